//! Foxglove messages to geometry: point clouds, transforms and poses, in protobuf and in JSON.
//!
//! Metres become millimetres here and nowhere later. A stamp is the message's own timestamp, which is when the sensor
//! measured; only where a writer left it out or zero does the publish time stand in.
//!
//! JSON is read as it is met in practice: `{sec, nsec}`, `{seconds, nanos}` or RFC 3339 timestamps, field names in
//! `snake_case` or `camelCase`, point types by number or by name, base64 of either alphabet, `NaN` bare, as text or as
//! null.

use crate::{
    LostPose,
    foxglove_json::{self, JsonCloud, JsonPose, JsonPoseInFrame, JsonTimestamp, JsonTransform, JsonTransforms},
    mcap_read::{Message, Recording},
};
use bytes::Bytes;
use foxglove::{
    Decode,
    messages::{
        FrameTransform, FrameTransforms, PointCloud, Pose as FoxglovePose, PoseInFrame,
        Quaternion as FoxgloveQuaternion, Timestamp, Vector3 as FoxgloveVector3, packed_element_field::NumericType,
    },
};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Cloud, Frame, MM_PER_M, Pose, Region, StampNs};

/// The schema of a point cloud.
pub const POINT_CLOUD: &str = "foxglove.PointCloud";
/// The schema of one transform.
pub const FRAME_TRANSFORM: &str = "foxglove.FrameTransform";
/// The schema of several transforms.
pub const FRAME_TRANSFORMS: &str = "foxglove.FrameTransforms";
/// The schema of a pose in a frame, such as a stylus tip.
pub const POSE_IN_FRAME: &str = "foxglove.PoseInFrame";

/// A translation beyond this is a tracker's code for "not seen", not a place: a kilometre.
const FARTHEST_M: f64 = 1e3;

/// A quaternion shorter than this holds no direction worth normalising.
const SHORTEST_QUATERNION: f64 = 1e-6;

/// A message with what is needed to decode it.
#[derive(Debug, Clone)]
pub struct Encoded<'a> {
    /// The schema's name, such as [`POINT_CLOUD`].
    pub schema_name: &'a str,
    /// `protobuf` or `json`.
    pub message_encoding: &'a str,
    /// When it was sent: stands in for a missing timestamp.
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

/// A message that does not give what it should.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FoxgloveError {
    /// The topic carries something else.
    #[error("{expected} is needed here, but the topic carries {found}; name another topic")]
    Schema {
        /// The schemas that would do.
        expected: &'static str,
        /// The schema that is there.
        found: String,
    },
    /// The message is written in another way than protobuf or JSON.
    #[error("the message is written as \"{found}\", but only protobuf and json can be read")]
    Encoding {
        /// The encoding that is there.
        found: String,
    },
    /// The bytes are no such message.
    #[error("the message is no {schema}: {reason}")]
    Decode {
        /// The schema it should follow.
        schema: String,
        /// What the decoder said.
        reason: String,
    },
    /// A point field is missing.
    #[error("the points have no field \"{missing}\"; there are: {found}")]
    MissingField {
        /// The field.
        missing: &'static str,
        /// The fields that are there.
        found: String,
    },
    /// A point field has a type that is no number.
    #[error("field \"{field}\" has numeric type {code}, but 1 (uint8) to 8 (float64) are known")]
    FieldType {
        /// The field.
        field: String,
        /// The type's code.
        code: i32,
    },
    /// A point field reaches beyond its point.
    #[error("field \"{field}\" ends at byte {end} of a point, but a point has {stride} bytes (point_stride)")]
    FieldEnd {
        /// The field.
        field: String,
        /// Where it ends.
        end: u64,
        /// The bytes of a point.
        stride: u32,
    },
    /// The data is not a whole number of points.
    #[error(
        "the data has {n_bytes} bytes, which is no whole number of points of {stride} bytes: {rest} remain; \
         was the message cut short?"
    )]
    Length {
        /// The bytes there are.
        n_bytes: usize,
        /// The bytes of a point.
        stride: u32,
        /// What remains behind the last whole point.
        rest: usize,
    },
    /// A pose that is no rigid motion.
    #[error("the {what} cannot be used: it has {reason}")]
    Pose {
        /// Which pose it is.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// A region of interest that cannot be understood.
    #[error(
        "metadata \"procedure\", key \"{key}\": {reason}; write three numbers in metres, such as \"-0.1 -0.1 0.2\""
    )]
    Region {
        /// The key.
        key: String,
        /// What is wrong with it.
        reason: String,
    },
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
    /// How many kept points had a normal that is none; if there is one, the cloud goes without normals.
    pub n_bad_normals: usize,
}

