//! The causes of one registration, fitted and compared.

use super::cause::{Cause, Mode};
use super::effect::{Effect, error_at};
use super::field::{self, N_FIELD};
use super::fit::{self, Fit, N_BEFORE, Problem, twist};
use super::params::NuisanceParams;
use super::report::{Nuisance, NuisanceState, Nuisances};
use super::words;
use crate::trust::predict::{Deformation, Where};
use crate::trust::{RuleParams, SurfaceError};
use nalgebra::{DMatrix, DVector, Point3, Vector3, Vector6};
use osteoflow_verdict::Reason;
use statrs::distribution::{ContinuousCDF, Normal};

/// The causes that may be told from the pose, a step apart.
const FITTED: [Cause; 8] = [
    Cause::Along,
    Cause::Growth,
    Cause::Shear,
    Cause::Across,
    Cause::Bend,
    Cause::Twist,
    Cause::Offset,
    Cause::CameraScale,
];

/// The causes that look like another pose.
const UNFITTED: [Cause; 4] = [Cause::FilmAlong, Cause::FilmAround, Cause::Film, Cause::CameraDepth];

/// Explanations are as good as each other that differ by this share of what the better explains, or by odds of 1 in 20.
const HARDLY: f64 = 0.05;
const SLACK: f64 = 6.0;

/// Places of a step are tried this far apart, mm.
const STEP_EVERY_MM: f64 = 8.0;

/// Another cause explains the same numbers if it takes this share of what the best one takes from the residuals.
const AS_WELL: f64 = 0.75;

/// A cause with this share of the effect that matters, and of the score from which it is measured, is fitted to its end: along and about
/// a shaft a first look finds a half of it.
const NEAR: f64 = 0.3;

/// An amplitude of the field that is not fitted has this standard deviation, mm.
const NONE_MM: f64 = 1e-6;

/// The least edge of the cells whose residuals count as one draw, mm: some points of the scan are in each.
const MIN_CELL_MM: f64 = 4.0;

/// Standard deviations over those that the residuals tell: so much more do sizes scatter in simulated sound scans, as errors of camera and
/// CT that are no wave of the field are in none of the residuals.
const UNMODELLED: f64 = 2.8;

/// Twice the logarithm of the odds against a fault: one in 400.
const FAULT: f64 = 12.0;

/// 90 % of a Gaussian's absolute values are below this many standard deviations.
const BOUND_SIGMAS: f64 = 1.645;

/// A fitted cause.
#[derive(Clone)]
struct Candidate {
    cause: Cause,
    fit: Fit,
    /// Of its parameters.
    covariance: DMatrix<f64>,
    /// Its size in standard deviations.
    score: f64,
    effect: Effect,
    /// How much it takes from the squares of the residuals, less what its prior asks for.
    gain: f64,
}

impl Candidate {
    /// Size of the estimate, in its parameters.
    fn size(&self) -> f64 {
        self.cause.size(&self.fit.values).abs()
    }

    /// Probability that it displaces the targets beyond the limits.
    fn beyond_limits(&self) -> f64 {
        let critical = self.size() / self.effect.times;
        Normal::new(self.size(), self.sd()).map_or(0.0, |size| size.sf(critical))
    }

    /// Standard deviation of its size, from the data alone.
    fn sd(&self) -> f64 {
        self.covariance.diagonal().rows(0, self.cause.n_own()).mean().max(0.0).sqrt()
    }
}

/// A registration whose causes of error are judged.
pub(super) struct Model<'a> {
    problem: Problem<'a>,
    /// The fit of pose and field alone.
    rigid: Fit,
    /// Edge of the cells whose residuals count as one draw, mm.
    cell_mm: f64,
    /// How much more the pose varies than with independent residuals.
    inflation: f64,
    place: &'a Where<'a>,
    rules: &'a RuleParams,
    params: &'a NuisanceParams,
}

