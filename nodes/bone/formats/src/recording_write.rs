//! Procedures as recordings of Foxglove's messages or of ROS 2, in any of the layouts that recorders choose.
//!
//! ```no_run
//! use nalgebra::Point3;
//! use osteoflow_formats::recording_write::{Layout, Stream, write_recording};
//! use osteoflow_geometry::Cloud;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scan = Cloud::new("camera", vec![Point3::new(0.0, 0.0, 200.0)])?.at(1_750_000_011_000_000_000);
//! let streams = [("/camera/scan", Stream::Clouds(vec![scan]))];
//! write_recording("procedure.mcap".as_ref(), &streams, &Default::default(), &[], &Layout::default())?;
//! # Ok(())
//! # }
//! ```
//!
//! Millimetres become metres here. In single precision a coordinate of 200 mm keeps 0.00002 mm.

mod cdr;
mod json;

use crate::{
    FileError,
    mcap_read::Attachment,
    message_read::{FRAME_TRANSFORM, FRAME_TRANSFORMS, POINT_CLOUD, POSE_IN_FRAME},
};
use foxglove::{
    Encode,
    messages::{
        FrameTransform, FrameTransforms, PackedElementField, PointCloud, Pose as FoxglovePose, PoseInFrame,
        Quaternion as FoxgloveQuaternion, Timestamp, Vector3 as FoxgloveVector3, packed_element_field::NumericType,
    },
};
use json::{cloud_json, json_schema, pose_json, time_json, transform_json};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};
pub use osteoflow_container::Compression;
use osteoflow_container::{MessageHeader, Sink, WriteOptions, Writer};
use osteoflow_geometry::{Cloud, Frame, MM_PER_M, Pose, StampNs};
use serde_json::{Value, json};
use std::{collections::BTreeMap, io, path::Path};

/// What a topic carries, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum Stream {
    /// Point clouds, as `foxglove.PointCloud`.
    Clouds(Vec<Cloud>),
    /// Poses, as `foxglove.FrameTransform` or `foxglove.FrameTransforms`.
    Transforms(Vec<Pose>),
    /// Located points with the frame they lie in, mm, as `foxglove.PoseInFrame` without a turn.
    Tips(Vec<(Frame, StampNs, Point3<f64>)>),
}

/// How messages are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Binary, the usual one.
    Protobuf,
    /// Text, with the points in base64.
    Json,
    /// The messages of ROS 2: `PointCloud2`, `TransformStamped` or `TFMessage`, `PoseStamped`. A cloud has no `pose` there.
    Cdr {
        /// Whether messages and points have the most significant byte first.
        big_endian: bool,
    },
}

/// The numeric type of coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointType {
    /// Single precision, the usual one.
    F32,
    /// Double precision.
    F64,
}

/// In which order messages lie in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// By sensor time; log time follows it after [`Layout::log_delay_ns`].
    Sensor,
    /// Topic after topic, each by sensor time; log times are those of [`Order::Sensor`].
    Topic,
    /// Shuffled by this seed, also in log time: as if transport had delayed each message at will.
    Shuffled(u64),
}

/// The layout of a recording: what recorders do differently while saying the same.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// How messages are written.
    pub encoding: Encoding,
    /// How chunks are packed.
    pub compression: Compression,
    /// The size at which a chunk is closed, bytes; none writes messages without chunks.
    pub chunk_bytes: Option<usize>,
    /// Whether the file ends with an index and statistics.
    pub index: bool,
    /// In which order messages lie in the file.
    pub order: Order,
    /// From sensor time, which is publish time, to log time, ns.
    pub log_delay_ns: u32,
    /// The numeric type of coordinates.
    pub points: PointType,
    /// Whether points carry fields that nobody asked for: `intensity` (float32), `ring` (uint16), `tag` (int8).
    pub extra_fields: bool,
    /// Whether the fields are written last to first.
    pub shuffled_fields: bool,
    /// Bytes between points that belong to no field.
    pub padding_bytes: u32,
    /// Puts a point without depth (NaN) in front of every so many points; 0 for none.
    pub nan_every: usize,
    /// The message's `pose`: points are written relative to it, so that a reader which applies it gets them back.
    pub pose: Option<Isometry3<f64>>,
    /// 1 writes each pose as a `FrameTransform`, more writes so many into each `FrameTransforms`.
    pub transforms_per_message: usize,
}

