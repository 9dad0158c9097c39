use super::paired::unpaired;
use super::{TreReport, tre};
use crate::Refusal;
use nalgebra::Isometry3;
use osteoflow_geometry::{Axes, NamedPoint};
use serde::{Deserialize, Serialize};

/// Errors of located laser spots against the true spots, and against the marks aimed at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LaserSpotReport {
    /// Located minus true spot: the error of camera, calibration, localiser and hole detection.
    pub to_spot: TreReport,
    /// Located minus mark: includes the error of the aim, as does the coarse fit.
    pub to_mark: TreReport,
}

/// Errors of located spots, transformed by `t_axes_located` into the frame of the axes, `spots` and `marks`, paired by
/// name. Spots that were not located are ignored.
///
/// # Errors
/// [`Refusal`] if nothing was located, a located point has no spot or mark, or one is not finite.
///
/// # Source
/// Section 4 of the paper.
pub fn laser_spot(
    located: &[NamedPoint],
    spots: &[NamedPoint],
    marks: &[NamedPoint],
    t_axes_located: &Isometry3<f64>,
    axes: &Axes,
) -> Result<LaserSpotReport, Refusal> {
    let against = |side, truth: &[NamedPoint]| {
        let of = |point: &NamedPoint| {
            let names = truth.iter().map(|t| &*t.name);
            truth.iter().find(|t| t.name == point.name).cloned().ok_or_else(|| unpaired(&point.name, side, names))
        };
        let truth = located.iter().map(of).collect::<Result<Vec<_>, _>>()?;
        tre(&truth, located, t_axes_located, axes)
    };
    Ok(LaserSpotReport { to_spot: against("true", spots)?, to_mark: against("marked", marks)? })
}
