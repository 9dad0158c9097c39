//! What the plan says about itself: the order of its landmarks, and whether it belongs to the surface.

use crate::coarse::{best_other_order, rms};
use crate::kabsch::kabsch;
use crate::mesh_query::MeshQuery;
use crate::section;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{NamedPoint, Plane, PlanePlace, Planes};
use osteoflow_verdict::{Answer, Reason};
use serde::{Deserialize, Serialize};

/// Maximum distance of a planned point from the surface, mm: a point picked on the CT, or at the bottom of a drilled hole.
const MAX_OFF_SURFACE_MM: f64 = 3.0;

/// Maximum distance from a cutting plane's origin at which it has to cut the bone, mm: twice the width of a fibula's head.
const CUT_REACH_MM: f64 = 60.0;

/// The order in which located landmarks fit the planned ones best.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OrderEvidence {
    /// RMS residual of the landmarks as named, mm.
    pub fre_mm: f64,
    /// RMS residual in the best other order, mm.
    pub best_other_fre_mm: f64,
    /// For each planned point, the located one that fits it in that order.
    pub best_other: Vec<String>,
}

/// Fits the landmarks in every order; `None` with fewer than three of the same names, or more than six.
pub fn landmark_order(planned: &[NamedPoint], located: &[NamedPoint]) -> Option<OrderEvidence> {
    let by_name = |p: &NamedPoint| located.iter().find(|l| l.name == p.name);
    let located: Vec<&NamedPoint> = planned.iter().map(by_name).collect::<Option<_>>()?;
    let target: Vec<Point3<f64>> = planned.iter().map(|p| p.position).collect();
    let source: Vec<Point3<f64>> = located.iter().map(|p| p.position).collect();
    let t = kabsch(&target, &source).ok()?;
    let (best_other_fre_mm, best_other) = best_other_order(&target, &located)?;
    Some(OrderEvidence { fre_mm: rms(&t, &target, &source), best_other_fre_mm, best_other })
}

/// Landmarks were exchanged where another order leaves less than this share of the squares: landmarks that are aimed 5 mm off fit
/// a little better in another order by chance.
const EXCHANGED: f64 = 0.5;

/// The sign that the landmarks fit much better in another order.
pub(super) fn order_reason(order: &OrderEvidence) -> Option<Reason> {
    let OrderEvidence { fre_mm, best_other_fre_mm, best_other } = order;
    (best_other_fre_mm.powi(2) < EXCHANGED * fre_mm.powi(2)).then(|| {
        let reason = format!(
            "the landmarks fit better in another order: {} by {best_other_fre_mm:.1} mm (RMS), as named {fre_mm:.1} mm",
            best_other.join(", ")
        );
        let remedy = "check which landmark each scan shows; two were probably exchanged";
        Reason::new("landmark_order", Answer::Doubtful, reason, remedy)
    })
}

/// The reason against a result whose planes are unknown at the end of the recording; `None` if all are known.
pub fn planes_lost(last: &Planes) -> Option<Reason> {
    let unknown = last.planes.iter().find_map(|plane| match &plane.place {
        PlanePlace::Unknown(why) => Some(why),
        PlanePlace::Known(_) => None,
    })?;
    let reason = format!("the cutting planes are unknown at the end: {unknown}");
    let remedy =
        "track the bone's marker until the end; the planes at the scan hold only if the bone has not moved since";
    Some(Reason::new("planes_lost", Answer::Doubtful, reason, remedy))
}

/// The changes of coordinates by which plan and surface may differ.
const CAUSES: [(&str, [f64; 3]); 6] = [
    ("one of both is in RAS, the other in LPS", [-1.0, -1.0, 1.0]),
    ("one of both is mirrored in x", [-1.0, 1.0, 1.0]),
    ("one of both is mirrored in y", [1.0, -1.0, 1.0]),
    ("one of both is mirrored in z", [1.0, 1.0, -1.0]),
    ("the plan is in metres, the surface in millimetres", [1000.0, 1000.0, 1000.0]),
    ("the plan is in millimetres, the surface in metres", [0.001, 0.001, 0.001]),
];