impl Default for Layout {
    /// What the common recorders write: protobuf, zstd chunks with an index, `float32` x, y, z, no `pose`.
    fn default() -> Self {
        Self {
            encoding: Encoding::Protobuf,
            compression: Compression::Zstd,
            chunk_bytes: Some(WriteOptions::default().chunk_bytes),
            index: true,
            order: Order::Sensor,
            // A millisecond and a half of transport, so that log time cannot pass for sensor time.
            log_delay_ns: 1_500_000,
            points: PointType::F32,
            extra_fields: false,
            shuffled_fields: false,
            padding_bytes: 0,
            nan_every: 0,
            pose: None,
            transforms_per_message: 1,
        }
    }
}

/// Writes topics with their streams, metadata records and attachments as one recording.
///
/// A stamp of 0 (a constant such as a CAD pose) is written as the recording's first stamp, since viewers cannot show time
/// zero.
///
/// # Errors
/// [`FileError`] if the file cannot be written, or a stamp is negative or beyond the year 2106.
pub fn write_recording<T: AsRef<str>>(
    path: &Path,
    streams: &[(T, Stream)],
    metadata: &BTreeMap<String, BTreeMap<String, String>>,
    attachments: &[Attachment],
    layout: &Layout,
) -> Result<(), FileError> {
    let messages = encoded(path, &by_topic(streams), layout)?;
    let file = std::fs::File::create(path).map_err(FileError::write(path))?;
    write(file, messages, metadata, attachments, layout).map(drop).map_err(FileError::write(path))
}

/// As [`write_recording`], into memory.
///
/// # Errors
/// As [`write_recording`].
pub fn recording_bytes<T: AsRef<str>>(
    streams: &[(T, Stream)],
    metadata: &BTreeMap<String, BTreeMap<String, String>>,
    attachments: &[Attachment],
    layout: &Layout,
) -> Result<Vec<u8>, FileError> {
    let path = Path::new("recording in memory");
    let messages = encoded(path, &by_topic(streams), layout)?;
    write(Vec::new(), messages, metadata, attachments, layout).map_err(FileError::write(path))
}

/// A message on its way into the file.
struct Encoded {
    topic: String,
    schema: foxglove::Schema,
    stamp_ns: StampNs,
    log_time_ns: StampNs,
    data: Vec<u8>,
}

fn by_topic<T: AsRef<str>>(streams: &[(T, Stream)]) -> Vec<(&str, &Stream)> {
    streams.iter().map(|(topic, stream)| (topic.as_ref(), stream)).collect()
}

/// All messages in the order in which they lie in the file.
fn encoded(path: &Path, streams: &[(&str, &Stream)], layout: &Layout) -> Result<Vec<Encoded>, FileError> {
    let stamps = streams.iter().flat_map(|(_, stream)| match stream {
        Stream::Clouds(clouds) => clouds.iter().map(|c| c.stamp_ns).collect::<Vec<_>>(),
        Stream::Transforms(poses) => poses.iter().map(|p| p.stamp_ns).collect(),
        Stream::Tips(tips) => tips.iter().map(|t| t.1).collect(),
    });
    let first = stamps.filter(|&s| s != 0).min().unwrap_or(1);
    let time = |stamp_ns: StampNs| -> Result<Timestamp, FileError> {
        let stamp_ns = if stamp_ns == 0 { first } else { stamp_ns };
        let seconds = u32::try_from(stamp_ns.div_euclid(1_000_000_000)).map_err(|_| {
            let message = format!("stamp {stamp_ns} ns is outside 1970 to 2106, which Foxglove messages can hold");
            FileError::content(path, "recording", message)
        })?;
        Ok(Timestamp::new(seconds, stamp_ns.rem_euclid(1_000_000_000) as u32))
    };
    let mut messages = Vec::new();
    for (topic, stream) in streams {
        let mut push = |time: Timestamp, (schema, data): (foxglove::Schema, Vec<u8>)| {
            let stamp_ns = StampNs::from(time.sec()) * 1_000_000_000 + StampNs::from(time.nsec());
            let log_time_ns = stamp_ns + StampNs::from(layout.log_delay_ns);
            messages.push(Encoded { topic: (*topic).into(), schema, stamp_ns, log_time_ns, data });
        };
        match stream {
            Stream::Clouds(clouds) => {
                for cloud in clouds {
                    let time = time(cloud.stamp_ns)?;
                    push(time, layout.message(POINT_CLOUD, &layout.cloud(cloud, time), cloud_json, cdr::cloud));
                }
            }
            Stream::Transforms(poses) => {
                let transforms = poses.iter().map(|p| Ok(transform(p, time(p.stamp_ns)?)));
                let transforms: Vec<FrameTransform> = transforms.collect::<Result<_, FileError>>()?;
                for batch in transforms.chunks(layout.transforms_per_message.max(1)) {
                    let time = batch[0].timestamp.expect("each transform has its time");
                    push(
                        time,
                        match batch {
                            [single] if layout.transforms_per_message <= 1 => {
                                layout.message(FRAME_TRANSFORM, single, transform_json, cdr::transform)
                            }
                            _ => {
                                let batch = FrameTransforms { transforms: batch.to_vec() };
                                let to_json = |batch: &FrameTransforms| json!({"transforms": batch.transforms.iter().map(transform_json).collect::<Vec<_>>()});
                                layout.message(FRAME_TRANSFORMS, &batch, to_json, cdr::transforms)
                            }
                        },
                    );
                }
            }
            Stream::Tips(tips) => {
                for (frame, stamp_ns, position) in tips {
                    let time = time(*stamp_ns)?;
                    let pose = Isometry3::from_parts(Translation3::from(position.coords), UnitQuaternion::identity());
                    let tip = PoseInFrame {
                        timestamp: Some(time),
                        frame_id: frame.to_string(),
                        pose: Some(pose_message(&pose)),
                    };
                    let to_json = |tip: &PoseInFrame| {
                        json!({"timestamp": time_json(tip.timestamp), "frame_id": tip.frame_id,
                               "pose": tip.pose.as_ref().map(pose_json)})
                    };
                    push(time, layout.message(POSE_IN_FRAME, &tip, to_json, cdr::pose));
                }
            }
        }
    }
    match layout.order {
        Order::Topic => {}
        Order::Sensor => messages.sort_by_key(|m| m.stamp_ns),
        Order::Shuffled(seed) => shuffle(&mut messages, seed),
    }
    Ok(messages)
}

