//! Messages of topics to the payloads of declared ports.

use super::{super::frozen::Frozen, protocol::Channel};
use osteoflow_formats::{
    PoseError,
    message_read::{
        Encoded, MessageError, MessageKind, is_sensor_frame, read_cloud, read_pose_in_frame, read_transforms,
    },
};
use osteoflow_geometry::{Corrections, Frame, NamedPoint, Nearest, Points, Pose, StampNs};
use osteoflow_node::{DeclaredPort, Emission, NodeError, schemars::JsonSchema, serde::Deserialize};
use std::collections::BTreeMap;

/// Encodings of messages that are read.
const ENCODINGS: [&str; 3] = ["protobuf", "json", "cdr"];

/// The topics that one port of `acquire.foxglove_ws` reads; `type` is the payload it gives.
///
/// `geometry/Cloud` from `foxglove.PointCloud` and `sensor_msgs/PointCloud2`; `geometry/Pose` from
/// `foxglove.FrameTransform(s)`, `tf2_msgs/TFMessage`, `geometry_msgs/TransformStamped` and poses in a frame
/// (`foxglove.PoseInFrame`, `geometry_msgs/PoseStamped`); `geometry/Points`, one point at a time, from poses in a frame; `report/Flag`
/// from `default` alone.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct PortParams {
    /// The topic that the port reads.
    pub topic: Option<String>,
    /// Several topics, merged in the order of arrival.
    pub topics: Vec<String>,
    /// Names: one for each of `topics`, or, with one topic, one for each message in order. Default: the last part of the topic's name.
    pub labels: Vec<String>,
    /// Only transforms with this parent frame, where a topic carries several.
    pub parent: Option<String>,
    /// Only transforms with this child frame; for a pose in a frame, the name of the frame that moves.
    pub child: Option<String>,
    /// Time of the sender without the tool, while other messages come, after which a pose is lost and the port gives an empty.
    /// Unset: never.
    #[schemars(range(min = 1.0, max = 3_600_000.0))]
    pub lost_after_ms: Option<f64>,
    /// Time for which poses may be the same to the last bit while their stamps go on; from then on the tracker is frozen, and the
    /// port gives empties with the reason until the pose changes. Unset: 2000, forty samples of a slow tracker, as a marker at rest
    /// jitters by noise. 0: never, for a constant that is sent again and again.
    #[schemars(range(min = 0.0, max = 3_600_000.0))]
    pub frozen_after_ms: Option<f64>,
    /// What a `report/Flag` gives with the first item of another port: the protocol has no such message.
    pub default: Option<bool>,
}

/// A declared port.
pub(super) struct Port {
    pub(super) name: String,
    pub(super) payload: &'static str,
    pub(super) topics: Vec<String>,
    pub(super) lost_after_ns: Option<StampNs>,
    pub(super) default: Option<bool>,
    /// The newest stamp.
    pub(super) last_ns: Option<StampNs>,
    labels: Vec<String>,
    parent: Option<String>,
    child: Option<String>,
    /// Constants of `tf_static`.
    held: Vec<Pose>,
    frozen: Frozen,
    /// Corrections of rotations.
    pub(super) corrections: Corrections,
    /// Items so far.
    n: usize,
}

/// The items of a message, and what the user should know of it.
#[derive(Default)]
pub(super) struct Given {
    pub(super) items: Vec<(StampNs, Emission)>,
    pub(super) notes: Vec<String>,
}

impl Port {
    pub(super) fn new(declared: &DeclaredPort) -> Result<Self, NodeError> {
        let params: PortParams = declared.params()?;
        let (name, payload) = (declared.name.clone(), declared.payload.name);
        let fault = |message: String| Err(NodeError::new(format!("port \"{name}\": {message}")));
        let topics = if let Some(topic) = params.topic { vec![topic] } else { params.topics };
        match payload {
            "report/Flag" if params.default.is_none() => {
                return fault("default is not given, and no topic states a flag".into());
            }
            "report/Flag" => {}
            "geometry/Cloud" | "geometry/Pose" | "geometry/Points" if topics.is_empty() => {
                return fault("neither topic nor topics is given".into());
            }
            "geometry/Cloud" | "geometry/Pose" | "geometry/Points" => {}
            other => {
                return fault(format!("topics give geometry/Cloud, Pose, Points and report/Flag, but not {other}"));
            }
        }
        Ok(Self {
            payload,
            topics,
            lost_after_ns: params.lost_after_ms.map(|ms| (ms * 1e6) as StampNs),
            default: params.default,
            last_ns: None,
            labels: params.labels,
            parent: params.parent,
            child: params.child,
            held: Vec::new(),
            frozen: Frozen::new(params.frozen_after_ms),
            corrections: Corrections::default(),
            n: 0,
            name,
        })
    }

