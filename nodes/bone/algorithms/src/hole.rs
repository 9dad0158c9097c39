//! Detection of a laser spot by the hole it leaves in a scan.
//!
//! The laser saturates the camera, so a disc around the spot is missing from the scan. It is found by comparison with a
//! full `reference` scan of the same surface; `cloud` is the scan with the laser on. Both are in one frame, each with
//! its own viewpoint, so the bone and the camera may have moved between them. [`boundary()`] needs no reference. [`rgb_spot()`]
//! finds the spot itself in a colour image.

mod blobs;
mod boundary;
mod cloud_difference;
mod footprint;
mod image;
mod patch;
mod range_image;
mod rgb_spot;
mod scene;
mod sight;
mod spot;

pub use boundary::boundary;
pub use cloud_difference::cloud_difference;
pub use range_image::range_image;
pub use rgb_spot::{Mark, RgbSpotError, RgbSpotParams, rgb_spot};

use footprint::{Footprint, Place};
use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of all detectors.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HoleParams {
    /// Radius of the hole that the spot leaves, mm. 2: the laser of the paper.
    #[schemars(range(min = 0.1, max = 50.0))]
    pub spot_radius_mm: f64,
    /// Maximum median distance of the scan with the laser from the reference, mm. 0.5: markers tracked to 0.06 mm and
    /// 0.023 degrees explain up to 0.35 mm where bone and camera have moved between the scans; beyond, one has moved without its
    /// marker.
    #[schemars(range(min = 1e-3, max = 10.0))]
    pub max_scan_residual_mm: f64,
    /// Minimum confidence. 0.4: losses of 1.2 mm radius for other reasons rarely get more, a hole on the face of a bone
    /// 0.7 and more.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_confidence: f64,
    /// Minimum confidence of a hole of the second tier, which lacks its whole disc and is the only candidate: no other has
    /// half its score. 0.14: spots at the silhouette, which hides up to two thirds of them; lost patches rarely lack a whole disc. Such a
    /// hole counts only where something else confirms it, as the distances to other landmarks in `coarse.three_point`.
    /// 1: no second tier.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_confidence_agreeing: f64,
}

impl Default for HoleParams {
    fn default() -> Self {
        Self { spot_radius_mm: 2.0, max_scan_residual_mm: 0.5, min_confidence: 0.4, min_confidence_agreeing: 0.14 }
    }
}

/// The hole of a laser spot.
#[derive(Debug, Clone, PartialEq)]
pub struct Hole {
    /// The centre of the hole, on the surface, mm, in the clouds' frame.
    pub centre: Point3<f64>,
    /// Radius of the disc that is missing, as measured, mm.
    pub radius_mm: f64,
    /// Confidence, 0 to 1; see [`HoleReport::confidence`].
    pub confidence: f64,
    /// The quantities behind the confidence.
    pub report: HoleReport,
}

/// The quantities behind the confidence of a hole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HoleReport {
    /// 1 if the confidence reaches `min_confidence`, 2 if only `min_confidence_agreeing`: then something else has to confirm
    /// the hole. 2 too where `centre_uncertainty_mm` lowers it.
    pub tier: u8,
    /// Points of the reference scan, or of the scan with its gaps filled where there is no reference.
    pub n_reference: usize,
    /// Points of the scan with the laser.
    pub n_cloud: usize,
    /// Reference points without a counterpart in the scan with the laser, everywhere.
    pub n_missing: usize,
    /// Missing reference points within the hole.
    pub n_hole: usize,
    /// Number of candidate positions.
    pub n_candidates: usize,
    /// Point spacing of the coarser scan on the surface around the hole, mm: more than in the camera's grid where the
    /// surface is slanted.
    pub spacing_mm: f64,
    /// Point spacing of the scan with the laser in the camera's grid, across the line of sight, mm; none without a
    /// viewpoint.
    pub grid_mm: Option<f64>,
    /// Median distance of the scan with the laser from the reference's surface, mm.
    pub scan_residual_mm: f64,
    /// Radius of the missing disc, measured by the number of missing points, mm.
    pub radius_mm: f64,
    /// Radius expected, mm.
    pub expected_radius_mm: f64,
    /// Share of the expected points inside the hole that are missing.
    pub empty_share: f64,
    /// Share of the disc that the reference covers: less where the hole reaches over the silhouette.
    pub seen_share: f64,
    /// Share of the rim, by direction, that the scan with the laser covers.
    pub rim_share: f64,
    /// 1 if the radius is as expected, falling to 0 where it is 1.6 times too small or too large; of a radius too small its
    /// lower standard error counts, so that few points give less.
    pub size_share: f64,
    /// Largest distance from the centre of another place at which the spot explains the hole as well, mm. A disc on the surface and
    /// the cross-section of a slanted beam have different centres where the silhouette cuts the hole off. None without a viewpoint.
    #[serde(default)]
    pub centre_uncertainty_mm: Option<f64>,
    /// `empty_share² · seen_share · √rim_share · size_share`, times the share `(r / (r + centre_uncertainty_mm))²` that the spot of radius r has of
    /// the area in which it may be. The last factor does not lower it below `min_confidence_agreeing`.
    pub confidence: f64,
}

