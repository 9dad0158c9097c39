//! The loop that both variants share.

use super::acceleration::{Acceleration, State};
use super::observability::Observability;
use super::pairing::{Pairing, Problem, Residual};
use super::surface::Surface;
use super::{IcpError, IcpFit, IcpParams, IcpReport, IcpStep, IcpTrace, Source, StopReason};
use crate::kabsch::{centroid, finite};
use crate::morton;
use crate::target::Target;
use nalgebra::{Isometry3, Point3, Vector3};
use std::ops::ControlFlow;

/// A subset is run first only where it keeps so many points.
const MIN_SUBSET: usize = 500;

/// The residual along the normals may rise for so many steps, as pairs and with them normals change.
const PATIENCE: usize = 3;

/// A subset is first pulled in from so many times the pair distance, so that no part of it is left behind at the start.
const PULL_REACH: f64 = 2.0;

/// Where planes take over, points need not have settled closer than this, mm.
const ROUGHLY_MM: f64 = 0.2;

/// How far to look for a lower residual from where a `point_to_point` has come to rest, in parts of its resolution: far
/// enough for the slope of the surface to outweigh the roughness.
const PROBES: [f64; 4] = [2.0, -2.0, 4.0, -4.0];

/// Share of the energy by which changing pairs may raise it along the normals while the pose gets better.
const SLACK: f64 = 1e-3;

/// A step at least this many times as long as the one before does not come closer.
const CONTRACTING: f64 = 0.7;

/// Shares of a step along the normals that are tried until one does not raise the residual.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.125];

/// How the descent on one subset ended.
struct Descent {
    state: State,
    pairing: Pairing,
    reason: StopReason,
    converged: bool,
    remaining_mm: Option<f64>,
}

pub(super) fn run(
    residual: Residual,
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<()>,
) -> Result<IcpFit, IcpError> {
    let Source { points: source, camera } = source;
    check(residual, target, source, init, params)?;
    let ordered = morton::sorted(source);
    let source_centre = centroid(&ordered);
    let arms: Vec<Vector3<f64>> = ordered.iter().map(|p| p - source_centre).collect();
    let squares: f64 = arms.iter().map(Vector3::norm_squared).sum();
    // Points in one place have no lever arm; any length does, as no turn moves them.
    let lever_arm_mm = Some((squares / arms.len() as f64).sqrt()).filter(|l| *l > 0.0).unwrap_or(1.0);
    let start = State { rotation: init.rotation, centre: init * source_centre };
    let moved: Vec<Point3<f64>> = arms.iter().map(|a| start.centre + start.rotation * a).collect();
    let camera = camera.filter(finite).map(|c| init * c);
    let surface = Surface::new(target, camera.as_ref(), &moved, params.max_pair_distance_mm);
    let all = Problem { residual, surface: &surface, params, arms, source_centre, lever_arm_mm };

    let mut trace = IcpTrace::default();
    let mut state = start;
    let mut end = None;
    let every = params.first_every as usize;
    if every > 1 && source.len() / every >= MIN_SUBSET {
        let pull = pulling(residual, params);
        let arms: Vec<Vector3<f64>> = all.arms.iter().copied().step_by(every).collect();
        let mut stages = vec![Problem { residual: Residual::Point, params: &pull, arms: arms.clone(), ..all }];
        if residual == Residual::Plane {
            stages.push(Problem { arms, ..all });
        }
        for stage in stages {
            // Where a subset finds too few pairs, all points decide whether there are enough.
            if end.is_none()
                && let Ok(descent) = descend(&stage, state, params.first_every, &mut trace, observer)
            {
                state = descent.state;
                end = Some(descent).filter(|d| matches!(d.reason, StopReason::Cancelled | StopReason::Iterations));
            }
        }
    }
    let end = match end {
        Some(end) => Descent { pairing: all.pair(&end.state)?, ..end },
        None => descend(&all, state, 1, &mut trace, observer)?,
    };
    let report = IcpReport { left_mm: left_mm(&all, &end.state), ..report(&all, &end, &trace) };
    Ok(IcpFit { t_target_source: end.state.isometry(&source_centre), report, trace })
}

