use super::blobs::{Blob, Channels, Mask, blobs};
use super::cloud_difference::missing;
use super::footprint::Footprint;
use super::patch::Patch;
use super::scene::{Scene, no_viewpoint};
use super::spot::{SECTORS, sector, two_places};
use super::{Hole, HoleParams, HoleReport};
use crate::Refusal;
use nalgebra::{Isometry3, Matrix3, Point3, Vector2, Vector3};
use osteoflow_geometry::{Cloud, Image, Intrinsics};
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Pixels of a blob below which its place is a matter of noise.
const MIN_PIXELS: usize = 12;

/// Factor by which a spot may look too large or too small: how far out its light is seen depends on the exposure.
const WRONG_SIZE: f64 = 2.5;

/// Minimum number of sectors with a rim: a circle's centre is determined by less, but not along its axis.
const MIN_SECTORS: usize = 7;

/// Relative confidence at which a second blob makes the result ambiguous.
const AMBIGUOUS_SHARE: f64 = 0.5;

/// Share of the disc that the scan with the laser has to lack. Half: highlights and noise fill some of it.
const MIN_EMPTY_SHARE: f64 = 0.5;

/// Minimum share of the cloud's points within the image.
const MIN_IN_IMAGE: f64 = 0.5;

/// Levels of a black pixel, and of a saturated channel.
const BLACK: u8 = 12;
const SATURATED: u8 = 250;

/// Number of steps of the fit of a circle.
const STEPS: usize = 12;

/// The mark to find in an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mark {
    /// The spot of a red laser.
    #[default]
    Laser,
    /// A mark of a violet or blue surgical pen.
    Pen,
}

/// Parameters of [`rgb_spot`].
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct RgbSpotParams {
    /// What to find: `laser`, a red spot, or `pen`, a violet or blue mark. laser: the paper's.
    pub mark: Mark,
    /// Radius of the coloured spot on the surface; found spots may be 2.5 times smaller or larger. 2: the paper's laser.
    #[param(HoleParams::default().spot_radius_mm, 0.1..=50.0)]
    pub spot_radius_mm: f64,
    /// Maximum median distance of the scan with the laser from the reference. 0.5: as of the other detectors.
    #[param(HoleParams::default().max_scan_residual_mm, 1e-3..=10.0)]
    pub max_scan_residual_mm: f64,
    /// Minimum confidence. 0.4: as of the other detectors; a rim in 7 of 12 directions and a radius twice too small give 0.38.
    #[param(HoleParams::default().min_confidence, 0.0..=1.0)]
    pub min_confidence: f64,
    /// Minimum difference of the spot's colour from the bone's, levels of 255. 40: noise of 2 levels and ivory bone stay below 25.
    #[param(40.0, 1.0..=255.0)]
    pub min_contrast: f64,
    /// Whether the scan has to lack half of its points at the laser's spot (not for a pen). true: this recognises a mirrored
    /// image, wrong intrinsics, the image of another scan, and a spot that the silhouette partly hides; false: for a camera
    /// whose depth the laser does not disturb.
    #[param(true)]
    pub require_hole: bool,
}

impl Mark {
    fn colour(self) -> &'static str {
        match self {
            Self::Laser => "red",
            Self::Pen => "violet or blue",
        }
    }

    /// How much a colour is that of the mark, levels.
    /// Exchanging red and blue takes neither mark to itself.
    fn strength(self, [red, green, blue]: [f64; 3]) -> f64 {
        match self {
            Self::Laser => red - green.max(blue),
            Self::Pen => blue - red.max(green),
        }
    }
}

