//! The minimiser of all variants but `point_to_point`: Gauss-Newton or Levenberg-Marquardt, with a nonmonotone line search
//! and pairs that are held where nothing but their changes moves the pose.

use super::IcpError;
use super::levels::LevelFit;
use super::normal_equations::NormalEquations;
use super::params::StepRule;
use super::problem::{Correspondences, Problem};
use super::report::Observer;
use super::residual::Residual;
use super::solve::{gauss_newton, levenberg_marquardt, sigma_mm};
use super::state::State;
use super::stop::{Secant, StopReason};
use super::weights::Weights;
use nalgebra::Vector6;

/// A step may raise the cost up to the largest of this many before it, as pairs and with them normals change. Source: Grippo,
/// Lampariello and Lucidi 1986.
const NONMONOTONE_WINDOW: usize = 3;

/// Share of the cost by which changing pairs may raise it while the pose improves.
const COST_TOLERANCE: f64 = 1e-3;

/// Steps without a new shortest one after which the iteration is in a cycle.
const CYCLE: u32 = 10;

/// Distance to the minimum before the first step, in Gauss-Newton steps.
const UNKNOWN_REMAINING: f64 = 2.0;

/// Line search: shares of the step, tried in this order.
const LINE_SEARCH: [f64; 4] = [1.0, 0.5, 0.25, 0.125];

/// Factors on the damping, tried in this order.
const DAMPING_FACTORS: [f64; 4] = [1.0, 1e1, 1e2, 1e4];

/// Lower bound on the damping.
const MIN_DAMPING: f64 = 1e-6;

/// Steps shorter than this many standard deviations of the minimum are accepted at any cost: there the cost of changing
/// pairs is noise.
const ROUGH_SIGMAS: f64 = 4.0;

/// A level before the last ends at steps shorter than this many standard deviations of its minimum.
const LEVEL_SIGMAS: f64 = 0.5;

/// The last level holds its pairs at steps shorter than this many standard deviations of the minimum for each step without a
/// new shortest one: the cost jumps where a point changes from one sample to the next, so steps among them never end.
const HELD_SIGMAS: f64 = 0.01;

/// Pairs that were held are searched again at their minimum; if the step there is longer than this share of the shortest one
/// before, they change in a cycle.
const ADVANCE: f64 = 0.5;

/// Minimises from `start` until the remaining distance is below `stop_step_mm`, no step lowers the cost, `max_steps` are used
/// up, or the observer stops it. A level before the last ends as soon as its noise exceeds its steps.
pub(super) fn minimize<R: Residual>(
    problem: &Problem<'_, R>,
    start: State,
    weights: Weights,
    is_last: bool,
    max_steps: u32,
    observer: &mut Observer<'_>,
) -> Result<LevelFit, IcpError> {
    let mut minimizer = Minimizer::linearized_at(start, problem, weights)?;
    loop {
        let step = minimizer.solve(is_last);
        if step.is_short && minimizer.correspondences.is_held {
            match minimizer.search_again()? {
                Some(end) => return Ok(end),
                None => continue,
            }
        }
        if let Some(end) = minimizer.converged(&step, is_last, max_steps, observer) {
            return Ok(end);
        }
        let Some(trial) = minimizer.line_search(&step) else {
            return Ok(minimizer.stalled(&step));
        };
        let step_mm = trial.delta.norm();
        if let Some(end) = minimizer.accept(trial, &step, observer) {
            return Ok(end);
        }
        minimizer.narrow_weights(step_mm)?;
    }
}

struct Minimizer<'a, R> {
    problem: &'a Problem<'a, R>,
    state: State,
    correspondences: Correspondences,
    weights: Weights,
    equations: NormalEquations,
    /// Mean costs since the weights last changed, mm².
    costs: Vec<f64>,
    damping: f64,
    /// The Gauss-Newton step at the state before, and the step taken from there.
    previous: Option<(Vector6<f64>, Vector6<f64>)>,
    n_steps: u32,
    /// Number of Gauss-Newton steps since the shortest one.
    n_no_shorter: u32,
    shortest_mm: f64,
    /// Length of the shortest step where pairs were held or searched again.
    held_mm: f64,
}

/// A solution of the normal equations.
struct Step {
    newton: Vector6<f64>,
    /// The step to take: `newton`, shortened where steps go to and fro.
    delta: Vector6<f64>,
    /// Distance to the minimum, mm; none while steps grow.
    remaining_mm: Option<f64>,
    /// Whether it is below the limits of the stop rule.
    is_short: bool,
    /// Standard deviation of the minimum, mm.
    sigma_mm: f64,
    is_cycling: bool,
}

