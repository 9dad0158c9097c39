//! Which motions the pairs of an ICP hold.

use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// Below this RMS residual (mm) for a motion of 1 mm, a motion counts as free: ten millimetres of slide would then
/// hide in a residual of 0.05 mm, the depth noise of the camera.
pub(super) const FREE_PER_MM: f64 = 0.005;

/// Which motions of the source the pairs hold, from the normal matrix `JᵀJ` at the end.
///
/// Rotations are about the source's centroid and scaled by `lever_arm_mm`, so that all six unknowns are millimetres: an
/// eigenvalue divided by the number of pairs is the square of the RMS residual that a motion of 1 mm causes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observability {
    /// Eigenvalues of `JᵀJ / n`, largest first, no unit.
    pub eigenvalues: [f64; 6],
    /// Largest over smallest eigenvalue; `None` if the smallest is zero.
    pub condition: Option<f64>,
    /// RMS distance of the source points from their centroid, mm.
    pub lever_arm_mm: f64,
    /// The motion that the pairs hold least.
    pub weakest: WeakDirection,
    /// Motions that the pairs leave free, weakest first; empty where all six are held. What the result says along them
    /// is what the start said.
    pub undetermined: Vec<WeakDirection>,
}

/// A motion of unit length in the six scaled unknowns, in the target's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeakDirection {
    /// RMS residual caused by 1 mm of it, mm.
    pub residual_per_mm: f64,
    /// Its shift, a share of 1 mm along x, y, z.
    pub translation: [f64; 3],
    /// Its turn times `lever_arm_mm`, about x, y, z through the centroid.
    pub rotation: [f64; 3],
}

impl Observability {
    /// From `JᵀJ / n` along the normals, unknowns `(shift, turn · lever arm)`.
    pub(super) fn new(hold: &Matrix6<f64>, lever_arm_mm: f64) -> Self {
        let (values, vectors) = sorted_eigen(hold);
        let direction = |k: usize| {
            let v = upright(vectors.column(k).into_owned());
            WeakDirection {
                residual_per_mm: values[k].max(0.0).sqrt(),
                translation: [v[0], v[1], v[2]],
                rotation: [v[3], v[4], v[5]],
            }
        };
        let free = |k: &usize| values[*k].max(0.0).sqrt() < FREE_PER_MM;
        Self {
            eigenvalues: values.into(),
            condition: Some(values[0] / values[5]).filter(|c| c.is_finite() && *c > 0.0),
            lever_arm_mm,
            weakest: direction(5),
            undetermined: (0..6).rev().filter(free).map(direction).collect(),
        }
    }
}

/// Eigenvalues, largest first, with their vectors as columns.
pub(super) fn sorted_eigen(matrix: &Matrix6<f64>) -> (Vector6<f64>, Matrix6<f64>) {
    let eigen = matrix.symmetric_eigen();
    let mut order = [0, 1, 2, 3, 4, 5];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]).then(a.cmp(&b)));
    let values = Vector6::from_fn(|k, _| eigen.eigenvalues[order[k]]);
    let vectors = Matrix6::from_fn(|row, k| eigen.eigenvectors[(row, order[k])]);
    (values, vectors)
}

/// An eigenvector has no sign; its largest component is made positive.
fn upright(v: Vector6<f64>) -> Vector6<f64> {
    let largest = v.iamax();
    if v[largest] < 0.0 { -v } else { v }
}
