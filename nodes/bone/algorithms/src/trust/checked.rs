//! What a check piece says against a registration.

use crate::metrics::CheckReport;
use osteoflow_geometry::StampNs;
use osteoflow_verdict::{Answer, Reason};

/// Refused from this many times the largest error that raises no doubt.
const REFUSED_FROM: f64 = 3.0;

/// The sign in the worst reading of a check piece; `None` if each is within `max_mm`.
///
/// `scanned_ns` is the time of the scan. A piece that is off before it was read with a wrong calibration as well.
pub(super) fn check_reason(readings: &[CheckReport], scanned_ns: StampNs, max_mm: f64) -> Option<Reason> {
    let worst = readings.iter().max_by(|a, b| a.mean_mm.total_cmp(&b.mean_mm)).filter(|r| r.mean_mm > max_mm)?;
    let answer = if worst.mean_mm > REFUSED_FROM * max_mm { Answer::Refused } else { Answer::Doubtful };
    let when = if worst.read_at_ns < scanned_ns { "before the scan" } else { "at the scan or after it" };
    let reason = format!(
        "the camera reads the check piece {:.1} mm (mean) from where its marker has it, {when}; likely cause: the camera's marker \
         was knocked after the calibration",
        worst.mean_mm
    );
    Some(Reason::new(
        "check_piece",
        answer,
        reason,
        "calibrate and scan again, or check the piece's own marker and CAD",
    ))
}

/// Whether a check piece shows that the camera's marker sat on its camera as calibrated when the bone was scanned: it was read
/// at the scan or after it, and every reading is within `max_mm`.
pub(super) fn is_checked(readings: &[CheckReport], scanned_ns: StampNs, max_mm: f64) -> bool {
    readings.iter().any(|reading| reading.read_at_ns >= scanned_ns) && readings.iter().all(|r| r.mean_mm <= max_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::check_points;
    use nalgebra::{Isometry3, Point3};
    use osteoflow_geometry::NamedPoint;

    const SCANNED_NS: StampNs = 100;
    const MAX_MM: f64 = 0.8;

    /// A piece that is off by `mm`, read at a time.
    fn reading(mm: f64, read_at_ns: StampNs) -> CheckReport {
        let named = |k: u8, x: f64| NamedPoint {
            stamp_ns: read_at_ns,
            ..NamedPoint::new(format!("working_{k}"), Point3::new(x, 0.0, 200.0))
        };
        let known: Vec<NamedPoint> = (0..3).map(|k| named(k, f64::from(k))).collect();
        let read: Vec<NamedPoint> = (0..3).map(|k| named(k, f64::from(k) + mm)).collect();
        check_points(&read, &known, &Isometry3::identity(), None).unwrap()
    }

    fn answer(readings: &[CheckReport]) -> Option<Answer> {
        check_reason(readings, SCANNED_NS, MAX_MM).map(|reason| reason.answer)
    }

    #[test]
    fn the_worst_reading_decides() {
        assert_eq!(answer(&[]), None);
        assert_eq!(answer(&[reading(0.7, 100), reading(0.3, 200)]), None);
        assert_eq!(answer(&[reading(0.3, 50), reading(0.9, 200)]), Some(Answer::Doubtful));
        assert_eq!(answer(&[reading(2.5, 200), reading(0.3, 300)]), Some(Answer::Refused));
        let before = check_reason(&[reading(1.0, 50), reading(0.3, 200)], SCANNED_NS, MAX_MM).unwrap();
        assert!(before.reason.contains("1.0 mm (mean)") && before.reason.contains("before the scan"), "{before:?}");
    }

    #[test]
    fn a_reading_at_a_limit_is_within_it() {
        let off = |mean_mm: f64| CheckReport { mean_mm, ..reading(0.3, SCANNED_NS) };
        let answer = |mm: f64| check_reason(&[off(mm)], SCANNED_NS, 1.0).map(|reason| reason.answer);
        assert_eq!((answer(1.0), answer(3.0)), (None, Some(Answer::Doubtful)));
        assert!(is_checked(&[off(1.0)], SCANNED_NS, 1.0));
        let reason = check_reason(&[off(1.26)], SCANNED_NS, 1.0).unwrap();
        assert_eq!(
            reason.reason,
            "the camera reads the check piece 1.3 mm (mean) from where its marker has it, at the scan or after it; likely cause: \
             the camera's marker was knocked after the calibration"
        );
    }

    #[test]
    fn the_marker_is_checked_by_a_piece_read_with_the_scan_or_later_alone() {
        assert!(!is_checked(&[], SCANNED_NS, MAX_MM));
        assert!(!is_checked(&[reading(0.3, 99)], SCANNED_NS, MAX_MM));
        assert!(is_checked(&[reading(0.3, 99), reading(0.3, 100)], SCANNED_NS, MAX_MM));
        assert!(!is_checked(&[reading(0.9, 99), reading(0.3, 100)], SCANNED_NS, MAX_MM));
    }
}
