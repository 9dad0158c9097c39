//! Options for logs of poses, which `info` and `convert` read.

use crate::app::UsageError;
use anyhow::Result;
use clap::Args;
use osteoflow_formats::{
    pose_log::{LogFormat, LogOptions},
    probe::{Kind, probe},
};
use std::path::{Path, PathBuf};

/// What a log of poses does not say itself.
#[derive(Debug, Default, Args)]
pub(crate) struct LogArgs {
    /// Of a log of poses, the frame that they lead to: its name, where the log has none (TUM, EuRoC, KITTI), or the choice.
    #[arg(long, value_name = "FRAME")]
    pub(crate) parent: Option<String>,

    /// Of a log of poses, the frame that moves: its name, where the log has none, or the choice.
    #[arg(long, value_name = "FRAME")]
    pub(crate) child: Option<String>,

    /// Poses a second of a log without stamps (KITTI), or with numbers of frames.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,

    /// The times.txt of a KITTI trajectory, a stamp in seconds for each pose.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,

    /// What is in the columns of a table of poses, such as NDI's or Atracsys': a TOML file with the keys of `columns` of acquire.poses.
    #[arg(long, value_name = "FILE")]
    pub(crate) columns: Option<PathBuf>,
}

impl LogArgs {
    /// The options for a log of a format, or of a table, if columns are given.
    pub(crate) fn options(&self, format: LogFormat, scale: f64) -> Result<LogOptions> {
        let columns = self.columns.as_ref().map(|path| {
            let text = osteoflow_formats::input::read_text(path)?;
            toml::from_str(&text).map_err(|error| UsageError(format!("{}: {error}", path.display())).into())
        });
        let columns: Option<_> = columns.transpose().map_err(|error: anyhow::Error| error)?;
        let format = if columns.is_some() { LogFormat::Table } else { format };
        // A table of motion capture states its unit.
        let is_stated = format == LogFormat::MotionCapture && scale == 1.0;
        Ok(LogOptions {
            format: Some(format),
            unit_mm: (!is_stated).then(|| format.unit_mm() * scale),
            parent: self.parent.clone(),
            child: self.child.clone(),
            rate_hz: self.rate,
            times: self.times.clone(),
            columns,
        })
    }

    /// What a file is. If it is said to be a log of poses, and is not recognised as one, it is a table.
    pub(crate) fn kind(&self, file: &Path) -> Result<Kind> {
        match probe(file) {
            Ok(found) if !self.says_poses() || matches!(found.kind, Kind::Recording | Kind::Poses(_)) => Ok(found.kind),
            Err(error) if !self.says_poses() => Err(error.into()),
            _ => Ok(Kind::Poses(LogFormat::Table)),
        }
    }

    fn says_poses(&self) -> bool {
        self.columns.is_some()
            || self.parent.is_some()
            || self.child.is_some()
            || self.rate.is_some()
            || self.times.is_some()
    }

    /// Whether the poses between two frames are wanted.
    pub(crate) fn wants(&self, parent: &str, child: &str) -> bool {
        self.parent.as_deref().is_none_or(|name| name == parent)
            && self.child.as_deref().is_none_or(|name| name == child)
    }
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: f64 = text.parse().map_err(|_| "a number is expected, such as 10")?;
    (1e-3..=1e6).contains(&rate).then_some(rate).ok_or_else(|| "it must be between 0.001 and 1e6 Hz".into())
}
