//! The pose and a few numbers more, fitted to a scan.

use super::cause::{Axes, Mode};
use super::field::{Field, N_FIELD};
use crate::target::Target;
use crate::trust::Residual;
use nalgebra::{Isometry3, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3, Vector6};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Number of unknowns: a shift, a turn, the field, and at most two numbers more.
pub(super) const N: usize = N_BEFORE + 2;

/// Number of unknowns that every fit has.
pub(super) const N_BEFORE: usize = 6 + N_FIELD;

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

/// Number of residuals that say as much as one that is independent, for the weight of a prior. 10: so much more the pose varies in
/// simulated scans, beside such a field, than with independent residuals.
const N_TOGETHER: f64 = 10.0;

/// The least standard deviation of residuals for the weight of a prior, mm: no surface of a segmentation is truer.
const SURFACE_MM: f64 = 0.05;

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
    pub(super) field: &'a Field,
    /// The sensor's noise, mm.
    pub(super) noise_mm: f64,
}

/// What a fit has reached.
struct Unknowns {
    motion: Isometry3<f64>,
    values: Vec<f64>,
    field_mm: [f64; N_FIELD],
}

impl Unknowns {
    /// The field's amplitudes among the unknowns.
    fn row(&self) -> Row {
        field(|k| self.field_mm[k])
    }

    fn add(&mut self, delta: &Row) {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(delta[3], delta[4], delta[5]));
        let shift = Translation3::new(delta[0], delta[1], delta[2]);
        self.motion = Isometry3::from_parts(shift * self.motion.translation, turn * self.motion.rotation);
        self.field_mm.iter_mut().zip(delta.iter().skip(6)).for_each(|(value, delta)| *value += delta);
        self.values.iter_mut().zip(delta.iter().skip(N_BEFORE)).for_each(|(value, delta)| *value += delta);
    }
}

/// A fitted pose with the parameters of some modes.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    /// The motion from the registration to the fitted pose, about the centroid.
    pub(super) motion: Isometry3<f64>,
    /// The parameters.
    pub(super) values: Vec<f64>,
    /// The amplitudes of the field, mm.
    pub(super) field_mm: [f64; N_FIELD],
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
    /// Fits the pose, the field and the modes, from the registration on, with pairs and weights found anew in each step from
    /// all points. `field_sds_mm` are the priors of the field's amplitudes.
    ///
    /// `None` where the points leave one of them undetermined.
    pub(super) fn fit(&self, modes: &[Mode], field_sds_mm: &[f64; N_FIELD], max_steps: usize) -> Option<Fit> {
        let (values, field_mm) = (vec![0.0; modes.len()], [0.0; N_FIELD]);
        let mut at = Unknowns { motion: Isometry3::identity(), values, field_mm };
        let mut normals = vec![Vector3::zeros(); self.points.len()];
        for step in 0.. {
            let pairs = self.pairs(modes, &at, &normals);
            let sigma_mm = self.sigma_mm(&pairs);
            let gate_mm = (GATE_SIGMAS * sigma_mm).max(GATES_MM.get(step).copied().unwrap_or(0.0));
            let rows = self.rows(&pairs, modes, &at.motion);
            let (mut h, mut b) = normal_equations(&pairs, &rows, gate_mm, N_BEFORE + modes.len());
            let prior = prior(field_sds_mm, sigma_mm);
            h += Normal::from_diagonal(&prior);
            b -= prior.component_mul(&at.row());
            let delta = h.cholesky()?.solve(&b);
            if !delta.iter().all(|value| value.is_finite()) {
                return None;
            }
            at.add(&delta);
            for (normal, pair) in normals.iter_mut().zip(&pairs) {
                *normal = pair.as_ref().map_or(*normal, |pair| pair.normal);
            }
            let moved_mm = rows.iter().map(|row| row.dot(&delta).abs()).fold(0.0, f64::max);
            if step + 1 == max_steps || (step >= GATES_MM.len() && moved_mm < STEP_MM) {
                let mut left = pairs.clone();
                for (pair, row) in left.iter_mut().zip(&rows) {
                    pair.iter_mut().for_each(|pair| pair.residual_mm -= row.dot(&delta));
                }
                let Unknowns { motion, values, field_mm } = at;
                return Some(Fit { motion, values, field_mm, sigma_mm, gate_mm, pairs: left });
            }
        }
        None
    }

    /// The pairs at a pose with the field and the modes' parameters; none where the surface is out of reach. `normals` are those of
    /// the last pairs.
    fn pairs(&self, modes: &[Mode], at: &Unknowns, normals: &[Vector3<f64>]) -> Vec<Option<Pair>> {
        let centre = self.axes.centre;
        let pair = |((index, p), normal): ((usize, &Point3<f64>), &Vector3<f64>)| {
            let shifts = modes.iter().zip(&at.values).map(|(mode, value)| mode.at(self.axes, p, normal) * *value);
            let field = self.field.displacement(index, &self.axes.towards, normal, &at.field_mm);
            let warped = p + shifts.sum::<Vector3<f64>>() + field;
            let point = centre + at.motion.rotation * (warped - centre) + at.motion.translation.vector;
            let (nearest, _) = self.target.nearest(&point, REACH_MM)?;
            let normal = self.normals[nearest];
            let residual_mm = (self.target.points()[nearest] - point).dot(&normal);
            Some(Pair { registered: *p, point, normal, residual_mm })
        };
        self.points.par_iter().enumerate().zip(normals.par_iter()).map(pair).collect()
    }

    /// How far each point moves along its pair's normal with each unknown.
    fn rows(&self, pairs: &[Option<Pair>], modes: &[Mode], motion: &Isometry3<f64>) -> Vec<Row> {
        let row = |(index, pair): (usize, &Option<Pair>)| {
            let mut row = Row::zeros();
            if let Some(pair) = pair {
                row.fixed_rows_mut::<N_BEFORE>(0).copy_from(&self.row_before(index, pair, motion));
                for (k, mode) in modes.iter().enumerate() {
                    row[N_BEFORE + k] = self.response(pair, mode, motion);
                }
            }
            row
        };
        pairs.iter().enumerate().map(row).collect()
    }

    /// How far the point of a pair moves along its normal with shift and turn about the centroid, and with the field's amplitudes.
    pub(super) fn row_before(&self, index: usize, pair: &Pair, motion: &Isometry3<f64>) -> SVector<f64, N_BEFORE> {
        let (n, turn) = (pair.normal, (pair.point - self.axes.centre).cross(&pair.normal));
        let facing = n.dot(&(motion.rotation * self.axes.towards));
        let along = n.dot(&(motion.rotation * n));
        SVector::from_iterator(n.iter().chain(&turn).copied().chain(self.field.at(index, facing, along)))
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

    /// Covariance of the unknowns of a fit, with the residuals of one cell of `cell_mm` taken for one draw; `None` with too few cells.
    ///
    /// # Source
    /// White 1980; Liang and Zeger 1986, with the correction for the number of cells.
    pub(super) fn covariance(
        &self,
        fit: &Fit,
        modes: &[Mode],
        field_sds_mm: &[f64; N_FIELD],
        cell_mm: f64,
    ) -> Option<Normal> {
        let n = N_BEFORE + modes.len();
        let rows = self.rows(&fit.pairs, modes, &fit.motion);
        let (mut h, _) = normal_equations(&fit.pairs, &rows, fit.gate_mm, n);
        let prior = prior(field_sds_mm, fit.sigma_mm);
        h += Normal::from_diagonal(&prior);
        let mut cells: BTreeMap<[i64; 3], Row> = BTreeMap::new();
        for (pair, row) in fit.pairs.iter().zip(&rows) {
            let Some(pair) = pair else { continue };
            let key = std::array::from_fn(|k| ((pair.point[k] - self.axes.centre[k]) / cell_mm).floor() as i64);
            *cells.entry(key).or_insert_with(Row::zeros) += row * (fit.weight(pair) * pair.residual_mm);
        }
        let scores: Normal = cells.values().map(|score| score * score.transpose()).sum();
        let inverse = h.cholesky()?.inverse();
        // The prior determines the rest.
        let n_determined = n as f64 - inverse.diagonal().dot(&prior);
        let n_cells = cells.len() as f64;
        let correction = (n_cells > n_determined + 1.0).then(|| n_cells / (n_cells - n_determined))?;
        // What the prior holds back of the field is error, too.
        let held_back = prior.component_mul(&prior).component_mul(&field(|k| field_sds_mm[k].powi(2)));
        Some(inverse * (scores * correction + Normal::from_diagonal(&held_back)) * inverse)
    }
}