impl Step {
    /// Distance to the minimum after a step of this length, mm.
    fn remaining_after_mm(&self, step_mm: f64) -> Option<f64> {
        self.remaining_mm.map(|remaining| (remaining - step_mm).abs())
    }
}

/// A state that the line search accepts.
struct Trial {
    state: State,
    equations: NormalEquations,
    delta: Vector6<f64>,
}

impl<'a, R: Residual> Minimizer<'a, R> {
    fn linearized_at(state: State, problem: &'a Problem<'a, R>, mut weights: Weights) -> Result<Self, IcpError> {
        let mut correspondences = problem.correspondences();
        let equations = problem.linearize(&state, &mut correspondences, &mut weights, true)?;
        Ok(Self {
            problem,
            state,
            correspondences,
            weights,
            costs: vec![problem.mean_cost(&equations)],
            equations,
            damping: MIN_DAMPING * 100.0,
            previous: None,
            n_steps: 0,
            n_no_shorter: 0,
            shortest_mm: f64::INFINITY,
            held_mm: f64::INFINITY,
        })
    }

    /// Solves the normal equations for the next step.
    fn solve(&mut self, is_last: bool) -> Step {
        let params = self.problem.params;
        let newton = gauss_newton(&self.equations);
        let (newton_mm, sigma_mm) = (newton.norm(), sigma_mm(&self.equations));
        self.n_no_shorter = if newton_mm < self.shortest_mm { 0 } else { self.n_no_shorter + 1 };
        self.shortest_mm = self.shortest_mm.min(newton_mm);
        let is_rough = newton_mm < HELD_SIGMAS * f64::from(self.n_no_shorter) * sigma_mm;
        if is_last && is_rough && !self.correspondences.is_held {
            self.correspondences.is_held = true;
            self.held_mm = self.held_mm.min(newton_mm);
        }
        let secant = match &self.previous {
            Some((before, taken)) => Secant::new(before, taken, &newton),
            None => Secant { factor: 1.0, remaining_mm: Some(UNKNOWN_REMAINING * newton_mm) },
        };
        let turn_rad = newton.fixed_rows::<3>(3).norm() / self.problem.source.lever_arm_mm;
        let is_near = secant.remaining_mm.is_some_and(|remaining| remaining <= params.stop_step_mm);
        Step {
            newton,
            delta: newton * if params.step == StepRule::GaussNewton { secant.factor } else { 1.0 },
            remaining_mm: secant.remaining_mm,
            is_short: is_near && turn_rad <= params.stop_step_rad,
            sigma_mm,
            is_cycling: self.n_no_shorter >= CYCLE && self.stagnates(),
        }
    }

    /// Searches pairs that are held again, at their minimum. The step there is the distance to the minimum of all pairs; if it is
    /// not shorter than before by `ADVANCE`, pairs change in a cycle of this size, and there is no better minimum.
    fn search_again(&mut self) -> Result<Option<LevelFit>, IcpError> {
        self.correspondences.is_held = false;
        self.equations = self.problem.linearize(&self.state, &mut self.correspondences, &mut self.weights, false)?;
        self.costs = vec![self.problem.mean_cost(&self.equations)];
        let newton_mm = gauss_newton(&self.equations).norm();
        if newton_mm >= ADVANCE * self.held_mm {
            return Ok(Some(self.end_within(newton_mm)));
        }
        (self.previous, self.n_no_shorter, self.shortest_mm, self.held_mm) = (None, 0, f64::INFINITY, newton_mm);
        Ok(None)
    }

    /// Whether the cost hardly falls any more.
    fn stagnates(&self) -> bool {
        matches!(self.costs.as_slice(), [.., before, now] if *now > (1.0 - COST_TOLERANCE) * before)
    }

    /// The convergence test; a short step is taken without a line search and ends the level.
    fn converged(&self, step: &Step, is_last: bool, max_steps: u32, observer: &mut Observer<'_>) -> Option<LevelFit> {
        if self.n_steps >= max_steps {
            return Some(self.end(StopReason::Iterations, step.is_short, step.remaining_mm));
        }
        let newton_mm = step.newton.norm();
        if step.is_cycling && is_last {
            // Pairs change to and fro, and the minimum is within the cycle.
            let before_mm = self.previous.map_or(0.0, |(before, _)| before.norm());
            return Some(self.end_within(newton_mm.max(before_mm)));
        }
        let is_noise = step.is_cycling || newton_mm <= LEVEL_SIGMAS * step.sigma_mm;
        if !step.is_short && (is_last || !is_noise) {
            return None;
        }
        let (next, step_mm) = (self.state.moved(&step.delta, self.problem.source.lever_arm_mm), step.delta.norm());
        let halted = self.observe(&next, step_mm, step, observer);
        let reason = halted.unwrap_or(StopReason::Step);
        Some(LevelFit { state: next, ..self.end(reason, step.is_short, step.remaining_after_mm(step_mm)) })
    }

