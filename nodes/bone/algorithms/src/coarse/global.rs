//! Registration by shape alone.

mod anywhere;
mod axis;
mod descent;
mod patches;
mod symmetry;

pub(crate) use descent::{Placed, Points, descended, distinct, motion};
pub(crate) use symmetry::symmetry;

use crate::Refusal;
use crate::downsample::thinned;
use crate::icp::{self, IcpParams, Method, Source};
use crate::kabsch::centroid;
use crate::tables::off_tables;
use crate::target::{NearMap, Side, Target};
use anywhere::{Effort, Ground, Shape, radius_of};
use axis::{Scan, stations};
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Cloud;
use osteoflow_node_macros::params;
use patches::patches;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::ops::ControlFlow;

/// Minimum number of points that tell the shape of a scan: twice as many as a pose has unknowns, which a step needs.
const MIN_POINTS: usize = 12;

/// Of fewer points than this the normals are not known.
const MIN_WITH_NORMALS: usize = 200;

/// Fewer points than this may not tell a scan from its mirror image.
const MIN_TO_TELL_SIDE: usize = 250;

/// Points closer together than this are one reading, mm.
const DISTINCT_MM: f64 = 1.0;

/// Standard deviations by which chance may lower the score of a wrong place of few points against another's.
const CHANCE_SIGMAS: f64 = 3.1;

/// Number of scan points by which every start is scored, by which the better ones are refined on the map, and by which the
/// best are registered.
const N_SCORED: usize = 250;
const N_MAPPED: usize = 1000;
const N_REGISTERED: usize = 1000;

/// Number of scan points by which the ends are compared.
const N_COMPARED: usize = 2500;

/// As many times the starts that are refined are first looked at more closely with few points; and as many times are refined and registered
/// where symmetries of the surface take the room of other places.
const MORE: usize = 5;

/// A scan is looked for along the bone alone if it is at least this many times as long as wide...
const SHAFT: f64 = 2.5;

/// ...and its best place leaves less than this share of the reach. Where a shaft fits so well, it fits as well where more starts lead.
const MISFIT: f64 = 0.25;

/// The reach at the end is at least this many standard deviations of what the best place leaves, by its better quarter, if that holds
/// nearly all.
const REACH_SIGMAS: f64 = 3.0;

/// A quarter of a Gaussian's absolute values are below this many standard deviations.
const QUARTER_SIGMAS: f64 = 0.318_639_363_964_375_15;

/// As many times the reach at most.
const MAX_REACH: f64 = 4.0;

/// Rivals of a place anywhere on a surface are also looked for at this distance from each other, as a share of the scan's radius.
const FAR: f64 = 0.4;

/// Patches of the scan are laid on the surface, too, if the best place leaves more than this share of the points, and is not clear...
const LEFT: f64 = 0.1;

/// ...or more than this, however clear it is.
const MUCH_LEFT: f64 = 0.4;

/// Radius of the balls that patches are cut out by, as a share of the scan's radius or the surface's, whichever is less; of the patches
/// themselves, as a share of that; and their number.
const PATCH: f64 = 0.5;
const PATCH_RADIUS: f64 = 0.8;
const N_PATCHES: usize = 16;

/// Clearness below which an answer may be wrong. 0.3: on real bones right answers had 0.4 and more, wrong ones 0.2 and less.
pub const CLEAR: f64 = 0.3;

/// What to do with surroundings in a scan.
pub(crate) const CROP: &str = "crop the scan to the bone (register: --box, --sphere, or --region with a region drawn on the page of \
                              osteoflow view; in a graph: crop.box)";

/// Spacing and number of the starts of [`global()`].
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct GlobalParams {
    /// Distance between starts along the bone. 10: a few steps on a coarse map recover half of it.
    #[param(10.0, 0.5..=100.0)]
    pub slide_mm: f64,
    /// Number of starts around the bone. 12: 30 degrees apart, of which these steps recover half.
    #[param(12, 4..=360)]
    pub n_turns: usize,
    /// Maximum number of starts that are refined on the map: the best at different places. 40: a fibula has fewer plausible
    /// ones.
    #[param(40, 1..=10_000)]
    pub n_refined: usize,
    /// Maximum number of refined starts that are registered: the best, at least 4 mm apart. 4: the right one and its rivals.
    #[param(4, 1..=1000)]
    pub n_registered: usize,
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
    /// RMS distance of the scan from the surface, mm, with distances limited to 2 mm; to more for a noisy scan, up to 8 mm, and to less for
    /// one smaller than a fingertip.
    pub score_mm: f64,
    /// The scan's centroid there, in the target's frame, mm.
    #[serde(default)]
    pub middle_mm: [f64; 3],
    /// The best distinct registration, if there is one; none of the surface's symmetries.
    pub runner_up: Option<RunnerUp>,
    /// The best distinct registration where the surface looks the same, by one of its symmetries.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<RunnerUp>,
    /// Margin over the runner-up: `1 - score / runner-up's score`; 0 is ambiguous, 1 if there is no runner-up. Surroundings, which count
    /// at both, lower it, and so do fewer than about 80 points, by as much as chance may.
    pub clearness: f64,
    /// Where the scan was looked for; null in reports of older versions.
    #[serde(default)]
    pub searched: Option<Searched>,
    /// The registration, if it was looked for by default parameters: a verdict need not look for it again.
    #[serde(default)]
    pub t_target_source: Option<Isometry3<f64>>,
}