/// The point under a laser's spot or a pen's mark in a colour image of the scan.
///
/// The scans show which pixels are bone; there, blobs of the mark's colour are found by their contrast to the bone's own.
/// A laser saturates its core, so a saturated area within a red ring belongs to the spot, and one without red is glare. The rim of the blob, where it borders on bone, is carried along the camera's rays onto the surface, a quadratic fitted
/// to the reference around the spot, and a circle fitted to it gives the centre: it does not move where glare covers a part of the
/// spot, or where the silhouette cuts it off. The scan with the laser has its hole at the same place, which an image that is
/// mirrored, of another scan or with other intrinsics contradicts.
///
/// Both clouds are in one frame, and `t_camera_image` takes coordinates of the image's camera to those of the camera that
/// took `cloud`. `O(n log n)` and `O(pixels)`.
///
/// # Errors
/// [`Refusal`]: no spot, more than one, one at the silhouette, or an image that contradicts the scan.
pub fn rgb_spot(
    reference: &Cloud,
    cloud: &Cloud,
    image: &Image,
    t_camera_image: &Isometry3<f64>,
    params: &RgbSpotParams,
) -> Result<Hole, Refusal> {
    let t_cloud_image = cloud.viewpoint.ok_or_else(no_viewpoint)? * t_camera_image;
    if image.channels() == 1 {
        let reason =
            "the image is grey, and the spot is found by its colour; use hole.cloud_difference, or a colour image";
        return Err(Refusal::of(reason));
    }
    let scene = Scene::new(reference, cloud, &params.of_holes())?;
    let search = Search::new(&scene, image, t_cloud_image, params)?;
    search.check_exposure()?;
    let spots = search.candidates(Channels::Rgb);
    let colour = params.mark.colour();
    let good: Vec<&Hole> = spots.iter().map(|c| &c.hole).filter(|h| h.confidence >= params.min_confidence).collect();
    let Some(best) = good.first() else { return Err(search.nothing(&spots)) };
    let is_rival = |h: &&&Hole| {
        h.confidence > AMBIGUOUS_SHARE * best.confidence && (h.centre - best.centre).norm() > params.spot_radius_mm
    };
    let rivals: Vec<&&Hole> = good.iter().skip(1).filter(is_rival).collect();
    if let Some(rival) = rivals.first() {
        return Err(Refusal::of(format!(
            "{} {colour} spots look alike, {}; is one a reflection, or another mark?",
            rivals.len() + 1,
            two_places([best, rival])
        )));
    }
    if params.mark == Mark::Laser && params.require_hole && best.report.empty_share < MIN_EMPTY_SHARE {
        let at = <[f64; 3]>::from(best.centre.coords);
        let (percent, needed) = (best.report.empty_share * 100.0, MIN_EMPTY_SHARE * 100.0);
        return Err(Refusal::of(format!(
            "the image shows the laser at {at:.1?} mm, where the scan lacks {percent:.0} % of its points, {needed:.0} % needed; is \
             the image mirrored, of another scan or camera, or are its intrinsics wrong?"
        )));
    }
    Ok(search.placed(best, spots.len()))
}

impl RgbSpotParams {
    fn of_holes(&self) -> HoleParams {
        HoleParams {
            spot_radius_mm: self.spot_radius_mm,
            max_scan_residual_mm: self.max_scan_residual_mm,
            min_confidence: self.min_confidence,
            ..HoleParams::default()
        }
    }
}

/// A blob on the surface.
struct Candidate {
    hole: Hole,
    n_sectors: usize,
}

/// The bone in the image.
struct Search<'a> {
    scene: &'a Scene,
    image: &'a Image,
    t_cloud_image: Isometry3<f64>,
    params: &'a RgbSpotParams,
    /// Pixels that show the reference.
    mask: Mask,
    /// Pixels of the reference's points, with their depth and index.
    seen: Vec<([f64; 2], f64, usize)>,
    /// Point spacing, pixels.
    spacing_px: f64,
    /// Median depth, mm.
    depth_mm: f64,
}

impl<'a> Search<'a> {
    fn new(
        scene: &'a Scene,
        image: &'a Image,
        t_cloud_image: Isometry3<f64>,
        params: &'a RgbSpotParams,
    ) -> Result<Self, Refusal> {
        let t_image_cloud = t_cloud_image.inverse();
        let [width, height] = [image.width(), image.height()].map(f64::from);
        let points = &scene.reference.points;
        let seen: Vec<([f64; 2], f64, usize)> = points
            .iter()
            .enumerate()
            .filter_map(|(i, point)| {
                let point = t_image_cloud * point;
                let [u, v] = image.intrinsics().pixel(&point)?;
                let inside = (0.0..width - 0.5).contains(&u) && (0.0..height - 0.5).contains(&v);
                inside.then_some(([u, v], point.z, i))
            })
            .collect();
        let share = seen.len() as f64 / points.len() as f64;
        if share < MIN_IN_IMAGE {
            let (percent, needed) = (share * 100.0, MIN_IN_IMAGE * 100.0);
            let distortion = image.intrinsics().distortion;
            let bent = distortion.name().map_or_else(String::new, |name| {
                let limit_deg = distortion.limit_rad().to_degrees();
                format!(" (its distortion, {name}, holds up to {limit_deg:.1} degrees from the axis)")
            });
            return Err(Refusal::of(format!(
                "{percent:.0} % of the scan's points are within the image{bent}, {needed:.0} % needed; do image and scan belong \
                 together, and the intrinsics to the image?"
            )));
        }
        let depth_mm = crate::median::median(&mut seen.iter().map(|(_, depth, _)| *depth).collect::<Vec<_>>());
        let spacing_px = scene.median_spacing_mm * image.intrinsics().fx / depth_mm;
        let mask = Mask::of(image, seen.iter().map(|(pixel, ..)| *pixel), 1.5 * spacing_px.max(1.0));
        Ok(Self { scene, image, t_cloud_image, params, mask, seen, spacing_px, depth_mm })
    }

