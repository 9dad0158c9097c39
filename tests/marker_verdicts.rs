//! What the verdict says of markers: motion with late poses, poses that contradict each other, messages without a stamp, a stylus that
//! contradicts the prediction, thresholds that were loosened, and an attitude that nothing has tested.

use crate::common::{Ran, case::Case, data, layouts, run};
use osteoflow_formats::{
    mcap_read::Recording,
    message_read::{MessageKind, read_cloud, read_pose_in_frame, read_transforms},
    recording_write::{Stream, recording_bytes},
};
use osteoflow_geometry::{
    Pose, StampNs,
    nalgebra::{Isometry3, Matrix4, Rotation3, UnitQuaternion, Vector3},
};
use serde_json::Value;
use std::{fs, path::Path};
use tempfile::TempDir;

/// The streams of the shipped recording by topic.
fn streams() -> Vec<(String, Stream)> {
    let read = Recording::open(&Case::shipped().recording, false).unwrap();
    let stream = |topic: &str| {
        let messages = read.messages(topic);
        match MessageKind::of(&messages[0].schema_name).unwrap() {
            MessageKind::Cloud => Stream::Clouds(messages.iter().map(|m| read_cloud(m).unwrap().cloud).collect()),
            MessageKind::Pose => {
                let tips = messages.iter().map(|m| read_pose_in_frame(m).unwrap());
                Stream::Tips(tips.map(|tip| (tip.frame, tip.stamp_ns, tip.position)).collect())
            }
            _ => {
                let poses = messages.iter().flat_map(|m| read_transforms(m).unwrap());
                Stream::Transforms(poses.map(|pose| pose.unwrap().value).collect())
            }
        }
    };
    let topics = read.topics();
    let topics = topics.iter().filter(|topic| topic.n_messages > 0);
    topics.map(|topic| (topic.name.clone(), stream(&topic.name))).collect()
}

/// The stamps of the clouds on a topic.
fn cloud_stamps(of: &str) -> Vec<StampNs> {
    let all = streams();
    let clouds = all.iter().filter(|(topic, _)| topic.starts_with(of)).flat_map(|(_, stream)| match stream {
        Stream::Clouds(clouds) => clouds.clone(),
        _ => Vec::new(),
    });
    clouds.map(|cloud| cloud.stamp_ns).collect()
}

/// The stamps of the points on a topic.
fn tip_stamps(of: &str) -> Vec<StampNs> {
    let all = streams();
    let tips = all.iter().filter(|(topic, _)| topic == of).flat_map(|(_, stream)| match stream {
        Stream::Tips(tips) => tips.clone(),
        _ => Vec::new(),
    });
    tips.map(|(_, stamp_ns, _)| stamp_ns).collect()
}

/// The shipped recording in a folder, with the poses of one topic replaced.
fn with_poses(topic: &str, change: impl Fn(&Pose) -> Vec<Pose>) -> (TempDir, Case) {
    let mut all = streams();
    for (_, stream) in all.iter_mut().filter(|(name, _)| name == topic) {
        let Stream::Transforms(poses) = stream else { panic!("{topic} has no poses") };
        *poses = poses.iter().flat_map(&change).collect();
    }
    written(&recording_bytes(&all, &Default::default(), &[]).unwrap())
}

fn written(bytes: &[u8]) -> (TempDir, Case) {
    let dir = tempfile::tempdir().unwrap();
    let recording = dir.path().join("changed.mcap");
    fs::write(&recording, bytes).unwrap();
    (dir, Case { recording, ..Case::shipped() })
}

/// A run of the recorded procedure without what the stylus measured.
fn without_stylus(dir: &Path, case: &Case, sets: &[&str]) -> Ran {
    let graph = dir.join("without_stylus.toml");
    let base = crate::common::root().join(crate::common::case::GRAPH);
    let text = format!("extends = \"{}\"\nremove = [\"node.verdict.in.measured\"]\n", base.display());
    fs::write(&graph, text).unwrap();
    let arguments: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).chain(["--no-record"]).collect();
    case.with_graph(graph.to_str().unwrap(), &case.plan, &arguments)
}

