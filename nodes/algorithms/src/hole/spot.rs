//! The search of all detectors for a disc among the missing points.

use super::scene::Scene;
use super::{Hole, HoleError, HoleParams, HoleReport};
use crate::kabsch::centroid;
use crate::normals::plane_normal;
use nalgebra::{Matrix2, Matrix6, Point3, Vector2, Vector3, Vector6};
use rayon::prelude::*;

/// Point spacing on the surface, as a share of the disc's radius, up to which every hole is found: ten of its points are
/// missing.
const SURE_SPACING: f64 = 0.32;

/// Maximum point spacing of a hole of the first and of the second tier, likewise. Half of the holes are found at 0.42 and
/// one in thirty at 0.5; the second tier's centres are more than 0.8 mm off beyond 0.45.
const MAX_SPACING: [f64; 2] = [0.5, 0.45];

/// Minimum number of missing points close together; a single one is dropout, of a sparse scan two are a spot's.
const MIN_CLUSTER: usize = 2;

/// Factor by which a gap may be too large or too small: other losses of a scan are a little over half as large.
const WRONG_SIZE: f64 = 1.6;

/// Area per point, in squares of its spacing: a disc as wide as the ring around it holds nine points.
const RING_AREA: f64 = 2.0 * std::f64::consts::PI / 9.0;

/// Directions into which the rim is divided.
const SECTORS: usize = 12;

/// A sector of the rim is present if the scan has this share of the points that the reference has.
const PRESENT_SHARE: f64 = 0.4;

/// Maximum number of sectors of the rim that only the reference has: another loss may touch the hole, but at the border
/// of the common view half of them are empty.
const MAX_LOST_SECTORS: usize = 4;

/// Minimum number of sectors present: at a silhouette half of them are empty in both scans.
const MIN_SEEN_SECTORS: usize = 4;

/// Relative score at which a second hole makes the result ambiguous.
const AMBIGUOUS_SHARE: f64 = 0.5;

/// Minimum share of its disc that a hole of the second tier lacks: spots at the silhouette lack all of it, losses of
/// 1.2 mm radius up to 0.83.
const MIN_EMPTY_SHARE: f64 = 0.9;

/// Standard deviation of the Gaussian weights of a surface patch, relative to its radius.
const WIDTH: f64 = 0.2;

/// Number of steps of the fit of a centre; each half converges in five.
const FIT_STEPS: usize = 24;

/// Weight of a present point relative to a missing one.
const PRESENT_WEIGHT: f64 = 2.0;

/// Distance from the disc, in bands, beyond which a point is missing for another reason.
const MAX_BANDS: f64 = 3.0;

/// Reference points without a counterpart, by ascending index.
pub(super) struct Missing {
    pub(super) indices: Vec<usize>,
    /// Distance inside the rim within which points still count as present, mm.
    pub(super) margin_mm: f64,
}

/// A candidate for the hole.
struct Candidate {
    hole: Hole,
    n_lost: usize,
    n_seen: usize,
}

impl Candidate {
    /// Whether the scan goes on around it, except where it goes on in neither scan.
    fn is_admissible(&self) -> bool {
        self.n_lost <= MAX_LOST_SECTORS && self.n_seen >= MIN_SEEN_SECTORS
    }

    /// Whether the scan lacks all of its disc: so it is at a spot, also where the silhouette hides most of it.
    fn is_empty(&self) -> bool {
        self.hole.report.empty_share >= MIN_EMPTY_SHARE
    }

    fn is_too_sparse(&self, params: &HoleParams) -> bool {
        let report = &self.hole.report;
        report.spacing_mm > MAX_SPACING[usize::from(report.tier > 1)] * params.spot_radius_mm
    }

    /// Score against rivals: a strip that is lost at a steep edge continues around the disc, a spot does not.
    fn score(&self) -> f64 {
        self.hole.confidence * (1.0 - self.n_lost as f64 / SECTORS as f64).powi(2)
    }
}

