//! Pose, field and all causes, fitted to a scan at once.

use super::axes::Axes;
use super::cause::{Mode, Spot};
use super::field::{Field, N_FIELD};
use crate::product::gram;
use crate::target::Target;
use crate::trust::surface_error::CELL_MM;
use crate::trust::{Residual, SurfaceError};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Number of unknowns before the causes': a shift, a turn, and the field.
pub(super) const N_BEFORE: usize = 6 + N_FIELD;

/// Pairs are searched within this distance, mm.
pub(super) const REACH_MM: f64 = 6.0;

/// Residuals beyond this many robust standard deviations have no weight.
const GATE_SIGMAS: f64 = 4.0;

/// Residuals from this many on are of points that a fit leaves out.
const FAR_SIGMAS: f64 = 3.0;

/// The least such gate of the first steps where all may be at fault, mm: a part that is displaced by millimetres is found again before the gate
/// closes.
pub(super) const GATES_MM: [f64; 5] = [2.5, 1.8, 1.2, 0.8, 0.5];

/// Largest number of steps.
const MAX_STEPS: usize = 12;

/// Number of residuals that say as much as one that is independent, for the weight of the priors while it is fitted.
const N_TOGETHER: f64 = 10.0;

/// The least standard deviation of residuals beyond the sensor's noise, mm: no surface of a segmentation is truer.
const SURFACE_MM: f64 = 0.05;

/// A fit ends where no point moves farther in a step, mm.
const STEP_MM: f64 = 0.01;

/// The least edge of the cells whose residuals count as one draw, mm: some points of the scan are in each.
const MIN_CELL_MM: f64 = 4.0;

/// Variances over those that the residuals tell beyond the sensor's noise: errors of camera and CT that are in no family, such as the steps of
/// voxels, are in none of the residuals. With 8 four of 40 simulated sound scans, from any side and of any part of a fibula, are doubted, with 5
/// ten are.
const UNMODELLED: f64 = 8.0;

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
    /// The causes' modes.
    pub(super) modes: &'a [Mode],
    /// The sensor's noise, mm.
    pub(super) noise_mm: f64,
}

/// What a scan says of pose, field and causes, to first order about where they fit together.
pub(super) struct Information {
    /// Weighted products of the unknowns' columns, and of the columns with the distances that they are to explain, in residuals that are
    /// independent and have a variance of 1.
    pub(super) matrix: DMatrix<f64>,
    pub(super) vector: DVector<f64>,
    /// Share of the scan that is left out there, though the surface is near.
    pub(super) left_out: f64,
    /// How the pose of a registration answers to each cause: a shift and a turn about the centre.
    pub(super) response: DMatrix<f64>,
}

/// Where a fit has come to.
pub(super) struct Fit {
    /// The unknowns: shift and turn about the centroid, the field's amplitudes, the causes' parameters.
    pub(super) at: DVector<f64>,
    /// The surface's normal at each point's last pair.
    normals: Vec<Vector3<f64>>,
    /// Robust standard deviation of the residuals where it is first looked at, and variance of those that are independent, mm².
    sigma_mm: f64,
    variance: f64,
}

impl Fit {
    fn motion(&self) -> Isometry3<f64> {
        let of = |first: usize| Vector3::from_column_slice(&self.at.as_slice()[first..first + 3]);
        Isometry3::from_parts(Translation3::from(of(0)), UnitQuaternion::from_scaled_axis(of(3)))
    }

    fn keep_normals(&mut self, step: &Step) {
        for (normal, pair) in self.normals.iter_mut().zip(&step.pairs) {
            *normal = pair.as_ref().map_or(*normal, |pair| pair.normal);
        }
    }
}

/// A point of the scan with the surface nearest to it.
#[derive(Debug, Clone)]
struct Pair {
    /// Where the fit puts it.
    point: Point3<f64>,
    /// The surface's normal.
    normal: Vector3<f64>,
    /// How far it lies inside the surface, mm.
    residual_mm: f64,
}