fn check(
    residual: Residual,
    target: &Target,
    source: &[Point3<f64>],
    init: &Isometry3<f64>,
    params: &IcpParams,
) -> Result<(), IcpError> {
    if residual == Residual::Plane && target.normals().is_none() {
        return Err(IcpError::NoNormals);
    }
    let min_pairs = params.min_pairs.max(3) as usize;
    if source.len() < min_pairs {
        return Err(IcpError::TooFewPoints { n_source: source.len(), min_pairs });
    }
    if let Some(index) = source.iter().position(|p| !finite(p)) {
        return Err(IcpError::NotFinite { what: format!("source point {index}") });
    }
    if !init.to_homogeneous().iter().all(|c| c.is_finite()) {
        return Err(IcpError::NotFinite { what: "the start".into() });
    }
    let limit = params.max_pair_distance_mm;
    if !(limit.is_finite() && limit > 0.0) {
        let expected = "it should be a positive length";
        return Err(IcpError::Parameter { parameter: "max_pair_distance_mm", value: limit, expected });
    }
    if !(0.0..1.0).contains(&params.trim_fraction) {
        let expected = "it should be at least 0 and below 1";
        return Err(IcpError::Parameter { parameter: "trim_fraction", value: params.trim_fraction, expected });
    }
    Ok(())
}

/// How the first subset is pulled in, by the distances between points whatever the variant: these draw from farther away
/// than those along the normals. Plain steps stay plain, as they serve to show what others did.
fn pulling(residual: Residual, params: &IcpParams) -> IcpParams {
    let mut pull = params.clone();
    if residual == Residual::Plane {
        pull.acceleration = 1;
        pull.stop_step_mm = params.stop_step_mm.max(ROUGHLY_MM);
    }
    if pull.acceleration > 0 {
        pull.max_pair_distance_mm *= PULL_REACH;
    }
    pull
}

/// Iterates until the way still to go is short, nothing lowers the residual any more, the steps are used up, or the
/// observer breaks off.
fn descend(
    problem: &Problem<'_>,
    start: State,
    every: u32,
    trace: &mut IcpTrace,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<()>,
) -> Result<Descent, IcpError> {
    let (params, lever_arm_mm) = (problem.params, problem.lever_arm_mm);
    let mut acceleration = Acceleration::new(params.acceleration);
    let (mut state, mut pairing) = (start, problem.pair(&start)?);
    let mut energies = vec![pairing.energy];
    let mut best = (state, pairing.clone());
    let (mut share, mut last_way_mm) = (1.0, None);
    let mut calm = 0;
    let mut plainly = false;
    loop {
        let x = state.since(&start, lever_arm_mm);
        let leap = problem.newton(&pairing);
        let plain = problem.plain(&state, &pairing);
        let g = plain.since(&start, lever_arm_mm);
        let way_mm = (g - x).norm().max(leap.norm());
        // Where pairs and with them normals change to and fro, planes step to and fro across the least: halving the
        // steps then halves how far it can be.
        let flat = energies.len() > 1 && pairing.energy > (1.0 - SLACK) * energies[energies.len() - 2];
        if problem.residual == Residual::Plane && flat && last_way_mm.is_some_and(|last| way_mm > CONTRACTING * last) {
            share *= 0.5;
        }
        last_way_mm = Some(way_mm);
        let remaining_mm = Some(way_mm * share);
        // Twice in a row, unless nothing moves: a state can look calm while passing by.
        let resolution_mm =
            problem.resolution_mm(&pairing).filter(|_| params.acceleration > 0 && !plainly).unwrap_or(0.0);
        let is_calm = remaining_mm.is_some_and(|r| r <= params.stop_step_mm.max(resolution_mm));
        calm = if is_calm { calm + 1 } else { 0 };
        let done = |reason, pairing| Ok(Descent { state, pairing, reason, converged: is_calm, remaining_mm });
        let settled = remaining_mm == Some(0.0) || calm >= 2;
        // What is rough can hold the source far from the least; a look beyond the roughness tells.
        let probed = if settled { lower_beyond(problem, &state, &pairing, resolution_mm) } else { None };
        if settled && probed.is_none() {
            // Among the roughness only plain steps find the pairs that stay.
            // A subset only brings the source near.
            if remaining_mm.is_some_and(|r| r <= params.stop_step_mm) || plainly || every > 1 {
                return done(StopReason::Step, pairing);
            }
            (plainly, calm) = (true, 0);
        }
        if trace.steps.len() >= params.max_iterations as usize {
            return done(StopReason::Iterations, pairing);
        }

        // No farther than pairs reach: beyond, the model knows nothing.
        let cut = (params.max_pair_distance_mm / leap.norm()).min(1.0);
        let candidates: Vec<(State, bool)> = match problem.residual {
            Residual::Point if params.acceleration == 0 || plainly => vec![(plain, false)],
            Residual::Point => {
                let far = start.moved(&acceleration.next(x, g), lever_arm_mm);
                vec![(state.moved(&(leap * cut), lever_arm_mm), true), (far, true), (plain, false)]
            }
            Residual::Plane => {
                SHARES.map(|part| (state.moved(&(leap * (part * share * cut)), lever_arm_mm), false)).to_vec()
            }
        };
        let slack = if problem.residual == Residual::Plane { SLACK } else { 0.0 };
        let recent = energies.len().saturating_sub(if problem.residual == Residual::Plane { PATIENCE } else { 1 });
        let limit = energies[recent..].iter().copied().fold(f64::NEG_INFINITY, f64::max) * (1.0 + slack);
        let mut taken = probed.map(|(candidate, found)| (candidate, found, true));
        for (candidate, accelerated) in candidates {
            if taken.is_some() {
                break;
            }
            // A candidate that loses its pairs is no better than one that raises the residual.
            if let Ok(found) = problem.pair(&candidate)
                && found.energy <= limit
            {
                taken = Some((candidate, found, accelerated));
            }
        }
        let Some((next, found, accelerated)) = taken else {
            // Not even the shortest share of the step lowers the residual, so its least lies within that share.
            let (state, pairing) = best;
            let remaining_mm = remaining_mm.map(|r| r * SHARES[SHARES.len() - 1]);
            let converged = remaining_mm.is_some_and(|r| r <= params.stop_step_mm);
            let reason = if converged { StopReason::Step } else { StopReason::Stalled };
            return Ok(Descent { state, pairing, reason, converged, remaining_mm });
        };
        let step = IcpStep {
            iteration: trace.steps.len() as u32 + 1,
            every,
            n_pairs: pairing.sums.n,
            rms_mm: pairing.rms_mm(),
            step_mm: (next.since(&start, lever_arm_mm) - x).norm(),
            step_rad: next.rotation.angle_to(&state.rotation),
            remaining_mm,
            accelerated,
            t_target_source: next.isometry(&problem.source_centre),
        };
        let change_mm = (found.rms_mm() - pairing.rms_mm()).abs();
        (state, pairing) = (next, found);
        energies.push(pairing.energy);
        if pairing.energy < best.1.energy {
            best = (state, pairing.clone());
        }
        let cancelled = observer(&step).is_break();
        trace.steps.push(step);
        let done = |reason, pairing| Ok(Descent { state, pairing, reason, converged: is_calm, remaining_mm });
        if cancelled {
            return done(StopReason::Cancelled, pairing);
        }
        if change_mm < params.stop_residual_mm {
            return done(StopReason::Residual, pairing);
        }
    }
}

