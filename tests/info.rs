//! `osteoflow info` and `osteoflow runs`: what files and folders hold.

use crate::common::{WHITE, copied_run, json as json_of, osteoflow, root, shared_run};
use osteoflow_formats::{
    mcap_read::Recording,
    message_read::{read_cloud, read_transforms},
    recording_write::{Stream, recording_bytes},
};
use osteoflow_geometry::{Pose, nalgebra::Isometry3};
use serde_json::{Value, json};
use std::{fs, path::Path, process::Output};

fn info(file: &Path) -> Output {
    osteoflow().arg("info").arg(file).args(["--format", "json"]).output().unwrap()
}

fn found(file: &Path) -> Value {
    let output = info(file);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn each_file_of_the_shipped_procedures_is_named_with_what_it_holds() {
    let data = root().join("tests/data");
    let bone = found(&data.join("folder/bone.stl"));
    assert_eq!((&bone["kind"], &bone["n_faces"]), (&json!("mesh"), &json!(84_792)));
    let length_mm = bone["extent_mm"].as_array().unwrap().iter().map(|mm| mm.as_f64().unwrap()).fold(0.0, f64::max);
    assert!((300.0..420.0).contains(&length_mm), "{length_mm} mm is no length of a fibula");
    let scan = found(&data.join("folder/scan.ply"));
    assert_eq!((&scan["kind"], &scan["n_points"], &scan["n_dropped"]), (&json!("cloud"), &json!(10_000), &json!(0)));
    assert!(scan["use"][0].as_str().unwrap().starts_with("osteoflow register BONE "), "{scan}");
    let plan = found(&data.join("procedure/plan.json"));
    assert_eq!((&plan["kind"], &plan["n_planes"]), (&json!("plan"), &json!(2)));
    assert_eq!(plan["labels"][0], "P1");
    let folder = found(&data.join("folder"));
    assert_eq!(folder["kind"], "procedure");
    let recording = found(&data.join("procedure/procedure.mcap"));
    assert_eq!((&recording["kind"], &recording["problems"]), (&json!("recording"), &json!([])));
    let topics = recording["topics"].as_array().unwrap();
    let scan = topics.iter().find(|topic| topic["name"] == "/camera/scan").unwrap();
    assert_eq!((&scan["schema"], &scan["frame"]), (&json!("foxglove.PointCloud"), &json!("camera")));
    let marker = topics.iter().find(|topic| topic["name"] == "/tracker/bone_marker").unwrap();
    assert_eq!(marker["frame"], "world -> bone_marker");
    assert!(marker["rate_hz"].as_f64().unwrap() > 1.0 && marker["last_ns"].as_i64() > marker["first_ns"].as_i64());
}

#[test]
fn a_recording_is_given_a_command_that_works_on_what_it_holds_and_all_its_pairs_of_frames() {
    let data = root().join("tests/data");
    let recording = found(&data.join("procedure/procedure.mcap"));
    assert!(
        recording["use"][0].as_str().unwrap().starts_with("osteoflow run graphs/fibula_recorded.toml "),
        "{recording}"
    );
    // The graph names no other topics without which it cannot run.
    let graph: toml::Table = fs::read_to_string(root().join("graphs/fibula_recorded.toml")).unwrap().parse().unwrap();
    let mut needed: Vec<String> = Vec::new();
    for port in graph["node"]["recording"]["out"].as_table().unwrap().values() {
        let is_optional = port.get("optional").is_some_and(|optional| optional.as_bool() == Some(true));
        let topics = port.get("topics").and_then(toml::Value::as_array).into_iter().flatten().chain(port.get("topic"));
        needed.extend(topics.filter(|_| !is_optional).map(|topic| topic.as_str().unwrap().to_owned()));
    }
    let recorded = Recording::open(&data.join("procedure/procedure.mcap"), false).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let transform = |parent: &str, child: &str| Pose::new(parent, child, Isometry3::identity()).at(1_000_000_000);
    let scan = read_cloud(&recorded.messages("/camera/scan")[0]).unwrap().cloud;
    let tf = (
        "/tf",
        Stream::Transforms(vec![transform("map", "base"), transform("base", "arm"), transform("arm", "camera")]),
    );
    let bag = |name: &str, streams: &[(&str, Stream)]| {
        let path = dir.path().join(name);
        fs::write(&path, recording_bytes(streams, &Default::default(), &[]).unwrap()).unwrap();
        (found(&path), path)
    };
    let (clouds, path) = bag("clouds.mcap", &[tf.clone(), ("/points", Stream::Clouds(vec![scan]))]);
    assert_eq!(clouds["frames"], json!(["arm -> camera", "base -> arm", "camera", "map -> base"]));
    assert_eq!(clouds["topics"][0]["frames"], json!(["arm -> camera", "base -> arm", "map -> base"]));
    let first = clouds["use"][0].as_str().unwrap();
    assert_eq!(first, format!("osteoflow convert {} scan.ply --topic /points", path.display()));
    let done = convert(&path, &dir.path().join("scan.ply"), &["--topic", "/points"]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(found(&dir.path().join("scan.ply"))["kind"], "cloud");
    let (poses, path) = bag("poses.mcap", &[tf]);
    assert_eq!(poses["use"], json!([format!("osteoflow view {}", path.display())]));
    // Without any one of what the graph needs, it is not recommended.
    needed.retain(|topic| !topic.is_empty());
    assert!(needed.len() == 7 && needed.contains(&"/camera/scan".to_owned()), "{needed:?}");
}

#[test]
fn the_command_for_a_procedure_fits_the_frames_of_its_recording() {
    let recorded = Recording::open(&root().join("tests/data/procedure/procedure.mcap"), false).unwrap();
    let transforms = |topic: &str, child: &str| {
        let read = recorded.messages(topic).iter().flat_map(|message| read_transforms(message).unwrap());
        let pose = read.map(|pose| pose.unwrap().value);
        Stream::Transforms(pose.map(|pose| Pose { to: "tracker_base".into(), from: child.into(), ..pose }).collect())
    };
    let clouds = |topic: &str| {
        let read = recorded.messages(topic).iter().map(|message| read_cloud(message).unwrap().cloud);
        Stream::Clouds(read.map(|cloud| cloud.transformed("optical.left", &Isometry3::identity())).collect())
    };
    let mut streams: Vec<(String, Stream)> = ["calibration", "scan", "laser_p1", "laser_p2", "laser_p3"]
        .map(|name| format!("/camera/{name}"))
        .map(|topic| (topic.clone(), clouds(&topic)))
        .into();
    for (name, child) in
        [("camera_marker", "camera_marker"), ("phantom_marker", "tool_2"), ("bone_marker", "bone_marker")]
    {
        let topic = format!("/tracker/{name}");
        streams.push((topic.clone(), transforms(&topic, child)));
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("renamed.mcap");
    fs::write(&path, recording_bytes(&streams, &recorded.metadata, &[]).unwrap()).unwrap();
    let command = found(&path)["use"][0].as_str().unwrap().to_owned();
    let out = dir.path().join("run");
    assert!(command.contains("--set 'recording.frames.\"optical.left\"=camera'"), "{command}");
    let words = command.split(' ').skip(1).map(|word| word.trim_matches('\''));
    let done = osteoflow().current_dir(root()).args(words).arg("--out").arg(&out).output().unwrap();
    assert_eq!(done.status.code(), Some(0), "{command}\n{}", String::from_utf8_lossy(&done.stderr));
    let origins = |dir: &Path| -> Vec<f64> {
        let planes = json_of(&dir.join("results.json"))["planes_at_scan"].as_array().unwrap().clone();
        planes.iter().flat_map(|plane| (0..3).map(|k| plane["matrix"][k][3].as_f64().unwrap())).collect()
    };
    let (found, expected) = (origins(&out), origins(shared_run("graphs/fibula_recorded.toml", &[]).dir.path()));
    assert_eq!((found.len(), expected.len()), (6, 6));
    assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}, not {expected:?}");
}

#[test]
fn points_that_are_not_finite_are_counted_and_a_matrix_is_no_cloud() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        fs::write(dir.path().join(name), text).unwrap();
        dir.path().join(name)
    };
    let cloud = found(&write("a.bin", "x,y,z\n0,0,0\n10,20,30\nnan,0,0\n"));
    assert_eq!((&cloud["n_points"], &cloud["n_dropped"]), (&json!(2), &json!(1)));
    assert_eq!(cloud["extent_mm"], json!([10.0, 20.0, 30.0]));
    let pose = found(&write("b.xyz", "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n"));
    assert_eq!((&pose["kind"], &pose["matrix"][2][3]), (&json!("pose"), &json!(7.0)));
}