fn verdict(ran: &Ran) -> (String, Vec<String>, String) {
    let of = &ran.results["verdict"];
    let texts = |key: &str, of: &Value| -> Vec<String> {
        let all = of.as_array().into_iter().flatten();
        all.map(|one| one.get(key).unwrap_or(one).as_str().unwrap().to_owned()).collect()
    };
    let said = texts("reason", &of["reasons"]).join("\n");
    let assumed = texts("", &of["assumptions"]).join("\n");
    (
        of["answer"].as_str().unwrap_or_else(|| panic!("{}", ran.stderr)).to_owned(),
        texts("rule", &of["reasons"]),
        said + "\n" + &assumed,
    )
}

/// Time from the nearest of these stamps to the pose, s; from half a second on it returns to zero. A motion by it leaves the marker at
/// each stamp, and far from all, as recorded.
fn since(pose: &Pose, stamps: &[StampNs]) -> f64 {
    let since_ns = stamps.iter().map(|stamp_ns| pose.stamp_ns - stamp_ns).min_by_key(|ns| ns.abs()).unwrap_or(0);
    let s = since_ns as f64 / 1e9;
    s.signum() * s.abs().min((1.0 - s.abs()).max(0.0))
}

/// The marker moves at this speed, along a slanted line, about each stamp.
fn moving(mm_s: f64, stamps: Vec<StampNs>) -> impl Fn(&Pose) -> Vec<Pose> {
    move |pose| {
        // Past its place at each stamp, and back before the next.
        let s = since(pose, &stamps);
        let past_s = if s.abs() < 0.5 { s } else { s.signum() * (1.5 - 2.0 * s.abs()).max(0.0) };
        let shift = Vector3::new(0.6, -0.64, 0.48) * (mm_s * past_s);
        let isometry = Isometry3::from_parts((pose.isometry.translation.vector + shift).into(), pose.isometry.rotation);
        vec![Pose { isometry, ..pose.clone() }]
    }
}

#[test]
fn a_camera_that_moves_while_it_scans_is_doubtful_with_the_lateness_that_would_matter() {
    let stamps = || cloud_stamps("/camera/");
    // A scan of unknown length may be sheared by much less than what is too late: a short one is not.
    let short = ["to_world.duration_s=0.1"];
    for (mm_s, is_doubtful) in [(20.0, true), (-20.0, true), (5.0, true), (0.5, false)] {
        let (dir, case) = with_poses("/tracker/camera_marker", moving(mm_s, stamps()));
        let (answer, rules, said) = verdict(&without_stylus(dir.path(), &case, &short));
        assert_eq!(
            (answer == "doubtful", rules.contains(&"motion".into())),
            (is_doubtful, is_doubtful),
            "{mm_s} mm/s: {said}"
        );
        if mm_s == 20.0 {
            assert!(
                said.contains("the camera marker moved what it carries by ") && said.contains("during scan"),
                "{said}"
            );
            // 1.5 mm are reached after 0.075 s.
            assert!(said.contains("poses later than 0.07 s") || said.contains("poses later than 0.08 s"), "{said}");
        }
    }
    // Where tracker and camera share a clock, a motion of less than a millimetre is sound; said, since it is laxer.
    let (dir, case) = with_poses("/tracker/camera_marker", moving(20.0, stamps()));
    let sets = ["verdict.rules.max_latency_s=0.001", "verdict.rules.max_moved_mm=100", "to_world.duration_s=0.01"];
    let (answer, _, said) = verdict(&without_stylus(dir.path(), &case, &sets));
    assert_eq!(answer, "trusted", "{said}");
    assert!(
        said.contains("rules.max_moved_mm = 100 (default 1)")
            && said.contains("rules.max_latency_s = 0.001 (default 0.1)"),
        "{said}"
    );
}

