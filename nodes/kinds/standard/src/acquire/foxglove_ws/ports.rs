//! Messages of topics to the payloads of declared ports.

use super::protocol::Channel;
use crate::acquire::{
    network::{Port, PortItems, StreamParams},
    topics::{self, Constants, FrameNames, TransformFilter, last_part},
    unstamped,
};
use osteoflow_formats::{
    PoseError, Spellings,
    message_read::{Encoded, MessageError, read_cloud_head, read_pose_in_frame},
};
use osteoflow_geometry::{Nearest, ROTATION_NOISE};
use osteoflow_node::{DeclaredPort, Emission, ParamError, schemars::JsonSchema, serde::Deserialize};
use std::collections::BTreeSet;

/// Encodings of messages that are read.
const ENCODINGS: [&str; 3] = ["protobuf", "json", "cdr"];

/// The topics that one port of `acquire.foxglove_ws` reads; `type` is the payload it gives.
///
/// `geometry/Cloud` from `foxglove.PointCloud` and `sensor_msgs/PointCloud2`; `geometry/Pose` from
/// `foxglove.FrameTransform(s)`, `tf2_msgs/TFMessage`, `geometry_msgs/TransformStamped` and poses in a frame
/// (`foxglove.PoseInFrame`, `geometry_msgs/PoseStamped`); `geometry/Points`, one point at a time, from poses in a frame; `report/Flag`
/// from `default` alone.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PortParams {
    /// The topic that the port reads.
    pub topic: Option<String>,
    /// Several topics, merged in the order of arrival.
    pub topics: Vec<String>,
    /// The transforms that the port takes.
    #[serde(flatten)]
    pub transforms: TransformFilter,
    /// What a port of every source over a network has.
    #[serde(flatten)]
    pub stream: StreamParams,
}

/// A message on a topic.
pub(super) struct TopicMessage<'a> {
    pub(super) topic: &'a str,
    pub(super) encoded: Encoded<'a>,
    pub(super) frames: &'a mut FrameNames,
}

/// What this protocol knows of a port.
pub(crate) struct Content {
    transforms: TransformFilter,
    constants: Constants,
    spellings: Spellings,
    /// Topics of which a message was looked at for a stamp of its own.
    is_looked_at: BTreeSet<String>,
}

impl Content {
    /// The port that a graph declares.
    ///
    /// # Errors
    /// [`ParamError`] if no topic can fill it.
    pub(super) fn port(declared: &DeclaredPort) -> Result<Port<Self>, ParamError> {
        let params: PortParams = declared.params()?;
        let fault = |key: &str, message: &str| Err(declared.refused(key, message));
        let topics = if let Some(topic) = params.topic { vec![topic] } else { params.topics };
        match declared.payload.name {
            "report/Flag" if params.stream.default.is_none() => {
                return fault("default", "default is not given, and no topic states a flag");
            }
            "report/Flag" if !topics.is_empty() => return fault("topic", "no topic states a flag; remove it"),
            "geometry/Cloud" | "geometry/Pose" | "geometry/Points" if topics.is_empty() => {
                return fault("topic", "neither topic nor topics is given");
            }
            "report/Flag" | "geometry/Cloud" | "geometry/Pose" | "geometry/Points" => {}
            other => {
                let message = format!("topics give geometry/Cloud, Pose, Points and report/Flag, but not {other}");
                return fault("type", &message);
            }
        }
        let content = Self {
            transforms: params.transforms,
            constants: Constants::default(),
            spellings: Spellings::default(),
            is_looked_at: BTreeSet::new(),
        };
        Ok(Port::new(declared, params.stream, topics, content))
    }
}

impl Port<Content> {
    /// Whether the messages of a channel can be read.
    ///
    /// # Errors
    /// What is read instead.
    pub(super) fn check(&self, channel: &Channel) -> Result<(), String> {
        let Channel { topic, encoding, schema_name, .. } = channel;
        let (name, payload) = (&self.name, self.payload);
        if !topics::reads(payload, schema_name) {
            let needed = match payload {
                "geometry/Cloud" => "foxglove.PointCloud or sensor_msgs/msg/PointCloud2",
                "geometry/Pose" => {
                    "foxglove.FrameTransform(s), tf2_msgs/msg/TFMessage, geometry_msgs/msg/TransformStamped or a pose in a frame"
                }
                _ => "foxglove.PoseInFrame or geometry_msgs/msg/PoseStamped",
            };
            return Err(format!("port \"{name}\": {topic} has {schema_name}, but {payload} is read from {needed}"));
        }
        if !ENCODINGS.contains(&encoding.as_str()) {
            let known = ENCODINGS.join(", ");
            return Err(format!("port \"{name}\": {topic} is encoded as \"{encoding}\"; {known} are read"));
        }
        Ok(())
    }