/// The one hole among the missing points.
pub(super) fn find(scene: &Scene<'_>, missing: &Missing, params: &HoleParams) -> Result<Hole, HoleError> {
    let mut is_missing = vec![false; scene.reference.len()];
    missing.indices.iter().for_each(|&i| is_missing[i] = true);
    let seeds = seeds(scene, missing, &is_missing, params.spot_radius_mm);
    let mut candidates: Vec<Candidate> =
        seeds.par_iter().filter_map(|seed| rate(scene, missing, &is_missing, seed, params)).collect();
    for candidate in &mut candidates {
        candidate.hole.report.n_candidates = seeds.len();
    }
    candidates.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let not_found = not_found(scene, missing, candidates.first(), params);
    let first_tier = |c: &&Candidate| c.is_admissible() && c.hole.confidence >= params.min_confidence;
    if let Some(best) = candidates.iter().find(first_tier) {
        if best.is_too_sparse(params) {
            return Err(too_sparse(scene, best.hole.report.spacing_mm, params));
        }
        let rivals = rivals(best, candidates.iter().filter(first_tier), params);
        return match rivals.first() {
            Some(rival) => Err(HoleError::Several {
                n: rivals.len() + 1,
                first: best.hole.centre.coords.into(),
                second: rival.hole.centre.coords.into(),
                first_confidence: best.hole.confidence,
                second_confidence: rival.hole.confidence,
            }),
            None => Ok(best.hole.clone()),
        };
    }
    let mut empty: Vec<Candidate> = candidates.into_iter().filter(Candidate::is_empty).collect();
    empty.iter_mut().for_each(|c| c.hole.report.tier = 2);
    let second_tier = |c: &&Candidate| {
        c.is_admissible() && c.hole.confidence >= params.min_confidence_agreeing && !c.is_too_sparse(params)
    };
    match empty.iter().find(second_tier) {
        Some(best) if rivals(best, empty.iter(), params).is_empty() => Ok(best.hole.clone()),
        _ => Err(not_found),
    }
}

/// The candidates with more than half the score of `best`, apart from it and from each other.
fn rivals<'a>(
    best: &Candidate,
    candidates: impl Iterator<Item = &'a Candidate>,
    params: &HoleParams,
) -> Vec<&'a Candidate> {
    let mut rivals: Vec<&Candidate> = Vec::new();
    for candidate in candidates.filter(|c| c.score() > AMBIGUOUS_SHARE * best.score()) {
        // Seeds of one hole converge to one centre.
        let apart = |other: &Candidate| (candidate.hole.centre - other.hole.centre).norm() > params.spot_radius_mm;
        if apart(best) && rivals.iter().all(|rival| apart(rival)) {
            rivals.push(candidate);
        }
    }
    rivals
}

fn too_sparse(scene: &Scene<'_>, spacing_mm: f64, params: &HoleParams) -> HoleError {
    HoleError::TooSparse {
        what: scene.coarser_scan(),
        spacing_mm,
        grid_mm: scene.grid_mm,
        needed_mm: SURE_SPACING * params.spot_radius_mm,
        expected_radius_mm: params.spot_radius_mm,
    }
}

/// The error that describes why there is no hole.
fn not_found(scene: &Scene<'_>, missing: &Missing, best: Option<&Candidate>, params: &HoleParams) -> HoleError {
    let spacing_mm = scene.median_spacing();
    if spacing_mm > SURE_SPACING * params.spot_radius_mm {
        return too_sparse(scene, spacing_mm, params);
    }
    let best = match best {
        None => "no two of them lie together".to_owned(),
        Some(Candidate { hole, n_lost, .. }) if *n_lost > MAX_LOST_SECTORS => {
            let share = *n_lost as f64 / SECTORS as f64 * 100.0;
            format!(
                "the best gap, at {:.1?} mm, lies at the border of the laser scan, which ends in {share:.0} % of the \
                 directions around it",
                <[f64; 3]>::from(hole.centre.coords)
            )
        }
        Some(Candidate { hole, .. }) => format!(
            "the best gap, at {:.1?} mm, has a radius of {:.1} mm, is empty by {:.0} % and has {:.0} % of its rim \
             (confidence {:.2}, {} needed)",
            <[f64; 3]>::from(hole.centre.coords),
            hole.radius_mm,
            hole.report.empty_share * 100.0,
            hole.report.rim_share * 100.0,
            hole.confidence,
            params.min_confidence
        ),
    };
    HoleError::None { expected_radius_mm: params.spot_radius_mm, n_missing: missing.indices.len(), best }
}

/// Missing points with the most missing points around, no two within a radius of each other.
fn seeds(scene: &Scene<'_>, missing: &Missing, is_missing: &[bool], radius_mm: f64) -> Vec<Point3<f64>> {
    let crowd = |&i: &usize| {
        let around = scene.reference_tree.within(&scene.reference[i], radius_mm);
        (around.into_iter().filter(|(j, _)| is_missing[*j]).count(), i)
    };
    let mut crowds: Vec<(usize, usize)> = missing.indices.par_iter().map(crowd).collect();
    crowds.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut taken = vec![false; scene.reference.len()];
    let mut seeds = Vec::new();
    for (n, i) in crowds {
        if n < MIN_CLUSTER {
            break;
        }
        if !taken[i] {
            seeds.push(scene.reference[i]);
            scene.reference_tree.within(&scene.reference[i], radius_mm).iter().for_each(|(j, _)| taken[*j] = true);
        }
    }
    seeds
}

