use crate::icp::{self, IcpParams, Method};
use crate::kabsch::centroid;
use crate::target::Target;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_geometry::Cloud;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Number of scan points by which a start is scored, and by which it is refined.
const N_SCORED: usize = 200;
const N_REFINED: usize = 600;

/// Number of surface points on which starts are scored and first refined: searches far from a denser one take longer.
const THINNED: usize = 10_000;

/// Minimum ratio of length to width of a scan whose long axis can be laid along the bone.
const MIN_ELONGATION: f64 = 1.5;

/// Distance of the centroid of one face of a shaft from the shaft's axis, as a share of its mean radius.
const FACE_OFFSET: f64 = 0.6;

/// Maximum distance counted for a point while starts are scored, mm: the distance between neighbouring starts.
const START_REACH_MM: f64 = 6.0;

/// Maximum distance counted for a point at the end, mm: soft tissue must not decide.
const END_REACH_MM: f64 = 2.0;

/// Minimum RMS distance between the points of two distinct registrations, mm.
const APART_MM: f64 = 4.0;

/// Spacing and number of the starts of [`global()`].
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GlobalParams {
    /// Distance between starts along the bone, mm. 5: the capture range of an ICP.
    #[schemars(range(min = 0.5, max = 100.0))]
    pub slide_mm: f64,
    /// Number of starts around the bone. 24: 15 degrees apart, half of which an ICP captures.
    #[schemars(range(min = 4, max = 360))]
    pub n_turns: usize,
    /// Maximum number of starts that are refined, each the best of its neighbours. 60: as many as a fibula has at these
    /// steps.
    #[schemars(range(min = 1, max = 10_000))]
    pub n_refined: usize,
}

impl Default for GlobalParams {
    fn default() -> Self {
        Self { slide_mm: 5.0, n_turns: 24, n_refined: 60 }
    }
}

/// A registration by shape alone.
#[derive(Debug, Clone, PartialEq)]
pub struct GlobalFit {
    /// The motion that takes the scan onto the surface.
    pub t_target_source: Isometry3<f64>,
    /// Score and runner-up.
    pub report: GlobalReport,
}

/// Score and runner-up of a registration by shape alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GlobalReport {
    /// Number of starts tried.
    pub n_tried: usize,
    /// Number of starts refined.
    pub n_refined: usize,
    /// RMS distance of the scan from the surface, with distances limited to 2 mm, mm.
    pub score_mm: f64,
    /// The best distinct registration, if there is one.
    pub runner_up: Option<RunnerUp>,
    /// Margin over the runner-up: `1 - score / runner-up's score`; 0 is ambiguous, 1 if there is no runner-up.
    pub clearness: f64,
}

/// The best distinct registration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunnerUp {
    /// Its score, mm.
    pub score_mm: f64,
    /// Distance of the scan's centroid from that of the answer, mm.
    pub shift_mm: f64,
    /// Angle to the answer, rad.
    pub turn_rad: f64,
}

/// Errors of [`global()`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GlobalError {
    /// The scan is too small.
    #[error(
        "the scan has {n} points, {needed} are needed to tell its shape; is the region of interest around the bone?"
    )]
    TooFew {
        /// Points found.
        n: usize,
        /// Points needed.
        needed: usize,
    },
    /// The scan has no long axis.
    #[error(
        "the scan is {elongation:.1} times as long as wide, {needed} is needed to lay it along the bone; scan more of the \
         shaft, or use landmarks (coarse.three_point)"
    )]
    NoDirection {
        /// Ratio of length to width found.
        elongation: f64,
        /// Ratio needed.
        needed: f64,
    },
    /// No start reached the surface.
    #[error("none of {n_tried} starts came to lie on the surface; are scan and surface of the same bone, both in mm?")]
    Nowhere {
        /// Number of starts tried.
        n_tried: usize,
    },
}

