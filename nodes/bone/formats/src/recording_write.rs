//! Procedures as recordings of Foxglove's messages, as the common recorders write them: protobuf in zstd chunks with an index.
//!
//! Millimetres become metres here. In single precision a coordinate of 200 mm keeps 0.00002 mm.

use crate::{FileError, LostPose, mcap_read::Attachment};
use foxglove::{
    Encode,
    messages::{
        FrameTransform, PackedElementField, PointCloud, Pose as FoxglovePose, PoseInFrame,
        Quaternion as FoxgloveQuaternion, Timestamp, Vector3 as FoxgloveVector3, packed_element_field::NumericType,
    },
};
use nalgebra::{Isometry3, Point3};
use osteoflow_container::{MessageHeader, WriteOptions, Writer};
use osteoflow_geometry::{Cloud, Frame, MM_PER_M, Pose, StampNs, time_column};
use std::{collections::BTreeMap, io};

/// From sensor time, which is publish time, to log time, ns: transport, so that log time cannot pass for sensor time.
const LOG_DELAY_NS: u64 = 1_500_000;

/// What a topic carries, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum Stream {
    /// Point clouds, as `foxglove.PointCloud`.
    Clouds(Vec<Cloud>),
    /// Poses, as `foxglove.FrameTransform`.
    Transforms(Vec<Pose>),
    /// Located points with the frame they lie in, mm, as `foxglove.PoseInFrame` without a turn.
    Tips(Vec<(Frame, StampNs, Point3<f64>)>),
}

impl Stream {
    fn stamps(&self) -> Vec<StampNs> {
        match self {
            Self::Clouds(clouds) => clouds.iter().map(|cloud| cloud.stamp_ns).collect(),
            Self::Transforms(poses) => poses.iter().map(|pose| pose.stamp_ns).collect(),
            Self::Tips(tips) => tips.iter().map(|tip| tip.1).collect(),
        }
    }
}

/// Topics with their streams, metadata records and attachments as one recording, by sensor time.
///
/// A stamp of 0 (a constant such as a CAD pose) is written as the recording's first stamp, since viewers cannot show time
/// zero.
///
/// # Errors
/// [`FileError`] if a stamp is negative or beyond the year 2106.
pub fn recording_bytes<T: AsRef<str>>(
    streams: &[(T, Stream)],
    metadata: &BTreeMap<String, BTreeMap<String, String>>,
    attachments: &[Attachment],
) -> Result<Vec<u8>, FileError> {
    let first = streams.iter().flat_map(|(_, stream)| stream.stamps()).filter(|&stamp| stamp != 0).min().unwrap_or(1);
    let mut messages = Vec::new();
    for (topic, stream) in streams {
        let topic = topic.as_ref();
        match stream {
            Stream::Clouds(clouds) => {
                for cloud in clouds {
                    let time = time(cloud.stamp_ns, first)?;
                    messages.push(Message::new(topic, time, &cloud_message(cloud, time)));
                }
            }
            Stream::Transforms(poses) => {
                for pose in poses {
                    let time = time(pose.stamp_ns, first)?;
                    messages.push(Message::new(topic, time, &transform_message(pose, time)));
                }
            }
            Stream::Tips(tips) => {
                for (frame, stamp_ns, position) in tips {
                    let time = time(*stamp_ns, first)?;
                    let pose = pose_message(&Isometry3::translation(position.x, position.y, position.z));
                    let tip = PoseInFrame { timestamp: Some(time), frame_id: frame.to_string(), pose: Some(pose) };
                    messages.push(Message::new(topic, time, &tip));
                }
            }
        }
    }
    // Stable: equal stamps keep the order of the topics.
    messages.sort_by_key(|message| message.stamp_ns);
    write(messages, metadata, attachments).map_err(FileError::write(MEMORY.as_ref()))
}

/// The poses of a log on one topic, each as `foxglove.FrameTransform`; where a tool was not seen, its numbers are NaN, which no reader
/// takes for a pose.
///
/// # Errors
/// As [`recording_bytes`].
pub fn log_bytes(
    topic: &str,
    poses: &[Result<Pose, LostPose>],
    metadata: &BTreeMap<String, BTreeMap<String, String>>,
) -> Result<Vec<u8>, FileError> {
    let stamps = poses.iter().map(|pose| pose.as_ref().map_or_else(|lost| lost.stamp_ns, |pose| pose.stamp_ns));
    let first = stamps.filter(|stamp| *stamp != 0).min().unwrap_or(1);
    let mut messages = Vec::new();
    for pose in poses {
        let message = match pose {
            Ok(pose) => transform_message(pose, time(pose.stamp_ns, first)?),
            Err(LostPose { to, from, stamp_ns, .. }) => FrameTransform {
                timestamp: Some(time(*stamp_ns, first)?),
                parent_frame_id: to.to_string(),
                child_frame_id: from.to_string(),
                translation: Some(FoxgloveVector3 { x: f64::NAN, y: f64::NAN, z: f64::NAN }),
                rotation: Some(FoxgloveQuaternion { x: f64::NAN, y: f64::NAN, z: f64::NAN, w: f64::NAN }),
            },
        };
        messages.push(Message::new(topic, message.timestamp.unwrap_or(Timestamp::new(0, 0)), &message));
    }
    messages.sort_by_key(|message| message.stamp_ns);
    write(messages, metadata, &[]).map_err(FileError::write(MEMORY.as_ref()))
}

