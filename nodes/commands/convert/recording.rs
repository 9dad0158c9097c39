//! A cloud of a recording as a file.

use super::{Convert, in_space};
use crate::app::UsageError;
use anyhow::{Result, anyhow};
use osteoflow_formats::{
    Space,
    mcap_read::Recording,
    message_read::{MessageKind, read_cloud},
    write::write_cloud,
};
use osteoflow_geometry::nalgebra::{Isometry3, Translation3};

impl Convert {
    /// One cloud of a recording.
    pub(super) fn recorded(&self) -> Result<(String, Vec<String>)> {
        let recording = Recording::open(&self.input, false)?;
        let name = self.input.display();
        let usage = |message: String| UsageError(format!("{name}: {message}"));
        if self.scale != 1.0 {
            return Err(usage("a recording is in metres by its messages; leave out --scale".into()).into());
        }
        let is_cloud = |schema: &str| MessageKind::of(schema) == Some(MessageKind::Cloud);
        let clouds = recording.topics().iter().filter(|topic| topic.n_messages > 0 && is_cloud(&topic.schema_name));
        let there: Vec<&str> = clouds.map(|topic| topic.name.as_str()).collect();
        let topic = match (&self.topic, &there[..]) {
            (Some(topic), _) if there.contains(&topic.as_str()) => topic.as_str(),
            (None, [topic]) => topic,
            (_, []) => {
                return Err(usage("the recording has no clouds, and those of a recording are converted".into()).into());
            }
            (Some(topic), _) => {
                return Err(usage(format!("no clouds on {topic}; there are {}", there.join(", "))).into());
            }
            (None, _) => return Err(usage(format!("clouds on {}; choose one by --topic", there.join(", "))).into()),
        };
        let messages = recording.messages(topic);
        let number = self.message.unwrap_or(1);
        let message = number.checked_sub(1).and_then(|k| messages.get(k)).ok_or_else(|| {
            usage(format!("--message {number} of {topic}, which has {} messages, counted from 1", messages.len()))
        })?;
        let read = read_cloud(message).map_err(|error| anyhow!("{name}: {topic}, message {number}: {error}"))?;
        let mut notes = recording.notes.clone();
        notes.extend(read.notes);
        if self.message.is_none() && messages.len() > 1 {
            notes.push(format!("the first of {} clouds on {topic}; --message chooses another", messages.len()));
        }
        if read.n_dropped > 0 {
            notes.push(format!(
                "{} of {} points are not finite and were left out",
                read.n_dropped, read.n_points_in_message
            ));
        }
        let (turn, space) = self.to_lps(Space::Unknown)?;
        let turned =
            read.cloud.transformed(read.cloud.frame.clone(), &Isometry3::from_parts(Translation3::identity(), turn));
        let told = write_cloud(&self.output, &turned, space, self.precision())?;
        notes.extend(self.told(told));
        Ok((format!("{} points in frame {}{}", turned.len(), turned.frame, in_space(space)), notes))
    }
}
