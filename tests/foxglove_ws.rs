//! The Foxglove WebSocket protocol from the command line: the whole method from the topics of a server.

use crate::common::{isometry, osteoflow, root, run_whole};
use osteoflow_formats::mcap_read::{Message, Recording};
use osteoflow_formats::message_read::procedure_region;
use serde_json::{Value, json};
use std::{
    net::{SocketAddr, TcpListener},
    thread,
};
use tungstenite::handshake::server::{Request, Response};

const LIVE: &str = "graphs/variants/fibula_live_foxglove.toml";
const RECORDED: &str = "graphs/fibula_recorded.toml";

fn recording() -> Recording {
    Recording::open(&root().join("tests/data/procedure/procedure.mcap"), false).unwrap()
}

/// A server that plays the procedure to its first client as fast as it can, in the order in which it was published, and closes.
fn bridge() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        let recording = recording();
        #[allow(clippy::result_large_err, reason = "the type is tungstenite's")]
        let protocol = |_: &Request, mut response: Response| {
            response.headers_mut().insert("sec-websocket-protocol", "foxglove.sdk.v1".parse().unwrap());
            Ok(response)
        };
        let mut socket = tungstenite::accept_hdr(listener.accept().unwrap().0, protocol).unwrap();
        let channels: Vec<Value> = (1..)
            .zip(recording.topics())
            .map(|(id, topic): (u64, _)| {
                json!({
                    "id": id, "topic": topic.name, "encoding": topic.message_encoding, "schemaName": topic.schema_name, "schema": "",
                })
            })
            .collect();
        let hello = json!({ "op": "serverInfo", "name": "test", "capabilities": [], "metadata": recording.metadata["procedure"] });
        socket.send(tungstenite::Message::text(hello.to_string())).unwrap();
        let advertise = json!({ "op": "advertise", "channels": channels });
        socket.send(tungstenite::Message::text(advertise.to_string())).unwrap();
        let subscribe: Value = serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap();
        assert_eq!(subscribe["op"], "subscribe");
        let mut messages: Vec<(u64, &Message)> = Vec::new();
        for row in subscribe["subscriptions"].as_array().unwrap() {
            let topic = &recording.topics()[row["channelId"].as_u64().unwrap() as usize - 1];
            messages.extend(recording.messages(&topic.name).iter().map(|m| (row["id"].as_u64().unwrap(), m)));
        }
        messages.sort_by_key(|(_, message)| message.publish_time_ns);
        for (id, message) in messages {
            let time = (message.log_time_ns as u64).to_le_bytes();
            let bytes = [&[1][..], &(id as u32).to_le_bytes(), &time, &message.data].concat();
            socket.send(tungstenite::Message::binary(bytes)).unwrap();
        }
        let _ = socket.close(None);
        while socket.read().is_ok() {}
    });
    address
}

/// The region of the recording, which no topic states.
fn box_mm() -> [String; 2] {
    let region = procedure_region(&recording()).unwrap().unwrap();
    [("min", region.min), ("max", region.max)].map(|(key, at)| format!("crop.{key}_mm=[{}, {}, {}]", at.x, at.y, at.z))
}

#[test]
fn the_whole_method_from_a_bridge_gives_the_results_of_the_same_procedure_from_file() {
    let recorded = run_whole(
        RECORDED,
        &["--no-record", "--set", r#"remove=["node.verdict.in.measured", "node.verdict.in.followed"]"#],
    );
    let [min, max] = box_mm();
    for workers in ["1", "8"] {
        let address = format!("recording.address=ws://{}", bridge());
        let arguments = ["--no-record", "--workers", workers, "--set", &address, "--set", &min, "--set", &max];
        let live = run_whole(LIVE, &arguments);
        let [ours, theirs] = [&live, &recorded].map(|run| isometry(&run.results["poses"]["t_ct_world"]["matrix"]));
        let apart = ours.inverse() * theirs;
        // At the bone, a metre from the tracker at most.
        let mm = apart.translation.vector.norm() + apart.rotation.angle() * 1000.0;
        println!("{workers} workers: {mm:.1e} mm apart");
        assert!(mm < 0.05, "{mm} mm apart");
        let tre_mm =
            [&live, &recorded].map(|run| run.results["metrics"]["tre_measured_mm"]["max"]["norm"].as_f64().unwrap());
        assert!((tre_mm[0] - tre_mm[1]).abs() < 0.05, "{tre_mm:?} mm");
        assert_eq!(live.results["verdict"]["answer"], recorded.results["verdict"]["answer"]);
        assert!(!live.stderr.contains("late") && !live.stderr.contains("not advertised"), "{}", live.stderr);
    }
}

#[test]
fn the_shipped_recorded_graph_runs_on_a_bridge_by_another_kind_and_address_and_gives_the_bits_of_the_recording() {
    // What a bridge cannot know: how a motion goes on, and how long a silence lasts.
    let markers = ["camera_marker", "phantom_marker", "bone_marker"];
    let free = markers.map(|name| format!("recording.out.{name}.motion={{hand_mm_s=0.0}}"));
    let mut settings = vec!["--set", r#"remove=["node.recording.out.bone_marker.lost_after_ms"]"#];
    settings.extend(free.iter().flat_map(|setting| ["--set", setting]));
    let recorded = run_whole(RECORDED, &settings);
    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("bridge.toml");
    let text = format!(
        "extends = \"{}\"\nremove = [\"node.recording.path\"]\n\n[node.recording]\nkind = \"acquire.foxglove_ws\"\naddress = \"ws://{}\"\nreconnect = \
         false\n",
        root().join(RECORDED).display(),
        bridge()
    );
    std::fs::write(&graph, text).unwrap();
    let live = run_whole(graph.to_str().unwrap(), &settings);
    assert_eq!(live.results["poses"], recorded.results["poses"], "{}", live.stderr);
    let [a, b] = [&recorded, &live].map(|run| run.path("run.mcap"));
    let output =
        osteoflow().arg("diff").args([&a, &b]).args(["--wires", "recording.*", "to_*", "icp.*"]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("recording.scan") || text.contains("equal"), "{text}");
}
