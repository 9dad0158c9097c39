//! The minimiser of `point_to_point`: Kabsch's steps, accelerated by Gauss-Newton steps along the target's normals and by
//! Anderson extrapolation.

use super::IcpError;
use super::anderson::Anderson;
use super::levels::LevelFit;
use super::normal_equations::NormalEquations;
use super::problem::{Correspondences, Problem};
use super::report::{IcpStep, Observer};
use super::residual::PointToPoint;
use super::solve::{gauss_newton, kabsch, resolution_mm, shrunk_gauss_newton, weakest_motion};
use super::state::State;
use super::stop::StopReason;
use super::weights::Weights;
use nalgebra::Vector6;

/// Distances along the weakest motion at which a stationary point is probed for a lower cost, in resolutions: far enough for
/// the slope of the surface to outweigh the roughness.
const PROBES: [f64; 4] = [2.0, -2.0, 4.0, -4.0];

/// Minimises from `start` until the remaining distance is below `stop_step_mm`, no step lowers the cost, `max_steps` are used
/// up, or the observer stops it. A level before the last ends at its first stationary point.
pub(super) fn minimize(
    problem: &Problem<'_, PointToPoint>,
    start: State,
    weights: Weights,
    is_last: bool,
    max_steps: u32,
    observer: &mut Observer<'_>,
) -> Result<LevelFit, IcpError> {
    let mut minimizer = Minimizer::linearized_at(start, problem, weights, is_last)?;
    loop {
        let step = minimizer.solve();
        let escape = minimizer.escape(&step);
        if step.is_stationary && escape.is_none() {
            if step.remaining_mm <= problem.params.stop_step_mm || minimizer.is_plain || !is_last {
                return Ok(minimizer.end(StopReason::Step, &step));
            }
            // Only plain steps find the pairs that stay among the roughness.
            (minimizer.is_plain, minimizer.n_calm) = (true, 0);
        }
        if minimizer.n_steps >= max_steps {
            return Ok(minimizer.end(StopReason::Iterations, &step));
        }
        let candidates = minimizer.candidates(&step);
        let Some(trial) = escape.or_else(|| minimizer.first_lower(&candidates)) else {
            return Ok(minimizer.stalled(&step));
        };
        let step_mm = (trial.state.since(&start, problem.source.lever_arm_mm) - step.x).norm();
        if let Some(end) = minimizer.accept(trial, step_mm, &step, observer) {
            return Ok(end);
        }
        minimizer.narrow_weights(step_mm)?;
    }
}

struct Minimizer<'a> {
    problem: &'a Problem<'a, PointToPoint>,
    start: State,
    is_last: bool,
    state: State,
    correspondences: Correspondences,
    weights: Weights,
    equations: NormalEquations,
    /// Mean cost, mm².
    cost: f64,
    anderson: Anderson,
    /// Whether only Kabsch's steps are taken.
    is_plain: bool,
    /// Steps in a row that ask for less than the resolution.
    n_calm: u32,
    n_steps: u32,
}

/// The steps proposed at a state.
struct Step {
    /// The motion from the start.
    x: Vector6<f64>,
    /// The state after Kabsch's step, and the motion from the start to it.
    plain: State,
    g: Vector6<f64>,
    /// The Gauss-Newton step along the target's normals.
    newton: Vector6<f64>,
    remaining_mm: f64,
    resolution_mm: f64,
    is_calm: bool,
    is_stationary: bool,
}

/// A state, its normal equations and their mean cost.
struct Trial {
    state: State,
    equations: NormalEquations,
    cost: f64,
    is_accelerated: bool,
}

impl<'a> Minimizer<'a> {
    fn linearized_at(
        start: State,
        problem: &'a Problem<'a, PointToPoint>,
        mut weights: Weights,
        is_last: bool,
    ) -> Result<Self, IcpError> {
        let mut correspondences = problem.correspondences();
        let equations = problem.linearize(&start, &mut correspondences, &mut weights, true)?;
        let cost = problem.mean_cost(&equations);
        Ok(Self {
            problem,
            start,
            is_last,
            state: start,
            correspondences,
            weights,
            equations,
            cost,
            anderson: Anderson::new(problem.params.acceleration),
            is_plain: problem.params.acceleration == 0,
            n_calm: 0,
            n_steps: 0,
        })
    }

