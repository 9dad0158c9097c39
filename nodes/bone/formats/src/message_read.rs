//! Messages to geometry: point clouds, transforms, poses, images and depth, of Foxglove in protobuf and (but for images) in JSON, of ROS 2
//! in CDR.
//!
//! Metres become millimetres here. A stamp is the message's own timestamp, the sensor time; the publish time replaces it only
//! if it is missing or zero.
//!
//! JSON is read in the spellings of several writers: `{sec, nsec}`, `{seconds, nanos}` or RFC 3339 timestamps, field names in
//! `snake_case` or `camelCase`, point types by number or by name, base64 of either alphabet, `NaN` bare, as text or as
//! null.

mod calibration;
mod cdr;
mod fault;
mod image;
mod layout;
mod raw_pixels;
#[cfg(test)]
mod tests;

pub use calibration::{Calibration, is_calibration, read_calibration};
pub use fault::MessageError;
pub use image::{is_image, read_depth, read_image, read_image_head};

use crate::{
    LostPose, PoseError,
    foxglove_json::{self, JsonCloud, JsonPose, JsonPoseInFrame, JsonTransform, JsonTransforms},
    invalid::{Invalid, invalid},
    mcap_read::{Message, Recording},
    normals::unit_normals,
    ros2::{
        CAMERA_INFO, COMPRESSED_IMAGE as ROS2_COMPRESSED_IMAGE, IMAGE as ROS2_IMAGE, ODOMETRY, POINT_CLOUD_2,
        POSE_STAMPED, POSE_WITH_COVARIANCE, TF_MESSAGE, TRANSFORM_STAMPED,
    },
    shape::retain,
};
use bytes::Bytes;
use foxglove::{
    Decode,
    messages::{
        FrameTransform, FrameTransforms, PointCloud, Pose as FoxglovePose, PoseInFrame,
        Quaternion as FoxgloveQuaternion, Timestamp, Vector3 as FoxgloveVector3,
    },
};
use layout::Layout;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{
    Cloud, Correction, Frame, MM_PER_M, Nearest, Pose, Region, RigidError, StampNs, TooFar, nearest_rotation,
};

/// The schema of a point cloud.
pub const POINT_CLOUD: &str = "foxglove.PointCloud";
/// The schema of one transform.
pub const FRAME_TRANSFORM: &str = "foxglove.FrameTransform";
/// The schema of several transforms.
pub const FRAME_TRANSFORMS: &str = "foxglove.FrameTransforms";
/// The schema of an image without compression.
pub const RAW_IMAGE: &str = "foxglove.RawImage";
/// The schema of a compressed image.
pub const COMPRESSED_IMAGE: &str = "foxglove.CompressedImage";
/// The schema of a camera's calibration.
pub const CAMERA_CALIBRATION: &str = "foxglove.CameraCalibration";
/// The schema of a pose in a frame, such as a stylus tip.
pub const POSE_IN_FRAME: &str = "foxglove.PoseInFrame";

/// What a message holds, whatever its encoding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageKind {
    /// A point cloud: `foxglove.PointCloud`, `sensor_msgs/msg/PointCloud2`.
    Cloud,
    /// One transform: `foxglove.FrameTransform`, `geometry_msgs/msg/TransformStamped`, the pose in `nav_msgs/msg/Odometry`.
    Transform,
    /// Several transforms: `foxglove.FrameTransforms`, `tf2_msgs/msg/TFMessage`.
    Transforms,
    /// A pose in a frame, such as a stylus tip: `foxglove.PoseInFrame`, `geometry_msgs/msg/PoseStamped` and `PoseWithCovarianceStamped`.
    Pose,
}

impl MessageKind {
    /// The kind of a schema; none of one that is not read.
    pub fn of(schema_name: &str) -> Option<Self> {
        Some(match schema_name {
            POINT_CLOUD | POINT_CLOUD_2 => Self::Cloud,
            FRAME_TRANSFORM | TRANSFORM_STAMPED | ODOMETRY => Self::Transform,
            FRAME_TRANSFORMS | TF_MESSAGE => Self::Transforms,
            POSE_IN_FRAME | POSE_STAMPED | POSE_WITH_COVARIANCE => Self::Pose,
            _ => return None,
        })
    }
}