#[test]
fn a_camera_that_moves_after_the_stamp_of_its_scan_by_more_than_a_millimetre_is_doubtful() {
    let stamps = cloud_stamps("/camera/");
    for (mm_s, is_doubtful) in [(5.0, true), (1.5, false)] {
        let away = |pose: &Pose| {
            let shift = Vector3::new(0.6, -0.8, 0.0) * (mm_s * since(pose, &stamps).max(0.0));
            let isometry =
                Isometry3::from_parts((pose.isometry.translation.vector + shift).into(), pose.isometry.rotation);
            vec![Pose { isometry, ..pose.clone() }]
        };
        let (dir, case) = with_poses("/tracker/camera_marker", away);
        let (answer, rules, said) = verdict(&without_stylus(dir.path(), &case, &["to_world.duration_s=0.1"]));
        assert_eq!((answer == "doubtful", rules == ["motion"]), (is_doubtful, is_doubtful), "{mm_s} mm/s: {said}");
        assert_eq!(said.contains("s after scan, P1, P2 and P3: poses that are 0.1 s late"), is_doubtful, "{said}");
    }
}

#[test]
fn poses_half_a_second_late_are_doubtful_where_the_recording_begins_with_the_scan() {
    let stamps = cloud_stamps("/camera/");
    let late_ns = 500_000_000;
    let late = |mm_s: f64| {
        let (moved, calibrated_ns) = (moving(mm_s, stamps.clone()), stamps.iter().min().unwrap() + late_ns);
        move |pose: &Pose| {
            let later = |moved: Pose| Pose { stamp_ns: moved.stamp_ns + late_ns, ..moved };
            let is_calibration = pose.stamp_ns < calibrated_ns;
            moved(pose).into_iter().map(|moved| if is_calibration { pose.clone() } else { later(moved) }).collect()
        }
    };
    for (mm_s, expected) in [(5.0, "doubtful"), (0.0, "trusted")] {
        let (dir, case) = with_poses("/tracker/camera_marker", late(mm_s));
        let (answer, rules, said) = verdict(&without_stylus(dir.path(), &case, &[]));
        assert_eq!(answer, expected, "{mm_s} mm/s: {rules:?} {said}");
    }
}

#[test]
fn a_bone_that_moves_while_it_is_scanned_is_doubtful_and_between_scans_it_may() {
    let (dir, case) = with_poses("/tracker/bone_marker", moving(20.0, cloud_stamps("/camera/")));
    let (answer, rules, said) = verdict(&without_stylus(dir.path(), &case, &[]));
    assert!(answer == "doubtful" && rules.contains(&"motion".into()), "{said}");
    assert!(said.contains("the bone marker moved what it carries by ") && said.contains("during scan"), "{said}");
    // Under the stylus it counts where the stylus measures.
    let (dir, case) = with_poses("/tracker/bone_marker", moving(10.0, tip_stamps("/stylus/assessment")));
    // It goes back between touches faster than a hand brings it.
    let unjudged = ["recording.out.bone_marker.motion.hand_mm_s=0.0", "planes_last.hand_mm_s=0.0"];
    let sets = ["--no-record", "--set", unjudged[0], "--set", unjudged[1]];
    let measured = case.with_graph(crate::common::case::GRAPH, &case.plan, &sets);
    let (answer, rules, said) = verdict(&measured);
    assert!(answer == "doubtful" && rules.contains(&"motion".into()) && said.contains("during M1"), "{answer}: {said}");
    assert_eq!(verdict(&without_stylus(dir.path(), &case, &unjudged)).0, "trusted", "nothing was measured");
    let sound = without_stylus(dir.path(), &Case::shipped(), &[]);
    assert_eq!(verdict(&sound).0, "trusted", "the bone of the shipped recording moves on after the scans");
}

#[test]
fn a_camera_that_turns_about_its_marker_moves_what_it_sees() {
    let stamps = cloud_stamps("/camera/");
    let turning = |pose: &Pose| {
        let s = since(pose, &stamps);
        let rotation =
            pose.isometry.rotation * UnitQuaternion::from_scaled_axis(Vector3::x() * (8_f64.to_radians() * s));
        vec![Pose { isometry: Isometry3::from_parts(pose.isometry.translation, rotation), ..pose.clone() }]
    };
    let (dir, case) = with_poses("/tracker/camera_marker", turning);
    let (answer, rules, said) = verdict(&without_stylus(dir.path(), &case, &[]));
    assert!(answer == "doubtful" && rules.contains(&"motion".into()), "{answer}: {said}");
}

