//! The search of all detectors for a disc among the missing points.

use super::footprint::Footprint;
use super::patch::Patch;
use super::scene::{Scan, Scene};
use super::{Hole, HoleParams, HoleReport};
use crate::Refusal;
use crate::kabsch::centroid;
use nalgebra::{Point3, Vector2};
use rayon::prelude::*;

/// Point spacing on the surface, as a share of the disc's radius, up to which nearly every hole is found: a dozen of its
/// points are missing.
const SURE_SPACING: f64 = 0.5;

/// Minimum number of points that the scan would have in the disc if it were not missing: fewer are lost by chance, and do
/// not locate it.
const MIN_POINTS: f64 = 10.0;

/// The same for the second tier, whose place something else confirms.
const MIN_POINTS_AGREEING: f64 = 6.0;

/// Variance of the number of points that one scan has where another has one, by lost points on a regular grid.
const COUNT_VARIANCE: f64 = 0.5;

/// Minimum number of missing points close together; a single one is dropout, of a sparse scan two are a spot's.
const MIN_CLUSTER: usize = 2;

/// Minimum share of missing points around a seed.
const MIN_SEED_SHARE: f64 = 0.08;

/// Factor by which a gap may be too large or too small: other losses of a scan are a little over half as large.
const WRONG_SIZE: f64 = 1.6;

/// Area per point, in squares of its spacing: a disc as wide as the ring around it holds nine points.
const RING_AREA: f64 = 2.0 * std::f64::consts::PI / 9.0;

/// Directions into which the rim is divided.
pub(super) const SECTORS: usize = 12;

/// A sector of the rim is present if the scan has this share of the points that the reference has.
const PRESENT_SHARE: f64 = 0.4;

/// Maximum number of sectors of the rim that only the reference has: another loss may touch the hole, but at the border
/// of the common view half of them are empty.
const MAX_LOST_SECTORS: usize = 4;

/// Minimum number of sectors present: at a silhouette half of them are empty in both scans.
const MIN_SEEN_SECTORS: usize = 4;

/// The same for the second tier: a strip lost along a silhouette is open on its far side and at both ends.
const MIN_SEEN_SECTORS_AGREEING: usize = 5;

/// Relative score at which a second hole makes the result ambiguous.
const AMBIGUOUS_SHARE: f64 = 0.5;

/// Minimum share of its disc that a hole of the second tier lacks: spots at the silhouette lack all of it, losses of
/// 1.2 mm radius up to 0.83.
const MIN_EMPTY_SHARE: f64 = 0.9;

/// Reference points without a counterpart, by ascending index.
pub(super) struct Missing {
    pub(super) indices: Vec<usize>,
    /// Distance inside the rim within which points still count as present, mm.
    pub(super) margin_mm: f64,
    /// Whether a hole that lacks its whole disc and is the only candidate is of the second tier.
    pub(super) alone_is_enough: bool,
}

/// A candidate for the hole.
struct Candidate {
    hole: Hole,
    n_lost: usize,
    n_seen: usize,
    n_expected: f64,
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

    fn is_of_first_tier(&self, params: &HoleParams) -> bool {
        self.is_admissible() && self.n_expected >= MIN_POINTS && self.hole.confidence >= params.min_confidence
    }

    fn is_of_second_tier(&self, params: &HoleParams) -> bool {
        let confidence = params.min_confidence_agreeing..params.min_confidence;
        self.is_admissible()
            && self.n_seen >= MIN_SEEN_SECTORS_AGREEING
            && self.n_expected >= MIN_POINTS_AGREEING
            && confidence.contains(&self.hole.confidence)
    }

    /// The hole where disc or beam explain it, with the confidence that the distance between these places leaves.
    fn placed(&self, scene: &Scene, missing: &Missing, params: &HoleParams) -> Result<Hole, Refusal> {
        let mut hole = self.hole.clone();
        hole.place(&Footprint::of_hole(scene, missing, &hole.centre, params), params);
        if hole.report.tier > 1 && params.min_confidence_agreeing >= params.min_confidence {
            return Err(Refusal::of(format!(
                "the spot is somewhere within {:.1} mm of {:.1?} mm: a disc on the surface and the cross-section of a slanted beam \
                 explain the hole with different centres, as around a hole that the silhouette cuts off (confidence {:.2}, {} \
                 needed); aim again, or turn the camera",
                hole.report.centre_uncertainty_mm.unwrap_or_default(),
                <[f64; 3]>::from(hole.centre.coords),
                hole.confidence,
                params.min_confidence
            )));
        }
        Ok(hole)
    }