    /// Solves for the next step by both models, and tests whether the state is stationary.
    fn solve(&mut self) -> Step {
        let (params, lever_arm_mm) = (self.problem.params, self.problem.source.lever_arm_mm);
        let x = self.state.since(&self.start, lever_arm_mm);
        let newton = gauss_newton(&self.equations);
        let plain = kabsch(&self.state, &self.equations, lever_arm_mm);
        let g = plain.since(&self.start, lever_arm_mm);
        let remaining_mm = (g - x).norm().max(newton.norm());
        let resolution_mm = if self.is_plain { 0.0 } else { resolution_mm(&self.equations) };
        let is_calm = remaining_mm <= params.stop_step_mm.max(resolution_mm);
        // Two steps in a row unless nothing moves: a state can look stationary in passing.
        self.n_calm = if is_calm { self.n_calm + 1 } else { 0 };
        let is_stationary = remaining_mm == 0.0 || self.n_calm >= 2;
        Step { x, plain, g, newton, remaining_mm, resolution_mm, is_calm, is_stationary }
    }

    /// The best of a few states along the weakest motion from a stationary point, if its cost is lower: a rough cost can hold
    /// the source far from its minimum.
    fn escape(&mut self, step: &Step) -> Option<Trial> {
        let weakest = weakest_motion(&self.equations).filter(|_| step.is_stationary)?;
        let mut best: Option<Trial> = None;
        for length_mm in PROBES.map(|share| share * step.resolution_mm).into_iter().filter(|length| *length != 0.0) {
            let state = self.state.moved(&(weakest * length_mm), self.problem.source.lever_arm_mm);
            let limit = best.as_ref().map_or(self.cost, |best| best.cost);
            best = self.trial(state, true).filter(|trial| trial.cost < limit).or(best);
        }
        best
    }

    /// The states to try, fastest first.
    fn candidates(&mut self, step: &Step) -> Vec<(State, bool)> {
        if self.is_plain {
            return vec![(step.plain, false)];
        }
        let lever_arm_mm = self.problem.source.lever_arm_mm;
        let anderson = self.start.moved(&self.anderson.next(step.x, step.g), lever_arm_mm);
        // On the last level the whole step is worth a try despite the roughness: shrunk, it ends a millimetre farther off.
        let newton = if self.is_last { step.newton } else { shrunk_gauss_newton(&self.equations) };
        // The linearisation says nothing beyond the pair distance.
        let trust = (self.problem.params.max_pair_distance_mm / step.newton.norm()).min(1.0);
        vec![(self.state.moved(&(newton * trust), lever_arm_mm), true), (anderson, true), (step.plain, false)]
    }

    fn first_lower(&mut self, candidates: &[(State, bool)]) -> Option<Trial> {
        let cost = self.cost;
        candidates
            .iter()
            .find_map(|&(state, is_accelerated)| self.trial(state, is_accelerated).filter(|trial| trial.cost <= cost))
    }

    /// The normal equations and the cost at a state; `None` if it has too few pairs.
    fn trial(&mut self, state: State, is_accelerated: bool) -> Option<Trial> {
        let equations = self.problem.linearize(&state, &mut self.correspondences, &mut self.weights, false).ok()?;
        let cost = self.problem.mean_cost(&equations);
        Some(Trial { state, equations, cost, is_accelerated })
    }

    /// Takes the step; the end of the level if the observer or the rule on the residual says so.
    fn accept(&mut self, trial: Trial, step_mm: f64, step: &Step, observer: &mut Observer<'_>) -> Option<LevelFit> {
        let seen = self.problem.step(&self.equations, &self.state, &trial.state, step_mm, Some(step.remaining_mm));
        let seen = IcpStep { accelerated: trial.is_accelerated, ..seen };
        let change_mm = (trial.equations.rms_mm() - self.equations.rms_mm()).abs();
        (self.state, self.equations) = (trial.state, trial.equations);
        self.n_steps += 1;
        let by_residual = (change_mm < self.problem.params.stop_residual_mm).then_some(StopReason::Residual);
        let reason = observer.observe(seen).or(by_residual)?;
        Some(LevelFit { change_mm: Some(change_mm), ..self.end(reason, step) })
    }

    fn narrow_weights(&mut self, step_mm: f64) -> Result<(), IcpError> {
        if !self.weights.is_settled(self.problem.params, step_mm) {
            self.equations = self.problem.linearize(&self.state, &mut self.correspondences, &mut self.weights, true)?;
        }
        self.cost = self.problem.mean_cost(&self.equations);
        Ok(())
    }

    /// No step lowers the cost: rounding aside, a plain step never raises it, so this is the minimum among these pairs.
    fn stalled(&self, step: &Step) -> LevelFit {
        let converged = step.remaining_mm <= self.problem.params.stop_step_mm;
        let reason = if converged { StopReason::Step } else { StopReason::Stalled };
        LevelFit { converged, ..self.end(reason, step) }
    }

    fn end(&self, reason: StopReason, step: &Step) -> LevelFit {
        LevelFit {
            reason,
            converged: step.is_calm,
            remaining_mm: Some(step.remaining_mm),
            ..LevelFit::at(self.state, self.equations.clone(), self.weights)
        }
    }
}