#[test]
fn a_stylus_that_contradicts_the_prediction_is_doubtful_though_below_its_limit() {
    let mut all = streams();
    for (_, stream) in all.iter_mut().filter(|(topic, _)| topic == "/stylus/assessment") {
        let Stream::Tips(tips) = stream else { panic!("no tips") };
        tips.iter_mut().for_each(|(_, _, position)| *position += Vector3::new(1.2, 1.2, -1.0));
    }
    let (_dir, case) = written(&recording_bytes(&all, &Default::default(), &[]).unwrap());
    let ran = case.with_graph(crate::common::case::GRAPH, &case.plan, &["--no-record"]);
    let (answer, rules, said) = verdict(&ran);
    assert!(answer == "doubtful" && rules == ["stylus"], "{answer} {rules:?}: {said}");
    assert!(
        said.contains("which contradicts the predicted error of")
            && said.contains("mm: both and the stylus' own error explain"),
        "{said}"
    );
    // A worse stylus explains it, and is told.
    let arguments = ["--no-record", "--set", "verdict.rules.stylus.tip_mm=1.0"];
    let (answer, _, said) = verdict(&case.with_graph(crate::common::case::GRAPH, &case.plan, &arguments));
    assert!(answer == "trusted" && said.contains("rules.stylus.tip_mm = 1 (default 0.2)"), "{answer}: {said}");
}

#[test]
fn poses_that_are_late_while_the_camera_moves_are_doubtful_without_a_stylus() {
    let test = "poses_that_are_late_while_the_camera_moves_are_doubtful_without_a_stylus";
    let Some(recording) = data(test, "../cases/trust/poses_100ms_late_at_20mm_s.mcap") else { return };
    let Some(bone) = data(test, "bones/TLEM2_CT_fibula_r.stl") else { return };
    let phantom = data(test, "bones/calibration_phantom.stl").unwrap();
    let plan = recording.with_file_name("poses_100ms_late_at_20mm_s.plan.json");
    let case = Case { recording, bone, phantom, plan, truth: Value::Null };
    let dir = tempfile::tempdir().unwrap();
    let (answer, rules, said) = verdict(&without_stylus(dir.path(), &case, &["to_world.duration_s=0.01"]));
    assert!(answer == "doubtful" && rules == ["motion"], "{rules:?}: {said}");
    // With it the reading of 2 mm contradicts the prediction of half a millimetre.
    let sets = ["--no-record", "--set", "to_world.duration_s=0.01"];
    let (_, rules, said) = verdict(&case.with_graph(crate::common::case::GRAPH, &case.plan, &sets));
    assert!(rules.contains(&"stylus".into()), "{said}");
}

