//! Files as version 0.2.0 wrote them: later versions read them. They are never written anew.

use crate::common::{osteoflow, root};
use std::fs;

/// A graph with every parameter spelled out, a recording, and the digest that 0.2.0 gave of it.
const KEPT: &str = "tests/data/kept/0.2.0";

#[test]
fn a_graph_of_version_0_2_0_is_read() {
    let checked = osteoflow().args(["check", &format!("{KEPT}/fibula.toml"), "--format", "json"]).output().unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
}

#[test]
fn a_recording_of_version_0_2_0_is_read_and_has_its_digest() {
    is_read(KEPT);
}

/// Its `geometry/Image` is of version 1, without the fields of distortion.
#[test]
fn a_recording_of_an_image_without_fields_of_distortion_is_read_and_has_its_digest() {
    is_read("tests/data/kept/before-0.2.0");
}

fn is_read(kept: &str) {
    let recording = format!("{kept}/run.mcap");
    osteoflow().args(["validate", &recording]).assert().success();
    osteoflow().args(["replay", &recording]).assert().success();
    let digest = osteoflow().args(["digest", &recording, "--format", "json"]).output().unwrap();
    let digest: serde_json::Value = serde_json::from_slice(&digest.stdout).unwrap();
    let kept = fs::read_to_string(root().join(kept).join("digest.txt")).unwrap();
    assert_eq!(digest["files"][0]["digest"].as_str(), Some(kept.trim()));
}
