use super::paired::paired;
use crate::Refusal;
use nalgebra::Isometry3;
use osteoflow_geometry::NamedPoint;
use serde::{Deserialize, Serialize};

/// Fiducial registration error: the residual at the points used to fit. It does not predict the TRE.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FreReport {
    /// `√(Σ |t_target_source · s - t|² / n)`, mm.
    pub rms_mm: f64,
    /// The residual of each point.
    pub points: Vec<FrePoint>,
    /// Number of points.
    pub n: usize,
}

/// The residual at one fitted point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrePoint {
    /// Its name.
    pub name: String,
    /// `|t_target_source · s - t|`, mm.
    pub residual_mm: f64,
}

/// Residuals of `source` points against the `target` points of the same names.
///
/// # Errors
/// [`Refusal`] if there is no point or one has no counterpart.
pub fn fre(
    target: &[NamedPoint],
    source: &[NamedPoint],
    t_target_source: &Isometry3<f64>,
) -> Result<FreReport, Refusal> {
    let points: Vec<FrePoint> = paired(target, source)?
        .into_iter()
        .map(|(name, t, s)| FrePoint { name, residual_mm: (t_target_source * s - t).norm() })
        .collect();
    let squares: f64 = points.iter().map(|p| p.residual_mm * p.residual_mm).sum();
    Ok(FreReport { rms_mm: (squares / points.len() as f64).sqrt(), n: points.len(), points })
}