/// A step of a fit.
struct Step {
    pairs: Vec<Option<Pair>>,
    /// A row for each point.
    rows: DMatrix<f64>,
    weights: Vec<f64>,
    sigma_mm: f64,
}

impl Problem<'_> {
    /// Fits pose, field and causes, whose standard deviations are `sds`, from the registration on, with pairs and weights found anew in each
    /// step from all points; the first steps reach as far as these gates, mm.
    ///
    /// `None` where the points leave the pose undetermined.
    pub(super) fn fit(&self, sds: &[f64], gates_mm: &[f64]) -> Option<Fit> {
        let n = N_BEFORE + self.modes.len();
        let mut fit = Fit {
            at: DVector::zeros(n),
            normals: vec![Vector3::zeros(); self.points.len()],
            sigma_mm: 1.0,
            variance: 1.0,
        };
        for n in 0..MAX_STEPS {
            let step = self.step(&fit, gates_mm.get(n).copied().unwrap_or(0.0));
            let (mut h, b) = step.normal_equations();
            let prior = self.prior(sds, N_TOGETHER * step.sigma_mm.max(SURFACE_MM).powi(2));
            (0..h.nrows()).for_each(|k| h[(k, k)] += prior[k]);
            let delta = h.cholesky()?.solve(&(&b - prior.component_mul(&fit.at)));
            if !delta.iter().all(|value| value.is_finite()) {
                return None;
            }
            let moved_mm = (&step.rows * &delta).amax();
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(delta[3], delta[4], delta[5]));
            let turned = (turn * fit.motion().rotation).scaled_axis();
            fit.at += delta;
            fit.at.rows_mut(3, 3).copy_from(&turned);
            fit.keep_normals(&step);
            if n >= gates_mm.len() && moved_mm < STEP_MM {
                break;
            }
        }
        Some(fit)
    }

    /// What the scan says about a fit, whose unknowns are replaced by `at` if given. What is independent is counted where it is not.
    pub(super) fn look(&self, fit: &mut Fit, at: Option<DVector<f64>>) -> Option<Information> {
        let is_first = at.is_none();
        if let Some(at) = at {
            fit.at = at;
        }
        let step = self.step(fit, 0.0);
        fit.keep_normals(&step);
        let (h, b) = step.normal_equations();
        let far_mm = FAR_SIGMAS * if is_first { step.sigma_mm } else { fit.sigma_mm };
        if is_first {
            fit.sigma_mm = step.sigma_mm;
            let [noise, all] = [self.noise_mm, step.sigma_mm].map(|mm| mm.powi(2));
            // Noise that hides a surface's own error does not make it less.
            let variance = (noise + UNMODELLED * (all - noise)).max(UNMODELLED * all.min(SURFACE_MM.powi(2)));
            // With too few cells nothing is known of what is independent: the priors are left.
            fit.variance = self.together(&step, &h).unwrap_or(f64::INFINITY) * variance;
        }
        let is_out = |pair: &&Option<Pair>| pair.as_ref().is_some_and(|p| p.residual_mm.abs() >= far_mm);
        let left_out = step.pairs.iter().filter(is_out).count() as f64 / step.pairs.len().max(1) as f64;
        self.information(h, b, left_out, fit)
    }

    /// Pairs, rows and weights at a fit.
    fn step(&self, fit: &Fit, gate_mm: f64) -> Step {
        let (centre, motion, at) = (self.axes.centre, fit.motion(), &fit.at);
        let (field_mm, values) = (&at.as_slice()[6..N_BEFORE], &at.as_slice()[N_BEFORE..]);
        let towards = self.axes.towards;
        let n = at.len();
        let pair = |((index, p), last): ((usize, &Point3<f64>), &Vector3<f64>)| {
            let shifts = self.modes.iter().zip(values).filter(|(mode, value)| **value != 0.0 && mode.moves_scan());
            let spot = Spot::new(self.axes, *p, *last);
            let shifts: Vector3<f64> = shifts.map(|(mode, value)| mode.at(self.axes, &spot) * *value).sum();
            let warped = p + shifts + self.field.displacement(index, &towards, field_mm);
            let point = centre + motion.rotation * (warped - centre) + motion.translation.vector;
            let mut row = vec![0.0; n];
            let found = self.target.nearest(&point, REACH_MM).map(|(nearest, _)| {
                let normal = self.normals[nearest];
                let turn = (point - centre).cross(&normal);
                row[..3].copy_from_slice(normal.as_slice());
                row[3..6].copy_from_slice(turn.as_slice());
                let facing = normal.dot(&(motion.rotation * towards));
                row[6..N_BEFORE].iter_mut().zip(self.field.at(index)).for_each(|(of, wave)| *of = facing * wave);
                let back = motion.rotation.inverse() * normal;
                let spot = Spot::new(self.axes, *p, normal);
                for (of, mode) in row[N_BEFORE..].iter_mut().zip(self.modes).filter(|(_, mode)| mode.moves_scan()) {
                    *of = back.dot(&mode.at(self.axes, &spot));
                }
                let residual_mm = (self.target.points()[nearest] - point).dot(&normal);
                Pair { point, normal, residual_mm }
            });
            (found, row)
        };
        let found: Vec<(Option<Pair>, Vec<f64>)> =
            self.points.par_iter().enumerate().zip(fit.normals.par_iter()).map(pair).collect();
        let rows = DMatrix::from_row_iterator(found.len(), n, found.iter().flat_map(|(_, row)| row.iter().copied()));
        let pairs: Vec<Option<Pair>> = found.into_iter().map(|(pair, _)| pair).collect();
        let sigma_mm = self.sigma_mm(&pairs);
        let gate_mm = (GATE_SIGMAS * sigma_mm).max(gate_mm);
        let weights = pairs.iter().map(|pair| pair.as_ref().map_or(0.0, |p| weight(p.residual_mm, gate_mm))).collect();
        Step { pairs, rows, weights, sigma_mm }
    }

    /// What the priors say of the unknowns, in residuals of this variance.
    fn prior(&self, sds: &[f64], variance: f64) -> DVector<f64> {
        let sds = self.field.sds_mm.iter().chain(sds).map(|sd| variance / (sd * sd));
        DVector::from_iterator(N_BEFORE + self.modes.len(), std::iter::repeat_n(0.0, 6).chain(sds))
    }

    /// Robust standard deviation of the residuals, mm: from the quarter that is nearest, so that tissue may be on half of the scan; of those
    /// within the gate that follows, so that it is a quarter of the bone's.
    fn sigma_mm(&self, pairs: &[Option<Pair>]) -> f64 {
        let mut sizes: Vec<f64> = pairs.iter().flatten().map(|pair| pair.residual_mm.abs()).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        let of_quarter =
            |n: usize| sizes.get(n / 4).or(sizes.last()).map_or(self.noise_mm, |size| size / QUARTER_SIGMAS);
        let gate_mm = FAR_SIGMAS * of_quarter(pairs.len());
        of_quarter(sizes.partition_point(|size| *size < gate_mm)).max(self.noise_mm)
    }

    /// What the normal equations of a fit say, with residuals counted as many as are independent.
    fn information(&self, h: DMatrix<f64>, b: DVector<f64>, left_out: f64, fit: &Fit) -> Option<Information> {
        let pose = h.view((0, 0), (6, 6)).into_owned().cholesky()?;
        let response = -pose.solve(&h.view((0, N_BEFORE), (6, self.modes.len())).into_owned());
        let (mut vector, mut matrix) = (b + &h * &fit.at, h);
        for (k, response) in response.column_iter().enumerate().filter(|(k, _)| self.modes[*k].is_as_pose()) {
            let column = -matrix.columns(0, 6) * response;
            let k = N_BEFORE + k;
            vector[k] = -vector.rows(0, 6).dot(&response);
            matrix.column_mut(k).copy_from(&column);
            matrix.row_mut(k).copy_from(&column.transpose());
            matrix[(k, k)] = -column.rows(0, 6).dot(&response);
        }
        Some(Information { vector: vector / fit.variance, matrix: matrix / fit.variance, left_out, response })
    }

    /// Number of residuals that say as much as one that is independent.
    ///
    /// # Source
    /// White 1980; Liang and Zeger 1986: the variance of the pose's scores summed over cells.
    fn together(&self, step: &Step, h: &DMatrix<f64>) -> Option<f64> {
        let left: Vec<Residual> = step.left();
        let cell_mm = SurfaceError::new(&left).cell_mm(MIN_CELL_MM).min(CELL_MM);
        let mut before = h.view((0, 0), (N_BEFORE, N_BEFORE)).into_owned();
        let prior = self.prior(&vec![1.0; self.modes.len()], N_TOGETHER * step.sigma_mm.max(SURFACE_MM).powi(2));
        (0..N_BEFORE).for_each(|k| before[(k, k)] += prior[k]);
        let inverse = before.cholesky()?.inverse();
        let mut cells: BTreeMap<[i64; 3], DVector<f64>> = BTreeMap::new();
        for ((pair, weight), row) in step.pairs.iter().zip(&step.weights).zip(step.rows.row_iter()) {
            let Some(pair) = pair else { continue };
            let key = std::array::from_fn(|k| ((pair.point[k] - self.axes.centre[k]) / cell_mm).floor() as i64);
            let score = row.columns(0, N_BEFORE).transpose() * (weight * pair.residual_mm);
            *cells.entry(key).or_insert_with(|| DVector::zeros(N_BEFORE)) += score;
        }
        let n_determined = N_BEFORE as f64 - inverse.diagonal().dot(&prior.rows(0, N_BEFORE));
        let n_cells = cells.len() as f64;
        // Of as few cells as unknowns, one is left to tell it.
        let correction = (n_cells > 7.0).then(|| n_cells / (n_cells - n_determined).max(1.0))?;
        let mut variances = DVector::zeros(6);
        for score in cells.values() {
            let moved = inverse.rows(0, 6) * score;
            variances += moved.component_mul(&moved);
        }
        let ratio = (0..6).map(|k| variances[k] / inverse[(k, k)]).sum::<f64>() / 6.0;
        Some((correction * ratio / step.sigma_mm.powi(2)).max(1.0))
    }
}

