use super::{Correspondence, Pairing};
use crate::icp::visible_surface::VisibleSurface;
use crate::mesh_query::MeshQuery;
use nalgebra::Vector3;

/// Below this distance, mm, rounding decides the direction to the closest point, and the triangle's normal is taken.
const TOUCHING_MM: f64 = 1e-7;

/// The closest points of the target's triangles, if they face the camera. The normal is the direction from them.
pub(in crate::icp) struct Mesh<'a> {
    surface: &'a VisibleSurface<'a>,
    mesh: &'a MeshQuery,
}

impl<'a> Mesh<'a> {
    pub(in crate::icp) fn new(surface: &'a VisibleSurface<'a>, mesh: &'a MeshQuery) -> Self {
        Self { surface, mesh }
    }
}

impl Pairing for Mesh<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        let found = self.mesh.closest_point(&(self.surface.index.centre + source));
        match found.filter(|c| c.distance_mm <= radius_mm && self.surface.is_visible(source, &c.normal)) {
            Some(closest) => {
                let target = closest.point - self.surface.index.centre;
                let outward = (source - target).try_normalize(TOUCHING_MM);
                correspondence.set(closest.face as u32, target, outward.unwrap_or(closest.normal));
            }
            None => correspondence.clear(),
        }
    }
}
