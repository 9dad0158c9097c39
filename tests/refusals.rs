//! A procedure that cannot be completed ends with the reason and the place, and without a pose.

use crate::common::{Ran, run};
use osteoflow_formats::{
    plan_file,
    recording_write::{Stream, recording_bytes},
    write::write_stl,
};
use osteoflow_geometry::{Cloud, Points, Pose, StampNs, nalgebra::Point3};
use osteoflow_simulation::{CtParams, Procedure, ProcedureParams, ct_surface};
use std::collections::BTreeMap;

const GRAPH: &str = "graphs/fibula_recorded.toml";
const SECOND_NS: StampNs = 1_000_000_000;

fn procedure(n_points: usize) -> Procedure {
    let mut params = ProcedureParams::default();
    params.camera.n_points = n_points;
    Procedure::simulate(&params, 42).unwrap()
}

/// A procedure that is trusted whatever the verdict says of correlated errors.
fn procedure_with_white_noise(n_points: usize) -> Procedure {
    let mut params = ProcedureParams::default();
    let camera = &mut params.camera;
    (camera.n_points, camera.surface_error_mm, camera.edge_outliers) = (n_points, 0.0, 0.0);
    Procedure::simulate(&params, 42).unwrap()
}

/// The topics of a procedure, except those named.
fn streams(of: &Procedure, without: &[&str]) -> Vec<(String, Stream)> {
    let clouds = |cloud: &Cloud| Stream::Clouds(vec![cloud.clone()]);
    let poses = |poses: &[Pose]| Stream::Transforms(poses.to_vec());
    let tips = |points: &Points| {
        Stream::Tips(points.points.iter().map(|p| (points.frame.clone(), p.stamp_ns, p.position)).collect())
    };
    let mut all = vec![
        ("/tracker/camera_marker".to_owned(), poses(&of.camera_marker)),
        ("/tracker/phantom_marker".into(), poses(&of.phantom_marker)),
        ("/tracker/bone_marker".into(), poses(&of.bone_marker)),
        ("/camera/calibration".into(), clouds(&of.phantom_scan)),
        ("/camera/scan".into(), clouds(&of.scan)),
        ("/stylus/assessment".into(), tips(&of.stylus_assessment)),
    ];
    all.extend(of.laser.iter().zip(1..).map(|(scan, n)| (format!("/camera/laser_p{n}"), clouds(scan))));
    all.retain(|(topic, _)| !without.contains(&topic.as_str()));
    all
}

/// Runs a procedure as a recording.
fn run_procedure(of: &Procedure, without: &[&str], arguments: &[&str]) -> Ran {
    run_with(of, without, Vec::new(), arguments)
}

/// Runs a procedure as a recording with more topics.
fn run_with(of: &Procedure, without: &[&str], more: Vec<(String, Stream)>, arguments: &[&str]) -> Ran {
    let dir = tempfile::tempdir().unwrap();
    let at = |file: &str| dir.path().join(file);
    let region = of.region.as_ref().unwrap();
    let corner = |c: [f64; 3]| c.map(|mm| (mm / 1000.0).to_string()).join(" ");
    let about = BTreeMap::from([
        ("simulated".to_owned(), "true".to_owned()),
        ("roi_camera_min_m".into(), corner(region.min.coords.into())),
        ("roi_camera_max_m".into(), corner(region.max.coords.into())),
    ]);
    let metadata = BTreeMap::from([("procedure".to_owned(), about)]);
    let streams = [streams(of, without), more].concat();
    std::fs::write(at("r.mcap"), recording_bytes(&streams, &metadata, &[]).unwrap()).unwrap();
    let ct_surface = ct_surface(&of.truth.bone, &CtParams::default(), 1).unwrap();
    write_stl(&at("bone.stl"), &ct_surface).unwrap();
    write_stl(&at("phantom.stl"), &of.phantom).unwrap();
    plan_file::write_plan(&at("plan.json"), &of.plan).unwrap();
    let files = [("recording", "r.mcap"), ("bone", "bone.stl"), ("phantom", "phantom.stl"), ("plan", "plan.json")];
    let sets = files.map(|(node, file)| format!("{node}.path={}", at(file).display()));
    let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).chain(arguments.iter().copied()).collect();
    run(GRAPH, &sets)
}