    fn check_exposure(&self) -> Result<(), Refusal> {
        let pixels = self.mask.pixels().count().max(1) as f64;
        let percent = |is: &dyn Fn([u8; 3]) -> bool| {
            100.0 * self.mask.pixels().filter(|[x, y]| is(self.image.rgb(*x, *y))).count() as f64 / pixels
        };
        let black = percent(&|rgb| rgb.iter().all(|c| *c <= BLACK));
        let saturated = percent(&|rgb| rgb.iter().any(|c| *c >= SATURATED));
        match [("black", black), ("saturated", saturated)].into_iter().find(|(_, percent)| *percent > 50.0) {
            None => Ok(()),
            Some((what, percent)) => Err(Refusal::of(format!(
                "the image is {what} at {percent:.0} % of the bone's pixels; change its exposure"
            ))),
        }
    }

    /// The blobs of the mark's colour on the surface, best first.
    fn candidates(&self, channels: Channels) -> Vec<Candidate> {
        let strength = |rgb| self.params.mark.strength(rgb);
        let spots = blobs(self.image, &self.mask, channels, &strength, self.params.min_contrast, SATURATED);
        let mut candidates: Vec<Candidate> =
            spots.iter().filter(|blob| blob.n_pixels >= MIN_PIXELS).filter_map(|blob| self.rate(blob)).collect();
        candidates.sort_by(|a, b| b.hole.confidence.total_cmp(&a.hole.confidence));
        candidates
    }

    /// Fits a circle to the rim of a blob, on the surface.
    fn rate(&self, blob: &Blob) -> Option<Candidate> {
        let radius = self.params.spot_radius_mm;
        let rough = self.surface_at(blob.centre)?;
        let patch = Patch::new(self.scene, &rough, 2.0 * radius)?;
        let origin = Point3::from(self.t_cloud_image.translation.vector);
        let on_patch = |pixel: &[f64; 2]| {
            let along = (self.t_cloud_image * self.intrinsics().ray(*pixel)?).normalize();
            patch.hit(&origin, &along, WRONG_SIZE * radius)
        };
        let rim: Vec<Vector2<f64>> = blob.rim.iter().filter_map(on_patch).collect();
        let middle = on_patch(&blob.centre)?;
        let (at, radius_mm) = circle(&rim, middle)?;
        let centre = patch.on_surface(&at);
        let mut sectors = [false; SECTORS];
        rim.iter().for_each(|p| sectors[sector(&(p - at))] = true);
        let n_sectors = sectors.iter().filter(|s| **s).count();
        let size_share = (1.0 - (radius_mm / radius).ln().abs() / WRONG_SIZE.ln()).clamp(0.0, 1.0);
        let rim_share = n_sectors as f64 / SECTORS as f64;
        // Where the circle was extrapolated far from the blob, it is not determined.
        if (at - middle).norm() > radius {
            return None;
        }
        let core = 0.75 * radius;
        let n_reference = self.scene.within(&self.scene.reference, &centre, core).len() as f64 * self.scene.density;
        let n_cloud = self.scene.within(&self.scene.cloud, &centre, core).len() as f64;
        let empty_share = (1.0 - n_cloud / n_reference.max(1.0)).clamp(0.0, 1.0);
        let is_closed = n_sectors >= MIN_SECTORS;
        let confidence = if is_closed { (rim_share * size_share).sqrt() } else { 0.0 };
        let n_missing = (n_reference - n_cloud).max(0.0).round() as usize;
        let scene = self.scene;
        let report = HoleReport {
            tier: 1,
            n_reference: scene.reference.len(),
            n_cloud: scene.cloud.len(),
            n_missing,
            n_hole: n_missing,
            n_candidates: 0,
            spacing_mm: scene.surface_spacing_mm,
            grid_mm: scene.grid_mm,
            scan_residual_mm: scene.residual_mm,
            radius_mm,
            expected_radius_mm: radius,
            empty_share,
            seen_share: 1.0,
            rim_share,
            size_share,
            centre_uncertainty_mm: None,
            confidence,
        };
        Some(Candidate { hole: Hole { centre, radius_mm, confidence, report }, n_sectors })
    }

