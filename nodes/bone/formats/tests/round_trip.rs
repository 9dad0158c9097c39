//! A recording gives the same procedure in every layout.

use crate::layouts::{Compression, Encoding, Layout, Order, PointType, recording_bytes, stamp};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_formats::{
    mcap_read::{Attachment, Message, Recording},
    message_read::{procedure_region, read_cloud, read_pose_in_frame, read_transforms},
    recording_write::{self, Stream},
};
use osteoflow_geometry::{Cloud, Pose, StampNs};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

const START_NS: StampNs = 1_750_000_000_000_000_000;

fn procedure(rng: &mut ChaCha8Rng) -> Vec<(&'static str, Stream)> {
    let mut number = |scale: f64| rng.random_range(-scale..scale);
    let mut cloud = |stamp_ns: StampNs, n: usize| {
        let points: Vec<_> = (0..n).map(|_| Point3::new(number(80.0), number(60.0), 210.0 + number(20.0))).collect();
        let normals: Vec<_> = (0..n).map(|_| Vector3::new(number(1.0), number(1.0), -1.0).normalize()).collect();
        Cloud::new("camera", points)
            .unwrap()
            .with_normals(normals)
            .unwrap()
            .at(stamp_ns)
            .seen_from(Isometry3::identity())
    };
    let clouds = vec![cloud(START_NS + 7, 90), cloud(START_NS + 900_000_000, 31), cloud(START_NS + 2_000_000_000, 0)];
    let pose = |k: StampNs| {
        let motion = Vector3::new(0.1, 0.2, 0.3) * k as f64;
        let t = Isometry3::new(Vector3::new(180.0, -100.0, 1070.0) + motion, motion);
        Pose::new("world", "camera_marker", t).at(START_NS + k * 50_000_000)
    };
    let tips = (0..4).map(|k| ("world".into(), START_NS + 13 * k, Point3::new(1.0 + k as f64, -2.5, 1200.0))).collect();
    vec![
        ("/camera/scan", Stream::Clouds(clouds)),
        ("/tracker/camera_marker", Stream::Transforms((0..10).map(pose).collect())),
        ("/stylus/init", Stream::Tips(tips)),
    ]
}

fn metadata() -> BTreeMap<String, BTreeMap<String, String>> {
    let roi = [("roi_camera_min_m", "-0.1 -0.2 0.05"), ("roi_camera_max_m", "0.1, 0.2, 0.5"), ("seed", "101")];
    [("procedure".into(), roi.map(|(k, v)| (k.to_owned(), v.to_owned())).into())].into()
}

fn any_layout(rng: &mut ChaCha8Rng) -> Layout {
    let pick = |rng: &mut ChaCha8Rng, n: usize| rng.random_range(0..n);
    Layout {
        encoding: [
            Encoding::Protobuf,
            Encoding::Json,
            Encoding::Cdr { big_endian: false },
            Encoding::Cdr { big_endian: true },
        ][pick(rng, 4)],
        compression: [Compression::None, Compression::Lz4, Compression::Zstd][pick(rng, 3)],
        chunk_bytes: [None, Some(300), Some(1 << 20)][pick(rng, 3)],
        index: pick(rng, 2) == 0,
        order: [Order::Sensor, Order::Topic, Order::Shuffled(9)][pick(rng, 3)],
        log_delay_ns: [0, 1_500_000][pick(rng, 2)],
        points: [PointType::F32, PointType::F64][pick(rng, 2)],
        extra_fields: pick(rng, 2) == 0,
        shuffled_fields: pick(rng, 2) == 0,
        padding_bytes: [0, 3, 16][pick(rng, 3)],
        nan_every: [0, 7][pick(rng, 2)],
        pose: [None, Some(Isometry3::new(Vector3::new(50.0, -120.0, 300.0), Vector3::new(0.4, -1.1, 0.7)))]
            [pick(rng, 2)],
        transforms_per_message: [1, 4][pick(rng, 2)],
        unstamped: Vec::new(),
    }
}

/// The messages of a topic sorted by sensor time, as recorders may write them in any order.
fn by_sensor_time<'a>(recording: &'a Recording, topic: &str) -> Vec<&'a Message> {
    let mut messages: Vec<&Message> = recording.messages(topic).iter().collect();
    messages.sort_by_key(|m| stamp(m));
    messages
}

