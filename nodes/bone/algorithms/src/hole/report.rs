use nalgebra::Point3;
use serde::{Deserialize, Serialize};

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