/// The best distinct registration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunnerUp {
    /// Its score, mm.
    pub score_mm: f64,
    /// The scan's centroid there, in the target's frame, mm.
    #[serde(default)]
    pub middle_mm: [f64; 3],
    /// Distance of the scan's centroid from that of the answer.
    pub shift_mm: f64,
    /// Angle to the answer, rad.
    pub turn_rad: f64,
}

/// Distances for a scan of some size, mm.
#[derive(Clone, Copy)]
struct Reach {
    /// Maximum distance counted for a point while starts along a bone are scored: about half the distance between neighbouring
    /// ones.
    start: f64,
    /// On the way.
    mid: f64,
    /// Maximum distance of a pair in the last steps, and counted for a point at the end: soft tissue must not decide.
    end: f64,
    /// Starts that come to lie closer together than this on the map are one.
    same: f64,
    /// Minimum RMS distance between the points of two distinct registrations.
    apart: f64,
}

impl Reach {
    /// In mm for scans of more than a finger's width, else in shares of the scan.
    fn new(radius_mm: f64) -> Self {
        let unit = (radius_mm / 10.0).min(1.0);
        Self { start: 6.0 * unit, mid: 3.5 * unit, end: 2.0 * unit, same: 1.5 * unit, apart: 4.0 * unit }
    }
}

/// Where a scan is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Searched {
    /// Along a bone, turned about its axis.
    Along,
    /// In any orientation, anywhere on the surface.
    Anywhere,
    /// Both.
    Both,
    /// Both, and each of some patches of the scan anywhere, since surroundings may be in it.
    Among,
}

/// A scan in the numbers of points that the steps take.
struct Search<'a> {
    target: &'a Target,
    map: &'a NearMap,
    params: &'a GlobalParams,
    middle: Point3<f64>,
    radius_mm: f64,
    camera: Option<Point3<f64>>,
    reach: Reach,
    /// Number of points that are apart.
    n_distinct: usize,
    few: Points,
    some: Points,
    registered: Vec<Point3<f64>>,
    compared: Vec<Point3<f64>>,
}

impl<'a> Search<'a> {
    fn new(target: &'a Target, source: &Cloud, params: &'a GlobalParams) -> Self {
        let points = source.points();
        let middle = centroid(points);
        // An open surface may be inside out, and its side does not matter here.
        let camera = source.viewpoint.filter(|_| target.side() == Side::Outward).map(|t| t * Point3::origin());
        let radius_mm = radius_about(&middle, points);
        Self {
            target,
            map: target.index().near_map(target),
            params,
            middle,
            radius_mm,
            camera,
            reach: Reach::new(radius_mm),
            n_distinct: n_distinct(points),
            few: Points::thinned(points, N_SCORED, &middle, camera),
            some: Points::thinned(points, N_MAPPED, &middle, camera),
            registered: thinned(points, N_REGISTERED),
            compared: thinned(points, N_COMPARED),
        }
    }

    /// The starts after some steps on the map, the best `n` that are apart.
    fn better(
        &self,
        starts: &[Placed],
        points: &Points,
        reach_mm: f64,
        n_steps: usize,
        apart_mm: f64,
        n: usize,
    ) -> Vec<Placed> {
        // Four points of the scan's extent tell poses apart.
        distinct(descended(self.map, points, starts, reach_mm, n_steps), &self.few, 4, apart_mm, n)
    }

    /// Registrations from the best starts along the bone, and the number of all.
    fn along(&self, scan: &Scan) -> (Vec<End>, usize) {
        let (params, reach) = (self.params, &self.reach);
        let stations = stations(self.map, scan.half_length_mm, params.slide_mm);
        let starts: Vec<Placed> = stations
            .iter()
            .flat_map(|station| (0..2 * params.n_turns).map(|turn| station.place(scan, turn, params.n_turns)))
            .collect();
        let near = self.better(&starts, &self.few, reach.start, 3, reach.same, MORE * params.n_refined);
        let near = self.better(&near, &self.few, reach.mid, 8, reach.same, params.n_refined);
        let near = self.better(&near, &self.some, reach.end, 8, reach.apart, params.n_registered);
        (self.ends(&near), starts.len())
    }

