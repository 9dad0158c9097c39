//! What an independent registration says: by shape alone, and of the scan's mirror image.

use super::evidence::{N_EXAMINED, Registered};
use crate::coarse::{self, GlobalParams, Searched};
use crate::downsample::thinned;

use crate::icp::{self, IcpParams, Method, Source};
use crate::kabsch::centroid;
use nalgebra::{Isometry3, Point3, Translation3};
use osteoflow_geometry::Cloud;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::ControlFlow;

/// Maximum distance of a pair while a pose is settled, mm.
const REACH_MM: f64 = 2.0;

/// A search whose pose takes the scan's middle farther from where its report has it, mm, was of another scan or in another frame.
const SAME_SCAN_MM: f64 = 0.001;

/// Number of scan points, evenly through their order, with which a pose is settled: it then differs from that of all points by
/// a tenth of the spread at most, as residuals of one region are correlated.
const N_SETTLED: usize = 10_000;

/// Every how many of these points a registration by shape is settled with first. A pose that is judged is settled with all of them:
/// a subset has another minimum, and with half of the points at first a film of 0.5 mm left it 0.5 mm along the bone.
const FIRST_LEVEL: u32 = 8;

/// Settled if less than this is left, mm and rad: a twentieth of the least predicted error.
const SETTLED_MM: f64 = 0.005;
const SETTLED_RAD: f64 = 5e-5;

/// Maximum number of steps; a pose that then still slides is far from where it started.
const MAX_STEPS: u32 = 100;

/// Points no farther from the surface support a pose: this many times the noise, and at least this many mm, the error of a CT's
/// surface. A share of points does not mind where the others are, as tissue may be anywhere.
const SUPPORT_SIGMAS: f64 = 3.0;
const MIN_SUPPORT_MM: f64 = 0.2;

/// Edge of the cells of a scan whose points are one draw when supports are compared, mm.
const CELL_MM: f64 = 10.0;

/// Share of the scan by which another pose has to be supported better to contradict, at least: less may be noise.
pub(super) const BETTER: f64 = 0.1;

/// And at least as many standard deviations of the comparison.
const BETTER_SIGMAS: f64 = 3.0;

/// A registration by shape alone beside the one that is judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShapeEvidence {
    /// Mean distance between both answers at the assessed points, mm.
    pub apart_mm: f64,
    /// Share of the scan on the surface by shape alone, within three times the noise and 0.2 mm.
    pub support: f64,
    /// That of the registration judged.
    pub judged_support: f64,
    /// Standard deviation of the difference of these two, by cells of 10 mm.
    pub margin_sd: f64,
    /// Margin of the answer by shape over its runner-up; see [`coarse::GlobalReport`].
    pub clearness: f64,
    /// That of the scan's mirror image where it fits best, if it was tried.
    pub mirrored_support: Option<f64>,
    /// Standard deviation of its difference to the best of the others.
    pub mirrored_margin_sd: Option<f64>,
}

impl ShapeEvidence {
    /// Whether the scan fits better by its shape alone than where it was judged, by more than the comparison's noise.
    pub(super) fn is_better(&self) -> bool {
        self.support > self.judged_support + BETTER.max(BETTER_SIGMAS * self.margin_sd)
    }

    /// Whether the scan's mirror image fits better than the scan, by more than the comparison's noise.
    pub(super) fn is_mirror_better(&self) -> bool {
        let (best, sd) = (self.support.max(self.judged_support), self.mirrored_margin_sd.unwrap_or(0.0));
        self.mirrored_support.is_some_and(|mirrored| mirrored > best + BETTER.max(BETTER_SIGMAS * sd))
    }
}

/// Which points of a scan, every n-th, lie on the surface at a pose.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Support(Vec<bool>);

impl Support {
    /// The support of the scan at a pose.
    pub(super) fn new(registered: &Registered<'_>, pose: &Isometry3<f64>, noise_mm: f64) -> Self {
        let limit_mm = (SUPPORT_SIGMAS * noise_mm).max(MIN_SUPPORT_MM);
        let (target, points) = (registered.target, thinned(registered.source.points(), N_EXAMINED));
        let normals = target.normals().unwrap_or_default();
        let is_on = |p: &Point3<f64>| {
            let moved = pose * p;
            let near = target.nearest(&moved, 2.0 * limit_mm);
            near.is_some_and(|(k, _)| (moved - target.points()[k]).dot(&normals[k]).abs() <= limit_mm)
        };
        Self(points.par_iter().map(is_on).collect())
    }

