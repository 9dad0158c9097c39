//! Recordings of Foxglove's messages or of ROS 2, in any of the layouts that recorders choose, for the tests of readers.
#![allow(dead_code, reason = "each program of tests uses some of the layouts")]

use base64::{Engine, engine::general_purpose::STANDARD};
use foxglove::{
    Encode,
    messages::{
        FrameTransform, FrameTransforms, PackedElementField, PointCloud, Pose as FoxglovePose, PoseInFrame,
        Quaternion as FoxgloveQuaternion, Timestamp, Vector3 as FoxgloveVector3, packed_element_field::NumericType,
    },
};
pub(crate) use osteoflow_container::Compression;
use osteoflow_container::{MessageHeader, WriteOptions, Writer};
use osteoflow_formats::{
    PoseError,
    mcap_read::{self, Attachment},
    message_read::{read_cloud_head, read_pose_in_frame, read_transforms},
    recording_write::Stream,
};
use osteoflow_geometry::{Cloud, MM_PER_M, Pose, StampNs, nalgebra::Isometry3};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The sensor time of a message; of several transforms, that of the first.
pub(crate) fn stamp(message: &mcap_read::Message) -> StampNs {
    if let Ok(head) = read_cloud_head(message) {
        return head.stamp_ns;
    }
    if let Ok(tip) = read_pose_in_frame(message) {
        return tip.stamp_ns;
    }
    match &read_transforms(message).unwrap()[0] {
        Ok(pose) => pose.value.stamp_ns,
        Err(PoseError::Lost(lost)) => lost.stamp_ns,
        Err(PoseError::NotRigid { stamp_ns, .. }) => *stamp_ns,
    }
}

/// How messages are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Encoding {
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
pub(crate) enum PointType {
    F32,
    F64,
}

/// In which order messages lie in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// By sensor time; log time follows it after [`Layout::log_delay_ns`].
    Sensor,
    /// Topic after topic, each by sensor time; log times are those of [`Order::Sensor`].
    Topic,
    /// Shuffled by this seed, also in log time: as if transport had delayed each message at will.
    Shuffled(u64),
}

/// The layout of a recording: what recorders do differently while saying the same.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layout {
    pub(crate) encoding: Encoding,
    /// How chunks are packed.
    pub(crate) compression: Compression,
    /// The size at which a chunk is closed, bytes; none writes messages without chunks.
    pub(crate) chunk_bytes: Option<usize>,
    /// Whether the file ends with an index and statistics.
    pub(crate) index: bool,
    pub(crate) order: Order,
    /// From sensor time, which is publish time, to log time, ns.
    pub(crate) log_delay_ns: u32,
    pub(crate) points: PointType,
    /// Whether points carry fields that nobody asked for: `intensity` (float32), `ring` (uint16), `tag` (int8).
    pub(crate) extra_fields: bool,
    /// Whether the fields are written last to first.
    pub(crate) shuffled_fields: bool,
    /// Bytes between points that belong to no field.
    pub(crate) padding_bytes: u32,
    /// Puts a point without depth (NaN) in front of every `nan_every` points; 0 for none.
    pub(crate) nan_every: usize,
    /// The message's `pose`: points are written relative to it, so that a reader which applies it gets them back.
    pub(crate) pose: Option<Isometry3<f64>>,
    /// 1 writes each pose as a `FrameTransform`, more writes that number into each `FrameTransforms`.
    pub(crate) transforms_per_message: usize,
    /// Topics whose messages have no timestamp of their own.
    pub(crate) unstamped: Vec<String>,
}

impl Default for Layout {
    /// That of `recording_write`.
    fn default() -> Self {
        Self {
            encoding: Encoding::Protobuf,
            compression: Compression::Zstd,
            chunk_bytes: Some(WriteOptions::default().chunk_bytes),
            index: true,
            order: Order::Sensor,
            log_delay_ns: 1_500_000,
            points: PointType::F32,
            extra_fields: false,
            shuffled_fields: false,
            padding_bytes: 0,
            nan_every: 0,
            pose: None,
            transforms_per_message: 1,
            unstamped: Vec::new(),
        }
    }
}

