//! Whether a scan is large enough to say anything.

use super::size::{BONE_MM, in_units, span};
use nalgebra::Point3;
use osteoflow_geometry::Cloud;
use osteoflow_verdict::{Answer, Reason};

/// A scan that spans less determines no pose of a bone, mm: the residuals of 10 mm are one draw, and a bone is that wide.
const MIN_MM: f64 = 10.0;

/// No scan of a bone spans less, mm: it is in metres.
const SPECK_MM: f64 = 1.0;

/// A scan that a person takes spans at least this, mm, by which another unit is asked about.
const TAKEN_MM: f64 = 20.0;

/// The reason against a scan that is too small. It is refused where another unit would explain it and only the shape says where it lies:
/// a scan of a few millimetres fits nearly everywhere.
pub(super) fn extent_reason(scan: &Cloud, bone: &[Point3<f64>], is_by_shape: bool) -> Option<Reason> {
    let mm = span(scan.points())?;
    if mm < SPECK_MM {
        let reason = format!("the scan spans {mm:.2} mm, too little for any bone; likely cause: its file is in metres");
        let remedy = "give its unit (register: --source-unit-mm 1000; in a graph: scan.unit_mm = 1000.0)";
        return Some(Reason::new("extent", Answer::Refused, reason, remedy));
    }
    if mm >= MIN_MM {
        return None;
    }
    let bone_mm = span(bone).filter(|bone_mm| BONE_MM.contains(bone_mm)).unwrap_or_default();
    let small = format!("the scan spans {mm:.1} mm, too little to determine a pose");
    let Some([names, lengths, factors, first]) = in_units(mm, |mm| (TAKEN_MM..=bone_mm).contains(&mm)) else {
        return Some(Reason::new("extent", Answer::Doubtful, small, "scan a longer stretch"));
    };
    let reason = format!("{small}, and the bone {bone_mm:.0} mm: is the scan in {names}? It would then span {lengths}");
    let remedy = format!(
        "give its unit (register: --source-unit-mm {factors}; in a graph: scan.unit_mm = {first}), or scan a longer stretch"
    );
    let answer = if is_by_shape { Answer::Refused } else { Answer::Doubtful };
    Some(Reason::new("extent", answer, reason, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_that_spans_less_than_10_mm_is_doubtful_and_less_than_1_mm_refused() {
        let reason = |mm: f64| {
            let points = vec![Point3::new(40.0, -20.0, 100.0), Point3::new(40.0, -20.0, 100.0 + mm)];
            extent_reason(&Cloud::new("scan", points).unwrap(), &[], true).map(|reason| (reason.answer, reason.reason))
        };
        assert_eq!(reason(10.0), None);
        let small =
            |mm: &str| Some((Answer::Doubtful, format!("the scan spans {mm} mm, too little to determine a pose")));
        assert_eq!((reason(9.5), reason(1.0)), (small("9.5"), small("1.0")));
        let speck = "the scan spans 0.50 mm, too little for any bone; likely cause: its file is in metres";
        assert_eq!(reason(0.5), Some((Answer::Refused, speck.to_owned())));
    }
    #[test]
    fn a_scan_in_centimetres_or_inches_by_shape_alone_is_refused_with_its_unit_and_from_a_start_doubtful() {
        let line = |mm: f64| vec![Point3::origin(), Point3::new(0.0, 0.0, mm)];
        let judged = |scan_mm: f64, bone_mm: f64, is_by_shape: bool| {
            let scan = Cloud::new("scan", line(scan_mm)).unwrap();
            extent_reason(&scan, &line(bone_mm), is_by_shape)
                .map(|reason| (reason.answer, reason.reason, reason.remedy))
        };
        let (answer, reason, remedy) = judged(9.7, 362.0, true).unwrap();
        assert_eq!(answer, Answer::Refused);
        assert!(reason.ends_with("is the scan in cm or inches? It would then span 97 mm or 246 mm"), "{reason}");
        assert!(remedy.contains("--source-unit-mm 10 or 25.4"), "{remedy}");
        assert_eq!(judged(9.7, 362.0, false).unwrap().0, Answer::Doubtful);
        // A bone that is no longer than such a scan, or of no known length, is no sign of another unit.
        for bone_mm in [15.0, 900.0] {
            let (answer, reason, _) = judged(9.7, bone_mm, true).unwrap();
            assert_eq!((answer, reason.contains("unit")), (Answer::Doubtful, false), "{reason}");
        }
        assert_eq!(judged(10.0, 362.0, true), None);
    }
}
