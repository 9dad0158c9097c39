//! Fine registration of a scanned surface onto a prepared target.

mod acceleration;
mod observability;
mod pairing;
mod run;
mod surface;
#[cfg(test)]
mod tests;

pub use observability::{Observability, WeakDirection};

use crate::target::Target;
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Cloud;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// What moves: the points of a scan, mm, and where the camera that took it stood, where known.
///
/// Made from a slice of points or from a [`Cloud`], whose viewpoint it takes. With a camera, points pair only with the
/// side of the target that faces it: a scan that starts some millimetres deep in a thin bone would else be drawn to the
/// far side. A cloud merged from several views has no viewpoint, and pairs with all of the target.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    points: &'a [Point3<f64>],
    camera: Option<Point3<f64>>,
}

impl<'a> Source<'a> {
    /// Points taken by a camera that stood at `camera`, mm, in the points' frame.
    pub fn seen_from(points: &'a [Point3<f64>], camera: Point3<f64>) -> Self {
        Self { points, camera: Some(camera) }
    }
}

impl<'a> From<&'a [Point3<f64>]> for Source<'a> {
    fn from(points: &'a [Point3<f64>]) -> Self {
        Self { points, camera: None }
    }
}

impl<'a> From<&'a Vec<Point3<f64>>> for Source<'a> {
    fn from(points: &'a Vec<Point3<f64>>) -> Self {
        Self { points, camera: None }
    }
}

impl<'a> From<&'a Cloud> for Source<'a> {
    fn from(cloud: &'a Cloud) -> Self {
        Self { points: cloud.points(), camera: cloud.viewpoint.map(|v| v.translation.vector.into()) }
    }
}

/// How an ICP pairs, weighs and stops; the same for every variant.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct IcpParams {
    /// Pairs farther apart are not used, mm. 5: twice the largest error of a three-point fit to laser holes, and less
    /// than half the thickness of a fibula, so that no point pairs with the far side.
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub max_pair_distance_mm: f64,
    /// Share of the pairs, the worst first, that a step leaves out. 0: a cropped scan of bare bone shows nothing else.
    #[schemars(range(min = 0.0, max = 0.9))]
    pub trim_fraction: f64,
    /// Give up after so many steps, all levels together. 500: two to ten times what real bones take.
    #[schemars(range(min = 1, max = 100000))]
    pub max_iterations: u32,
    /// Converged where the way still to go, as estimated from the last steps, is shorter than this, mm. 0.01: a tenth
    /// of what the tracker can tell. A step is the RMS movement of the source points.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub stop_step_mm: f64,
    /// Stop, too, where the RMS residual changes by less than this in a step, mm. 0: never. Close to a coarse fit the
    /// residual of a bone hardly changes while it still slides along its axis, so 0.01 here stops after three or four
    /// steps, millimetres away; the report then does not say converged.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub stop_residual_mm: f64,
    /// How many earlier steps the next one is extrapolated from (Anderson). 5: as in the literature; 0: plain steps only,
    /// without leaps along the normals either, which takes hundreds of steps for `point_to_point`, where each step recovers
    /// 0.1 % of a slide along the bone.
    #[schemars(range(min = 0, max = 5))]
    pub acceleration: u32,
    /// First run on every n-th source point until converged, then on all. 8: saves most of the time and ends in the
    /// same place; 1: all points from the start.
    #[schemars(range(min = 1, max = 1000))]
    pub first_every: u32,
    /// Fewer pairs than this are an error. 10: six unknowns and something left to judge them by.
    #[schemars(range(min = 3, max = 1000000))]
    pub min_pairs: u32,
}

impl Default for IcpParams {
    fn default() -> Self {
        Self {
            max_pair_distance_mm: 5.0,
            trim_fraction: 0.0,
            max_iterations: 500,
            stop_step_mm: 0.01,
            stop_residual_mm: 0.0,
            acceleration: 5,
            first_every: 8,
            min_pairs: 10,
        }
    }
}

/// Where an ICP ended.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpFit {
    /// The motion that takes the source onto the target.
    pub t_target_source: Isometry3<f64>,
    /// How it ended.
    pub report: IcpReport,
    /// How it got there.
    pub trace: IcpTrace,
}

/// Why an ICP stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// The way still to go is shorter than `stop_step_mm`.
    Step,
    /// The residual changed by less than `stop_residual_mm`.
    Residual,
    /// `max_iterations` were used up.
    Iterations,
    /// No step lowers the residual any more, although the way still to go is not short.
    Stalled,
    /// The observer broke it off.
    Cancelled,
}