impl<'a> Model<'a> {
    /// The model at the pose at which the scan fits; `None` where that leaves a motion undetermined.
    pub(super) fn new(
        problem: Problem<'a>,
        place: &'a Where<'a>,
        rules: &'a RuleParams,
        params: &'a NuisanceParams,
    ) -> Option<Self> {
        let rigid = problem.fit(&[], &problem.field.sds_mm, fit::THOROUGH)?;
        // The field explains what is correlated over longer distances.
        let cell_mm = SurfaceError::new(&rigid.left()).cell_mm(MIN_CELL_MM);
        let covariance = problem.covariance(&rigid, &[], &problem.field.sds_mm, cell_mm)?;
        let mut model = Self { problem, rigid, cell_mm, inflation: 1.0, place, rules, params };
        let (h, _, _) = model.blocks(&[], &model.problem.field.sds_mm);
        let inverse = h.try_inverse()?;
        let inflation = (0..6).map(|k| covariance[(k, k)] / inverse[(k, k)]).sum::<f64>() / 6.0;
        model.inflation = (inflation / model.rigid.sigma_mm.powi(2)).max(1.0);
        Some(model)
    }

    /// What the data say of every cause.
    pub(super) fn judge(&self) -> Nuisances {
        let mut fitted = FITTED.to_vec();
        fitted.extend(self.step());
        let candidates = self.candidates(&fitted);
        let measured = self.measured(&candidates);
        let (mut list, mut unseen, mut bounded) = (Vec::new(), Vec::new(), Vec::new());
        for cause in fitted.into_iter().chain(UNFITTED) {
            let modes = self.own_modes(cause);
            if modes.is_empty() {
                continue;
            }
            let candidate = candidates.iter().find(|c| c.cause == cause);
            let prior = self.params.prior(cause);
            let linear = self.linear(cause, &modes);
            let bound = linear.worst.scaled(BOUND_SIGMAS * linear.data_sd);
            let (state, effect) = match candidate {
                Some(c) if measured.iter().any(|m| m.cause == cause) => (NuisanceState::Measured, c.effect),
                Some(_) if !cause.is_assumed() && bound.times <= 1.0 => (NuisanceState::Bounded, bound),
                _ => (NuisanceState::Unseen, linear.worst.scaled(prior)),
            };
            let critical = 1.0 / linear.worst.times.max(1e-12);
            match state {
                NuisanceState::Bounded => bounded.push(cause),
                NuisanceState::Unseen => {
                    let assumption = words::assumption(cause, critical, linear.worst, &self.rules.limits);
                    unseen.push((critical / prior, (cause.is_of_camera(), assumption)));
                }
                NuisanceState::Measured => {}
            }
            let (unit, by) = cause.unit();
            let values = candidate.map(|c| &c.fit.values[..]);
            list.push(Nuisance {
                name: cause.name().to_owned(),
                state,
                estimate: values.map(|values| by * cause.size(values)),
                sd: by * linear.sd,
                unit: unit.to_owned(),
                axis: cause.axis(self.problem.axes, values).map(Into::into),
                at: cause.place(self.problem.axes).map(|p| p.coords.into()),
                effect_mm: effect.mm,
                effect_deg: effect.deg,
                critical: by * critical,
            });
        }
        unseen.sort_by(|a, b| a.0.total_cmp(&b.0));
        Nuisances {
            list,
            reason: self.reason(&measured),
            assumptions: unseen.into_iter().map(|(_, assumption)| assumption).collect(),
            deformation: self.deformation(&bounded),
        }
    }

    /// The modes of a cause without what is fitted beside it: the stretch beside a shear is a cause of its own.
    fn own_modes(&self, cause: Cause) -> Vec<Mode> {
        cause.modes(self.problem.axes).into_iter().take(cause.n_own()).collect()
    }