/// A located point, such as the tip of a stylus.
#[derive(Debug, Clone, PartialEq)]
pub struct TipRead {
    /// The frame of the position.
    pub frame: Frame,
    /// When it was located.
    pub stamp_ns: StampNs,
    /// Where it is, mm.
    pub position: Point3<f64>,
    /// How the tool was held, where the message says so.
    pub orientation: Option<UnitQuaternion<f64>>,
}

/// The sensor time of a message of any of the schemas; for several transforms, of the first one.
///
/// # Errors
/// [`FoxgloveError`] if the schema or encoding is not known, or the bytes do not follow it.
pub fn stamp<'a>(message: impl Into<Encoded<'a>>) -> Result<StampNs, FoxgloveError> {
    let message = message.into();
    let time = match (message.schema_name, encoding(&message)?) {
        (POINT_CLOUD, Protobuf) => nanoseconds(decode::<PointCloud>(&message)?.timestamp),
        (FRAME_TRANSFORM, Protobuf) => nanoseconds(decode::<FrameTransform>(&message)?.timestamp),
        (POSE_IN_FRAME, Protobuf) => nanoseconds(decode::<PoseInFrame>(&message)?.timestamp),
        (FRAME_TRANSFORMS, Protobuf) => {
            decode::<FrameTransforms>(&message)?.transforms.first().and_then(|t| nanoseconds(t.timestamp))
        }
        (FRAME_TRANSFORMS, Json) => {
            parse::<JsonTransforms>(&message)?.transforms.first().and_then(|t| t.timestamp.nanoseconds())
        }
        (POINT_CLOUD | FRAME_TRANSFORM | POSE_IN_FRAME, Json) => {
            parse::<JsonTimestamp>(&message)?.timestamp.nanoseconds()
        }
        _ => return Err(wrong_schema("a Foxglove point cloud, transform or pose", &message)),
    };
    Ok(time.unwrap_or(message.publish_time_ns))
}

/// The cloud in a `foxglove.PointCloud`: fields found by name at any stride, order and numeric type, moved by the
/// message's `pose`, metres turned to mm.
///
/// Points with a NaN or infinite coordinate are left out and counted. Normals (`normal_x` .. or `nx` ..) come along when
/// every kept point has one; other fields are ignored. The viewpoint is the message's `pose`: a sensor looks from the
/// origin of the frame it measures in. `O(n)`.
///
/// # Errors
/// [`FoxgloveError`], saying what is missing, which bytes do not add up, or that the pose is no rigid motion.
pub fn read_cloud<'a>(message: impl Into<Encoded<'a>>) -> Result<CloudRead, FoxgloveError> {
    let message = message.into();
    let raw: PointCloud = match (message.schema_name, encoding(&message)?) {
        (POINT_CLOUD, Protobuf) => decode(&message)?,
        (POINT_CLOUD, Json) => {
            let cloud: JsonCloud = parse(&message)?;
            cloud.into_message().map_err(|reason| no_such(&message, reason))?
        }
        _ => return Err(wrong_schema(POINT_CLOUD, &message)),
    };
    let pose = cloud_pose(raw.pose.as_ref())?;
    let layout = Layout::of(&raw)?;
    let n_points_in_message = layout.n_points;
    let (mut points, mut normals) = (Vec::with_capacity(n_points_in_message), Vec::new());
    let mut n_bad_normals = 0;
    for bytes in raw.data.chunks_exact(layout.stride.max(1)).take(n_points_in_message) {
        let at_m = layout.position.map(|field| field.value(bytes));
        let point = Point3::from(Vector3::from(at_m) * MM_PER_M);
        if !point.coords.iter().all(|c| c.is_finite()) {
            continue;
        }
        points.push(pose.map_or(point, |t| t * point));
        if let Some(fields) = layout.normal {
            let normal = Vector3::from(fields.map(|field| field.value(bytes)));
            match normal.try_normalize(1e-9).filter(|n| n.iter().all(|c| c.is_finite())) {
                Some(normal) => normals.push(pose.map_or(normal, |t| t * normal)),
                None => n_bad_normals += 1,
            }
        }
    }
    let n_dropped = n_points_in_message - points.len();
    let stamp_ns = nanoseconds(raw.timestamp).unwrap_or(message.publish_time_ns);
    let with_normals = layout.normal.is_some() && n_bad_normals == 0;
    let mut cloud = Cloud::new(raw.frame_id, points).expect("points that are not finite were left out");
    if with_normals {
        cloud = cloud.with_normals(normals).expect("each kept point has its normal");
    }
    let cloud = cloud.at(stamp_ns).seen_from(pose.unwrap_or_default());
    Ok(CloudRead { cloud, n_points_in_message, n_dropped, n_bad_normals })
}