impl Step {
    /// Normal matrix and right-hand side.
    fn normal_equations(&self) -> (DMatrix<f64>, DVector<f64>) {
        let mut weighted = self.rows.clone();
        weighted.row_iter_mut().zip(&self.weights).for_each(|(mut row, weight)| row *= weight.sqrt());
        let residuals = self.pairs.iter().map(|pair| pair.as_ref().map_or(0.0, |pair| pair.residual_mm));
        let residuals = residuals.zip(&self.weights).map(|(mm, weight)| mm * weight.sqrt());
        let residuals = DVector::from_iterator(self.pairs.len(), residuals);
        (gram(&weighted), weighted.tr_mul(&residuals))
    }

    /// The residuals of the pairs that have weight.
    fn left(&self) -> Vec<Residual> {
        let pairs = self.pairs.iter().zip(&self.weights).filter(|(_, weight)| **weight > 0.0);
        let left = |pair: &Pair| Residual {
            point: pair.point,
            normal: pair.normal,
            signed_mm: -pair.residual_mm,
            aside_mm: 0.0,
        };
        pairs.filter_map(|(pair, _)| pair.as_ref().map(left)).collect()
    }
}

/// Tukey's weight.
fn weight(residual_mm: f64, gate_mm: f64) -> f64 {
    let u = residual_mm / gate_mm;
    if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
}
