//! The code of docs/extend/own-device.md, run against a simulated SDK: tests/python/my_camera_sdk.py.

use crate::common::{json, osteoflow, python::Folder, root};
use serde_json::Value;
use std::fs;

/// The first block of the page in a language.
fn block(language: &str) -> String {
    let page = fs::read_to_string(root().join("docs/extend/own-device.md")).unwrap();
    let (_, rest) = page.split_once(&format!("```{language}\n")).unwrap();
    rest.split_once("```").unwrap().0.to_owned()
}

/// A folder with the source and the graph of the page, and the SDK.
fn folder(test: &str) -> Option<Folder> {
    let sdk = fs::read_to_string(root().join("tests/python/my_camera_sdk.py")).unwrap();
    let (source, graph) = (block("python"), block("toml"));
    Folder::new(test, &[("my_camera.py", &source), ("my_camera.toml", &graph), ("my_camera_sdk.py", &sdk)])
}

/// Runs the graph until it has this number of frames, with such a camera; exit code and all that was printed.
fn ran(folder: &Folder, n_frames: usize, camera: &str, rest: &[&str]) -> (Option<i32>, String) {
    let _ = fs::remove_dir_all(folder.path("r"));
    let mut command = osteoflow();
    command.current_dir(folder.0.path()).env("OSTEOFLOW_PYTHON", &folder.1).env("CAMERA", camera);
    command.args(["run", "my_camera.toml", "--out", "r", "--set", &format!("camera.n_frames={n_frames}")]);
    let output = command.args(rest).output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
}

fn replays(folder: &Folder) {
    // A replay needs neither camera nor SDK.
    let sdk = folder.path("my_camera_sdk.py");
    let text = fs::read_to_string(&sdk).unwrap();
    fs::remove_file(&sdk).unwrap();
    let (code, said) = folder.says(&["replay", "r"]);
    assert!(code == Some(0) && said.contains(", 0 differ"), "{code:?} {said}");
    fs::write(&sdk, text).unwrap();
}

#[test]
fn frames_of_an_sdk_are_given_once_whole_and_stamped_by_this_clock_and_replay_the_same() {
    let Some(folder) = folder("the device of docs/extend/own-device.md") else { return };
    let before_ns = now_ns();
    let (code, said) = ran(&folder, 12, r#"{"lost": [5, 6, 9]}"#, &["--set", "crop.max_mm=[1000,1000,1000]"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("2 frames before frame 7 were lost"), "{said}");
    assert!(said.contains("1 frames before frame 10 were lost"), "{said}");
    let scans = json(&folder.path("r/results.json"))["scans"].as_array().unwrap().clone();
    let given: Vec<Value> = json(&folder.path("given.json")).as_array().unwrap().clone();
    assert_eq!(scans.len(), 12);
    for (k, (scan, given)) in scans.iter().zip(&given).enumerate() {
        assert_eq!(scan["n_points"], given["points"], "frame {k}");
        let stamp_ns = scan["stamp_ns"].as_i64().unwrap();
        let late_ms = (stamp_ns - given["at_ns"].as_i64().unwrap()) as f64 / 1e6;
        // By the least delay of a thread that is woken, on a busy machine.
        assert!((0.0..2000.0).contains(&late_ms) && stamp_ns > before_ns, "frame {k}: {late_ms} ms");
    }
    replays(&folder);
    let (code, said) = folder.says(&["replay", "r", "--set", "crop.max_mm=[100,100,200]"]);
    assert!(code == Some(4) && said.contains("crop.cloud"), "another box gives other clouds: {code:?} {said}");
}

#[test]
fn the_coordinates_are_those_of_the_sdk_in_mm_and_not_of_an_array_that_it_used_again() {
    let Some(folder) = folder("the coordinates of a device") else { return };
    let (graph, keep) = (block("toml"), "\n[node.keep]\nkind = \"output.ply\"\nin = { cloud = \"camera.cloud\" }\n");
    folder.write("my_camera.toml", &(graph + keep));
    let (code, said) = ran(&folder, 3, "{}", &[]);
    assert_eq!(code, Some(0), "{said}");
    let given: Vec<Value> = json(&folder.path("given.json")).as_array().unwrap().clone();
    for (k, name) in ["keep.ply", "keep-1.ply", "keep-2.ply"].into_iter().enumerate() {
        let path = folder.path(&format!("r/{name}"));
        let read = osteoflow_formats::mesh_or_cloud::read_cloud(&path, 1.0, "camera").unwrap();
        let points = read.cloud.points();
        assert_eq!(points.len() as u64, given[k]["points"].as_u64().unwrap(), "frame {k}");
        for axis in 0..3 {
            let sum_mm: f64 = points.iter().map(|p| p[axis]).sum();
            let expected_mm = given[k]["sum"][axis].as_f64().unwrap() * 1000.0;
            // Files in single precision, 750 points.
            assert!((sum_mm - expected_mm).abs() < 0.05, "frame {k}, axis {axis}: {sum_mm} and {expected_mm} mm");
        }
    }
}

#[test]
fn an_sdk_that_stalls_is_reported_and_goes_on() {
    let Some(folder) = folder("a device that stalls") else { return };
    let (code, said) = ran(&folder, 6, r#"{"stall": [3, 3.5]}"#, &[]);
    assert_eq!(code, Some(0), "{said}");
    assert!(
        said.contains("it has given nothing for 2.0 s") && said.contains("it gave something again after 3.5 s"),
        "{said}"
    );
    replays(&folder);
}

#[test]
fn an_sdk_that_throws_ends_the_run_with_its_line_and_what_came_before_replays() {
    let Some(folder) = folder("a device that throws") else { return };
    let (code, said) = ran(&folder, 20, r#"{"throws": 4}"#, &[]);
    let line = block("python").lines().position(|line| line.contains("camera.check()")).unwrap() + 1;
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains(&format!("my_camera.py:{line}: OSError: USB transfer failed")), "{said}");
    let (code, said) = folder.says(&["validate", "r/run.mcap"]);
    assert_eq!(code, Some(0), "{said}");
    let (code, said) = ran(&folder, 20, r#"{"absent": true}"#, &["--set", "camera.serial=A7"]);
    assert!(code == Some(3) && said.contains("ConnectionError: no camera 'A7' on the bus"), "{said}");
}

#[test]
fn frames_without_depth_are_left_out_and_another_unit_is_refused() {
    let Some(folder) = folder("a device without depth, or in another unit") else { return };
    let (code, said) = ran(&folder, 5, r#"{"empty": [1, 2]}"#, &[]);
    assert!(code == Some(0) && said.contains("frame 2 has no point with a depth and is left out"), "{said}");
    assert_eq!(json(&folder.path("r/results.json"))["scans"].as_array().unwrap().len(), 5);
    let (code, said) = ran(&folder, 5, r#"{"factor": 1000.0}"#, &[]);
    assert!(code == Some(3) && said.contains("mm away; set unit_mm to the SDK's unit"), "{said}");
    let (code, said) = ran(&folder, 5, r#"{"factor": 1000.0}"#, &["--set", "camera.unit_mm=1"]);
    assert_eq!(code, Some(0), "{said}");
}

fn now_ns() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(since.as_nanos()).unwrap()
}
