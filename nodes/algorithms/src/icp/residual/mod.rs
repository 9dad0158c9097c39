//! What a variant minimises over its pairs: one file for each.

mod generalized;
mod point_to_mesh;
mod point_to_plane;
mod point_to_point;
mod symmetric;

pub(super) use generalized::Generalized;
pub(super) use point_to_mesh::PointToMesh;
pub(super) use point_to_plane::PointToPlane;
pub(super) use point_to_point::PointToPoint;
pub(super) use symmetric::Symmetric;

use super::sums::Sums;
use nalgebra::Vector3;

/// A source point and its partner, as seen from the source's centroid at the pose at hand, mm, target's axes.
pub(super) struct Pair {
    /// The source point.
    pub(super) arm: Vector3<f64>,
    /// From the partner to the source point.
    pub(super) gap: Vector3<f64>,
    /// The partner's unit normal; zero where unknown.
    pub(super) normal: Vector3<f64>,
    /// The source point's own unit normal, turned to the target's side; zero where unknown.
    pub(super) source_normal: Vector3<f64>,
}

/// Cosine of 30 degrees.
const ASTRAY: f64 = 0.866;

impl Pair {
    /// The source point's normal, or its partner's where it is unknown or lies more than 30 degrees off: such a one was
    /// estimated across an edge or from what is no bone.
    #[inline]
    fn sound_source_normal(&self) -> &Vector3<f64> {
        if self.source_normal.dot(&self.normal) < ASTRAY { &self.normal } else { &self.source_normal }
    }
}

/// What a variant minimises: the sum over the pairs of a squared residual.
pub(super) trait Residual: Send + Sync + 'static {
    /// Whether the target's normals are needed.
    const TARGET_NORMALS: bool = true;
    /// Whether the source's normals are needed.
    const SOURCE_NORMALS: bool = false;
    /// Whether partners are the closest points of the target's triangles.
    const MESH: bool = false;

    /// The squared residual of a pair, mm².
    fn square(pair: &Pair) -> f64;

    /// Adds `weight` times what the pair asks for: `Jᵀr` and `JᵀJ`, turns in units of `1 / lever_arm_mm`.
    fn add(pair: &Pair, weight: f64, lever_arm_mm: f64, sums: &mut Sums);
}
