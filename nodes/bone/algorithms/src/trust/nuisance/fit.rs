//! The pose and a few numbers more, fitted to a scan.

use super::cause::{Axes, Mode};
use crate::target::Target;
use nalgebra::{Isometry3, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Number of unknowns: a shift, a turn, and at most four numbers more.
pub(super) const N: usize = 10;

pub(super) type Normal = SMatrix<f64, N, N>;
pub(super) type Row = SVector<f64, N>;

/// Pairs are searched within this distance, mm.
pub(super) const REACH_MM: f64 = 6.0;

/// Residuals beyond this many robust standard deviations have no weight.
const GATE_SIGMAS: f64 = 4.0;

/// The least such gate of the first steps, mm: a part that is displaced by millimetres is found again before the gate closes.
const GATES_MM: [f64; 5] = [2.5, 1.8, 1.2, 0.8, 0.5];

/// Largest number of steps of a first look, which tells a cause that is there from one that is not.
pub(super) const LOOK: usize = 10;

/// Largest number of steps of a fit whose size is told: a shear slides along a shaft, slowly.
pub(super) const THOROUGH: usize = 100;

/// Number of residuals that say as much as one that is independent, for the weight of a prior.
const N_TOGETHER: f64 = 5.0;

/// A fit ends where no point moves farther in a step, mm.
const STEP_MM: f64 = 0.001;

/// A quarter of a Gaussian's absolute values are below this many standard deviations.
const QUARTER_SIGMAS: f64 = 0.318_639_363_964_375_15;

/// The scan and the surface that a fit begins from.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a> {
    pub(super) target: &'a Target,
    /// Normals of the target's points.
    pub(super) normals: &'a [Vector3<f64>],
    /// The examined points of the scan at the registration, target's frame.
    pub(super) points: &'a [Point3<f64>],
    pub(super) axes: &'a Axes,
    /// The sensor's noise, mm.
    pub(super) noise_mm: f64,
    /// Edge of the cells whose residuals count as one draw, mm.
    pub(super) cell_mm: f64,
}

/// A fitted pose with the parameters of some modes.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    /// The motion from the registration to the fitted pose, about the centroid.
    pub(super) motion: Isometry3<f64>,
    /// The parameters.
    pub(super) values: Vec<f64>,
    /// Robust standard deviation of the residuals, mm.
    pub(super) sigma_mm: f64,
    /// Residuals beyond this have no weight, mm.
    pub(super) gate_mm: f64,
    /// The pairs of all points with the residuals that are left; none where the surface is out of reach.
    pub(super) pairs: Vec<Option<Pair>>,
}

/// A point of the scan with the surface nearest to it.
#[derive(Debug, Clone)]
pub(super) struct Pair {
    /// Where the registration puts it, target's frame.
    registered: Point3<f64>,
    /// Where the fit puts it.
    point: Point3<f64>,
    /// The surface's normal.
    normal: Vector3<f64>,
    /// How far it lies inside the surface, mm.
    residual_mm: f64,
}

