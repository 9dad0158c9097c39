//! Live sources from the command line: the shipped recording, played as if its devices sent it.

use crate::common::{OF_ANY_AGE, is_slow_run, json, osteoflow, osteoflow_to_spawn, run, run_whole};
use osteoflow_formats::openigtlink::{Affine, Body, Message};
use osteoflow_geometry::nalgebra::Isometry3;
use serde_json::{Value, json};
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpListener,
    process::Stdio,
    sync::mpsc::{Receiver, sync_channel},
    thread,
    time::Duration,
};
use tungstenite::handshake::server::{Request, Response};

const RECORDED: &str = "graphs/fibula_recorded.toml";
const LIVE: &str = "graphs/variants/fibula_live.toml";
/// So fast that only the graph takes time.
const AT_ONCE: &str = "recording.rate=1e9";

#[test]
fn a_live_source_gives_the_results_of_the_recording_it_plays() {
    // The live graph's verdict does not wait for the stylus, which comes long after the planes are needed.
    let recorded = run_whole(
        RECORDED,
        &["--no-record", "--set", r#"remove=["node.verdict.in.measured", "node.verdict.in.followed"]"#],
    );
    let jitter = ["recording.jitter_ms=20", "recording.max_delay_ms=20"];
    for (sets, all_workers) in [(&[][..], ["1", "8"]), (&jitter, ["8", "1"])] {
        for workers in all_workers.into_iter().take(if is_slow_run() { 2 } else { 1 }) {
            let mut arguments = vec!["--no-record", "--workers", workers, "--set", AT_ONCE, "--set", OF_ANY_AGE];
            arguments.extend(sets.iter().flat_map(|set| ["--set", set]));
            let live = run_whole(LIVE, &arguments);
            assert_eq!(live.results, recorded.results, "{sets:?} on {workers} workers");
            assert!(!live.stderr.contains("late"), "{}", live.stderr);
        }
    }
}

#[test]
fn late_items_are_counted_and_reported_and_replay_the_same() {
    let arguments = ["--set", AT_ONCE, "--set", "recording.jitter_ms=200", "--set", "recording.max_delay_ms=5"];
    let live = run(LIVE, &arguments);
    let late = "recording.region: 1 item came late, by up to ";
    assert!(live.stderr.contains(late), "{}", live.stderr);
    let manifest = json(&live.dir.path().join("manifest.json"));
    let of = |link: &Value, key: &str| link[key].as_u64().unwrap();
    let links = manifest["links"].as_array().unwrap();
    assert!(links.iter().any(|link| link["from"] == "recording.region" && of(link, "late") == 1), "{links:?}");
    assert!(links.iter().all(|link| of(link, "sent") == of(link, "received") + of(link, "dropped")));
    let replay = osteoflow().arg("replay").arg(live.dir.path().join("run.mcap")).output().unwrap();
    let printed = String::from_utf8_lossy(&replay.stdout);
    assert!(printed.contains(", 0 differ, "), "{printed}{}", String::from_utf8_lossy(&replay.stderr));
}

/// 2026-01-01, and a stamp of the year 2106 in the fifth of twelve messages.
const STAMPS_S: [u32; 12] = {
    let mut stamps = [1_767_225_600; 12];
    let mut k = 1;
    while k < 12 {
        stamps[k] = stamps[k - 1] + 1;
        k += 1;
    }
    stamps[4] = 4_294_000_000;
    stamps
};

/// Sends a pose for each stamp to the first client, and stays until it is told to leave, or a limit.
fn openigtlink(leave: Receiver<()>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        for (k, stamp_s) in STAMPS_S.into_iter().enumerate() {
            let body = Body::Transform(Affine::of(&Isometry3::translation(k as f64 + 1.0, 0.0, 0.0)));
            let message = Message::new("Marker", i64::from(stamp_s) * 1_000_000_000, body);
            stream.write_all(&message.to_bytes().unwrap()).unwrap();
        }
        let _ = leave.recv_timeout(Duration::from_secs(30));
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let _ = stream.read_to_end(&mut Vec::new());
    });
    address.to_string()
}