    /// The items of a message.
    pub(super) fn read(&mut self, message: &mut TopicMessage<'_>) -> PortItems {
        let mut out = PortItems::default();
        let read = match self.payload {
            "geometry/Cloud" => self.cloud(message, &mut out),
            "geometry/Pose" => self.poses(message, &mut out),
            _ => self.point(message, &mut out),
        };
        let topic = message.topic;
        if let Err(error) = read {
            let stamp_ns = self.not_before_last(message.encoded.publish_time_ns);
            return PortItems::refused(stamp_ns, format!("{topic}: {error}"));
        }
        if self.content.is_looked_at.insert(topic.to_owned()) && !self.has_stamp(message) {
            out.notes.push("its first message has no stamp; the time at which the server published it is used".into());
        }
        out.notes.iter_mut().for_each(|note| *note = format!("{topic}: {note}"));
        out
    }

    /// Whether a message that could be read has a stamp of its own. Constants need none.
    fn has_stamp(&self, message: &TopicMessage<'_>) -> bool {
        let encoded = unstamped::without_publish_time(message.encoded.clone());
        let stamps: Vec<_> = match self.payload {
            _ if Constants::are_on(message.topic) => return true,
            "geometry/Cloud" => read_cloud_head(encoded).into_iter().map(|head| head.stamp_ns).collect(),
            "geometry/Pose" => {
                let poses = self.content.transforms.poses(message.topic, encoded, &mut Spellings::default());
                let poses = poses.into_iter().flatten();
                poses.filter_map(Result::ok).map(|pose| pose.value.stamp_ns).collect()
            }
            _ => read_pose_in_frame(encoded).into_iter().map(|tip| tip.stamp_ns).collect(),
        };
        !stamps.into_iter().any(unstamped::is_missing)
    }

    fn cloud(&self, message: &mut TopicMessage<'_>, out: &mut PortItems) -> Result<(), MessageError> {
        let label = self.label(message.topic).unwrap_or(last_part(message.topic));
        let (cloud, notes) = topics::cloud(message.encoded.clone(), label, |frame| message.frames.of(frame))?;
        out.notes.extend(notes);
        out.items.push((cloud.stamp_ns, Emission::value(cloud)));
        Ok(())
    }

    fn poses(&mut self, message: &mut TopicMessage<'_>, out: &mut PortItems) -> Result<(), MessageError> {
        let Content { transforms, spellings, .. } = &mut self.content;
        let read = transforms.poses(message.topic, message.encoded.clone(), spellings)?;
        out.notes.extend(spellings.notes.drain(..).chain(spellings.signs.drain(..).map(|(_, sign)| sign)));
        for pose in read {
            match pose {
                Ok(Nearest { value: mut pose, correction }) => {
                    message.frames.rename([&mut pose.to, &mut pose.from]);
                    if Constants::are_on(message.topic) {
                        let constant = self.content.constants.take(pose, |sign| out.notes.push(sign));
                        out.items.extend(constant.map(|pose| (pose.stamp_ns, Emission::value(pose))));
                    } else {
                        let what = format!("t_{}_{}", pose.to, pose.from);
                        if !self.is_repeat(&what, &pose, out) {
                            self.put_pose(&what, pose, correction, ROTATION_NOISE, out);
                        }
                    }
                }
                Err(PoseError::Lost(mut lost)) => {
                    message.frames.rename([&mut lost.to, &mut lost.from]);
                    out.items.push((lost.stamp_ns, Emission::Empty(lost.to_string())));
                }
                Err(error @ PoseError::NotRigid { .. }) => {
                    out.notes.push(error.to_string());
                    // A message has no other time for it than its neighbours'.
                    out.items.push((self.not_before_last(0), Emission::Empty(error.to_string())));
                }
            }
        }
        Ok(())
    }

    fn point(&self, message: &mut TopicMessage<'_>, out: &mut PortItems) -> Result<(), MessageError> {
        let tip = read_pose_in_frame(message.encoded.clone())?;
        let numbered = || format!("{}_{}", last_part(message.topic), self.n_messages + 1);
        let name = self.label(message.topic).map_or_else(numbered, str::to_owned);
        let frame = message.frames.of(&tip.frame).unwrap_or_else(|| tip.frame.clone());
        out.items.push((tip.stamp_ns, Emission::value(topics::point(&tip, name, frame))));
        Ok(())
    }
}
