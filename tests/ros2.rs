//! A procedure as a bag of ROS 2: the same answer as from Foxglove's messages.

use crate::common::{
    Ran,
    case::Case,
    isometry,
    layouts::{Compression, Encoding, Layout, PointType, recording_bytes},
    osteoflow, root, run,
};
use osteoflow_formats::{
    mcap_read::Recording,
    message_read::{MessageKind, read_cloud, read_pose_in_frame, read_transforms},
    recording_write::Stream,
};
use osteoflow_geometry::{
    Frame, Pose, StampNs,
    nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3},
};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// The frames of the bag for those of the recording, as ROS names them.
fn ros_frame(frame: &Frame) -> Frame {
    match frame.as_str() {
        "camera" => "camera_depth_optical_frame".into(),
        "world" => "map".into(),
        other => other.into(),
    }
}

/// The topic of the bag: all moving transforms are on `/tf`, the constant one on `/tf_static`.
fn ros_topic(topic: &str) -> &str {
    match topic {
        "/phantom/marker_cad" => "/tf_static",
        _ if topic.starts_with("/tracker/") => "/tf",
        _ => topic,
    }
}

/// Topics with their messages sent before and after half of the procedure.
#[derive(Default)]
struct Halves([BTreeMap<String, Stream>; 2]);

impl Halves {
    fn add(&mut self, topic: &str, late: bool, part: Stream) {
        let half = &mut self.0[usize::from(late)];
        match (half.get_mut(topic), part) {
            (Some(Stream::Clouds(all)), Stream::Clouds(part)) => all.extend(part),
            (Some(Stream::Transforms(all)), Stream::Transforms(part)) => all.extend(part),
            (Some(Stream::Tips(all)), Stream::Tips(part)) => all.extend(part),
            (_, part) => {
                half.insert(topic.into(), part);
            }
        }
    }
}

/// Writes a recording as a bag of two files, the second big-endian and without an index; the constant transform comes last.
fn write_bag(recording: &Path, folder: &Path) {
    let read = Recording::open(recording, false).unwrap();
    let messages = || read.topics().iter().flat_map(|topic| read.messages(&topic.name));
    let stamps: Vec<StampNs> = messages().map(|message| message.publish_time_ns).collect();
    let (first, last) = (*stamps.iter().min().unwrap(), *stamps.iter().max().unwrap());
    let mut halves = Halves::default();
    for topic in read.topics() {
        for message in read.messages(&topic.name) {
            let (name, late) = (ros_topic(&topic.name), message.publish_time_ns > first.midpoint(last));
            match MessageKind::of(&message.schema_name).unwrap() {
                MessageKind::Cloud => {
                    let mut cloud = read_cloud(message).unwrap().cloud;
                    cloud.frame = ros_frame(&cloud.frame);
                    halves.add(name, late, Stream::Clouds(vec![cloud]));
                }
                MessageKind::Pose => {
                    let tip = read_pose_in_frame(message).unwrap();
                    let tip = (ros_frame(&tip.frame), tip.stamp_ns, tip.position);
                    halves.add(name, late, Stream::Tips(vec![tip]));
                }
                MessageKind::Transform | MessageKind::Transforms => {
                    for pose in read_transforms(message).unwrap() {
                        let mut pose = pose.unwrap().value;
                        (pose.to, pose.from) = (ros_frame(&pose.to), ros_frame(&pose.from));
                        let held = name == "/tf_static";
                        pose.stamp_ns = if held { last } else { pose.stamp_ns };
                        halves.add(name, late || held, Stream::Transforms(vec![pose]));
                    }
                }
            }
        }
    }
    fs::create_dir(folder).unwrap();
    let layout = |big_endian| Layout {
        encoding: Encoding::Cdr { big_endian },
        points: PointType::F64,
        padding_bytes: 4,
        transforms_per_message: 3,
        ..Layout::default()
    };
    let layouts = [layout(false), Layout { index: false, compression: Compression::Lz4, ..layout(true) }];
    let n_messages: usize = layouts
        .iter()
        .zip(&halves.0)
        .enumerate()
        .map(|(k, (layout, half))| {
            let streams: Vec<(String, Stream)> =
                half.iter().map(|(topic, stream)| (topic.clone(), stream.clone())).collect();
            let file = folder.join(format!("bag_{k}.mcap"));
            fs::write(&file, recording_bytes(&streams, &read.metadata, &[], layout)).unwrap();
            Recording::open(&file, false).unwrap().topics().iter().map(|topic| topic.n_messages).sum::<usize>()
        })
        .sum();
    let metadata = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n    - bag_0.mcap\n    \
         - bag_1.mcap\n  message_count: {n_messages}\n  compression_format: \"\"\n  compression_mode: \"\"\n"
    );
    fs::write(folder.join("metadata.yaml"), metadata).unwrap();
}

