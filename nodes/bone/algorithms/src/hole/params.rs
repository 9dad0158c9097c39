use schemars::JsonSchema;
use serde::Deserialize;

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
    /// half its score. 0.14: spots at the silhouette, which hides up to two thirds of them; lost patches rarely lack a
    /// whole disc. Such a hole is used only if something else confirms it, such as the distances to other landmarks in
    /// `coarse.three_point`. 1: no second tier.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_confidence_agreeing: f64,
}

impl Default for HoleParams {
    fn default() -> Self {
        Self { spot_radius_mm: 2.0, max_scan_residual_mm: 0.5, min_confidence: 0.4, min_confidence_agreeing: 0.14 }
    }
}
