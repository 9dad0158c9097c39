//! Contracts of time from the command line: what a run says of them, what a replay repeats, and what `check --times` predicts.

use crate::common::{json, osteoflow, root, run, run_whole};
use osteoflow_formats::openigtlink::{Affine, Body, Message};
use osteoflow_geometry::nalgebra::Isometry3;
use serde_json::{Value, json};
use std::{
    fs,
    io::{Read, Write},
    net::TcpListener,
    path::Path,
    thread,
    time::Duration,
};

/// `check` with these arguments: exit code, stdout and stderr.
fn check(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = osteoflow().arg("check").args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

fn replayed(recording: &Path) -> Value {
    let output = osteoflow().args(["replay", "--format", "json"]).arg(recording).output().unwrap();
    serde_json::from_slice(&output.stdout).unwrap()
}

fn contract<'m>(manifest: &'m Value, on: &str) -> &'m Value {
    let all = manifest["contracts"].as_array().unwrap();
    all.iter().find(|contract| contract["on"] == on).unwrap_or_else(|| panic!("none on {on}: {all:?}"))
}

#[test]
fn check_says_with_the_times_of_a_run_which_contract_cannot_be_kept_where_it_stands_and_by_which_node() {
    let small = ["--set", "stream.camera.n_points=5000", "--set", "stream.stream={n_scans=8,motion_s=1}"];
    let ran = run_whole("graphs/fibula_tracking.toml", &small);
    let times = ran.dir.path().to_str().unwrap().to_owned();
    let wide = ["--set", "tre_true.in.t_ct_world.max_age_ms=600000", "--set", "start.in.previous.max_age_ms=600000"];
    let (code, printed, said) = check(&[&["graphs/fibula_tracking.toml", "--times", &times], &wide[..]].concat());
    assert_eq!((code, &*said), (Some(0), ""), "{printed}");
    for part in ["tre_true.t_ct_world", "result tracking.icp", "99 % below", "waits for the next of"] {
        assert!(printed.contains(part), "{part}: {printed}");
    }

    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("tight.toml");
    let shipped = root().join("graphs/fibula_tracking.toml");
    let text = format!(
        "extends = {shipped:?}\n\n[node.tre_true.in.t_ct_world]\nmax_age_ms = 0.5\n\n[node.start]\ndeadline_ms = 600000\n"
    );
    fs::write(&graph, text).unwrap();
    let named = graph.to_str().unwrap();
    let (code, _, said) = check(&[named, "--times", &times]);
    let place = format!("{named}:4: tre_true.t_ct_world cannot keep max_age_ms = 0.5: it needs ");
    assert!(code == Some(2) && said.contains(&place), "{said}");
    assert!(said.contains("node \"icp\" takes most of it; make it faster, or allow more"), "{said}");
    let (code, printed, _) = check(&[named, "--times", &times, "--format", "json"]);
    let printed: Value = serde_json::from_str(&printed).unwrap();
    let of = |on: &str| printed["times"].as_array().unwrap().iter().find(|time| time["on"] == on).unwrap();
    let tight = of("tre_true.t_ct_world");
    assert_eq!(
        (code, &tight["kept"], &tight["breaks"], &tight["line"]),
        (Some(2), &json!(false), &json!("icp"), &json!(4))
    );
    assert!(tight["predicted_ms"].as_f64().unwrap() > 0.5);
    assert_eq!(of("start")["kept"], json!(true), "a deadline is predicted by the node's own times");

    // A node that cannot keep up has no bound: scans a thousand times as often.
    let manifest = ran.path("manifest.json");
    let slow = fs::read_to_string(&manifest).unwrap();
    let mut slow: Value = serde_json::from_str(&slow).unwrap();
    for node in slow["nodes"].as_array_mut().unwrap().iter_mut().filter(|node| node["name"] == "icp") {
        node["busy_ms"] = json!(node["busy_ms"].as_f64().unwrap() * 1e6);
    }
    fs::write(&manifest, slow.to_string()).unwrap();
    let (code, _, said) = check(&[&["graphs/fibula_tracking.toml", "--times", &times], &wide[..]].concat());
    assert!(code == Some(2) && said.contains("it has no bound (icp takes "), "{said}");

    // Times of another graph are no times of this one.
    let text = fs::read_to_string(&manifest).unwrap().replace("\"name\":\"icp\"", "\"name\":\"another\"");
    fs::write(&manifest, text).unwrap();
    let (code, printed, said) = check(&[&["graphs/fibula_tracking.toml", "--times", &times], &wide[..]].concat());
    assert!(code == Some(2) && said.contains("it has no bound (the run has no firing of icp"), "{said}");
    assert!(printed.contains("no faults, 1 contract cannot be kept"), "{printed}");

    for (times, expected) in [(dir.path().to_str().unwrap(), "manifest.json"), ("graphs", "manifest.json")] {
        let (code, _, said) = check(&["graphs/fibula_tracking.toml", "--times", times]);
        assert!(code == Some(2) && said.contains(expected), "{said}");
    }
}

