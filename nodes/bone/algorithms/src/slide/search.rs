//! The minima about a pose: a grid of starts on a coarse map, the better ones registered onto the surface.

use super::SlideParams;
use super::axis::LongAxis;
use super::surface::{Loss, Scene};
use crate::Refusal;
use crate::coarse::{self, Placed, Points, descended, motion};
use crate::downsample::thinned;
use crate::icp::{self, IcpParams, Method, Source};
use crate::target::Target;
use nalgebra::Isometry3;
use osteoflow_geometry::Cloud;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Spacing of the starts along the bone and around it: a few steps on the map recover half of it.
const STEP_MM: f64 = 3.0;
const STEP_DEG: f64 = 15.0;

/// Number of points by which all starts are scored, and by which the better ones are refined on the map and registered.
const N_SCORED: usize = 250;
const N_MAPPED: usize = 1000;
const N_REGISTERING: usize = 700;

/// Largest residual counted on the map, mm, first and last.
const FIRST_REACH_MM: f64 = 3.5;
const LAST_REACH_MM: f64 = 2.0;

/// Number of distinct places that are refined on the map, registered, and registered with all points.
const N_REFINED: usize = 40;
const N_REGISTERED: usize = 6;
const N_FINISHED: usize = 3;

/// Places whose mean cost is larger by this factor with few points are not registered with all.
const RIVAL: f64 = 1.5;

/// A registration is iterated from its own result at most this often.
const N_ITERATED: usize = 4;

/// Until it moves less: then gate and visible side are those of the result.
const SETTLED_MM: f64 = 0.05;
const SETTLED_RAD: f64 = 0.002;

/// Places closer together on the map are one, mm (RMS); registrations closer than the other are one.
const APART_MM: f64 = 1.5;
pub(super) const SAME_MM: f64 = 1.0;

/// Maximum distance of a pair while a candidate is registered, and from the start, mm.
const PAIR_MM: f64 = 2.0;
const START_PAIR_MM: f64 = 5.0;

/// A place at which a registration comes to rest.
#[derive(Debug, Clone)]
pub(super) struct Minimum {
    pub(super) pose: Isometry3<f64>,
    scale_mm: f64,
    /// Mean robust cost, mm².
    cost: f64,
}

/// The minima within reach of a pose, best first; at least that of the pose itself.
pub(super) fn minima(
    seen: &Scene<'_>,
    axis: &LongAxis,
    centre: &Isometry3<f64>,
    params: &SlideParams,
) -> Result<Vec<Minimum>, Refusal> {
    let reach_rad = params.around_deg.to_radians();
    let is_within = |pose: &Isometry3<f64>| {
        let [along_mm, turn_rad] = axis.offset(seen, centre, pose);
        along_mm.abs() <= params.along_mm && turn_rad.abs() <= reach_rad
    };
    let mut starts: Vec<Isometry3<f64>> = on_map(seen, axis, centre, params).into_iter().filter(is_within).collect();
    starts.truncate(N_REGISTERED);
    starts.push(*centre);
    let some = thinned(seen.source.points(), N_REGISTERING);
    let few = IcpParams {
        levels: Vec::new(),
        max_iterations: 40,
        stop_step_mm: 0.01,
        stop_step_rad: 1e-4,
        ..icp_params(params)
    };
    let camera = seen.camera;
    let registered = starts.par_iter().filter_map(|start| {
        let source = camera.map_or_else(|| Source::from(&some), |camera| Source::seen_from(&some, camera));
        register(Method::PointToPlane, seen.target, source, start, &few).ok()
    });
    let mut rough: Vec<Minimum> = registered.filter(is_within).map(|pose| Minimum::new(seen, pose)).collect();
    sort(seen, params, &mut rough);
    let rough = distinct(seen, rough, SAME_MM);

    let max_cost = RIVAL * rough.first().map_or(0.0, |best| best.cost);
    let finish = |(k, minimum): (usize, &Minimum)| match k < N_FINISHED && minimum.cost <= max_cost {
        true => {
            register(Method::PointToPlane, seen.target, seen.source.into(), &minimum.pose, &icp_params(params)).ok()
        }
        false => Some(minimum.pose),
    };
    let ends: Vec<Option<Isometry3<f64>>> = rough.par_iter().enumerate().map(finish).collect();
    let mut minima: Vec<Minimum> = ends.into_iter().flatten().map(|pose| Minimum::new(seen, pose)).collect();
    if minima.is_empty() {
        let pose = register(Method::PointToPlane, seen.target, seen.source.into(), centre, &icp_params(params))?;
        minima.push(Minimum::new(seen, pose));
    }
    sort(seen, params, &mut minima);
    Ok(distinct(seen, minima, SAME_MM))
}

impl Minimum {
    fn new(seen: &Scene<'_>, pose: Isometry3<f64>) -> Self {
        Self { pose, scale_mm: seen.scale_mm(&pose), cost: 0.0 }
    }
}

