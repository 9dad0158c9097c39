//! The descent of `point_to_point`.

use super::IcpError;
use super::acceleration::{Acceleration, State};
use super::params::PublishedReading;
use super::problem::{Partners, Problem};
use super::report::{IcpStep, Observer};
use super::residual::PointToPoint;
use super::run::Descent;
use super::step::{kabsch, newton, resolution_mm, told, weakest};
use super::stop::StopReason;
use super::sums::Sums;
use super::weights::Weights;

/// How far to look for a lower residual from where a `point_to_point` has come to rest, in parts of its resolution: far
/// enough for the slope of the surface to outweigh the roughness.
const PROBES: [f64; 4] = [2.0, -2.0, 4.0, -4.0];

/// Iterates until the way still to go is short, nothing lowers the residual any more, the steps are used up, or the
/// observer breaks off. A level that is not the `last` only brings the source near.
pub(super) fn descend(
    problem: &Problem<'_, PointToPoint>,
    start: State,
    mut weights: Weights,
    last: bool,
    max_steps: u32,
    observer: &mut Observer<'_>,
) -> Result<Descent, IcpError> {
    let (params, lever_arm_mm) = (problem.params, problem.source.lever_arm_mm);
    let mut acceleration = Acceleration::new(params.acceleration);
    let mut partners = problem.partners();
    let mut state = start;
    let mut sums = problem.pair(&state, &mut partners, &mut weights, true)?;
    let mut cost = problem.energy(&sums);
    let mut best = (state, sums.clone(), cost);
    let residual_mm = |sums: &Sums, partners: &Partners| match params.published_reading {
        PublishedReading::MeanChange1e5 => partners.mean_mm(),
        _ => sums.rms_mm(),
    };
    let mut last_mm = residual_mm(&sums, &partners);
    let (mut calm, mut n_steps) = (0, 0);
    let mut plainly = false;
    loop {
        let x = state.since(&start, lever_arm_mm);
        let leap = newton(&sums);
        let plain = kabsch(&state, &sums, lever_arm_mm);
        let g = plain.since(&start, lever_arm_mm);
        let remaining_mm = (g - x).norm().max(leap.norm());
        let resolution_mm = if params.acceleration > 0 && !plainly { resolution_mm(&sums) } else { 0.0 };
        let is_calm = remaining_mm <= params.stop_step_mm.max(resolution_mm);
        // Twice in a row, unless nothing moves: a state can look calm while passing by.
        calm = if is_calm { calm + 1 } else { 0 };
        let done = |state, sums, weights, reason, change_mm| {
            Ok(Descent {
                reason,
                converged: is_calm,
                remaining_mm: Some(remaining_mm),
                change_mm,
                ..Descent::at(state, sums, weights)
            })
        };
        let settled = remaining_mm == 0.0 || calm >= 2;
        // What is rough can hold the source far from the least; a look beyond the roughness tells.
        let probed = match settled {
            true => lower_beyond(problem, &state, &sums, cost, resolution_mm, &mut partners, &mut weights),
            false => None,
        };
        if settled && probed.is_none() {
            if remaining_mm <= params.stop_step_mm || plainly || !last {
                return done(state, sums, weights, StopReason::Step, None);
            }
            // Among the roughness only plain steps find the pairs that stay.
            (plainly, calm) = (true, 0);
        }
        if n_steps >= max_steps {
            return done(state, sums, weights, StopReason::Iterations, None);
        }

        // No farther than pairs reach: beyond, the model knows nothing.
        let cut = (params.max_pair_distance_mm / leap.norm()).min(1.0);
        let candidates: Vec<(State, bool)> = if params.acceleration == 0 || plainly {
            vec![(plain, false)]
        } else {
            let far = start.moved(&acceleration.next(x, g), lever_arm_mm);
            // On the last level a leap among the roughness is worth its try: without it a scan rests a millimetre farther off.
            let leap = if last { leap } else { told(&sums) };
            vec![(state.moved(&(leap * cut), lever_arm_mm), true), (far, true), (plain, false)]
        };
        let mut taken = probed.map(|(candidate, found)| (candidate, found, true));
        for (candidate, accelerated) in candidates {
            if taken.is_some() {
                break;
            }
            // A candidate that loses its pairs is no better than one that raises the residual.
            if let Ok(found) = problem.pair(&candidate, &mut partners, &mut weights, false)
                && problem.energy(&found) <= cost
            {
                taken = Some((candidate, found, accelerated));
            }
        }
        let Some((next, found, accelerated)) = taken else {
            // Rounding aside, plain steps never raise the residual: this is its least among these pairs.
            let (state, sums, _) = best;
            let converged = remaining_mm <= params.stop_step_mm;
            let reason = if converged { StopReason::Step } else { StopReason::Stalled };
            return Ok(Descent {
                reason,
                converged,
                remaining_mm: Some(remaining_mm),
                ..Descent::at(state, sums, weights)
            });
        };
        let step_mm = (next.since(&start, lever_arm_mm) - x).norm();
        let step = problem.step(&sums, &state, &next, step_mm, Some(remaining_mm));
        let step = IcpStep { accelerated, ..step };
        (state, sums) = (next, found);
        let now_mm = residual_mm(&sums, &partners);
        let change_mm = (now_mm - last_mm).abs();
        n_steps += 1;
        let seen = observer.see(step);
        let by_residual = (change_mm < params.stop_residual_mm).then_some(StopReason::Residual);
        if let Some(reason) = seen.or(by_residual) {
            return done(state, sums, weights, reason, Some(change_mm));
        }
        if !weights.settled(params, step_mm) {
            let before = weights;
            sums = problem.pair(&state, &mut partners, &mut weights, true)?;
            if weights != before {
                // Costs under other weights cannot be compared.
                best = (state, sums.clone(), problem.energy(&sums));
            }
        }
        last_mm = residual_mm(&sums, &partners);
        cost = problem.energy(&sums);
        if cost < best.2 {
            best = (state, sums.clone(), cost);
        }
    }
}

/// The best of a few states some way along the motion that the pairs hold least, if it lowers the residual.
fn lower_beyond(
    problem: &Problem<'_, PointToPoint>,
    state: &State,
    sums: &Sums,
    cost: f64,
    resolution_mm: f64,
    partners: &mut Partners,
    weights: &mut Weights,
) -> Option<(State, Sums)> {
    let mut best: Option<(State, Sums, f64)> = None;
    let weakest = weakest(sums)?;
    for way in PROBES.map(|share| share * resolution_mm).into_iter().filter(|way| *way != 0.0) {
        let candidate = state.moved(&(weakest * way), problem.source.lever_arm_mm);
        if let Ok(found) = problem.pair(&candidate, partners, weights, false)
            && problem.energy(&found) < best.as_ref().map_or(cost, |b| b.2)
        {
            let cost = problem.energy(&found);
            best = Some((candidate, found, cost));
        }
    }
    best.map(|(state, sums, _)| (state, sums))
}