/// How an ICP ended. What it leaves is a surface residual, neither FRE nor TRE.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IcpReport {
    /// Whether `remaining_mm` is not above `stop_step_mm`: the variant has come to rest. A `point_to_point` may rest away
    /// from its least; see `resolution_mm` and `left_mm`.
    pub converged: bool,
    /// Why it stopped.
    pub stop_reason: StopReason,
    /// Steps taken, all levels together.
    pub iterations: u32,
    /// Source points.
    pub n_source: usize,
    /// Pairs that the last step used: near enough and not trimmed.
    pub n_pairs: usize,
    /// `n_pairs / n_source`.
    pub pair_share: f64,
    /// RMS over those pairs of what this variant minimises, mm: the distance between points (`point_to_point`), or
    /// along the target's normal (`point_to_plane`).
    pub rms_mm: f64,
    /// RMS over those pairs of the distance between points, mm.
    pub point_rms_mm: f64,
    /// RMS movement of the source points by the last step, mm.
    pub step_mm: f64,
    /// Turn of the last step, rad.
    pub step_rad: f64,
    /// Way still to go along the motions that the pairs hold, mm, as RMS movement of the source points: from the last
    /// pairs, `N⁺ Jᵀr` with `N` along the target's normals. A crawl of `point_to_point` shows here, however short its
    /// steps are.
    pub remaining_mm: Option<f64>,
    /// How far from its least a `point_to_point` can come to rest, mm, one standard deviation: its residual is rough, as
    /// points prefer to stay with the target samples they have. Denser samples make it finer. None for planes.
    pub resolution_mm: Option<f64>,
    /// What a `point_to_point` leaves although it has come to rest, mm: how far a first step along the target's normals
    /// would move the source from here (RMS of its points), mostly along the bone. None for planes.
    pub left_mm: Option<f64>,
    /// Which motions the pairs hold, and which they leave free.
    pub observability: Observability,
}

/// One step of an ICP, as its observer sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IcpStep {
    /// Counted from 1, all levels together.
    pub iteration: u32,
    /// Every n-th source point took part.
    pub every: u32,
    /// Pairs used.
    pub n_pairs: usize,
    /// RMS residual of the pairs before the step, mm.
    pub rms_mm: f64,
    /// RMS movement of the source points by the step, mm.
    pub step_mm: f64,
    /// Turn of the step, rad.
    pub step_rad: f64,
    /// Way still to go before the step, mm; see [`IcpReport::remaining_mm`].
    pub remaining_mm: Option<f64>,
    /// Whether the step was extrapolated.
    pub accelerated: bool,
    /// The motion after the step.
    pub t_target_source: Isometry3<f64>,
}

/// The steps of an ICP in order.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct IcpTrace {
    /// One entry for each step.
    pub steps: Vec<IcpStep>,
}

/// Why an ICP has no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IcpError {
    /// Too few source points lie near the target.
    #[error(
        "{n_pairs} of {n_source} source points lie within {max_pair_distance_mm} mm of the target, {min_pairs} are \
         needed; the nearest target point is {nearest_mm:.1} mm away: is init right, and are both in mm?"
    )]
    TooFewPairs {
        /// Pairs found.
        n_pairs: usize,
        /// Pairs needed.
        min_pairs: usize,
        /// Source points.
        n_source: usize,
        /// The limit.
        max_pair_distance_mm: f64,
        /// The distance of the source point that comes closest to the target.
        nearest_mm: f64,
    },
    /// There are not enough source points.
    #[error("{n_source} source points, {min_pairs} are needed; is the crop empty?")]
    TooFewPoints {
        /// Source points.
        n_source: usize,
        /// Needed.
        min_pairs: usize,
    },
    /// The variant needs normals that the target does not have.
    #[error("the target has no normals, which point_to_plane needs; sample it from a mesh or estimate them")]
    NoNormals,
    /// A source point or the start is NaN or infinite.
    #[error("{what} is not finite; drop such points before the registration")]
    NotFinite {
        /// What is not finite.
        what: String,
    },
    /// A parameter has a value that cannot be used.
    #[error("{parameter} is {value}, but {expected}")]
    Parameter {
        /// Its name.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
}

/// Registers `source` onto `target` by the distances between paired points, from `init`.
///
/// Each source point pairs with the nearest target point. A step along the target's normals or an extrapolated one is
/// taken where it lowers the residual, else Kabsch moves the source, as it always does with `acceleration = 0`; the last
/// steps are Kabsch's until the pairs stay. `O(n log m)` a step. The result does
/// not depend on the number of threads, nor (but for rounding) on the order of the points.
///
/// # Errors
/// [`IcpError`]; reaching the iteration limit is a result, with `converged = false`.
///
/// # Source
/// Besl and McKay 1992; section 2.3 of the paper. Its stop rule "E < 0.01 mm" cannot be read as a sum or as a mean above
/// the noise, so ours estimates the way still to go.
pub fn point_to_point<'a>(
    target: &Target,
    source: impl Into<Source<'a>>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<()>,
) -> Result<IcpFit, IcpError> {
    run::run(pairing::Residual::Point, target, source.into(), init, params, observer)
}

/// Registers `source` onto `target` by the distances along the target's normals, from `init`.
///
/// Each source point pairs with the nearest target point; a Gauss-Newton step on SE(3) about the source's centroid moves
/// the source. Slides along the surface freely, so it needs few steps. `O(n log m)` a step.
///
/// # Errors
/// [`IcpError`], and [`IcpError::NoNormals`] if the target has none.
///
/// # Source
/// Chen and Medioni 1992; Low 2004 for the linearisation.
pub fn point_to_plane<'a>(
    target: &Target,
    source: impl Into<Source<'a>>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<()>,
) -> Result<IcpFit, IcpError> {
    run::run(pairing::Residual::Plane, target, source.into(), init, params, observer)
}