/// Sorts minima by the robust cost of one and the same scale, that of the closest fit among them.
pub(super) fn sort(seen: &Scene<'_>, params: &SlideParams, minima: &mut [Minimum]) {
    let scale_mm = minima.iter().map(|m| m.scale_mm).fold(f64::INFINITY, f64::min);
    let loss = Loss::new(scale_mm.max(params.noise_mm));
    for minimum in minima.iter_mut() {
        let costs = seen.costs(&minimum.pose, &loss);
        minimum.cost = costs.iter().sum::<f64>() / costs.len().max(1) as f64;
    }
    minima.sort_by(|a, b| a.cost.total_cmp(&b.cost));
}

/// The first of each group of minima that lie closer together than `apart_mm`.
pub(super) fn distinct(seen: &Scene<'_>, sorted: Vec<Minimum>, apart_mm: f64) -> Vec<Minimum> {
    let mut kept: Vec<Minimum> = Vec::new();
    for minimum in sorted {
        if kept.iter().all(|other| seen.apart_mm(&other.pose, &minimum.pose) > apart_mm) {
            kept.push(minimum);
        }
    }
    kept
}

/// The place at which a registration from the start comes to rest; `None` if it finds no pairs.
pub(super) fn settled(
    target: &Target,
    source: &Cloud,
    start: &Isometry3<f64>,
    params: &SlideParams,
) -> Option<Isometry3<f64>> {
    let params = IcpParams { max_pair_distance_mm: START_PAIR_MM, ..icp_params(params) };
    register(Method::PointToPlane, target, source.into(), start, &params).ok()
}

/// The registration iterated from its own result, so that neither gate nor visible side are those of a start.
///
/// Onto the triangles where the target has them: among samples, a point-to-plane registration of a shaft has several stationary
/// points some hundredths of a millimetre apart.
pub(super) fn finished(
    target: &Target,
    source: &Cloud,
    pose: &Isometry3<f64>,
    params: &SlideParams,
) -> Result<Isometry3<f64>, Refusal> {
    let method = if target.mesh().is_some() { Method::PointToMesh } else { Method::PointToPlane };
    let tight = IcpParams { levels: Vec::new(), stop_step_mm: 1e-4, stop_step_rad: 1e-6, ..icp_params(params) };
    let mut pose = *pose;
    for _ in 0..N_ITERATED {
        let next = register(method, target, source.into(), &pose, &tight)?;
        let moved = next * pose.inverse();
        let centre = pose * source.points()[0];
        pose = next;
        if (moved * centre - centre).norm() < SETTLED_MM && moved.rotation.angle() < SETTLED_RAD {
            break;
        }
    }
    Ok(pose)
}

/// The registration beside the start where a motion is undetermined: along the bone, around it, or both.
pub(super) fn beside(
    seen: &Scene<'_>,
    axis: &LongAxis,
    start: &Isometry3<f64>,
    best: &Isometry3<f64>,
    is_open: [bool; 2],
    params: &SlideParams,
) -> Result<Isometry3<f64>, Refusal> {
    let [along_mm, turn_rad] = axis.offset(seen, best, start);
    let kept = |is_open: bool, offset: f64| if is_open { offset } else { 0.0 };
    let pose = axis.moved(best, kept(is_open[0], along_mm), kept(is_open[1], turn_rad));
    finished(seen.target, seen.source, &pose, params)
}

fn register(
    method: Method,
    target: &Target,
    source: Source<'_>,
    start: &Isometry3<f64>,
    params: &IcpParams,
) -> Result<Isometry3<f64>, Refusal> {
    let observer = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
    let fit = icp::register(method, target, source, start, params, observer).map_err(Refusal::of)?;
    Ok(fit.t_target_source)
}

fn icp_params(params: &SlideParams) -> IcpParams {
    IcpParams { max_pair_distance_mm: PAIR_MM, noise_mm: params.noise_mm, ..IcpParams::default() }
}

/// Poses at which a grid of starts comes to rest on the map, best first.
fn on_map(seen: &Scene<'_>, axis: &LongAxis, centre: &Isometry3<f64>, params: &SlideParams) -> Vec<Isometry3<f64>> {
    let map = seen.target.index().near_map(seen.target);
    let thinned = |n: usize| Points::thinned(&seen.points, n, &seen.centroid, seen.camera);
    let (few, some) = (thinned(N_SCORED), thinned(N_MAPPED));
    let placed = |pose: &Isometry3<f64>| -> Placed {
        Placed::from_parts((pose * seen.centroid - map.centre()).into(), pose.rotation)
    };
    let steps = |reach: f64, step: f64| {
        let n = (reach / step).floor() as i32;
        (-n..=n).map(move |k| f64::from(k) * step)
    };
    let turns = || steps(params.around_deg, STEP_DEG).map(f64::to_radians);
    let starts: Vec<Placed> = steps(params.along_mm, STEP_MM)
        .flat_map(|along_mm| turns().map(move |turn_rad| (along_mm, turn_rad)))
        .map(|(along_mm, turn_rad)| placed(&axis.moved(centre, along_mm, turn_rad)))
        .collect();
    let better = |starts: &[Placed], points: &Points, reach_mm: f64, n_steps: usize| {
        coarse::distinct(descended(map, points, starts, reach_mm, n_steps), points, 8, APART_MM, N_REFINED)
    };
    let near = better(&starts, &few, FIRST_REACH_MM, 4);
    let near = better(&near, &some, LAST_REACH_MM, 8);
    near.iter().map(|placed| motion(map, &seen.centroid, placed)).collect()
}
