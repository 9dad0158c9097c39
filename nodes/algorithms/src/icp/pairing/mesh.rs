use super::{Known, Pairing};
use crate::icp::surface::Surface;
use crate::mesh_query::MeshQuery;
use nalgebra::Vector3;

/// Below this distance its direction is lost to rounding, mm; the triangle's normal is taken.
const TOUCHING_MM: f64 = 1e-7;

/// The closest point of the target's triangles, where that faces the camera. The normal is the direction from it.
pub(in crate::icp) struct Mesh<'a> {
    surface: &'a Surface<'a>,
    mesh: &'a MeshQuery,
}

impl<'a> Mesh<'a> {
    pub(in crate::icp) fn new(surface: &'a Surface<'a>, mesh: &'a MeshQuery) -> Self {
        Self { surface, mesh }
    }
}

impl Pairing for Mesh<'_> {
    #[inline]
    fn find(&self, moved: &Vector3<f64>, reach_mm: f64, known: &mut Known) {
        let found = self.mesh.closest_point(&(self.surface.index.centre + moved));
        match found.filter(|c| c.distance_mm <= reach_mm && self.surface.faces(moved, &c.normal)) {
            Some(closest) => {
                let target = closest.point - self.surface.index.centre;
                let outward = (moved - target).try_normalize(TOUCHING_MM);
                known.set(closest.face as u32, target, outward.unwrap_or(closest.normal));
            }
            None => known.clear(),
        }
    }
}