/// What stands for the file in errors.
const MEMORY: &str = "recording in memory";

/// A message on its way into the file.
struct Message<'a> {
    topic: &'a str,
    schema: foxglove::Schema,
    stamp_ns: u64,
    data: Vec<u8>,
}

impl<'a> Message<'a> {
    fn new<M: Encode>(topic: &'a str, time: Timestamp, message: &M) -> Self {
        let mut data = Vec::with_capacity(message.encoded_len().unwrap_or(0));
        message.encode(&mut data).expect("memory takes any message");
        let schema = M::get_schema().expect("Foxglove's messages have their schema");
        Self { topic, schema, stamp_ns: u64::from(time.sec()) * 1_000_000_000 + u64::from(time.nsec()), data }
    }
}

fn time(stamp_ns: StampNs, first: StampNs) -> Result<Timestamp, FileError> {
    let stamp_ns = if stamp_ns == 0 { first } else { stamp_ns };
    let seconds = u32::try_from(stamp_ns.div_euclid(1_000_000_000)).map_err(|_| {
        let message = format!("stamp {stamp_ns} ns is outside 1970 to 2106, which Foxglove messages can hold");
        FileError::content(MEMORY.as_ref(), "recording", message)
    })?;
    Ok(Timestamp::new(seconds, stamp_ns.rem_euclid(1_000_000_000) as u32))
}

fn write(
    messages: Vec<Message>,
    metadata: &BTreeMap<String, BTreeMap<String, String>>,
    attachments: &[Attachment],
) -> io::Result<Vec<u8>> {
    let mut writer = Writer::new(Vec::new(), WriteOptions { library: "osteoflow".into(), ..WriteOptions::default() })?;
    for (name, values) in metadata {
        writer.write_metadata(name, values)?;
    }
    // The channel of a topic and the number of its messages so far.
    let mut channels = BTreeMap::<&str, (u16, u32)>::new();
    for Message { topic, schema, stamp_ns, data } in messages {
        let (channel_id, sequence) = match channels.get(topic) {
            Some(channel) => *channel,
            None => {
                let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data)?;
                (writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())?, 0)
            }
        };
        channels.insert(topic, (channel_id, sequence + 1));
        let (log_time, publish_time) = (stamp_ns + LOG_DELAY_NS, stamp_ns);
        writer.write_message(MessageHeader { channel_id, sequence, log_time, publish_time }, data.into())?;
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

/// The points, and the normals if there are any, in single precision; the times of points, if there are any, in double precision.
fn cloud_message(cloud: &Cloud, time: Timestamp) -> PointCloud {
    let names = ["x", "y", "z", "normal_x", "normal_y", "normal_z"];
    let names = if cloud.normals().is_some() { &names[..] } else { &names[..3] };
    let fields = names.iter().zip((0..).step_by(4)).map(|(name, offset)| PackedElementField {
        name: (*name).into(),
        offset,
        r#type: NumericType::Float32.into(),
    });
    let time_field = cloud.extras().iter().find(|(name, _)| time_column(name).is_some());
    let field_of_time = time_field.map(|(name, _)| PackedElementField {
        name: name.to_string(),
        offset: 4 * names.len() as u32,
        r#type: NumericType::Float64.into(),
    });
    let stride = 4 * names.len() + 8 * usize::from(time_field.is_some());
    let mut data = Vec::with_capacity(cloud.len() * stride);
    for (index, point) in cloud.points().iter().enumerate() {
        let normal = cloud.normals().map(|normals| normals[index]);
        let point = point / MM_PER_M;
        for value in point.iter().chain(normal.iter().flatten()) {
            data.extend((*value as f32).to_le_bytes());
        }
        data.extend(time_field.into_iter().flat_map(|(_, times)| times[index].to_le_bytes()));
    }
    PointCloud {
        timestamp: Some(time),
        frame_id: cloud.frame.to_string(),
        pose: Some(pose_message(&Isometry3::identity())),
        point_stride: stride as u32,
        fields: fields.chain(field_of_time).collect(),
        data: data.into(),
    }
}

fn transform_message(pose: &Pose, time: Timestamp) -> FrameTransform {
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