#[test]
fn transforms_that_contradict_each_other_at_one_stamp_are_told_and_doubtful_and_equal_ones_are_one() {
    let twice = |by: Isometry3<f64>| {
        move |pose: &Pose| vec![pose.clone(), Pose { isometry: pose.isometry * by, ..pose.clone() }]
    };
    let (_dir, case) = with_poses("/tracker/bone_marker", |pose| vec![pose.clone()]);
    let once = case.with_graph(crate::common::case::GRAPH, &case.plan, &["--no-record"]);
    let (_dir, case) = with_poses("/tracker/bone_marker", twice(Isometry3::identity()));
    let equal = case.with_graph(crate::common::case::GRAPH, &case.plan, &["--no-record"]);
    assert_eq!(equal.results["poses"], once.results["poses"]);
    assert!(!equal.stderr.contains("contradict"), "{}", equal.stderr);
    for (by, words) in [
        (Isometry3::translation(2.0, 0.0, 0.0), "up to 2.00 mm and 0.00 degrees apart"),
        (Isometry3::rotation(Vector3::x() * 0.01), "up to 0.00 mm and 0.57 degrees apart"),
    ] {
        for topic in ["/tracker/bone_marker", "/tracker/camera_marker"] {
            let (dir, case) = with_poses(topic, twice(by));
            let ran = without_stylus(dir.path(), &case, &[]);
            assert!(
                ran.stderr.contains(&format!("topic {topic}: t_world_")) && ran.stderr.contains(words),
                "{}",
                ran.stderr
            );
            let (answer, rules, said) = verdict(&ran);
            assert!(answer != "trusted" && rules.contains(&"contradiction".into()), "{topic}: {answer} {said}");
        }
    }
    // At the last sample alone the planes are unknown.
    let all = streams();
    let last_ns = all.iter().filter(|(topic, _)| topic == "/tracker/bone_marker").map(|(_, stream)| match stream {
        Stream::Transforms(poses) => poses.iter().map(|pose| pose.stamp_ns).max().unwrap(),
        _ => panic!("no poses"),
    });
    let last_ns = last_ns.max().unwrap();
    let (dir, case) = with_poses("/tracker/bone_marker", |pose| match pose.stamp_ns == last_ns {
        true => twice(Isometry3::translation(3.0, 0.0, 0.0))(pose),
        false => vec![pose.clone()],
    });
    let (answer, rules, said) = verdict(&without_stylus(dir.path(), &case, &[]));
    assert!(answer == "doubtful" && rules == ["planes_lost"], "{answer} {rules:?}: {said}");
    assert!(said.contains("poses of one stamp that put them 3.0 mm"), "{said}");
    // Twice and once more, as where three programs send it.
    let thrice = |pose: &Pose| {
        [0.0, 2.0, 0.0]
            .map(|x| Pose { isometry: pose.isometry * Isometry3::translation(x, 0.0, 0.0), ..pose.clone() })
            .to_vec()
    };
    let (dir, case) = with_poses("/tracker/bone_marker", thrice);
    assert!(verdict(&without_stylus(dir.path(), &case, &[])).1.contains(&"contradiction".into()));
}

#[test]
fn rows_of_a_table_that_contradict_each_other_at_one_stamp_are_told_and_doubtful() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("folder");
    crate::common::copy_folder(&crate::common::root().join("tests/data/folder"), &folder);
    let table = fs::read_to_string(folder.join("poses.csv")).unwrap();
    let twice = |row: &str| {
        let mut fields: Vec<String> = row.split(',').map(str::to_owned).collect();
        if fields[2] != "bone_marker" {
            return row.to_owned();
        }
        fields[3] = (fields[3].parse::<f64>().unwrap() + 2.0).to_string();
        format!("{row}\n{row}\n{}", fields.join(","))
    };
    let rows: Vec<String> = table.lines().map(twice).collect();
    fs::write(folder.join("poses.csv"), rows.join("\n")).unwrap();
    let path = format!("recording.path={}", folder.display());
    let ran = run("graphs/fibula_folder.toml", &["--no-record", "--set", &path]);
    let words = [
        "t_world_bone_marker: ",
        "stamps have poses that contradict each other",
        "up to 2.00 mm and 0.00 degrees apart",
    ];
    assert!(words.iter().all(|words| ran.stderr.contains(words)), "{}", ran.stderr);
    let (answer, rules, said) = verdict(&ran);
    assert!(answer != "trusted" && rules.contains(&"contradiction".into()), "{answer}: {said}");
}

