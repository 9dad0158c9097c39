//! Points drawn from a surface.

use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Mesh;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Points on a surface, with the outward unit normals of their faces.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// The points, `n`, mm, in the mesh's frame.
    pub points: Vec<Point3<f64>>,
    /// One unit normal for each point.
    pub normals: Vec<Vector3<f64>>,
}

/// `n` points drawn evenly by area from `mesh`, from a seeded generator.
///
/// Stratified: the k-th point is drawn from the k-th of `n` equal shares of the area taken face after face, so that
/// neighbouring faces are served alike. Faces without area get none; a mesh without any area gives no points.
/// `O(m + n)`.
///
/// # Source
/// Osada et al. 2002, eq. 1, for the point within a face.
pub fn surface(mesh: &Mesh, n: usize, rng: &mut ChaCha8Rng) -> Samples {
    let n_faces = mesh.faces().len();
    let areas: Vec<f64> = (0..n_faces).map(|face| mesh.area_vector(face).norm() / 2.0).collect();
    let total: f64 = areas.iter().sum();
    let mut samples = Samples { points: Vec::with_capacity(n), normals: Vec::with_capacity(n) };
    let Some(last) = areas.iter().rposition(|&a| a > 0.0).filter(|_| total > 0.0) else { return samples };
    let (mut face, mut area_before) = (0, 0.0);
    for k in 0..n {
        let share = total * (k as f64 + rng.random::<f64>()) / n as f64;
        while face < last && (areas[face] == 0.0 || area_before + areas[face] <= share) {
            area_before += areas[face];
            face += 1;
        }
        let [a, b, c] = mesh.corners(face);
        let (root, v) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
        samples.points.push(a + (b - a) * (root * (1.0 - v)) + (c - a) * (root * v));
        samples.normals.push(mesh.area_vector(face) / (2.0 * areas[face]));
    }
    samples
}