/// The poses in a `foxglove.FrameTransform` or `foxglove.FrameTransforms`, in order: `t_parent_child`, mm.
///
/// A quaternion of another length than one is normalised. One that is all zero or not finite, or a place that is not
/// finite or beyond a kilometre, is how trackers write a marker they do not see: that one transform is a [`LostPose`],
/// which a stream turns into an empty.
///
/// # Errors
/// [`FoxgloveError`] if the schema or encoding is another, or the bytes do not follow it.
pub fn read_transforms<'a>(message: impl Into<Encoded<'a>>) -> Result<Vec<Result<Pose, LostPose>>, FoxgloveError> {
    let message = message.into();
    let transforms = match (message.schema_name, encoding(&message)?) {
        (FRAME_TRANSFORM, Protobuf) => vec![decode::<FrameTransform>(&message)?.into()],
        (FRAME_TRANSFORM, Json) => vec![parse::<JsonTransform>(&message)?],
        (FRAME_TRANSFORMS, Protobuf) => {
            decode::<FrameTransforms>(&message)?.transforms.into_iter().map(JsonTransform::from).collect()
        }
        (FRAME_TRANSFORMS, Json) => parse::<JsonTransforms>(&message)?.transforms,
        _ => return Err(wrong_schema("foxglove.FrameTransform or foxglove.FrameTransforms", &message)),
    };
    Ok(transforms.into_iter().map(|t| pose_of(t, message.publish_time_ns)).collect())
}

/// The point in a `foxglove.PoseInFrame`, mm, such as a stylus tip; its orientation may be missing.
///
/// # Errors
/// [`FoxgloveError::Pose`] if there is no position or it is not finite; otherwise if the schema or encoding is another,
/// or the bytes do not follow it.
pub fn read_pose_in_frame<'a>(message: impl Into<Encoded<'a>>) -> Result<TipRead, FoxgloveError> {
    let message = message.into();
    let read: JsonPoseInFrame = match (message.schema_name, encoding(&message)?) {
        (POSE_IN_FRAME, Protobuf) => decode::<PoseInFrame>(&message)?.into(),
        (POSE_IN_FRAME, Json) => parse(&message)?,
        _ => return Err(wrong_schema(POSE_IN_FRAME, &message)),
    };
    let lost = |reason: &str| FoxgloveError::Pose { what: "located point", reason: reason.into() };
    let pose = read.pose.ok_or_else(|| lost("no pose"))?;
    let position = translation(&pose.position.unwrap_or_default()).map_err(|reason| lost(&reason))?;
    let orientation = pose.orientation.and_then(|q| rotation(&q).ok());
    let stamp_ns = read.timestamp.nanoseconds().unwrap_or(message.publish_time_ns);
    Ok(TipRead { frame: read.frame_id.into(), stamp_ns, position: position.into(), orientation })
}

/// The region of interest that the recording's metadata record `procedure` gives, if it does: keys `roi_camera_min_m` and
/// `roi_camera_max_m`, three numbers in metres each, in the camera's frame; mm here.
///
/// # Errors
/// [`FoxgloveError::Region`] if only one of both is there, it does not hold three finite numbers, or min lies above max.
pub fn procedure_region(recording: &Recording) -> Result<Option<Region>, FoxgloveError> {
    const KEYS: [&str; 2] = ["roi_camera_min_m", "roi_camera_max_m"];
    let Some(record) = recording.metadata.get("procedure") else { return Ok(None) };
    let fault = |key: &str, reason: String| FoxgloveError::Region { key: key.into(), reason };
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
            [Some(x), Some(y), Some(z)] => Ok(Point3::new(x, y, z) * MM_PER_M),
            _ => Err(fault(KEYS[k], format!("\"{}\" is not three numbers", corners[k]))),
        }
    };
    let (min, max) = (corner(0)?, corner(1)?);
    if let Some(axis) = (0..3).find(|&k| min[k] > max[k]) {
        return Err(fault(KEYS[0], format!("its {} lies above that of {}", ["x", "y", "z"][axis], KEYS[1])));
    }
    Ok(Some(Region { frame: "camera".into(), min, max }))
}

enum Encoding {
    Protobuf,
    Json,
}
use Encoding::{Json, Protobuf};

