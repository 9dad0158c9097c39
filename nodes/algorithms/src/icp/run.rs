//! The loop that both variants share.

use super::acceleration::{Acceleration, State};
use super::observability::{FREE_PER_MM, Normal, plane_row, point_block, sorted_eigen};
use super::{IcpError, IcpFit, IcpParams, IcpReport, IcpStep, IcpTrace, Observability, StopReason};
use crate::kabsch::{centroid, finite, from_covariance};
use crate::morton;
use crate::target::Target;
use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Points summed by one task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 512;

/// A subset is run first only where it keeps so many points.
const MIN_SUBSET: usize = 500;

/// An extrapolation longer than this many plain steps is cut: far from the fixed point it is a guess.
const MAX_STRETCH: f64 = 1000.0;

/// What a variant minimises.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Residual {
    Point,
    Plane,
}

/// Sums over the pairs used, taken over chunks in order.
#[derive(Clone)]
struct Sums {
    n: usize,
    point_squares: f64,
    squares: f64,
    arm: Vector3<f64>,
    offset: Vector3<f64>,
    offset_arm: Matrix3<f64>,
    normal: Matrix6<f64>,
    gradient: Vector6<f64>,
}

impl Sums {
    const ZERO: Self = Self {
        n: 0,
        point_squares: 0.0,
        squares: 0.0,
        arm: Vector3::new(0.0, 0.0, 0.0),
        offset: Vector3::new(0.0, 0.0, 0.0),
        offset_arm: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        normal: Matrix6::from_array_storage(nalgebra::ArrayStorage([[0.0; 6]; 6])),
        gradient: Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    fn add(mut self, other: &Self) -> Self {
        self.n += other.n;
        self.point_squares += other.point_squares;
        self.squares += other.squares;
        self.arm += other.arm;
        self.offset += other.offset;
        self.offset_arm += other.offset_arm;
        self.normal += other.normal;
        self.gradient += other.gradient;
        self
    }
}

/// A source point's nearest target point.
#[derive(Clone, Copy)]
struct Pair {
    target: u32,
    point_square: f64,
    /// The square of what is minimised; infinite where the pair is too far apart to be used.
    square: f64,
}

/// What one pairing gives.
struct Pairing {
    sums: Sums,
    /// Mean over all source points of the squared residual, where an unused point counts as far as the limit, mm².
    energy: f64,
}

impl Pairing {
    fn rms_mm(&self) -> f64 {
        (self.sums.squares / self.sums.n.max(1) as f64).sqrt()
    }
}

struct Problem<'a> {
    residual: Residual,
    target: &'a Target,
    params: &'a IcpParams,
    /// Source points about the centroid of the whole source.
    arms: Vec<Vector3<f64>>,
    source_centre: Point3<f64>,
    lever_arm_mm: f64,
}

/// How the descent on one subset ended.
struct Descent {
    state: State,
    reason: StopReason,
    converged: bool,
    remaining_mm: Option<f64>,
}