/// The best of a few states some way along the motion that the pairs hold least, if it lowers the residual.
fn lower_beyond(
    problem: &Problem<'_>,
    state: &State,
    pairing: &Pairing,
    resolution_mm: f64,
) -> Option<(State, Pairing)> {
    let mut best: Option<(State, Pairing)> = None;
    let weakest = problem.weakest(pairing)?;
    for way in PROBES.map(|share| share * resolution_mm).into_iter().filter(|way| *way != 0.0) {
        let candidate = state.moved(&(weakest * way), problem.lever_arm_mm);
        if let Ok(found) = problem.pair(&candidate)
            && found.energy < best.as_ref().map_or(pairing.energy, |(_, best)| best.energy)
        {
            best = Some((candidate, found));
        }
    }
    best
}

/// How far a step along the normals would still move a source that `point_to_point` has brought to rest, mm.
fn left_mm(problem: &Problem<'_>, state: &State) -> Option<f64> {
    if problem.residual == Residual::Plane {
        return None;
    }
    let planes = Problem { residual: Residual::Plane, arms: problem.arms.clone(), ..*problem };
    planes.pair(state).ok().map(|pairing| planes.newton(&pairing).norm())
}

fn report(problem: &Problem<'_>, end: &Descent, trace: &IcpTrace) -> IcpReport {
    let sums = &end.pairing.sums;
    let last = trace.steps.last();
    IcpReport {
        converged: end.converged,
        stop_reason: end.reason,
        iterations: trace.steps.len() as u32,
        n_source: problem.arms.len(),
        n_pairs: sums.n,
        pair_share: sums.n as f64 / problem.arms.len() as f64,
        rms_mm: end.pairing.rms_mm(),
        point_rms_mm: (sums.point_squares / sums.n as f64).sqrt(),
        step_mm: last.map_or(0.0, |s| s.step_mm),
        step_rad: last.map_or(0.0, |s| s.step_rad),
        remaining_mm: end.remaining_mm,
        resolution_mm: problem.resolution_mm(&end.pairing),
        left_mm: None,
        observability: Observability::new(&(sums.hold / sums.n as f64), problem.lever_arm_mm),
    }
}