    /// Share of the points.
    pub(super) fn share(&self) -> f64 {
        self.0.iter().filter(|is_on| **is_on).count() as f64 / self.0.len().max(1) as f64
    }

    /// Standard deviation of the difference of two shares of a scan.
    pub(super) fn margin_sd(&self, other: &Self, scan: &[Point3<f64>]) -> f64 {
        let difference = |k: usize| f64::from(u8::from(self.0[k])) - f64::from(u8::from(other.0[k]));
        let points = thinned(scan, N_EXAMINED);
        let n = points.len().max(1) as f64;
        let mean = (0..points.len()).map(difference).sum::<f64>() / n;
        let mut cells: BTreeMap<[i64; 3], f64> = BTreeMap::new();
        for (k, point) in points.iter().enumerate() {
            let key = std::array::from_fn(|axis| (point[axis] / CELL_MM).floor() as i64);
            *cells.entry(key).or_default() += difference(k) - mean;
        }
        cells.values().map(|sum| sum * sum).sum::<f64>().sqrt() / n
    }
}

/// The scan's mirror image and that of its camera.
pub fn mirrored(scan: &Cloud) -> Cloud {
    let flip = |p: &Point3<f64>| Point3::new(-p.x, p.y, p.z);
    let points: Vec<Point3<f64>> = scan.points().iter().map(flip).collect();
    let mirrored = Cloud::new(scan.frame.clone(), points).unwrap_or_else(|_| scan.clone());
    match scan.viewpoint {
        Some(viewpoint) => {
            let camera = flip(&(viewpoint * Point3::origin()));
            mirrored.seen_from(Isometry3::from_parts(Translation3::from(camera.coords), viewpoint.rotation))
        }
        None => mirrored,
    }
}

/// The pose at which a point-to-plane registration from the judged one comes to rest.
pub(super) fn settled(registered: &Registered<'_>) -> Option<Isometry3<f64>> {
    settled_from(registered, registered.t_target_source, Vec::new())
}

fn settled_from(registered: &Registered<'_>, start: &Isometry3<f64>, levels: Vec<u32>) -> Option<Isometry3<f64>> {
    let params = IcpParams {
        max_pair_distance_mm: REACH_MM,
        levels,
        stop_step_mm: SETTLED_MM,
        stop_step_rad: SETTLED_RAD,
        max_iterations: MAX_STEPS,
        ..IcpParams::default()
    };
    let points = thinned(registered.source.points(), N_SETTLED);
    let camera = registered.source.viewpoint.map(|t| t * Point3::origin());
    let source = camera.map_or_else(|| Source::from(&points[..]), |camera| Source::seen_from(&points, camera));
    let observer = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
    let fit = icp::register(Method::PointToPlane, registered.target, source, start, &params, observer);
    fit.ok().map(|fit| fit.t_target_source)
}

/// The registration by shape alone, settled, and its report. Where the one that is judged started there, with this report, and still is
/// there, it is that one; where it left, the search is not made again, if it was of this scan.
pub(super) fn by_shape(
    registered: &Registered<'_>,
    start: Option<&coarse::GlobalReport>,
    settled: Option<&Isometry3<f64>>,
) -> Option<(Isometry3<f64>, coarse::GlobalReport)> {
    let middle = centroid(registered.source.points());
    let is_there = |start: &&coarse::GlobalReport| {
        let at = [registered.t_target_source, settled.unwrap_or(registered.t_target_source)].map(|pose| pose * middle);
        at.iter().all(|at| (at - Point3::from(start.middle_mm)).norm() < REACH_MM)
    };
    if let Some((start, settled)) = start.filter(is_there).zip(settled) {
        return Some((*settled, start.clone()));
    }
    let is_of_this = |pose: &Isometry3<f64>, start: &coarse::GlobalReport| {
        (pose * middle - Point3::from(start.middle_mm)).norm() < SAME_SCAN_MM
    };
    let known = start.and_then(|start| Some((start.t_target_source?, start.clone())));
    let known = known.filter(|(pose, start)| is_of_this(pose, start));
    let (found, report) = match known {
        Some(known) => known,
        None => {
            let fit = coarse::global(registered.target, registered.source, &GlobalParams::default()).ok()?;
            (fit.t_target_source, fit.report)
        }
    };
    Some((settled_from(registered, &found, vec![FIRST_LEVEL])?, report))
}

