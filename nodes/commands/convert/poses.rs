//! A log of poses as a recording, a table or a trajectory.

use super::Convert;
use anyhow::{Context, Result};
use osteoflow_formats::{
    LostPose, durable,
    pose_log::{LogFormat, read_log, write_tum},
    poses_csv::write_rows,
    recording_write::log_bytes,
    write::ending,
};
use osteoflow_geometry::{Corrections, Pose};
use std::collections::BTreeMap;

/// The topic of the poses in a recording: each message names its frames.
const TOPIC: &str = "/tf";

impl Convert {
    /// The poses of a log.
    pub(super) fn poses(&self, format: LogFormat) -> Result<(String, Vec<String>)> {
        let options = self.log.options(format, self.scale)?;
        let ending = ending(&self.output);
        if !["mcap", "csv", "tum"].contains(&ending.as_str()) {
            usage!("{} is {format}, which is written as .mcap, .csv or .tum; name OUT so", self.input.display());
        }
        let log = read_log(&self.input, &options)?;
        let (mut corrections, mut notes) = (Corrections::default(), log.notes);
        let poses = log.poses.into_iter().map(|pose| pose.map(|pose| corrections.take(pose)));
        let frames = |pose: &Result<Pose, LostPose>| match pose {
            Ok(pose) => (pose.to.to_string(), pose.from.to_string()),
            Err(lost) => (lost.to.to_string(), lost.from.to_string()),
        };
        let wants = |(to, from): &(String, String)| self.log.wants(to, from);
        let all: Vec<Result<Pose, LostPose>> = poses.collect();
        let poses: Vec<_> = all.iter().filter(|pose| wants(&frames(pose))).cloned().collect();
        if poses.is_empty() {
            let mut pairs: Vec<String> = all.iter().map(frames).map(|(to, from)| format!("{to} -> {from}")).collect();
            pairs.sort();
            pairs.dedup();
            let message = format!("no poses between --parent and --child; there are {}", pairs.join(", "));
            usage!("{}: {message}", self.input.display());
        }
        notes.extend(corrections.note().into_iter().chain(log.signs.into_iter().map(|(_, sign)| sign)));
        let n_lost = poses.iter().filter(|pose| pose.is_err()).count();
        match ending.as_str() {
            "mcap" => {
                let name = self.input.file_name().unwrap_or_default().to_string_lossy();
                let about = [("file", name.as_ref()), ("format", &log.format.to_string())];
                let about = about.map(|(key, value)| (key.to_owned(), value.to_owned()));
                let metadata = BTreeMap::from([("pose_log".to_owned(), about.into())]);
                let written = durable::write(&self.output, log_bytes(TOPIC, &poses, &metadata)?);
                written.with_context(|| format!("{} cannot be written", self.output.display()))?;
            }
            "csv" => write_rows(&self.output, poses.iter().map(Result::as_ref))?,
            _ => {
                let n_left_out = write_tum(&self.output, &poses)?;
                if n_left_out > 0 {
                    notes.push(format!("{n_left_out} samples in which the tool was not seen were left out"));
                }
            }
        }
        Ok((format!("{} poses, {n_lost} of them lost", poses.len()), notes))
    }
}