fn encoding(message: &Encoded) -> Result<Encoding, FoxgloveError> {
    match message.message_encoding {
        "protobuf" => Ok(Protobuf),
        "json" => Ok(Json),
        found => Err(FoxgloveError::Encoding { found: found.into() }),
    }
}

fn wrong_schema(expected: &'static str, message: &Encoded) -> FoxgloveError {
    let found = if message.schema_name.is_empty() { "messages without a schema" } else { message.schema_name };
    FoxgloveError::Schema { expected, found: found.into() }
}

fn no_such(message: &Encoded, reason: impl ToString) -> FoxgloveError {
    FoxgloveError::Decode { schema: message.schema_name.into(), reason: reason.to_string() }
}

fn decode<T: Decode>(message: &Encoded) -> Result<T, FoxgloveError> {
    T::decode(message.data.clone()).map_err(|error| no_such(message, error))
}

fn parse<T: serde::de::DeserializeOwned>(message: &Encoded) -> Result<T, FoxgloveError> {
    foxglove_json::parse(&message.data).map_err(|error| no_such(message, error))
}

/// A timestamp that says something: zero is what a writer leaves that did not set it.
fn nanoseconds(timestamp: Option<Timestamp>) -> Option<StampNs> {
    timestamp.map(|t| StampNs::from(t.sec()) * 1_000_000_000 + StampNs::from(t.nsec())).filter(|&ns| ns != 0)
}

fn pose_of(transform: JsonTransform, publish_time_ns: StampNs) -> Result<Pose, LostPose> {
    let stamp_ns = transform.timestamp.nanoseconds().unwrap_or(publish_time_ns);
    let (to, from): (Frame, Frame) = (transform.parent_frame_id.into(), transform.child_frame_id.into());
    let lost = |reason| LostPose { to: to.clone(), from: from.clone(), stamp_ns, reason };
    let translation = translation(&transform.translation.unwrap_or_default()).map_err(&lost)?;
    let rotation = rotation(&transform.rotation.unwrap_or_default()).map_err(&lost)?;
    Ok(Pose::new(to.clone(), from.clone(), Isometry3::from_parts(translation.into(), rotation)).at(stamp_ns))
}

/// The pose of a cloud; none where it is unset or the identity, so that coordinates stay exactly as they are.
fn cloud_pose(pose: Option<&FoxglovePose>) -> Result<Option<Isometry3<f64>>, FoxgloveError> {
    let Some(pose) = pose else { return Ok(None) };
    let fault = |reason| FoxgloveError::Pose { what: "cloud's pose", reason };
    let translation = translation(&pose.position.unwrap_or_default()).map_err(fault)?;
    let rotation = pose.orientation.map_or(Ok(UnitQuaternion::identity()), |q| rotation(&q).map_err(fault))?;
    let pose = Isometry3::from_parts(Translation3::from(translation), rotation);
    Ok((pose != Isometry3::identity()).then_some(pose))
}

/// A place in metres as mm, where it is one.
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