    fn intrinsics(&self) -> &Intrinsics {
        self.image.intrinsics()
    }

    /// The surface in front at a pixel: the nearest of the points seen there.
    fn surface_at(&self, pixel: [f64; 2]) -> Option<Point3<f64>> {
        let reach = self.reach_px();
        let off = |at: &[f64; 2]| (at[0] - pixel[0]).hypot(at[1] - pixel[1]);
        let front = self.seen.iter().filter(|(at, ..)| off(at) <= reach).min_by(|a, b| a.1.total_cmp(&b.1))?;
        // Behind the point in front by more than the spot is another surface.
        let is_in_front = |depth: f64| depth - front.1 < self.params.spot_radius_mm;
        let near = self.seen.iter().filter(|(_, depth, _)| is_in_front(*depth));
        let nearest = near.min_by(|a, b| off(&a.0).total_cmp(&off(&b.0)))?;
        Some(self.scene.reference.points[nearest.2])
    }

    /// Distance within which the surface at a pixel is known, pixels.
    fn reach_px(&self) -> f64 {
        3.0 * self.spacing_px.max(1.0)
    }

    /// The hole where disc or beam explain what the scan lacks, with the confidence that the distance between these places leaves.
    fn placed(&self, best: &Hole, n_candidates: usize) -> Hole {
        let mut hole = best.clone();
        hole.report.n_candidates = n_candidates;
        if self.params.mark == Mark::Laser && self.params.require_hole {
            let params = self.params.of_holes();
            let missing = missing(self.scene, &params);
            let footprint = Footprint::of_hole(self.scene, &missing, &hole.centre, &params).shown_at(hole.centre);
            hole.place(&footprint, &params);
        }
        hole
    }

    /// The error that describes why there is no spot.
    fn nothing(&self, spots: &[Candidate]) -> Refusal {
        let (colour, radius_mm) = (self.params.mark.colour(), self.params.spot_radius_mm);
        let none = |best: &str| Refusal::of(format!("no {colour} spot of {radius_mm} mm radius on the bone: {best}"));
        let size_share = |c: &Candidate| c.hole.report.size_share;
        let closest = spots.iter().max_by(|a, b| size_share(a).total_cmp(&size_share(b)));
        if let Some(cut) = closest.filter(|c| size_share(c) > 0.0 && c.n_sectors < MIN_SECTORS) {
            let (at, n) = (<[f64; 3]>::from(cut.hole.centre.coords), cut.n_sectors);
            return Refusal::of(format!(
                "the {colour} spot at {at:.1?} mm has a rim in {n} of {SECTORS} directions, {MIN_SECTORS} needed: it is at the \
                 bone's silhouette or under a highlight; aim again, or turn the camera"
            ));
        }
        if let Some(c) = closest {
            let (percent, needed) = (c.n_sectors as f64 / SECTORS as f64 * 100.0, self.params.min_confidence);
            let at = <[f64; 3]>::from(c.hole.centre.coords);
            return none(&format!(
                "the best one, at {at:.1?} mm, has a radius of {:.1} mm and {percent:.0} % of its rim (confidence {:.2}, {needed} \
                 needed)",
                c.hole.radius_mm, c.hole.confidence
            ));
        }
        // What is neither on the bone nor on its surface has no point.
        let all = Mask::all(self.image);
        let strength = |rgb| self.params.mark.strength(rgb);
        let beside = blobs(self.image, &all, Channels::Rgb, &strength, self.params.min_contrast, SATURATED);
        let is_of_size = |blob: &&Blob| {
            let mm = (blob.n_pixels as f64 / std::f64::consts::PI).sqrt() * self.depth_mm / self.intrinsics().fx;
            blob.n_pixels >= MIN_PIXELS && (mm / radius_mm).ln().abs() < WRONG_SIZE.ln()
        };
        if let Some(blob) = beside.iter().filter(is_of_size).max_by_key(|blob| blob.n_pixels) {
            let off = |at: &[f64; 2]| (at[0] - blob.centre[0]).hypot(at[1] - blob.centre[1]);
            let nearest_px = self.seen.iter().map(|(at, ..)| off(at)).fold(f64::MAX, f64::min);
            let mm = self.depth_mm / self.intrinsics().fx;
            let (distance_mm, limit_mm) = (nearest_px * mm, self.reach_px() * mm);
            if nearest_px > self.reach_px() {
                return Refusal::of(format!(
                    "the {colour} spot at pixel {:.0?} is {distance_mm:.1} mm from the nearest point of the scan, {limit_mm:.1} mm \
                     allowed",
                    blob.centre
                ));
            }
        }
        let is_swapped = self.candidates(Channels::Bgr).iter().any(|c| c.hole.confidence >= self.params.min_confidence);
        let on_bone = blobs(self.image, &self.mask, Channels::Rgb, &strength, self.params.min_contrast, SATURATED);
        if let Some(blob) = on_bone.iter().max_by_key(|blob| blob.n_pixels).filter(|_| !is_swapped) {
            let (pixel, n) = (blob.centre, blob.n_pixels);
            return none(&format!(
                "the largest blob of that colour, at pixel {pixel:.0?}, has {n} pixels ({MIN_PIXELS} needed) and no rim that \
                     determines its centre; is it at the bone's silhouette or under a highlight?"
            ));
        }
        let hint = match (is_swapped, self.params.mark) {
            (true, Mark::Laser) => {
                "; is the laser on and red? With red and blue exchanged there is one: is the image BGR?"
            }
            (true, Mark::Pen) => "; with red and blue exchanged there is one: is the image BGR?",
            (false, Mark::Laser) => "; is the laser on and red, and the exposure short enough for its colour?",
            (false, Mark::Pen) => "; is the mark in view, and lit well enough to have a colour?",
        };
        none(&format!("no blob has that colour{hint}"))
    }
}

