//! The descent of all variants but `point_to_point`.

use super::IcpError;
use super::acceleration::State;
use super::params::StepRule;
use super::problem::Problem;
use super::report::Observer;
use super::residual::Residual;
use super::run::Descent;
use super::step::{damped, grain_mm, newton};
use super::stop::{Pace, StopReason};
use super::weights::Weights;

/// The cost may rise for so many steps, as pairs and with them normals change.
const PATIENCE: usize = 3;

/// Share of the cost by which changing pairs may raise it while the pose gets better.
const SLACK: f64 = 1e-3;

/// A step at least this many times as long as the one before does not come closer.
const CONTRACTING: f64 = 0.7;

/// Shares of a Gauss-Newton step that are tried until one does not raise the cost.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.125];

/// Factors of the damping that Levenberg and Marquardt's rule tries until one does not raise the cost.
const DAMPINGS: [f64; 4] = [1.0, 1e1, 1e2, 1e4];

/// Least damping.
const MIN_DAMPING: f64 = 1e-6;

/// Over a way shorter than so many times what noise alone moves the least by, the cost of changing pairs goes up and down
/// and tells nothing.
const ROUGH_GRAINS: f64 = 4.0;

/// A level that is not the last ends where steps are shorter than this share of what noise alone moves its least by.
const GRAIN_SHARE: f64 = 0.5;

/// Iterates until the way still to go is short, nothing lowers the cost any more, the steps are used up, or the observer
/// breaks off. A level that is not the `last` ends as soon as its own noise hides what it could still gain.
pub(super) fn descend<R: Residual>(
    problem: &Problem<'_, R>,
    start: State,
    mut weights: Weights,
    last: bool,
    max_steps: u32,
    observer: &mut Observer<'_>,
) -> Result<Descent, IcpError> {
    let (params, lever_arm_mm) = (problem.params, problem.source.lever_arm_mm);
    let mut partners = problem.partners();
    let mut state = start;
    let mut sums = problem.pair(&state, &mut partners, &mut weights, true)?;
    let mut costs = vec![problem.energy(&sums)];
    let mut pace = Pace::default();
    let (mut share, mut damping) = (1.0_f64, MIN_DAMPING * 100.0);
    let mut last_step_mm: Option<f64> = None;
    let mut n_steps = 0;
    loop {
        let full = newton(&sums);
        let way_mm = full.norm();
        // Where pairs and with them normals change to and fro, steps go to and fro across the least: halving them then
        // halves how far it can be.
        let flat = costs.len() > 1 && costs[costs.len() - 1] > (1.0 - SLACK) * costs[costs.len() - 2];
        if flat && last_step_mm.is_some_and(|l| way_mm > CONTRACTING * l) {
            share *= 0.5;
        }
        last_step_mm = Some(way_mm);
        let remaining_mm = pace.remaining_mm(way_mm * share);
        let turn_rad = full.fixed_rows::<3>(3).norm() / lever_arm_mm * share;
        let fine = remaining_mm.is_some_and(|r| r <= params.stop_step_mm) && turn_rad <= params.stop_step_rad;
        let enough = fine || (!last && way_mm * share <= GRAIN_SHARE * grain_mm(&sums));
        let spent = n_steps >= max_steps;
        if spent || (enough && max_steps == 0) {
            return Ok(Descent {
                state,
                sums,
                weights,
                reason: StopReason::Iterations,
                converged: fine,
                remaining_mm,
                change_mm: None,
                pace,
            });
        }
        // No farther than pairs reach: beyond, the model knows nothing.
        let cut = (params.max_pair_distance_mm / way_mm).min(1.0);
        let before = sums.clone();
        let step = |next: &State, step_mm: f64| problem.step(&before, &state, next, step_mm, remaining_mm);
        if enough {
            // The last step is taken on trust: it is shorter than what matters.
            let motion = full * share;
            let next = state.moved(&motion, lever_arm_mm);
            let seen = observer.see(step(&next, motion.norm()));
            let left = pace.left_after_mm(motion.norm());
            return Ok(Descent {
                state: next,
                sums,
                weights,
                reason: seen.unwrap_or(StopReason::Step),
                converged: fine,
                remaining_mm: left,
                change_mm: None,
                pace,
            });
        }
        let recent = costs.len().saturating_sub(PATIENCE);
        let limit = costs[recent..].iter().copied().fold(f64::NEG_INFINITY, f64::max) * (1.0 + SLACK);
        let rough_mm = ROUGH_GRAINS * grain_mm(&sums);
        let mut taken = None;
        for k in 0..SHARES.len() {
            let motion = match params.step {
                StepRule::GaussNewton => full * (SHARES[k] * share * cut),
                StepRule::LevenbergMarquardt => {
                    let motion = damped(&sums, damping * DAMPINGS[k]) * share;
                    motion * (params.max_pair_distance_mm / motion.norm()).min(1.0)
                }
            };
            let candidate = state.moved(&motion, lever_arm_mm);
            // A candidate that loses its pairs is no better than one that raises the cost.
            if let Ok(found) = problem.pair(&candidate, &mut partners, &mut weights, false)
                && (motion.norm() <= rough_mm || problem.energy(&found) <= limit)
            {
                damping = (damping * DAMPINGS[k] * if k == 0 { 0.1 } else { 1.0 }).max(MIN_DAMPING);
                taken = Some((candidate, found, motion.norm()));
                break;
            }
        }
        let Some((next, found, step_mm)) = taken else {
            // Not even the shortest share of the step lowers the cost, so its least lies within that share.
            let remaining_mm = way_mm * share * SHARES[SHARES.len() - 1];
            let converged = remaining_mm <= params.stop_step_mm;
            let reason = if converged { StopReason::Step } else { StopReason::Stalled };
            return Ok(Descent {
                state,
                sums,
                weights,
                reason,
                converged,
                remaining_mm: Some(remaining_mm),
                change_mm: None,
                pace,
            });
        };
        let change_mm = (found.rms_mm() - sums.rms_mm()).abs();
        let seen = observer.see(step(&next, step_mm));
        n_steps += 1;
        (state, sums) = (next, found);
        costs.push(problem.energy(&sums));
        let by_residual = change_mm < params.stop_residual_mm;
        if let Some(reason) = seen.or(by_residual.then_some(StopReason::Residual)) {
            let remaining_mm = pace.left_after_mm(step_mm);
            return Ok(Descent {
                state,
                sums,
                weights,
                reason,
                converged: false,
                remaining_mm,
                change_mm: Some(change_mm),
                pace,
            });
        }
        let narrower = weights;
        if !weights.settled(params, step_mm) {
            sums = problem.weigh(&state, &partners, &mut weights, true)?;
            if weights != narrower {
                // Costs under other weights cannot be compared.
                costs = vec![problem.energy(&sums)];
            }
        }
    }
}
