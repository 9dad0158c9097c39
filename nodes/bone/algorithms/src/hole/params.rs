use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::Deserialize;

/// Parameters of all detectors.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct HoleParams {
    /// Radius of the hole that the spot leaves. 2: the paper's laser.
    #[param(2.0, 0.1..=50.0)]
    pub spot_radius_mm: f64,
    /// Maximum median distance of the scan with the laser from the reference. 0.5: markers tracked to 0.06 mm and 0.023 degrees
    /// explain up to 0.35 mm if bone and camera have moved; beyond, one has moved without its marker.
    #[param(0.5, 1e-3..=10.0)]
    pub max_scan_residual_mm: f64,
    /// Minimum confidence. 0.4: other losses of 1.2 mm radius rarely have more, a hole on the face of a bone 0.7 and more.
    #[param(0.4, 0.0..=1.0)]
    pub min_confidence: f64,
    /// Minimum confidence of a hole of the second tier: it lacks its whole disc, is the only candidate (no other has half its
    /// score), and is used only if something confirms it, such as the distances of `coarse.three_point`. 0.14: the silhouette
    /// hides up to two thirds of a spot; lost patches rarely lack a whole disc. 1: no second tier.
    #[param(0.14, 0.0..=1.0)]
    pub min_confidence_agreeing: f64,
}
