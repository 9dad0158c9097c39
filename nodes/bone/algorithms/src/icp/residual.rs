//! The residuals that the variants minimise: one file for each.

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

use super::normal_equations::NormalEquations;
use nalgebra::Vector3;

/// A correspondence about the source's centroid at the current pose, mm, in the target's axes.
pub(super) struct Pair {
    /// The source point.
    pub(super) source: Vector3<f64>,
    /// The source point less the target point.
    pub(super) difference: Vector3<f64>,
    /// The target point's unit normal; zero where unknown.
    pub(super) normal: Vector3<f64>,
    /// The source point's unit normal, turned to the target's side; zero where unknown.
    pub(super) source_normal: Vector3<f64>,
}

/// Cosine of 30 degrees.
const MIN_NORMAL_COSINE: f64 = 0.866;

impl Pair {
    /// The source point's normal; the target point's if the source's is unknown or differs by more than 30 degrees, as it was
    /// then estimated across an edge or from outliers.
    #[inline]
    fn sound_source_normal(&self) -> &Vector3<f64> {
        if self.source_normal.dot(&self.normal) < MIN_NORMAL_COSINE { &self.normal } else { &self.source_normal }
    }
}

/// A residual of a pair, the sum of whose squares a variant minimises.
pub(super) trait Residual: Send + Sync + 'static {
    /// Whether it needs the target's normals.
    const TARGET_NORMALS: bool = true;
    /// Whether it needs the source's normals.
    const SOURCE_NORMALS: bool = false;
    /// Whether points outside the surface count less by default; see [`IcpParams::one_sided`](super::IcpParams).
    const ONE_SIDED: bool = true;
    /// Whether the target points are the closest points of the target's triangles.
    const MESH: bool = false;

    /// The squared residual of a pair, mm².
    fn square(pair: &Pair) -> f64;

    /// Adds `weight` times the pair's `Jᵀr` and `JᵀJ`, turns in units of `1 / lever_arm_mm`.
    fn accumulate(pair: &Pair, weight: f64, lever_arm_mm: f64, equations: &mut NormalEquations);
}
