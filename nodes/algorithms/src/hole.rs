//! Where a laser spot was: the hole it leaves in a scan.
//!
//! The laser saturates the camera, so that a disc around the spot is missing from the scan. It is found against a full
//! `reference` scan of the same surface; `cloud` is the scan with the laser on. Both lie in one frame, each with its own
//! viewpoint, so that the bone and the camera may have moved between them. [`boundary()`] does without the reference.

mod boundary;
mod cloud_difference;
mod image;
mod range_image;
mod scene;
mod spot;

pub use boundary::boundary;
pub use cloud_difference::cloud_difference;
pub use range_image::range_image;

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What counts as the hole of a laser spot; the same for every detector.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HoleParams {
    /// Radius of the hole that the spot leaves, mm. 2: the laser of the paper.
    #[schemars(range(min = 0.1, max = 50.0))]
    pub spot_radius_mm: f64,
    /// Refuse where the median distance of the scan with the laser from the reference is larger than this, mm. 0.3: the
    /// bone or the camera has then moved by more than the hole's centre may be off.
    #[schemars(range(min = 1e-3, max = 10.0))]
    pub max_scan_residual_mm: f64,
    /// Refuse a hole that is less sure than this. 0.4: losses of 1.2 mm radius for other reasons rarely
    /// get more, a hole on the face of a bone 0.7 and more.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_confidence: f64,
}

impl Default for HoleParams {
    fn default() -> Self {
        Self { spot_radius_mm: 2.0, max_scan_residual_mm: 0.3, min_confidence: 0.4 }
    }
}

/// The hole of a laser spot.
#[derive(Debug, Clone, PartialEq)]
pub struct Hole {
    /// The middle of the hole, on the surface, mm, in the clouds' frame.
    pub centre: Point3<f64>,
    /// Radius of the disc that is missing, as measured, mm.
    pub radius_mm: f64,
    /// How sure it is, 0 to 1: from the three shares in the report.
    pub confidence: f64,
    /// What it was judged by.
    pub report: HoleReport,
}

/// What a hole was judged by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HoleReport {
    /// Points of the reference scan, or of the scan with its gaps filled where there is no reference.
    pub n_reference: usize,
    /// Points of the scan with the laser.
    pub n_cloud: usize,
    /// Reference points without a partner in the scan with the laser, everywhere.
    pub n_missing: usize,
    /// Those within the hole.
    pub n_hole: usize,
    /// Places that were looked at as possible holes.
    pub n_candidates: usize,
    /// Point spacing of the reference around the hole, mm.
    pub spacing_mm: f64,
    /// Median distance of the scan with the laser from the reference's surface, mm.
    pub scan_residual_mm: f64,
    /// Radius of the disc that is missing, as measured from how many points are, mm.
    pub radius_mm: f64,
    /// Radius expected, mm.
    pub expected_radius_mm: f64,
    /// Share of the expected points inside the hole that are indeed missing.
    pub empty_share: f64,
    /// Share of the disc that the reference shows: less where the hole reaches over the silhouette.
    pub seen_share: f64,
    /// Share of the rim, by direction, where the scan with the laser is there again.
    pub rim_share: f64,
    /// 1 where the radius is as expected, falling to 0 where it is 1.6 times too small or too large.
    pub size_share: f64,
    /// `empty_share² · seen_share · √rim_share · size_share`: a hole is empty whatever else is lost around it.
    pub confidence: f64,
}

/// Why there is no hole.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HoleError {
    /// A cloud is empty.
    #[error("the {what} scan has no points; is the region of interest around the bone?")]
    Empty {
        /// `reference` or `laser`.
        what: &'static str,
    },
    /// The scans do not lie on each other.
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
    /// Nothing is missing.
    #[error(
        "no hole of {expected_radius_mm} mm radius: {n_missing} reference points have no partner in the laser scan, and \
         {best}; is the laser on, and its spot inside the region of interest?"
    )]
    None {
        /// Radius expected.
        expected_radius_mm: f64,
        /// Reference points without a partner.
        n_missing: usize,
        /// What came closest, in words.
        best: String,
    },
    /// There is more than one.
    #[error(
        "{n} holes look alike, at {first:.1?} and {second:.1?} mm with confidence {first_confidence:.2} and \
         {second_confidence:.2}; crop the scan closer, or were two spots scanned?"
    )]
    Several {
        /// How many.
        n: usize,
        /// The surest one's centre.
        first: [f64; 3],
        /// The next one's centre.
        second: [f64; 3],
        /// The surest one's confidence.
        first_confidence: f64,
        /// The next one's confidence.
        second_confidence: f64,
    },
    /// The points are too far apart to show a hole.
    #[error(
        "points of the {what} scan are {spacing_mm:.2} mm apart, which cannot resolve a hole of {expected_radius_mm} mm \
         radius ({needed_mm:.2} mm can); scan closer or with more points"
    )]
    TooSparse {
        /// `reference` or `laser`.
        what: &'static str,
        /// Spacing found.
        spacing_mm: f64,
        /// Spacing needed.
        needed_mm: f64,
        /// Radius expected.
        expected_radius_mm: f64,
    },
    /// The laser scan does not say where its camera was.
    #[error("the laser scan has no viewpoint, which its camera's image needs; use hole.cloud_difference, or set it")]
    NoViewpoint,
}