    /// Score against rivals: a strip that is lost at a steep edge continues around the disc, a spot does not.
    fn score(&self) -> f64 {
        self.hole.confidence * (1.0 - self.n_lost as f64 / SECTORS as f64).powi(2)
    }
}

/// The one hole among the missing points.
pub(super) fn find(scene: &Scene, missing: &Missing, params: &HoleParams) -> Result<Hole, Refusal> {
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
    let first_tier = |c: &&Candidate| c.is_of_first_tier(params);
    if let Some(best) = candidates.iter().find(first_tier) {
        let rivals = rivals(best, candidates.iter().filter(first_tier), params);
        return match rivals.first() {
            Some(rival) => Err(Refusal::of(format!(
                "{} holes look alike, {}; crop the scan closer, or were two spots scanned?",
                rivals.len() + 1,
                two_places([best, rival].map(|c| &c.hole))
            ))),
            None => best.placed(scene, missing, params),
        };
    }
    if !missing.alone_is_enough {
        return Err(not_found);
    }
    let empty: Vec<Candidate> = candidates.into_iter().filter(Candidate::is_empty).collect();
    match empty.iter().find(|c| c.is_of_second_tier(params)) {
        Some(best) if rivals(best, empty.iter(), params).is_empty() => best.placed(scene, missing, params),
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

/// Two rivals, each with its place and confidence, for messages.
pub(super) fn two_places(rivals: [&Hole; 2]) -> String {
    let [first, second] = rivals.map(|hole| <[f64; 3]>::from(hole.centre.coords));
    let [a, b] = rivals.map(|hole| hole.confidence);
    format!("at {first:.1?} and {second:.1?} mm with confidence {a:.2} and {b:.2}")
}

/// The sector in which an offset from the centre lies.
pub(super) fn sector(offset: &Vector2<f64>) -> usize {
    let turn = (offset.y.atan2(offset.x) / std::f64::consts::TAU).rem_euclid(1.0);
    ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
}

fn too_sparse(scene: &Scene, spacing_mm: f64, params: &HoleParams) -> Refusal {
    let grid = scene.grid_mm.map(|mm| format!(" ({mm:.2} mm in the camera's grid)")).unwrap_or_default();
    Refusal::of(format!(
        "points of the {} scan are {spacing_mm:.2} mm apart on the surface{grid}, and {:.2} mm on the surface surely show a hole \
         of {} mm radius; scan closer, less slanted or with more points, or is the laser off?",
        scene.coarser_scan(),
        SURE_SPACING * params.spot_radius_mm,
        params.spot_radius_mm
    ))
}

/// The error that describes why there is no hole.
fn not_found(scene: &Scene, missing: &Missing, best: Option<&Candidate>, params: &HoleParams) -> Refusal {
    let spacing_mm = scene.surface_spacing_mm;
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
        Some(Candidate { hole, n_expected, .. }) if *n_expected < MIN_POINTS => format!(
            "the best gap, at {:.1?} mm, lacks {n_expected:.0} points of {MIN_POINTS} needed (confidence {:.2})",
            <[f64; 3]>::from(hole.centre.coords),
            hole.confidence
        ),
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
    Refusal::of(format!(
        "no hole of {} mm radius: {} reference points have no counterpart in the laser scan, and {best}; is the laser on, and its \
         spot inside the region of interest, on a side that faces the camera?",
        params.spot_radius_mm,
        missing.indices.len()
    ))
}

/// Missing points with the most missing points around, no two within a radius of each other.
fn seeds(scene: &Scene, missing: &Missing, is_missing: &[bool], radius_mm: f64) -> Vec<Point3<f64>> {
    let crowd = |&i: &usize| {
        let around = scene.within(&scene.reference, &scene.reference.points[i], radius_mm);
        let n = around.iter().filter(|(j, _)| is_missing[*j]).count();
        (if n as f64 >= MIN_SEED_SHARE * around.len() as f64 { n } else { 0 }, i)
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
            seeds.push(scene.reference.points[i]);
            scene
                .within(&scene.reference, &scene.reference.points[i], radius_mm)
                .iter()
                .for_each(|(j, _)| taken[*j] = true);
        }
    }
    seeds
}

/// Fits a disc to the missing points around `seed` and rates it.
fn rate(
    scene: &Scene,
    missing: &Missing,
    is_missing: &[bool],
    seed: &Point3<f64>,
    params: &HoleParams,
) -> Option<Candidate> {
    let radius = params.spot_radius_mm;
    let lost = |around: &Point3<f64>, reach: f64| -> Vec<usize> {
        let near = scene.within(&scene.reference, around, reach);
        near.into_iter().map(|(i, _)| i).filter(|i| is_missing[*i]).collect()
    };
    let start = centroid(&lost(seed, radius).iter().map(|&i| scene.reference.points[i]).collect::<Vec<_>>());
    let local = lost(&start, 2.0 * radius);
    let step_mm = local.iter().map(|&i| scene.spacing_mm(i)).sum::<f64>() / local.len().max(1) as f64;
    let patch = Patch::new(scene, &start, 2.0 * radius)?;
    let inside: Vec<Point3<f64>> = local.iter().map(|&i| scene.reference.points[i]).collect();
    let outside: Vec<Point3<f64>> =
        scene.within(&scene.cloud, &start, 3.0 * radius).into_iter().map(|(i, _)| scene.cloud.points[i]).collect();
    let band = step_mm.max(0.1 * radius);
    let inner = (radius - missing.margin_mm - band).max(0.1 * radius);
    let rough = patch.fit(&inside, inner, &outside, radius + band, band);
    let patch = Patch::new(scene, &rough, 2.0 * radius).unwrap_or(patch);
    let centre = patch.fit(&inside, inner, &outside, radius + band, band);

    let count = |scan: &Scan, reach: f64| scene.within(scan, &centre, reach).len() as f64;
    let core = (radius - step_mm / 2.0).max(0.5 * radius);
    let expected = |reach: f64| scene.density * count(&scene.reference, reach);
    let empty_share = (1.0 - count(&scene.cloud, core) / expected(core).max(1.0)).clamp(0.0, 1.0);
    // The share missing of a wider disc gives the radius, independent of the blurred rim.
    let wide = 1.4 * radius;
    let n_wide = expected(wide).max(1.0);
    let share = (1.0 - count(&scene.cloud, wide) / n_wide).clamp(0.0, 1.0);
    let radius_mm = wide * share.sqrt();
    // Few points measure the radius less well: a smaller loss must not pass for a spot by chance.
    let least = wide * (share - (COUNT_VARIANCE * share * (1.0 - share) / n_wide).sqrt()).max(0.0).sqrt();
    let off = if radius_mm < radius { least / radius } else { radius_mm / radius };
    let size_share = (1.0 - off.ln().abs() / WRONG_SIZE.ln()).clamp(0.0, 1.0);
    let (n_seen, n_lost) = rim(scene, &patch, &centre, radius, step_mm);
    let rim_share = n_seen as f64 / SECTORS as f64;
    let slant = scene.sight.slant(&centre, patch.normal());
    let spacing_mm = step_mm * slant;
    let area =
        scene.within(&scene.reference, &centre, core).iter().map(|(i, _)| scene.spacing_mm(*i).powi(2)).sum::<f64>()
            * RING_AREA
            * slant;
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
        centre_uncertainty_mm: None,
        confidence,
    };
    Some(Candidate { hole: Hole { centre, radius_mm, confidence, report }, n_lost, n_seen, n_expected: expected(core) })
}

/// Numbers of sectors of the rim that the scan covers, and that only the reference covers.
fn rim(scene: &Scene, patch: &Patch, centre: &Point3<f64>, radius: f64, spacing_mm: f64) -> (usize, usize) {
    let reach = radius + (0.6 * radius).max(2.0 * spacing_mm);
    let sectors = |scan: &Scan| {
        let mut sectors = [0.0; SECTORS];
        for (i, square) in scene.within(scan, centre, reach) {
            if square > radius * radius {
                let offset = patch.local(&scan.points[i]) - patch.local(centre);
                sectors[sector(&offset.xy())] += 1.0;
            }
        }
        sectors
    };
    let expected = sectors(&scene.reference).map(|n| n * scene.density);
    let counts = sectors(&scene.cloud);
    let pairs = || counts.iter().zip(&expected);
    let n_seen = pairs().filter(|(n, expected)| **n >= 1.0 && **n >= PRESENT_SHARE * **expected).count();
    let n_lost = pairs().filter(|(n, expected)| **expected >= 2.0 && **n < PRESENT_SHARE * **expected).count();
    (n_seen, n_lost)
}
