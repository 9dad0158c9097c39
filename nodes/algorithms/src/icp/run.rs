//! From coarse to fine: the levels that all variants share.

use super::acceleration::State;
use super::observability::Observability;
use super::pairing::{Cached, Field, Kept, Mesh, Pairing, Thinned, Tree};
use super::params::{IcpParams, PairingKind, PublishedReading};
use super::problem::Problem;
use super::report::{Halt, IcpFit, IcpReport, IcpStep, IcpTrace, Observer};
use super::residual::{PointToPlane, PointToPoint, Residual};
use super::source::{Prepared, Source};
use super::step;
use super::stop::{StopReason, rules};
use super::sums::Sums;
use super::surface::Surface;
use super::weights::Weights;
use super::{IcpError, planes, points};
use crate::cells::{Cells, cell_mm};
use crate::kabsch::finite;
use crate::target::Target;
use nalgebra::{Isometry3, Matrix6, Point3, Vector6};
use std::ops::ControlFlow;

/// A subset is run first only where it keeps so many points.
const MIN_SUBSET: usize = 500;

/// The first subset is pulled in from so many times the pair distance, so that no part of it is left behind at the start.
const PULL_REACH: f64 = 2.0;

/// How the descent at one level ended.
pub(super) struct Descent {
    pub(super) state: State,
    pub(super) sums: Sums,
    pub(super) weights: Weights,
    pub(super) reason: StopReason,
    pub(super) converged: bool,
    pub(super) remaining_mm: Option<f64>,
    pub(super) change_mm: Option<f64>,
}

impl Descent {
    /// At this state, with these sums under these weights; why it ended there is for the caller to say.
    pub(super) fn at(state: State, sums: Sums, weights: Weights) -> Self {
        let (remaining_mm, change_mm) = (None, None);
        Self { state, sums, weights, reason: StopReason::Iterations, converged: false, remaining_mm, change_mm }
    }
}

/// A variant's descent at one level: from a state, with weights; whether it is the last; for at most so many steps.
type Descend<R> = fn(&Problem<'_, R>, State, Weights, bool, u32, &mut Observer<'_>) -> Result<Descent, IcpError>;

pub(super) fn points(
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    caller: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    let mut left_mm = None;
    let mut fit =
        run::<PointToPoint>(target, source, init, &params.resolved(), caller, points::descend, |all, state| {
            // How far a step along the normals would still move what has come to rest.
            let planes: Problem<'_, PointToPlane> =
                Problem::new(all.surface, all.pairing, all.params, 1, all.source.clone(), all.back);
            let mut weights = Weights::open(all.params, all.params.max_pair_distance_mm);
            let sums = planes.pair(state, &mut planes.partners(), &mut weights, false);
            left_mm = sums.ok().map(|sums| step::newton(&sums).norm());
        })?;
    fit.report.left_mm = left_mm;
    Ok(fit)
}

pub(super) fn planes<R: Residual>(
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    caller: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    if params.published_reading != PublishedReading::None {
        return Err(IcpError::NotPublished);
    }
    run::<R>(target, source, init, params, caller, planes::descend::<R>, |_, _| ())
}