    /// Registrations from the best starts anywhere, and the number of all.
    fn anywhere(&self, source: &Cloud) -> (Vec<End>, usize) {
        let mut shape = Shape::new(source.points(), &self.middle, self.camera);
        if source.points().len() < MIN_WITH_NORMALS {
            shape = shape.without_normals();
        }
        let (starts, n_tried) = Ground::new(self.target, shape.radius_mm).laid(&shape, &Effort::WHOLE);
        (self.settled(&starts, shape.radius_mm), n_tried)
    }

    /// Registrations from the best starts of patches of the scan, and the number of all.
    fn among(&self, source: &Cloud) -> (Vec<End>, usize) {
        let patch_mm = PATCH * self.radius_mm.min(radius_of(self.map.samples()));
        let patches = patches(source.points(), patch_mm, N_PATCHES);
        let ground = Ground::new(self.target, PATCH_RADIUS * patch_mm);
        let effort = Effort::of_patch(patches.len());
        let one = |patch: &Vec<Point3<f64>>| {
            let middle = centroid(patch);
            let (mut starts, n_tried) = ground.laid(&Shape::of_patch(patch, &middle, self.camera), &effort);
            // Of the patch about its centroid; from here on of the scan about that of the scan.
            for start in &mut starts {
                start.translation.vector -= start.rotation * (middle - self.middle);
            }
            (starts, n_tried)
        };
        let laid: Vec<(Vec<Placed>, usize)> = patches.par_iter().map(one).collect();
        let n_tried = laid.iter().map(|(_, n)| n).sum();
        let starts: Vec<Placed> = laid.into_iter().flat_map(|(starts, _)| starts).collect();
        (self.settled(&starts, self.radius_mm), n_tried)
    }

    /// Registrations from the best of these starts, near ones and far ones.
    fn settled(&self, starts: &[Placed], radius_mm: f64) -> Vec<End> {
        let ends = descended(self.map, &self.few, starts, self.reach.mid, 8);
        // Rivals are looked for far away, too, as near ones may all come to lie in one place.
        let n_far = self.params.n_refined / 2;
        let far_mm = self.reach.apart.max(FAR * radius_mm);
        let mut near = distinct(ends.clone(), &self.few, 4, self.reach.same, self.params.n_refined - n_far);
        near.extend(distinct(ends, &self.few, 4, far_mm, n_far));
        let ends = descended(self.map, &self.some, &near, self.reach.end, 8);
        let n_far = self.params.n_registered.div_ceil(2);
        let mut near = distinct(ends.clone(), &self.few, 4, far_mm, n_far);
        for one in distinct(ends, &self.few, 4, self.reach.apart, self.params.n_registered) {
            if !near.contains(&one) {
                near.push(one);
            }
        }
        self.ends(&near)
    }

    /// Registrations from poses on the map.
    fn ends(&self, near: &[Placed]) -> Vec<End> {
        let reach_mm = self.reach.end;
        let one = |placed: &Placed| {
            let start = motion(self.map, &self.middle, placed);
            let pose = refined(self.target, &self.registered, &start, self.camera, reach_mm)?;
            Some(End { score_mm: score(self.target, &self.compared, &pose, reach_mm), reach_mm, pose })
        };
        near.par_iter().filter_map(one).collect()
    }

    /// Sorts the ends by their scores, best first, with the reach that the best of them asks for.
    fn sort(&self, ends: &mut [End]) {
        let least_mm = self.reach.end;
        self.score(ends, least_mm);
        let Some(best) = ends.first() else { return };
        let mut distances: Vec<f64> =
            self.compared.iter().map(|p| distance_mm(self.target, p, &best.pose, MAX_REACH * least_mm)).collect();
        let quarter = distances.len() / 4;
        let sigma_mm = *distances.select_nth_unstable_by(quarter, f64::total_cmp).1 / QUARTER_SIGMAS;
        let reach_mm = (REACH_SIGMAS * sigma_mm).min(MAX_REACH * least_mm);
        let beyond = distances.iter().filter(|mm| **mm >= reach_mm).count() as f64;
        // Noise leaves next to nothing beyond; what does is surroundings, which must not be taken for noise.
        if reach_mm > least_mm && beyond <= LEFT * distances.len() as f64 {
            self.score(ends, reach_mm);
        }
    }

