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
use nalgebra::Vector6;

/// The cost may rise for so many steps, as pairs and with them normals change.
const PATIENCE: usize = 3;

/// Share of the cost by which changing pairs may raise it while the pose gets better.
const SLACK: f64 = 1e-3;

/// Where steps shrink by no more than this, pairs and with them normals change as fast as the pose.
const CRAWL: f64 = 0.5;

/// Cosine between two steps that go the same way.
const SAME_WAY: f64 = 0.9;

/// A stride is at most so many steps long.
const LONGEST: f64 = 10.0;

/// Between two strides so many steps are taken as they are, to see what the first one did.
const BETWEEN: usize = 2;

/// After so many steps none of which was shorter than all before, they go in circles.
const CIRCLES: usize = 10;

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
/// breaks off. A level that is not the last ends as soon as its own noise hides what it could still gain.
pub(super) fn descend<R: Residual>(
    problem: &Problem<'_, R>,
    start: State,
    mut weights: Weights,
    is_last: bool,
    max_steps: u32,
    observer: &mut Observer<'_>,
) -> Result<Descent, IcpError> {
    let (params, lever_arm_mm) = (problem.params, problem.source.lever_arm_mm);
    let mut partners = problem.partners();
    let mut state = start;
    let mut sums = problem.pair(&state, &mut partners, &mut weights, true)?;
    let mut costs = vec![problem.energy(&sums)];
    let mut pace = Pace::default();
    let mut damping = MIN_DAMPING * 100.0;
    let mut last: Option<Vector6<f64>> = None;
    let mut shortest_mm = f64::INFINITY;
    let (mut n_no_shorter, mut n_plain, mut n_steps) = (0, 0, 0);
    let mut visited = Vec::new();
    loop {
        let full = newton(&sums);
        let flat = costs.len() > 1 && costs[costs.len() - 1] > (1.0 - SLACK) * costs[costs.len() - 2];
        let stride = match &last {
            Some(last) if flat && params.step == StepRule::GaussNewton => stride(&full, last, n_plain),
            _ => 1.0,
        };
        n_plain = if stride > 1.0 { 0 } else { n_plain + 1 };
        if stride > 1.0 {
            pace.crawls(1.0 - 1.0 / stride);
        }
        last = Some(full);
        let aim = full * stride;
        let way_mm = aim.norm();
        let remaining_mm = pace.remaining_mm(full.norm());
        let turn_rad = full.fixed_rows::<3>(3).norm() / lever_arm_mm;
        let fine = remaining_mm.is_some_and(|r| r <= params.stop_step_mm) && turn_rad <= params.stop_step_rad;
        n_no_shorter = if full.norm() < shortest_mm { 0 } else { n_no_shorter + 1 };
        shortest_mm = shortest_mm.min(full.norm());
        let circles = flat && n_no_shorter >= CIRCLES;
        visited.push(state);
        let enough = fine || (!is_last && (circles || full.norm() <= GRAIN_SHARE * grain_mm(&sums)));
        if n_steps >= max_steps {
            return Ok(Descent { converged: fine, remaining_mm, ..Descent::at(state, sums, weights) });
        }
        if circles && is_last {
            // Where pairs change to and fro the least lies within the circle.
            let recent = &visited[visited.len() - CIRCLES..];
            let circle_mm = recent.iter().map(|v| v.since(&state, lever_arm_mm).norm()).fold(0.0, f64::max);
            let converged = circle_mm <= params.stop_step_mm;
            return Ok(Descent {
                reason: if converged { StopReason::Step } else { StopReason::Stalled },
                converged,
                remaining_mm: Some(circle_mm),
                ..Descent::at(state, sums, weights)
            });
        }
        // No farther than pairs reach: beyond, the model knows nothing.
        let cut = (params.max_pair_distance_mm / way_mm).min(1.0);
        let before = sums.clone();
        let step = |next: &State, step_mm: f64| problem.step(&before, &state, next, step_mm, remaining_mm);
        if enough {
            // The last step is taken on trust: it is shorter than what matters.
            let motion = aim;
            let next = state.moved(&motion, lever_arm_mm);
            let seen = observer.see(step(&next, motion.norm()));
            let left = pace.left_after_mm(motion.norm());
            return Ok(Descent {
                reason: seen.unwrap_or(StopReason::Step),
                converged: fine,
                remaining_mm: left,
                ..Descent::at(next, sums, weights)
            });
        }
        let recent = costs.len().saturating_sub(PATIENCE);
        let limit = costs[recent..].iter().copied().fold(f64::NEG_INFINITY, f64::max) * (1.0 + SLACK);
        let rough_mm = ROUGH_GRAINS * grain_mm(&sums);
        let mut taken = None;
        for k in 0..SHARES.len() {
            let motion = match params.step {
                StepRule::GaussNewton => aim * (SHARES[k] * cut),
                StepRule::LevenbergMarquardt => {
                    let motion = damped(&sums, damping * DAMPINGS[k]);
                    motion * (params.max_pair_distance_mm / motion.norm()).min(1.0)
                }
            };
            let candidate = state.moved(&motion, lever_arm_mm);
            // A candidate that loses its pairs is no better than one that raises the cost.
            if let Ok(found) = problem.pair(&candidate, &mut partners, &mut weights, false)
                && (motion.norm() <= rough_mm || problem.energy(&found) <= limit)
            {
                damping = (damping * DAMPINGS[k] * if k == 0 { 0.1 } else { 1.0 }).max(MIN_DAMPING);
                taken = Some((candidate, found, motion));
                break;
            }
        }
        let Some((next, found, motion)) = taken else {
            // Not even the shortest share of the step lowers the cost, so its least lies within that share.
            let remaining_mm = way_mm * SHARES[SHARES.len() - 1];
            let converged = remaining_mm <= params.stop_step_mm;
            let reason = if converged { StopReason::Step } else { StopReason::Stalled };
            return Ok(Descent {
                reason,
                converged,
                remaining_mm: Some(remaining_mm),
                ..Descent::at(state, sums, weights)
            });
        };
        let step_mm = motion.norm();
        let change_mm = (found.rms_mm() - sums.rms_mm()).abs();
        let seen = observer.see(step(&next, step_mm));
        n_steps += 1;
        (state, sums) = (next, found);
        costs.push(problem.energy(&sums));
        let by_residual = change_mm < params.stop_residual_mm;
        if let Some(reason) = seen.or(by_residual.then_some(StopReason::Residual)) {
            let remaining_mm = pace.left_after_mm(step_mm);
            return Ok(Descent {
                reason,
                remaining_mm,
                change_mm: Some(change_mm),
                ..Descent::at(state, sums, weights)
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

/// How many times a step is to be taken at once where steps crawl the same way, or swing to and fro: to where they would
/// end at the rate of the last two (Aitken).
fn stride(full: &Vector6<f64>, last: &Vector6<f64>, n_plain: usize) -> f64 {
    let rate = full.norm() / last.norm().max(f64::MIN_POSITIVE);
    let agreement = full.dot(last) / (full.norm() * last.norm()).max(f64::MIN_POSITIVE);
    if rate < CRAWL {
        1.0
    } else if agreement < -CRAWL {
        1.0 / (1.0 + rate.min(1.0))
    } else if agreement > SAME_WAY && rate < 1.0 && n_plain >= BETWEEN {
        (1.0 / (1.0 - rate)).min(LONGEST)
    } else {
        1.0
    }
}
