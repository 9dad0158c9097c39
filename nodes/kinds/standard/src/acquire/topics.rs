//! Messages of Foxglove's schemas and ROS 2's on topics, as recordings and bridges have them.

use osteoflow_formats::{
    PoseError, Spellings,
    message_read::{Encoded, MessageError, MessageKind, read_pose_in_frame, read_transforms},
    without_slash,
};
use osteoflow_geometry::{Frame, Nearest, Pose};
use osteoflow_node::{NodeError, schemars::JsonSchema, serde::Deserialize};
use std::collections::{BTreeMap, BTreeSet};

/// Whether a port with this payload reads messages of this schema without further parameters; images need a calibration.
pub fn reads(payload: &str, schema: &str) -> bool {
    match MessageKind::of(schema) {
        Some(MessageKind::Cloud) => payload == "geometry/Cloud",
        Some(MessageKind::Transform | MessageKind::Transforms) => payload == "geometry/Pose",
        Some(MessageKind::Pose) => ["geometry/Pose", "geometry/Points"].contains(&payload),
        None => false,
    }
}

/// Frames of a source that have other names in the graph, and those of them that were met. A leading slash is none of a name.
#[derive(Clone, Default)]
pub(super) struct FrameNames {
    names: BTreeMap<String, String>,
    met: BTreeSet<String>,
}

impl FrameNames {
    pub(super) fn new(names: &BTreeMap<String, String>) -> Self {
        Self { names: names.clone(), met: BTreeSet::new() }
    }

    /// The name of a frame in the graph, if it is another.
    pub(super) fn of(&mut self, frame: &Frame) -> Option<Frame> {
        let plain = without_slash(frame.as_str());
        match self.names.iter().find(|(name, _)| without_slash(name) == plain) {
            Some((name, in_graph)) => {
                self.met.insert(name.clone());
                Some(in_graph.as_str().into())
            }
            None => (plain != frame.as_str()).then(|| plain.into()),
        }
    }

    pub(super) fn rename(&mut self, frames: [&mut Frame; 2]) {
        for frame in frames {
            *frame = self.of(frame).unwrap_or_else(|| frame.clone());
        }
    }

    /// Refuses a name of a frame that no `item` is in.
    pub(super) fn check_met(&self, item: &str) -> Result<(), NodeError> {
        match self.names.keys().find(|name| !self.met.contains(*name)) {
            Some(name) => Err(NodeError::new(format!(
                "frames names \"{name}\", but no {item} that a port reads is in it; `osteoflow info` lists the frames"
            ))),
            None => Ok(()),
        }
    }
}

/// The transforms that a port takes from its topics.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct TransformFilter {
    /// Only transforms with this parent frame.
    pub parent: Option<String>,
    /// Only transforms with this child frame; of a pose in a frame, the name of the frame that moves.
    pub child: Option<String>,
}

impl TransformFilter {
    /// The poses of a message between the frames of the port, whose names have no leading slash.
    pub(super) fn poses<'a>(
        &self,
        topic: &str,
        message: impl Into<Encoded<'a>>,
        spellings: &mut Spellings,
    ) -> Result<Vec<TransformRead>, MessageError> {
        let message = message.into();
        if MessageKind::of(message.schema_name) == Some(MessageKind::Pose) {
            let child = self.child.as_deref().unwrap_or(last_part(topic));
            return Ok(vec![read_pose_in_frame(message)?.pose(child)]);
        }
        let mut poses = read_transforms(message)?;
        poses.retain_mut(|pose| {
            let [to, from] = frames_mut(pose);
            (*to, *from) = (spellings.take(to), spellings.take(from));
            self.wants(to, from)
        });
        Ok(poses)
    }

    /// Whether the port takes `t_to_from`.
    pub(super) fn wants(&self, to: &Frame, from: &Frame) -> bool {
        let is = |wanted: &Option<String>, frame: &Frame| {
            wanted.as_deref().is_none_or(|wanted| without_slash(wanted) == frame.as_str())
        };
        is(&self.parent, to) && is(&self.child, from)
    }
}

/// A transform of a message, or why it gives no pose.
pub(super) type TransformRead = Result<Nearest<Pose>, PoseError>;

/// The frames to and from of a transform.
fn frames_mut(read: &mut TransformRead) -> [&mut Frame; 2] {
    match read {
        Ok(pose) => [&mut pose.value.to, &mut pose.value.from],
        Err(PoseError::Lost(lost)) => [&mut lost.to, &mut lost.from],
        Err(PoseError::NotRigid { to, from, .. }) => [to, from],
    }
}

/// Static transforms farther apart than this differ: rounding in single precision.
const EQUAL_MM: f64 = 1e-4;
const EQUAL_RAD: f64 = 1e-6;

/// Transforms that hold from the beginning, whenever they are sent.
#[derive(Default)]
pub(super) struct Constants(Vec<Pose>);

impl Constants {
    /// The transforms of a topic are constants.
    pub(super) fn are_on(topic: &str) -> bool {
        last_part(topic) == "tf_static"
    }

    /// The constant, without a stamp; `None` where it is sent again. One that is sent again with another value holds from its own
    /// stamp on, which is told once.
    pub(super) fn take(&mut self, mut pose: Pose, tell: impl FnOnce(String)) -> Option<Pose> {
        let known: Vec<_> = self.0.iter().filter(|known| (&known.to, &known.from) == (&pose.to, &pose.from)).collect();
        match known[..] {
            [] => pose.stamp_ns = 0,
            [.., last] => {
                let between = last.isometry.inverse() * pose.isometry;
                let (mm, rad) = (between.translation.vector.norm(), between.rotation.angle());
                if mm <= EQUAL_MM && rad <= EQUAL_RAD {
                    return None;
                }
                if known.len() == 1 {
                    let Pose { to, from, stamp_ns, .. } = &pose;
                    tell(format!(
                        "t_{to}_{from} changes at {stamp_ns} ns by {mm:.2} mm and {:.2} degrees, though it is static; the new value is used from \
                         then on; find what else sends this transform",
                        rad.to_degrees()
                    ));
                }
            }
        }
        self.0.push(pose.clone());
        Some(pose)
    }
}

/// `camera_marker` of `/tracker/camera_marker`.
pub(super) fn last_part(topic: &str) -> &str {
    topic.rsplit('/').next().unwrap_or(topic)
}