#[test]
fn a_cut_recording_is_read_in_part_with_its_problem_and_what_cannot_be_read_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = fs::read(shared_run("graphs/fibula.toml", &[]).path("run.mcap")).unwrap();
    let cut = dir.path().join("cut.mcap");
    fs::write(&cut, &bytes[..bytes.len() - 3000]).unwrap();
    let found = found(&cut);
    let problems = found["problems"].as_array().unwrap();
    assert!(problems.len() == 1 && problems[0].as_str().unwrap().contains("the file ends "), "{problems:?}");
    assert!(!found["topics"].as_array().unwrap().is_empty());
    assert!(found["use"][0].as_str().unwrap().starts_with("osteoflow recover "), "{found}");

    for (name, bytes, expected) in [
        ("empty.stl", &b""[..], "empty.stl: byte 0: the file is empty"),
        ("head.mcap", &bytes[..4], "head.mcap: "),
        ("other.json", b"{\"a\": 1}", "other.json: "),
        ("broken.json", b"{\"a\": ", "broken.json: line 1: no JSON"),
        ("noise.bin", &[7; 300], "noise.bin: "),
    ] {
        let file = dir.path().join(name);
        fs::write(&file, bytes).unwrap();
        let output = info(&file);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && stderr.contains(expected), "{name}: {stderr}");
    }
    let nothing = dir.path().join("nothing");
    fs::create_dir(&nothing).unwrap();
    for (folder, expected) in [
        (
            &nothing,
            "a folder without procedure.toml, manifest.json or metadata.yaml (a ROS 2 bag), and no DICOM series: ",
        ),
        (&dir.path().to_path_buf(), "head.mcap: "),
    ] {
        let output = info(folder);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && stderr.contains(expected), "{stderr}");
    }
}

