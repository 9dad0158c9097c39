use super::{MetricsError, TreReport, tre};
use nalgebra::Isometry3;
use osteoflow_geometry::{Axes, NamedPoint};
use serde::{Deserialize, Serialize};

/// How far the laser's spots were located from where they are, and from the marks that they were to show.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LaserSpotReport {
    /// Located minus true spot: what camera, calibration, localiser and the search for the hole do.
    pub to_spot: TreReport,
    /// Located minus mark: the same with the aim in it, which is what the coarse fit gets.
    pub to_mark: TreReport,
}

/// The error of located spots, which `t_axes_located` brings into the axes' frame; `spots` and `marks` lie there, paired by
/// name. Only what was located counts.
///
/// # Errors
/// [`MetricsError`] if nothing was located, a located point has no spot or mark, or one is not finite.
///
/// # Source
/// Section 4 of the paper.
pub fn laser_spot(
    located: &[NamedPoint],
    spots: &[NamedPoint],
    marks: &[NamedPoint],
    t_axes_located: &Isometry3<f64>,
    axes: &Axes,
) -> Result<LaserSpotReport, MetricsError> {
    let against = |side, truth: &[NamedPoint]| {
        let of = |point: &NamedPoint| {
            let found = || truth.iter().map(|t| &*t.name).collect::<Vec<_>>().join(", ");
            let unpaired = || MetricsError::Unpaired { name: point.name.to_string(), side, found: found() };
            truth.iter().find(|t| t.name == point.name).cloned().ok_or_else(unpaired)
        };
        let truth = located.iter().map(of).collect::<Result<Vec<_>, _>>()?;
        tre(&truth, located, t_axes_located, axes)
    };
    Ok(LaserSpotReport { to_spot: against("true", spots)?, to_mark: against("marked", marks)? })
}