/// Reasons against planned points and planes that contradict the surface they should belong to.
pub fn plan_faults(surface: &MeshQuery, points: &[NamedPoint], planes: Option<&Planes>) -> Vec<Reason> {
    let mut faults = Vec::new();
    let mut add = |answer, reason: String, remedy: &str| faults.push(Reason::new("plan", answer, reason, remedy));
    let distance = |p: &Point3<f64>| surface.closest_point(p).map_or(f64::INFINITY, |closest| closest.distance_mm);
    let distances: Vec<f64> = points.iter().map(|p| distance(&p.position)).collect();
    let n_off = distances.iter().filter(|d| **d > MAX_OFF_SURFACE_MM).count();
    if n_off > 0 {
        let fits = |scale: &[f64; 3]| {
            points.iter().all(|p| {
                let moved = Point3::from(p.position.coords.component_mul(&Vector3::from(*scale)));
                distance(&moved) <= MAX_OFF_SURFACE_MM
            })
        };
        let cause =
            CAUSES.iter().find(|(_, scale)| fits(scale)).map_or("the plan is of another surface", |(cause, _)| cause);
        let (n, largest_mm) = (points.len(), distances.iter().copied().fold(0.0, f64::max));
        let reason = format!(
            "{n_off} of {n} planned points lie off the surface, up to {largest_mm:.0} mm; likely cause: {cause}"
        );
        let remedy = "take plan and surface from the same CT, in the same coordinates; points that lie off the surface by nature are fiducials \
                      (on_surface = false of verdict.registration, register --fiducials)";
        add(Answer::Refused, reason, remedy);
    }
    let planes: &[Plane] = match planes {
        Some(planes) => &planes.planes,
        None => return faults,
    };
    if planes.is_empty() {
        let reason = "the plan has no cutting planes".into();
        add(Answer::Doubtful, reason, "add them, or do not wire the verdict's planes");
    }
    for plane in planes {
        let Some(t) = plane.isometry() else { continue };
        if section::middle(surface.mesh(), t, Some(CUT_REACH_MM)).is_none() {
            let (name, distance_mm) = (&plane.name, distance(&t.translation.vector.into()));
            let reason =
                format!("the planned plane {name} does not cut the bone, its origin is {distance_mm:.0} mm away");
            add(Answer::Refused, reason, "check that the plan is of this patient and in the surface's coordinates");
        }
    }
    // The normals of two planes that bound a segment point from the first to the second.
    for pair in planes.chunks_exact(2) {
        let (Some(a), Some(b)) = (pair[0].isometry(), pair[1].isometry()) else { continue };
        let between = b.translation.vector - a.translation.vector;
        let along = |plane: &Plane| plane.normal().map_or(0.0, |n| n.dot(&between));
        if along(&pair[0]) <= 0.0 || along(&pair[1]) <= 0.0 {
            let (first, second) = (&pair[0].name, &pair[1].name);
            let reason = format!("the normals of {first} and {second} do not both point from {first} to {second}");
            add(Answer::Doubtful, reason, "turn the reversed plane, or exchange them");
        }
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::{Mesh, SurfaceOrigin};

    fn named(name: &str, position: [f64; 3]) -> NamedPoint {
        NamedPoint::new(name, Point3::from(position))
    }

    #[test]
    fn landmarks_are_tried_in_every_order() {
        let planned = [named("a", [0.0, 0.0, 0.0]), named("b", [40.0, 0.0, 0.0]), named("c", [0.0, 30.0, 0.0])];
        let mut located = planned.to_vec();
        // Located exactly, but b and c exchanged.
        (located[1].position, located[2].position) = (planned[2].position, planned[1].position);
        located.reverse();
        let order = landmark_order(&planned, &located).unwrap();
        assert_eq!(order.best_other, ["a", "c", "b"]);
        assert!(order.best_other_fre_mm < 1e-9, "{order:?}");
        // As named, the triangle turned over meets its mirror image. About the centroids, both have a sum of squares of 5000/3;
        // their dot and cross products, 1600 and 700/3, give the best turn in the plane.
        let left = 2.0 * (5000.0 / 3.0 - 1600.0_f64.hypot(700.0 / 3.0)) / 3.0;
        assert!((order.fre_mm - left.sqrt()).abs() < 1e-9, "rounding alone: {order:?}");
        assert_eq!(landmark_order(&planned[..2], &located), None);
        assert_eq!(landmark_order(&planned, &located[1..]), None);
        let many = |n: u8| -> Vec<NamedPoint> {
            (0..n).map(|k| named(&k.to_string(), [f64::from(k * k), f64::from(k), f64::from(k * k * k)])).collect()
        };
        let six = landmark_order(&many(6), &many(6)).unwrap();
        assert!(six.fre_mm < 1e-9 && six.best_other_fre_mm > 0.5, "{six:?}");
        assert_eq!(landmark_order(&many(7), &many(7)), None);
    }

    #[test]
    fn planes_that_are_unknown_at_the_end_are_doubtful() {
        let known = Planes::new("world", vec![Plane::new("a", nalgebra::Isometry3::identity())]);
        assert_eq!(planes_lost(&known), None);
        let lost = planes_lost(&known.unknown("world", 5, "the marker is hidden")).unwrap();
        assert_eq!((lost.rule.as_str(), lost.answer), ("planes_lost", Answer::Doubtful));
        assert_eq!(lost.reason, "the cutting planes are unknown at the end: the marker is hidden");
    }

    /// A square of 100 mm in the plane z = 0, away from the origin.
    fn square() -> MeshQuery {
        let corners = [[100.0, 300.0, 0.0], [200.0, 300.0, 0.0], [200.0, 400.0, 0.0], [100.0, 400.0, 0.0]];
        let faces = vec![[0, 1, 2], [0, 2, 3]];
        MeshQuery::new(&Mesh::new("ct", SurfaceOrigin::Exact, corners.map(Point3::from).to_vec(), faces).unwrap())
    }

    #[test]
    fn a_planned_point_may_be_3_mm_off_the_surface() {
        let at = |z: f64| named("p", [150.0, 350.0, z]);
        assert_eq!(plan_faults(&square(), &[at(3.0), at(-3.0)], None), []);
        let faults = plan_faults(&square(), &[at(3.0), at(8.0), at(-4.0)], None);
        let [fault] = &faults[..] else { panic!("{faults:?}") };
        let off = "2 of 3 planned points lie off the surface, up to 8 mm; likely cause: the plan is of another surface";
        assert_eq!((fault.rule.as_str(), fault.answer, fault.reason.as_str()), ("plan", Answer::Refused, off));
    }

    #[test]
    fn each_change_of_coordinates_is_found() {
        for (position, words) in [
            ([-150.0, -350.0, 0.0], "one of both is in RAS, the other in LPS"),
            ([-150.0, 350.0, 0.0], "one of both is mirrored in x"),
            ([150.0, -350.0, 0.0], "one of both is mirrored in y"),
            ([0.15, 0.35, 0.0], "the plan is in metres, the surface in millimetres"),
            ([150_000.0, 350_000.0, 0.0], "the plan is in millimetres, the surface in metres"),
        ] {
            let faults = plan_faults(&square(), &[named("p", position)], None);
            let [fault] = &faults[..] else { panic!("{faults:?}") };
            assert!(fault.reason.ends_with(&format!("; likely cause: {words}")), "{fault:?}");
        }
    }

    #[test]
    fn two_planes_in_the_wrong_order_are_reversed() {
        let plane = |name: &str, x: f64| {
            Plane::new(
                name,
                nalgebra::Isometry3::new(Vector3::new(x, 350.0, 0.0), Vector3::y() * std::f64::consts::FRAC_PI_2),
            )
        };
        let faults = |planes: Vec<Plane>| plan_faults(&square(), &[], Some(&Planes::new("ct", planes)));
        assert_eq!(faults(vec![plane("a", 120.0), plane("b", 150.0)]), []);
        let reversed = faults(vec![plane("b", 150.0), plane("a", 120.0)]);
        let [fault] = &reversed[..] else { panic!("{reversed:?}") };
        let reason = "the normals of b and a do not both point from b to a";
        assert_eq!((fault.answer, fault.reason.as_str()), (Answer::Doubtful, reason));
        let [away] = &faults(vec![plane("c", 1200.0)])[..] else { panic!("a plane 1 m off cuts nothing") };
        let reason = "the planned plane c does not cut the bone, its origin is 1000 mm away";
        assert_eq!((away.answer, away.reason.as_str()), (Answer::Refused, reason));
    }
}
