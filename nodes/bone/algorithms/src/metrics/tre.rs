use super::paired::{not_finite, paired};
use super::quantile::quantile;
use crate::Refusal;
use nalgebra::{Isometry3, Vector3};
use osteoflow_geometry::{Axes, NamedPoint};
use serde::{Deserialize, Serialize};

/// Target registration error: the error at points not used to fit, along the bone's axes.
///
/// `e = Aᵀ (t_target_source · s - t)`: the registered position of a point minus its position, in the axes A (z along
/// the bone). A positive z means that the registration puts the point too far towards +z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TreReport {
    /// The error at each point, in the target's order.
    pub points: Vec<TrePoint>,
    /// Mean of the signed errors, mm; its norm is that of the mean vector.
    pub mean_signed: TreSummary,
    /// Mean of the absolute errors, mm.
    pub mean_abs: TreSummary,
    /// Root of the mean squared errors, mm.
    pub rms: TreSummary,
    /// 95th percentile of the absolute errors, linear between neighbours, mm; for five points close to the largest.
    pub p95: TreSummary,
    /// Largest absolute error, mm.
    pub max: TreSummary,
    /// Number of points.
    pub n: usize,
}

/// The error at one point, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrePoint {
    /// Its name.
    pub name: String,
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z, the bone.
    pub z: f64,
    /// `√(x² + y² + z²)`.
    pub norm: f64,
    /// `|z|`.
    pub axial: f64,
    /// `√(x² + y²)`.
    pub transverse: f64,
}

/// One statistic of the errors, mm, along each axis, of the norm, and of the axial and transverse parts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TreSummary {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z, the bone.
    pub z: f64,
    /// Of the norm.
    pub norm: f64,
    /// Of the axial part.
    pub axial: f64,
    /// Of the transverse part.
    pub transverse: f64,
}

/// Target registration error of `t_target_source`: `target` points are as planned (CT), `source` points as measured or
/// true, paired by name; `axes` are in the target's frame.
///
/// # Errors
/// [`Refusal`] if there is no point, one has no counterpart, or one is not finite.
///
/// # Source
/// Section 3.2.1 of the paper; Fitzpatrick, West and Maurer 1998 for the term.
pub fn tre(
    target: &[NamedPoint],
    source: &[NamedPoint],
    t_target_source: &Isometry3<f64>,
    axes: &Axes,
) -> Result<TreReport, Refusal> {
    let mut points = Vec::with_capacity(target.len());
    for (name, t, s) in paired(target, source)? {
        let e = axes.components(&(t_target_source * s - t));
        if !e.iter().all(|c| c.is_finite()) {
            return Err(not_finite(&format!("the error at {name}")));
        }
        let [x, y, z, norm, axial, transverse] = parts(&e);
        points.push(TrePoint { name, x, y, z, norm, axial, transverse });
    }
    let n = points.len() as f64;
    let mean = |of: &dyn Fn(&TrePoint) -> f64| points.iter().map(of).sum::<f64>() / n;
    let signed = Vector3::new(mean(&|p| p.x), mean(&|p| p.y), mean(&|p| p.z));
    Ok(TreReport {
        mean_signed: TreSummary::of(parts(&signed)),
        mean_abs: summary(&points, |sorted| sorted.iter().sum::<f64>() / n),
        rms: summary(&points, |sorted| (sorted.iter().map(|e| e * e).sum::<f64>() / n).sqrt()),
        p95: summary(&points, |sorted| quantile(sorted, 0.95).unwrap_or(0.0)),
        max: summary(&points, |sorted| sorted.last().copied().unwrap_or(0.0)),
        n: points.len(),
        points,
    })
}

/// An error along each axis, its norm, and its axial and transverse parts.
fn parts(e: &Vector3<f64>) -> [f64; 6] {
    [e.x, e.y, e.z, e.norm(), e.z.abs(), e.x.hypot(e.y)]
}

impl TreSummary {
    fn of([x, y, z, norm, axial, transverse]: [f64; 6]) -> Self {
        Self { x, y, z, norm, axial, transverse }
    }
}

/// One statistic of the sorted absolute errors.
fn summary(points: &[TrePoint], statistic: impl Fn(&[f64]) -> f64) -> TreSummary {
    let of = |part: fn(&TrePoint) -> f64| {
        let mut values: Vec<f64> = points.iter().map(|p| part(p).abs()).collect();
        values.sort_by(f64::total_cmp);
        statistic(&values)
    };
    TreSummary::of([of(|p| p.x), of(|p| p.y), of(|p| p.z), of(|p| p.norm), of(|p| p.axial), of(|p| p.transverse)])
}
