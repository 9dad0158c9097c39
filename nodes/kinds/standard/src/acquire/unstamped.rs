//! Messages without a stamp of their own.

use osteoflow_formats::mcap_read::Message;
use osteoflow_formats::message_read::Encoded;
use osteoflow_geometry::{Pose, StampNs, nalgebra::Isometry3};
use osteoflow_node::{schemars::JsonSchema, serde::Deserialize};
use std::collections::BTreeMap;

/// The stamp of a message that has none, while it is read.
const NONE: StampNs = StampNs::MIN;

/// From which range on a pose moves: farther than a marker at rest is thrown by its noise.
const MOVES_MM: f64 = 1.0;
const MOVES_RAD: f64 = 0.01;

/// The stamp of messages that have none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Unstamped {
    /// An error, if the recording's poses move: when it was published is not when it was measured.
    #[default]
    Refuse,
    /// The time at which the message was published.
    PublishTime,
}

/// The message as it is read here, so that a missing stamp is [`NONE`].
pub(super) fn without_publish_time<'a>(message: impl Into<Encoded<'a>>) -> Encoded<'a> {
    Encoded { publish_time_ns: NONE, ..message.into() }
}

/// What the ports of a source met.
#[derive(Clone, Default)]
pub(super) struct MissingStamps {
    topics: BTreeMap<String, Topic>,
    /// The first pose of each marker, and how far the others are from it, by its topic.
    moved: BTreeMap<(String, String), (Isometry3<f64>, f64, f64)>,
}

/// The messages of a topic.
#[derive(Clone, Default)]
struct Topic {
    n: usize,
    n_missing: usize,
    is_allowed: bool,
    is_told: bool,
    port: String,
}

impl MissingStamps {
    /// The stamp of a message of `topic`, as read from [`without_publish_time`].
    pub(super) fn stamp(
        &mut self,
        (port, topic): (&str, &str),
        message: &Message,
        read_ns: StampNs,
        unstamped: Unstamped,
    ) -> StampNs {
        let of = self.topics.entry(topic.into()).or_default();
        of.n += 1;
        if read_ns != NONE {
            return read_ns;
        }
        of.n_missing += 1;
        of.port = port.into();
        of.is_allowed = unstamped == Unstamped::PublishTime;
        message.publish_time_ns
    }

    /// Takes a tracked pose of `topic`.
    pub(super) fn track(&mut self, topic: &str, pose: &Pose) {
        let what = (topic.to_owned(), format!("t_{}_{}", pose.to, pose.from));
        let (first, mm, rad) = self.moved.entry(what).or_insert((pose.isometry, 0.0, 0.0));
        let between = first.inverse() * pose.isometry;
        (*mm, *rad) = (mm.max(between.translation.vector.norm()), rad.max(between.rotation.angle()));
    }

    /// Notes on messages without a stamp, once for each topic.
    ///
    /// # Errors
    /// They are joined with poses that move: the sentence that says so.
    pub(super) fn notes(&mut self) -> Result<Vec<String>, String> {
        let is_moving = |(_, (_, mm, rad)): &(_, &(_, f64, f64))| *mm > MOVES_MM || *rad > MOVES_RAD;
        let moves = self.moved.iter().find(is_moving);
        // A pose that stays where it is holds at any time.
        let is_constant = |topic: &String| {
            let mut poses = self.moved.iter().filter(|((of, _), _)| of == topic).peekable();
            poses.peek().is_some() && !poses.any(|pose| is_moving(&pose))
        };
        // Something else has to be there to be joined with.
        let moves = moves.filter(|_| self.topics.len() > 1);
        let mut notes = Vec::new();
        for (topic, of) in self.topics.iter_mut().filter(|(_, of)| of.n_missing > 0) {
            let Topic { n, n_missing, is_allowed, is_told, port } = of;
            let what = format!("topic {topic}: {n_missing} of {n} messages have no stamp");
            match moves {
                Some(((moving, pose), (_, mm, rad))) if !*is_allowed && !is_constant(topic) => {
                    return Err(format!(
                        "port \"{port}\": {what}, and {pose} of {moving} moves by {mm:.1} mm and {:.1} degrees: paired by the time at which \
                         they were published they may be off by as much; record them with the sensor's stamps, or, if that time is \
                         the sensor's, set out.{port}.unstamped = \"publish_time\"",
                        rad.to_degrees()
                    ));
                }
                _ if !std::mem::replace(is_told, true) => {
                    notes.push(format!("{what}; the time at which they were published is used"));
                }
                _ => {}
            }
        }
        Ok(notes)
    }
}
