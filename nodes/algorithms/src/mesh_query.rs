//! Rays and closest points on a triangle mesh.

use crate::kabsch::{centroid, finite};
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Mesh;
use parry3d_f64::math::Vector as Vec3;
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::TriMesh;
use std::sync::{Arc, OnceLock};

/// Distance behind a face at which a ray is continued, mm: beyond rounding, before any next face.
const STEP_PAST_MM: f64 = 1e-6;

/// A mesh prepared for ray casts and closest points. Wraps parry3d, with vertices relative to their mean, so a bone far
/// from the origin loses no digits. A cheap handle: clones share the search structure, which is built on first use.
#[derive(Clone)]
pub struct MeshQuery {
    mesh: Mesh,
    searched: Arc<OnceLock<Searched>>,
}

struct Searched {
    /// Where the mesh can be searched at all.
    shape: Option<TriMesh>,
    centre: Point3<f64>,
}

/// An intersection of a ray with a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// The point on the surface, mm.
    pub point: Point3<f64>,
    /// The distance from the ray's origin, mm.
    pub distance_mm: f64,
    /// The face that was hit.
    pub face: usize,
    /// The face's outward unit normal, whichever side is hit.
    pub normal: Vector3<f64>,
}

/// The point of a mesh closest to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closest {
    /// The point on the surface, mm.
    pub point: Point3<f64>,
    /// Its distance, mm.
    pub distance_mm: f64,
    /// The face it lies on.
    pub face: usize,
    /// The face's outward unit normal.
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
            let vertices = self.mesh.vertices().iter().map(|v| to_glam(&(v - centre))).collect();
            Searched { shape: TriMesh::new(vertices, self.mesh.faces().to_vec()).ok(), centre }
        })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The first face met from `origin` along `direction` (any length but zero), from either side.
    pub fn cast_ray(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<RayHit> {
        let direction = direction.try_normalize(0.0).filter(|d| finite(origin) && d.iter().all(|c| c.is_finite()))?;
        let Searched { shape, centre } = self.searched();
        let ray = Ray::new(to_glam(&(origin - centre)), to_glam(&direction));
        let hit = shape.as_ref()?.cast_local_ray_and_get_normal(&ray, f64::MAX, false)?;
        let face = hit.subshape as usize;
        let distance_mm = hit.time_of_impact;
        Some(RayHit { point: origin + direction * distance_mm, distance_mm, face, normal: self.normal(face) })
    }

    /// The point of the surface closest to `point`.
    pub fn closest_point(&self, point: &Point3<f64>) -> Option<Closest> {
        let Searched { shape, centre } = self.searched();
        let shape = shape.as_ref().filter(|_| finite(point))?;
        let projection = shape.project_local_point(to_glam(&(point - centre)), false);
        let face = projection.subshape as usize;
        let found = centre + Vector3::new(projection.point.x, projection.point.y, projection.point.z);
        Some(Closest { point: found, distance_mm: (found - point).norm(), face, normal: self.normal(face) })
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

fn to_glam(v: &Vector3<f64>) -> Vec3 {
    Vec3::new(v.x, v.y, v.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, together};
    use nalgebra::Isometry3;

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
    }

    #[test]
    fn inside_overlapping_parts_is_inside() {
        let query = MeshQuery::new(&together(&cuboid([0.0; 3], [10.0; 3]), &cuboid([5.0; 3], [15.0; 3])));
        for (point, inside) in [(2.0, true), (7.0, true), (12.0, true), (-1.0, false), (16.0, false)] {
            assert_eq!(query.is_inside(&Point3::new(point, point, point)), inside, "{point}");
        }
        assert!(!query.is_inside(&Point3::new(12.0, 2.0, 2.0)));
    }
}