#[test]
fn a_pose_of_a_table_or_a_recording_whose_stamp_was_damaged_is_left_out_by_itself_and_nothing_else_changes() {
    let dir = tempfile::tempdir().unwrap();
    let shipped = crate::common::root().join("tests/data/folder");
    let table = fs::read_to_string(shipped.join("poses.csv")).unwrap();
    let rows: Vec<&str> = table.lines().collect();
    let of_bone: Vec<usize> = (0..rows.len()).filter(|k| rows[*k].contains(",bone_marker,")).collect();
    let at = of_bone[of_bone.len() / 2];
    let (_, pose) = rows[at].split_once(',').unwrap();
    let ran = |rows: &[&str]| {
        let folder = dir.path().join("folder");
        crate::common::copy_folder(&shipped, &folder);
        fs::write(folder.join("poses.csv"), rows.join("\n")).unwrap();
        let ran = run(
            "graphs/fibula_folder.toml",
            &["--no-record", "--set", &format!("recording.path={}", folder.display())],
        );
        fs::remove_dir_all(&folder).unwrap();
        ran
    };
    // The years 2106 and 1970, in the middle of the file.
    let sound = ran(&rows);
    for stamp_ns in ["4292000000000000000", "1000000000"] {
        let damaged = format!("{stamp_ns},{pose}");
        let mut rows = rows.clone();
        rows[at] = &damaged;
        let ran = ran(&rows);
        let told = format!("t_world_bone_marker: 1 pose is left out, the stamp {stamp_ns} ns of the first is far from");
        assert!(ran.stderr.contains(&told) && ran.stderr.contains("stray_stamps"), "{}", ran.stderr);
        assert_eq!(ran.results["planes_at_scan"], sound.results["planes_at_scan"]);
        // What is said of the last planes rests on the last pose.
        let last = |ran: &Ran| ran.stderr.lines().find(|line| line.contains("the last planes")).map(str::to_owned);
        assert!(last(&ran).is_some() && last(&ran) == last(&sound), "{}", ran.stderr);
    }
}

/// The shipped recording with the stamps of these topics left out.
fn without_stamps(topics: &[&str]) -> (TempDir, Case) {
    let all = streams();
    let layout =
        layouts::Layout { unstamped: topics.iter().map(|topic| (*topic).to_owned()).collect(), ..Default::default() };
    written(&layouts::recording_bytes(&all, &Default::default(), &[], &layout))
}

