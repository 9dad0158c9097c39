//! Which motions the pairs of an ICP hold.

use super::acceleration::State;
use super::pairing::Pairing;
use super::params::IcpParams;
use super::problem::Problem;
use super::residual::PointToPlane;
use super::source::Prepared;
use super::surface::Surface;
use super::weights::Weights;
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// Below this RMS residual (mm) for a motion of 1 mm, a motion counts as free: ten millimetres of slide would then
/// hide in a residual of 0.05 mm, the depth noise of the camera.
pub(super) const FREE_PER_MM: f64 = 0.005;

/// The normals of samples beside the foot tell of a hold on any curved surface, even on a ball: by their distance over its
/// radius. What is held by less than a cell of the samples over a bone's radius of so many mm is looked at again by moving
/// the source.
const BONE_RADIUS_MM: f64 = 10.0;

/// How far the source is moved for that, mm: beyond the spacing of the samples, within the shape of the bone.
const PROBE_MM: f64 = 2.0;

/// About so many source points are moved.
const PROBED: usize = 2500;

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
    /// What a pose holds: along the target's normals alone (`hold` is `JᵀJ / n` along them, where known), and where that is
    /// little, by how much the distances from the surface grow when the source is moved.
    pub(super) fn at(
        surface: &Surface<'_>,
        pairing: &dyn Pairing,
        params: &IcpParams,
        source: &Prepared,
        state: &State,
        mut weights: Weights,
        hold: Option<Matrix6<f64>>,
    ) -> Self {
        let every = (source.arms.len() / PROBED).max(1);
        let problem: Problem<'_, PointToPlane> =
            Problem::new(surface, pairing, params, every as u32, source.every(every), None);
        let mut partners = problem.partners();
        let mut energy_and_hold = |state: &State| {
            let sums = problem.pair(state, &mut partners, &mut weights, false).ok()?;
            Some((problem.energy(&sums), sums.hold / sums.weight))
        };
        let hold = match hold {
            Some(hold) => hold,
            None => energy_and_hold(state).map_or_else(Matrix6::zeros, |(_, hold)| hold),
        };
        let (mut values, vectors) = sorted_eigen(&hold);
        let doubt_per_mm = surface.index.cell_mm() / BONE_RADIUS_MM;
        let doubtful = |value: f64| (FREE_PER_MM..doubt_per_mm).contains(&value.max(0.0).sqrt());
        if !values.iter().any(|v| doubtful(*v)) {
            return Self::new(&hold, source.lever_arm_mm);
        }
        for k in (0..6).filter(|&k| doubtful(values[k])).collect::<Vec<_>>() {
            let mut energy = |way_mm: f64| {
                let motion: Vector6<f64> = vectors.column(k) * way_mm;
                energy_and_hold(&state.screwed(&motion, source.lever_arm_mm)).map(|(energy, _)| energy)
            };
            if let (Some(back), Some(here), Some(on)) = (energy(-PROBE_MM), energy(0.0), energy(PROBE_MM)) {
                let rise = ((back + on) / 2.0 - here) / (PROBE_MM * PROBE_MM);
                values[k] = values[k].min(rise.max(0.0));
            }
        }
        Self::new(&(vectors * Matrix6::from_diagonal(&values) * vectors.transpose()), source.lever_arm_mm)
    }

    /// From `JᵀJ / n` along the normals, unknowns `(shift, turn · lever arm)`.
    fn new(hold: &Matrix6<f64>, lever_arm_mm: f64) -> Self {
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
            eigenvalues: values.map(|v| v.max(0.0)).into(),
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