/// The same as a Foxglove server.
fn bridge(leave: Receiver<()>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        #[allow(clippy::result_large_err, reason = "the type is tungstenite's")]
        let protocol = |_: &Request, mut response: Response| {
            response.headers_mut().insert("sec-websocket-protocol", "foxglove.sdk.v1".parse().unwrap());
            Ok(response)
        };
        let mut socket = tungstenite::accept_hdr(listener.accept().unwrap().0, protocol).unwrap();
        let channel = json!({ "id": 1, "topic": "/tf", "encoding": "json", "schemaName": "foxglove.FrameTransform", "schema": "" });
        for text in [
            json!({ "op": "serverInfo", "name": "test", "capabilities": [] }),
            json!({ "op": "advertise", "channels": [channel] }),
        ] {
            socket.send(tungstenite::Message::text(text.to_string())).unwrap();
        }
        let subscribe: Value = serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap();
        let id = subscribe["subscriptions"][0]["id"].as_u64().unwrap();
        for (k, stamp_s) in STAMPS_S.into_iter().enumerate() {
            let data = json!({
                "timestamp": { "sec": stamp_s, "nsec": 0 }, "parent_frame_id": "world", "child_frame_id": "marker",
                "translation": { "x": (k as f64 + 1.0) / 1000.0, "y": 0.0, "z": 0.0 }, "rotation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
            });
            let bytes = [&[1][..], &(id as u32).to_le_bytes(), &[0; 8], data.to_string().as_bytes()].concat();
            socket.send(tungstenite::Message::binary(bytes)).unwrap();
        }
        let _ = leave.recv_timeout(Duration::from_secs(30));
        let _ = socket.close(None);
        while socket.read().is_ok() {}
    });
    format!("ws://{address}")
}

#[test]
fn a_stamp_of_2106_from_a_device_costs_its_own_item_and_is_said_while_the_device_sends_on() {
    type Device = (&'static str, &'static str, fn(Receiver<()>) -> String);
    let devices: [Device; 2] = [
        ("acquire.openigtlink", "device = \"Marker\", to = \"world\", from = \"marker\"", openigtlink),
        ("acquire.foxglove_ws", "topic = \"/tf\", parent = \"world\", child = \"marker\"", bridge),
    ];
    for (kind, port, device) in devices {
        let dir = tempfile::tempdir().unwrap();
        let (leave, left) = sync_channel(1);
        let address = device(left);
        let graph = format!(
            "[graph]\nformat = 1\n[node.device]\nkind = \"{kind}\"\naddress = \"{address}\"\nreconnect = false\n\
             out.marker = {{ type = \"geometry/Pose\", {port} }}\n[results]\nmarker = {{ from = \"device.marker\", all = true }}\n"
        );
        std::fs::write(dir.path().join("g.toml"), graph).unwrap();
        let mut command = osteoflow_to_spawn();
        command.current_dir(dir.path()).args(["run", "g.toml", "--out", "r"]);
        let mut child = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let said = |line: &String| line.contains("its stamp 4294000000000000000 ns is ");
        let told = lines.find(said).unwrap_or_else(|| panic!("{kind}: nothing is said of it"));
        // The device is still there, unless the limit is over, after which nobody listens.
        assert!(leave.send(()).is_ok(), "{kind}: said after the end only: {told}");
        let rest: Vec<String> = lines.collect();
        assert!(child.wait().unwrap().success(), "{kind}: {told} {rest:?}");
        let results = json(&dir.path().join("r/results.json"));
        let all = results["marker"].as_array().unwrap();
        assert_eq!(all.len(), 12, "{kind}: {all:?}");
        for (k, item) in all.iter().enumerate() {
            let (x, reason) = (item["matrix"][0][3].as_f64(), item["unknown"].as_str());
            assert_eq!(
                (x.map(f64::round), reason.is_some()),
                ((k != 4).then_some(k as f64 + 1.0), k == 4),
                "{kind}: {item}"
            );
        }
        let manifest = json(&dir.path().join("r/manifest.json"));
        let warnings: Vec<&str> =
            manifest["warnings"].as_array().unwrap().iter().filter_map(|w| w["message"].as_str()).collect();
        assert_eq!(
            warnings.iter().filter(|w| w.starts_with("its stamp 4294")).count(),
            1,
            "{kind}: {}",
            manifest["warnings"]
        );
    }
}
