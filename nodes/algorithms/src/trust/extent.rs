//! Whether a scan is large enough to say anything.

use super::verdict::{Answer, Reason};
use osteoflow_geometry::Cloud;

/// A scan that spans less determines no pose of a bone, mm: the residuals of 10 mm are one draw, and a bone is that wide.
const MIN_MM: f64 = 10.0;

/// No scan of a bone spans less, mm: it is in metres.
const SPECK_MM: f64 = 1.0;

/// The reason against a scan that is too small.
pub(super) fn extent_reason(scan: &Cloud) -> Option<Reason> {
    let first = scan.points().first()?;
    let (low, high) = scan.points().iter().fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
    let mm = (high - low).norm();
    if mm < SPECK_MM {
        let reason = format!("the scan spans {mm:.2} mm, too little for any bone; likely cause: its file is in metres");
        return Some(Reason::new("extent", Answer::Refused, reason, "give its unit"));
    }
    let small = || {
        let reason = format!("the scan spans {mm:.1} mm, too little to determine a pose");
        Reason::new("extent", Answer::Doubtful, reason, "scan a longer stretch")
    };
    (mm < MIN_MM).then(small)
}