/// Fits a disc to the missing points around `seed` and rates it.
fn rate(
    scene: &Scene<'_>,
    missing: &Missing,
    is_missing: &[bool],
    seed: &Point3<f64>,
    params: &HoleParams,
) -> Option<Candidate> {
    let radius = params.spot_radius_mm;
    let lost = |around: &Point3<f64>, reach: f64| -> Vec<usize> {
        let near = scene.reference_tree.within(around, reach);
        near.into_iter().map(|(i, _)| i).filter(|i| is_missing[*i]).collect()
    };
    let start = centroid(&lost(seed, radius).iter().map(|&i| scene.reference[i]).collect::<Vec<_>>());
    let local = lost(&start, 2.0 * radius);
    let spacing_mm = local.iter().map(|&i| scene.spacing_mm(i)).sum::<f64>() / local.len().max(1) as f64;
    let patch = Patch::new(scene, &start, 2.0 * radius)?;
    let inside: Vec<Point3<f64>> = local.iter().map(|&i| scene.reference[i]).collect();
    let outside: Vec<Point3<f64>> =
        scene.cloud_tree.within(&start, 3.0 * radius).into_iter().map(|(i, _)| scene.cloud[i]).collect();
    let band = spacing_mm.max(0.1 * radius);
    let inner = (radius - missing.margin_mm - band).max(0.1 * radius);
    let rough = patch.fit(&inside, inner, &outside, radius + band, band);
    let patch = Patch::new(scene, &rough, 2.0 * radius).unwrap_or(patch);
    let centre = patch.fit(&inside, inner, &outside, radius + band, band);

    let count = |points: &crate::nearest::Nearest, reach: f64| points.within(&centre, reach).len() as f64;
    let core = (radius - spacing_mm / 2.0).max(0.5 * radius);
    let expected = |reach: f64| scene.density * count(&scene.reference_tree, reach);
    let empty_share = (1.0 - count(&scene.cloud_tree, core) / expected(core).max(1.0)).clamp(0.0, 1.0);
    // The share missing of a wider disc gives the radius, independent of the blurred rim.
    let wide = 1.4 * radius;
    let share = (1.0 - count(&scene.cloud_tree, wide) / expected(wide).max(1.0)).clamp(0.0, 1.0);
    let radius_mm = wide * share.sqrt();
    let size_share = (1.0 - (radius_mm / radius).ln().abs() / WRONG_SIZE.ln()).clamp(0.0, 1.0);
    let (n_seen, n_lost) = rim(scene, &patch, &centre, radius, spacing_mm);
    let rim_share = n_seen as f64 / SECTORS as f64;
    let area: f64 =
        scene.reference_tree.within(&centre, core).iter().map(|(i, _)| scene.spacing_mm(*i).powi(2) * RING_AREA).sum();
    let seen_share = (area / (std::f64::consts::PI * core * core)).min(1.0);
    let confidence = empty_share.powi(2) * seen_share * rim_share.sqrt() * size_share;
    let report = HoleReport {
        tier: 1,
        n_reference: scene.reference.len(),
        n_cloud: scene.cloud.len(),
        n_missing: missing.indices.len(),
        n_hole: lost(&centre, radius).len(),
        n_candidates: 0,
        spacing_mm,
        grid_mm: scene.grid_mm,
        scan_residual_mm: scene.residual_mm,
        radius_mm,
        expected_radius_mm: radius,
        empty_share,
        seen_share,
        rim_share,
        size_share,
        confidence,
    };
    Some(Candidate { hole: Hole { centre, radius_mm, confidence, report }, n_lost, n_seen })
}