/// A translation beyond this, a kilometre, is a tracker's code for a marker that it does not see.
const FARTHEST_M: f64 = 1e3;

/// A message and the names needed to decode it.
#[derive(Debug, Clone)]
pub struct Encoded<'a> {
    /// The schema's name, such as [`POINT_CLOUD`].
    pub schema_name: &'a str,
    /// `protobuf`, `json` or `cdr`.
    pub message_encoding: &'a str,
    /// The publish time, which replaces a missing timestamp.
    pub publish_time_ns: StampNs,
    /// The message's bytes.
    pub data: Bytes,
}

impl<'a> From<&'a Message> for Encoded<'a> {
    fn from(message: &'a Message) -> Self {
        Self {
            schema_name: &message.schema_name,
            message_encoding: &message.message_encoding,
            publish_time_ns: message.publish_time_ns,
            data: message.data.clone(),
        }
    }
}

/// A cloud read from a message.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudRead {
    /// The finite points, mm, in the message's frame, with the sensor's pose as viewpoint.
    pub cloud: Cloud,
    /// How many points the message had.
    pub n_points_in_message: usize,
    /// How many of them were NaN or infinite and were left out.
    pub n_dropped: usize,
    /// The correction of the message's pose.
    pub correction: Correction,
    /// Changes to the normals, and pixels without depth that were left out, one sentence each.
    pub notes: Vec<String>,
}

/// The properties of a cloud message without its points.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudHead {
    /// The frame of the points.
    pub frame: Frame,
    /// The sensor time.
    pub stamp_ns: StampNs,
    /// The correction of the message's pose; zero where it has none.
    pub correction: Correction,
}

/// A located point, such as the tip of a stylus.
#[derive(Debug, Clone, PartialEq)]
pub struct TipRead {
    /// The frame of the position.
    pub frame: Frame,
    /// The sensor time.
    pub stamp_ns: StampNs,
    /// The position, mm.
    pub position: Point3<f64>,
    /// The orientation of the tool, if the message has one, or why it is no rotation.
    pub orientation: Option<Result<Nearest<UnitQuaternion<f64>>, RigidError>>,
}

impl TipRead {
    /// The tool's pose, from the frame `child`.
    ///
    /// # Errors
    /// [`PoseError::Lost`] if the quaternion is zero or not finite, which is how trackers write a tool they do not see, or if
    /// there is none; [`PoseError::NotRigid`] if its length is farther than
    /// [`ROUNDED_ROTATION`](osteoflow_geometry::ROUNDED_ROTATION) from 1.
    pub fn pose(&self, child: impl Into<Frame>) -> Result<Nearest<Pose>, PoseError> {
        let (to, from, stamp_ns) = (self.frame.clone(), child.into(), self.stamp_ns);
        let Some(rotation) = self.orientation.clone() else {
            return Err(LostPose { to, from, stamp_ns, reason: "no orientation".into() }.into());
        };
        let rotation = rotation.map_err(|error| no_pose(&to, &from, stamp_ns, error))?;
        Ok(rotation.map(|r| Pose::new(to, from, Isometry3::from_parts(self.position.into(), r)).at(stamp_ns)))
    }
}

/// The sensor time of a cloud and the correction of its pose, without its points.
///
/// # Errors
/// [`MessageError`] if the schema or encoding is another, the bytes do not follow it, or the pose is no rigid motion.
pub fn read_cloud_head<'a>(message: impl Into<Encoded<'a>>) -> Result<CloudHead, MessageError> {
    let message = message.into();
    let (frame, stamp_ns, pose) = match kind_and_encoding(&message)? {
        (MessageKind::Cloud, Json) => {
            let head: JsonPoseInFrame = parse(&message)?;
            let pose = head.pose.map(|p| FoxglovePose { position: p.position, orientation: p.orientation });
            (head.frame_id, head.timestamp.nanoseconds(), pose)
        }
        (MessageKind::Cloud, encoding) => {
            let (cloud, _) = raw_cloud(&message, encoding)?;
            (cloud.frame_id, nanoseconds(cloud.timestamp), cloud.pose)
        }
        _ => return Err(wrong_schema("a point cloud", &message)),
    };
    let Nearest { correction, .. } = cloud_pose(pose.as_ref())?;
    Ok(CloudHead { frame: frame.into(), stamp_ns: stamp_ns.unwrap_or(message.publish_time_ns), correction })
}