#[test]
fn runs_are_listed_with_verdict_and_error_and_a_broken_one_with_its_problem() {
    let (dir, run) = copied_run("graphs/fibula.toml", &[&["--no-record"], &WHITE[..]].concat());
    let out = dir.path().join("one");
    fs::rename(run, &out).unwrap();
    assert_eq!(found(&out)["verdict"], "trusted");
    assert_eq!(found(&out)["use"], json!([format!("osteoflow report {}", out.display())]), "it was not recorded");
    fs::create_dir(dir.path().join("two")).unwrap();
    fs::write(dir.path().join("two/manifest.json"), "{").unwrap();
    let two = found(&dir.path().join("two"));
    assert_eq!(two["use"], json!([]), "{two}");
    assert!(two["problems"].to_string().contains("manifest.json: EOF"), "{two}");
    let listed = osteoflow().arg("runs").arg(dir.path()).args(["--format", "json"]).output().unwrap();
    let rows: Value = serde_json::from_slice(&listed.stdout).unwrap();
    let row = |name: &str| rows.as_array().unwrap().iter().find(|row| row["folder"] == name).unwrap().clone();
    let results: Value = serde_json::from_slice(&fs::read(out.join("results.json")).unwrap()).unwrap();
    let one = row("one");
    assert_eq!((&one["graph"], &one["verdict"], &one["tre"]), (&json!("fibula"), &json!("trusted"), &json!("true")));
    assert_eq!(one["tre_mm"], results["metrics"]["tre_true_mm"]["mean_abs"]["norm"]);
    assert!(row("two")["problem"].as_str().unwrap().contains("manifest.json"), "{rows}");
    let text = osteoflow().arg("runs").arg(dir.path()).output().unwrap();
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("trusted") && text.contains("problem: "), "{text}");
}

#[test]
fn a_study_lists_its_series_with_what_chooses_them_and_one_with_a_single_ct_is_it() {
    let volumes = root().join("nodes/bone/formats/tests/data/volumes");
    let study = found(&volumes.join("study"));
    assert_eq!((&study["kind"], &study["size"]), (&json!("ct"), &json!([34, 33, 3])));
    assert!(study["notes"].to_string().contains("left out, as no CT: CT series 401"), "{study}");

    let dir = tempfile::tempdir().unwrap();
    for name in ["plain", "jpeg_2000"] {
        fs::create_dir(dir.path().join(name)).unwrap();
        for k in 0..3 {
            let file = format!("{name}/I{k}");
            fs::copy(volumes.join(&file), dir.path().join(&file)).unwrap();
        }
    }
    let both = found(dir.path());
    assert_eq!((&both["kind"], both["series"].as_array().unwrap().len()), (&json!("study"), 2), "{both}");
    let surface = |k: usize| {
        let choice = both["series"][k]["choice"].as_str().unwrap();
        assert!(both["use"][0].as_str().unwrap().contains(" --series ") && both["series"][k]["why_not"].is_null());
        let out = dir.path().join(format!("{k}.stl"));
        let output = convert(dir.path(), &out, &["--iso-hu", "300", "--series", choice]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        fs::read(out).unwrap()
    };
    assert_eq!(surface(0), surface(1), "the same layers, compressed and not");
    let output = convert(dir.path(), &dir.path().join("none.stl"), &["--iso-hu", "300"]);
    let refusal = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        refusal.contains("2 series; choose one by its number or the ending of its identifier, --series"),
        "{refusal}"
    );
    let output = convert(&root().join("tests/data/folder/bone.stl"), &dir.path().join("b.ply"), &["--series", "1"]);
    assert_eq!(output.status.code(), Some(2));
}

