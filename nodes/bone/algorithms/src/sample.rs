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
    /// The face that each point lies on.
    pub faces: Vec<u32>,
}

/// `n` points drawn evenly by area from `mesh`, from a seeded generator.
///
/// Stratified: the k-th point is drawn from the k-th of `n` equal shares of the cumulative area of the faces. Faces
/// without area get no points, nor does a mesh without any area. `O(m + n)`.
///
/// # Source
/// Osada et al. 2002, eq. 1, for the point within a face.
pub fn surface(mesh: &Mesh, n: usize, rng: &mut ChaCha8Rng) -> Samples {
    let n_faces = mesh.faces().len();
    let areas: Vec<f64> = (0..n_faces).map(|face| mesh.area_vector(face).norm() / 2.0).collect();
    let total: f64 = areas.iter().sum();
    let mut samples =
        Samples { points: Vec::with_capacity(n), normals: Vec::with_capacity(n), faces: Vec::with_capacity(n) };
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
        samples.faces.push(face as u32);
    }
    samples
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_query::MeshQuery;
    use crate::shapes::{cuboid, shaft};
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn faces_get_points_in_proportion_to_their_area() {
        let mesh = cuboid([0.0; 3], [10.0, 20.0, 30.0]);
        assert_eq!(mesh.area_mm2(), 2200.0);
        let samples = surface(&mesh, 22_000, &mut ChaCha8Rng::seed_from_u64(1));
        // 200, 300 and 600 of 1100 mm² on each pair of sides.
        for (axis, share) in [(2, 4000), (1, 6000), (0, 12_000)] {
            let n = samples.normals.iter().filter(|n| n[axis].abs() == 1.0).count();
            assert!(n.abs_diff(share) <= 4, "{n} of {share} points across axis {axis}");
        }
        let middle: nalgebra::Vector3<f64> = samples.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 22_000.0;
        assert!((middle - Vector3::new(5.0, 10.0, 15.0)).norm() < 0.2, "{middle}");
    }

    #[test]
    fn points_lie_on_the_surface_with_its_normals_and_follow_the_seed() {
        let mesh = shaft();
        let draw = |seed| surface(&mesh, 500, &mut ChaCha8Rng::seed_from_u64(seed));
        let query = MeshQuery::new(&mesh);
        let samples = draw(1);
        for (p, n) in samples.points.iter().zip(&samples.normals) {
            let closest = query.closest_point(p).unwrap();
            assert!(closest.distance_mm < 1e-9 && (n.norm() - 1.0).abs() < 1e-12);
            assert!(query.is_inside(&(p - n * 1e-3)) && !query.is_inside(&(p + n * 1e-3)));
        }
        assert_eq!(samples, draw(1));
        assert_ne!(samples, draw(2));
    }

    #[test]
    fn faces_without_area_get_nothing() {
        let flat = Mesh::new("ct", mesh_origin(), vec![Point3::origin(); 3], vec![[0, 1, 2]]).unwrap();
        assert!(surface(&flat, 10, &mut ChaCha8Rng::seed_from_u64(1)).points.is_empty());
        assert!(surface(&shaft(), 0, &mut ChaCha8Rng::seed_from_u64(1)).points.is_empty());
    }

    fn mesh_origin() -> osteoflow_geometry::SurfaceOrigin {
        osteoflow_geometry::SurfaceOrigin::Exact
    }
}
