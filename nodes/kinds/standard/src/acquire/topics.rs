//! Messages of Foxglove's schemas and ROS 2's on topics, as recordings and bridges have them.

use osteoflow_formats::{
    PoseError,
    message_read::{
        CloudRead, Encoded, MessageError, MessageKind, TipRead, is_sensor_frame, read_cloud, read_pose_in_frame,
        read_transforms,
    },
};
use osteoflow_geometry::{Cloud, Frame, NamedPoint, Nearest, Points, Pose};
use osteoflow_node::{schemars::JsonSchema, serde::Deserialize};

/// The transforms that a port takes from its topics.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct TransformFilter {
    /// Only transforms with this parent frame, where a topic carries several.
    pub parent: Option<String>,
    /// Only transforms with this child frame; for a pose in a frame, the name of the frame that moves.
    pub child: Option<String>,
}

impl TransformFilter {
    /// The poses of a message between the frames of the port.
    pub(super) fn poses<'a>(
        &self,
        topic: &str,
        message: impl Into<Encoded<'a>>,
    ) -> Result<Vec<Result<Nearest<Pose>, PoseError>>, MessageError> {
        let message = message.into();
        if MessageKind::of(message.schema_name) == Some(MessageKind::Pose) {
            let child = self.child.as_deref().unwrap_or(last_part(topic));
            return Ok(vec![read_pose_in_frame(message)?.pose(child)]);
        }
        let wanted = |to: &Frame, from: &Frame| {
            self.parent.as_deref().is_none_or(|p| p == to.as_str())
                && self.child.as_deref().is_none_or(|c| c == from.as_str())
        };
        let poses = read_transforms(message)?.into_iter().filter(|pose| match pose {
            Ok(pose) => wanted(&pose.value.to, &pose.value.from),
            Err(PoseError::Lost(lost)) => wanted(&lost.to, &lost.from),
            Err(PoseError::NotRigid { to, from, .. }) => wanted(to, from),
        });
        Ok(poses.collect())
    }
}

/// Transforms that hold from the beginning, whenever they are sent.
#[derive(Default)]
pub(super) struct Constants(Vec<Pose>);

impl Constants {
    /// The transforms of a topic are constants.
    pub(super) fn are_on(topic: &str) -> bool {
        last_part(topic) == "tf_static"
    }

    /// The constant, without a stamp; `None` where it is sent again. One that is sent again with another value holds from its own
    /// stamp on.
    pub(super) fn take(&mut self, mut pose: Pose, notes: &mut Vec<String>) -> Option<Pose> {
        match self.0.iter().rfind(|known| (&known.to, &known.from) == (&pose.to, &pose.from)) {
            None => pose.stamp_ns = 0,
            Some(known) if known.isometry == pose.isometry => return None,
            Some(_) => {
                notes.push(format!("t_{}_{} changes at {} ns, though it is static", pose.to, pose.from, pose.stamp_ns))
            }
        }
        self.0.push(pose.clone());
        Some(pose)
    }
}

/// The cloud of a message, and what the user should know of it; `renamed` is a frame's name in the graph, if that is another.
pub(super) fn cloud<'a>(
    message: impl Into<Encoded<'a>>,
    label: &str,
    renamed: impl FnOnce(&Frame) -> Option<Frame>,
) -> Result<(Cloud, Vec<String>), MessageError> {
    Ok(named(read_cloud(message)?, label, renamed))
}

/// The cloud that was read of a message, as [`cloud`].
pub(super) fn named(
    read: CloudRead,
    label: &str,
    renamed: impl FnOnce(&Frame) -> Option<Frame>,
) -> (Cloud, Vec<String>) {
    let dropped = (read.n_dropped > 0).then(|| {
        let (n, all) = (read.n_dropped, read.n_points_in_message);
        format!("{n} of {all} points are NaN or infinite and were left out")
    });
    let mut cloud = read.cloud.labelled(label);
    if let Some(frame) = renamed(&cloud.frame) {
        cloud.viewpoint = cloud.viewpoint.filter(|_| is_sensor_frame(frame.as_str()));
        cloud.frame = frame;
    }
    (cloud, dropped.into_iter().chain(read.notes).collect())
}

/// A located point as a list of one, in `frame`.
pub(super) fn point(tip: &TipRead, name: String, frame: Frame) -> Points {
    let mut point = NamedPoint::new(name, tip.position);
    point.stamp_ns = tip.stamp_ns;
    Points::new(frame, vec![point])
}

/// `camera_marker` of `/tracker/camera_marker`.
pub(super) fn last_part(topic: &str) -> &str {
    topic.rsplit('/').next().unwrap_or(topic)
}
