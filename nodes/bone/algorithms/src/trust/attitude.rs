//! Whether the attitude of the bone's marker was tested.

use super::case::Case;
use super::predict_last::bone_at_last;
use super::{Cut, RuleParams, Takes};
use crate::still_average::BonePose;
use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion};
use osteoflow_geometry::NamedPoint;
use osteoflow_verdict::{Answer, Reason};

/// A misread attitude is detected if it displaces a located point by at least this many times the point's residual, and by at
/// least this much, mm: a landmark is located to 1 or 2 mm.
const SEEN_TIMES: f64 = 3.0;
const SEEN_MM: f64 = 5.0;

/// Largest distance of a marker from the scanned part of the bone that carries it, mm: the length of a long leg.
const MARKER_REACH_MM: f64 = 500.0;

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

/// An attitude of the bone's marker that nothing has tested.
pub(super) struct Untested {
    /// What is taken for granted.
    pub(super) assumption: String,
    /// Why the last planes are not covered, if a misread attitude would put them beyond a limit.
    pub(super) beyond: Option<String>,
}

/// What is said of the attitude of the bone's marker; `None` where no marker is on the bone, or a turn of the bone between the scan and
/// the points located on it has tested it: misread, they would not agree.
///
/// A bone that is not turned shows nothing: any attitude then gives one frame for scan and points. So the planes at the scan do not
/// depend on it; those that followed the marker since do, as far as the bone has turned. `cuts` are in the frame that `t_target_source`
/// leads to.
pub(super) fn untested_attitude(
    case: &Case<'_>,
    cuts: &[Cut],
    planned: &[NamedPoint],
    rules: &RuleParams,
) -> Option<Untested> {
    let (takes, t_target_source) = (&case.takes, case.registered.t_target_source);
    let at_scan = takes.scan?.bone.as_ref().map(BonePose::isometry)?;
    let points = located_points(takes, planned, case.located, case.measured_tre_mm, t_target_source);
    let seen_from = |misread: &Misreading, bone: &Isometry3<f64>| misread(bone).inverse() * bone;
    let is_seen = |misread: &&Misreading| {
        let at_scan = seen_from(misread, &at_scan);
        points.iter().any(|located| {
            let apart = seen_from(misread, &located.bone) * located.position - at_scan * located.position;
            apart.norm() > SEEN_MM.max(SEEN_TIMES * located.off_mm)
        })
    };
    let unseen: Vec<&Misreading> = MISREADINGS.iter().filter(|misread| !is_seen(misread)).collect();
    if unseen.is_empty() {
        return None;
    }
    let turns = points.iter().map(|located| located.bone.rotation.angle_to(&at_scan.rotation).to_degrees());
    let assumption = format!(
        "the attitude of the bone's marker is read as it was written (order of its quaternion, direction of its transform): the bone was \
         turned by {:.1} degrees between the scan and the points located on it, which does not test it",
        turns.fold(0.0, f64::max)
    );
    let last = bone_at_last(takes, case.planes, t_target_source).filter(|_| !rules.attitude_stated);
    let beyond = last.and_then(|last| {
        // From where a plane was followed to, to where it would be.
        let to_misread = |misread: &&Misreading| {
            let scan_to_last = misread(&last) * misread(&at_scan).inverse();
            scan_to_last * at_scan * last.inverse()
        };
        let t_world_target = last * t_target_source.inverse();
        let size = |motion: &Isometry3<f64>| {
            let at = |cut: &Cut| t_world_target * cut.middle.position;
            let mm = cuts.iter().map(|cut| (motion * at(cut) - at(cut)).norm()).fold(0.0, f64::max);
            (mm, motion.rotation.angle().to_degrees())
        };
        let limits = &rules.limits;
        let of = |size: &(f64, f64)| limits.times(0.0, size.0, size.1);
        let sizes = unseen.iter().map(|misread| size(&to_misread(misread)));
        let (mm, deg) = sizes.filter(|size| of(size) > 1.0).max_by(|a, b| of(a).total_cmp(&of(b)))?;
        Some(format!(
            "the last planes rest on an attitude of the bone's marker that nothing has tested: read wrongly, they would be up to {mm:.1} mm and \
             {deg:.1} degrees off; trust ends at the planes of the scan. Locate a landmark once more after turning the bone, or, where this \
             was tested before, set rules.attitude_stated = true"
        ))
    });
    Some(Untested { assumption, beyond })
}

