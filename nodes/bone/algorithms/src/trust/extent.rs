//! Whether a scan is large enough to say anything.

use osteoflow_geometry::Cloud;
use osteoflow_verdict::{Answer, Reason};

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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_scan_that_spans_less_than_10_mm_is_doubtful_and_less_than_1_mm_refused() {
        let reason = |mm: f64| {
            let points = vec![Point3::new(40.0, -20.0, 100.0), Point3::new(40.0, -20.0, 100.0 + mm)];
            extent_reason(&Cloud::new("scan", points).unwrap()).map(|reason| (reason.answer, reason.reason))
        };
        assert_eq!(reason(10.0), None);
        let small =
            |mm: &str| Some((Answer::Doubtful, format!("the scan spans {mm} mm, too little to determine a pose")));
        assert_eq!((reason(9.5), reason(1.0)), (small("9.5"), small("1.0")));
        let speck = "the scan spans 0.50 mm, too little for any bone; likely cause: its file is in metres";
        assert_eq!(reason(0.5), Some((Answer::Refused, speck.to_owned())));
    }
}
