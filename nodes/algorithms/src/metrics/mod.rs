//! How good a registration is. Each report states its formula, its n and its unit.

mod cuts;
mod fre;
mod pose_error;
mod surface;
mod tre;

pub use cuts::{CutReport, CutsReport, SegmentReport, cuts};
pub use fre::{FrePoint, FreReport, fre};
pub use pose_error::{PoseErrorReport, pose_error};
pub use surface::{SurfaceReport, surface_residual};
pub use tre::{TrePoint, TreReport, TreSummary, tre};

use nalgebra::Point3;
use osteoflow_geometry::NamedPoint;

/// Why a metric has no value.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MetricsError {
    /// Nothing to measure.
    #[error("there is no {what}; nothing can be measured")]
    Empty {
        /// What is missing.
        what: &'static str,
    },
    /// A point has no partner of its name.
    #[error("{name} is not among the {side} points ({found}); name both sets alike")]
    Unpaired {
        /// The name.
        name: String,
        /// Where it is missing.
        side: &'static str,
        /// The names found there.
        found: String,
    },
    /// Planes lie in different frames, or differ from the axes' or the bone's.
    #[error(transparent)]
    Frame(#[from] osteoflow_geometry::FrameError),
    /// A plane is unknown.
    #[error("plane {name} is unknown: {reason}")]
    UnknownPlane {
        /// The plane.
        name: String,
        /// Why.
        reason: String,
    },
    /// A number is NaN or infinite.
    #[error("{what} is not finite; look at where it comes from")]
    NotFinite {
        /// What is not finite.
        what: String,
    },
}

/// Name, target and source position of a point.
type PointPair = (String, Point3<f64>, Point3<f64>);

/// The pair of each target point.
fn paired(target: &[NamedPoint], source: &[NamedPoint]) -> Result<Vec<PointPair>, MetricsError> {
    if target.is_empty() {
        return Err(MetricsError::Empty { what: "point" });
    }
    target
        .iter()
        .map(|t| match source.iter().find(|s| s.name == t.name) {
            Some(s) => Ok((t.name.to_string(), t.position, s.position)),
            None => Err(MetricsError::Unpaired {
                name: t.name.to_string(),
                side: "measured",
                found: source.iter().map(|s| &*s.name).collect::<Vec<_>>().join(", "),
            }),
        })
        .collect()
}

/// The value below which a share of the sorted values lies, linear between neighbours; `None` without values.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let place = share * last as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(last);
    Some(sorted[below] + (sorted[above] - sorted[below]) * (place - below as f64))
}
