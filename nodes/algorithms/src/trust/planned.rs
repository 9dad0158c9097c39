//! What the plan says about itself: the order of its landmarks, and whether it belongs to the surface.

use super::verdict::{Answer, Reason};
use crate::kabsch::kabsch;
use crate::mesh_query::MeshQuery;
use crate::section;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{NamedPoint, PlanePlace, Planes};
use serde::{Deserialize, Serialize};

/// Maximum number of landmarks of which all orders are tried.
const MAX_PERMUTED: usize = 6;

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
    if !(3..=MAX_PERMUTED).contains(&located.len()) {
        return None;
    }
    let target: Vec<Point3<f64>> = planned.iter().map(|p| p.position).collect();
    let fre = |order: &[usize]| {
        let source: Vec<Point3<f64>> = order.iter().map(|&k| located[k].position).collect();
        let t = kabsch(&target, &source).ok()?;
        let squares: f64 = target.iter().zip(&source).map(|(t_p, s)| (t * s - t_p).norm_squared()).sum();
        Some((squares / target.len() as f64).sqrt())
    };
    let named: Vec<usize> = (0..located.len()).collect();
    let fre_mm = fre(&named)?;
    let mut best: Option<(f64, Vec<usize>)> = None;
    crate::coarse::permutations(located.len(), &mut |order| {
        if order == named {
            return;
        }
        if let Some(fre) = fre(order).filter(|fre| best.as_ref().is_none_or(|(least, _)| fre < least)) {
            best = Some((fre, order.to_vec()));
        }
    });
    let (best_other_fre_mm, order) = best?;
    let best_other = order.iter().map(|&k| located[k].name.to_string()).collect();
    Some(OrderEvidence { fre_mm, best_other_fre_mm, best_other })
}

/// A contradiction between a plan and the surface it should belong to.
#[derive(Debug, Clone, PartialEq)]
pub enum PlanFault {
    /// Planned points lie off the surface.
    Off {
        /// Number of points off the surface.
        n_off: usize,
        /// Number of planned points.
        n: usize,
        /// Largest distance, mm.
        largest_mm: f64,
        /// The change of coordinates that would put them onto it, in words.
        cause: Option<&'static str>,
    },
    /// A cutting plane misses the bone.
    MissesBone {
        /// The plane.
        name: String,
        /// Distance of its origin from the bone, mm.
        distance_mm: f64,
    },
    /// The normals of two cutting planes that bound a segment do not both point from the first to the second.
    Reversed {
        /// The first plane.
        first: String,
        /// The second plane.
        second: String,
    },
    /// There are no cutting planes.
    NoPlanes,
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

/// Contradictions between planned points and planes and the surface.
pub fn plan_faults(surface: &MeshQuery, points: &[NamedPoint], planes: Option<&Planes>) -> Vec<PlanFault> {
    let mut faults = Vec::new();
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
        let cause = CAUSES.iter().find(|(_, scale)| fits(scale)).map(|(cause, _)| *cause);
        let largest_mm = distances.iter().copied().fold(0.0, f64::max);
        faults.push(PlanFault::Off { n_off, n: points.len(), largest_mm, cause });
    }
    let Some(planes) = planes else { return faults };
    if planes.planes.is_empty() {
        faults.push(PlanFault::NoPlanes);
    }
    for plane in planes.planes.iter() {
        let Some(t) = plane.isometry() else { continue };
        if section::middle(surface.mesh(), t, Some(CUT_REACH_MM)).is_none() {
            let distance_mm = distance(&t.translation.vector.into());
            faults.push(PlanFault::MissesBone { name: plane.name.to_string(), distance_mm });
        }
    }
    for pair in planes.planes.chunks_exact(2) {
        let (Some(a), Some(b)) = (pair[0].isometry(), pair[1].isometry()) else { continue };
        let between = b.translation.vector - a.translation.vector;
        let along = |plane: &osteoflow_geometry::Plane| plane.normal().map_or(0.0, |n| n.dot(&between));
        if along(&pair[0]) <= 0.0 || along(&pair[1]) <= 0.0 {
            faults.push(PlanFault::Reversed { first: pair[0].name.to_string(), second: pair[1].name.to_string() });
        }
    }
    faults
}