/// The cloud in a `foxglove.PointCloud` or `sensor_msgs/msg/PointCloud2`: fields found by name at any stride, order and numeric type, moved by the
/// message's `pose`, metres turned to mm.
///
/// Points with a NaN or infinite coordinate are left out and counted. Normals (`normal_x` .. or `nx` ..) come along when
/// every kept point has one, and the times of points (`t`, `time`, `offset_time` ..) as a column; other fields are ignored. The viewpoint is the origin of the frame, for a
/// sensor looks from there, whatever `pose` its points are given in; in a frame that is no sensor's (`world`, `ct`,
/// `phantom`, a marker) it is the `pose`, or unknown where there is none. `O(n)`.
///
/// # Errors
/// [`MessageError`], saying what is missing, which bytes do not add up, or that the pose is no rigid motion.
pub fn read_cloud<'a>(message: impl Into<Encoded<'a>>) -> Result<CloudRead, MessageError> {
    let message = message.into();
    let (raw, big_endian) = match kind_and_encoding(&message)? {
        (MessageKind::Cloud, encoding) => raw_cloud(&message, encoding)?,
        _ => return Err(wrong_schema("a point cloud", &message)),
    };
    let Nearest { value: pose, correction } = cloud_pose(raw.pose.as_ref())?;
    let layout = Layout::of(&raw, big_endian)?;
    let n_points_in_message = layout.n_points;
    let (mut points, mut normals) = (Vec::with_capacity(n_points_in_message), Vec::new());
    let mut times = Vec::new();
    let mut points_in_sensor = Vec::with_capacity(n_points_in_message);
    for (k, bytes) in raw.data.chunks_exact(layout.stride.max(1)).take(n_points_in_message).enumerate() {
        let at_m = layout.position.map(|field| field.value(bytes));
        if !at_m.iter().all(|c| c.is_finite()) {
            continue;
        }
        let in_sensor = Point3::from(Vector3::from(at_m) * MM_PER_M);
        let point = pose.map_or(in_sensor, |t| t * in_sensor);
        TooFar::check(point.coords.as_slice()).map_err(|far| {
            MessageError(format!("point {}, at byte {} of the data: {far}", k + 1, k * layout.stride))
        })?;
        points_in_sensor.push(in_sensor);
        points.push(point);
        if let Some(fields) = layout.normal {
            normals.push(Vector3::from(fields.map(|field| field.value(bytes))));
        }
        times.extend(layout.time.as_ref().map(|(_, field)| field.value(bytes)));
    }
    let n_dropped = n_points_in_message - points.len();
    let invalid = invalid(&points_in_sensor, n_points_in_message);
    if let Some(Invalid { keep, .. }) = &invalid {
        retain(&mut points, keep);
        if layout.normal.is_some() {
            retain(&mut normals, keep);
        }
        if layout.time.is_some() {
            retain(&mut times, keep);
        }
    }
    let stamp_ns = nanoseconds(raw.timestamp).unwrap_or(message.publish_time_ns);
    let (normals, mut notes) = unit_normals(normals);
    notes.extend(invalid.map(|invalid| invalid.note));
    let mut cloud =
        Cloud::new(raw.frame_id, points).expect("points that are not finite were left out, and none is far");
    if let Some(mut normals) = normals.filter(|_| layout.normal.is_some()) {
        if let Some(t) = pose {
            normals.iter_mut().for_each(|normal| *normal = t * *normal);
        }
        cloud = cloud.with_normals(normals).expect("each kept point has its unit normal");
    }
    if let Some((name, _)) = layout.time {
        cloud = cloud.with_extra(name, times).expect("each kept point has its time");
    }
    cloud.stamp_ns = stamp_ns;
    cloud.viewpoint = if is_sensor_frame(cloud.frame.as_str()) { Some(Isometry3::identity()) } else { pose };
    Ok(CloudRead { cloud, n_points_in_message, n_dropped, correction, notes })
}

