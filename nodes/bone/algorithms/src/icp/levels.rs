//! Coarse to fine: the levels of source subsets that all variants share.

use super::normal_equations::NormalEquations;
use super::observability::Observability;
use super::pairing::{Cached, Mesh, NeighbourLists, Pairing, Thinned, Tree};
use super::params::{IcpParams, PairingKind};
use super::problem::Problem;
use super::report::{Halt, IcpFit, IcpReport, IcpStep, IcpTrace, Observer};
use super::residual::{PointToPlane, PointToPoint, Residual};
use super::solve;
use super::source::{PreparedSource, Source};
use super::state::State;
use super::stop::{StopReason, rules};
use super::visible_surface::VisibleSurface;
use super::weights::Weights;
use super::{IcpError, gauss_newton};
use crate::kabsch::finite;
use crate::point_grid::{PointGrid, cell_mm};
use crate::target::{Side, Target};
use nalgebra::{Isometry3, Matrix6, Point3, Vector6};
use std::ops::ControlFlow;

/// Fewest points of a subset.
const MIN_SUBSET: usize = 500;

/// Search radius of the first level, in pair distances, so that no part of the source stays without pairs.
const FIRST_RADIUS: f64 = 2.0;

/// How the minimisation at one level ended.
pub(super) struct LevelFit {
    pub(super) state: State,
    pub(super) equations: NormalEquations,
    pub(super) weights: Weights,
    pub(super) reason: StopReason,
    pub(super) converged: bool,
    pub(super) remaining_mm: Option<f64>,
    pub(super) change_mm: Option<f64>,
}

/// Number of steps along the normals after which the error that a `point_to_point` leaves is estimated: twice what
/// `point_to_plane` takes from the starts of docs/method/icp.md.
const MAX_SETTLING: u32 = 100;

impl LevelFit {
    /// At this state, not converged, by [`StopReason::Iterations`].
    pub(super) fn at(state: State, equations: NormalEquations, weights: Weights) -> Self {
        let (remaining_mm, change_mm) = (None, None);
        Self { state, equations, weights, reason: StopReason::Iterations, converged: false, remaining_mm, change_mm }
    }
}

/// A variant's minimiser at one level: from a state with these weights, whether it is the last level, for at most this many
/// steps.
pub(super) trait Minimize<R>:
    Fn(&Problem<'_, R>, State, Weights, bool, u32, &mut Observer<'_>) -> Result<LevelFit, IcpError>
{
}

impl<R, F> Minimize<R> for F where
    F: Fn(&Problem<'_, R>, State, Weights, bool, u32, &mut Observer<'_>) -> Result<LevelFit, IcpError>
{
}

/// The registration by a minimiser of `point_to_point`.
pub(super) fn by_points(
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
    minimize: impl Minimize<PointToPoint>,
) -> Result<IcpFit, IcpError> {
    check::<PointToPoint>(target, &source, init, params)?;
    let mut fit = run(target, source, init, params, observer, minimize)?;
    fit.report.left_mm = left_mm(target, source, params, &fit);
    Ok(fit)
}