    /// Scores the ends with distances limited to `reach_mm`, unless they are, and sorts them, best first.
    fn score(&self, ends: &mut [End], reach_mm: f64) {
        ends.par_iter_mut().filter(|end| end.reach_mm != reach_mm).for_each(|end| {
            end.score_mm = score(self.target, &self.compared, &end.pose, reach_mm);
            end.reach_mm = reach_mm;
        });
        ends.sort_by(|a, b| a.score_mm.total_cmp(&b.score_mm));
    }

    /// Whether so much is off the surface at the best of the sorted ends that surroundings may be in the scan, and hide the bone.
    fn may_be_among_others(&self, ends: &[End]) -> bool {
        let Some(best) = ends.first() else { return true };
        let off = self.off_mm(best);
        let left = off.iter().filter(|mm| **mm >= best.reach_mm).count() as f64 / off.len().max(1) as f64;
        let is_clear = || self.rival(ends).is_none_or(|rival| self.clearness_of_near(best, rival) >= CLEAR);
        left > MUCH_LEFT || (left > LEFT && !is_clear())
    }

    /// Distances of the points from the surface, limited to the reach of the score, mm.
    fn off_mm(&self, end: &End) -> Vec<f64> {
        self.compared.iter().map(|p| distance_mm(self.target, p, &end.pose, end.reach_mm)).collect()
    }

    /// Clearness by the points that are near the surface at either place: surroundings do not lower it.
    fn clearness_of_near(&self, best: &End, rival: &End) -> f64 {
        let (mut squares, mut rivals) = (0.0, 0.0);
        for (mm, rival_mm) in self.off_mm(best).into_iter().zip(self.off_mm(rival)) {
            if mm < best.reach_mm || rival_mm < rival.reach_mm {
                squares += mm * mm;
                rivals += rival_mm * rival_mm;
            }
        }
        1.0 - (squares / rivals.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// The best of the sorted ends that is another place than the first.
    fn rival<'b>(&self, ends: &'b [End]) -> Option<&'b End> {
        let (best, others) = ends.split_first()?;
        others.iter().find(|end| self.apart_mm(&end.pose, &best.pose) > self.reach.apart)
    }

    /// The best of the sorted ends that is another place than the first and that no symmetry of the surface leads to, and the best that one
    /// leads to. What is clearly worse is not asked.
    fn rival_and_twin<'b>(&self, ends: &'b [End]) -> [Option<&'b End>; 2] {
        let mut twin = None;
        let Some((best, others)) = ends.split_first() else { return [None; 2] };
        let is_apart = |end: &&End| self.apart_mm(&end.pose, &best.pose) > self.reach.apart;
        let is_rival = |end: &&'b End| {
            let is_twin = best.clearness(end, self.n_distinct) < CLEAR && self.is_twin(best, end);
            twin = twin.or_else(|| is_twin.then_some(*end));
            !is_twin
        };
        [others.iter().filter(is_apart).find(is_rival), twin]
    }

    fn is_twin(&self, best: &End, other: &End) -> bool {
        symmetry(self.target, &(other.pose * best.pose.inverse())).is_some_and(|symmetry| {
            let image = symmetry * best.pose;
            self.apart_mm(&image, &other.pose) <= self.reach.apart
                && self.apart_mm(&image, &best.pose) > self.reach.apart
        })
    }

    fn apart_mm(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let squares: f64 = self.registered.iter().map(|p| (a * p - b * p).norm_squared()).sum();
        (squares / self.registered.len() as f64).sqrt()
    }
}

/// A registration from a start, and its score.
struct End {
    score_mm: f64,
    /// Distances are limited to this in the score, mm.
    reach_mm: f64,
    pose: Isometry3<f64>,
}

impl End {
    /// Margin over a rival; see [`GlobalReport`].
    fn clearness(&self, rival: &Self, n_distinct: usize) -> f64 {
        (1.0 - by_chance(n_distinct) * self.score_mm / rival.score_mm.max(f64::MIN_POSITIVE)).max(0.0)
    }
}

/// Whether there are so few points that a place and its mirror image look alike on many bones.
pub(crate) fn is_sparse(points: &[Point3<f64>]) -> bool {
    points.len() < MIN_TO_TELL_SIDE
}

/// RMS distance of points from their centroid, mm.
fn radius_about(middle: &Point3<f64>, points: &[Point3<f64>]) -> f64 {
    let squares: f64 = points.iter().map(|p| (p - middle).norm_squared()).sum();
    (squares / points.len().max(1) as f64).sqrt()
}

/// Number of cells that the points are in.
fn n_distinct(points: &[Point3<f64>]) -> usize {
    let cell = |p: &Point3<f64>| p.coords.map(|c| (c / DISTINCT_MM).floor() as i64);
    thinned(points, N_COMPARED).iter().map(cell).collect::<HashSet<_>>().len()
}