/// The cloud of a message of that kind, and whether the numbers of its points are big-endian.
fn raw_cloud(message: &Encoded, encoding: Encoding) -> Result<(PointCloud, bool), MessageError> {
    Ok(match encoding {
        Protobuf => (decode(message)?, false),
        Json => {
            let cloud: JsonCloud = parse(message)?;
            (cloud.into_message().map_err(|reason| no_such(message, reason))?, false)
        }
        Cdr => cdr::cloud(message)?,
    })
}

/// The poses in a message of one or several transforms, in order: `t_parent_child`, mm.
///
/// A rounded quaternion gives the nearest rotation, with its correction. A quaternion that is zero or not finite, or a
/// position that is not finite or beyond a kilometre, is how trackers write a marker they do not see: that transform is
/// [`PoseError::Lost`], which a stream turns into an empty. One whose length is farther than
/// [`ROUNDED_ROTATION`](osteoflow_geometry::ROUNDED_ROTATION) from 1 is [`PoseError::NotRigid`].
///
/// # Errors
/// [`MessageError`] if the schema or encoding is another, or the bytes do not follow it.
pub fn read_transforms<'a>(
    message: impl Into<Encoded<'a>>,
) -> Result<Vec<Result<Nearest<Pose>, PoseError>>, MessageError> {
    let message = &message.into();
    let transforms = match kind_and_encoding(message)? {
        (MessageKind::Transform, Protobuf) => vec![decode::<FrameTransform>(message)?.into()],
        (MessageKind::Transform, Json) => vec![parse::<JsonTransform>(message)?],
        (MessageKind::Transform, Cdr) => vec![cdr::transform(message)?],
        (MessageKind::Transforms, Protobuf) => {
            decode::<FrameTransforms>(message)?.transforms.into_iter().map(JsonTransform::from).collect()
        }
        (MessageKind::Transforms, Json) => parse::<JsonTransforms>(message)?.transforms,
        (MessageKind::Transforms, Cdr) => cdr::transforms(message)?,
        _ => return Err(wrong_schema("a transform", message)),
    };
    Ok(transforms.into_iter().map(|t| pose_of(t, message.publish_time_ns)).collect())
}

/// The point in a `foxglove.PoseInFrame` or `geometry_msgs/msg/PoseStamped`, mm, such as a stylus tip; its orientation may be missing.
///
/// # Errors
/// [`MessageError`] if there is no pose or its position is not finite; otherwise if the schema or encoding is another,
/// or the bytes do not follow it.
pub fn read_pose_in_frame<'a>(message: impl Into<Encoded<'a>>) -> Result<TipRead, MessageError> {
    let message = &message.into();
    let read: JsonPoseInFrame = match kind_and_encoding(message)? {
        (MessageKind::Pose, Protobuf) => decode::<PoseInFrame>(message)?.into(),
        (MessageKind::Pose, Json) => parse(message)?,
        (MessageKind::Pose, Cdr) => cdr::pose(message)?,
        _ => return Err(wrong_schema("a pose in a frame", message)),
    };
    let lost = |reason: &str| MessageError(format!("the located point cannot be used: it has {reason}"));
    let pose = read.pose.ok_or_else(|| lost("no pose"))?;
    let position = translation(&pose.position.unwrap_or_default()).map_err(|reason| lost(&reason))?;
    let orientation = pose.orientation.map(|q| rotation(&q));
    let stamp_ns = read.timestamp.nanoseconds().unwrap_or(message.publish_time_ns);
    Ok(TipRead { frame: read.frame_id.into(), stamp_ns, position: position.into(), orientation })
}