/// Shuffles messages and gives them log times that rise in their new order.
fn shuffle(messages: &mut [Encoded], seed: u64) {
    let mut state = seed;
    for last in (1..messages.len()).rev() {
        // Knuth's 64-bit linear congruential generator; its high bits are good enough for an order.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        messages.swap(last, (state >> 33) as usize % (last + 1));
    }
    let latest = messages.iter().map(|m| m.log_time_ns).max().unwrap_or(0);
    for (k, message) in messages.iter_mut().enumerate() {
        message.log_time_ns = latest + k as StampNs;
    }
}

fn write<W: Sink>(
    sink: W,
    messages: Vec<Encoded>,
    metadata: &BTreeMap<String, BTreeMap<String, String>>,
    attachments: &[Attachment],
    layout: &Layout,
) -> io::Result<W> {
    let defaults = WriteOptions::default();
    let options = WriteOptions {
        library: "osteoflow".into(),
        compression: layout.compression,
        chunk_bytes: layout.chunk_bytes.unwrap_or(defaults.chunk_bytes),
        chunks: layout.chunk_bytes.is_some(),
        index: layout.index,
        ..defaults
    };
    let mut writer = Writer::new(sink, options)?;
    for (name, values) in metadata {
        writer.write_metadata(name, values)?;
    }
    let encoding = layout.encoding.name();
    let mut channels = BTreeMap::<String, (u16, u32)>::new();
    for message in messages {
        let (channel_id, sequence) = match channels.get_mut(&message.topic) {
            Some((id, sequence)) => {
                *sequence += 1;
                (*id, *sequence)
            }
            None => {
                let schema = writer.add_schema(&message.schema.name, &message.schema.encoding, &message.schema.data)?;
                let id = writer.add_channel(schema, &message.topic, encoding, &BTreeMap::new())?;
                channels.insert(message.topic.clone(), (id, 0));
                (id, 0)
            }
        };
        let (log_time, publish_time) = (message.log_time_ns as u64, message.stamp_ns as u64);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        writer.write_message(header, message.data.into())?;
    }
    for attachment in attachments {
        writer.write_attachment(&osteoflow_container::Attachment {
            log_time: 0,
            create_time: 0,
            name: &attachment.name,
            media_type: &attachment.media_type,
            data: &attachment.data,
        })?;
    }
    writer.finish()
}

impl Encoding {
    fn name(self) -> &'static str {
        match self {
            Self::Protobuf => "protobuf",
            Self::Json => "json",
            Self::Cdr { .. } => "cdr",
        }
    }
}

impl Layout {
    fn message<M: Encode>(
        &self,
        name: &str,
        message: &M,
        to_json: impl Fn(&M) -> Value,
        to_cdr: impl Fn(&M, bool) -> Vec<u8>,
    ) -> (foxglove::Schema, Vec<u8>) {
        match self.encoding {
            Encoding::Protobuf => {
                let mut data = Vec::with_capacity(message.encoded_len().unwrap_or(0));
                message.encode(&mut data).expect("memory takes any message");
                (M::get_schema().expect("Foxglove's messages have their schema"), data)
            }
            Encoding::Json => {
                let schema = serde_json::to_vec(&json_schema(name)).expect("a schema is JSON");
                let data = serde_json::to_vec(&to_json(message)).expect("a message is JSON");
                (foxglove::Schema::new(name, "jsonschema", schema), data)
            }
            Encoding::Cdr { big_endian } => (cdr::schema(name), to_cdr(message, big_endian)),
        }
    }

