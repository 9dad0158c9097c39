//! Conditioning of a registration: the motions that its pairs determine.

use super::pairing::Pairing;
use super::params::IcpParams;
use super::problem::Problem;
use super::residual::PointToPlane;
use super::source::PreparedSource;
use super::state::State;
use super::visible_surface::VisibleSurface;
use super::weights::Weights;
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// RMS residual (mm) of a motion of 1 mm below which the motion is in the nullspace: ten millimetres of slide then
/// cause a residual of 0.05 mm, the depth noise of the camera.
pub(super) const FREE_PER_MM: f64 = 0.005;

/// Radius of a bone, mm. The normals of samples beside the closest point determine spurious motions of any curved surface, even
/// of a ball, by their distance over its radius. Motions determined by less than a cell of the samples over this radius are
/// probed by moving the source.
const BONE_RADIUS_MM: f64 = 10.0;

/// Length of the probing motion, mm: beyond the spacing of the samples, within the shape of the bone.
const PROBE_MM: f64 = 2.0;

/// About this many source points are moved to probe.
const PROBED: usize = 1000;

/// Eigenvalues of the normal matrix `JᵀJ` at the end, and the motions that the pairs leave undetermined.
///
/// Rotations are about the source's centroid and scaled by `lever_arm_mm`, so that all six unknowns are in mm: an
/// eigenvalue of `JᵀJ / n` is the square of the RMS residual that a motion of 1 mm causes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observability {
    /// Eigenvalues of `JᵀJ / n`, largest first, no unit.
    pub eigenvalues: [f64; 6],
    /// Largest over smallest eigenvalue; `None` if the smallest is zero.
    pub condition: Option<f64>,
    /// RMS distance of the source points from their centroid, mm.
    pub lever_arm_mm: f64,
    /// The motion of the smallest eigenvalue.
    pub weakest: WeakDirection,
    /// Motions in the nullspace, weakest first; empty if all six are determined. Along them the result is the start.
    pub undetermined: Vec<WeakDirection>,
}

/// A motion of unit length in the six scaled unknowns, in the target's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeakDirection {
    /// RMS residual caused by 1 mm of it, mm.
    pub residual_per_mm: f64,
    /// Its shift along x, y, z, as a share of 1 mm.
    pub translation: [f64; 3],
    /// Its turn times `lever_arm_mm`, about x, y, z through the centroid.
    pub rotation: [f64; 3],
}

impl Observability {
    /// The observability at `state`, from `h`, the `JᵀJ / n` along the target's normals, if known. Motions of a small
    /// eigenvalue are probed: theirs is the growth of the cost when the source is moved along them.
    pub(super) fn at(
        surface: &VisibleSurface<'_>,
        pairing: &dyn Pairing,
        params: &IcpParams,
        source: &PreparedSource,
        state: &State,
        mut weights: Weights,
        h: Option<Matrix6<f64>>,
    ) -> Self {
        let every = (source.points.len() / PROBED).max(1);
        let problem: Problem<'_, PointToPlane> =
            Problem::new(surface, pairing, params, every as u32, source.every(every), None);
        let mut correspondences = problem.correspondences();
        let mut cost_and_h = |state: &State| {
            let equations = problem.linearize(state, &mut correspondences, &mut weights, false).ok()?;
            Some((problem.mean_cost(&equations), equations.h / equations.weight))
        };
        let h = match h {
            Some(h) => h,
            None => cost_and_h(state).map_or_else(Matrix6::zeros, |(_, h)| h),
        };
        let (mut values, vectors) = sorted_eigen(&h);
        let doubt_per_mm = surface.index.cell_mm() / BONE_RADIUS_MM;
        let doubtful = |value: f64| (FREE_PER_MM..doubt_per_mm).contains(&value.max(0.0).sqrt());
        if !values.iter().any(|v| doubtful(*v)) {
            return Self::new(&h, source.lever_arm_mm);
        }
        for k in (0..6).filter(|&k| doubtful(values[k])).collect::<Vec<_>>() {
            let mut cost = |length_mm: f64| {
                let motion: Vector6<f64> = vectors.column(k) * length_mm;
                cost_and_h(&state.screwed(&motion, source.lever_arm_mm)).map(|(cost, _)| cost)
            };
            if let (Some(before), Some(here), Some(after)) = (cost(-PROBE_MM), cost(0.0), cost(PROBE_MM)) {
                let curvature = ((before + after) / 2.0 - here) / (PROBE_MM * PROBE_MM);
                values[k] = values[k].min(curvature.max(0.0));
            }
        }
        Self::new(&(vectors * Matrix6::from_diagonal(&values) * vectors.transpose()), source.lever_arm_mm)
    }

    /// From `JᵀJ / n` along the normals, unknowns `(shift, turn · lever arm)`.
    fn new(h: &Matrix6<f64>, lever_arm_mm: f64) -> Self {
        let (values, vectors) = sorted_eigen(h);
        let direction = |k: usize| {
            let v = with_sign(vectors.column(k).into_owned());
            WeakDirection {
                residual_per_mm: values[k].max(0.0).sqrt(),
                translation: [v[0], v[1], v[2]],
                rotation: [v[3], v[4], v[5]],
            }
        };
        let free = |k: &usize| values[*k].max(0.0).sqrt() < FREE_PER_MM;
        Self {
            eigenvalues: values.map(|v| v.max(0.0)).into(),
            condition: Some(values[0] / values[5]).filter(|c| c.is_finite() && *c > 0.0),
            lever_arm_mm,
            weakest: direction(5),
            undetermined: (0..6).rev().filter(free).map(direction).collect(),
        }
    }
}

/// Eigenvalues, largest first, and their eigenvectors as columns.
pub(super) fn sorted_eigen(matrix: &Matrix6<f64>) -> (Vector6<f64>, Matrix6<f64>) {
    let eigen = matrix.symmetric_eigen();
    let mut order = [0, 1, 2, 3, 4, 5];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]).then(a.cmp(&b)));
    let values = Vector6::from_fn(|k, _| eigen.eigenvalues[order[k]]);
    let vectors = Matrix6::from_fn(|row, k| eigen.eigenvectors[(row, order[k])]);
    (values, vectors)
}

/// An eigenvector with the sign that makes its largest component positive.
fn with_sign(v: Vector6<f64>) -> Vector6<f64> {
    let largest = v.iamax();
    if v[largest] < 0.0 { -v } else { v }
}