fn check(streams: &[(&str, Stream)], layout: &Layout) {
    let plan = Attachment { name: "plan.json".into(), media_type: "application/json".into(), data: "{}".into() };
    let bytes = recording_bytes(streams, &metadata(), std::slice::from_ref(&plan), layout);
    let recording = Recording::from_bytes("round trip", &bytes, false).unwrap();
    assert_eq!(recording.notes, [""; 0], "{layout:?}");
    assert_eq!(recording.attachments, [plan]);
    assert_eq!(recording.metadata, metadata());
    let region = procedure_region(&recording).unwrap().unwrap();
    assert_eq!((region.min, region.max), (Point3::new(-100.0, -200.0, 50.0), Point3::new(100.0, 200.0, 500.0)));
    // Half an ulp of 0.5 m in single precision, rotated by the pose, is 0.00003 mm.
    let tolerance_mm = if layout.points == PointType::F32 { 1e-4 } else { 1e-9 };
    for (topic, stream) in streams {
        let messages = by_sensor_time(&recording, topic);
        match stream {
            Stream::Clouds(clouds) => {
                assert_eq!(messages.len(), clouds.len());
                for (message, cloud) in messages.into_iter().zip(clouds) {
                    let read = read_cloud(message).unwrap();
                    let n_nan = if layout.nan_every > 0 { cloud.len().div_ceil(layout.nan_every) } else { 0 };
                    assert_eq!((read.n_points_in_message, read.n_dropped), (cloud.len() + n_nan, n_nan), "{layout:?}");
                    assert_eq!((&read.cloud.frame, read.cloud.stamp_ns), (&cloud.frame, cloud.stamp_ns));
                    assert_eq!(read.cloud.len(), cloud.len());
                    for (k, (a, b)) in read.cloud.points().iter().zip(cloud.points()).enumerate() {
                        assert!((a - b).norm() < tolerance_mm, "point {k} is off by {} mm: {layout:?}", (a - b).norm());
                    }
                    let normals = read.cloud.normals().unwrap().iter().zip(cloud.normals().unwrap());
                    // Normals are always written in single precision.
                    assert!(normals.into_iter().all(|(a, b)| (a - b).norm() < 1e-6), "{layout:?}");
                    assert_eq!(read.cloud.viewpoint, Some(Isometry3::identity()), "{layout:?}");
                }
            }
            Stream::Transforms(poses) => {
                let read: Vec<Pose> =
                    messages.into_iter().flat_map(|m| read_transforms(m).unwrap()).map(|t| t.unwrap().value).collect();
                assert_eq!(read.len(), poses.len());
                for (a, b) in read.iter().zip(poses) {
                    assert_eq!((&a.to, &a.from, a.stamp_ns), (&b.to, &b.from, b.stamp_ns));
                    let off = a.isometry.inverse() * b.isometry;
                    assert!(off.translation.vector.norm() + off.rotation.angle() < 1e-9, "{layout:?}");
                }
            }
            Stream::Tips(tips) => {
                assert_eq!(messages.len(), tips.len());
                for (message, (frame, stamp_ns, position)) in messages.into_iter().zip(tips) {
                    let read = read_pose_in_frame(message).unwrap();
                    assert_eq!((&read.frame, read.stamp_ns), (frame, *stamp_ns));
                    assert!((read.position - position).norm() < 1e-9, "{layout:?}");
                }
            }
        }
    }
}

#[test]
fn every_layout_gives_the_same_procedure() {
    let mut rng = ChaCha8Rng::seed_from_u64(42);
    let streams = procedure(&mut rng);
    check(&streams, &Layout::default());
    for _ in 0..400 {
        check(&streams, &any_layout(&mut rng));
    }
}

#[test]
fn a_recording_is_written_in_the_usual_layout() {
    let streams = procedure(&mut ChaCha8Rng::seed_from_u64(42));
    let plan = Attachment { name: "plan.json".into(), media_type: "application/json".into(), data: "{}".into() };
    let written = recording_write::recording_bytes(&streams, &metadata(), std::slice::from_ref(&plan)).unwrap();
    assert!(written == recording_bytes(&streams, &metadata(), &[plan], &Layout::default()));
}