impl Problem<'_> {
    /// Fits the pose and the modes, from the registration on, with pairs and weights found anew in each step from all points.
    /// The last modes have priors of these standard deviations.
    ///
    /// `None` where the points leave one of them undetermined.
    pub(super) fn fit(&self, modes: &[Mode], priors: &[f64], max_steps: usize) -> Option<Fit> {
        let first_prior = 6 + modes.len() - priors.len();
        let (mut motion, mut values) = (Isometry3::identity(), vec![0.0; modes.len()]);
        let mut normals = vec![Vector3::zeros(); self.points.len()];
        for step in 0.. {
            let pairs = self.pairs(modes, &motion, &values, &normals);
            let sigma_mm = self.sigma_mm(&pairs);
            let gate_mm = (GATE_SIGMAS * sigma_mm).max(GATES_MM.get(step).copied().unwrap_or(0.0));
            let rows = self.rows(&pairs, modes, &motion);
            let (mut h, mut b) = normal_equations(&pairs, &rows, gate_mm, 6 + modes.len());
            for (k, sd) in priors.iter().enumerate() {
                // The residuals of a neighbourhood count as one.
                let information = N_TOGETHER * (sigma_mm / sd).powi(2);
                h[(first_prior + k, first_prior + k)] += information;
                b[first_prior + k] -= information * values[first_prior - 6 + k];
            }
            let delta = h.cholesky()?.solve(&b);
            if !delta.iter().all(|value| value.is_finite()) {
                return None;
            }
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(delta[3], delta[4], delta[5]));
            let shift = Translation3::new(delta[0], delta[1], delta[2]);
            motion = Isometry3::from_parts(shift * motion.translation, turn * motion.rotation);
            values.iter_mut().zip(delta.iter().skip(6)).for_each(|(value, delta)| *value += delta);
            for (normal, pair) in normals.iter_mut().zip(&pairs) {
                *normal = pair.as_ref().map_or(*normal, |pair| pair.normal);
            }
            let moved_mm = rows.iter().map(|row| row.dot(&delta).abs()).fold(0.0, f64::max);
            if step + 1 == max_steps || (step >= GATES_MM.len() && moved_mm < STEP_MM) {
                let mut left = pairs.clone();
                for (pair, row) in left.iter_mut().zip(&rows) {
                    pair.iter_mut().for_each(|pair| pair.residual_mm -= row.dot(&delta));
                }
                return Some(Fit { motion, values, sigma_mm, gate_mm, pairs: left });
            }
        }
        None
    }

    /// The pairs at a pose with the modes' parameters; none where the surface is out of reach. `normals` are those of the last
    /// pairs.
    fn pairs(
        &self,
        modes: &[Mode],
        motion: &Isometry3<f64>,
        values: &[f64],
        normals: &[Vector3<f64>],
    ) -> Vec<Option<Pair>> {
        let centre = self.axes.centre;
        let pair = |(p, normal): (&Point3<f64>, &Vector3<f64>)| {
            let shifts = modes.iter().zip(values).map(|(mode, value)| mode.at(self.axes, p, normal) * *value);
            let warped = p + shifts.sum::<Vector3<f64>>();
            let point = centre + motion.rotation * (warped - centre) + motion.translation.vector;
            let (index, _) = self.target.nearest(&point, REACH_MM)?;
            let normal = self.normals[index];
            let residual_mm = (self.target.points()[index] - point).dot(&normal);
            Some(Pair { registered: *p, point, normal, residual_mm })
        };
        self.points.par_iter().zip(normals.par_iter()).map(pair).collect()
    }

    /// How far each point moves along its pair's normal with each unknown.
    fn rows(&self, pairs: &[Option<Pair>], modes: &[Mode], motion: &Isometry3<f64>) -> Vec<Row> {
        let row = |pair: &Option<Pair>| {
            let mut row = Row::zeros();
            if let Some(pair) = pair {
                row.fixed_rows_mut::<6>(0).copy_from(&self.rigid_row(pair));
                for (k, mode) in modes.iter().enumerate() {
                    row[6 + k] = self.response(pair, mode, motion);
                }
            }
            row
        };
        pairs.iter().map(row).collect()
    }

    /// How far the point of a pair moves along its normal with shift and turn about the centroid.
    pub(super) fn rigid_row(&self, pair: &Pair) -> Vector6<f64> {
        let (n, turn) = (pair.normal, (pair.point - self.axes.centre).cross(&pair.normal));
        Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z)
    }

    /// How far the point of a pair moves along its normal with a mode.
    pub(super) fn response(&self, pair: &Pair, mode: &Mode, motion: &Isometry3<f64>) -> f64 {
        pair.normal.dot(&(motion.rotation * mode.at(self.axes, &pair.registered, &pair.normal)))
    }

    /// Robust standard deviation of the residuals, mm: from the quarter that is nearest, so that tissue may be on half of the scan.
    fn sigma_mm(&self, pairs: &[Option<Pair>]) -> f64 {
        let mut sizes: Vec<f64> = pairs.iter().flatten().map(|pair| pair.residual_mm.abs()).collect();
        if sizes.is_empty() {
            return self.noise_mm;
        }
        let at = pairs.len() / 4;
        let at = at.min(sizes.len() - 1);
        let (_, quarter, _) = sizes.select_nth_unstable_by(at, f64::total_cmp);
        (*quarter / QUARTER_SIGMAS).max(self.noise_mm)
    }

    /// Covariance of the unknowns of a fit, with the residuals of one cell taken for one draw; `None` with too few cells.
    ///
    /// # Source
    /// White 1980; Liang and Zeger 1986, with the correction for the number of cells.
    pub(super) fn covariance(&self, fit: &Fit, modes: &[Mode]) -> Option<Normal> {
        let n = 6 + modes.len();
        let rows = self.rows(&fit.pairs, modes, &fit.motion);
        let (h, _) = normal_equations(&fit.pairs, &rows, fit.gate_mm, n);
        let mut cells: BTreeMap<[i64; 3], Row> = BTreeMap::new();
        for (pair, row) in fit.pairs.iter().zip(&rows) {
            let Some(pair) = pair else { continue };
            let key = std::array::from_fn(|k| ((pair.point[k] - self.axes.centre[k]) / self.cell_mm).floor() as i64);
            *cells.entry(key).or_insert_with(Row::zeros) += row * (fit.weight(pair) * pair.residual_mm);
        }
        let scores: Normal = cells.values().map(|score| score * score.transpose()).sum();
        let n_cells = cells.len();
        let inverse = h.cholesky()?.inverse();
        (n_cells > n).then(|| inverse * scores * inverse * (n_cells as f64 / (n_cells - n) as f64))
    }
}

impl Fit {
    /// Weight of a pair.
    pub(super) fn weight(&self, pair: &Pair) -> f64 {
        weight(pair.residual_mm, self.gate_mm)
    }

    /// Sum over all points of the squares of the residuals, each at most `cap_mm`².
    pub(super) fn squares(&self, cap_mm: f64) -> f64 {
        let square =
            |pair: &Option<Pair>| pair.as_ref().map_or(cap_mm, |pair| pair.residual_mm.abs().min(cap_mm)).powi(2);
        self.pairs.iter().map(square).sum()
    }
}

/// Tukey's weight.
fn weight(residual_mm: f64, gate_mm: f64) -> f64 {
    let u = residual_mm / gate_mm;
    if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
}

/// Normal matrix and right-hand side; unknowns beyond the first `n` are held at zero.
fn normal_equations(pairs: &[Option<Pair>], rows: &[Row], gate_mm: f64, n: usize) -> (Normal, Row) {
    let (mut h, mut b) = (Normal::zeros(), Row::zeros());
    for (pair, row) in pairs.iter().zip(rows) {
        let Some(pair) = pair else { continue };
        let weighted = row * weight(pair.residual_mm, gate_mm);
        h += weighted * row.transpose();
        b += weighted * pair.residual_mm;
    }
    (n..N).for_each(|k| h[(k, k)] = 1.0);
    (h, b)
}

/// Shift and turn of a motion about the centroid.
pub(super) fn twist(motion: &Isometry3<f64>) -> Vector6<f64> {
    let (shift, turn) = (motion.translation.vector, motion.rotation.scaled_axis());
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}