    /// Whether the messages of a channel can be read.
    ///
    /// # Errors
    /// What is read instead.
    pub(super) fn check(&self, channel: &Channel) -> Result<(), String> {
        let Channel { topic, encoding, schema_name, .. } = channel;
        let kind = MessageKind::of(schema_name);
        let (is_read, needed) = match self.payload {
            "geometry/Cloud" => {
                (kind == Some(MessageKind::Cloud), "foxglove.PointCloud or sensor_msgs/msg/PointCloud2")
            }
            "geometry/Pose" => (
                kind.is_some_and(|kind| kind != MessageKind::Cloud),
                "foxglove.FrameTransform(s), tf2_msgs/msg/TFMessage, geometry_msgs/msg/TransformStamped or a pose in a frame",
            ),
            _ => (kind == Some(MessageKind::Pose), "foxglove.PoseInFrame or geometry_msgs/msg/PoseStamped"),
        };
        let (name, payload) = (&self.name, self.payload);
        if !is_read {
            return Err(format!("port \"{name}\": {topic} has {schema_name}, but {payload} is read from {needed}"));
        }
        if !ENCODINGS.contains(&encoding.as_str()) {
            let known = ENCODINGS.join(", ");
            return Err(format!("port \"{name}\": {topic} is encoded as \"{encoding}\"; {known} are read"));
        }
        Ok(())
    }

    /// The items of a message.
    ///
    /// # Errors
    /// Its bytes do not follow its schema.
    pub(super) fn give(
        &mut self,
        topic: &str,
        message: Encoded<'_>,
        frames: &BTreeMap<String, String>,
    ) -> Result<Given, MessageError> {
        let mut given = match self.payload {
            "geometry/Cloud" => self.cloud(topic, message, frames)?,
            "geometry/Pose" => self.poses(topic, message, frames)?,
            _ => self.point(topic, message, frames)?,
        };
        given.items.iter().for_each(|(stamp_ns, _)| self.last_ns = self.last_ns.max(Some(*stamp_ns)));
        self.n += given.items.len();
        given.notes.iter_mut().for_each(|note| *note = format!("{topic}: {note}"));
        Ok(given)
    }

    fn label(&self, topic: &str) -> Option<String> {
        let index = if let [_] = self.topics[..] { Some(self.n) } else { self.topics.iter().position(|t| t == topic) };
        self.labels.get(index?).cloned()
    }

    fn cloud(
        &mut self,
        topic: &str,
        message: Encoded<'_>,
        frames: &BTreeMap<String, String>,
    ) -> Result<Given, MessageError> {
        let read = read_cloud(message)?;
        self.corrections.add(read.correction);
        let mut notes = read.notes;
        if read.n_dropped > 0 {
            let (dropped, all) = (read.n_dropped, read.n_points_in_message);
            notes.push(format!("{dropped} of {all} points are NaN or infinite and were left out"));
        }
        let mut cloud = read.cloud.labelled(self.label(topic).unwrap_or_else(|| last_part(topic).into()));
        if let Some(frame) = frames.get(cloud.frame.as_str()) {
            cloud.frame = frame.as_str().into();
            cloud.viewpoint = cloud.viewpoint.filter(|_| is_sensor_frame(frame));
        }
        Ok(Given { items: vec![(cloud.stamp_ns, Emission::value(cloud))], notes })
    }

