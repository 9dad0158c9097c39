//! What a log of poses holds.

use super::{super::common::LogArgs, contents::Contents};
use anyhow::Result;
use osteoflow_formats::pose_log::{LogFormat, read_log};
use osteoflow_geometry::{Corrections, nalgebra::Vector3};
use serde_json::{Value, json};
use std::{collections::BTreeMap, path::Path};

/// The poses of one tool.
#[derive(Default)]
struct Stream {
    n_poses: usize,
    lost: BTreeMap<String, usize>,
    stamps: Vec<i64>,
    /// The corners of the box around the origin of the tool.
    ends: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// The contents of a log; where it names no frames, or has no stamps, they are not needed here.
pub(super) fn poses(file: &Path, format: LogFormat, log: &LogArgs) -> Result<Contents> {
    let mut options = log.options(format, 1.0)?;
    let names_frames = format.names_frames();
    let has_stamps = format != LogFormat::Kitti || options.rate_hz.is_some() || options.times.is_some();
    if !names_frames {
        options.parent.get_or_insert_with(|| "PARENT".into());
        options.child.get_or_insert_with(|| "CHILD".into());
    }
    if !has_stamps {
        options.rate_hz = Some(1.0);
    }
    let read = read_log(file, &options)?;
    let (mut streams, mut corrections) = (BTreeMap::<(String, String), Stream>::new(), Corrections::default());
    for pose in read.poses {
        let key = match &pose {
            Ok(pose) => (pose.value.to.to_string(), pose.value.from.to_string()),
            Err(lost) => (lost.to.to_string(), lost.from.to_string()),
        };
        let stream = streams.entry(key).or_default();
        match pose {
            Ok(pose) => {
                let pose = corrections.take(pose);
                let at = pose.isometry.translation.vector;
                stream.n_poses += 1;
                stream.stamps.push(pose.stamp_ns);
                stream.ends = Some(stream.ends.map_or((at, at), |(low, high)| (low.inf(&at), high.sup(&at))));
            }
            Err(lost) => {
                stream.stamps.push(lost.stamp_ns);
                *stream.lost.entry(lost.reason).or_default() += 1;
            }
        }
    }
    let n_poses: usize = streams.values().map(|stream| stream.n_poses).sum();
    let frames = if names_frames { Vec::new() } else { vec!["it names no frames; --parent and --child do".to_owned()] };
    let mut notes: Vec<String> = read.notes.into_iter().chain(frames).chain(corrections.note()).collect();
    notes.extend(read.signs.into_iter().map(|(_, sign)| sign));
    if !has_stamps {
        notes.push("it has no stamps; --rate or --times give them".into());
    }
    let mut contents = Contents::new("poses", format!("{} with {n_poses} poses", read.format));
    let mut transforms: Vec<Value> = Vec::new();
    for ((parent, child), stream) in &streams {
        transforms.push(stream.to_json(parent, child, has_stamps));
        contents.lines.push(("transform", stream.describe(parent, child, has_stamps)));
    }
    contents.facts.insert("transforms".into(), json!(transforms));
    let name = file.display();
    let (parent, child) = if names_frames { ("", "") } else { (" --parent PARENT", " --child CHILD") };
    let rate = if has_stamps { "" } else { " --rate HZ" };
    let table = log.columns.as_ref().map_or_else(String::new, |path| format!(" --columns {}", path.display()));
    contents.used_by = vec![format!("osteoflow convert {name} poses.mcap{parent}{child}{rate}{table}")];
    Ok(contents.noted(notes))
}

impl Stream {
    fn n_lost(&self) -> usize {
        self.lost.values().sum()
    }

    fn ends_ns(&self) -> Option<(i64, i64)> {
        Some((*self.stamps.iter().min()?, *self.stamps.iter().max()?))
    }

    /// Samples a second, from the first to the last.
    fn rate_hz(&self) -> Option<f64> {
        let (first, last) = self.ends_ns()?;
        (last > first).then(|| (self.stamps.len() - 1) as f64 / ((last - first) as f64 * 1e-9))
    }

    fn to_json(&self, parent: &str, child: &str, has_stamps: bool) -> Value {
        let (first, last) = self.ends_ns().filter(|_| has_stamps).unzip();
        let extent = self.ends.map(|(low, high)| <[f64; 3]>::from(high - low));
        json!({
            "parent": parent, "child": child, "n_poses": self.n_poses, "n_lost": self.n_lost(), "lost": self.lost,
            "rate_hz": self.rate_hz().filter(|_| has_stamps), "first_ns": first, "last_ns": last, "extent_mm": extent,
        })
    }

    fn describe(&self, parent: &str, child: &str, has_stamps: bool) -> String {
        let mut text = format!("{parent} -> {child}: {} poses", self.n_poses);
        let lost: Vec<String> = self.lost.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
        if !lost.is_empty() {
            text += &format!(", {} lost ({})", self.n_lost(), lost.join(", "));
        }
        if let Some(hz) = self.rate_hz().filter(|_| has_stamps) {
            let (first, last) = self.ends_ns().unwrap_or_default();
            text += &format!(", {hz:.2} a second over {:.2} s from {first} ns on", (last - first) as f64 * 1e-9);
        }
        if let Some((low, high)) = self.ends {
            let size = high - low;
            text += &format!(", within {:.1} x {:.1} x {:.1} mm", size.x, size.y, size.z);
        }
        text
    }
}