/// The landmarks and touches at known poses of the bone's marker.
fn located_points(
    takes: &Takes<'_>,
    planned: &[NamedPoint],
    located: &[NamedPoint],
    measured_tre_mm: Option<f64>,
    t_target_source: &Isometry3<f64>,
) -> Vec<Located> {
    let named = |points: &[NamedPoint], name: &str| points.iter().find(|p| *p.name == *name).map(|p| p.position);
    let landmarks = takes.located.iter().map(|take| {
        let off = named(planned, &take.what)? - t_target_source * named(located, &take.what)?;
        Some((take, off.norm()))
    });
    let touches = takes.touched.iter().map(|take| Some((take, measured_tre_mm?)));
    landmarks
        .chain(touches)
        .flatten()
        .filter_map(|(take, off_mm)| {
            let position = t_target_source.inverse() * named(planned, &take.what)?;
            Some(Located { bone: take.bone.as_ref()?.isometry(), position, off_mm })
        })
        .collect()
}

/// The sign that the marker of the bone is nowhere near it: `t_target_source` has its origin.
pub(super) fn marker_place_reason(case: &Case<'_>) -> Option<Reason> {
    case.takes.scan?.bone.as_ref()?;
    let marker = case.registered.t_target_source * Point3::origin();
    let scan = case.registered.source.points();
    let at = |p: &Point3<f64>| case.registered.t_target_source * p;
    let apart_mm = scan.iter().map(|p| (at(p) - marker).norm()).fold(f64::INFINITY, f64::min);
    (apart_mm > MARKER_REACH_MM && apart_mm.is_finite()).then(|| {
        let reason = format!(
            "the marker of the bone is {apart_mm:.0} mm from the scan of the bone, which no marker on it is: its poses are inverse, mirrored, \
             or those of another tool"
        );
        let remedy = "check which transform is written as the bone's, and in which direction";
        Reason::new("marker_place", Answer::Doubtful, reason, remedy)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still_average::TakeMotion;
    use crate::target::Target;
    use crate::trust::Registered;
    use nalgebra::Vector3;
    use osteoflow_geometry::{Cloud, Plane, Planes, SurfaceOrigin};

    /// The assumption where the bone was turned between the scan and a landmark that is off by 1 mm.
    fn assumption(turn_deg: [f64; 3], off_mm: f64) -> Option<String> {
        let scan = Isometry3::new(Vector3::new(100.0, -50.0, 1200.0), Vector3::new(0.4, -0.9, 0.3));
        let turn = Isometry3::new(Vector3::new(3.0, 0.0, 1.0), Vector3::from(turn_deg).map(f64::to_radians));
        let take = |what: &str, pose: Isometry3<f64>| TakeMotion::new(what).on_bone(Some(&pose));
        let (at_scan, laser) = (take("scan", scan), [take("P1", scan * turn)]);
        let planned = [NamedPoint::new("P1", Point3::new(60.0, 40.0, 80.0))];
        let located = [NamedPoint::new("P1", Point3::new(60.0, 40.0, 80.0 + off_mm))];
        let takes = Takes { scan: Some(&at_scan), located: &laser, ..Takes::default() };
        said(takes, &planned, &located, None).map(|untested| untested.assumption)
    }

    /// What is said of these takes, with a plane that was followed to `last`.
    fn said(
        takes: Takes<'_>,
        planned: &[NamedPoint],
        located: &[NamedPoint],
        last: Option<Isometry3<f64>>,
    ) -> Option<Untested> {
        let target = Target::new("ct", SurfaceOrigin::User, vec![Point3::origin()], None).unwrap();
        let source = Cloud::new("bone_marker", vec![Point3::new(60.0, 40.0, 80.0)]).unwrap();
        let registered =
            Registered { target: &target, source: &source, t_target_source: &Isometry3::identity(), at: &[] };
        let plane = |t: Isometry3<f64>| Planes::new("world", vec![Plane::new("a", t)]);
        let (planes, followed) = (plane(Isometry3::identity()), last.map(plane));
        let takes = Takes { last: followed.as_ref(), ..takes };
        let case = Case { takes, located, planes: Some(&planes), ..Case::new(registered) };
        let cut = Cut { middle: NamedPoint::new("a", Point3::new(60.0, 0.0, 120.0)), normal: Vector3::z() };
        untested_attitude(&case, &[cut], planned, &RuleParams::default())
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
    fn trust_ends_at_the_scan_where_the_bone_turned_since_and_no_turn_tested_the_attitude() {
        let scan = Isometry3::new(Vector3::new(100.0, -50.0, 1200.0), Vector3::new(0.4, -0.9, 0.3));
        let take = |what: &str, pose: Isometry3<f64>| TakeMotion::new(what).on_bone(Some(&pose));
        let planned = [NamedPoint::new("P1", Point3::new(60.0, 40.0, 80.0))];
        let turned = |deg: [f64; 3]| {
            scan * Isometry3::new(Vector3::new(9.0, -4.0, 2.0), Vector3::from(deg).map(f64::to_radians))
        };
        let ends = |at_landmark: [f64; 3], at_last: [f64; 3]| {
            let (at_scan, laser) = (take("scan", scan), [take("P1", turned(at_landmark))]);
            let takes = Takes { scan: Some(&at_scan), located: &laser, ..Takes::default() };
            said(takes, &planned, &planned, Some(turned(at_last))).and_then(|untested| untested.beyond)
        };
        let said = ends([0.1; 3], [5.0, 3.0, -4.0]).unwrap();
        assert!(said.contains("trust ends at the planes of the scan") && said.contains("mm and"), "{said}");
        assert_eq!(ends([8.0, 5.0, -6.0], [5.0, 3.0, -4.0]), None, "tested by a turn");
        // The last planes are those of the scan.
        let (at_scan, still) = (take("scan", scan), [take("P1", scan)]);
        let takes = Takes { scan: Some(&at_scan), located: &still, ..Takes::default() };
        assert_eq!(
            super::tests::said(takes, &planned, &planned, Some(scan)).and_then(|untested| untested.beyond),
            None
        );
    }

    #[test]
    fn without_a_marker_on_the_bone_there_is_no_attitude() {
        let scan = TakeMotion::new("scan");
        let takes = Takes { scan: Some(&scan), ..Takes::default() };
        assert!(said(takes, &[], &[], None).is_none());
        assert!(said(Takes::default(), &[], &[], None).is_none());
    }

    #[test]
    fn a_marker_that_is_nowhere_near_the_bone_is_told() {
        let target = Target::new("ct", SurfaceOrigin::User, vec![Point3::origin()], None).unwrap();
        let reason = |at_mm: f64| {
            let source = Cloud::new("bone_marker", vec![Point3::new(at_mm, 0.0, 0.0)]).unwrap();
            let registered =
                Registered { target: &target, source: &source, t_target_source: &Isometry3::identity(), at: &[] };
            let scan = TakeMotion::new("scan").on_bone(Some(&Isometry3::identity()));
            let takes = Takes { scan: Some(&scan), ..Takes::default() };
            marker_place_reason(&Case { takes, ..Case::new(registered) })
        };
        assert_eq!(reason(250.0), None);
        assert!(reason(1340.0).unwrap().reason.contains("1340 mm from the scan"));
    }
}