/// The shipped graph with the topics and frames of the bag.
fn write_graph(dir: &Path, frames: &str) -> PathBuf {
    let tf = |port: &str, child: &str, more: &str| {
        format!(
            "out.{port} = {{ type = \"geometry/Pose\", topic = \"/tf\", parent = \"map\", child = \"{child}\", \
             to = \"world\", from = \"{child}\"{more} }}\n"
        )
    };
    let text = format!(
        "extends = \"{}\"\n[graph]\nname = \"bag\"\n[node.recording]\npath = \"bag\"\n{frames}\n{}{}{}\
         out.phantom_marker_cad = {{ type = \"geometry/Pose\", topic = \"/tf_static\", parent = \"phantom\", \
         child = \"phantom_marker\", to = \"phantom\", from = \"phantom_marker\" }}\n\
         out.bone_tracked = {{ type = \"report/Flag\", present = \"/tf\" }}\n",
        root().join("graphs/fibula_recorded.toml").display(),
        tf("camera_marker", "camera_marker", ""),
        tf("phantom_marker", "phantom_marker", ""),
        tf("bone_marker", "bone_marker", ", lost_after_ms = 500"),
    );
    let path = dir.join("bag.toml");
    fs::write(&path, text).unwrap();
    path
}

const FRAMES: &str = "frames = { camera_depth_optical_frame = \"camera\", map = \"world\" }";

fn registered(graph: &Path) -> Ran {
    run(graph.to_str().unwrap(), &["--no-record"])
}

#[test]
fn a_bag_of_ros_2_gives_the_answer_of_the_recording_that_it_was_made_from() {
    let dir = tempfile::tempdir().unwrap();
    let case = Case::shipped();
    write_bag(&case.recording, &dir.path().join("bag"));
    let ran = registered(&write_graph(dir.path(), FRAMES));
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let expected = case.run(&["--no-record"]);
    assert_eq!(ran.results["verdict"]["answer"], expected.results["verdict"]["answer"]);
    for pose in ["t_ct_world", "t_camera_camera_marker"] {
        let [a, b] = [&ran, expected].map(|ran| isometry(&ran.results["poses"][pose]["matrix"]));
        let off = a.inverse() * b;
        let (mm, rad) = ((a.translation.vector - b.translation.vector).norm(), off.rotation.angle());
        assert!(mm < 1e-6 && rad < 1e-9, "{pose}: {mm} mm, {rad} rad; both are written in double precision");
    }
    let n_planes = |ran: &Ran| ran.results["planes_at_scan"].as_array().unwrap().len();
    assert_eq!((n_planes(&ran), n_planes(expected)), (2, 2));
}

#[test]
fn a_bag_that_is_read_in_another_way_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    write_bag(&Case::shipped().recording, &bag);

    // The frames under the names of ROS.
    let ran = registered(&write_graph(dir.path(), ""));
    assert_ne!(ran.code, 0);
    let said = "the region of interest should be in camera_depth_optical_frame, but is in camera";
    assert!(ran.stderr.contains(said), "{}", ran.stderr);

    let ran =
        registered(&write_graph(dir.path(), "frames = { camera_depth_optical_frame = \"camera\", odom = \"world\" }"));
    assert_ne!(ran.code, 0);
    assert!(ran.stderr.contains("frames names \"odom\", but no message that a port reads is in it"), "{}", ran.stderr);

    fs::remove_file(bag.join("bag_1.mcap")).unwrap();
    let ran = registered(&write_graph(dir.path(), FRAMES));
    assert_ne!(ran.code, 0);
    assert!(ran.stderr.contains("bag_1.mcap is missing, though metadata.yaml names it"), "{}", ran.stderr);
}

#[test]
fn a_static_transform_holds_from_the_beginning_and_a_changed_one_is_told() {
    const START_NS: StampNs = 1_750_000_000_000_000_000;
    let dir = tempfile::tempdir().unwrap();
    let pose = |x: f64, k: StampNs| {
        Pose::new("base", "camera", Isometry3::translation(x, 0.0, 0.0)).at(START_NS + k * 1_000_000_000)
    };
    let run_with = |poses: Vec<Pose>, more: &str| {
        let layout = Layout { encoding: Encoding::Cdr { big_endian: false }, ..Layout::default() };
        let streams = [("/tf_static", Stream::Transforms(poses))];
        fs::write(dir.path().join("static.mcap"), recording_bytes(&streams, &BTreeMap::new(), &[], &layout)).unwrap();
        let graph = format!(
            "[graph]\nformat = 1\nframes = [\"world\", \"camera\"]\n[node.recording]\nkind = \"acquire.mcap\"\n\
             path = \"static.mcap\"\nframes = {{ base = \"world\" }}\nout.held = {{ type = \"geometry/Pose\", \
             topic = \"/tf_static\", to = \"world\", from = \"camera\"{more} }}\n[results]\n\
             held = {{ from = \"recording.held\", all = true }}\n"
        );
        fs::write(dir.path().join("static.toml"), graph).unwrap();
        registered(&dir.path().join("static.toml"))
    };
    let ran = run_with(vec![pose(5.0, 3), pose(5.0, 4)], "");
    let held = ran.results["held"].as_array().unwrap();
    assert_eq!((ran.code, held.len()), (0, 1), "what is sent again is the same: {}", ran.stderr);
    assert_eq!(held[0]["to"], "world", "{}", held[0]);
    let ran = run_with(vec![pose(5.0, 3), pose(6.0, 4)], "");
    assert_eq!((ran.code, ran.results["held"].as_array().unwrap().len()), (0, 2), "{}", ran.stderr);
    assert!(
        ran.stderr.contains(
            "t_base_camera changes at 1750000004000000000 ns by 1.00 mm and 0.00 degrees, though it is static"
        ),
        "{}",
        ran.stderr
    );
    let ran = run_with(vec![pose(5.0, 3)], ", lost_after_ms = 500");
    assert!(ran.code != 0 && ran.stderr.contains("remove lost_after_ms"), "{}", ran.stderr);
}