    /// The fields of a point with their offsets, in written order, and the stride.
    fn fields(&self, with_normals: bool) -> (Vec<(&'static str, NumericType, u32)>, u32) {
        let number = match self.points {
            PointType::F32 => NumericType::Float32,
            PointType::F64 => NumericType::Float64,
        };
        let mut fields = vec![("x", number), ("y", number), ("z", number)];
        if with_normals {
            fields.extend(["normal_x", "normal_y", "normal_z"].map(|name| (name, NumericType::Float32)));
        }
        if self.extra_fields {
            fields.insert(1, ("intensity", NumericType::Float32));
            fields.extend([("ring", NumericType::Uint16), ("tag", NumericType::Int8)]);
        }
        if self.shuffled_fields {
            fields.reverse();
        }
        let mut offset = 0;
        let mut placed = Vec::new();
        for (name, kind) in fields {
            placed.push((name, kind, offset));
            offset += match kind {
                NumericType::Float64 => 8,
                NumericType::Float32 => 4,
                NumericType::Uint16 => 2,
                _ => 1,
            };
        }
        (placed, offset + self.padding_bytes)
    }

    fn cloud(&self, cloud: &Cloud, time: Timestamp) -> PointCloud {
        let (fields, stride) = self.fields(cloud.normals().is_some());
        let pose = self.pose.filter(|_| !matches!(self.encoding, Encoding::Cdr { .. }));
        let big_endian = self.encoding == Encoding::Cdr { big_endian: true };
        let to_message = pose.map(|pose| pose.inverse());
        let mut data: Vec<u8> = Vec::with_capacity(cloud.len() * stride as usize);
        let mut push = |values: [f64; 6], index: usize| {
            let start = data.len();
            for (name, kind, _) in &fields {
                let value = match *name {
                    "x" => values[0],
                    "y" => values[1],
                    "z" => values[2],
                    "normal_x" => values[3],
                    "normal_y" => values[4],
                    "normal_z" => values[5],
                    "intensity" => index as f64 * 0.5,
                    _ => (index % 100) as f64,
                };
                let number = data.len();
                match kind {
                    NumericType::Float64 => data.extend(value.to_le_bytes()),
                    NumericType::Float32 => data.extend((value as f32).to_le_bytes()),
                    NumericType::Uint16 => data.extend((value as u16).to_le_bytes()),
                    _ => data.extend((value as i8).to_le_bytes()),
                }
                if big_endian {
                    data[number..].reverse();
                }
            }
            // What lies between points is anything but a number that could be taken for one.
            data.resize(start + stride as usize, 0xA5);
        };
        for (index, point) in cloud.points().iter().enumerate() {
            if self.nan_every > 0 && index.is_multiple_of(self.nan_every) {
                push([f64::NAN; 6], index);
            }
            let point = to_message.map_or(*point, |t| t * point) / MM_PER_M;
            let normal = cloud.normals().map_or_else(Default::default, |n| n[index]);
            let normal = to_message.map_or(normal, |t| t * normal);
            push([point.x, point.y, point.z, normal.x, normal.y, normal.z], index);
        }
        let field = |&(name, kind, offset): &(&str, NumericType, u32)| PackedElementField {
            name: name.into(),
            offset,
            r#type: kind.into(),
        };
        PointCloud {
            timestamp: Some(time),
            frame_id: cloud.frame.to_string(),
            pose: Some(pose_message(&pose.unwrap_or_default())),
            point_stride: stride,
            fields: fields.iter().map(field).collect(),
            data: data.into(),
        }
    }
}

fn transform(pose: &Pose, time: Timestamp) -> FrameTransform {
    let message = pose_message(&pose.isometry);
    FrameTransform {
        timestamp: Some(time),
        parent_frame_id: pose.to.to_string(),
        child_frame_id: pose.from.to_string(),
        translation: message.position,
        rotation: message.orientation,
    }
}

fn pose_message(pose: &Isometry3<f64>) -> FoxglovePose {
    let (t, q) = (pose.translation.vector / MM_PER_M, pose.rotation);
    FoxglovePose {
        position: Some(FoxgloveVector3 { x: t.x, y: t.y, z: t.z }),
        orientation: Some(FoxgloveQuaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}
