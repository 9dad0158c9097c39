//! The ports of a graph on a recording and on a bridge that plays it: the same items, or a word that says what differs.

use super::*;
use crate::acquire::mcap::{self, Mcap};
use layouts::{Layout, recording_bytes};
use osteoflow_formats::{
    mcap_read::{Message as Recorded, Recording},
    recording_write,
};
use osteoflow_geometry::{
    Cloud, Pose,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{FilePath, Outputs, View};
use osteoflow_payloads::Flag;
use std::path::{Path, PathBuf};

#[path = "../../../../../../bone/formats/tests/layouts.rs"]
mod layouts;

type Items = Vec<(StampNs, Result<View, String>)>;

fn items(items: impl Iterator<Item = (StampNs, Emission)>) -> Items {
    let view = |emission| match emission {
        Emission::Value(value) => Ok(value.to_view()),
        Emission::Empty(reason) => Err(reason),
        other => panic!("{other:?}"),
    };
    items.map(|(stamp_ns, emission)| (stamp_ns, view(emission))).collect()
}

/// The items of each port over a recording.
fn recorded(path: &Path, ports: &[PortSpec]) -> Vec<Items> {
    let params = mcap::Params { path: FilePath(path.into()), allow_truncated: false, frames: BTreeMap::new() };
    let (mut source, mut ctx) = (Mcap::new(params).unwrap(), context(ports));
    let mut all: Vec<Vec<(StampNs, Emission)>> = ports.iter().map(|_| Vec::new()).collect();
    while let Some(out) = source.next(&mut ctx).unwrap() {
        let mut emissions: Vec<Emission> = ports.iter().map(|_| Emission::Silent).collect();
        out.put(&mut emissions);
        for (port, emission) in emissions.into_iter().enumerate().filter(|(_, e)| !matches!(e, Emission::Silent)) {
            all[port].push((ctx.stamp_ns(), emission));
        }
    }
    all.into_iter().map(|of_port| items(of_port.into_iter())).collect()
}

/// What a bridge sends.
type Sent = (String, Recorded);

/// The messages of some topics of a recording, in the order in which they were published.
fn published(recording: &Recording, topics: &[&str]) -> Vec<Sent> {
    let mut sent: Vec<Sent> = Vec::new();
    for topic in topics {
        sent.extend(recording.messages(topic).iter().map(|message| ((*topic).to_owned(), message.clone())));
    }
    sent.sort_by_key(|(_, message)| message.publish_time_ns);
    sent
}

/// What a source gives of a bridge that advertises each topic with its first message.
fn bridged(metadata: BTreeMap<String, String>, sent: Vec<Sent>, ports: &[PortSpec]) -> Outcome {
    let address = one(move |client| {
        client.text(&json!({ "op": "serverInfo", "name": "test", "capabilities": [], "metadata": metadata }));
        let mut subscriptions: BTreeMap<String, u64> = BTreeMap::new();
        for (topic, message) in &sent {
            if !subscriptions.contains_key(topic) {
                let id = subscriptions.len() as u64 + 1;
                client.advertise(&[(id, topic, &message.message_encoding, &message.schema_name)]);
                let Some(subscription) = client.subscription() else { return };
                subscriptions.insert(topic.clone(), subscription);
            }
            let head = [&[1][..], &(subscriptions[topic] as u32).to_le_bytes()].concat();
            let time = (message.publish_time_ns as u64).to_le_bytes();
            // A client that has failed is gone.
            let _ = client.0.send(Message::binary([&head[..], &time, &message.data].concat()));
        }
    });
    take_all(&address, ports, |_| {})
}

/// Asserts that each port gives the same of a bridge as of its recording; reasons of empties may differ.
#[track_caller]
fn assert_same(outcome: &Outcome, recorded: &[Items], ports: &[PortSpec]) {
    assert_eq!(outcome.error, None);
    for (k, (expected, (name, ..))) in recorded.iter().zip(ports).enumerate() {
        let of_port = outcome.of_port(k).into_iter().map(|(stamp_ns, emission)| (stamp_ns, emission.clone()));
        let given = items(of_port);
        let heads = |items: &Items| items.iter().map(|(ns, item)| (*ns, item.is_ok())).collect::<Vec<_>>();
        assert_eq!(heads(&given), heads(expected), "{name}: {:?}", outcome.warnings);
        assert!(!given.is_empty(), "{name}");
        for ((stamp_ns, given), (_, expected)) in given.iter().zip(expected) {
            assert!(given.is_err() || given == expected, "{name}, {stamp_ns} ns: {given:?} but {expected:?}");
        }
    }
}

fn data(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/data").join(path)
}

fn image_ports() -> Vec<PortSpec> {
    let image = |topic: &str| json!({ "topic": topic, "calibration": "/pinhole/info" });
    vec![
        ("picture", "geometry/Image", image("/rgb8")),
        ("jpeg", "geometry/Image", image("/jpeg")),
        ("depth", "geometry/Cloud", json!({ "topic": "/depth16", "calibration": "/fisheye/info", "labels": ["P1"] })),
        ("points", "geometry/Cloud", json!({ "topic": "/pinhole/points" })),
    ]
}

const IMAGES: [&str; 6] = ["/pinhole/info", "/fisheye/info", "/rgb8", "/jpeg", "/depth16", "/pinhole/points"];

#[test]
fn images_depths_and_points_of_a_bridge_are_those_of_its_recording_also_before_their_calibration() {
    let path = data("ros2_images.mcap");
    let recording = Recording::open(&path, false).unwrap();
    let (ports, mut sent) = (image_ports(), published(&recording, &IMAGES));
    let expected = recorded(&path, &ports);
    assert_same(&bridged(BTreeMap::new(), sent.clone(), &ports), &expected, &ports);
    // Each image before its calibration.
    sent.sort_by_key(|(topic, _)| topic.ends_with("info"));
    assert_same(&bridged(BTreeMap::new(), sent.clone(), &ports), &expected, &ports);
    // A topic that has something else is refused at once.
    let cloud = recording.messages("/pinhole/points")[0].clone();
    let refused = bridged(BTreeMap::new(), vec![("/rgb8".into(), cloud)], &ports).error.unwrap();
    assert!(refused.contains("/rgb8 has sensor_msgs/msg/PointCloud2, but geometry/Image is read from"), "{refused}");
    // The camera changes.
    let other = recording.messages("/brown/info")[0].clone();
    sent.push(("/pinhole/info".into(), other));
    let changed = bridged(BTreeMap::new(), sent, &ports).error.unwrap();
    assert!(changed.contains("differs from the first one, but a port has one camera"), "{changed}");
}

#[test]
fn the_shipped_procedure_gives_all_its_streams_from_a_bridge_that_plays_it() {
    let path = data("procedure/procedure.mcap");
    let recording = Recording::open(&path, false).unwrap();
    let pose = |topic: &str, parent: &str, child: &str| json!({ "topic": topic, "parent": parent, "child": child });
    let marker = |name: &str| pose(&format!("/tracker/{name}"), "world", name);
    let ports = [
        ("scan", "geometry/Cloud", json!({ "topic": "/camera/scan" })),
        (
            "laser",
            "geometry/Cloud",
            json!({ "topics": ["/camera/laser_p1", "/camera/laser_p2", "/camera/laser_p3"], "labels": ["P1", "P2", "P3"] }),
        ),
        ("camera_marker", "geometry/Pose", marker("camera_marker")),
        ("bone_marker", "geometry/Pose", marker("bone_marker")),
        ("cad", "geometry/Pose", pose("/phantom/marker_cad", "phantom", "phantom_marker")),
        (
            "touched",
            "geometry/Points",
            json!({ "topic": "/stylus/assessment", "labels": ["M1", "M2", "M3", "M4", "M5"] }),
        ),
    ];
    let topics: Vec<&str> = recording.topics().iter().map(|topic| topic.name.as_str()).collect();
    let wanted = [
        "/camera/scan",
        "/camera/laser_p1",
        "/camera/laser_p2",
        "/camera/laser_p3",
        "/tracker/camera_marker",
        "/tracker/bone_marker",
        "/phantom/marker_cad",
        "/stylus/assessment",
    ];
    let sent = published(&recording, &wanted);
    assert!(wanted.iter().all(|topic| topics.contains(topic)), "{topics:?}");
    let mut free = ports.clone();
    for (_, payload, params) in &mut free {
        if *payload == "geometry/Pose" {
            params["motion"] = json!({ "hand_mm_s": 0.0 });
        }
    }
    assert_same(&bridged(BTreeMap::new(), sent.clone(), &free), &recorded(&path, &free), &free);
    // A motion has to be confirmed by poses that have not come yet, so that a bridge gives fewer of them, and no others.
    let (outcome, expected) = (bridged(BTreeMap::new(), sent.clone(), &ports), recorded(&path, &ports));
    for (k, (name, ..)) in ports.iter().enumerate() {
        let given = items(outcome.of_port(k).into_iter().map(|(stamp_ns, emission)| (stamp_ns, emission.clone())));
        let given: Items = given.into_iter().filter(|(_, item)| item.is_ok()).collect();
        assert!(given.iter().all(|item| expected[k].contains(item)), "{name}");
        assert!(given.len() + 6 >= expected[k].len(), "{name}: {} of {}", given.len(), expected[k].len());
    }
    // What is known of the procedure beside its topics.
    let facts = [
        ("region", "geometry/Region", json!({ "metadata": "procedure" })),
        ("tracked", "report/Flag", json!({ "present": "/tracker/bone_marker" })),
        ("other", "report/Flag", json!({ "present": "/nothing" })),
        ("simulated", "report/Flag", json!({ "metadata": "procedure", "key": "simulated" })),
        ("palpation", "geometry/Points", json!({ "topic": "/nothing", "optional": true })),
        ("bone_marker", "geometry/Pose", marker("bone_marker")),
    ];
    let expected = recorded(&path, &facts);
    let sent: Vec<Sent> = sent.into_iter().filter(|(topic, _)| topic == "/tracker/bone_marker").collect();
    let outcome = bridged(recording.metadata["procedure"].clone(), sent, &facts);
    for k in 0..facts.len() - 1 {
        let given = items(outcome.of_port(k).into_iter().map(|(stamp_ns, emission)| (stamp_ns, emission.clone())));
        assert_eq!(given.len(), 1, "{}: {:?}", facts[k].0, outcome.warnings);
        assert!(given[0].1 == expected[k][0].1 || given[0].1.is_err() && expected[k][0].1.is_err(), "{}", facts[k].0);
    }
}

/// `t_map_base` and `t_base_camera`, which move, at times of their own, and `t_camera_tool`, which does not.
fn moving() -> Vec<(&'static str, recording_write::Stream)> {
    let pose = |to: &str, from: &str, ms: StampNs, x: f64| {
        Pose::new(to, from, Isometry3::translation(x, 20.0, 0.1 * x)).at(STAMP + ms * MS)
    };
    let mut tf: Vec<Pose> = (0..40).map(|k| pose("map", "base", 50 * k, 100.0 + 0.2 * k as f64)).collect();
    tf.extend((0..100).map(|k| pose("base", "camera", 7 + 20 * k, 300.0 - 0.1 * k as f64)));
    tf.retain(|pose| pose.stamp_ns < STAMP + 1960 * MS);
    tf.sort_by_key(|pose| pose.stamp_ns);
    vec![
        ("/tf", recording_write::Stream::Transforms(tf)),
        ("/tf_static", recording_write::Stream::Transforms(vec![pose("camera", "tool", 0, 5.0)])),
    ]
}

fn written(dir: &Path, streams: &[(&str, recording_write::Stream)], unstamped: &[&str]) -> (PathBuf, Recording) {
    let unstamped = unstamped.iter().map(|topic| (*topic).to_owned()).collect();
    let bytes = recording_bytes(streams, &BTreeMap::new(), &[], &Layout { unstamped, ..Layout::default() });
    let path = dir.join("written.mcap");
    std::fs::write(&path, bytes).unwrap();
    let recording = Recording::open(&path, false).unwrap();
    (path, recording)
}

#[test]
fn frames_that_several_transforms_join_are_joined_alike_also_where_the_static_one_comes_late() {
    let dir = tempfile::tempdir().unwrap();
    let (path, recording) = written(dir.path(), &moving(), &[]);
    let joined = |parent, child| json!({ "topic": "/tf", "parent": parent, "child": child });
    let ports = [
        ("tool", "geometry/Pose", joined("map", "tool")),
        ("inverse", "geometry/Pose", joined("/base", "map")),
        ("direct", "geometry/Pose", joined("base", "camera")),
    ];
    let expected = recorded(&path, &ports);
    assert!(expected[0].len() > 130 && expected[0].iter().filter(|item| item.1.is_ok()).count() > 130);
    let mut sent = published(&recording, &["/tf_static", "/tf"]);
    for of_static in [0, 30] {
        let at = sent.iter().position(|(topic, _)| topic == "/tf_static").unwrap();
        let late = sent.remove(at);
        sent.insert(of_static, late);
        let outcome = bridged(BTreeMap::new(), sent.clone(), &ports);
        outcome.warned("t_map_tool is t_map_base * t_base_camera * t_camera_tool, as tf takes it");
        outcome.warned("t_base_map is the inverse of t_map_base");
        let k = expected[0].len();
        // What waits at the end of the stream for a transform that does not come is not given.
        let given = outcome.of_port(0).len();
        assert!(k - given <= 3, "{given} of {k}");
        let cut = [expected[0][..given].to_vec(), expected[1].clone(), expected[2].clone()];
        assert_same(&outcome, &cut, &ports);
    }
    // A stamp that goes back, after what it would have been needed for.
    let back = sent.iter().filter(|(topic, _)| topic == "/tf").nth(4).unwrap().clone();
    sent.push(back);
    let outcome = bridged(BTreeMap::new(), sent.clone(), &ports);
    let last = outcome.of_port(0).pop().unwrap().1.clone();
    assert!(matches!(&last, Emission::Empty(reason) if reason.contains("comes after it was needed")), "{last:?}");
    // Two ways between the frames.
    let bytes =
        String::from_utf8(transform(STAMP, 0.5)).unwrap().replace("world", "map").replace("bone_marker", "tool");
    let (encoding, schema_name) = ("json".into(), "foxglove.FrameTransform".into());
    let direct = Recorded { data: bytes.into(), message_encoding: encoding, schema_name, ..sent[0].1.clone() };
    sent.push(("/tf_2".into(), direct));
    let both = [("tool", "geometry/Pose", json!({ "topics": ["/tf", "/tf_2"], "parent": "map", "child": "tool" }))];
    let fault = bridged(BTreeMap::new(), sent, &both).error.unwrap();
    assert!(fault.contains("comes as one transform after it was joined of several"), "{fault}");
}

#[test]
fn messages_without_a_stamp_are_refused_beside_poses_that_move_unless_the_port_allows_their_time() {
    let dir = tempfile::tempdir().unwrap();
    let mut cloud = Cloud::new("camera", vec![Point3::new(1.0, 2.0, 300.0)]).unwrap();
    cloud.stamp_ns = STAMP + 500 * MS;
    let mut streams = moving();
    streams.push(("/scan", recording_write::Stream::Clouds(vec![cloud])));
    let (path, recording) = written(dir.path(), &streams, &["/scan"]);
    let sent = published(&recording, &["/tf", "/scan"]);
    let ports = |policy: &str| {
        [
            ("base", "geometry/Pose", json!({ "topic": "/tf", "parent": "base", "child": "camera" })),
            ("scan", "geometry/Cloud", json!({ "topic": "/scan", "unstamped": policy })),
        ]
    };
    let refused = bridged(BTreeMap::new(), sent.clone(), &ports("refuse")).error.unwrap();
    assert!(
        refused.contains("topic /scan: 1 of 1 messages have no stamp, and t_base_camera of /tf moves"),
        "{refused}"
    );
    let ports = ports("publish_time");
    let outcome = bridged(BTreeMap::new(), sent, &ports);
    outcome.warned("topic /scan: 1 of 1 messages have no stamp; the time at which they were published is used");
    assert_same(&outcome, &recorded(&path, &ports), &ports);
}

#[test]
fn a_topic_that_comes_late_or_twice_or_with_another_schema_is_said() {
    let tf = (7, "/tf", "json", "foxglove.FrameTransform");
    let late = |port: PortSpec| {
        let address = one(move |client| {
            let id = client.tf();
            client.data(id, &transform(STAMP, 0.5));
            client.advertise(&[(9, "/late", "json", "foxglove.FrameTransform")]);
            client.data(id, &transform(STAMP + MS, 0.5));
        });
        take_all(&address, &[marker(), port], |_| {})
    };
    let flag = late(("tracked", "report/Flag", json!({ "present": "/late" }))).error.unwrap();
    assert!(flag.contains("/late is advertised after the port has said that it is not there; start its"), "{flag}");
    let optional = late(("other", "geometry/Pose", json!({ "topic": "/late", "optional": true })));
    optional.warned("port \"other\": /late is advertised after the port has said that it is not there");
    assert_eq!(optional.poses(1), [(STAMP, Err("the server has no topic /late"))]);
    let address = one(move |client| {
        let id = client.tf();
        client.advertise(&[(8, tf.1, tf.2, tf.3)]);
        client.data(id, &transform(STAMP, 0.5));
        // The channel becomes another: its messages are not read as those of the old one.
        client.advertise(&[(7, "/tf", "json", "foxglove.Log")]);
        client.data(id, &transform(STAMP + MS, 0.9));
    });
    let ran = take_all(&address, &[marker()], |_| {});
    ran.warned("/tf is advertised twice; the first channel is read");
    ran.warned("/tf has foxglove.Log, but geometry/Pose is read from");
    assert_eq!(ran.poses(0), [(STAMP, Ok(500.0))]);
}

#[test]
fn a_server_that_comes_back_does_not_contradict_the_flag_of_its_topic() {
    let client = |stamp_ns: StampNs| -> Treat {
        Box::new(move |client: &mut Client| {
            client.text(&json!({ "op": "serverInfo", "name": "test", "capabilities": [] }));
            let id = client.tf();
            client.data(id, &transform(stamp_ns, 0.5));
        })
    };
    let params =
        Params { address: format!("ws://{}", server(vec![client(STAMP), client(STAMP + MS)])), ..Params::default() };
    let ports = [marker(), ("tracked", "report/Flag", json!({ "present": "/tf" }))];
    let is_last = |ran: &Outcome| ran.poses(0).last() == Some(&(STAMP + MS, Ok(500.0)));
    let ran = take_until(&mut NetworkSource::<FoxgloveWs>::new(params).unwrap(), &mut context(&ports), is_last);
    assert_eq!(ran.error, None);
    let flags = ran.of_port(1);
    let (stamp_ns, Emission::Value(flag)) = flags[0] else { panic!("{flags:?}") };
    assert_eq!((flags.len(), stamp_ns, flag.get::<Flag>().map(|flag| flag.0)), (1, STAMP, Some(true)));
}