pub(super) fn run(
    residual: Residual,
    target: &Target,
    source: &[Point3<f64>],
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<()>,
) -> Result<IcpFit, IcpError> {
    check(residual, target, source, init, params)?;
    let ordered = morton::sorted(source);
    let source_centre = centroid(&ordered);
    let arms: Vec<Vector3<f64>> = ordered.iter().map(|p| p - source_centre).collect();
    let squares: f64 = arms.iter().map(Vector3::norm_squared).sum();
    // Points in one place have no lever arm; any length does, as no turn moves them.
    let lever_arm_mm = Some((squares / arms.len() as f64).sqrt()).filter(|l| *l > 0.0).unwrap_or(1.0);
    let all = Problem { residual, target, params, arms, source_centre, lever_arm_mm };

    let mut trace = IcpTrace::default();
    let mut state = State { rotation: init.rotation, centre: init * source_centre };
    let mut end = None;
    let every = params.first_every as usize;
    if every > 1 && source.len() / every >= MIN_SUBSET {
        let subset = Problem { arms: all.arms.iter().copied().step_by(every).collect(), ..all };
        // Where a subset finds too few pairs, all points decide whether there are enough.
        if let Ok(descent) = subset.descend(state, params.first_every, &mut trace, observer) {
            state = descent.state;
            end = Some(descent).filter(|d| matches!(d.reason, StopReason::Cancelled | StopReason::Iterations));
        }
    }
    let end = match end {
        Some(end) => end,
        None => all.descend(state, 1, &mut trace, observer)?,
    };
    let report = all.report(&end, &trace)?;
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

impl Problem<'_> {
    /// Iterates until the way still to go is short, the steps are used up, or the observer breaks off.
    fn descend(
        &self,
        start: State,
        every: u32,
        trace: &mut IcpTrace,
        observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<()>,
    ) -> Result<Descent, IcpError> {
        let mut acceleration = Acceleration::new(self.params.acceleration);
        let (mut state, mut pairing) = (start, self.pair(&start)?);
        let mut remaining_mm = None;
        let mut previous_step: Option<f64> = None;
        let mut calm = 0;
        loop {
            let done = |reason, converged, remaining_mm| Ok(Descent { state, reason, converged, remaining_mm });
            if trace.steps.len() >= self.params.max_iterations as usize {
                return done(StopReason::Iterations, false, remaining_mm);
            }
            let x = state.since(&start, self.lever_arm_mm);
            let plain = self.step(&state, &pairing);
            let g = plain.since(&start, self.lever_arm_mm);
            let plain_step = (g - x).norm();
            let mut far = acceleration.next(x, g);
            let stretch = (far - x).norm() / (MAX_STRETCH * plain_step).max(f64::MIN_POSITIVE);
            if stretch > 1.0 {
                far = x + (far - x) / stretch;
            }
            // The way still to go: as extrapolated, or as a geometric series of the last two plain steps.
            let series = previous_step.filter(|p| *p > plain_step).map(|p| plain_step / (1.0 - plain_step / p));
            remaining_mm = match (self.params.acceleration, previous_step) {
                _ if plain_step == 0.0 => Some(0.0),
                (_, None) => None,
                (0, _) => series,
                _ => Some((far - x).norm().max(plain_step)),
            };
            previous_step = Some(plain_step);

            // An extrapolated step is taken only where it lowers the energy; the plain one always is.
            let mut next = (plain, None, false);
            if (far - g).norm() > 0.0 {
                let leap = start.moved(&far, self.lever_arm_mm);
                match self.pair(&leap) {
                    Ok(found) if found.energy <= pairing.energy => next = (leap, Some(found), true),
                    _ => acceleration.clear(),
                }
            }
            let (next, found, accelerated) = next;
            let found = match found {
                Some(found) => found,
                None => self.pair(&next)?,
            };
            let change_mm = (found.rms_mm() - pairing.rms_mm()).abs();
            let step = IcpStep {
                iteration: trace.steps.len() as u32 + 1,
                every,
                n_pairs: pairing.sums.n,
                rms_mm: pairing.rms_mm(),
                step_mm: (next.since(&start, self.lever_arm_mm) - x).norm(),
                step_rad: next.rotation.angle_to(&state.rotation),
                accelerated,
                t_target_source: next.isometry(&self.source_centre),
            };
            (state, pairing) = (next, found);
            let cancelled = observer(&step).is_break();
            trace.steps.push(step);
            // Twice in a row: an extrapolation can be short by chance.
            calm = if remaining_mm.is_some_and(|r| r <= self.params.stop_step_mm) { calm + 1 } else { 0 };
            let done = |reason, converged| Ok(Descent { state, reason, converged, remaining_mm });
            if calm >= 2 || (calm == 1 && plain_step == 0.0) {
                return done(StopReason::Step, true);
            }
            if cancelled {
                return done(StopReason::Cancelled, false);
            }
            if change_mm < self.params.stop_residual_mm {
                return done(StopReason::Residual, calm > 0);
            }
        }
    }

    /// Pairs every source point at `state` and sums over the pairs used.
    fn pair(&self, state: &State) -> Result<Pairing, IcpError> {
        let normals = self.target.normals().filter(|_| self.residual == Residual::Plane);
        let rotation = state.rotation.to_rotation_matrix();
        let (points, tree) = (self.target.points(), self.target.tree());
        let limit = self.params.max_pair_distance_mm.powi(2);
        let mut pairs = vec![Pair { target: 0, point_square: f64::INFINITY, square: f64::INFINITY }; self.arms.len()];
        pairs.par_chunks_mut(CHUNK).zip(self.arms.par_chunks(CHUNK)).for_each(|(pairs, arms)| {
            for (pair, arm) in pairs.iter_mut().zip(arms) {
                let moved = state.centre + rotation * arm;
                let Some((index, point_square)) = tree.nearest(&moved) else { continue };
                let square = match normals {
                    _ if point_square > limit => f64::INFINITY,
                    Some(normals) => (moved - points[index]).dot(&normals[index]).powi(2),
                    None => point_square,
                };
                *pair = Pair { target: index as u32, point_square, square };
            }
        });
        let worst = self.worst_used(&pairs)?;
        let chunks: Vec<Sums> = pairs
            .par_chunks(CHUNK)
            .zip(self.arms.par_chunks(CHUNK))
            .map(|(pairs, arms)| {
                let mut sums = Sums::ZERO;
                for (pair, arm) in pairs.iter().zip(arms).filter(|(pair, _)| pair.square <= worst) {
                    let turned = rotation * arm;
                    let target = &points[pair.target as usize];
                    let offset = target - state.centre;
                    sums.n += 1;
                    sums.point_squares += pair.point_square;
                    sums.squares += pair.square;
                    if let Some(normals) = normals {
                        let normal = &normals[pair.target as usize];
                        let row = plane_row(normal, &turned, self.lever_arm_mm);
                        sums.normal += row * row.transpose();
                        sums.gradient += row * (turned - offset).dot(normal);
                    } else {
                        sums.arm += turned;
                        sums.offset += offset;
                        sums.offset_arm += offset * turned.transpose();
                        let residual = turned - offset;
                        let turn = turned.cross(&residual) / self.lever_arm_mm;
                        sums.normal += point_block(&turned, self.lever_arm_mm);
                        sums.gradient += Vector6::new(residual.x, residual.y, residual.z, turn.x, turn.y, turn.z);
                    }
                }
                sums
            })
            .collect();
        let sums = chunks.iter().fold(Sums::ZERO, Sums::add);
        let energy = (sums.squares + (self.arms.len() - sums.n) as f64 * limit) / self.arms.len() as f64;
        Ok(Pairing { sums, energy })
    }

    /// The largest squared residual that is used: below the limit, and above it only the trimmed share.
    fn worst_used(&self, pairs: &[Pair]) -> Result<f64, IcpError> {
        let mut squares: Vec<f64> = pairs.iter().map(|p| p.square).filter(|s| s.is_finite()).collect();
        let used = ((1.0 - self.params.trim_fraction) * squares.len() as f64).ceil() as usize;
        let min_pairs = self.params.min_pairs.max(3) as usize;
        if used < min_pairs {
            let nearest = pairs.iter().map(|p| p.point_square).fold(f64::INFINITY, f64::min);
            return Err(IcpError::TooFewPairs {
                n_pairs: used,
                min_pairs,
                n_source: pairs.len(),
                max_pair_distance_mm: self.params.max_pair_distance_mm,
                nearest_mm: nearest.sqrt(),
            });
        }
        if used == squares.len() {
            return Ok(f64::MAX);
        }
        Ok(*squares.select_nth_unstable_by(used - 1, f64::total_cmp).1)
    }

    /// Where the plain step of the variant leads.
    fn step(&self, state: &State, pairing: &Pairing) -> State {
        let sums = &pairing.sums;
        let n = sums.n as f64;
        if self.residual == Residual::Point {
            let (arm, offset) = (sums.arm / n, sums.offset / n);
            let covariance = sums.offset_arm - offset * arm.transpose() * n;
            let fit = from_covariance(&covariance, &(state.centre + offset), &(state.centre + arm));
            if let Some(turn) = fit {
                let mut rotation = turn.rotation * state.rotation;
                rotation.renormalize();
                return State { rotation, centre: turn * state.centre };
            }
        }
        let (values, vectors) = sorted_eigen(&(sums.normal / n));
        let motion = (0..6).filter(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM).fold(Vector6::zeros(), |motion, k| {
            let v: Vector6<f64> = vectors.column(k).into_owned();
            motion - v * (v.dot(&sums.gradient) / n / values[k])
        });
        state.moved(&motion, self.lever_arm_mm)
    }

    fn report(&self, end: &Descent, trace: &IcpTrace) -> Result<IcpReport, IcpError> {
        let Pairing { sums, .. } = self.pair(&end.state)?;
        // How well a surface holds a scan is told by its normals, whatever the variant minimises.
        let normal = match (self.residual, self.target.normals()) {
            (Residual::Point, Some(_)) => self.plane_problem().pair(&end.state)?.sums,
            _ => sums.clone(),
        };
        let normal = Normal { matrix: normal.normal, n: normal.n, lever_arm_mm: self.lever_arm_mm };
        let last = trace.steps.last();
        Ok(IcpReport {
            converged: end.converged,
            stop_reason: end.reason,
            iterations: trace.steps.len() as u32,
            n_source: self.arms.len(),
            n_pairs: sums.n,
            pair_share: sums.n as f64 / self.arms.len() as f64,
            rms_mm: (sums.squares / sums.n as f64).sqrt(),
            point_rms_mm: (sums.point_squares / sums.n as f64).sqrt(),
            step_mm: last.map_or(0.0, |s| s.step_mm),
            step_rad: last.map_or(0.0, |s| s.step_rad),
            remaining_mm: end.remaining_mm,
            observability: Observability::new(&normal),
        })
    }

    fn plane_problem(&self) -> Problem<'_> {
        Problem { residual: Residual::Plane, arms: self.arms.clone(), ..*self }
    }
}