/// The factor by which chance may lower a score against another's: the upper 1 in 1000 of the ratio of two standard deviations, each of
/// as many residuals as there are points less the unknowns, over that at which [`CLEAR`] answers were judged.
fn by_chance(n_points: usize) -> f64 {
    let n_free = (n_points as f64 - 6.0).max(1.0);
    ((1.0 - CLEAR) * (CHANCE_SIGMAS / n_free.sqrt()).exp()).max(1.0)
}

/// Registers a scan to a surface by shape alone.
///
/// The long axis of a scan that is 1.5 times as long as wide is laid along the bone's centre line both ways, in steps along it and in
/// turns about it. A scan that is less than 2.5 times as long as wide, and one that fits badly so, is laid in any orientation anywhere on the
/// surface: points of it onto samples of the surface with their normals, in turns about these. Starts that score better than their
/// neighbours are refined, and the best refined one of both searches is the answer, by one score. Where that leaves
/// much of the scan off the surface, patches of it are laid anywhere, too. Planes on which the scan is wider than the whole
/// surface are left out ([`off_tables`]). The side from which a long
/// scan was seen (its viewpoint, else the way it bulges) is turned outward. A shaft is nearly a cylinder, so the answer
/// may be wrong along or about it although it fits well; the report gives the score of the runner-up. The result does
/// not depend on the number of threads.
///
/// # Errors
/// [`Refusal`] if the scan is too small, or nothing fits anywhere.
///
/// # Source
/// Multi-start ICP, as Besl and McKay 1992, section IV-B, with starts along the principal axes. Oriented points as bases: Drost
/// et al. 2010; theirs vote for pairs of points, ours are scored by the distance of the others from the surface.
pub fn global(target: &Target, source: &Cloud, params: &GlobalParams) -> Result<GlobalFit, Refusal> {
    let fit = global_by(target, source, params, None)?;
    if fit.report.twin.is_none() || fit.report.runner_up.is_some() {
        return Ok(fit);
    }
    // Images of one place took the room of its rivals.
    let more =
        GlobalParams { n_refined: MORE * params.n_refined, n_registered: MORE * params.n_registered, ..params.clone() };
    let mut fit = global_by(target, source, &more, None)?;
    fit.report.t_target_source = (*params == GlobalParams::default()).then_some(fit.t_target_source);
    Ok(fit)
}

/// [`global()`], by the searches that are named if any are.
pub(crate) fn global_by(
    target: &Target,
    source: &Cloud,
    params: &GlobalParams,
    searched: Option<Searched>,
) -> Result<GlobalFit, Refusal> {
    let n = source.points().len();
    if n < MIN_POINTS {
        return Err(Refusal::of(format!(
            "the scan has {n} points, {MIN_POINTS} are needed to tell its shape; is the region of interest around the bone?"
        )));
    }
    let rest = off_tables(target, source);
    let source = rest.as_ref().unwrap_or(source);
    let search = Search::new(target, source, params);
    let long = Scan::new(source).filter(|_| searched != Some(Searched::Anywhere));
    let (mut ends, mut n_tried) = long.as_ref().map_or_else(Default::default, |scan| search.along(scan));
    let is_along = match searched {
        Some(searched) => searched == Searched::Along && long.is_some(),
        None => {
            let is_shaft = long.as_ref().is_some_and(|scan| scan.elongation >= SHAFT);
            is_shaft && ends.iter().any(|end| end.score_mm < MISFIT * search.reach.end)
        }
    };
    if !is_along {
        let (more, n_more) = search.anywhere(source);
        ends.extend(more);
        n_tried += n_more;
    }
    search.sort(&mut ends);
    let is_among = searched.map_or_else(|| search.may_be_among_others(&ends), |searched| searched == Searched::Among);
    if is_among {
        let (more, n_more) = search.among(source);
        ends.extend(more);
        n_tried += n_more;
        search.sort(&mut ends);
    }
    let searched = match (is_among, long.is_some(), is_along) {
        (true, ..) => Searched::Among,
        (_, _, true) => Searched::Along,
        (_, true, false) => Searched::Both,
        (_, false, false) => Searched::Anywhere,
    };
    let Some(best @ &End { score_mm, pose, .. }) = ends.first() else {
        return Err(Refusal::of(format!(
            "none of {n_tried} starts came to lie on the surface; are scan and surface of the same bone, both in mm? If \
             surroundings are in the scan, {CROP}"
        )));
    };
    let middle = search.middle;
    let [rival, twin] = search.rival_and_twin(&ends);
    let clearness = rival.map_or(1.0, |rival| best.clearness(rival, search.n_distinct));
    let told = |end: &End| RunnerUp {
        score_mm: end.score_mm,
        middle_mm: (end.pose * middle).into(),
        shift_mm: (end.pose * middle - pose * middle).norm(),
        turn_rad: (end.pose.rotation * pose.rotation.inverse()).angle(),
    };
    let report = GlobalReport {
        n_tried,
        n_refined: ends.len(),
        score_mm,
        middle_mm: (pose * middle).into(),
        runner_up: rival.map(told),
        twin: twin.map(told),
        clearness,
        searched: Some(searched),
        t_target_source: (*params == GlobalParams::default()).then_some(pose),
    };
    Ok(GlobalFit { t_target_source: pose, report })
}