#[test]
fn planes_of_a_pose_that_is_too_old_are_unknown_counted_and_the_same_in_a_replay() {
    // As fast as the graph can run, most poses wait for the registration.
    let live = run_whole("graphs/variants/fibula_live.toml", &["--set", "recording.rate=1e9"]);
    let manifest = json(&live.path("manifest.json"));
    let planes = contract(&manifest, "planes.t_world_bone_marker");
    let (n, broken) = (planes["n"].as_u64().unwrap(), planes["broken"].as_u64().unwrap());
    assert!(n > 300 && broken > 10, "{planes}");
    assert_eq!((&planes["of"], &planes["limit_ms"]), (&json!("age"), &json!(100.0)));
    assert!(planes["max_ms"].as_f64().unwrap() > 100.0 && planes["p99_ms"].as_f64() <= planes["max_ms"].as_f64());
    let reasons = live.results["reasons"].as_array().unwrap();
    let sign = reasons.iter().find(|sign| sign["rule"] == "max_age").unwrap();
    let expected =
        format!("planes.t_world_bone_marker: {broken} of {n} values were older than 0.1 s, the first at item 0");
    assert_eq!(sign["reason"], json!(expected));
    let again = replayed(&live.path("run.mcap"));
    assert_eq!((&again["results_equal"], &again["equal"]), (&json!(true), &json!(true)), "{:#}", again["wires"]);
    assert_eq!(again["results"]["reasons"], live.results["reasons"]);
    // The drawings say what is asked, and how it was kept.
    let folder = live.dir.path().to_str().unwrap();
    for (what, expected) in [
        (&["graphs/variants/fibula_live.toml"][..], "at most 100 ms old"),
        (&["--run", folder], &*format!("of 100 ms, {broken} above")),
    ] {
        let drawn = osteoflow().arg("graph").args(what).args(["--as", "svg"]).output().unwrap();
        let drawn = String::from_utf8_lossy(&drawn.stdout).into_owned();
        assert!(drawn.contains(expected), "{expected}: {}", &drawn[..drawn.len().min(400)]);
    }

    let refused = ["--set", "recording.rate=1e9", "--set", "planes.in.t_world_bone_marker.otherwise=refuse"];
    let refused = run("graphs/variants/fibula_live.toml", &refused);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(refused.stderr.contains("0.1 s allowed, and otherwise = \"refuse\""), "{}", refused.stderr);
    let again = replayed(&refused.path("run.mcap"));
    assert_eq!((&again["results_equal"], &again["equal"]), (&json!(true), &json!(true)), "{again:#}");
}

/// A tracker that sends four poses, nothing for 600 ms, and four more.
fn breaks_off() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut stamp_ns = 1_767_225_600_000_000_000_i64;
        for k in 0..8 {
            let pause_ms = if k == 4 { 600 } else { 20 };
            thread::sleep(Duration::from_millis(pause_ms));
            stamp_ns += pause_ms as i64 * 1_000_000;
            let body = Body::Transform(Affine::of(&Isometry3::translation(f64::from(k) + 1.0, 0.0, 0.0)));
            stream.write_all(&Message::new("Marker", stamp_ns, body).to_bytes().unwrap()).unwrap();
        }
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let _ = stream.read_to_end(&mut Vec::new());
    });
    address.to_string()
}

#[test]
fn a_tracker_that_breaks_off_is_unknown_while_it_is_silent_and_a_replay_knows_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let graph = format!(
        "[graph]\nformat = 1\n[node.device]\nkind = \"acquire.openigtlink\"\naddress = \"{}\"\nreconnect = false\n\
         out.marker = {{ type = \"geometry/Pose\", device = \"Marker\", to = \"world\", from = \"marker\" }}\n\
         [node.shown]\nkind = \"transform.first_of\"\non_error = \"skip\"\nin.first = {{ from = \"device.marker\", join = \"each\", max_age_ms = 300, rate_hz = 5 }}\n\
         [record]\nwires = [\"*.*\"]\n[results]\nshown = {{ from = \"shown.pose\", all = true }}\n",
        breaks_off()
    );
    fs::write(dir.path().join("g.toml"), graph).unwrap();
    let output = osteoflow().current_dir(dir.path()).args(["run", "g.toml", "--out", "r"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("device.marker: nothing came for 0.3 s; what depends on it is unknown"), "{said}");
    let results = json(&dir.path().join("r/results.json"));
    let unknown: Vec<_> = results["shown"].as_array().unwrap().iter().map(|pose| pose["unknown"].clone()).collect();
    // A busy machine may find another silence, but not less than this one.
    let n_silent =
        unknown.iter().filter(|why| why.as_str().is_some_and(|why| why.contains("nothing came for 0.3 s"))).count();
    assert!(n_silent >= 1 && unknown.iter().filter(|why| why.is_null()).count() >= 4, "{unknown:?}");
    let manifest = json(&dir.path().join("r/manifest.json"));
    assert_eq!(contract(&manifest, "device.marker")["broken"].as_u64(), Some(n_silent as u64));
    let again = replayed(&dir.path().join("r/run.mcap"));
    assert_eq!((&again["results_equal"], &again["equal"]), (&json!(true), &json!(true)), "{again:#}");
}