#[test]
fn info_lists_the_topics_of_a_bag_and_its_problems() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    write_bag(&Case::shipped().recording, &bag);
    let info = || {
        let output = osteoflow().arg("info").arg(&bag).args(["--format", "json"]).output().unwrap();
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    let found = info();
    assert_eq!((&found["kind"], &found["problems"]), (&"recording".into(), &serde_json::json!([])));
    let topics = found["topics"].as_array().unwrap();
    let schema = |name: &str| topics.iter().find(|topic| topic["name"] == name).unwrap()["schema"].clone();
    assert_eq!(schema("/camera/scan"), "sensor_msgs/msg/PointCloud2");
    assert_eq!(schema("/tf_static"), "tf2_msgs/msg/TFMessage");
    assert_eq!(schema("/stylus/assessment"), "geometry_msgs/msg/PoseStamped");
    assert!(found["frames"].to_string().contains("camera_depth_optical_frame"), "{}", found["frames"]);

    let metadata = fs::read_to_string(bag.join("metadata.yaml")).unwrap();
    let line = metadata.lines().find(|line| line.contains("message_count")).unwrap();
    fs::write(bag.join("metadata.yaml"), metadata.replace(line, "  message_count: 5000")).unwrap();
    assert!(info()["notes"].to_string().contains("metadata.yaml counts 5000 messages"), "{}", info());
}

/// Checks what tests/python/ros2_bag.py writes.
fn check_bag(folder: &Path) {
    const START_NS: StampNs = 1_750_000_000_000_000_000;
    let bag = Recording::open(folder, false).unwrap();
    assert_eq!(bag.notes, [""; 0]);
    let clouds: Vec<_> = bag.messages("/camera/points").iter().map(|m| read_cloud(m).unwrap()).collect();
    let expected = |k: usize| Point3::new(500.0 + k as f64, -2.0 * k as f64, 250.0);
    for (i, read) in clouds.iter().enumerate() {
        assert_eq!((read.cloud.frame.as_str(), read.cloud.stamp_ns), ("optical", START_NS + i as StampNs));
        let without_depth = (i == 2).then_some(3);
        assert_eq!((read.n_points_in_message, read.n_dropped), (12, usize::from(i == 2)), "cloud {i}");
        let kept = (0..12).filter(|k| Some(*k) != without_depth).map(expected);
        for (found, expected) in read.cloud.points().iter().zip(kept) {
            // Metres in single precision.
            assert!((found - expected).norm() < 1e-4, "cloud {i}: {found} and {expected}");
        }
    }
    assert_eq!(clouds.len(), 3);
    let moves = read_transforms(&bag.messages("/tf")[0]).unwrap();
    let marker = &moves[0].as_ref().unwrap().value;
    assert_eq!((marker.to.as_str(), marker.from.as_str(), marker.stamp_ns), ("map", "marker", START_NS + 3));
    let expected = Isometry3::from_parts(
        Vector3::new(100.0, 200.0, 300.0).into(),
        UnitQuaternion::from_quaternion(Quaternion::new(0.8, 0.0, 0.0, 0.6)),
    );
    let off = marker.isometry.inverse() * expected;
    assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-9, "{marker:?}");
    assert!(moves[1].as_ref().unwrap_err().to_string().contains("all-zero quaternion"));
    assert_eq!(read_transforms(&bag.messages("/marker")[0]).unwrap()[0].as_ref().unwrap().value, *marker);
    let tip = read_pose_in_frame(&bag.messages("/tip")[0]).unwrap();
    assert!((tip.position - Point3::new(400.0, 500.0, 600.0)).norm() < 1e-9 && tip.frame.as_str() == "map");
    let held = read_transforms(&bag.messages("/tf_static")[0]).unwrap();
    assert_eq!(held[0].as_ref().unwrap().value.isometry.translation.vector.z, 10.0);
}

#[test]
fn a_bag_of_a_public_writer_is_read() {
    check_bag(&root().join("tests/data/ros2_bag"));
    let dir = tempfile::tempdir().unwrap();
    let script = root().join("tests/python/ros2_bag.py");
    let bag = dir.path().join("bag");
    match std::process::Command::new("python3").arg(script).arg(&bag).output() {
        Ok(output) if output.status.success() => check_bag(&bag),
        _ => println!("skipped: a fresh bag, because python3 with the package rosbags is not there"),
    }
}