/// Centre and radius of the circle through points of its rim, robust to a minority that are not: weights fall beyond 15 % of
/// the radius.
fn circle(rim: &[Vector2<f64>], start: Vector2<f64>) -> Option<(Vector2<f64>, f64)> {
    const BAND: f64 = 0.15;
    if rim.len() < MIN_SECTORS {
        return None;
    }
    let mut radii: Vec<f64> = rim.iter().map(|p| (p - start).norm()).collect();
    let (mut at, mut radius) = (start, crate::median::median(&mut radii));
    for _ in 0..STEPS {
        // Algebraic fit of x² + y² = 2 a x + 2 b y + c about the present centre.
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for p in rim.iter().map(|p| p - at) {
            let off = (p.norm() - radius).abs() / (BAND * radius).max(1e-9);
            let weight = if off > 1.0 { 1.0 / off.powi(2) } else { 1.0 };
            let row = Vector3::new(2.0 * p.x, 2.0 * p.y, 1.0);
            normal += row * row.transpose() * weight;
            right += row * (p.norm_squared() * weight);
        }
        let solved = normal.cholesky()?.solve(&right);
        at += Vector2::new(solved.x, solved.y);
        radius = (solved.z + solved.x.powi(2) + solved.y.powi(2)).max(0.0).sqrt();
    }
    (at.iter().all(|c| c.is_finite()) && radius.is_finite()).then_some((at, radius))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on_circle(turn_deg: f64) -> Vector2<f64> {
        let (sin, cos) = turn_deg.to_radians().sin_cos();
        Vector2::new(0.3 + 2.0 * cos, -0.4 + 2.0 * sin)
    }

    #[test]
    fn a_circle_is_found_from_two_thirds_of_its_rim_with_a_few_points_beside_it() {
        let mut rim: Vec<Vector2<f64>> = (0..240).step_by(5).map(|deg| on_circle(f64::from(deg))).collect();
        rim.extend([Vector2::new(0.5, 0.0), Vector2::new(4.0, 1.0), Vector2::new(0.0, -4.0)]);
        let (at, radius) = circle(&rim, Vector2::zeros()).unwrap();
        assert!((at - Vector2::new(0.3, -0.4)).norm() < 0.05, "{at}");
        assert!((radius - 2.0).abs() < 0.05, "{radius} mm");
    }

    #[test]
    fn points_in_one_place_and_too_few_are_no_circle() {
        assert_eq!(circle(&[Vector2::new(1.0, 1.0); 30], Vector2::zeros()), None);
        assert_eq!(circle(&[on_circle(0.0), on_circle(90.0), on_circle(180.0)], Vector2::zeros()), None);
    }

    #[test]
    fn a_laser_and_a_pen_are_not_taken_for_each_other_when_red_and_blue_are_exchanged() {
        let (laser, pen) = ([255.0, 120.0, 100.0], [60.0, 30.0, 85.0]);
        let bgr = |[red, green, blue]: [f64; 3]| [blue, green, red];
        assert!(Mark::Laser.strength(laser) > 100.0 && Mark::Laser.strength(bgr(laser)) < 0.0);
        assert!(Mark::Pen.strength(pen) > 20.0 && Mark::Pen.strength(bgr(pen)) < 0.0);
    }
}