impl Fit {
    /// Weight of a pair.
    pub(super) fn weight(&self, pair: &Pair) -> f64 {
        weight(pair.residual_mm, self.gate_mm)
    }

    /// The residuals of the pairs that have weight.
    pub(super) fn left(&self) -> Vec<Residual> {
        let pairs = self.pairs.iter().flatten().filter(|pair| self.weight(pair) > 0.0);
        let left = |pair: &Pair| Residual {
            point: pair.point,
            normal: pair.normal,
            signed_mm: -pair.residual_mm,
            aside_mm: 0.0,
        };
        pairs.map(left).collect()
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

/// A row of the unknowns with these values for the field's amplitudes.
fn field(of: impl Fn(usize) -> f64) -> Row {
    Row::from_fn(|k, _| if (6..N_BEFORE).contains(&k) { of(k - 6) } else { 0.0 })
}

/// What the priors of the field's amplitudes say of them, in residuals.
pub(super) fn prior(field_sds_mm: &[f64; N_FIELD], sigma_mm: f64) -> Row {
    field(|k| N_TOGETHER * (sigma_mm.max(SURFACE_MM) / field_sds_mm[k]).powi(2))
}

/// Lower half of the normal matrix, and right-hand side; unknowns beyond the first `n` are held at zero.
fn normal_equations(pairs: &[Option<Pair>], rows: &[Row], gate_mm: f64, n: usize) -> (Normal, Row) {
    let (mut h, mut b) = (Normal::zeros(), Row::zeros());
    for (pair, row) in pairs.iter().zip(rows) {
        let Some(pair) = pair else { continue };
        let weight = weight(pair.residual_mm, gate_mm);
        if weight == 0.0 {
            continue;
        }
        let weighted = row * weight;
        for k in 0..n {
            let column = &mut h.as_mut_slice()[k * N..k * N + n];
            column[k..].iter_mut().zip(&weighted.as_slice()[k..n]).for_each(|(sum, of)| *sum += of * row[k]);
        }
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