    /// The first share of the step, or the least damping, whose cost is not above the largest of the last few.
    fn line_search(&mut self, step: &Step) -> Option<Trial> {
        let (problem, params) = (self.problem, self.problem.params);
        let recent = self.costs.len().saturating_sub(NONMONOTONE_WINDOW);
        let max_cost = self.costs[recent..].iter().copied().fold(f64::NEG_INFINITY, f64::max) * (1.0 + COST_TOLERANCE);
        let rough_mm = ROUGH_SIGMAS * sigma_mm(&self.equations);
        // The linearisation says nothing beyond the pair distance.
        let trust = |delta: &Vector6<f64>| (params.max_pair_distance_mm / delta.norm()).min(1.0);
        for k in 0..LINE_SEARCH.len() {
            let delta = match params.step {
                StepRule::GaussNewton => step.delta * (LINE_SEARCH[k] * trust(&step.delta)),
                StepRule::LevenbergMarquardt => {
                    let delta = levenberg_marquardt(&self.equations, self.damping * DAMPING_FACTORS[k]);
                    delta * trust(&delta)
                }
            };
            let state = self.state.moved(&delta, problem.source.lever_arm_mm);
            // A state with too few pairs is as bad as one with a higher cost.
            if let Ok(equations) = problem.linearize(&state, &mut self.correspondences, &mut self.weights, false)
                && (delta.norm() <= rough_mm || problem.mean_cost(&equations) <= max_cost)
            {
                let eased = if k == 0 { 0.1 } else { 1.0 };
                self.damping = (self.damping * DAMPING_FACTORS[k] * eased).max(MIN_DAMPING);
                return Some(Trial { state, equations, delta });
            }
        }
        None
    }

    /// Takes the step; the end of the level if the observer or the rule on the residual says so.
    fn accept(&mut self, trial: Trial, step: &Step, observer: &mut Observer<'_>) -> Option<LevelFit> {
        let step_mm = trial.delta.norm();
        self.previous = Some((step.newton, trial.delta));
        let halted = self.observe(&trial.state, step_mm, step, observer);
        let change_mm = (trial.equations.rms_mm() - self.equations.rms_mm()).abs();
        self.n_steps += 1;
        (self.state, self.equations) = (trial.state, trial.equations);
        self.costs.push(self.problem.mean_cost(&self.equations));
        let by_residual = (change_mm < self.problem.params.stop_residual_mm).then_some(StopReason::Residual);
        let reason = halted.or(by_residual)?;
        Some(LevelFit { change_mm: Some(change_mm), ..self.end(reason, false, step.remaining_after_mm(step_mm)) })
    }

    fn narrow_weights(&mut self, step_mm: f64) -> Result<(), IcpError> {
        let before = self.weights;
        if !self.weights.is_settled(self.problem.params, step_mm) {
            self.problem.narrow(&self.correspondences, &mut self.weights);
            if self.weights != before {
                self.equations =
                    self.problem.reweight(&self.state, &mut self.correspondences, &mut self.weights, false)?;
                // Costs under other weights cannot be compared.
                self.costs = vec![self.problem.mean_cost(&self.equations)];
            }
        }
        Ok(())
    }

    /// No share of the step lowers the cost, so the minimum is within the smallest.
    fn stalled(&self, step: &Step) -> LevelFit {
        self.end_within(step.delta.norm() * LINE_SEARCH[LINE_SEARCH.len() - 1])
    }

    /// The end at a state that is this close to the minimum.
    fn end_within(&self, remaining_mm: f64) -> LevelFit {
        let converged = remaining_mm <= self.problem.params.stop_step_mm;
        let reason = if converged { StopReason::Step } else { StopReason::Stalled };
        self.end(reason, converged, Some(remaining_mm))
    }

    fn end(&self, reason: StopReason, converged: bool, remaining_mm: Option<f64>) -> LevelFit {
        LevelFit { reason, converged, remaining_mm, ..LevelFit::at(self.state, self.equations.clone(), self.weights) }
    }

    fn observe(&self, next: &State, step_mm: f64, step: &Step, observer: &mut Observer<'_>) -> Option<StopReason> {
        observer.observe(self.problem.step(&self.equations, &self.state, next, step_mm, step.remaining_mm))
    }
}