fn convert(input: &Path, output: &Path, arguments: &[&str]) -> Output {
    osteoflow().arg("convert").arg(input).arg(output).args(arguments).output().unwrap()
}

/// The rows of a CSV without its heading, the last three cells as numbers.
fn rows(file: &Path) -> Vec<[f64; 3]> {
    let text = fs::read_to_string(file).unwrap();
    let row = |line: &str| {
        let cells: Vec<f64> = line.rsplit(',').take(3).map(|cell| cell.parse().unwrap()).collect();
        [cells[2], cells[1], cells[0]]
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn the_same_points_come_out_of_every_format_that_they_are_converted_through() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let points = [[1.25, -2.5, 300.125], [-40.0, 8.75, 0.5], [7.0, 9.5, -11.25]];
    let text: String = points.iter().map(|[x, y, z]| format!("{x},{y},{z}\n")).collect();
    fs::write(at("cloud.csv"), format!("x,y,z\n{text}")).unwrap();
    for through in ["a.ply", "a.pcd", "a.obj"] {
        let back = at(through).with_extension("csv");
        for (from, to) in [(at("cloud.csv"), at(through)), (at(through), back.clone())] {
            let _ = fs::remove_file(&to);
            let done = convert(&from, &to, &[]);
            assert!(done.status.success(), "{through}: {}", String::from_utf8_lossy(&done.stderr));
        }
        let found = rows(&back);
        let off = |(a, b): (&[f64; 3], &[f64; 3])| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(
            found.len() == 3 && found.iter().zip(&points).map(off).fold(0.0, f64::max) < 1e-4,
            "{through}: {found:?}"
        );
        assert!(fs::read_to_string(&back).unwrap().starts_with("x,y,z\n"), "{through}");
    }
    let scaled = convert(&at("cloud.csv"), &at("scaled.csv"), &["--scale", "1000"]);
    assert!(scaled.status.success() && rows(&at("scaled.csv"))[0] == [1250.0, -2500.0, 300_125.0]);

    // Picked points: a format that claims a space needs one, and RAS numbers are turned to LPS.
    fs::write(at("picks.csv"), "label,x,y,z\nP1,1,2,3\nP2,4,5,6\n").unwrap();
    let refused = convert(&at("picks.csv"), &at("picks.mrk.json"), &[]);
    let stderr = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(2) && stderr.contains("states no space"), "{stderr}");
    assert!(!at("picks.mrk.json").exists());
    assert!(convert(&at("picks.csv"), &at("picks.mrk.json"), &["--space", "RAS"]).status.success());
    assert!(convert(&at("picks.mrk.json"), &at("lps.csv"), &[]).status.success());
    assert_eq!(fs::read_to_string(at("lps.csv")).unwrap(), "label,x,y,z\nP1,-1,-2,3\nP2,-4,-5,6\n");
    assert_eq!(found(&at("picks.mrk.json"))["space"], "LPS");
    let stated = convert(&at("picks.mrk.json"), &at("again.csv"), &["--space", "RAS"]);
    let stderr = String::from_utf8_lossy(&stated.stderr).into_owned();
    assert!(stated.status.code() == Some(2) && stderr.contains("states LPS; leave out --space"), "{stderr}");
    // Points of a cloud and its normals are turned as picked points are.
    fs::write(at("normals.csv"), "x,y,z,nx,ny,nz,q\n1,2,3,0.6,0,0.8,7\n4,5,6,0,1,0,8\n").unwrap();
    assert!(convert(&at("normals.csv"), &at("turned.csv"), &["--space", "RAS"]).status.success());
    let turned = fs::read_to_string(at("turned.csv")).unwrap();
    assert_eq!(turned, "x,y,z,nx,ny,nz,q\n-1,-2,3,-0.6,0,0.8,7\n-4,-5,6,0,-1,0,8\n");
    for (output, expected) in
        [("lps.csv", "exists already"), ("new.glb", "nothing is written as"), ("new", "nothing is written as")]
    {
        let stderr = String::from_utf8_lossy(&convert(&at("cloud.csv"), &at(output), &[]).stderr).into_owned();
        assert!(stderr.contains(expected), "{output}: {stderr}");
    }
}