/// RMS distance of the source points from where a registration along the target's normals ends that starts at a fit.
///
/// It pairs all points within `max_pair_distance_mm` anew: the gate of the fit has narrowed to the pairs that fit where it is.
/// Normals that the target does not have are estimated near the fit. `None` where that is not possible.
fn left_mm(target: &Target, source: Source<'_>, params: &IcpParams, fit: &IcpFit) -> Option<f64> {
    let was_halted = matches!(fit.report.stop_reason, StopReason::Time | StopReason::Cancelled);
    let max_iterations = if was_halted { 1 } else { MAX_SETTLING };
    let IcpParams { stop_step_mm, stop_step_rad, stop_residual_mm, .. } = IcpParams::default();
    let one_sided = Some(params.one_sided.unwrap_or(PointToPoint::ONE_SIDED));
    let params =
        IcpParams { max_iterations, stop_step_mm, stop_step_rad, stop_residual_mm, one_sided, ..params.clone() };
    let quiet = &mut |_: &IcpStep| ControlFlow::Continue(());
    let from = &fit.t_target_source;
    let settled = run::<PointToPlane>(target, source, from, &params, quiet, gauss_newton::minimize).ok()?;
    let to = &settled.t_target_source;
    let mut squares: Vec<f64> = source.points.iter().map(|p| (from * p - to * p).norm_squared()).collect();
    // Summed in an order that does not depend on that of the points.
    squares.sort_by(f64::total_cmp);
    Some((squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// The registration by any other residual.
pub(super) fn by_planes<R: Residual>(
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    check::<R>(target, &source, init, params)?;
    run::<R>(target, source, init, params, observer, gauss_newton::minimize)
}

fn run<R: Residual>(
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    caller: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
    minimize: impl Minimize<R>,
) -> Result<IcpFit, IcpError> {
    // The variant's own default holds for the probes along the normals, too.
    let one_sided = Some(params.one_sided.unwrap_or(R::ONE_SIDED));
    let params = &IcpParams { one_sided, ..params.clone() };
    let all = PreparedSource::new(&source, R::SOURCE_NORMALS || params.max_normal_angle_deg < 180.0);
    let mut state = State { rotation: init.rotation, centroid: init * all.centroid };
    let surface = visible_surface(target, &source, &all, &state, init, params)?;
    let grid = params.reciprocal.then(|| grid(&all));
    let pairings = Pairings::new::<R>(target, &surface, params);
    let mut weights = Weights::open(params, params.max_pair_distance_mm * FIRST_RADIUS);

    let mut observer = Observer { trace: IcpTrace::default(), caller };
    let steps_left = |observer: &Observer<'_>| params.max_iterations - observer.trace.steps.len() as u32;
    let mut halted = None;
    let is_one_sided = surface.outward().is_some() && one_sided == Some(true);
    for (k, every) in subsets(params, all.points.len(), is_one_sided).into_iter().enumerate() {
        if k > 0 {
            weights.search_radius_mm = weights.search_radius_mm.min(params.max_pair_distance_mm);
        }
        let subset = all.every(every as usize);
        let level = Problem::new(&surface, pairings.of_subset(k), params, every, subset, grid.as_ref());
        // If a subset has too few pairs, all points decide whether there are enough.
        if let Ok(fit) = minimize(&level, state, weights, false, steps_left(&observer), &mut observer) {
            (state, weights) = (fit.state, fit.weights);
            if matches!(fit.reason, StopReason::Cancelled | StopReason::Time) || steps_left(&observer) == 0 {
                halted = Some(fit.reason);
                break;
            }
        }
    }

    let mut weights = weights.for_last(params, 2.0 * surface.index.cell_mm());
    let last = Problem::new(&surface, &*pairings.exact, params, 1, all, grid.as_ref());
    let mut end = match halted {
        Some(reason) => {
            let equations = last.linearize(&state, &mut last.correspondences(), &mut weights, false)?;
            let remaining_mm = Some(solve::gauss_newton(&equations).norm());
            LevelFit { reason, remaining_mm, ..LevelFit::at(state, equations, weights) }
        }
        None => minimize(&last, state, weights, true, steps_left(&observer), &mut observer)?,
    };
    if end.converged && end.reason == StopReason::Iterations {
        end.reason = StopReason::Step;
    }
    // Normals of the source, too, decide how far a symmetric or generalized step may go, but not what the surface determines.
    let h = (!R::SOURCE_NORMALS).then(|| end.equations.h / end.equations.weight);
    let observability = Observability::at(&surface, last.pairing, params, &last.source, &end.state, end.weights, h);
    let mut report = report(&last.source, params, &end, &observer.trace, observability);
    let [inside, outside] = end.equations.largest_squares.map(f64::sqrt);
    report.inliers_mm = Some([-inside, if is_one_sided { outside } else { inside }]);
    Ok(IcpFit { t_target_source: end.state.isometry(&last.source.centroid), report, trace: observer.trace })
}

/// The target as the camera sees it from the start.
fn visible_surface<'a>(
    target: &'a Target,
    source: &Source<'_>,
    prepared: &PreparedSource,
    start: &State,
    init: &Isometry3<f64>,
    params: &IcpParams,
) -> Result<VisibleSurface<'a>, IcpError> {
    let camera = source.camera.filter(finite).map(|c| init * c);
    let is_told = || match target.side() {
        Side::Outward | Side::Inward => true,
        Side::Stated => !target.is_open(),
        Side::Unknown => false,
    };
    let is_known = target.normals().is_some() && (camera.is_none() || is_told());
    let near: Vec<Point3<f64>> = match is_known {
        true => Vec::new(),
        false => prepared.points.iter().map(|p| start.centroid + start.rotation * p).collect(),
    };
    VisibleSurface::new(target, camera.as_ref(), &near, params.max_pair_distance_mm)
}

/// The source points in a grid about their centroid.
fn grid(source: &PreparedSource) -> PointGrid {
    let points: Vec<Point3<f64>> = source.points.iter().copied().map(Point3::from).collect();
    PointGrid::new(&points, &Point3::origin(), cell_mm(&points, &Point3::origin()))
}

/// The subsets to register before all points: every n-th point for each.
fn subsets(params: &IcpParams, n_points: usize, is_one_sided: bool) -> Vec<u32> {
    let is_large = |every: &u32| *every >= 2 && n_points / (*every as usize) >= MIN_SUBSET;
    let mut subsets: Vec<u32> = params.levels.iter().copied().filter(is_large).collect();
    if subsets.is_empty() && is_one_sided && !params.levels.is_empty() {
        // All points start with those outside counting less.
        subsets.push(1);
    }
    subsets
}

/// The correspondence searches of the levels.
struct Pairings<'a> {
    params: &'a IcpParams,
    exact: Box<dyn Pairing + 'a>,
    thinned: Thinned<'a>,
}