/// RMS distance of the moved points from the surface, with distances limited to `reach_mm`.
fn score(target: &Target, points: &[Point3<f64>], t_target_source: &Isometry3<f64>, reach_mm: f64) -> f64 {
    let squares = points.iter().map(|p| distance_mm(target, p, t_target_source, reach_mm).powi(2));
    (squares.sum::<f64>() / points.len().max(1) as f64).sqrt()
}

/// Distance of a moved point from the surface, along the normal if it is known, up to `reach_mm`.
fn distance_mm(target: &Target, point: &Point3<f64>, t_target_source: &Isometry3<f64>, reach_mm: f64) -> f64 {
    let moved = t_target_source * point;
    let Some((index, distance)) = target.nearest(&moved, reach_mm) else { return reach_mm };
    target.normals().map_or(distance, |normals| (moved - target.points()[index]).dot(&normals[index]).abs())
}

/// A registration from a start; `None` if there are too few pairs.
fn refined(
    target: &Target,
    points: &[Point3<f64>],
    start: &Isometry3<f64>,
    camera: Option<Point3<f64>>,
    reach_mm: f64,
) -> Option<Isometry3<f64>> {
    let method = if target.normals().is_some() { Method::PointToPlane } else { Method::PointToPoint };
    let params = IcpParams {
        max_pair_distance_mm: reach_mm,
        levels: Vec::new(),
        max_iterations: 40,
        stop_step_mm: 0.01,
        stop_step_rad: 1e-4,
        ..IcpParams::default()
    };
    let source = camera.map_or_else(|| Source::from(points), |camera| Source::seen_from(points, camera));
    let fit = icp::register(method, target, source, start, &params, &mut |_| ControlFlow::Continue(()));
    fit.ok().map(|fit| fit.t_target_source)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use osteoflow_geometry::SurfaceOrigin;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    #[test]
    fn poses_no_closer_than_the_limit_to_an_earlier_one_are_distinct() {
        let points = (0..9).map(|k| Vector3::new(f64::from(k), 0.0, 0.0)).collect();
        let points = Points { points, camera: None };
        let at = |score: f64, mm: f64| (score, Placed::translation(0.0, mm, 0.0));
        let poses = vec![at(0.1, 0.0), at(0.2, 4.0), at(0.3, 4.1), at(0.4, -4.1), at(0.5, 8.2), at(0.6, 20.0)];
        let kept =
            |n: usize| distinct(poses.clone(), &points, 4, 4.0, n).iter().map(|p| p.translation.y).collect::<Vec<_>>();
        assert_eq!(kept(9), [0.0, 4.1, -4.1, 8.2, 20.0]);
        assert_eq!(kept(3), [0.0, 4.1, -4.1]);
        assert!(kept(0).is_empty());
        // The points 0, 2, 4, 6 and 8 mm off the axis move by 2 mm RMS each at a turn of 0.4082 rad.
        let turned = |rad: f64| (0.9, Placed::rotation(Vector3::z() * rad));
        let n = |rad: f64| distinct(vec![at(0.1, 0.0), turned(rad)], &points, 4, 2.0, 9).len();
        let limit = 2.0 * (2.0 / 2.0 / 24.0_f64.sqrt()).asin();
        assert_eq!([n(limit - 1e-6), n(limit + 1e-6)], [1, 2], "{limit} rad");
    }

    #[test]
    fn fewer_points_need_a_wider_margin_and_a_pointer_at_rest_is_one_reading() {
        let factors = [7, 20, 50, 85, 1000].map(by_chance);
        assert!(factors.is_sorted_by(|a, b| a >= b) && factors[3..] == [1.0, 1.0], "{factors:?}");
        // The ratio of two standard deviations of 14 residuals each is above 2.4 at 1 in 1000, over the 1 / 0.7 of a clear answer: 1.7.
        assert!((factors[1] - 1.65).abs() < 0.1, "{factors:?}");
        let rest = |k: i32| Point3::new(20.0 * f64::from(k % 5) + 0.5, 0.5 + 1e-3 * f64::from(k), 0.5);
        assert_eq!(n_distinct(&(0..400).map(rest).collect::<Vec<_>>()), 5);
        let best = End { score_mm: 0.1, reach_mm: 2.0, pose: Isometry3::identity() };
        let rival = End { score_mm: 0.2, reach_mm: 2.0, pose: Isometry3::identity() };
        assert_eq!(best.clearness(&rival, 100), 0.5);
        assert!(best.clearness(&rival, 20) < CLEAR && best.clearness(&rival, 5) == 0.0);
    }

    #[test]
    fn points_are_thinned_evenly_and_scored_by_their_distance_along_the_normals_up_to_the_reach() {
        let points: Vec<Point3<f64>> = (0..10).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect();
        let xs = |n: usize| thinned(&points, n).iter().map(|p| p.x).collect::<Vec<_>>();
        assert_eq!((xs(3), xs(10).len(), xs(100).len()), (vec![0.0, 4.0, 8.0], 10, 10));
        let up = Some(vec![Vector3::z(); 10].into());
        let target = |normals| Target::new("ct", SurfaceOrigin::Exact, points.clone(), normals).unwrap();
        let (with_normals, without) = (target(up), target(None));
        // 0.3 mm aside and 0.4 above; 5 mm above is beyond the reach.
        let scan = [Point3::new(3.0, 0.3, 0.4), Point3::new(3.0, 0.0, 5.0)];
        let rms = |a: f64, b: f64| ((a * a + b * b) / 2.0).sqrt();
        let t = Isometry3::translation(2.0, 0.0, 0.0);
        assert!((score(&with_normals, &scan, &t, 2.0) - rms(0.4, 2.0)).abs() < 1e-12);
        assert!((score(&without, &scan, &t, 2.0) - rms(0.5, 2.0)).abs() < 1e-12);
        assert!((score(&without, &scan, &t, 6.0) - rms(0.5, 5.0)).abs() < 1e-12);
        assert_eq!(score(&without, &[], &t, 6.0), 0.0);
    }

    #[test]
    fn of_two_equal_bones_neither_place_is_clear() {
        let shaft = crate::shapes::shaft();
        let beside = |mm: f64| shaft.transformed("ct", &Isometry3::translation(mm, 0.0, 0.0));
        let mesh = |bones: &[osteoflow_geometry::Mesh]| {
            let vertices: Vec<_> = bones.iter().flat_map(|bone| bone.vertices().to_vec()).collect();
            let n = shaft.vertices().len() as u32;
            let faces =
                bones.iter().zip(0..).flat_map(|(bone, k)| bone.faces().iter().map(move |f| f.map(|v| v + k * n)));
            osteoflow_geometry::Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces.collect::<Vec<_>>()).unwrap()
        };
        let target = |bones: &[osteoflow_geometry::Mesh]| {
            let samples = crate::sample::surface(&mesh(bones), 60_000, &mut ChaCha8Rng::seed_from_u64(1));
            Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap()
        };
        let seen = crate::sample::surface(&shaft, 20_000, &mut ChaCha8Rng::seed_from_u64(2));
        let side = seen.points.iter().zip(&seen.normals).filter(|(p, n)| n.x > 0.2 && (15.0..105.0).contains(&p.z));
        let scan = Cloud::new("scan", side.map(|(p, _)| *p).collect::<Vec<_>>()).unwrap();
        let report = |bones: &[osteoflow_geometry::Mesh]| {
            global(&target(bones), &scan, &GlobalParams::default()).unwrap().report
        };
        let one = report(&[beside(0.0)]);
        assert!(one.clearness > CLEAR, "{one:?}");
        for apart_mm in [30.0, 60.0, 150.0] {
            let two = report(&[beside(0.0), beside(apart_mm)]);
            let other = two.runner_up.as_ref().unwrap();
            // Samples of the two are not at the same places.
            assert!(two.clearness < 0.1 && (other.shift_mm - apart_mm).abs() < 0.5, "{apart_mm} mm: {two:?}");
        }
    }

    /// One side of the bumpy shaft with a drape behind it, 60 % of the points, and the shaft.
    fn before_a_drape() -> (Target, Cloud, usize) {
        let shaft = crate::shapes::shaft();
        let samples = crate::sample::surface(&shaft, 40_000, &mut ChaCha8Rng::seed_from_u64(1));
        let target = Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap();
        let seen = crate::sample::surface(&shaft, 12_000, &mut ChaCha8Rng::seed_from_u64(2));
        let side = seen.points.iter().zip(&seen.normals).filter(|(p, n)| n.x > 0.2 && (15.0..105.0).contains(&p.z));
        let mut points: Vec<Point3<f64>> = side.map(|(p, _)| *p).collect();
        let n_bone = points.len();
        let n = 3 * n_bone / 2;
        // A sequence of low discrepancy.
        let at = |k: usize, by: f64| (k as f64 * by).fract() * 200.0 - 100.0;
        let wavy = |y: f64, z: f64| Point3::new(25.0 * (z / 30.0).sin() - 60.0, y, 60.0 + z);
        points.extend((0..n).map(|k| wavy(at(k, 0.754_877_666), at(k, 0.569_840_291))));
        let t = Isometry3::new(Vector3::new(80.0, -300.0, 500.0), Vector3::new(1.0, -0.4, 2.0));
        (target, Cloud::new("scan", points.iter().map(|p| t * p).collect::<Vec<_>>()).unwrap(), n_bone)
    }

    #[test]
    fn a_bone_before_a_drape_is_found_by_a_patch_the_same_on_any_number_of_threads_and_anywhere_alone_misses_it() {
        let (target, scan, n_bone) = before_a_drape();
        let truth = Isometry3::new(Vector3::new(80.0, -300.0, 500.0), Vector3::new(1.0, -0.4, 2.0)).inverse();
        let off = |fit: &GlobalFit| {
            let moved = |p: &Point3<f64>| (fit.t_target_source * p - truth * p).norm();
            scan.points()[..n_bone].iter().map(moved).fold(0.0, f64::max)
        };
        let on = |n_threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
            pool.install(|| global(&target, &scan, &GlobalParams::default()).unwrap())
        };
        let (one, three) = (on(1), on(3));
        assert!(
            off(&one) < 1.0 && one.report.searched == Some(Searched::Among),
            "{:.2} mm: {:?}",
            off(&one),
            one.report
        );
        assert_eq!(one, three);
        let whole = global_by(&target, &scan, &GlobalParams::default(), Some(Searched::Both)).unwrap();
        assert!(off(&whole) > 5.0, "{:.2} mm: {:?}", off(&whole), whole.report);
    }

    #[test]
    fn surroundings_are_not_taken_for_noise_and_noise_widens_the_reach() {
        let (target, scan, n_bone) = before_a_drape();
        let params = GlobalParams::default();
        let truth = Isometry3::new(Vector3::new(80.0, -300.0, 500.0), Vector3::new(1.0, -0.4, 2.0)).inverse();
        // Off the surface by up to 3 mm to either side.
        let noisy = |(k, p): (usize, &Point3<f64>)| p + Vector3::repeat(((k as f64 * 0.618_034).fract() - 0.5) * 6.0);
        let noisy: Vec<Point3<f64>> = scan.points()[..n_bone].iter().enumerate().map(noisy).collect();
        let reach_mm = |points: Vec<Point3<f64>>| {
            let cloud = Cloud::new("scan", points).unwrap();
            let search = Search::new(&target, &cloud, &params);
            let mut ends = [End { score_mm: 2.0, reach_mm: 2.0, pose: truth }];
            search.sort(&mut ends);
            ends[0].reach_mm
        };
        let with_drape = scan.points().to_vec();
        // Of three quarters and more that is around, a quarter of all points is far off.
        let more = [&with_drape[..], &with_drape[n_bone..]].concat();
        let reaches = [noisy, with_drape, more].map(reach_mm);
        assert!(reaches[0] > 2.5 && reaches[1..] == [2.0, 2.0], "{reaches:?} mm");
    }

    #[test]
    fn what_is_near_the_surface_at_neither_place_is_no_sign_that_the_best_is_unclear() {
        let (target, scan, n_bone) = before_a_drape();
        let params = GlobalParams::default();
        let search = Search::new(&target, &scan, &params);
        let truth = Isometry3::new(Vector3::new(80.0, -300.0, 500.0), Vector3::new(1.0, -0.4, 2.0)).inverse();
        let end = |pose: Isometry3<f64>| {
            let score_mm = score(&target, &search.compared, &pose, 2.0);
            End { score_mm, reach_mm: 2.0, pose }
        };
        let (right, other) = (end(truth), end(Isometry3::translation(0.0, 0.0, 1.5) * truth));
        let bone = Cloud::new("scan", scan.points()[..n_bone].to_vec()).unwrap();
        let alone = Search::new(&target, &bone, &params);
        let [with, without] = [&search, &alone].map(|search| search.clearness_of_near(&right, &other));
        assert!((with - without).abs() < 0.05 && with > 0.5, "{with} among others, {without} alone");
        assert!(right.clearness(&other, 1000) < 0.2);
        assert!(search.may_be_among_others(&[end(truth)]) && !alone.may_be_among_others(&[end(truth)]));
    }
}