    fn poses(
        &mut self,
        topic: &str,
        message: Encoded<'_>,
        frames: &BTreeMap<String, String>,
    ) -> Result<Given, MessageError> {
        let mut given = Given::default();
        for read in self.poses_of(topic, message)? {
            match read {
                Ok(pose) => {
                    let mut pose = self.corrections.take(pose);
                    rename(frames, [&mut pose.to, &mut pose.from]);
                    if last_part(topic) == "tf_static" {
                        given.items.extend(self.constant(pose, &mut given.notes));
                        continue;
                    }
                    let stamp_ns = pose.stamp_ns;
                    let what = format!("t_{}_{}", pose.to, pose.from);
                    let emission = match self.frozen.take(&what, &pose.isometry, stamp_ns) {
                        Some(frozen) => {
                            given.notes.extend(frozen.is_first.then(|| frozen.reason.clone()));
                            Emission::Empty(frozen.reason)
                        }
                        None => Emission::value(pose),
                    };
                    given.items.push((stamp_ns, emission));
                }
                Err(PoseError::Lost(mut lost)) => {
                    rename(frames, [&mut lost.to, &mut lost.from]);
                    given.items.push((lost.stamp_ns, Emission::Empty(lost.to_string())));
                }
                Err(error @ PoseError::NotRigid { .. }) => {
                    given.notes.push(error.to_string());
                    // A message has no other time for it than its neighbours'.
                    let stamp_ns = self.last_ns.unwrap_or(0);
                    given.items.push((stamp_ns, Emission::Empty(error.to_string())));
                }
            }
        }
        Ok(given)
    }

    /// A pose that holds from the beginning; nothing where it is sent again.
    fn constant(&mut self, mut pose: Pose, notes: &mut Vec<String>) -> Option<(StampNs, Emission)> {
        match self.held.iter().rfind(|known| (&known.to, &known.from) == (&pose.to, &pose.from)) {
            None => pose.stamp_ns = 0,
            Some(known) if known.isometry == pose.isometry => return None,
            Some(_) => notes.push(format!("t_{}_{} changes, though it is static", pose.to, pose.from)),
        }
        self.held.push(pose.clone());
        Some((pose.stamp_ns, Emission::value(pose)))
    }

    /// The poses of a message between the frames of the port.
    fn poses_of(
        &self,
        topic: &str,
        message: Encoded<'_>,
    ) -> Result<Vec<Result<Nearest<Pose>, PoseError>>, MessageError> {
        if MessageKind::of(message.schema_name) == Some(MessageKind::Pose) {
            let child = self.child.as_deref().unwrap_or(last_part(topic));
            return Ok(vec![read_pose_in_frame(message)?.pose(child)]);
        }
        let wanted = |to: &Frame, from: &Frame| {
            self.parent.as_deref().is_none_or(|p| p == to.as_str())
                && self.child.as_deref().is_none_or(|c| c == from.as_str())
        };
        let reads = read_transforms(message)?.into_iter().filter(|read| match read {
            Ok(pose) => wanted(&pose.value.to, &pose.value.from),
            Err(PoseError::Lost(lost)) => wanted(&lost.to, &lost.from),
            Err(PoseError::NotRigid { to, from, .. }) => wanted(to, from),
        });
        Ok(reads.collect())
    }

    fn point(
        &mut self,
        topic: &str,
        message: Encoded<'_>,
        frames: &BTreeMap<String, String>,
    ) -> Result<Given, MessageError> {
        let tip = read_pose_in_frame(message)?;
        let name = self.label(topic).unwrap_or_else(|| format!("{}_{}", last_part(topic), self.n + 1));
        let mut point = NamedPoint::new(name, tip.position);
        point.stamp_ns = tip.stamp_ns;
        let mut frame = tip.frame;
        rename(frames, [&mut frame]);
        Ok(Given { items: vec![(tip.stamp_ns, Emission::value(Points::new(frame, vec![point])))], notes: Vec::new() })
    }
}

fn rename<const N: usize>(frames: &BTreeMap<String, String>, names: [&mut Frame; N]) {
    for name in names {
        if let Some(renamed) = frames.get(name.as_str()) {
            *name = renamed.as_str().into();
        }
    }
}

/// `camera_marker` of `/tracker/camera_marker`.
fn last_part(topic: &str) -> &str {
    topic.rsplit('/').next().unwrap_or(topic)
}
