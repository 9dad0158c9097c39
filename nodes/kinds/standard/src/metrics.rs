//! Measures of accuracy and fit, each with its formula, n and unit.

pub mod calibration;
pub mod check_points;
pub mod cut_difference;
pub mod cuts;
pub mod fre;
pub mod laser_spot;
pub mod pose;
pub mod surface;
pub mod tre_measured;
pub mod tre_true;
pub mod verdict;

use osteoflow_algorithms::{axes::principal_axes, metrics::TreReport};
use osteoflow_geometry::{Axes, Mesh};
use osteoflow_node::{Emit, NodeError, Outputs};

/// Outputs of a target registration error.
#[derive(Outputs)]
pub struct TreOut {
    /// Per point and in summary; empty where nothing that counts was measured.
    report: Emit<TreReport>,
}

/// The axes along which errors are resolved: the plan's if it has them, else the principal axes of the bone's surface.
pub(crate) fn axes(planned: Option<Axes>, bone: Option<&Mesh>) -> Result<Axes, NodeError> {
    match (planned, bone) {
        (Some(axes), _) => Ok(axes),
        (None, Some(bone)) => Ok(principal_axes(bone)),
        (None, None) => Err(NodeError::new("the plan gives no axes; wire the bone's surface to \"bone\"")),
    }
}