/// The region of interest that the recording's metadata record `procedure` gives, if it does: keys `roi_camera_min_m` and
/// `roi_camera_max_m`, three numbers in metres each, in the camera's frame; mm here.
///
/// # Errors
/// [`MessageError`] if only one of both is there, it does not hold three finite numbers, or min lies above max.
pub fn procedure_region(recording: &Recording) -> Result<Option<Region>, MessageError> {
    const KEYS: [&str; 2] = ["roi_camera_min_m", "roi_camera_max_m"];
    let Some(record) = recording.metadata.get("procedure") else { return Ok(None) };
    let fault = |key: &str, reason: String| {
        MessageError(format!(
            "metadata \"procedure\", key \"{key}\": {reason}; write three numbers in metres, such as \"-0.1 -0.1 0.2\""
        ))
    };
    let corners = match KEYS.map(|key| record.get(key)) {
        [None, None] => return Ok(None),
        [Some(min), Some(max)] => [min, max],
        [None, _] => return Err(fault(KEYS[0], "it is missing".into())),
        [_, None] => return Err(fault(KEYS[1], "it is missing".into())),
    };
    let corner = |k: usize| {
        let words = corners[k].split([' ', ',', ';', '\t', '[', ']']).filter(|w| !w.is_empty());
        let numbers: Vec<Option<f64>> = words.map(|w| w.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        match numbers[..] {
            [Some(x), Some(y), Some(z)] => {
                let corner = Point3::new(x, y, z) * MM_PER_M;
                TooFar::check(corner.coords.as_slice()).map_err(|far| fault(KEYS[k], far.to_string()))?;
                Ok(corner)
            }
            _ => Err(fault(KEYS[k], format!("\"{}\" is not three numbers", corners[k]))),
        }
    };
    let (min, max) = (corner(0)?, corner(1)?);
    if let Some(axis) = (0..3).find(|&k| min[k] > max[k]) {
        return Err(fault(KEYS[0], format!("its {} is above that of {}", ["x", "y", "z"][axis], KEYS[1])));
    }
    Ok(Some(Region { frame: "camera".into(), min, max }))
}

/// How a message is written.
#[derive(Clone, Copy)]
enum Encoding {
    Protobuf,
    Json,
    Cdr,
}
use Encoding::{Cdr, Json, Protobuf};

fn kind_and_encoding(message: &Encoded) -> Result<(MessageKind, Encoding), MessageError> {
    let Some(kind) = MessageKind::of(message.schema_name) else {
        return Err(wrong_schema("a point cloud, transform or pose of Foxglove or ROS 2", message));
    };
    // A schema of one family in the encoding of the other would be read with the wrong layout.
    match (message.message_encoding, message.schema_name.starts_with("foxglove.")) {
        ("protobuf", true) => Ok((kind, Protobuf)),
        ("json", true) => Ok((kind, Json)),
        ("cdr", false) => Ok((kind, Cdr)),
        _ => Err(wrong_encoding(message)),
    }
}

fn wrong_schema(expected: &str, message: &Encoded) -> MessageError {
    let content = if message.schema_name.is_empty() { "messages without a schema" } else { message.schema_name };
    MessageError(format!("{expected} is needed here, but the topic carries {content}; name another topic"))
}

fn wrong_encoding(message: &Encoded) -> MessageError {
    let Encoded { schema_name, message_encoding, .. } = message;
    MessageError(format!(
        "a {schema_name} written as \"{message_encoding}\" is not read; foxglove.* in protobuf and json are, those of ROS 2 in \
         cdr"
    ))
}

fn no_such(message: &Encoded, reason: impl ToString) -> MessageError {
    MessageError(format!("the message is no {}: {}", message.schema_name, reason.to_string()))
}

fn decode<T: Decode>(message: &Encoded) -> Result<T, MessageError> {
    T::decode(message.data.clone()).map_err(|error| no_such(message, error))
}

fn parse<T: serde::de::DeserializeOwned>(message: &Encoded) -> Result<T, MessageError> {
    foxglove_json::parse(&message.data).map_err(|error| no_such(message, error))
}

/// A timestamp; `None` if absent or zero, which means unset.
fn nanoseconds(timestamp: Option<Timestamp>) -> Option<StampNs> {
    timestamp.map(|t| StampNs::from(t.sec()) * 1_000_000_000 + StampNs::from(t.nsec())).filter(|&ns| ns != 0)
}

fn pose_of(transform: JsonTransform, publish_time_ns: StampNs) -> Result<Nearest<Pose>, PoseError> {
    let stamp_ns = transform.timestamp.nanoseconds().unwrap_or(publish_time_ns);
    let (to, from): (Frame, Frame) = (transform.parent_frame_id.into(), transform.child_frame_id.into());
    let translation = translation(&transform.translation.unwrap_or_default()).map_err(|reason| LostPose {
        to: to.clone(),
        from: from.clone(),
        stamp_ns,
        reason,
    })?;
    let rotation =
        rotation(&transform.rotation.unwrap_or_default()).map_err(|error| no_pose(&to, &from, stamp_ns, error))?;
    Ok(rotation.map(|r| Pose::new(to, from, Isometry3::from_parts(translation.into(), r)).at(stamp_ns)))
}

/// The error for an unusable quaternion.
fn no_pose(to: &Frame, from: &Frame, stamp_ns: StampNs, error: RigidError) -> PoseError {
    let (to, from) = (to.clone(), from.clone());
    let reason = match error {
        RigidError::NotFinite { .. } => "a quaternion that is not finite",
        RigidError::Zero { .. } => "an all-zero quaternion",
        error => return PoseError::NotRigid { to, from, stamp_ns, error },
    };
    LostPose { to, from, stamp_ns, reason: reason.into() }.into()
}

/// The pose of a cloud; `None` if it is unset or the identity, so that coordinates are unchanged.
fn cloud_pose(pose: Option<&FoxglovePose>) -> Result<Nearest<Option<Isometry3<f64>>>, MessageError> {
    let Some(pose) = pose else { return Ok(Nearest { value: None, correction: Correction::default() }) };
    let fault = |reason: String| MessageError(format!("the cloud's pose cannot be used: {reason}"));
    let translation =
        translation(&pose.position.unwrap_or_default()).map_err(|reason| fault(format!("it has {reason}")))?;
    let unset = Nearest { value: UnitQuaternion::identity(), correction: Correction::default() };
    let rotation = pose.orientation.map_or(Ok(unset), |q| rotation(&q)).map_err(|error| fault(error.to_string()))?;
    let pose = rotation.map(|r| Isometry3::from_parts(Translation3::from(translation), r));
    Ok(pose.map(|pose| (pose != Isometry3::identity()).then_some(pose)))
}

/// Whether a cloud in a frame of that name was seen from its origin.
pub fn is_sensor_frame(frame: &str) -> bool {
    !matches!(frame, "world" | "ct" | "phantom") && !frame.ends_with("_marker")
}

/// A position in metres as mm.
fn translation(v: &FoxgloveVector3) -> Result<Vector3<f64>, String> {
    let metres = Vector3::new(v.x, v.y, v.z);
    if !metres.iter().all(|c| c.is_finite()) {
        return Err("a position that is not finite".into());
    }
    if metres.amax() > FARTHEST_M {
        return Err(format!("a position {:.1e} m away", metres.amax()));
    }
    Ok(metres * MM_PER_M)
}

fn rotation(q: &FoxgloveQuaternion) -> Result<Nearest<UnitQuaternion<f64>>, RigidError> {
    nearest_rotation(Quaternion::new(q.w, q.x, q.y, q.z))
}

impl From<FrameTransform> for JsonTransform {
    fn from(t: FrameTransform) -> Self {
        Self {
            timestamp: t.timestamp.into(),
            parent_frame_id: t.parent_frame_id,
            child_frame_id: t.child_frame_id,
            translation: t.translation,
            rotation: t.rotation,
        }
    }
}

impl From<PoseInFrame> for JsonPoseInFrame {
    fn from(p: PoseInFrame) -> Self {
        let pose = p.pose.map(|pose| JsonPose { position: pose.position, orientation: pose.orientation });
        Self { timestamp: p.timestamp.into(), frame_id: p.frame_id, pose }
    }
}
