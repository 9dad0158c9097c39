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
