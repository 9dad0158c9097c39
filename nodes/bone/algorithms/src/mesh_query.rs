//! Rays and closest points on a triangle mesh.

mod face;

use crate::bvh::{Aabb, Bvh};
use crate::kabsch::{centroid, finite};
use crate::morton;
use face::Face;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Mesh;
use std::sync::{Arc, OnceLock};

/// Distance behind a face at which a ray is continued, mm: beyond rounding, before any next face.
const STEP_PAST_MM: f64 = 1e-6;

/// A mesh prepared for ray casts and closest points.
///
/// The vertices are held relative to their mean, so a bone far from the origin loses no digits. A cheap handle: clones
/// share the search structure, which is built on first use.
#[derive(Clone)]
pub struct MeshQuery {
    mesh: Mesh,
    searched: Arc<OnceLock<Searched>>,
}

struct Searched {
    /// Faces along a Morton curve, relative to the centre.
    faces: Vec<Face>,
    /// The index in the mesh of each face along the curve.
    order: Vec<u32>,
    bvh: Bvh,
    centre: Point3<f64>,
}

/// A point of a mesh: the first on a ray, or the closest to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The point on the surface, mm.
    pub point: Point3<f64>,
    /// Its distance from the ray's origin or the other point, mm.
    pub distance_mm: f64,
    /// The face it lies on.
    pub face: usize,
    /// The face's outward unit normal, whichever side is hit.
    pub normal: Vector3<f64>,
}

impl MeshQuery {
    /// A query of `mesh`; faces without area are never hit.
    pub fn new(mesh: &Mesh) -> Self {
        Self { mesh: mesh.clone(), searched: Arc::default() }
    }

    /// Builds the search structure now. `O(m log m)`.
    pub fn prepare(&self) {
        self.searched();
    }

