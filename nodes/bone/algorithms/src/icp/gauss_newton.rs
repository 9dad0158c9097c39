//! The minimiser of all variants but `point_to_point`: Gauss-Newton or Levenberg-Marquardt, with a nonmonotone line search
//! and Aitken extrapolation of slow steps.

use super::IcpError;
use super::levels::LevelFit;
use super::normal_equations::NormalEquations;
use super::params::StepRule;
use super::problem::{Correspondences, Problem};
use super::report::Observer;
use super::residual::Residual;
use super::solve::{gauss_newton, levenberg_marquardt, sigma_mm};
use super::state::State;
use super::stop::{ConvergenceRate, StopReason};
use super::weights::Weights;
use nalgebra::Vector6;

/// A step may raise the cost up to the largest of this many before it, as pairs and with them normals change. Source: Grippo,
/// Lampariello and Lucidi 1986.
const NONMONOTONE_WINDOW: usize = 3;

/// Share of the cost by which changing pairs may raise it while the pose improves.
const COST_TOLERANCE: f64 = 1e-3;

/// Contraction rate above which pairs and with them normals change as fast as the pose.
const SLOW_RATE: f64 = 0.5;

/// Cosine above which two steps have the same direction.
const SAME_DIRECTION: f64 = 0.9;

/// Upper bound on the extrapolation of a step.
const MAX_EXTRAPOLATION: f64 = 10.0;

/// Plain steps between two extrapolated ones, which show the effect of the first.
const PLAIN_BETWEEN: usize = 2;

/// Steps without a new shortest one after which the iteration is in a cycle.
const CYCLE: usize = 10;

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
        let step = minimizer.solve();
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
    rate: ConvergenceRate,
    previous: Option<Vector6<f64>>,
    /// States before each step.
    visited: Vec<State>,
    n_steps: u32,
    n_plain: usize,
    n_no_shorter: usize,
    shortest_mm: f64,
}

/// A solution of the normal equations.
struct Step {
    newton: Vector6<f64>,
    /// The step to take: `newton`, extrapolated.
    delta: Vector6<f64>,
    /// Distance to the minimum, mm; none while steps grow.
    remaining_mm: Option<f64>,
    /// Whether it is below the limits of the stop rule.
    is_short: bool,
    is_cycling: bool,
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
            rate: ConvergenceRate::default(),
            previous: None,
            visited: Vec::new(),
            n_steps: 0,
            n_plain: 0,
            n_no_shorter: 0,
            shortest_mm: f64::INFINITY,
        })
    }

    /// Solves the normal equations; extrapolates the step if the cost hardly falls any more.
    fn solve(&mut self) -> Step {
        let (params, lever_arm_mm) = (self.problem.params, self.problem.source.lever_arm_mm);
        let newton = gauss_newton(&self.equations);
        let stagnates = match self.costs.as_slice() {
            [.., before, now] => *now > (1.0 - COST_TOLERANCE) * before,
            _ => false,
        };
        let factor = match &self.previous {
            Some(previous) if stagnates && params.step == StepRule::GaussNewton => {
                aitken_factor(&newton, previous, self.n_plain)
            }
            _ => 1.0,
        };
        self.n_plain = if factor > 1.0 { 0 } else { self.n_plain + 1 };
        if factor > 1.0 {
            self.rate.at_least(1.0 - 1.0 / factor);
        }
        self.previous = Some(newton);
        let remaining_mm = self.rate.remaining_mm(newton.norm());
        let turn_rad = newton.fixed_rows::<3>(3).norm() / lever_arm_mm;
        self.n_no_shorter = if newton.norm() < self.shortest_mm { 0 } else { self.n_no_shorter + 1 };
        self.shortest_mm = self.shortest_mm.min(newton.norm());
        self.visited.push(self.state);
        Step {
            newton,
            delta: newton * factor,
            remaining_mm,
            is_short: remaining_mm.is_some_and(|r| r <= params.stop_step_mm) && turn_rad <= params.stop_step_rad,
            is_cycling: stagnates && self.n_no_shorter >= CYCLE,
        }
    }

    /// The convergence test; a short step is taken without a line search and ends the level.
    fn converged(&self, step: &Step, is_last: bool, max_steps: u32, observer: &mut Observer<'_>) -> Option<LevelFit> {
        if self.n_steps >= max_steps {
            return Some(self.end(StopReason::Iterations, step.is_short, step.remaining_mm));
        }
        if step.is_cycling && is_last {
            // Pairs change to and fro, and the minimum is within the cycle.
            return Some(self.end_within(self.cycle_mm()));
        }
        let is_noise = !is_last && (step.is_cycling || step.newton.norm() <= LEVEL_SIGMAS * sigma_mm(&self.equations));
        if !step.is_short && !is_noise {
            return None;
        }
        let (next, step_mm) = (self.state.moved(&step.delta, self.problem.source.lever_arm_mm), step.delta.norm());
        let halted = self.observe(&next, step_mm, step, observer);
        let reason = halted.unwrap_or(StopReason::Step);
        Some(LevelFit { state: next, ..self.end(reason, step.is_short, self.rate.remaining_after_mm(step_mm)) })
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
        let halted = self.observe(&trial.state, step_mm, step, observer);
        let change_mm = (trial.equations.rms_mm() - self.equations.rms_mm()).abs();
        self.n_steps += 1;
        (self.state, self.equations) = (trial.state, trial.equations);
        self.costs.push(self.problem.mean_cost(&self.equations));
        let by_residual = (change_mm < self.problem.params.stop_residual_mm).then_some(StopReason::Residual);
        let reason = halted.or(by_residual)?;
        let remaining_mm = self.rate.remaining_after_mm(step_mm);
        Some(LevelFit { change_mm: Some(change_mm), ..self.end(reason, false, remaining_mm) })
    }

    fn narrow_weights(&mut self, step_mm: f64) -> Result<(), IcpError> {
        let before = self.weights;
        if !self.weights.is_settled(self.problem.params, step_mm) {
            self.equations = self.problem.reweight(&self.state, &mut self.correspondences, &mut self.weights, true)?;
            if self.weights != before {
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

    fn cycle_mm(&self) -> f64 {
        let recent = &self.visited[self.visited.len() - CYCLE..];
        recent.iter().map(|v| v.since(&self.state, self.problem.source.lever_arm_mm).norm()).fold(0.0, f64::max)
    }

    fn observe(&self, next: &State, step_mm: f64, step: &Step, observer: &mut Observer<'_>) -> Option<StopReason> {
        observer.observe(self.problem.step(&self.equations, &self.state, next, step_mm, step.remaining_mm))
    }
}

/// Factor on a step for which two steps in one direction, or swinging to and fro, end at the limit of their geometric series.
///
/// Source: Aitken's delta-squared process.
fn aitken_factor(newton: &Vector6<f64>, previous: &Vector6<f64>, n_plain: usize) -> f64 {
    let rate = newton.norm() / previous.norm().max(f64::MIN_POSITIVE);
    let cosine = newton.dot(previous) / (newton.norm() * previous.norm()).max(f64::MIN_POSITIVE);
    if rate < SLOW_RATE {
        1.0
    } else if cosine < -SLOW_RATE {
        1.0 / (1.0 + rate.min(1.0))
    } else if cosine > SAME_DIRECTION && rate < 1.0 && n_plain >= PLAIN_BETWEEN {
        (1.0 / (1.0 - rate)).min(MAX_EXTRAPOLATION)
    } else {
        1.0
    }
}
