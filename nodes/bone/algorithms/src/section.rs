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
    for [a, b] in cuts(mesh, t_mesh_plane) {
        let middle = nalgebra::center(&a, &b);
        if reach_mm.is_some_and(|reach| middle.coords.norm() > reach) {
            continue;
        }
        length += (b - a).norm();
        moment += middle.coords * (b - a).norm();
    }
    (length > 0.0).then(|| t_mesh_plane * Point3::from(moment / length))
}

/// The ends of the edges in which a plane cuts the faces of a mesh, in the plane's coordinates.
pub fn cuts(mesh: &Mesh, t_mesh_plane: &Isometry3<f64>) -> impl Iterator<Item = [Point3<f64>; 2]> {
    let (origin, normal) = (t_mesh_plane * Point3::origin(), t_mesh_plane * Vector3::z());
    (0..mesh.faces().len()).filter_map(move |face| {
        // Skips most faces by one product each, with a margin for rounding.
        let heights = mesh.corners(face).map(|p| (p - origin).dot(&normal));
        if heights.iter().all(|h| *h > CLEAR_MM) || heights.iter().all(|h| *h < -CLEAR_MM) {
            return None;
        }
        let corners = mesh.corners(face).map(|p| t_mesh_plane.inverse_transform_point(&p));
        let sides = (0..3).map(|k| (corners[k], corners[(k + 1) % 3]));
        let mut ends =
            sides.filter(|(a, b)| (a.z < 0.0) != (b.z < 0.0)).map(|(a, b)| a + (b - a) * (a.z / (a.z - b.z)));
        Some([ends.next()?, ends.next()?])
    })
}