    /// The causes fitted, the one that explains most first.
    fn candidates(&self, causes: &[Cause]) -> Vec<Candidate> {
        let mut candidates: Vec<Candidate> =
            causes.iter().filter_map(|cause| self.candidate(*cause, fit::LOOK)).collect();
        self.compare(&mut candidates);
        for candidate in &mut candidates {
            if candidate.score >= NEAR * self.params.min_score && candidate.effect.times >= NEAR {
                *candidate = self.candidate(candidate.cause, fit::THOROUGH).unwrap_or_else(|| candidate.clone());
            }
        }
        self.compare(&mut candidates);
        candidates
    }

    /// The causes that are there and large enough to matter: the best explanation, and those that explain about as much.
    fn measured<'c>(&self, candidates: &'c [Candidate]) -> Vec<&'c Candidate> {
        let Some(best) = candidates.first() else { return Vec::new() };
        let matters =
            |c: &Candidate| c.beyond_limits() > self.rules.max_beyond_limits && c.size() >= self.params.least(c.cause);
        // Where the best explanation is harmless, another must be hardly worse.
        let least = if matters(best) { AS_WELL * best.gain } else { best.gain - (HARDLY * best.gain).max(SLACK) };
        // A shear is fitted beside a stretch: it is there where the stretch alone explains less.
        let stretch = candidates.iter().find(|c| c.cause == Cause::Along);
        let is_stretch = |c: &Candidate| c.cause == Cause::Shear && stretch.is_some_and(|s| s.gain + SLACK > c.gain);
        let is_measured = |c: &&Candidate| {
            c.gain > 0.0 && c.gain >= least && c.score >= self.params.min_score && matters(c) && !is_stretch(c)
        };
        candidates.iter().filter(is_measured).collect()
    }

    /// The sign that a cause was measured.
    fn reason(&self, measured: &[&Candidate]) -> Option<Reason> {
        let (first, others) = measured.split_first()?;
        let (_, by) = first.cause.unit();
        let others: Vec<(Cause, &[f64])> = others.iter().map(|c| (c.cause, &c.fit.values[..])).collect();
        Some(words::measured((first.cause, &first.fit.values), by * first.sd(), first.effect, &others))
    }

    /// The place of a step that fits best, if any fits.
    fn step(&self) -> Option<Cause> {
        let half_mm = self.problem.axes.half_mm;
        let every = (self.problem.points.len() / 500).max(1);
        let few: Vec<Point3<f64>> = self.problem.points.iter().step_by(every).copied().collect();
        let field = self.problem.field.thinned(every);
        let problem = Problem { points: &few, field: &field, ..self.problem };
        let cap_mm = 3.0 * self.rigid.sigma_mm;
        let n = (half_mm / STEP_EVERY_MM).floor() as i32;
        let places =
            (-n..=n).map(|k| f64::from(k) * STEP_EVERY_MM).filter(|mm| mm.abs() < half_mm - 0.5 * STEP_EVERY_MM);
        let squares = |beyond_mm: f64| {
            let cause = Cause::Step { beyond_mm };
            let fit = problem.fit(&cause.modes(self.problem.axes), &self.field_sds_mm(cause), fit::LOOK)?;
            Some((fit.squares(cap_mm), cause))
        };
        places.filter_map(squares).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, cause)| cause)
    }

    /// How much each candidate explains, the best first.
    fn compare(&self, candidates: &mut [Candidate]) {
        let sigma_mm = candidates.iter().map(|c| c.fit.sigma_mm).fold(self.rigid.sigma_mm, f64::min);
        let cap_mm = 3.0 * sigma_mm;
        let left = |fit: &Fit, sds_mm: &[f64; N_FIELD]| {
            let field: f64 = fit.field_mm.iter().zip(sds_mm).map(|(mm, sd_mm)| (mm / sd_mm).powi(2)).sum();
            fit.squares(cap_mm) / (sigma_mm * sigma_mm * self.inflation) + field
        };
        let rigid = left(&self.rigid, &self.problem.field.sds_mm);
        for candidate in candidates.iter_mut() {
            let gained = rigid - left(&candidate.fit, &self.field_sds_mm(candidate.cause));
            candidate.gain = gained - self.penalty(candidate);
        }
        candidates.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    }

    /// What an explanation costs, as twice the logarithm of its odds: as much as usual in a sound world, or a fault.
    fn penalty(&self, candidate: &Candidate) -> f64 {
        let of = |cause: Cause, size: f64| {
            let as_fault = (size / cause.usual()).powi(2) + FAULT;
            as_fault.min((size / self.params.prior(cause)).powi(2))
        };
        let beside = match (candidate.cause, &candidate.fit.values[..]) {
            (Cause::Shear, [_, stretch]) => of(Cause::Along, *stretch),
            _ => 0.0,
        };
        of(candidate.cause, candidate.size()) + beside
    }

    /// Priors of the field beside a cause: a bend is its longest wave, and the side that a camera sees does not tell a CT too wide from one with
    /// an offset.
    fn field_sds_mm(&self, cause: Cause) -> [f64; N_FIELD] {
        let mut sds_mm = self.problem.field.sds_mm;
        match cause {
            Cause::Bend => sds_mm[field::LONGEST] = NONE_MM,
            Cause::Offset | Cause::Across => sds_mm[field::OFFSET] = NONE_MM,
            _ => {}
        }
        sds_mm
    }

    fn candidate(&self, cause: Cause, max_steps: usize) -> Option<Candidate> {
        let axes = self.problem.axes;
        let modes = cause.modes(axes);
        if modes.is_empty() {
            return None;
        }
        let sds_mm = self.field_sds_mm(cause);
        let fit = self.problem.fit(&modes, &sds_mm, max_steps)?;
        let k = modes.len();
        let covariance = self.problem.covariance(&fit, &modes, &sds_mm, self.cell_mm)? * UNMODELLED.powi(2);
        let covariance = DMatrix::from_fn(k, k, |row, column| covariance[(N_BEFORE + row, N_BEFORE + column)]);
        let n_own = cause.n_own();
        let values = DVector::from_column_slice(&fit.values[..n_own]);
        let own = covariance.view((0, 0), (n_own, n_own)).into_owned();
        let score = own.cholesky().map_or(0.0, |c| values.dot(&c.solve(&values)).max(0.0).sqrt());
        let pose = twist(&fit.motion) - twist(&self.rigid.motion);
        let effect = Effect::new(self.place, &self.rules.limits, &|p| error_at(axes, &pose, &modes, &fit.values, p));
        Some(Candidate { cause, fit, covariance, score, effect, gain: 0.0 })
    }

    /// Normal matrices at the rigid fit: of pose and field, of these and modes, of the modes.
    fn blocks(&self, modes: &[Mode], field_sds_mm: &[f64; N_FIELD]) -> (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>) {
        let k = modes.len();
        let (problem, rigid) = (&self.problem, &self.rigid);
        let mut h = DMatrix::zeros(N_BEFORE + k, N_BEFORE + k);
        for (index, pair) in rigid.pairs.iter().enumerate() {
            let Some(pair) = pair else { continue };
            let before = problem.row_before(index, pair, &rigid.motion);
            let responses = modes.iter().map(|mode| problem.response(pair, mode, &rigid.motion));
            let row = DVector::from_iterator(N_BEFORE + k, before.iter().copied().chain(responses));
            h.ger(rigid.weight(pair), &row, &row, 1.0);
        }
        let prior = fit::prior(field_sds_mm, rigid.sigma_mm);
        (0..N_BEFORE).for_each(|k| h[(k, k)] += prior[k]);
        let part = |row, column, rows, columns| h.view((row, column), (rows, columns)).into_owned();
        (part(0, 0, N_BEFORE, N_BEFORE), part(0, N_BEFORE, N_BEFORE, k), part(N_BEFORE, N_BEFORE, k, k))
    }

    /// How the registration's pose answers to modes, and the information on them that pose and field leave.
    fn schur(&self, modes: &[Mode], field_sds_mm: &[f64; N_FIELD]) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let (h, cross, own) = self.blocks(modes, field_sds_mm);
        let response = -h.view((0, 0), (6, 6)).into_owned().cholesky()?.solve(&cross.rows(0, 6).into_owned());
        let left = own - cross.transpose() * h.cholesky()?.solve(&cross);
        Some((response, left / ((self.rigid.sigma_mm * UNMODELLED).powi(2) * self.inflation)))
    }

    /// What the data say of a cause's own modes at the rigid fit, to first order.
    fn linear(&self, cause: Cause, modes: &[Mode]) -> Linear {
        let (k, prior) = (modes.len(), self.params.prior(cause));
        let nothing = || (DMatrix::zeros(6, k), DMatrix::zeros(k, k));
        let (response, information) = self.schur(modes, &self.field_sds_mm(cause)).unwrap_or_else(nothing);
        let sd = |information: DMatrix<f64>| {
            information.try_inverse().map_or(f64::INFINITY, |inverse| (inverse.trace() / k as f64).max(0.0).sqrt())
        };
        let at = |values: &Vec<f64>| {
            // A size that may be: a tilt is no multiple of an angle that is not small.
            let values: Vec<f64> = values.iter().map(|value| value * prior).collect();
            let pose = &response * DVector::from_column_slice(&values);
            let pose = Vector6::from_fn(|row, _| pose[row]);
            Effect::new(self.place, &self.rules.limits, &|p| error_at(self.problem.axes, &pose, modes, &values, p))
                .scaled(1.0 / prior)
        };
        let worst = directions(k).iter().map(at).max_by(|a, b| a.times.total_cmp(&b.times)).unwrap_or_default();
        Linear { sd: sd(&information + DMatrix::identity(k, k) / (prior * prior)), data_sd: sd(information), worst }
    }

    /// The joint posterior of causes that the data limit, each with its prior.
    fn deformation(&self, bounded: &[Cause]) -> Option<Deformation> {
        let modes: Vec<Mode> = bounded.iter().flat_map(|cause| self.own_modes(*cause)).collect();
        if modes.is_empty() {
            return None;
        }
        // An offset is not there twice.
        let field_sds_mm = bounded.iter().find(|cause| **cause == Cause::Offset).map(|cause| self.field_sds_mm(*cause));
        let (response, information) = self.schur(&modes, &field_sds_mm.unwrap_or(self.problem.field.sds_mm))?;
        let prior = |cause: &Cause| vec![self.params.prior(*cause).powi(-2); cause.n_own()];
        let priors = DVector::from_iterator(modes.len(), bounded.iter().flat_map(prior));
        let covariance = (information + DMatrix::from_diagonal(&priors)).try_inverse()?;
        let axes = self.problem.axes.clone();
        let at = move |p: &Point3<f64>| {
            let column = |k: usize| {
                let pose = Vector6::from_fn(|row, _| response[(row, k)]);
                error_at(&axes, &pose, &modes[k..=k], &[1.0], p)
            };
            let columns: Vec<Vector3<f64>> = (0..modes.len()).map(column).collect();
            DMatrix::from_fn(3, columns.len(), |row, k| columns[k][row])
        };
        Some(Deformation { covariance, at: Box::new(at) })
    }
}

/// To first order: the standard deviation of a parameter, and the effect of a size of 1 in the worst direction.
struct Linear {
    /// With the prior.
    sd: f64,
    /// From the data alone.
    data_sd: f64,
    worst: Effect,
}

/// Directions of up to three parameters of unit length.
fn directions(k: usize) -> Vec<Vec<f64>> {
    match k {
        1 => vec![vec![1.0]],
        2 => (0..8).map(|i| f64::from(i) * std::f64::consts::PI / 8.0).map(|a| vec![a.cos(), a.sin()]).collect(),
        _ => {
            let all = (0..27).map(|i| [i % 3, i / 3 % 3, i / 9].map(|k| f64::from(k) - 1.0));
            let unit = |v: [f64; 3]| Vector3::from(v).try_normalize(1e-9).map(|v| v.as_slice().to_vec());
            all.filter_map(unit).collect()
        }
    }
}