    #[inline]
    fn searched(&self) -> &Searched {
        self.searched.get_or_init(|| {
            let centre = centroid(self.mesh.vertices());
            let corners = |face: &[u32; 3]| face.map(|v| self.mesh.vertices()[v as usize] - centre);
            let middles: Vec<Vector3<f64>> =
                self.mesh.faces().iter().map(|face| corners(face).iter().sum::<Vector3<f64>>() / 3.0).collect();
            let order = morton::order_by_index(&middles);
            let faces: Vec<Face> = order.iter().map(|&f| Face(corners(&self.mesh.faces()[f as usize]))).collect();
            let boxes: Vec<Aabb> = faces.iter().map(|face| Aabb::of(&face.0)).collect();
            Searched { faces, order, bvh: Bvh::new(&boxes), centre }
        })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The first face met from `origin` along `direction` (any length but zero), from either side.
    ///
    /// Of faces met at one distance, as on an edge, the one with the lowest index.
    pub fn cast_ray(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<SurfacePoint> {
        let direction = direction.try_normalize(0.0).filter(|d| finite(origin) && d.iter().all(|c| c.is_finite()))?;
        let searched = self.searched();
        let from = origin - searched.centre;
        let (mut distance_mm, mut first) = (f64::MAX, None);
        searched.bvh.along(&from, &direction, distance_mm, |place| {
            if let Some(met) = searched.faces[place].met(&from, &direction).filter(|met| *met <= distance_mm) {
                let face = searched.order[place] as usize;
                if met < distance_mm || first.is_none_or(|first| face < first) {
                    (distance_mm, first) = (met, Some(face));
                }
            }
            distance_mm
        });
        let face = first?;
        Some(SurfacePoint { point: origin + direction * distance_mm, distance_mm, face, normal: self.normal(face) })
    }

    /// The point of the surface closest to `point`. Of faces at one distance, as at an edge or a corner, the one with the
    /// lowest index.
    pub fn closest_point(&self, point: &Point3<f64>) -> Option<SurfacePoint> {
        if !finite(point) {
            return None;
        }
        let searched = self.searched();
        let at = point - searched.centre;
        // With a first bound most nodes are never sorted. Beyond single precision it is the answer.
        let first = searched.bvh.near(&at)?;
        let (mut foot, mut face) = (searched.faces.get(first)?.closest(&at), searched.order[first] as usize);
        let mut square = (foot - at).norm_squared();
        searched.bvh.nearest(&at, square, |place| {
            let (other, other_face) = (searched.faces[place].closest(&at), searched.order[place] as usize);
            let other_square = (other - at).norm_squared();
            if other_square < square || other_square == square && other_face < face {
                (square, foot, face) = (other_square, other, other_face);
            }
            square
        });
        let foot = searched.centre + foot;
        Some(SurfacePoint { point: foot, distance_mm: (foot - point).norm(), face, normal: self.normal(face) })
    }

    /// Whether the point is inside one of the closed parts of the mesh: a ray leaves more faces than it enters.
    ///
    /// Parts may overlap, as CAD programs export them. The result for a point on a face is arbitrary.
    pub fn is_inside(&self, point: &Point3<f64>) -> bool {
        // Oblique to every axis, so that the ray does not run along an edge of a box.
        let direction = Vector3::new(0.412_371, 0.576_923, 0.705_128).normalize();
        let (mut from, mut left) = (*point, 0);
        for _ in 0..self.mesh.faces().len() {
            let Some(hit) = self.cast_ray(&from, &direction) else { break };
            left += if hit.normal.dot(&direction) > 0.0 { 1 } else { -1 };
            from = hit.point + direction * STEP_PAST_MM;
        }
        left > 0
    }

    fn normal(&self, face: usize) -> Vector3<f64> {
        self.mesh.area_vector(face).try_normalize(0.0).unwrap_or_else(Vector3::zeros)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joined::joined;
    use crate::shapes::{cuboid, shaft};
    use nalgebra::Isometry3;
    use osteoflow_geometry::SurfaceOrigin;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn rays_and_closest_points_name_their_face_far_from_the_origin_too() {
        for far in [0.0, 1e7] {
            let mesh = cuboid([0.0; 3], [10.0, 20.0, 30.0]).transformed("ct", &Isometry3::translation(far, 0.0, far));
            let query = MeshQuery::new(&mesh);
            let hit = query.cast_ray(&Point3::new(far + 2.0, 3.0, far + 100.0), &Vector3::new(0.0, 0.0, -4.0)).unwrap();
            assert!((hit.distance_mm - 70.0).abs() < 1e-6 && hit.normal == Vector3::z());
            assert_eq!(mesh.area_vector(hit.face).normalize(), Vector3::z());
            let closest = query.closest_point(&Point3::new(far + 2.0, -3.0, far + 5.0)).unwrap();
            assert!((closest.distance_mm - 3.0).abs() < 1e-6 && closest.normal == -Vector3::y());
            assert_eq!(query.cast_ray(&Point3::new(far, 0.0, far + 100.0), &Vector3::z()), None);
        }
        let query = MeshQuery::new(&cuboid([0.0; 3], [1.0; 3]));
        assert_eq!(query.cast_ray(&Point3::origin(), &Vector3::zeros()), None);
        assert_eq!(query.closest_point(&Point3::new(f64::NAN, 0.0, 0.0)), None);
        // Its square is beyond single precision.
        let far = query.closest_point(&Point3::new(1e25, 0.5, 0.5)).unwrap();
        assert!((far.distance_mm / 1e25 - 1.0).abs() < 1e-9, "{far:?}");
    }

    #[test]
    fn inside_overlapping_parts_is_inside() {
        let query = MeshQuery::new(&joined(&[cuboid([0.0; 3], [10.0; 3]), cuboid([5.0; 3], [15.0; 3])]));
        for (point, inside) in [(2.0, true), (7.0, true), (12.0, true), (-1.0, false), (16.0, false)] {
            assert_eq!(query.is_inside(&Point3::new(point, point, point)), inside, "{point}");
        }
        assert!(!query.is_inside(&Point3::new(12.0, 2.0, 2.0)));
    }

    /// The first face met, and its distance, by trying all faces.
    fn cast_at_all(query: &MeshQuery, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<(usize, f64)> {
        let searched = query.searched();
        let from = origin - searched.centre;
        (0..searched.faces.len())
            .filter_map(|k| Some((searched.order[k] as usize, searched.faces[k].met(&from, &direction.normalize())?)))
            .min_by(|a, b| a.1.partial_cmp(&b.1).unwrap().then(a.0.cmp(&b.0)))
    }

    fn check_ray(query: &MeshQuery, origin: &Point3<f64>, direction: &Vector3<f64>) -> bool {
        let hit = query.cast_ray(origin, direction);
        assert_eq!(
            hit.map(|hit| (hit.face, hit.distance_mm)),
            cast_at_all(query, origin, direction),
            "from {origin} along {direction}"
        );
        hit.is_some()
    }

    /// The closest face, and the point on it, by trying all faces.
    fn closest_of_all(query: &MeshQuery, point: &Point3<f64>) -> Option<(usize, Point3<f64>)> {
        let searched = query.searched();
        let at = point - searched.centre;
        (0..searched.faces.len())
            .map(|k| (searched.order[k] as usize, searched.faces[k].closest(&at)))
            .min_by(|a, b| (a.1 - at).norm_squared().total_cmp(&(b.1 - at).norm_squared()).then(a.0.cmp(&b.0)))
            .map(|(face, foot)| (face, searched.centre + foot))
    }

    fn check_closest(query: &MeshQuery, point: &Point3<f64>) {
        let closest = query.closest_point(point).map(|closest| (closest.face, closest.point));
        assert_eq!(closest, closest_of_all(query, point), "from {point}");
    }

    fn drawn(rng: &mut ChaCha8Rng, reach: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| rng.random_range(-reach..reach))
    }

    /// A position on a drawn face, by the weights of its second and third corner.
    fn on_face(mesh: &Mesh, rng: &mut ChaCha8Rng, [v, w]: [f64; 2]) -> Point3<f64> {
        let face = mesh.faces()[rng.random_range(0..mesh.faces().len())];
        let [a, b, c] = face.map(|v| mesh.vertices()[v as usize]);
        a + (b - a) * v + (c - a) * w
    }

    fn bone_and_box() -> [Mesh; 2] {
        let moved = Isometry3::new(Vector3::new(-90.0, -85.0, -890.0), Vector3::new(0.3, -0.2, 0.5));
        [shaft().transformed("ct", &moved), cuboid([0.0; 3], [10.0, 20.0, 30.0])]
    }

    #[test]
    fn rays_meet_the_face_that_a_search_of_all_faces_finds() {
        for mesh in bone_and_box() {
            let (query, mut rng) = (MeshQuery::new(&mesh), ChaCha8Rng::seed_from_u64(1));
            let mut n_hit = 0;
            for k in 0..600 {
                // Through faces, edges and corners, from outside, from inside, from a face, and from 10 m away.
                let weights = [[0.2, 0.3], [0.4, 0.0], [0.0, 0.0]][k % 3];
                let through = on_face(&mesh, &mut rng, weights);
                let reach = [200.0, 3.0, 1e4][k / 3 % 3];
                let origin = through + drawn(&mut rng, reach);
                n_hit += usize::from(check_ray(&query, &origin, &(through - origin)));
                check_ray(&query, &through, &drawn(&mut rng, 1.0));
                check_ray(&query, &origin, &drawn(&mut rng, 1.0));
            }
            // A ray through a corner of the outline may miss by rounding.
            assert!(n_hit > 400, "{n_hit} of 600 rays hit");
        }
    }

    #[test]
    fn rays_along_an_axis_or_a_face_meet_the_same_faces_too() {
        for mesh in bone_and_box() {
            let (query, mut rng) = (MeshQuery::new(&mesh), ChaCha8Rng::seed_from_u64(2));
            let mut n_hit = 0;
            for k in 0..600 {
                let mut along = Vector3::zeros();
                along[k % 3] = if k % 2 == 0 { 1.0 } else { -2.0 };
                let through = on_face(&mesh, &mut rng, [[0.2, 0.3], [0.5, 0.0], [0.0, 0.0]][k / 3 % 3]);
                n_hit += usize::from(check_ray(&query, &(through - along * 300.0), &along));
                check_ray(&query, &through, &along);

                let face = mesh.faces()[rng.random_range(0..mesh.faces().len())];
                let [a, b, c] = face.map(|v| mesh.vertices()[v as usize]);
                let within = (b - a) * rng.random_range(-1.0..1.0) + (c - a) * rng.random_range(-1.0..1.0);
                check_ray(&query, &(a - within * 5.0), &within);
            }
            assert!(n_hit > 400, "{n_hit} of 600 rays hit");
        }
    }

    #[test]
    fn closest_points_are_those_of_a_search_of_all_faces() {
        for mesh in bone_and_box() {
            let (query, mut rng) = (MeshQuery::new(&mesh), ChaCha8Rng::seed_from_u64(3));
            for k in 0..600 {
                let on = on_face(&mesh, &mut rng, [[0.2, 0.3], [0.4, 0.0], [0.0, 0.0]][k % 3]);
                check_closest(&query, &on);
                let reach = [0.01, 3.0, 50.0, 3000.0][k % 4];
                check_closest(&query, &(on + drawn(&mut rng, reach)));
            }
        }
    }

    #[test]
    fn of_faces_at_one_distance_the_lowest_index_is_found() {
        let query = MeshQuery::new(&joined(&[cuboid([0.0; 3], [10.0; 3]), cuboid([0.0; 3], [10.0; 3])]));
        // The diagonal between the upper faces, 2 and 3, of both boxes.
        let hit = query.cast_ray(&Point3::new(5.0, 5.0, 20.0), &-Vector3::z()).unwrap();
        assert_eq!((hit.face, hit.distance_mm), (2, 10.0));
        let closest = query.closest_point(&Point3::new(12.0, 12.0, 12.0)).unwrap();
        assert_eq!((closest.face, closest.point), (3, Point3::new(10.0, 10.0, 10.0)));
    }

    #[test]
    fn faces_without_area_are_not_hit() {
        let corners = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 3.0, -1.0], [4.0, 3.0, -1.0]];
        let vertices: Vec<_> = corners.map(Point3::from).to_vec();
        let flat = vec![[0, 1, 2], [1, 1, 0], [2, 2, 2]];
        let mesh = |faces| Mesh::new("ct", SurfaceOrigin::Exact, vertices.clone(), faces).unwrap();
        let query = MeshQuery::new(&mesh(flat.clone()));
        let with_face = MeshQuery::new(&mesh([flat, vec![[0, 1, 4], [0, 4, 3]]].concat()));
        for x in [0.0, 1.0, 2.0, 3.5] {
            for tilt in [0.0, 0.1, -0.1] {
                let (origin, down) = (Point3::new(x, -10.0 * tilt, 10.0), Vector3::new(0.0, tilt, -1.0));
                assert_eq!(query.cast_ray(&origin, &down), None);
                assert!(with_face.cast_ray(&origin, &down).is_none_or(|hit| hit.face > 2));
            }
        }
        // A face without area still has a closest point.
        assert_eq!(query.closest_point(&Point3::new(3.0, 0.0, 7.0)).unwrap().point, Point3::new(3.0, 0.0, 0.0));
    }
}