fn run<R: Residual>(
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    caller: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
    descend: Descend<R>,
    mut at_end: impl FnMut(&Problem<'_, R>, &State),
) -> Result<IcpFit, IcpError> {
    check::<R>(target, &source, init, params)?;
    let with_normals = R::SOURCE_NORMALS || params.max_normal_angle_deg < 180.0;
    let all = Prepared::new(&source, with_normals);
    let start = State { rotation: init.rotation, centre: init * all.centre };
    let camera = source.camera.filter(finite).map(|c| init * c);
    let near: Vec<Point3<f64>> = match target.normals() {
        Some(_) => Vec::new(),
        None => all.arms.iter().map(|a| start.centre + start.rotation * a).collect(),
    };
    let surface = Surface::new(target, camera.as_ref(), &near, params.max_pair_distance_mm);
    let back = params.reciprocal.then(|| {
        let arms: Vec<Point3<f64>> = all.arms.iter().copied().map(Point3::from).collect();
        Cells::new(&arms, &Point3::origin(), cell_mm(&arms, &Point3::origin()))
    });
    let (cached, kept) = (Cached(&surface), Kept(Cached(&surface)));
    let (tree, thinned) = (Tree(&surface), Thinned(&surface));
    let mesh = target.mesh().filter(|_| R::MESH).map(|mesh| Mesh::new(&surface, mesh));
    let exact: &dyn Pairing = match (&mesh, params.pairing) {
        (Some(mesh), _) => mesh,
        (None, PairingKind::Tree) => &tree,
        // Plain steps between points are many and short.
        (None, _) if !R::TARGET_NORMALS && params.acceleration == 0 => &kept,
        (None, _) => &cached,
    };
    let field =
        target.field().filter(|_| params.pairing == PairingKind::Field).map(|field| Field::new(&surface, field));
    let fast: Option<&dyn Pairing> = field.as_ref().map(|field| field as &dyn Pairing);
    // Between points exact pairs would hold the source back among the samples.
    let last = fast.filter(|_| !params.field_exact || !R::TARGET_NORMALS).unwrap_or(exact);

    let mut observer = Observer { trace: IcpTrace::default(), caller };
    let left = |observer: &Observer<'_>| params.max_iterations - observer.trace.steps.len() as u32;
    let mut state = start;
    let mut weights = Weights::open(params, params.max_pair_distance_mm * PULL_REACH);
    let mut halted = None;
    let worth = |every: &u32| *every >= 2 && all.arms.len() / (*every as usize) >= MIN_SUBSET;
    let mut levels: Vec<u32> = params.levels.iter().copied().filter(worth).collect();
    if fast.is_some() && params.field_exact && levels.is_empty() {
        // Too few points for a subset: the field takes all of them near.
        levels.push(1);
    }
    for (k, every) in levels.into_iter().enumerate() {
        let pairing = match fast {
            Some(fast) => fast,
            // The first level comes from farthest away, where a few of the target's points do.
            None if k == 0 && params.pairing == PairingKind::Cached => &thinned,
            None => exact,
        };
        if k > 0 {
            weights.reach_mm = weights.reach_mm.min(params.max_pair_distance_mm);
        }
        let level = Problem::new(&surface, pairing, params, every, all.every(every as usize), back.as_ref());
        // Where a subset finds too few pairs, all points decide whether there are enough.
        if let Ok(descent) = descend(&level, state, weights, false, left(&observer), &mut observer) {
            (state, weights) = (descent.state, descent.weights);
            if matches!(descent.reason, StopReason::Cancelled | StopReason::Time) || left(&observer) == 0 {
                halted = Some(descent.reason);
                break;
            }
        }
    }
    let mut weights = weights.for_last(params, 2.0 * surface.index.cell_mm());
    let last = Problem::new(&surface, last, params, 1, all, back.as_ref());
    let mut end = match halted {
        Some(reason) => {
            let sums = last.pair(&state, &mut last.partners(), &mut weights, false)?;
            let remaining_mm = Some(step::newton(&sums).norm());
            Descent { reason, remaining_mm, ..Descent::at(state, sums, weights) }
        }
        None => descend(&last, state, weights, true, left(&observer), &mut observer)?,
    };
    at_end(&last, &end.state);
    if end.converged {
        end.reason = if matches!(end.reason, StopReason::Iterations) { StopReason::Step } else { end.reason };
    }
    // Source normals, too, say what a symmetric or generalized step may do, but nothing of the surface's hold.
    let hold = (!R::SOURCE_NORMALS).then(|| end.sums.hold / end.sums.weight);
    let look = fast.unwrap_or(last.pairing);
    let observability = Observability::at(&surface, look, params, &last.source, &end.state, end.weights, hold);
    let report = report(&last.source, params, &end, &observer.trace, observability);
    Ok(IcpFit { t_target_source: end.state.isometry(&last.source.centre), report, trace: observer.trace })
}

fn check<R: Residual>(
    target: &Target,
    source: &Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
) -> Result<(), IcpError> {
    params.check()?;
    if R::TARGET_NORMALS && !R::MESH && target.normals().is_none() {
        return Err(IcpError::NoNormals);
    }
    if R::MESH && target.mesh().is_none() {
        return Err(IcpError::NoMesh);
    }
    if params.pairing == PairingKind::Field && target.field().is_none() {
        return Err(IcpError::NoField);
    }
    let min_pairs = params.min_pairs.max(3) as usize;
    if source.points.len() < min_pairs {
        return Err(IcpError::TooFewPoints { n_source: source.points.len(), min_pairs });
    }
    if let Some(index) = source.points.iter().position(|p| !finite(p)) {
        return Err(IcpError::NotFinite { what: format!("source point {index}") });
    }
    if let Some(normals) = source.normals.filter(|n| n.len() != source.points.len()) {
        return Err(IcpError::SourceNormals { n_points: source.points.len(), n_normals: normals.len() });
    }
    if !init.to_homogeneous().iter().all(|c| c.is_finite()) {
        return Err(IcpError::NotFinite { what: "the start".into() });
    }
    Ok(())
}

fn report(
    source: &Prepared,
    params: &IcpParams,
    end: &Descent,
    trace: &IcpTrace,
    observability: Observability,
) -> IcpReport {
    let sums = &end.sums;
    let last = trace.steps.last();
    let iterations = trace.steps.len() as u32;
    let step_rad = last.map_or(0.0, |s| s.step_rad);
    let unscale = Vector6::from_fn(|k, _| if k < 3 { 1.0 } else { source.lever_arm_mm });
    let normal_matrix = Matrix6::from_diagonal(&unscale) * sums.hold * Matrix6::from_diagonal(&unscale);
    let by_point = sums.grip.iter().any(|g| *g != 0.0);
    IcpReport {
        converged: end.converged,
        stop_reason: end.reason,
        rules: rules(params, end.reason, iterations, end.remaining_mm, step_rad, end.change_mm),
        iterations,
        n_source: source.arms.len(),
        n_pairs: sums.n,
        pair_share: sums.n as f64 / source.arms.len() as f64,
        rms_mm: sums.rms_mm(),
        point_rms_mm: (sums.point_squares / sums.weight).sqrt(),
        step_mm: last.map_or(0.0, |s| s.step_mm),
        step_rad,
        remaining_mm: end.remaining_mm,
        resolution_mm: by_point.then(|| step::resolution_mm(sums)),
        left_mm: None,
        normal_matrix: std::array::from_fn(|i| std::array::from_fn(|j| normal_matrix[(i, j)])),
        centroid_mm: end.state.centre.coords.into(),
        observability,
    }
}
