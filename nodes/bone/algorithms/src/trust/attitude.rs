//! Whether the attitude of the bone's marker was tested.

use super::Takes;
use crate::still_average::BonePose;
use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion};
use osteoflow_geometry::NamedPoint;

/// A misread attitude is detected if it displaces a located point by at least this many times the point's residual, and by at
/// least this much, mm: a landmark is located to 1 or 2 mm.
const SEEN_TIMES: f64 = 3.0;
const SEEN_MM: f64 = 5.0;

/// A pose as it would be misread.
type Misreading = fn(&Isometry3<f64>) -> Isometry3<f64>;

/// The ways in which a pose is misread.
const MISREADINGS: [Misreading; 3] = [
    |t| Isometry3::from_parts(t.translation, t.rotation.inverse()),
    |t| {
        let [x, y, z, w] = t.rotation.coords.into();
        Isometry3::from_parts(t.translation, UnitQuaternion::from_quaternion(Quaternion::new(x, y, z, w)))
    },
    Isometry3::inverse,
];

/// A point that was located while the bone's marker was at a pose.
struct Located {
    bone: Isometry3<f64>,
    /// Where it was planned, in the marker's frame.
    position: Point3<f64>,
    /// By how much it was off, mm.
    off_mm: f64,
}

/// The assumption that the attitude of the bone's marker was read as it was written; `None` where no marker is on the bone, or a turn
/// of the bone between the scan and the points has tested it: misread, they would not agree.
///
/// A bone that is not turned shows nothing: any attitude then gives one frame for scan and points.
pub(super) fn attitude_assumption(
    takes: &Takes<'_>,
    planned: &[NamedPoint],
    located: &[NamedPoint],
    measured_tre_mm: Option<f64>,
    t_target_source: &Isometry3<f64>,
) -> Option<String> {
    let at_scan = takes.scan?.bone.as_ref().map(BonePose::isometry)?;
    let named = |points: &[NamedPoint], name: &str| points.iter().find(|p| *p.name == *name).map(|p| p.position);
    let landmarks = takes.located.iter().map(|take| {
        let off = named(planned, &take.what)? - t_target_source * named(located, &take.what)?;
        Some((take, off.norm()))
    });
    let touches = takes.touched.iter().map(|take| Some((take, measured_tre_mm?)));
    let points: Vec<Located> = landmarks
        .chain(touches)
        .flatten()
        .filter_map(|(take, off_mm)| {
            let position = t_target_source.inverse() * named(planned, &take.what)?;
            Some(Located { bone: take.bone.as_ref()?.isometry(), position, off_mm })
        })
        .collect();
    let is_seen = |misread: &Misreading| {
        let seen_from = |bone: &Isometry3<f64>, p: &Point3<f64>| misread(bone).inverse() * bone * p;
        points.iter().any(|located| {
            let apart = seen_from(&located.bone, &located.position) - seen_from(&at_scan, &located.position);
            apart.norm() > SEEN_MM.max(SEEN_TIMES * located.off_mm)
        })
    };
    if MISREADINGS.iter().all(is_seen) {
        return None;
    }
    let turns = points.iter().map(|located| located.bone.rotation.angle_to(&at_scan.rotation).to_degrees());
    Some(format!(
        "the attitude of the bone's marker is read as it was written (order of its quaternion, direction of its transform): the bone was \
         turned by {:.1} degrees between the scan and the points located on it, which does not test it",
        turns.fold(0.0, f64::max)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still_average::TakeMotion;
    use nalgebra::Vector3;

    /// The assumption where the bone was turned between the scan and a landmark that is off by 1 mm.
    fn assumption(turn_deg: [f64; 3], off_mm: f64) -> Option<String> {
        let scan = Isometry3::new(Vector3::new(100.0, -50.0, 1200.0), Vector3::new(0.4, -0.9, 0.3));
        let turn = Isometry3::new(Vector3::new(3.0, 0.0, 1.0), Vector3::from(turn_deg).map(f64::to_radians));
        let take = |what: &str, pose: Isometry3<f64>| TakeMotion::new(what).on_bone(Some(&pose));
        let (at_scan, laser) = (take("scan", scan), [take("P1", scan * turn)]);
        let planned = [NamedPoint::new("P1", Point3::new(60.0, 40.0, 80.0))];
        let located = [NamedPoint::new("P1", Point3::new(60.0, 40.0, 80.0 + off_mm))];
        let takes = Takes { scan: Some(&at_scan), located: &laser, ..Takes::default() };
        attitude_assumption(&takes, &planned, &located, None, &Isometry3::identity())
    }

    #[test]
    fn the_attitude_is_an_assumption_until_a_turn_of_the_bone_has_tested_it() {
        let still = assumption([0.0; 3], 1.0).unwrap();
        assert!(still.contains("order of its quaternion") && still.contains("turned by 0.0 degrees"), "{still}");
        assert!(assumption([0.3, 0.2, -0.1], 1.0).unwrap().contains("turned by 0.4 degrees"));
        assert_eq!(assumption([8.0, 5.0, -6.0], 1.0), None);
        // Points that are off by as much as a misread attitude would put them test nothing.
        assert!(assumption([8.0, 5.0, -6.0], 30.0).is_some());
    }

    #[test]
    fn without_a_marker_on_the_bone_there_is_no_attitude() {
        let scan = TakeMotion::new("scan");
        let takes = Takes { scan: Some(&scan), ..Takes::default() };
        assert_eq!(attitude_assumption(&takes, &[], &[], None, &Isometry3::identity()), None);
        assert_eq!(attitude_assumption(&Takes::default(), &[], &[], None, &Isometry3::identity()), None);
    }
}