/// Asserts exit code, message and results of a refusal; `words` must be in both.
fn assert_refused(ran: &Ran, words: &[&str]) {
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let refused = &ran.results["refused"];
    let reason = refused["reason"].as_str().unwrap_or_else(|| panic!("no reason: {}", ran.results));
    for word in words {
        assert!(ran.stderr.contains(word), "{}\nlacks {word}", ran.stderr);
        assert!(reason.contains(word) || refused["node"] == *word, "{refused}\nlacks {word}");
    }
    for key in ["poses", "laser_points", "planes", "planes_at_scan", "metrics"] {
        assert!(ran.results.get(key).is_none(), "{key} in the results of a refused run");
    }
}

/// The poses without those within `seconds` of a stamp.
fn lost(poses: &[Pose], around: StampNs, seconds: i64) -> Vec<Pose> {
    poses.iter().filter(|p| (p.stamp_ns - around).abs() > seconds * SECOND_NS).cloned().collect()
}

#[test]
fn the_untouched_procedure_is_completed() {
    let ran = run_procedure(&procedure(10_000), &[], &["--no-record"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
}

#[test]
fn a_missing_laser_scan_is_named() {
    assert_refused(&run_procedure(&procedure(10_000), &["/camera/laser_p2"], &[]), &["/camera/laser_p2", "P2"]);
}

#[test]
fn a_missing_full_scan_is_named() {
    assert_refused(&run_procedure(&procedure(10_000), &["/camera/scan"], &[]), &["/camera/scan"]);
}

#[test]
fn a_missing_calibration_scan_is_named() {
    assert_refused(&run_procedure(&procedure(10_000), &["/camera/calibration"], &[]), &["/camera/calibration"]);
}

#[test]
fn a_laser_scan_without_a_hole_is_refused_with_its_landmark() {
    let mut procedure = procedure(10_000);
    let stamp_ns = procedure.laser[1].stamp_ns;
    procedure.laser[1] = procedure.scan.clone().at(stamp_ns).labelled("P2");
    assert_refused(&run_procedure(&procedure, &[], &[]), &["hole", "P2"]);
}

#[test]
fn a_cloud_too_sparse_to_show_the_hole_is_refused() {
    assert_refused(&run_procedure(&procedure(1_000), &[], &[]), &["hole", "P1"]);
}

#[test]
fn a_bone_marker_lost_at_the_scan_is_refused_instead_of_taken_from_before() {
    let mut procedure = procedure(10_000);
    procedure.bone_marker = lost(&procedure.bone_marker, procedure.scan.stamp_ns, 1);
    assert_refused(&run_procedure(&procedure, &[], &[]), &["bone_marker"]);
}

#[test]
fn a_camera_marker_lost_at_the_scan_is_refused_instead_of_taken_from_before() {
    let mut procedure = procedure(10_000);
    procedure.camera_marker = lost(&procedure.camera_marker, procedure.scan.stamp_ns, 1);
    assert_refused(&run_procedure(&procedure, &[], &[]), &["camera_marker"]);
}

#[test]
fn planes_are_unknown_once_the_marker_is_lost_and_known_at_the_scan() {
    let mut procedure = procedure(10_000);
    let end = procedure.bone_marker.last().unwrap().stamp_ns;
    procedure.bone_marker = lost(&procedure.bone_marker, end, 2);
    // The tracker continues: it sees the camera's marker to the end.
    let seen = procedure.camera_marker.last().unwrap().clone();
    procedure.camera_marker.extend((0..40).map(|k| seen.clone().at(end - 2 * SECOND_NS + k * SECOND_NS / 20)));
    let ran = run_procedure(&procedure, &[], &["--no-record"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    for plane in ran.results["planes_at_scan"].as_array().unwrap() {
        assert!(plane["matrix"].is_array(), "{plane}");
    }
    assert_unknown_at_the_end(&ran, "not seen for 2.00 s");
}

/// The planes are unknown at the end for a reason with these words, the verdict doubts the result by it, and the last known ones are given.
fn assert_unknown_at_the_end(ran: &Ran, why: &str) {
    for plane in ran.results["planes"].as_array().unwrap() {
        assert!(plane["matrix"].is_array() && plane["stamp_ns"].as_i64().unwrap() > 0, "{plane}");
    }
    let verdict = &ran.results["verdict"];
    let lost = verdict["reasons"].as_array().unwrap().iter().find(|reason| reason["rule"] == "planes_lost");
    let lost = lost.unwrap_or_else(|| panic!("{verdict}"));
    assert_eq!((&verdict["answer"], &lost["answer"]), (&"doubtful".into(), &"doubtful".into()), "{verdict}");
    let reason = lost["reason"].as_str().unwrap();
    assert!(reason.contains("the bone marker was not seen for") && reason.contains(why), "{reason}");
}

#[test]
fn a_bone_marker_that_stops_before_the_last_message_of_any_topic_leaves_the_planes_unknown() {
    let of = procedure_with_white_noise(10_000);
    let end = of.bone_marker.last().unwrap().stamp_ns;
    // No port reads this topic, and the wired ones end with the marker.
    let run_until = |after_ms: i64| {
        let stamp = end + after_ms * SECOND_NS / 1000;
        let message = Stream::Tips(vec![("world".into(), stamp, Point3::origin())]);
        let stated = ["--no-record", "--set", "verdict.rules.attitude_stated=true"];
        run_with(&of, &[], vec![("/lamp".to_owned(), message)], &stated)
    };
    let known = run_until(400);
    assert_eq!((known.code, &known.results["verdict"]["answer"]), (0, &"trusted".into()), "{}", known.stderr);
    for plane in known.results["planes"].as_array().unwrap() {
        assert!(plane["matrix"].is_array(), "the limit is 500 ms: {plane}");
    }
    let lost = run_until(6000);
    assert_eq!(lost.code, 0, "{}", lost.stderr);
    assert_unknown_at_the_end(&lost, "not seen for 6.00 s, until the recording ended");
}

#[test]
fn every_refusal_of_a_recording_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let of = procedure(1000);
    let whole = recording_bytes(&streams(&of, &[]), &BTreeMap::new(), &[]).unwrap();
    let without = |topic: &str| recording_bytes(&streams(&of, &[topic]), &BTreeMap::new(), &[]).unwrap();
    let with = |more: Vec<(String, Stream)>, instead: &str| {
        recording_bytes(&[streams(&of, &[instead]), more].concat(), &BTreeMap::new(), &[]).unwrap()
    };
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 0x40;
    let pose =
        |to: &str| Stream::Transforms(vec![Pose::new(to, "camera_marker", of.camera_marker[0].isometry).at(SECOND_NS)]);
    let point = Stream::Tips(vec![("camera".into(), SECOND_NS, Point3::new(1.0, 2.0, 3.0))]);
    let files: [(&str, Vec<u8>); 14] = [
        ("empty.mcap", Vec::new()),
        ("first_bytes.mcap", whole[..5].to_vec()),
        ("cut.mcap", whole[..whole.len() * 6 / 10].to_vec()),
        ("cut_late.mcap", whole[..whole.len() - 9].to_vec()),
        ("flipped.mcap", flipped),
        ("magic.mcap", [&b"\x89NCAP0\r\n"[..], &whole[8..]].concat()),
        ("no_messages.mcap", recording_bytes::<String>(&[], &BTreeMap::new(), &[]).unwrap()),
        ("no_scan.mcap", without("/camera/scan")),
        ("no_laser.mcap", without("/camera/laser_p2")),
        ("other_frames.mcap", with(vec![("/tracker/camera_marker".into(), pose("lab"))], "/tracker/camera_marker")),
        ("points_as_scan.mcap", with(vec![("/camera/scan".into(), point)], "/camera/scan")),
        ("bag.db3", b"SQLite format 3\0and more".to_vec()),
        ("ros1.bag", b"#ROSBAG V2.0\nE\0\0\0".to_vec()),
        ("text.mcap", b"1 2 3\n4 5 6\n".to_vec()),
    ];
    for (name, bytes) in files {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let ran = run(GRAPH, &["--set", &format!("recording.path={}", path.display()), "--no-record"]);
        assert_ne!(ran.code, 0, "{name}: {}", ran.stderr);
        let refusal = ran.stderr.lines().find(|line| line.starts_with("refused: ") || line.starts_with("error: "));
        assert!(refusal.is_some_and(|line| line.contains(&path.display().to_string())), "{name}: {}", ran.stderr);
    }
}
