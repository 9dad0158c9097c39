//! The marks on the bone: the planned points with the errors of a ruler.

use crate::draws::{Term, normal, stream};
use crate::{RulerParams, SimulationError};
use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, NamedPoint, Points};

/// Marks planned points on the bone.
pub(super) struct Ruler<'a> {
    pub(super) params: &'a RulerParams,
    pub(super) surface: &'a MeshQuery,
    pub(super) anatomy: &'a Anatomy,
    pub(super) seed: u64,
}

impl Ruler<'_> {
    /// The marks of planned points, of which the first is the `first`-th of the plan.
    pub(super) fn marks(&self, planned: &Points, first: usize) -> Result<Points, SimulationError> {
        let RulerParams { shared_mm, each_mm, across_mm } = *self.params;
        if [shared_mm, each_mm, across_mm] == [0.0; 3] {
            return Ok(planned.clone());
        }
        let shared = normal(&mut stream(self.seed, Term::RulerShared, 0)) * shared_mm;
        let marks = planned.points.iter().enumerate().map(|(k, point)| {
            let mut rng = stream(self.seed, Term::RulerEach, (first + k) as u64);
            let (along, across) = (normal(&mut rng) * each_mm, normal(&mut rng) * across_mm);
            beside(point, across, shared + along, self.surface, self.anatomy)
        });
        Ok(Points::new(&planned.frame, marks.collect::<Result<Vec<_>, SimulationError>>()?))
    }
}

/// The surface point at a distance across and along the bone from a point on it.
pub(super) fn beside(
    point: &NamedPoint,
    across_mm: f64,
    along_mm: f64,
    surface: &MeshQuery,
    anatomy: &Anatomy,
) -> Result<NamedPoint, SimulationError> {
    let on_bone = |place: &Point3<f64>| {
        surface
            .closest_point(place)
            .ok_or_else(|| SimulationError::Unsuitable(format!("planned point {} is not finite", point.name)))
    };
    let outward = on_bone(&point.position)?.normal;
    let around = anatomy.proximal.cross(&outward).try_normalize(1e-6).unwrap_or_else(Vector3::zeros);
    let moved = point.position + around * across_mm + *anatomy.proximal * along_mm;
    Ok(NamedPoint::new(point.name.clone(), on_bone(&moved)?.point))
}