/// A message on its way into the file.
struct Message {
    topic: String,
    schema: foxglove::Schema,
    stamp_ns: StampNs,
    log_time_ns: StampNs,
    data: Vec<u8>,
}

/// Streams as a recording in a layout, with metadata records and attachments.
pub(crate) fn recording_bytes<T: AsRef<str>>(
    streams: &[(T, Stream)],
    metadata: &BTreeMap<String, BTreeMap<String, String>>,
    attachments: &[Attachment],
    layout: &Layout,
) -> Vec<u8> {
    let mut messages = layout.messages(streams);
    match layout.order {
        Order::Topic => {}
        Order::Sensor => messages.sort_by_key(|m| m.stamp_ns),
        Order::Shuffled(seed) => shuffle(&mut messages, seed),
    }
    let defaults = WriteOptions::default();
    let options = WriteOptions {
        library: "osteoflow".into(),
        compression: layout.compression,
        chunk_bytes: layout.chunk_bytes.unwrap_or(defaults.chunk_bytes),
        chunks: layout.chunk_bytes.is_some(),
        index: layout.index,
        ..defaults
    };
    let mut writer = Writer::new(Vec::new(), options).unwrap();
    for (name, values) in metadata {
        writer.write_metadata(name, values).unwrap();
    }
    let mut channels = BTreeMap::<String, (u16, u32)>::new();
    for message in messages {
        let (channel_id, n_before) = channels.entry(message.topic.clone()).or_insert_with(|| {
            let schema = message.schema;
            let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data).unwrap();
            let encoding = layout.encoding.name();
            (writer.add_channel(schema, &message.topic, encoding, &BTreeMap::new()).unwrap(), 0)
        });
        let (log_time, publish_time) = (message.log_time_ns as u64, message.stamp_ns as u64);
        let header = MessageHeader { channel_id: *channel_id, sequence: *n_before, log_time, publish_time };
        *n_before += 1;
        writer.write_message(header, message.data.into()).unwrap();
    }
    for Attachment { name, media_type, data } in attachments {
        let attachment = osteoflow_container::Attachment { log_time: 0, create_time: 0, name, media_type, data };
        writer.write_attachment(&attachment).unwrap();
    }
    writer.finish().unwrap()
}

/// Shuffles messages and gives them log times that rise in their new order.
fn shuffle(messages: &mut [Message], seed: u64) {
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

impl Encoding {
    fn name(self) -> &'static str {
        match self {
            Self::Protobuf => "protobuf",
            Self::Json => "json",
            Self::Cdr { .. } => "cdr",
        }
    }

    /// A message, with its name and value in ROS 2.
    fn message<M: Encode, R: serde::Serialize>(
        self,
        message: &M,
        to_json: impl Fn(&M) -> Value,
        ros_name: &str,
        to_ros: impl Fn(&M) -> R,
    ) -> (foxglove::Schema, Vec<u8>) {
        let schema = M::get_schema().unwrap();
        match self {
            Self::Protobuf => {
                let mut data = Vec::new();
                message.encode(&mut data).unwrap();
                (schema, data)
            }
            Self::Json => {
                let data = serde_json::to_vec(&to_json(message)).unwrap();
                (foxglove::Schema::new(schema.name, "jsonschema", &b"{}"[..]), data)
            }
            Self::Cdr { big_endian } => {
                let message = to_ros(message);
                let body = match big_endian {
                    true => re_cdr::to_vec::<R, re_cdr::BigEndian>(&message),
                    false => re_cdr::to_vec::<R, re_cdr::LittleEndian>(&message),
                };
                let data = [&[0, u8::from(!big_endian), 0, 0][..], &body.unwrap()].concat();
                (foxglove::Schema::new(ros_name.to_owned(), "ros2msg", &b"the definition is not read"[..]), data)
            }
        }
    }
}

