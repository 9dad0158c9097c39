//! Point-to-point ICP in its plainest form, under the stop rules that the paper may have used.

use super::IcpError;
use super::levels::{self, LevelFit};
use super::normal_equations::NormalEquations;
use super::params::IcpParams;
use super::problem::{Correspondences, Problem};
use super::report::{Halt, IcpFit, IcpStep, Observer};
use super::residual::PointToPoint;
use super::solve::{gauss_newton, kabsch};
use super::source::Source;
use super::state::State;
use super::stop::StopReason;
use super::weights::Weights;
use crate::target::Target;
use nalgebra::Isometry3;
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Parameters of [`register_published`].
#[params(reading)]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PublishedParams {
    /// The stop rule. Required, as the paper does not say which it used.
    pub reading: PublishedReading,
    /// Largest distance of a pair. 5: as of the other kinds.
    #[param(IcpParams::default().max_pair_distance_mm, 1e-6..=1e6)]
    pub max_pair_distance_mm: f64,
    /// Largest number of steps. 500: as of the other kinds; the number of steps with `reading = "iterations"`.
    #[param(IcpParams::default().max_iterations, 1..=100_000)]
    pub max_iterations: u32,
    /// Also stop after this time. 0: never. It is recorded, and a replay stops at the same step.
    #[param(0.0, 0.0..=1e9)]
    pub stop_after_ms: f64,
    /// Smallest number of pairs; fewer are an error. 10: six unknowns and some redundancy.
    #[param(IcpParams::default().min_pairs, 3..=1_000_000)]
    pub min_pairs: u32,
}

/// A reading of the paper's stop rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum PublishedReading {
    /// The RMS residual changes by less than 0.01 mm.
    #[serde(rename = "change_0.01")]
    Change001,
    /// The RMS residual changes by less than 1e-5 mm.
    #[serde(rename = "change_1e-5")]
    Change1e5,
    /// The mean distance of the pairs changes by less than 1e-5 mm.
    #[serde(rename = "mean_change_1e-5")]
    MeanChange1e5,
    /// `max_iterations` are used up.
    #[serde(rename = "iterations")]
    Iterations,
}

impl PublishedReading {
    /// The change below which it stops, mm.
    fn change_mm(self) -> f64 {
        match self {
            Self::Change001 => 0.01,
            Self::Change1e5 | Self::MeanChange1e5 => 1e-5,
            Self::Iterations => 0.0,
        }
    }

    /// The residual whose change it compares, mm.
    fn residual_mm(self, equations: &NormalEquations, correspondences: &Correspondences) -> f64 {
        match self {
            Self::MeanChange1e5 => correspondences.mean_mm(),
            _ => equations.rms_mm(),
        }
    }
}

impl PublishedParams {
    /// Plain steps on all points, without weights or convergence test, in the parameters of the other variants.
    fn to_icp(&self) -> IcpParams {
        IcpParams {
            max_pair_distance_mm: self.max_pair_distance_mm,
            max_iterations: self.max_iterations,
            stop_after_ms: self.stop_after_ms,
            min_pairs: self.min_pairs,
            stop_residual_mm: self.reading.change_mm(),
            stop_step_mm: 0.0,
            stop_step_rad: 0.0,
            acceleration: 0,
            levels: Vec::new(),
            gate_sigmas: 0.0,
            ..IcpParams::default()
        }
    }
}

/// Registers `source` onto `target` from `init` as the paper may have done: nearest points, Kabsch's motion, and a stop rule
/// that its text leaves open. The report's `left_mm` says how far from the minimum that stops.
///
/// # Errors
/// [`IcpError`] as of [`register`](super::register).
///
/// # Source
/// Besl and McKay 1992; section 2.3 of the paper.
pub fn register_published<'a>(
    target: &Target,
    source: impl Into<Source<'a>>,
    init: &Isometry3<f64>,
    params: &PublishedParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    register_source(target, source.into(), init, params, observer)
}

// Not generic, so that the loops are compiled in this crate.
fn register_source(
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &PublishedParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    let reading = params.reading;
    let minimize = |problem: &Problem<'_, PointToPoint>, start, weights, _, max_steps, observer: &mut Observer<'_>| {
        minimize(problem, start, weights, reading, max_steps, observer)
    };
    levels::by_points(target, source, init, &params.to_icp(), observer, minimize)
}

fn minimize(
    problem: &Problem<'_, PointToPoint>,
    start: State,
    mut weights: Weights,
    reading: PublishedReading,
    max_steps: u32,
    observer: &mut Observer<'_>,
) -> Result<LevelFit, IcpError> {
    let lever_arm_mm = problem.source.lever_arm_mm;
    let mut correspondences = problem.correspondences();
    let mut state = start;
    let mut equations = problem.linearize(&state, &mut correspondences, &mut weights, true)?;
    let mut residual_mm = reading.residual_mm(&equations, &correspondences);
    let mut best = (state, equations.clone());
    let mut n_steps = 0;
    loop {
        let next = kabsch(&state, &equations, lever_arm_mm);
        let step_mm = (next.since(&start, lever_arm_mm) - state.since(&start, lever_arm_mm)).norm();
        let remaining_mm = step_mm.max(gauss_newton(&equations).norm());
        let end = move |reason, (state, equations)| LevelFit {
            reason,
            converged: remaining_mm == 0.0,
            remaining_mm: Some(remaining_mm),
            ..LevelFit::at(state, equations, weights)
        };
        if remaining_mm == 0.0 {
            return Ok(end(StopReason::Step, (state, equations)));
        }
        if n_steps == max_steps {
            return Ok(end(StopReason::Iterations, (state, equations)));
        }

        let found = problem.linearize(&next, &mut correspondences, &mut weights, false).ok();
        let Some(found) = found.filter(|found| problem.mean_cost(found) <= problem.mean_cost(&equations)) else {
            return Ok(end(StopReason::Stalled, best));
        };
        let halted = observer.observe(problem.step(&equations, &state, &next, step_mm, Some(remaining_mm)));
        (state, equations) = (next, found);
        n_steps += 1;

        let before_mm = std::mem::replace(&mut residual_mm, reading.residual_mm(&equations, &correspondences));
        let change_mm = (residual_mm - before_mm).abs();
        let by_residual = (change_mm < reading.change_mm()).then_some(StopReason::Residual);
        if let Some(reason) = halted.or(by_residual) {
            return Ok(LevelFit { change_mm: Some(change_mm), ..end(reason, (state, equations)) });
        }
        if problem.mean_cost(&equations) < problem.mean_cost(&best.1) {
            best = (state, equations.clone());
        }
    }
}