/// Registers a scan of a long bone to its surface by shape alone.
///
/// The scan's long axis is laid along the bone's centre line both ways, in steps along it and in turns about it. Starts
/// that score better than their neighbours are refined, and the best refined one is the answer. The side from which the
/// scan was seen (its viewpoint, else the way it bulges) is turned outward. A shaft is nearly a cylinder, so the answer
/// may be wrong along or about it although it fits well; the report gives the score of the runner-up. The result does
/// not depend on the number of threads.
///
/// # Errors
/// [`GlobalError`] if the scan is too small or as wide as long, or nothing fits anywhere.
///
/// # Source
/// Multi-start ICP, as Besl and McKay 1992, section IV-B, with starts along the principal axes.
pub fn global(target: &Target, source: &Cloud, params: &GlobalParams) -> Result<GlobalFit, GlobalError> {
    let scan = Scan::new(source)?;
    let rough = thin(target);
    let stations = stations(rough.points(), scan.half_length_mm, params.slide_mm);
    let starts: Vec<Start> = (0..stations.len())
        .flat_map(|station| (0..2 * params.n_turns).map(move |turn| Start { station, turn }))
        .collect();
    let place = |start: &Start| stations[start.station].place(&scan, start.turn, params.n_turns);
    let few = thinned(source.points(), N_SCORED);
    let scores: Vec<f64> = starts.par_iter().map(|s| score(&rough, &few, &place(s), START_REACH_MM)).collect();
    let mut best: Vec<usize> = (0..starts.len()).filter(|&k| starts[k].is_best(&scores, params.n_turns)).collect();
    best.sort_by(|&a, &b| scores[a].total_cmp(&scores[b]).then(a.cmp(&b)));
    best.truncate(params.n_refined);
    let some = thinned(source.points(), N_REFINED);
    let mut ends: Vec<(f64, Isometry3<f64>)> = best
        .par_iter()
        .filter_map(|&k| {
            let near = refined(&rough, &some, &place(&starts[k]), 2.0 * START_REACH_MM)?;
            let end = refined(target, &some, &near, END_REACH_MM)?;
            Some((score(target, &some, &end, END_REACH_MM), end))
        })
        .collect();
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(&(score_mm, t_target_source)) = ends.first() else {
        return Err(GlobalError::Nowhere { n_tried: starts.len() });
    };
    let apart = |other: &Isometry3<f64>| {
        let squares: f64 = some.iter().map(|p| (other * p - t_target_source * p).norm_squared()).sum();
        (squares / some.len() as f64).sqrt()
    };
    let runner_up = ends.iter().find(|(_, end)| apart(end) > APART_MM).map(|(score_mm, end)| RunnerUp {
        score_mm: *score_mm,
        shift_mm: (end * scan.middle - t_target_source * scan.middle).norm(),
        turn_rad: (end.rotation * t_target_source.rotation.inverse()).angle(),
    });
    let clearness = runner_up.as_ref().map_or(1.0, |other| 1.0 - score_mm / other.score_mm.max(f64::MIN_POSITIVE));
    let report = GlobalReport { n_tried: starts.len(), n_refined: ends.len(), score_mm, runner_up, clearness };
    Ok(GlobalFit { t_target_source, report })
}

/// The scan's centroid, long axis and the side from which it was seen.
struct Scan {
    middle: Point3<f64>,
    along: Vector3<f64>,
    outward: Vector3<f64>,
    half_length_mm: f64,
}

impl Scan {
    fn new(source: &Cloud) -> Result<Self, GlobalError> {
        let points = source.points();
        if points.len() < N_SCORED {
            return Err(GlobalError::TooFew { n: points.len(), needed: N_SCORED });
        }
        let (middle, axes, spread) = principal(points);
        let elongation = (spread[0] / spread[1].max(f64::MIN_POSITIVE)).sqrt();
        if elongation < MIN_ELONGATION {
            return Err(GlobalError::NoDirection { elongation, needed: MIN_ELONGATION });
        }
        let along = axes[0];
        let across = |v: Vector3<f64>| (v - along * v.dot(&along)).try_normalize(1e-6);
        let seen = source.viewpoint.and_then(|t| across(t * Point3::origin() - middle));
        // The way it bulges: points far out to both sides lie lower.
        let bulge: f64 = points.iter().map(|p| (p - middle).dot(&axes[1]).powi(2) * (p - middle).dot(&axes[2])).sum();
        let outward = seen.unwrap_or(axes[2] * if bulge > 0.0 { -1.0 } else { 1.0 });
        let heights = points.iter().map(|p| (p - middle).dot(&along));
        let (min, max) = heights.fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(h), b.max(h)));
        Ok(Self { middle, along, outward, half_length_mm: (max - min) / 2.0 })
    }
}

/// Centroid, axes and variances of points, the longest first.
fn principal(points: &[Point3<f64>]) -> (Point3<f64>, [Vector3<f64>; 3], [f64; 3]) {
    let middle = centroid(points);
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
    let eigen = (scatter / points.len().max(1) as f64).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[j].total_cmp(&eigen.eigenvalues[i]).then(i.cmp(&j)));
    (middle, order.map(|k| eigen.eigenvectors.column(k).into_owned()), order.map(|k| eigen.eigenvalues[k]))
}

/// A position on the bone's centre line where a scan's centroid may lie.
struct Station {
    middle: Point3<f64>,
    along: Vector3<f64>,
    /// Perpendicular to the bone: turns are counted from it.
    side: Vector3<f64>,
    radius_mm: f64,
}

