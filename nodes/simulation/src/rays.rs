//! Rays and closest points on a mesh: the one place that knows parry.

use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Mesh;
use parry3d_f64::math::Vector;
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::TriMesh;

/// A mesh that can be asked where a ray meets it, in the mesh's own frame.
pub(crate) struct Surface {
    tree: TriMesh,
    normals: Vec<Vector3<f64>>,
    // Coordinates of a CT are large beside the bone; near the origin nothing is lost.
    centre: Vector3<f64>,
}

/// Where a ray meets a surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    /// Along the unit ray, mm.
    pub(crate) distance_mm: f64,
    /// Outward unit normal of the face.
    pub(crate) normal: Vector3<f64>,
}

impl Surface {
    /// Prepares `mesh`; `None` if parry refuses it, which only an empty mesh can cause.
    pub(crate) fn new(mesh: &Mesh) -> Option<Self> {
        let centre = mesh.vertices().iter().map(|v| v.coords).sum::<Vector3<f64>>() / mesh.vertices().len() as f64;
        let vertices = mesh.vertices().iter().map(|v| parry(&(v.coords - centre))).collect();
        let tree = TriMesh::new(vertices, mesh.faces().to_vec()).ok()?;
        let normals = (0..mesh.faces().len())
            .map(|face| mesh.area_vector(face).try_normalize(0.0).unwrap_or_else(Vector3::zeros))
            .collect();
        Some(Self { tree, normals, centre })
    }

    /// The first face that a ray along the unit vector `direction` meets from outside.
    pub(crate) fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<Hit> {
        let ray = Ray::new(parry(&(origin.coords - self.centre)), parry(direction));
        let hit = self.tree.cast_local_ray_and_get_normal(&ray, f64::MAX, false)?;
        Some(Hit { distance_mm: hit.time_of_impact, normal: self.normals[hit.subshape as usize] })
    }

    /// The point of the surface closest to `point`, and the outward unit normal there.
    pub(crate) fn closest(&self, point: &Point3<f64>) -> (Point3<f64>, Vector3<f64>) {
        let (projection, _) = self.tree.project_local_point_and_get_feature(parry(&(point.coords - self.centre)));
        let on = Vector3::new(projection.point.x, projection.point.y, projection.point.z);
        (Point3::from(on + self.centre), self.normals[projection.subshape as usize])
    }
}

fn parry(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}