impl<'a> Pairings<'a> {
    fn new<R: Residual>(target: &'a Target, surface: &'a VisibleSurface<'a>, params: &'a IcpParams) -> Self {
        let exact: Box<dyn Pairing + 'a> = match (target.mesh().filter(|_| R::MESH), params.pairing) {
            (Some(mesh), _) => Box::new(Mesh::new(surface, mesh)),
            (None, PairingKind::Tree) => Box::new(Tree(surface)),
            // Plain steps between points are many and short.
            (None, _) if !R::TARGET_NORMALS && params.acceleration == 0 => Box::new(NeighbourLists(Cached(surface))),
            (None, _) => Box::new(Cached(surface)),
        };
        Self { params, exact, thinned: Thinned(surface) }
    }

    /// The search of the `k`-th subset.
    fn of_subset(&self, k: usize) -> &dyn Pairing {
        // The start is far off, where a thinned target is accurate enough.
        if k == 0 && self.params.pairing == PairingKind::Cached { &self.thinned } else { &*self.exact }
    }
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
    source: &PreparedSource,
    params: &IcpParams,
    end: &LevelFit,
    trace: &IcpTrace,
    observability: Observability,
) -> IcpReport {
    let equations = &end.equations;
    let last = trace.steps.last();
    let iterations = trace.steps.len() as u32;
    let step_rad = last.map_or(0.0, |s| s.step_rad);
    let unscale = Vector6::from_fn(|k, _| if k < 3 { 1.0 } else { source.lever_arm_mm });
    let normal_matrix = Matrix6::from_diagonal(&unscale) * equations.h * Matrix6::from_diagonal(&unscale);
    let by_points = equations.h_points.iter().any(|entry| *entry != 0.0);
    IcpReport {
        converged: end.converged,
        stop_reason: end.reason,
        rules: rules(params, end.reason, iterations, end.remaining_mm, step_rad, end.change_mm),
        iterations,
        n_source: source.points.len(),
        n_pairs: equations.n_pairs,
        pair_share: equations.n_pairs as f64 / source.points.len() as f64,
        rms_mm: equations.rms_mm(),
        point_rms_mm: (equations.point_squares / equations.weight).sqrt(),
        step_mm: last.map_or(0.0, |s| s.step_mm),
        step_rad,
        remaining_mm: end.remaining_mm,
        resolution_mm: by_points.then(|| solve::resolution_mm(equations)),
        left_mm: None,
        inliers_mm: None,
        normal_matrix: std::array::from_fn(|i| std::array::from_fn(|j| normal_matrix[(i, j)])),
        centroid_mm: end.state.centroid.coords.into(),
        observability,
    }
}