impl Layout {
    /// All messages, topic after topic.
    fn messages<T: AsRef<str>>(&self, streams: &[(T, Stream)]) -> Vec<Message> {
        let stamps = streams.iter().flat_map(|(_, stream)| match stream {
            Stream::Clouds(clouds) => clouds.iter().map(|c| c.stamp_ns).collect::<Vec<_>>(),
            Stream::Transforms(poses) => poses.iter().map(|p| p.stamp_ns).collect(),
            Stream::Tips(tips) => tips.iter().map(|t| t.1).collect(),
        });
        let first = stamps.filter(|&s| s != 0).min().unwrap_or(1);
        let time = |stamp_ns: StampNs| {
            let stamp_ns = if stamp_ns == 0 { first } else { stamp_ns };
            Timestamp::new((stamp_ns / 1_000_000_000) as u32, (stamp_ns % 1_000_000_000) as u32)
        };
        let mut messages = Vec::new();
        for (topic, stream) in streams {
            let is_stamped = !self.unstamped.iter().any(|of| of == topic.as_ref());
            let own = |time: Timestamp| is_stamped.then_some(time);
            let mut push = |time: Timestamp, (schema, data): (foxglove::Schema, Vec<u8>)| {
                let stamp_ns = StampNs::from(time.sec()) * 1_000_000_000 + StampNs::from(time.nsec());
                let log_time_ns = stamp_ns + StampNs::from(self.log_delay_ns);
                messages.push(Message { topic: topic.as_ref().into(), schema, stamp_ns, log_time_ns, data });
            };
            match stream {
                Stream::Clouds(clouds) => {
                    for cloud in clouds {
                        let time = time(cloud.stamp_ns);
                        let cloud = self.cloud(cloud, own(time));
                        let big_endian = self.encoding == Encoding::Cdr { big_endian: true };
                        let to_ros = |cloud: &PointCloud| ros_cloud(cloud, big_endian);
                        let ros_name = "sensor_msgs/msg/PointCloud2";
                        push(time, self.encoding.message(&cloud, cloud_json, ros_name, to_ros));
                    }
                }
                Stream::Transforms(poses) => {
                    let transforms: Vec<_> = poses.iter().map(|p| transform(p, time(p.stamp_ns))).collect();
                    for batch in transforms.chunks(self.transforms_per_message.max(1)) {
                        let time = batch[0].timestamp.unwrap();
                        let batch: Vec<_> = batch
                            .iter()
                            .cloned()
                            .map(|transform| FrameTransform {
                                timestamp: transform.timestamp.and_then(own),
                                ..transform
                            })
                            .collect();
                        if self.transforms_per_message <= 1 {
                            let ros_name = "geometry_msgs/msg/TransformStamped";
                            push(time, self.encoding.message(&batch[0], transform_json, ros_name, ros_transform));
                        } else {
                            let batch = FrameTransforms { transforms: batch };
                            let to_json = |batch: &FrameTransforms| json!({ "transforms": batch.transforms.iter().map(transform_json).collect::<Value>() });
                            let to_ros = |batch: &FrameTransforms| {
                                batch.transforms.iter().map(ros_transform).collect::<Vec<_>>()
                            };
                            push(time, self.encoding.message(&batch, to_json, "tf2_msgs/msg/TFMessage", to_ros));
                        }
                    }
                }
                Stream::Tips(tips) => {
                    for (frame, stamp_ns, position) in tips {
                        let time = time(*stamp_ns);
                        let pose = pose_message(&Isometry3::translation(position.x, position.y, position.z));
                        let tip = PoseInFrame { timestamp: own(time), frame_id: frame.to_string(), pose: Some(pose) };
                        let to_json = |tip: &PoseInFrame| {
                            json!({ "timestamp": time_json(tip.timestamp), "frame_id": tip.frame_id,
                                    "pose": tip.pose.as_ref().map(pose_json) })
                        };
                        let to_ros = |tip: &PoseInFrame| {
                            let FoxglovePose { position, orientation } = tip.pose.unwrap();
                            let header = ros_header(tip.timestamp, &tip.frame_id);
                            (header, xyz(&position.unwrap()), xyzw(&orientation.unwrap()))
                        };
                        push(time, self.encoding.message(&tip, to_json, "geometry_msgs/msg/PoseStamped", to_ros));
                    }
                }
            }
        }
        messages
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

    fn cloud(&self, cloud: &Cloud, time: Option<Timestamp>) -> PointCloud {
        let (fields, stride) = self.fields(cloud.normals().is_some());
        let pose = self.pose.filter(|_| !matches!(self.encoding, Encoding::Cdr { .. }));
        let big_endian = self.encoding == Encoding::Cdr { big_endian: true };
        let to_message = pose.map(|pose| pose.inverse());
        let mut data: Vec<u8> = Vec::new();
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
            timestamp: time,
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

fn time_json(time: Option<Timestamp>) -> Value {
    time.map_or(Value::Null, |t| json!({"sec": t.sec(), "nsec": t.nsec()}))
}

fn vector_json(v: &FoxgloveVector3) -> Value {
    json!({"x": v.x, "y": v.y, "z": v.z})
}

fn quaternion_json(q: &FoxgloveQuaternion) -> Value {
    json!({"x": q.x, "y": q.y, "z": q.z, "w": q.w})
}

fn pose_json(pose: &FoxglovePose) -> Value {
    json!({"position": pose.position.as_ref().map(vector_json), "orientation": pose.orientation.as_ref().map(quaternion_json)})
}

fn transform_json(t: &FrameTransform) -> Value {
    json!({
        "timestamp": time_json(t.timestamp),
        "parent_frame_id": t.parent_frame_id,
        "child_frame_id": t.child_frame_id,
        "translation": t.translation.as_ref().map(vector_json),
        "rotation": t.rotation.as_ref().map(quaternion_json),
    })
}

fn cloud_json(cloud: &PointCloud) -> Value {
    let fields = cloud.fields.iter().map(|f| json!({"name": f.name, "offset": f.offset, "type": f.r#type}));
    json!({
        "timestamp": time_json(cloud.timestamp),
        "frame_id": cloud.frame_id,
        "pose": cloud.pose.as_ref().map(pose_json),
        "point_stride": cloud.point_stride,
        "fields": fields.collect::<Vec<_>>(),
        "data": STANDARD.encode(&cloud.data),
    })
}

// The messages of ROS 2 are their fields in order, as CDR lays them out.

type Xyz = (f64, f64, f64);
type Xyzw = (f64, f64, f64, f64);
type RosHeader = ((i32, u32), String);

fn xyz(v: &FoxgloveVector3) -> Xyz {
    (v.x, v.y, v.z)
}

fn xyzw(q: &FoxgloveQuaternion) -> Xyzw {
    (q.x, q.y, q.z, q.w)
}

fn ros_header(time: Option<Timestamp>, frame_id: &str) -> RosHeader {
    // ROS has no message without a stamp, but stamps of 0.
    (time.map_or((0, 0), |time| (time.sec() as i32, time.nsec())), frame_id.to_owned())
}

fn ros_transform(t: &FrameTransform) -> impl serde::Serialize + use<> {
    let header = ros_header(t.timestamp, &t.parent_frame_id);
    (header, t.child_frame_id.clone(), xyz(&t.translation.unwrap()), xyzw(&t.rotation.unwrap()))
}

/// `sensor_msgs/msg/PointCloud2`: header, height, width, fields, is_bigendian, point_step, row_step, data, is_dense.
fn ros_cloud(cloud: &PointCloud, big_endian: bool) -> impl serde::Serialize + use<> {
    let datatype = |kind: i32| match NumericType::try_from(kind).unwrap() {
        NumericType::Int8 => 1_u8,
        NumericType::Uint16 => 4,
        NumericType::Float32 => 7,
        NumericType::Float64 => 8,
        other => panic!("no layout has points of {other:?}"),
    };
    let fields: Vec<_> = cloud.fields.iter().map(|f| (f.name.clone(), f.offset, datatype(f.r#type), 1_u32)).collect();
    let n_bytes = cloud.data.len() as u32;
    (
        ros_header(cloud.timestamp, &cloud.frame_id),
        1_u32,
        n_bytes / cloud.point_stride.max(1),
        fields,
        big_endian,
        cloud.point_stride,
        n_bytes,
        cloud.data.to_vec(),
        false,
    )
}
