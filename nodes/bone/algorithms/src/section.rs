//! Sections of a surface by a plane.

use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::Mesh;

/// A face this far to one side of a plane is not cut by it, mm: beyond rounding.
const CLEAR_MM: f64 = 1e-3;

/// The centre of the outline in which a plane (its z axis is its normal) cuts the mesh: the mean of the outline
/// weighted by length. `None` if the plane misses the mesh.
///
/// A plane may cut a bent bone twice; if `reach_mm` is given, only cut edges within it of the plane's origin count.
/// `O(m)`.
pub fn middle(mesh: &Mesh, t_mesh_plane: &Isometry3<f64>, reach_mm: Option<f64>) -> Option<Point3<f64>> {
    let (mut length, mut moment) = (0.0, Vector3::zeros());
    let (origin, normal) = (t_mesh_plane * Point3::origin(), t_mesh_plane * Vector3::z());
    for face in 0..mesh.faces().len() {
        // Skips most faces by one product each, with a margin for rounding.
        let heights = mesh.corners(face).map(|p| (p - origin).dot(&normal));
        if heights.iter().all(|h| *h > CLEAR_MM) || heights.iter().all(|h| *h < -CLEAR_MM) {
            continue;
        }
        let corners = mesh.corners(face).map(|p| t_mesh_plane.inverse_transform_point(&p));
        let mut ends = Vec::with_capacity(2);
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            if (a.z < 0.0) != (b.z < 0.0) {
                ends.push(a + (b - a) * (a.z / (a.z - b.z)));
            }
        }
        let [a, b] = ends[..] else { continue };
        let middle = nalgebra::center(&a, &b);
        if reach_mm.is_some_and(|reach| middle.coords.norm() > reach) {
            continue;
        }
        length += (b - a).norm();
        moment += middle.coords * (b - a).norm();
    }
    (length > 0.0).then(|| t_mesh_plane * Point3::from(moment / length))
}
