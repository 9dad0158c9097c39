//! Poses of one marker and one stamp that contradict each other.

use super::PredictParams;
use crate::still_average::TakeMotion;
use osteoflow_geometry::{Plane, Planes};
use osteoflow_verdict::{Answer, Reason};

/// Standard deviations of the difference of two poses from which they contradict each other.
const SIGMAS: f64 = 5.0;

/// Distance (mm) and angle (rad) of two poses beyond which they contradict each other.
fn limits(errors: &PredictParams) -> (f64, f64) {
    // Each of both poses has the noise.
    let sigmas = SIGMAS * std::f64::consts::SQRT_2;
    (sigmas * errors.marker_mm, sigmas * errors.marker_deg.to_radians())
}

/// Why the last of the planes that followed a marker are unknown, if others of their stamp contradict them by more than the noise of a
/// marker.
pub fn planes_contradict(followed: &[Planes]) -> Option<String> {
    let (limit_mm, limit_rad) = limits(&PredictParams::default());
    let last = followed.last()?;
    let first = |planes: &Planes| planes.planes.iter().find_map(Plane::isometry).copied();
    let at_end = first(last)?;
    let others = followed.iter().rev().take_while(|planes| planes.stamp_ns == last.stamp_ns).filter_map(first);
    let apart = others.map(|other| {
        let between = other.inverse() * at_end;
        (between.translation.vector.norm(), between.rotation.angle())
    });
    let (mm, rad) = apart.fold((0.0_f64, 0.0_f64), |most, apart| (most.0.max(apart.0), most.1.max(apart.1)));
    (mm > limit_mm || rad > limit_rad).then(|| {
        let deg = rad.to_degrees();
        format!("the bone marker has poses of one stamp that put them {mm:.1} mm and {deg:.1} degrees apart, and one of them is wrong")
    })
}

/// The sign in the streams of the markers that carried these takes; `None` where no two poses of one stamp differ by more than the
/// stated noise of a marker.
pub(super) fn contradiction_reason(takes: &[TakeMotion], errors: &PredictParams) -> Option<Reason> {
    let (limit_mm, limit_rad) = limits(errors);
    let markers = takes.iter().flat_map(|take| &take.markers);
    let times = |mm: f64, rad: f64| (mm / limit_mm).max(rad / limit_rad);
    let worst = markers.max_by(|a, b| {
        times(a.contradiction_mm, a.contradiction_rad).total_cmp(&times(b.contradiction_mm, b.contradiction_rad))
    })?;
    let (mm, rad) = (worst.contradiction_mm, worst.contradiction_rad);
    (mm > limit_mm || rad > limit_rad).then(|| {
        let reason = format!(
            "the {} marker has two poses of one stamp that are {mm:.1} mm and {:.1} degrees apart, and one of them is wrong",
            worst.marker,
            rad.to_degrees()
        );
        let remedy = "find what else sends this transform, and record it again with one sender; `osteoflow info` lists the topics";
        Reason::new("contradiction", Answer::Doubtful, reason, remedy)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still_average::{Carries, MarkerMotion, StillReport, still_average};
    use nalgebra::{Isometry3, Point3};

    #[test]
    fn the_last_planes_contradict_others_of_their_stamp_alone() {
        let at = |x: f64, stamp_ns: i64| {
            Planes::new("world", vec![Plane::new("a", Isometry3::translation(x, 0.0, 0.0))]).at(stamp_ns)
        };
        assert_eq!(planes_contradict(&[]), None);
        assert_eq!(planes_contradict(&[at(0.0, 5), at(9.0, 6), at(9.1, 6)]), None);
        let why = planes_contradict(&[at(9.0, 6), at(12.0, 6)]).unwrap();
        assert!(why.contains("put them 3.0 mm and 0.0 degrees apart"), "{why}");
    }

    #[test]
    fn poses_of_one_stamp_contradict_beyond_the_noise_in_place_or_in_rotation() {
        let still = still_average(&[Isometry3::identity(); 3], 1.0, 1.0).unwrap().report;
        let rule = |mm: f64, deg: f64| {
            let still = StillReport { contradiction_mm: mm, contradiction_rad: deg.to_radians(), ..still.clone() };
            let bone = MarkerMotion::new("bone", Carries::Frame, &Point3::origin(), &still);
            let take = TakeMotion::new("the scan").by(Some(bone));
            contradiction_reason(&[TakeMotion::new("P1"), take], &PredictParams::default())
        };
        assert_eq!((rule(0.0, 0.0), rule(0.42, 0.16)), (None, None));
        let mm = rule(3.0, 0.0).unwrap();
        assert_eq!((mm.rule.as_str(), mm.answer), ("contradiction", Answer::Doubtful));
        assert!(
            mm.reason.starts_with("the bone marker has two poses of one stamp that are 3.0 mm and 0.0 degrees apart")
        );
        assert!(rule(0.0, 0.5).unwrap().reason.contains("0.0 mm and 0.5 degrees"));
        assert_eq!(contradiction_reason(&[], &PredictParams::default()), None);
    }
}