fn rotation(q: &FoxgloveQuaternion) -> Result<UnitQuaternion<f64>, String> {
    let q = Quaternion::new(q.w, q.x, q.y, q.z);
    if !q.coords.iter().all(|c| c.is_finite()) {
        return Err("a quaternion that is not finite".into());
    }
    if q.coords == nalgebra::Vector4::zeros() {
        return Err("an all-zero quaternion".into());
    }
    let norm = q.norm();
    if !(SHORTEST_QUATERNION..1.0 / SHORTEST_QUATERNION).contains(&norm) {
        return Err(format!("a quaternion of length {norm:.1e}"));
    }
    Ok(UnitQuaternion::from_quaternion(q))
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

/// A number within a point.
#[derive(Clone, Copy)]
struct Field {
    offset: usize,
    kind: NumericType,
}

impl Field {
    fn value(self, point: &[u8]) -> f64 {
        fn at<const N: usize>(point: &[u8], offset: usize) -> [u8; N] {
            std::array::from_fn(|k| point[offset + k])
        }
        let o = self.offset;
        match self.kind {
            NumericType::Uint8 => point[o].into(),
            NumericType::Int8 => i8::from_le_bytes(at(point, o)).into(),
            NumericType::Uint16 => u16::from_le_bytes(at(point, o)).into(),
            NumericType::Int16 => i16::from_le_bytes(at(point, o)).into(),
            NumericType::Uint32 => u32::from_le_bytes(at(point, o)).into(),
            NumericType::Int32 => i32::from_le_bytes(at(point, o)).into(),
            NumericType::Float32 => f32::from_le_bytes(at(point, o)).into(),
            NumericType::Float64 => f64::from_le_bytes(at(point, o)),
            NumericType::Unknown => f64::NAN,
        }
    }
}

/// Where the numbers of a point lie, checked to be within it.
struct Layout {
    stride: usize,
    n_points: usize,
    position: [Field; 3],
    normal: Option<[Field; 3]>,
}

impl Layout {
    fn of(raw: &PointCloud) -> Result<Self, FoxgloveError> {
        let stride = raw.point_stride;
        let [x, y, z] = ["x", "y", "z"].map(|name| Self::field(raw, name));
        let position = [Self::needed(raw, "x", x?)?, Self::needed(raw, "y", y?)?, Self::needed(raw, "z", z?)?];
        let normal = [["normal_x", "normal_y", "normal_z"], ["nx", "ny", "nz"]].into_iter().find_map(|names| {
            // Normals are an extra: where they are incomplete or of no known type, the cloud goes without.
            let [x, y, z] = names.map(|name| Self::field(raw, name).ok().flatten());
            Some([x?, y?, z?])
        });
        let n_bytes = raw.data.len();
        let rest = n_bytes.checked_rem(stride as usize).unwrap_or(n_bytes);
        if rest != 0 {
            return Err(FoxgloveError::Length { n_bytes, stride, rest });
        }
        let n_points = n_bytes.checked_div(stride as usize).unwrap_or(0);
        Ok(Self { stride: stride as usize, n_points, position, normal })
    }

    /// The first field of that name.
    fn field(raw: &PointCloud, name: &str) -> Result<Option<Field>, FoxgloveError> {
        let Some(field) = raw.fields.iter().find(|f| f.name == name) else { return Ok(None) };
        let kind = NumericType::try_from(field.r#type).unwrap_or(NumericType::Unknown);
        let n_bytes = match kind {
            NumericType::Uint8 | NumericType::Int8 => 1,
            NumericType::Uint16 | NumericType::Int16 => 2,
            NumericType::Uint32 | NumericType::Int32 | NumericType::Float32 => 4,
            NumericType::Float64 => 8,
            NumericType::Unknown => {
                return Err(FoxgloveError::FieldType { field: name.into(), code: field.r#type });
            }
        };
        let end = u64::from(field.offset) + n_bytes;
        if end > raw.point_stride.into() {
            return Err(FoxgloveError::FieldEnd { field: name.into(), end, stride: raw.point_stride });
        }
        Ok(Some(Field { offset: field.offset as usize, kind }))
    }

    fn needed(raw: &PointCloud, missing: &'static str, field: Option<Field>) -> Result<Field, FoxgloveError> {
        field.ok_or_else(|| {
            let names: Vec<&str> = raw.fields.iter().map(|f| f.name.as_str()).collect();
            let found = if names.is_empty() { "none".into() } else { names.join(", ") };
            FoxgloveError::MissingField { missing, found }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foxglove::{Encode, messages::PackedElementField};

    fn message(schema_name: &'static str, message_encoding: &'static str, data: impl Into<Bytes>) -> Encoded<'static> {
        Encoded { schema_name, message_encoding, publish_time_ns: 77, data: data.into() }
    }

    fn protobuf<M: Encode>(schema_name: &'static str, content: &M) -> Encoded<'static> {
        let mut data = Vec::new();
        content.encode(&mut data).unwrap();
        message(schema_name, "protobuf", data)
    }

    fn cloud_of(stride: u32, fields: &[(&str, u32, i32)], data: Vec<u8>) -> PointCloud {
        let field =
            |&(name, offset, kind): &(&str, u32, i32)| PackedElementField { name: name.into(), offset, r#type: kind };
        PointCloud {
            timestamp: Some(Timestamp::new(5, 6)),
            frame_id: "camera".into(),
            pose: None,
            point_stride: stride,
            fields: fields.iter().map(field).collect(),
            data: data.into(),
        }
    }

    fn xyz_f32(points: &[[f32; 3]]) -> PointCloud {
        let data = points.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        cloud_of(12, &[("x", 0, 7), ("y", 4, 7), ("z", 8, 7)], data)
    }

    fn read(raw: &PointCloud) -> Result<CloudRead, FoxgloveError> {
        read_cloud(protobuf(POINT_CLOUD, raw))
    }

    #[test]
    fn every_numeric_type_is_read_as_what_it_is() {
        // Foxglove's codes: 1 is unsigned and 2 signed, the other way round than in ROS.
        let minus_two: [(i32, Vec<u8>, f64); 8] = [
            (1, vec![254], 254.0),
            (2, vec![254], -2.0),
            (3, (-2_i16).to_le_bytes().into(), 65_534.0),
            (4, (-2_i16).to_le_bytes().into(), -2.0),
            (5, (-2_i32).to_le_bytes().into(), 4_294_967_294.0),
            (6, (-2_i32).to_le_bytes().into(), -2.0),
            (7, (-2_f32).to_le_bytes().into(), -2.0),
            (8, (-2_f64).to_le_bytes().into(), -2.0),
        ];
        for (code, bytes, metres) in minus_two {
            let n = bytes.len() as u32;
            let mut data = vec![3, 4];
            data.extend(&bytes);
            let raw = cloud_of(2 + n, &[("z", 0, 1), ("y", 1, 2), ("x", 2, code)], data);
            let found = read(&raw).unwrap().cloud.points()[0];
            assert_eq!(found, Point3::new(metres * 1000.0, 4000.0, 3000.0), "type {code}");
        }
    }

    #[test]
    fn points_that_are_not_finite_are_left_out_and_counted() {
        let (nan, inf) = (f32::NAN, f32::INFINITY);
        let read = read(&xyz_f32(&[[nan; 3], [0.5, 0.0, 1.0], [0.0, -inf, 0.0], [0.0, 0.0, nan]])).unwrap();
        assert_eq!((read.n_points_in_message, read.n_dropped), (4, 3));
        assert_eq!(read.cloud.points(), [Point3::new(500.0, 0.0, 1000.0)]);
        assert_eq!(read.cloud.stamp_ns, 5_000_000_006);
    }

    #[test]
    fn an_empty_cloud_is_a_cloud() {
        let read = read(&xyz_f32(&[])).unwrap();
        assert!(read.cloud.is_empty() && read.n_points_in_message == 0);
    }

    #[test]
    fn a_pose_moves_points_and_normals_and_is_the_viewpoint() {
        let mut raw = xyz_f32(&[[0.1, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        raw.point_stride = 24;
        raw.fields.extend([("nx", 12), ("ny", 16), ("nz", 20)].map(|(name, offset)| PackedElementField {
            name: name.into(),
            offset,
            r#type: 7,
        }));
        raw.data = [0.1, 0.0, 0.0, 2.0, 0.0, 0.0_f32].iter().flat_map(|c| c.to_le_bytes()).collect::<Vec<u8>>().into();
        // A quarter turn about z and half a metre along y, with a quaternion of twice the length.
        let q = std::f64::consts::SQRT_2;
        raw.pose = Some(FoxglovePose {
            position: Some(FoxgloveVector3 { x: 0.0, y: 0.5, z: 0.0 }),
            orientation: Some(FoxgloveQuaternion { x: 0.0, y: 0.0, z: q, w: q }),
        });
        let cloud = read(&raw).unwrap().cloud;
        // 0.1 in single precision is off by 1.5e-6 mm.
        assert!((cloud.points()[0] - Point3::new(0.0, 600.0, 0.0)).norm() < 1e-5);
        assert!((cloud.normals().unwrap()[0] - Vector3::y()).norm() < 1e-12, "unit length, turned along");
        assert!((cloud.viewpoint.unwrap() * Point3::origin() - Point3::new(0.0, 500.0, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn an_unset_pose_leaves_the_coordinates_as_they_are() {
        let plain = read(&xyz_f32(&[[0.1, 0.2, 0.3]])).unwrap().cloud;
        assert_eq!(plain.viewpoint, Some(Isometry3::identity()));
        let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]]);
        raw.pose = Some(FoxglovePose { position: None, orientation: None });
        assert_eq!(read(&raw).unwrap().cloud, plain);
    }

    #[test]
    fn a_pose_that_turns_nothing_is_refused() {
        for (w, said) in [(0.0, "an all-zero quaternion"), (f64::NAN, "a quaternion that is not finite")] {
            let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]]);
            let orientation = FoxgloveQuaternion { x: 0.0, y: 0.0, z: 0.0, w };
            raw.pose = Some(FoxglovePose { position: None, orientation: Some(orientation) });
            let error = read(&raw).unwrap_err().to_string();
            assert_eq!(error, format!("the cloud's pose cannot be used: it has {said}"));
        }
    }

    #[test]
    fn bytes_that_do_not_add_up_are_told_with_their_numbers() {
        let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]; 2]);
        raw.data = raw.data.slice(..23);
        let error = read(&raw).unwrap_err().to_string();
        assert!(
            error.starts_with("the data has 23 bytes, which is no whole number of points of 12 bytes: 11 remain"),
            "{error}"
        );
        raw.point_stride = 11;
        assert_eq!(read(&raw), Err(FoxgloveError::FieldEnd { field: "z".into(), end: 12, stride: 11 }));
        raw.point_stride = 0;
        assert!(matches!(read(&raw), Err(FoxgloveError::FieldEnd { .. })));
        raw.fields.pop();
        assert_eq!(read(&raw), Err(FoxgloveError::FieldEnd { field: "x".into(), end: 4, stride: 0 }));
        raw.point_stride = 23;
        assert_eq!(read(&raw), Err(FoxgloveError::MissingField { missing: "z", found: "x, y".into() }));
        raw.fields[0].r#type = 9;
        assert_eq!(read(&raw), Err(FoxgloveError::FieldType { field: "x".into(), code: 9 }));
    }

    #[test]
    fn a_missing_or_zero_timestamp_gives_way_to_the_publish_time() {
        let mut raw = xyz_f32(&[[0.0; 3]]);
        for timestamp in [None, Some(Timestamp::new(0, 0))] {
            raw.timestamp = timestamp;
            assert_eq!(read(&raw).unwrap().cloud.stamp_ns, 77);
            assert_eq!(stamp(protobuf(POINT_CLOUD, &raw)), Ok(77));
        }
    }

    #[test]
    fn a_marker_that_was_not_seen_is_lost_and_not_at_zero() {
        let nan = f64::NAN;
        let cases = [
            (0.0, 0.5, "an all-zero quaternion"),
            (nan, 0.5, "a quaternion that is not finite"),
            (1.0, nan, "a position that is not finite"),
            // What an NDI tracker writes for a missing marker.
            (1.0, -3.697314e28, "a position 3.7e28 m away"),
        ];
        for (w, x, reason) in cases {
            let transform = FrameTransform {
                timestamp: Some(Timestamp::new(1, 0)),
                parent_frame_id: "world".into(),
                child_frame_id: "bone_marker".into(),
                translation: Some(FoxgloveVector3 { x, y: 0.0, z: 0.0 }),
                rotation: Some(FoxgloveQuaternion { x: 0.0, y: 0.0, z: 0.0, w }),
            };
            let lost = read_transforms(protobuf(FRAME_TRANSFORM, &transform)).unwrap().remove(0).unwrap_err();
            assert_eq!((lost.stamp_ns, lost.reason.as_str()), (1_000_000_000, reason));
            assert!(lost.to_string().starts_with("marker lost: t_world_bone_marker at 1000000000 ns"));
        }
    }

    #[test]
    fn json_is_read_as_writers_spell_it() {
        let spelt = [
            r#"{"timestamp":{"sec":1750000001,"nsec":5},"parent_frame_id":"world","child_frame_id":"m",
                "translation":{"x":1,"y":0.5,"z":0},"rotation":{"x":0,"y":0,"z":0,"w":1}}"#,
            r#"{"timestamp":"2025-06-15T15:06:41.000000005Z","parentFrameId":"world","childFrameId":"m",
                "translation":{"x":1.0,"y":5e-1},"rotation":{"w":"1"}}"#,
            r#"{"timestamp":"2025-06-15T17:06:41.000000005+02:00","parentFrameId":"world","childFrameId":"m",
                "translation":{"x":1.0,"y":0.5},"rotation":{"w":1.0}}"#,
            r#"{"timestamp":{"seconds":"1750000001","nanos":5},"parent_frame_id":"world","child_frame_id":"m","more":NaN,
                "translation":{"x":1,"y":0.5,"z":0},"rotation":{"x":0,"y":0,"z":0,"w":1}}"#,
        ];
        for text in spelt {
            let pose = read_transforms(message(FRAME_TRANSFORM, "json", text)).unwrap().remove(0).unwrap();
            let expected =
                Pose::new("world", "m", Isometry3::translation(1000.0, 500.0, 0.0)).at(1_750_000_001_000_000_005);
            assert_eq!(pose, expected, "{text}");
            assert_eq!(stamp(message(FRAME_TRANSFORM, "json", text)), Ok(expected.stamp_ns));
        }
        let lost = r#"{"parent_frame_id":"w\"NaN","child_frame_id":"m","translation":{"x":NaN,"y":null,"z":-Infinity},
            "rotation":{"x":"NaN","y":0,"z":0,"w":1}}"#;
        let lost = read_transforms(message(FRAME_TRANSFORM, "json", lost)).unwrap().remove(0).unwrap_err();
        assert_eq!((lost.stamp_ns, lost.to.as_str()), (77, "w\"NaN"), "a text that says NaN stays a text");
    }

    #[test]
    fn a_json_cloud_is_read_with_types_by_name_and_base64_of_either_alphabet() {
        // 0.5, -1, 2 in single precision; the second spelling has no padding and the alphabet for URLs.
        for data in ["AAAAPwAAgL8AAABA", " AAAAPwAAgL8AAABA\n"] {
            let text = format!(
                r#"{{"frameId":"camera","pointStride":12,"data":{data:?},"pose":{{"orientation":{{"w":1}}}},
                "fields":[{{"name":"x","type":"FLOAT32"}},{{"name":"y","offset":4,"type":7}},{{"name":"z","offset":8,"type":"FLOAT32"}}]}}"#
            );
            let read = read_cloud(message(POINT_CLOUD, "json", text)).unwrap();
            assert_eq!(read.cloud.points(), [Point3::new(500.0, -1000.0, 2000.0)]);
        }
        let data =
            [1.5_f32, f32::from_bits(0xFBFF_BFBF), 0.25].iter().flat_map(|c| c.to_le_bytes()).collect::<Vec<_>>();
        for engine in [base64::prelude::BASE64_URL_SAFE_NO_PAD, base64::prelude::BASE64_STANDARD_NO_PAD] {
            use base64::Engine;
            let mut bytes = data.clone();
            bytes.push(0xFF);
            let text = format!(
                r#"{{"point_stride":13,"data":"{}","fields":[{{"name":"x","type":7}},{{"name":"y","offset":4,"type":7}},
                {{"name":"z","offset":8,"type":7}}]}}"#,
                engine.encode(&bytes)
            );
            let read = read_cloud(message(POINT_CLOUD, "json", text)).unwrap();
            assert_eq!(read.cloud.points()[0].z, 250.0);
        }
        let bad = r#"{"point_stride":12,"data":"A*","fields":[]}"#;
        let error = read_cloud(message(POINT_CLOUD, "json", bad)).unwrap_err().to_string();
        assert!(error.starts_with("the message is no foxglove.PointCloud: data is no base64"), "{error}");
    }

    #[test]
    fn a_tip_may_lack_its_turn_but_not_its_place() {
        let tip = |pose| PoseInFrame { timestamp: None, frame_id: "world".into(), pose };
        let position = Some(FoxgloveVector3 { x: 0.001, y: 0.0, z: 0.0 });
        let read = |t: &PoseInFrame| read_pose_in_frame(protobuf(POSE_IN_FRAME, t));
        let found = read(&tip(Some(FoxglovePose { position, orientation: None }))).unwrap();
        assert_eq!((found.position, found.orientation, found.stamp_ns), (Point3::new(1.0, 0.0, 0.0), None, 77));
        assert!(read(&tip(None)).unwrap_err().to_string().contains("no pose"));
    }

    #[test]
    fn another_schema_or_encoding_is_told_by_name() {
        let said = read_cloud(message("sensor_msgs/msg/PointCloud2", "cdr", "")).unwrap_err().to_string();
        assert_eq!(said, "the message is written as \"cdr\", but only protobuf and json can be read");
        let said = read_transforms(message(POINT_CLOUD, "protobuf", "")).unwrap_err().to_string();
        assert!(said.contains("but the topic carries foxglove.PointCloud"), "{said}");
    }

    #[test]
    fn a_region_that_cannot_be_understood_is_an_error_and_not_ignored() {
        let recording = |min: &str, max: &str| {
            let keys = [("roi_camera_min_m", min), ("roi_camera_max_m", max)];
            let record = keys.into_iter().filter(|k| !k.1.is_empty()).map(|(k, v)| (k.to_owned(), v.to_owned()));
            let mut recording = Recording::default();
            recording.metadata.insert("procedure".into(), record.collect());
            recording
        };
        assert_eq!(procedure_region(&recording("", "")), Ok(None));
        for (min, max, said) in [
            ("0 0", "1 1 1", "\"0 0\" is not three numbers"),
            ("0 0 0", "1 1 1 1", "\"1 1 1 1\" is not three numbers"),
            ("0 0 nan", "1 1 1", "is not three numbers"),
            ("0 2 0", "1 1 1", "its y lies above that of roi_camera_max_m"),
            ("0 0 0", "", "key \"roi_camera_max_m\": it is missing"),
        ] {
            let error = procedure_region(&recording(min, max)).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
