//! The start of a registration: a given pose, picked points, or the shape alone.

use super::inputs::ms_since;
use osteoflow_algorithms::{
    coarse::{CoarseReport, GlobalParams, GlobalReport, global, three_point},
    target::Target,
};
use osteoflow_geometry::{Cloud, NamedPoint, nalgebra::Isometry3};
use serde_json::{Value, json};
use std::time::Instant;

/// How to find the start.
pub(super) enum Start {
    /// It is given.
    Pose(Isometry3<f64>),
    /// From points picked in both files, paired by name.
    Landmarks {
        /// In the target.
        target: Vec<NamedPoint>,
        /// In the source.
        source: Vec<NamedPoint>,
    },
    /// From the shape alone.
    Shape,
}

/// A start.
#[derive(Debug, Clone)]
pub(super) struct Started {
    /// The motion that takes the source to the target.
    pub(super) init: Isometry3<f64>,
    pub(super) by: StartedBy,
    /// Time to find it, ms.
    pub(super) ms: f64,
}

/// Where a start comes from.
#[derive(Debug, Clone)]
pub(super) enum StartedBy {
    Pose,
    Landmarks(CoarseReport),
    Shape(GlobalReport),
}

impl Start {
    /// Finds the start.
    ///
    /// # Errors
    /// The reason why there is none, with the other ways to start.
    pub(super) fn find(&self, target: &Target, source: &Cloud) -> Result<Started, String> {
        let began = Instant::now();
        let (init, by) = match self {
            Self::Pose(init) => (*init, StartedBy::Pose),
            Self::Landmarks { target, source } => {
                let other =
                    "register by shape alone (neither --landmarks nor --init), or start from a pose with --init";
                let fit = three_point(target, source).map_err(|error| format!("--landmarks: {error}; or {other}"))?;
                (fit.t_target_source, StartedBy::Landmarks(fit.report))
            }
            Self::Shape => {
                let fit = global(target, source, &GlobalParams::default())
                    .map_err(|error| format!("the shape alone gives no start: {error}; or start from {OTHER_WAYS}"))?;
                (fit.t_target_source, StartedBy::Shape(fit.report))
            }
        };
        Ok(Started { init, by, ms: ms_since(began) })
    }

    /// The located and the planned points, if it starts from such.
    pub(super) fn landmarks(&self) -> (&[NamedPoint], &[NamedPoint]) {
        match self {
            Self::Landmarks { target, source } => (target, source),
            Self::Pose(_) | Self::Shape => (&[], &[]),
        }
    }
}

/// The ways to start other than by shape alone.
pub(super) const OTHER_WAYS: &str =
    "points picked in both files (--landmarks TARGET_POINTS SOURCE_POINTS) or from a pose (--init FILE)";

impl Started {
    /// The registration by shape alone, if it started from one.
    pub(super) fn shape(&self) -> Option<&GlobalReport> {
        match &self.by {
            StartedBy::Shape(report) => Some(report),
            StartedBy::Pose | StartedBy::Landmarks(_) => None,
        }
    }

    /// One line for the text.
    pub(super) fn describe(&self) -> Option<String> {
        match &self.by {
            StartedBy::Pose => None,
            StartedBy::Landmarks(report) => {
                Some(format!("{} landmarks, {:.2} mm RMS apart after their fit", report.pairs.len(), report.fre_mm))
            }
            StartedBy::Shape(report) => Some(match &report.runner_up {
                Some(other) => format!(
                    "by shape alone: the next best place, {:.0} mm and {:.0} degrees away, fits {:.0} % worse (clearness {:.2})",
                    other.shift_mm,
                    other.turn_rad.to_degrees(),
                    100.0 * (other.score_mm / report.score_mm.max(f64::MIN_POSITIVE) - 1.0),
                    report.clearness
                ),
                None => "by shape alone: the scan fits in one place only".into(),
            }),
        }
    }

    pub(super) fn to_json(&self) -> Value {
        match &self.by {
            StartedBy::Pose => json!({ "by": "pose" }),
            StartedBy::Landmarks(report) => json!({ "by": "landmarks", "ms": self.ms, "report": report }),
            StartedBy::Shape(report) => json!({ "by": "shape", "ms": self.ms, "report": report }),
        }
    }
}