#[test]
fn messages_without_a_stamp_are_refused_where_a_pose_moves_unless_their_time_of_publication_is_asked_for() {
    for topic in ["/camera/scan", "/tracker/bone_marker", "/stylus/assessment"] {
        let (_dir, case) = without_stamps(&[topic]);
        let ran = case.with_graph(crate::common::case::GRAPH, &case.plan, &["--no-record"]);
        assert_eq!(ran.code, 3, "{topic}: {}", ran.stderr);
        for words in [
            format!("topic {topic}: "),
            "messages have no stamp".into(),
            ".unstamped = \"publish_time\"".into(),
            "node \"recording\"".into(),
        ] {
            assert!(ran.stderr.contains(&words), "{topic}: {words}: {}", ran.stderr);
        }
    }
    let topics: Vec<String> = streams().into_iter().map(|(topic, _)| topic).collect();
    let (_dir, case) = without_stamps(&topics.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(case.with_graph(crate::common::case::GRAPH, &case.plan, &["--no-record"]).code, 3, "none has a stamp");
    let (_dir, case) = without_stamps(&["/camera/scan"]);
    let arguments = ["--no-record", "--set", "recording.out.scan.unstamped=publish_time"];
    let ran = case.with_graph(crate::common::case::GRAPH, &case.plan, &arguments);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(
        ran.stderr.contains(
            "topic /camera/scan: 1 of 1 messages have no stamp; the time at which they were published is used"
        ),
        "{}",
        ran.stderr
    );
    // A constant holds at any time.
    let (_dir, case) = without_stamps(&["/phantom/marker_cad"]);
    assert_eq!(case.with_graph(crate::common::case::GRAPH, &case.plan, &["--no-record"]).code, 0);
}

#[test]
fn the_planes_as_last_followed_have_an_error_of_their_own_and_the_attitude_is_an_assumption() {
    let ran = run(crate::common::case::GRAPH, &["--no-record"]);
    let last = &ran.results["verdict"]["predicted"]["last"];
    let error = |of: &Value| of["cuts"][0]["tre_mm"].as_f64().unwrap();
    assert!(last["turned_deg"].as_f64().unwrap() > 1.0, "{last}");
    assert!(error(last) > error(&ran.results["verdict"]["predicted"]), "{last}");
    let (_, _, said) = verdict(&ran);
    assert!(said.contains("the predicted error is that of the scan's instant; the bone has turned by"), "{said}");
    assert!(said.contains("the attitude of the bone's marker is read as it was written"), "{said}");
}

/// The poses of a marker in a log of PLUS, with the times at which they were measured.
fn plus_log(path: &Path, marker: &str) -> Vec<Pose> {
    let bytes = fs::read(path).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    let field = |frame: usize, name: &str| {
        let key = format!("Seq_Frame{frame:04}_{name} = ");
        text.lines().find_map(|line| line.strip_prefix(&key)).map(str::trim)
    };
    let pose = |frame: usize| {
        let ok = field(frame, &format!("{marker}TransformStatus"))?;
        let numbers =
            field(frame, &format!("{marker}Transform"))?.split_whitespace().map(|n| n.parse::<f64>().unwrap());
        let matrix = Matrix4::from_row_iterator(numbers);
        let rotation = Rotation3::from_matrix(&matrix.fixed_view::<3, 3>(0, 0).into_owned());
        let shift = matrix.fixed_view::<3, 1>(0, 3).into_owned();
        let isometry = Isometry3::from_parts(shift.into(), UnitQuaternion::from_rotation_matrix(&rotation));
        let seconds: f64 = field(frame, "Timestamp")?.parse().unwrap();
        let stamp_ns = 1_750_000_000_000_000_000 + (seconds * 1e9) as StampNs;
        (ok == "OK").then(|| Pose::new("world", "marker", isometry).at(stamp_ns))
    };
    (0..).map_while(|frame| field(frame, "Timestamp").map(|_| pose(frame))).flatten().collect()
}

#[test]
fn a_measured_marker_at_rest_moves_in_at_most_one_window_of_a_hundred() {
    let test = "a_measured_marker_at_rest_moves_in_at_most_one_window_of_a_hundred";
    let Some(log) = data(test, "real/plus/ReferenceToRASCalibration.igs.mha") else { return };
    let poses = plus_log(&log, "ReferenceToTracker");
    let n = poses.len();
    assert!(n > 90, "{n} poses");
    let moving = |mm_s: f64| {
        let first_ns = poses[0].stamp_ns;
        let moved = poses.iter().map(|pose| {
            let s = (pose.stamp_ns - first_ns) as f64 / 1e9;
            let at = Vector3::new(0.6, -0.64, 0.48) * (mm_s * (s - 4.0).clamp(0.0, 1.0));
            Pose { isometry: Isometry3::translation(at.x, at.y, at.z) * pose.isometry, ..pose.clone() }
        });
        let dir = tempfile::tempdir().unwrap();
        let streams = [("/tracker/marker", Stream::Transforms(moved.collect()))];
        fs::write(dir.path().join("rest.mcap"), recording_bytes(&streams, &Default::default(), &[]).unwrap()).unwrap();
        let graph = "[graph]\nformat = 1\nframes = [\"world\", \"marker\"]\n[node.recording]\nkind = \"acquire.mcap\"\npath = \"rest.mcap\"\n\
                     out.marker = { type = \"geometry/Pose\", topic = \"/tracker/marker\", to = \"world\", from = \"marker\" }\n\
                     [node.still]\nkind = \"transform.still_average\"\nin = { pose = \"recording.marker\" }\n\
                     [results]\nmotion = { from = \"still.motion\", all = true }\n";
        fs::write(dir.path().join("rest.toml"), graph).unwrap();
        let ran = run(dir.path().join("rest.toml").to_str().unwrap(), &["--no-record"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let is_moved = |report: &Value| {
            let of = |key: &str| report[key].as_f64().unwrap();
            of("moved_mm") > of("explained_mm").max(0.1) || of("moved_rad") > of("explained_rad").max(0.0005)
        };
        ran.results["motion"].as_array().unwrap().iter().filter(|report| is_moved(report)).count()
    };
    // 30 of them by the noise within the window alone.
    assert!(moving(0.0) <= n / 100 + 1, "{} of {n} windows move at rest", moving(0.0));
    assert!(moving(2.0) >= 10, "a millimetre in half a second for a second: {} of {n} windows", moving(2.0));
}