impl Station {
    /// Turns from `n_turns` on are with the scan reversed end for end.
    fn place(&self, scan: &Scan, turn: usize, n_turns: usize) -> Isometry3<f64> {
        let along = if turn < n_turns { self.along } else { -self.along };
        let angle = (turn % n_turns) as f64 / n_turns as f64 * std::f64::consts::TAU;
        let outward = self.side * angle.cos() + self.along.cross(&self.side) * angle.sin();
        let axes = |z: &Vector3<f64>, x: &Vector3<f64>| Rotation3::from_basis_unchecked(&[*x, z.cross(x), *z]);
        let turned = axes(&along, &outward) * axes(&scan.along, &scan.outward).inverse();
        let rotation = UnitQuaternion::from_rotation_matrix(&turned);
        let middle = self.middle + outward * (FACE_OFFSET * self.radius_mm);
        Isometry3::from_parts((middle.coords - rotation * scan.middle.coords).into(), rotation)
    }
}

/// Positions along the bone at which at least half of the scan lies on it.
fn stations(points: &[Point3<f64>], half_length_mm: f64, slide_mm: f64) -> Vec<Station> {
    let (middle, axes, _) = principal(points);
    let height = |p: &Point3<f64>| (p - middle).dot(&axes[0]);
    let (min, max) = points.iter().map(height).fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(h), b.max(h)));
    let n = ((max - min) / slide_mm).ceil() as usize + 1;
    (0..n)
        .filter_map(|k| {
            let at = min + k as f64 * slide_mm;
            let near: Vec<Point3<f64>> =
                points.iter().filter(|p| (height(p) - at).abs() <= half_length_mm).copied().collect();
            if near.len() < 10 {
                return None;
            }
            let (local, local_axes, _) = principal(&near);
            // A piece as short as wide has no axis; use that of the bone.
            let bend = local_axes[0].dot(&axes[0]);
            let along = if bend.abs() > 0.8 { local_axes[0] * bend.signum() } else { axes[0] };
            let side = (axes[1] - along * axes[1].dot(&along)).try_normalize(1e-6)?;
            let from_line = |p: &Point3<f64>| (p - local - along * (p - local).dot(&along)).norm();
            let radius_mm = near.iter().map(from_line).sum::<f64>() / near.len() as f64;
            Some(Station { middle: local + along * ((middle - local).dot(&along) + at), along, side, radius_mm })
        })
        .collect()
}

/// One start, by its indices.
struct Start {
    station: usize,
    turn: usize,
}

impl Start {
    /// Whether no neighbouring start is better; the first in case of a tie.
    fn is_best(&self, scores: &[f64], n_turns: usize) -> bool {
        let at = |station: usize, turn: usize| station * 2 * n_turns + turn;
        let own = at(self.station, self.turn);
        let (half, turn) = (self.turn / n_turns, self.turn % n_turns);
        let stations = self.station.saturating_sub(1)..=self.station + 1;
        stations.flat_map(|s| [n_turns - 1, 0, 1].map(|d| at(s, half * n_turns + (turn + d) % n_turns))).all(|other| {
            scores.get(other).is_none_or(|score| scores[own].total_cmp(score).then(own.cmp(&other)).is_le())
        })
    }
}

/// About `n` points, evenly through their order.
fn thinned(points: &[Point3<f64>], n: usize) -> Vec<Point3<f64>> {
    points.iter().step_by(points.len().div_ceil(n).max(1)).copied().collect()
}

/// The surface with fewer points, drawn evenly from its own.
fn thin(target: &Target) -> Target {
    let n = target.points().len().div_ceil(THINNED).max(1);
    let points: Vec<Point3<f64>> = target.points().iter().step_by(n).copied().collect();
    let normals = target.normals().map(|normals| normals.iter().step_by(n).copied().collect::<Vec<_>>().into());
    Target::new(target.frame.clone(), target.origin, points, normals).unwrap_or_else(|_| target.clone())
}

/// RMS distance of the moved points from the surface, with distances limited to `reach_mm`.
fn score(target: &Target, points: &[Point3<f64>], t_target_source: &Isometry3<f64>, reach_mm: f64) -> f64 {
    let square = |p: &Point3<f64>| {
        let moved = t_target_source * p;
        let Some((index, distance)) = target.nearest(&moved, reach_mm) else { return reach_mm * reach_mm };
        let along = target.normals().map(|normals| (moved - target.points()[index]).dot(&normals[index]));
        along.unwrap_or(distance).powi(2)
    };
    (points.iter().map(square).sum::<f64>() / points.len().max(1) as f64).sqrt()
}

/// A registration from a start with pairs no farther than `reach_mm`; `None` if there are too few.
fn refined(target: &Target, points: &[Point3<f64>], start: &Isometry3<f64>, reach_mm: f64) -> Option<Isometry3<f64>> {
    let method = if target.normals().is_some() { Method::PointToPlane } else { Method::PointToPoint };
    let params = IcpParams {
        max_pair_distance_mm: reach_mm,
        levels: Vec::new(),
        max_iterations: 40,
        stop_step_mm: 0.01,
        stop_step_rad: 1e-4,
        ..IcpParams::default()
    };
    let fit = icp::register(method, target, points, start, &params, &mut |_| ControlFlow::Continue(()));
    fit.ok().map(|fit| fit.t_target_source)
}