/// The support of the scan's mirror image where it fits best, which is looked for where the scan was, but not by patches: among surroundings
/// they, not the mirror image, are what is named first.
pub(super) fn mirrored_support(
    registered: &Registered<'_>,
    noise_mm: f64,
    searched: Option<Searched>,
) -> Option<Support> {
    let image = mirrored(registered.source);
    let fit = coarse::global_by(registered.target, &image, &GlobalParams::default(), not_among(searched)).ok()?;
    let image = Registered { source: &image, ..*registered };
    let pose = settled_from(&image, &fit.t_target_source, vec![FIRST_LEVEL])?;
    Some(Support::new(&image, &pose, noise_mm))
}

/// These searches without that by patches.
pub(super) fn not_among(searched: Option<Searched>) -> Option<Searched> {
    searched.map(|searched| if searched == Searched::Among { Searched::Both } else { searched })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use crate::shapes::shaft;
    use crate::target::Target;
    use nalgebra::Vector3;
    use osteoflow_geometry::SurfaceOrigin;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_mirror_image_has_its_camera_mirrored_and_its_frame_kept() {
        let scan = Cloud::new("scan", vec![Point3::new(1.0, 2.0, 3.0), Point3::new(-4.0, 5.0, 6.0)]).unwrap();
        let image = mirrored(&scan);
        assert_eq!(image.points(), [Point3::new(-1.0, 2.0, 3.0), Point3::new(4.0, 5.0, 6.0)]);
        assert_eq!((image.frame.clone(), image.viewpoint), (scan.frame.clone(), None));
        let turn = Vector3::y() * 0.3;
        let seen = mirrored(&scan.seen_from(Isometry3::new(Vector3::new(200.0, -10.0, 50.0), turn)));
        assert_eq!(seen.viewpoint, Some(Isometry3::new(Vector3::new(-200.0, -10.0, 50.0), turn)));
    }

    #[test]
    fn a_search_of_another_scan_or_in_another_frame_is_made_again() {
        let drawn = |n, seed| sample::surface(&shaft(), n, &mut ChaCha8Rng::seed_from_u64(seed));
        let surface = drawn(20_000, 1);
        let target = Target::new("ct", SurfaceOrigin::Exact, surface.points, Some(surface.normals.into())).unwrap();
        let truth = Isometry3::new(Vector3::new(40.0, -3.0, 7.0), Vector3::new(0.3, 0.2, -0.1));
        let points: Vec<_> = drawn(3000, 2).points.iter().map(|p| truth.inverse() * p).collect();
        let source = Cloud::new("scan", points).unwrap();
        let astray = Isometry3::translation(0.0, 0.0, 30.0) * truth;
        let registered = Registered { target: &target, source: &source, t_target_source: &astray, at: &[] };
        let report = coarse::global(&target, &source, &GlobalParams::default()).unwrap().report;
        let searched = |start: &coarse::GlobalReport| {
            let (pose, report) = by_shape(&registered, Some(start), None).unwrap();
            ((pose.translation.vector - truth.translation.vector).norm() < 0.5, report)
        };
        // A number by which a report is known again.
        let marked = coarse::GlobalReport { n_tried: 1, ..report.clone() };
        assert_eq!(searched(&marked), (true, marked.clone()), "the search of this scan is taken");
        let of_other = marked.t_target_source.map(|pose| pose * Isometry3::translation(500.0, 0.0, 0.0));
        assert_eq!(searched(&coarse::GlobalReport { t_target_source: of_other, ..marked }), (true, report));
    }

    #[test]
    fn support_is_the_share_within_three_times_the_noise_and_a_fifth_of_a_millimetre() {
        let grid: Vec<Point3<f64>> = (0..121).map(|k| Point3::new(f64::from(k % 11), f64::from(k / 11), 0.0)).collect();
        let normals = vec![Vector3::z(); grid.len()];
        let target = Target::new("ct", SurfaceOrigin::Exact, grid, Some(normals.into())).unwrap();
        // Above samples of the surface, at a limit, and 1 mm beyond its edge in its plane.
        let scan = [[5.0, 5.0, 0.2], [5.0, 6.0, -0.2], [4.0, 5.0, 0.21], [4.0, 4.0, -0.61], [11.0, 5.0, 0.0]];
        let source = Cloud::new("scan", scan.map(Point3::from).to_vec()).unwrap();
        let pose = Isometry3::identity();
        let registered = Registered { target: &target, source: &source, t_target_source: &pose, at: &[] };
        assert_eq!(Support::new(&registered, &pose, 0.05).share(), 0.4);
        assert_eq!(Support::new(&registered, &pose, 0.08).share(), 0.6);
        assert_eq!(Support::new(&registered, &pose, 0.21).share(), 0.8 + 0.2 * f64::from(2.0 * 0.63 > 1.0));
    }
}