/// Numbers of sectors of the rim that the scan covers, and that only the reference covers.
fn rim(scene: &Scene<'_>, patch: &Patch, centre: &Point3<f64>, radius: f64, spacing_mm: f64) -> (usize, usize) {
    let reach = radius + (0.6 * radius).max(2.0 * spacing_mm);
    let sectors = |points: &[Point3<f64>], tree: &crate::nearest::Nearest| {
        let mut sectors = [0.0; SECTORS];
        for (i, square) in tree.within(centre, reach) {
            if square > radius * radius {
                let offset = patch.local(&points[i]) - patch.local(centre);
                let turn = (offset.y.atan2(offset.x) / std::f64::consts::TAU).rem_euclid(1.0);
                sectors[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] += 1.0;
            }
        }
        sectors
    };
    let expected = sectors(scene.reference, &scene.reference_tree).map(|n| n * scene.density);
    let found = sectors(scene.cloud, &scene.cloud_tree);
    let pairs = || found.iter().zip(&expected);
    let n_seen = pairs().filter(|(found, expected)| **found >= 1.0 && **found >= PRESENT_SHARE * **expected).count();
    let n_lost = pairs().filter(|(found, expected)| **expected >= 2.0 && **found < PRESENT_SHARE * **expected).count();
    (n_seen, n_lost)
}

/// The reference's surface around a point, as a quadratic height over its tangent plane.
struct Patch {
    origin: Point3<f64>,
    axes: [Vector3<f64>; 3],
    height: Vector6<f64>,
}

impl Patch {
    fn new(scene: &Scene<'_>, origin: &Point3<f64>, reach_mm: f64) -> Option<Self> {
        let around: Vec<Point3<f64>> =
            scene.reference_tree.within(origin, reach_mm).into_iter().map(|(i, _)| scene.reference[i]).collect();
        let z = plane_normal(&around)?;
        let x = z.cross(&Vector3::ith(z.iamin(), 1.0)).normalize();
        let mut patch = Self { origin: *origin, axes: [x, z.cross(&x), z], height: Vector6::zeros() };
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for point in &around {
            let [x, y, z] = patch.local(point).into();
            // A bone bends within a spot's radius more than a quadratic can follow, so near points count most.
            let weight = (-(x * x + y * y) / (2.0 * (WIDTH * reach_mm).powi(2))).exp();
            let row = monomials(x, y);
            normal += row * row.transpose() * weight;
            right += row * (z * weight);
        }
        // Regularization: curvatures that too few points determine stay flat.
        let damped = normal + Matrix6::identity() * 1e-3;
        patch.height = damped.cholesky()?.solve(&right);
        Some(patch)
    }

    /// Coordinates along the patch's axes.
    fn local(&self, point: &Point3<f64>) -> Vector3<f64> {
        let offset = point - self.origin;
        Vector3::from(self.axes.map(|axis| axis.dot(&offset)))
    }

    fn on_surface(&self, at: &Vector2<f64>) -> Point3<f64> {
        let z = self.height.dot(&monomials(at.x, at.y));
        self.origin + self.axes[0] * at.x + self.axes[1] * at.y + self.axes[2] * z
    }

    /// The point on the surface with the points `inside` closer than `inner` and those `outside` farther than `outer`,
    /// in the least-squares sense.
    ///
    /// A present point is certainly outside of the hole; a missing one may be missing for another reason, so its
    /// residual is limited to `band`, and in the second half of the steps it is ignored far beyond.
    fn fit(&self, inside: &[Point3<f64>], inner: f64, outside: &[Point3<f64>], outer: f64, band: f64) -> Point3<f64> {
        let mut at = Vector2::zeros();
        for round in 0..FIT_STEPS {
            let centre = self.on_surface(&at);
            let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
            let mut add = |point: &Point3<f64>, limit: f64, weight: &dyn Fn(f64) -> f64| {
                let offset = point - centre;
                let distance = offset.norm();
                let (excess, weight) = (distance - limit, weight(distance - limit));
                if weight > 0.0 && distance > 0.0 {
                    let direction = Vector2::new(self.axes[0].dot(&offset), self.axes[1].dot(&offset)) / distance;
                    normal += direction * direction.transpose() * weight;
                    right += direction * (excess * weight);
                }
            };
            let missing = |excess: f64| match excess {
                e if e <= 0.0 || (round >= FIT_STEPS / 2 && e > MAX_BANDS * band) => 0.0,
                e => (band / e).min(1.0),
            };
            inside.iter().for_each(|p| add(p, inner, &missing));
            outside.iter().for_each(|p| add(p, outer, &|excess| if excess < 0.0 { PRESENT_WEIGHT } else { 0.0 }));
            // Damping: where the rim is open, the centre stays.
            let Some(inverse) = (normal + Matrix2::identity()).try_inverse() else { break };
            at += inverse * right;
        }
        self.on_surface(&at)
    }
}

fn monomials(x: f64, y: f64) -> Vector6<f64> {
    Vector6::new(1.0, x, y, x * x, x * y, y * y)
}