impl Hole {
    /// Moves the centre to the place that explains the footprint, and lowers the confidence to the share of the area in which the spot
    /// may be that the spot has, but not below that of the second tier, if there is one.
    fn place(&mut self, footprint: &Footprint<'_>, params: &HoleParams) {
        let radius_mm = params.spot_radius_mm;
        if let Some(Place { centre, uncertainty_mm }) = footprint.place(self.centre) {
            let share = (radius_mm / (radius_mm + uncertainty_mm)).powi(2);
            let agreeing = params.min_confidence_agreeing;
            let least = if agreeing < params.min_confidence { agreeing.min(self.confidence) } else { 0.0 };
            self.centre = centre;
            self.confidence = (self.confidence * share).max(least);
            self.report.centre_uncertainty_mm = Some(uncertainty_mm);
        }
        self.report.confidence = self.confidence;
        self.report.tier = if self.confidence < params.min_confidence { 2 } else { 1 };
    }
}

/// Errors of the detectors.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HoleError {
    /// A cloud is empty.
    #[error("the {what} scan has no points; is the region of interest around the bone?")]
    Empty {
        /// `reference` or `laser`.
        what: &'static str,
    },
    /// The scans do not coincide.
    #[error(
        "the laser scan lies {residual_mm:.2} mm (median) from the reference scan, {limit_mm} mm is allowed; did the bone \
         or the camera move without a marker, or is the calibration off?"
    )]
    ScansApart {
        /// Median distance found.
        residual_mm: f64,
        /// Distance allowed.
        limit_mm: f64,
    },
    /// No hole was found.
    #[error(
        "no hole of {expected_radius_mm} mm radius: {n_missing} reference points have no counterpart in the laser scan, \
         and {best}; is the laser on, and its spot inside the region of interest?"
    )]
    None {
        /// Radius expected.
        expected_radius_mm: f64,
        /// Reference points without a counterpart.
        n_missing: usize,
        /// Description of the best candidate.
        best: String,
    },
    /// There is more than one hole.
    #[error(
        "{n} holes look alike, at {first:.1?} and {second:.1?} mm with confidence {first_confidence:.2} and \
         {second_confidence:.2}; crop the scan closer, or were two spots scanned?"
    )]
    Several {
        /// Number of holes.
        n: usize,
        /// Centre of the most confident one.
        first: [f64; 3],
        /// Centre of the next one.
        second: [f64; 3],
        /// Confidence of the first.
        first_confidence: f64,
        /// Confidence of the second.
        second_confidence: f64,
    },
    /// The hole does not determine the place of the spot, and there is no second tier.
    #[error(
        "the spot is somewhere within {uncertainty_mm:.1} mm of {at:.1?} mm: a disc on the surface and the cross-section of a slanted beam \
         explain the hole with different centres, as around a hole that the silhouette cuts off (confidence {confidence:.2}, {needed} \
         needed); aim again, or turn the camera"
    )]
    Uncertain {
        /// Centre of the hole.
        at: [f64; 3],
        /// Distance of the farthest place that explains it.
        uncertainty_mm: f64,
        /// Its confidence.
        confidence: f64,
        /// Confidence needed.
        needed: f64,
    },
    /// The points are too far apart to show a hole.
    #[error(
        "points of the {what} scan are {spacing_mm:.2} mm apart on the surface{}, and {needed_mm:.2} mm on the surface \
         surely show a hole of {expected_radius_mm} mm radius; scan closer, less slanted or with more points, or is the \
         laser off?",
        grid_mm.map(|mm| format!(" ({mm:.2} mm in the camera's grid)")).unwrap_or_default()
    )]
    TooSparse {
        /// `reference` or `laser`.
        what: &'static str,
        /// Spacing found on the surface.
        spacing_mm: f64,
        /// Spacing found in the camera's grid, if its viewpoint is known.
        grid_mm: Option<f64>,
        /// Spacing on the surface at which every hole is found.
        needed_mm: f64,
        /// Radius expected.
        expected_radius_mm: f64,
    },
    /// The laser scan does not say where its camera was.
    #[error("the laser scan has no viewpoint, which its camera's image needs; use hole.cloud_difference, or set it")]
    NoViewpoint,
}
