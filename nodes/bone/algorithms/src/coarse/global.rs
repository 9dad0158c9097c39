//! Registration by shape alone.

mod axis;
mod descent;

pub(crate) use descent::{Placed, Points, descended, distinct, motion, thinned};

use crate::Refusal;
use crate::icp::{self, IcpParams, Method, Source};
use crate::target::Target;
use axis::{Scan, stations};
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Cloud;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Number of scan points by which every start is scored, by which the better ones are refined on the map, and by which the
/// best are registered.
const N_SCORED: usize = 250;
const N_MAPPED: usize = 1000;
const N_REGISTERED: usize = 1000;

/// Number of scan points by which the ends are compared.
const N_COMPARED: usize = 2500;

/// Maximum distance counted for a point while starts are scored, mm: about half the distance between neighbouring starts.
const START_REACH_MM: f64 = 6.0;

/// Maximum distance of a pair in the last steps, and counted for a point at the end, mm: soft tissue must not decide.
/// The same on the way, mm.
const MID_REACH_MM: f64 = 3.5;

/// As many times the starts that are refined are first looked at more closely with few points.
const MORE: usize = 5;

const END_REACH_MM: f64 = 2.0;

/// Minimum RMS distance between the points of two distinct registrations, mm.
const APART_MM: f64 = 4.0;

/// Starts that come to lie closer together than this on the map are one, mm.
const SAME_MM: f64 = 1.5;

/// Clearness below which an answer may be wrong. 0.3: on real bones right answers had 0.4 and more, wrong ones 0.2 and less.
pub const CLEAR: f64 = 0.3;

/// What to do with surroundings in a scan.
pub(crate) const CROP: &str = "crop the scan to the bone (crop.box, or draw a region on the page of osteoflow view)";

/// Spacing and number of the starts of [`global()`].
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GlobalParams {
    /// Distance between starts along the bone, mm. 10: a few steps on a coarse map recover half of it.
    #[schemars(range(min = 0.5, max = 100.0))]
    pub slide_mm: f64,
    /// Number of starts around the bone. 12: 30 degrees apart, half of which the same steps recover.
    #[schemars(range(min = 4, max = 360))]
    pub n_turns: usize,
    /// Maximum number of starts, the best of those that came to lie apart, that are refined on the map. 40: a fibula has fewer
    /// plausible places.
    #[schemars(range(min = 1, max = 10_000))]
    pub n_refined: usize,
    /// Maximum number of those, the best again and at least 4 mm apart, that are registered onto the surface. 4: the right one
    /// and its rivals.
    #[schemars(range(min = 1, max = 1000))]
    pub n_registered: usize,
}

impl Default for GlobalParams {
    fn default() -> Self {
        Self { slide_mm: 10.0, n_turns: 12, n_refined: 40, n_registered: 4 }
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
    /// The scan's centroid there, in the target's frame, mm.
    #[serde(default)]
    pub middle_mm: [f64; 3],
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
    /// The scan's centroid there, in the target's frame, mm.
    #[serde(default)]
    pub middle_mm: [f64; 3],
    /// Distance of the scan's centroid from that of the answer, mm.
    pub shift_mm: f64,
    /// Angle to the answer, rad.
    pub turn_rad: f64,
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
/// [`Refusal`] if the scan is too small or as wide as long, or nothing fits anywhere.
///
/// # Source
/// Multi-start ICP, as Besl and McKay 1992, section IV-B, with starts along the principal axes.
pub fn global(target: &Target, source: &Cloud, params: &GlobalParams) -> Result<GlobalFit, Refusal> {
    let scan = Scan::new(source, target.points())?;
    let map = target.index().near_map(target);
    let stations = stations(map, scan.half_length_mm, params.slide_mm);
    let starts: Vec<Placed> = stations
        .iter()
        .flat_map(|station| (0..2 * params.n_turns).map(|turn| station.place(&scan, turn, params.n_turns)))
        .collect();
    let few = scan.thinned(source.points(), N_SCORED);
    let some = scan.thinned(source.points(), N_MAPPED);
    // Four points of the scan's extent tell poses apart.
    let better = |starts: &[Placed], points: &Points, reach_mm: f64, n_steps: usize, apart_mm: f64, n: usize| {
        distinct(descended(map, points, starts, reach_mm, n_steps), &few, 4, apart_mm, n)
    };
    let near = better(&starts, &few, START_REACH_MM, 3, SAME_MM, MORE * params.n_refined);
    let near = better(&near, &few, MID_REACH_MM, 8, SAME_MM, params.n_refined);
    let near = better(&near, &some, END_REACH_MM, 8, APART_MM, params.n_registered);
    let (registered, compared) = (thinned(source.points(), N_REGISTERED), thinned(source.points(), N_COMPARED));
    let mut ends: Vec<(f64, Isometry3<f64>)> = near
        .par_iter()
        .filter_map(|placed| {
            let start = motion(map, &scan.middle, placed);
            let end = refined(target, &registered, &start, scan.camera)?;
            Some((score(target, &compared, &end, END_REACH_MM), end))
        })
        .collect();
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(&(score_mm, t_target_source)) = ends.first() else {
        let n_tried = starts.len();
        return Err(Refusal::of(format!(
            "none of {n_tried} starts came to lie on the surface; are scan and surface of the same bone, both in mm? If \
             surroundings are in the scan, {CROP}"
        )));
    };
    let apart = |other: &Isometry3<f64>| {
        let squares: f64 = registered.iter().map(|p| (other * p - t_target_source * p).norm_squared()).sum();
        (squares / registered.len() as f64).sqrt()
    };
    let runner_up = ends.iter().find(|(_, end)| apart(end) > APART_MM).map(|(score_mm, end)| RunnerUp {
        score_mm: *score_mm,
        middle_mm: (end * scan.middle).into(),
        shift_mm: (end * scan.middle - t_target_source * scan.middle).norm(),
        turn_rad: (end.rotation * t_target_source.rotation.inverse()).angle(),
    });
    let clearness = runner_up.as_ref().map_or(1.0, |other| 1.0 - score_mm / other.score_mm.max(f64::MIN_POSITIVE));
    let middle_mm = (t_target_source * scan.middle).into();
    let (n_tried, n_refined) = (starts.len(), ends.len());
    let report = GlobalReport { n_tried, n_refined, score_mm, middle_mm, runner_up, clearness };
    Ok(GlobalFit { t_target_source, report })
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

/// A registration from a start; `None` if there are too few pairs.
fn refined(
    target: &Target,
    points: &[Point3<f64>],
    start: &Isometry3<f64>,
    camera: Option<Point3<f64>>,
) -> Option<Isometry3<f64>> {
    let method = if target.normals().is_some() { Method::PointToPlane } else { Method::PointToPoint };
    let params = IcpParams {
        max_pair_distance_mm: END_REACH_MM,
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
}