#[test]
fn topics_come_in_file_order_with_their_schemas_and_counts() {
    let streams = procedure(&mut ChaCha8Rng::seed_from_u64(1));
    let layout = Layout { order: Order::Topic, ..Layout::default() };
    let bytes = recording_bytes(&streams, &BTreeMap::new(), &[], &layout);
    let recording = Recording::from_bytes("topics", &bytes, false).unwrap();
    let told: Vec<_> = recording.topics().iter().map(|t| (&*t.name, &*t.schema_name, t.n_messages)).collect();
    assert_eq!(
        told,
        [
            ("/camera/scan", "foxglove.PointCloud", 3),
            ("/tracker/camera_marker", "foxglove.FrameTransform", 10),
            ("/stylus/init", "foxglove.PoseInFrame", 4)
        ]
    );
    assert!(recording.messages("/nothing").is_empty());
}

#[test]
fn topics_that_nobody_wants_are_counted_but_not_kept() {
    let streams = procedure(&mut ChaCha8Rng::seed_from_u64(1));
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), recording_write::recording_bytes(&streams, &BTreeMap::new(), &[]).unwrap()).unwrap();
    let recording = Recording::open_topics(file.path(), false, |topic| topic == "/stylus/init").unwrap();
    assert_eq!(recording.messages("/stylus/init").len(), 4);
    assert!(recording.messages("/camera/scan").is_empty());
    assert_eq!(recording.topics().iter().map(|t| t.n_messages).sum::<usize>(), 17);
}

#[test]
fn several_channels_may_share_a_topic() {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema("foxglove.PoseInFrame", "jsonschema", b"{}").unwrap();
    let other = writer.add_schema("foxglove.PointCloud", "jsonschema", b"{}").unwrap();
    let empty = BTreeMap::new();
    let sender = BTreeMap::from([("sender".to_owned(), "second".to_owned())]);
    let channels = [
        writer.add_channel(schema, "/stylus", "json", &empty).unwrap(),
        writer.add_channel(schema, "/stylus", "json", &sender).unwrap(),
        writer.add_channel(other, "/stylus", "json", &empty).unwrap(),
    ];
    for (k, channel) in [0, 1, 0, 2].into_iter().enumerate() {
        let time = k as u64 + 1;
        let header = mcap::records::MessageHeader {
            channel_id: channels[channel],
            sequence: 0,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, b"{}").unwrap();
    }
    writer.finish().unwrap();
    let recording = Recording::from_bytes("shared topic", &writer.into_inner().into_inner(), false).unwrap();
    let log_times: Vec<_> = recording.messages("/stylus").iter().map(|m| m.log_time_ns).collect();
    assert_eq!(log_times, [1, 2, 3, 4], "in file order, whatever the channel");
    let told: Vec<_> = recording.topics().iter().map(|t| (&*t.schema_name, t.n_messages)).collect();
    assert_eq!(told, [("foxglove.PoseInFrame", 3), ("foxglove.PointCloud", 1)]);
    assert_eq!(&*recording.messages("/stylus")[3].schema_name, "foxglove.PointCloud");
}

#[test]
fn a_constant_pose_is_written_with_the_first_stamp() {
    let constant = Pose::new("phantom", "phantom_marker", Isometry3::translation(-55.0, -48.0, 30.0));
    let moving = Pose::new("world", "bone_marker", Isometry3::identity()).at(START_NS);
    let streams = [("/cad", Stream::Transforms(vec![constant])), ("/bone", Stream::Transforms(vec![moving]))];
    let bytes = recording_write::recording_bytes(&streams, &BTreeMap::new(), &[]).unwrap();
    let recording = Recording::from_bytes("constant", &bytes, false).unwrap();
    let read = read_transforms(&recording.messages("/cad")[0]).unwrap().remove(0).unwrap().value;
    assert_eq!(read.stamp_ns, START_NS);
    assert_eq!(read.isometry.translation.vector, Vector3::new(-55.0, -48.0, 30.0));
}

#[test]
fn a_stamp_that_foxglove_cannot_hold_is_refused() {
    let early = Pose::new("world", "bone_marker", Isometry3::identity()).at(-1);
    let streams = [("/bone", Stream::Transforms(vec![early]))];
    let refused = recording_write::recording_bytes(&streams, &BTreeMap::new(), &[]);
    assert!(refused.unwrap_err().to_string().contains("stamp -1 ns is outside 1970 to 2106"));
}
