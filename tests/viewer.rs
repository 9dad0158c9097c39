//! The page and the stream to viewers: who is let in, what is sent, and what the page shows of it in a browser.

use crate::common::browser::Browser;
use crate::common::served::Served;
use crate::common::{OF_ANY_AGE, WHITE, copied_run, osteoflow, read_by_viewers, shared_run, skips_slow};
use crate::viewers::{DRAWN_MM, file::File, off_its_place_mm, place_of_scan};
use osteoflow_geometry::{
    isometry_from_matrix,
    nalgebra::{Matrix4, Point3, Vector3},
};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use serde_json::{Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    net::TcpStream,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

/// Time after which a test that waits fails.
const LIMIT: Duration = Duration::from_secs(60);
/// Opcode of a message of a channel.
const MESSAGE: u8 = 1;
/// Opcode of the state of a playback.
const PLAYBACK_STATE: u8 = 5;

impl Served {
    fn view(&self) -> Viewer {
        Viewer::connect(&self.stream, None, "foxglove.sdk.v1").unwrap()
    }
}

/// A viewer that speaks the protocol.
struct Viewer {
    socket: WebSocket<TcpStream>,
    info: Value,
    /// Channel by topic.
    channels: BTreeMap<String, Value>,
    /// Topic of each subscription.
    topics: BTreeMap<u32, String>,
    /// Opcodes of the binary messages so far.
    opcodes: BTreeSet<u8>,
}

impl Viewer {
    fn connect(address: &str, origin: Option<&str>, protocol: &str) -> Result<Self, String> {
        let host = address.strip_prefix("ws://").unwrap().split('/').next().unwrap();
        let connection = TcpStream::connect(host).unwrap();
        connection.set_read_timeout(Some(LIMIT)).unwrap();
        let mut request = ClientRequestBuilder::new(address.parse().unwrap()).with_sub_protocol(protocol);
        if let Some(origin) = origin {
            request = request.with_header("Origin", origin);
        }
        let (socket, answer) = tungstenite::client(request, connection).map_err(|error| error.to_string())?;
        assert_eq!(answer.headers()["sec-websocket-protocol"], protocol);
        let mut viewer = Self {
            socket,
            info: Value::Null,
            channels: BTreeMap::new(),
            topics: BTreeMap::new(),
            opcodes: BTreeSet::new(),
        };
        viewer.info = viewer.text("serverInfo");
        viewer.text("advertise");
        Ok(viewer)
    }

    /// Next message; channels that are advertised are noted.
    fn next(&mut self) -> Option<Message> {
        let message = self.socket.read().ok()?;
        if let Message::Binary(bytes) = &message {
            self.opcodes.extend(bytes.first());
        }
        if let Message::Text(text) = &message {
            let message: Value = serde_json::from_str(text).unwrap();
            if message["op"] == "advertise" {
                for channel in message["channels"].as_array().unwrap() {
                    if channel["schemaEncoding"] == "jsonschema" {
                        let schema = serde_json::from_str(channel["schema"].as_str().unwrap()).unwrap();
                        assert_eq!(read_by_viewers(&schema), Ok(()), "{channel}");
                    }
                    self.channels.insert(channel["topic"].as_str().unwrap().to_owned(), channel.clone());
                }
            }
        }
        Some(message)
    }

    /// The next text message with this `op`.
    fn text(&mut self, op: &str) -> Value {
        loop {
            if let Message::Text(text) = self.next().expect("the server closed the connection") {
                let message: Value = serde_json::from_str(&text).unwrap();
                if message["op"] == op {
                    return message;
                }
            }
        }
    }

    fn send(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    fn subscribe(&mut self, wanted: impl Fn(&str) -> bool) {
        let topics = self.channels.iter().filter(|(topic, _)| wanted(topic));
        let pairs: Vec<(u32, String)> =
            topics.map(|(topic, channel)| (channel["id"].as_u64().unwrap() as u32 + 100, topic.clone())).collect();
        let rows: Vec<_> = pairs.iter().map(|(id, _)| json!({ "id": id, "channelId": id - 100 })).collect();
        self.topics.extend(pairs);
        self.send(&json!({ "op": "subscribe", "subscriptions": rows }));
    }

    /// Topic, time and data of the next message of a subscription.
    fn data(&mut self) -> Option<(String, u64, Vec<u8>)> {
        loop {
            if let Message::Binary(bytes) = self.next()?
                && bytes[0] == MESSAGE
            {
                let subscription = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let time = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                let topic = self.topics[&subscription].clone();
                // An item is a sequence of bytes in CDR: 4 bytes of its head, 4 of its length.
                let at = if topic.starts_with("/exact/") { 13 + 8 } else { 13 };
                return Some((topic, time, bytes[at..].to_vec()));
            }
        }
    }
}

const GRAPH: &str = "graphs/fibula.toml";

/// A run of the built-in procedure with these settings, in the folder `run`, and its results.
fn a_run(sets: &[&str]) -> (tempfile::TempDir, Value) {
    let dir = tempfile::tempdir().unwrap();
    let mut command = osteoflow();
    command.args(["run", GRAPH, "--quiet", "--out"]).arg(dir.path().join("run"));
    sets.iter().for_each(|set| {
        command.args(["--set", set]);
    });
    command.output().unwrap();
    let results = fs::read(dir.path().join("run/results.json")).unwrap();
    (dir, serde_json::from_slice(&results).unwrap())
}

fn path(dir: &tempfile::TempDir) -> PathBuf {
    dir.path().join("run")
}

fn digest(recording: &Path) -> String {
    let output = osteoflow().args(["digest", "--format", "json"]).arg(recording).output().unwrap();
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    answer["files"][0]["digest"].as_str().unwrap().to_owned()
}

#[test]
fn nobody_without_the_token_or_from_another_origin_is_let_in() {
    let run = shared_run(GRAPH, &[]);
    let allowed = "https://lichtblick.example";
    let served = Served::start(&["view", run.dir.path().to_str().unwrap(), "--allow-origin", allowed]);
    let (host, token) = served.parts();
    assert!(host.starts_with("127.0.0.1:") && token.len() == 32, "{host} {token}");

    let page = served.get("/TOKEN/", "");
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<title>Osteoflow</title>"), "{page:.300}");
    let policy = page.lines().find(|line| line.starts_with("Content-Security-Policy: ")).unwrap();
    assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
    assert!(served.get("/TOKEN", "").contains(&format!("Location: /{token}/")));

    let own = format!("Origin: http://{host}\r\n");
    assert!(served.get("/TOKEN/main.js", &own).starts_with("HTTP/1.1 200"));
    for (path, headers) in [
        ("/", ""),
        ("/0123456789abcdef0123456789abcdef/", ""),
        ("/main.js", ""),
        ("/TOKEN/", "Host: evil.example\r\n"),
        ("/TOKEN/", "Origin: http://evil.example\r\n"),
        ("/TOKEN/", "Origin: null\r\n"),
        ("/TOKENx/", ""),
    ] {
        let answer = served.get(path, headers);
        assert!(answer.starts_with("HTTP/1.1 403"), "{path} {headers}: {answer:.200}");
        assert!(!answer.contains(token), "the answer gives the token away");
    }
    for path in ["/TOKEN/../Cargo.toml", "/TOKEN/etc/passwd", "/TOKEN/%2e%2e/x", "/TOKEN/three"] {
        assert!(served.get(path, "").starts_with("HTTP/1.1 404"), "{path}");
    }

    // The same for the stream.
    let wrong = served.stream.replace(&token[..4], "zzzz");
    assert!(Viewer::connect(&wrong, None, "foxglove.sdk.v1").is_err());
    for origin in ["http://evil.example", "https://app.foxglove.dev", "null"] {
        assert!(Viewer::connect(&served.stream, Some(origin), "foxglove.sdk.v1").is_err(), "{origin}");
    }
    assert!(Viewer::connect(&served.stream, None, "chat").is_err(), "another protocol");
    for protocol in ["foxglove.sdk.v1", "foxglove.websocket.v1"] {
        for origin in [None, Some(allowed)] {
            let viewer = Viewer::connect(&served.stream, origin, protocol).unwrap();
            assert_eq!(viewer.info["name"], "fibula");
        }
    }
}

#[test]
fn other_addresses_than_the_loopback_need_a_word_more() {
    let run = shared_run(GRAPH, &[]).dir.path();
    for (arguments, said) in [
        (&["--address", "0.0.0.0:0"][..], "add --serve-public"),
        (&["--address", "example.org:80"], "an address is HOST:PORT"),
        (&["--allow-origin", "*"], "an origin is a scheme and a host"),
        (&["--allow-origin", "https://a.example/page"], "an origin is a scheme and a host"),
    ] {
        let output = osteoflow().arg("view").arg(run).args(arguments).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && stderr.contains(said), "{arguments:?}: {stderr}");
    }
    let nothing = osteoflow().args(["view", "tests/data/folder/scan.ply"]).output().unwrap();
    assert!(
        String::from_utf8_lossy(&nothing.stderr)
            .contains("is a cloud of points, and the folder of a run or a recording is needed")
    );
}

#[test]
fn a_thousand_broken_requests_neither_stop_the_server_nor_reach_the_run() {
    let run = shared_run(GRAPH, &[]);
    let served = Served::start(&["view", run.dir.path().to_str().unwrap()]);
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let (host, token) = served.parts();
    let whole = format!("GET /{token}/ HTTP/1.1\r\nHost: {host}\r\nContent-Length: 4\r\n\r\nabcd").into_bytes();
    for n in 0..500 {
        let mut bytes = whole.clone();
        match n % 3 {
            0 => bytes = (0..rng.next_u32() % 300).map(|_| rng.next_u32() as u8).collect(),
            1 => bytes.truncate(rng.next_u32() as usize % bytes.len()),
            _ => {
                let at = rng.next_u32() as usize % bytes.len();
                bytes[at] ^= 1 << (rng.next_u32() % 8);
            }
        }
        served.raw(&bytes);
    }
    let mut viewer = served.view();
    for _ in 0..500 {
        let bytes: Vec<u8> = (0..rng.next_u32() % 60)
            .map(|k| if k == 0 { (rng.next_u32() % 5) as u8 } else { rng.next_u32() as u8 })
            .collect();
        viewer.socket.send(Message::binary(bytes)).unwrap();
    }
    for text in [
        "",
        "{",
        "[1]",
        r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":60000}]}"#,
        r#"{"op":"setParameters","parameters":[{"name":"a.b","value":1}]}"#,
    ] {
        viewer.socket.send(Message::text(text)).unwrap();
    }
    viewer.send(&json!({ "op": "getParameters", "parameterNames": [], "id": "last" }));
    assert_eq!(viewer.text("parameterValues")["parameters"], json!([]));
    // More connections than are served at a time: those that are too many are closed.
    let many: Vec<_> = (0..100).map(|_| TcpStream::connect(host).unwrap()).collect();
    drop(many);
    let until = Instant::now() + LIMIT;
    while !served.get("/TOKEN/", "").starts_with("HTTP/1.1 200") {
        assert!(Instant::now() < until, "it serves nobody any more");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(served.interrupt().code(), Some(0));
}

#[test]
fn a_viewer_gets_every_channel_with_its_schema_and_who_comes_late_the_last_of_each() {
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run");
    let served = Served::start(&["run", "graphs/fibula.toml", "--out", run.to_str().unwrap(), "--serve"]);
    // It is published after the files are written that the run has ended.
    let mut early = served.view();
    early.subscribe(|topic| topic == "/viewer/state");
    while serde_json::from_slice::<Value>(&early.data().unwrap().2).unwrap()["state"] != "complete" {}
    // All that comes now is what came last.
    let mut viewer = served.view();
    for (topic, encoding, schema) in [
        ("/view/icp.t_target_source", "protobuf", "foxglove.FrameTransform"),
        ("/exact/icp.t_target_source", "cdr", "geometry/msg/PoseV1"),
        ("/run/log", "json", "foxglove.Log"),
    ] {
        let channel = &viewer.channels[topic];
        assert_eq!((&channel["encoding"], &channel["schemaName"]), (&json!(encoding), &json!(schema)), "{topic}");
        assert!(!channel["schema"].as_str().unwrap().is_empty());
    }
    viewer.subscribe(|topic| topic.starts_with("/exact/") || topic == "/viewer/state");
    let mut got = BTreeMap::new();
    while !(got.contains_key("/exact/planes.planes")
        && got.contains_key("/exact/verdict.verdict")
        && got.contains_key("/viewer/state"))
    {
        let (topic, _, data) = viewer.data().unwrap();
        assert!(got.insert(topic.clone(), data).is_none(), "{topic} came twice");
    }
    let state: Value = serde_json::from_slice(&got["/viewer/state"]).unwrap();
    assert_eq!(
        (&state["state"], &state["simulated"], &state["verdict_wire"]),
        (&json!("complete"), &json!(true), &json!("verdict.verdict"))
    );
    // Its number is that of the last item of the wire.
    let numbers = |topic: &str| u64::from_le_bytes(got[topic][16..24].try_into().unwrap());
    assert_eq!((numbers("/exact/planes.planes"), numbers("/exact/bone.mesh")), (601, 0));
    // Serving changes nothing.
    assert_eq!(served.interrupt().code(), Some(0));
    assert_eq!(digest(&run), digest(shared_run(GRAPH, &[]).dir.path()));
}

#[test]
fn a_viewer_that_does_not_read_never_holds_up_the_run() {
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run");
    let graph = "graphs/variants/fibula_live.toml";
    let arguments = ["--set", "recording.rate=20", "--set", "record.wires=[\"*.*\"]", "--set", OF_ANY_AGE];
    let served = Served::start(&[&["run", graph, "--out", run.to_str().unwrap(), "--serve"], &arguments[..]].concat());
    let mut slow = served.view();
    let all: BTreeSet<String> = slow.channels.keys().cloned().collect();
    slow.subscribe(|topic| all.contains(topic));
    let until = Instant::now() + LIMIT;
    while !run.join("results.json").exists() {
        assert!(Instant::now() < until, "the run waits for a viewer that does not read");
        std::thread::sleep(Duration::from_millis(20));
    }
    // Before the server leaves it as stuck.
    assert!(slow.data().is_some());
    let other = out.path().join("other");
    let ran = osteoflow().args(["run", graph, "--quiet", "--out"]).arg(&other).args(arguments).output().unwrap();
    assert_eq!(ran.status.code(), Some(0));
    assert_eq!(digest(&run), digest(&other));
    assert_eq!(served.interrupt().code(), Some(0));
}

#[test]
fn the_registered_scan_stays_on_its_place_on_the_bone_at_every_second_of_the_stream() {
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run");
    let arguments = ["run", "graphs/variants/fibula_live.toml", "--serve", "--set", "recording.rate=20", "--out"];
    let served = Served::start(&[&arguments[..], &[run.to_str().unwrap()]].concat());
    let mut viewer = served.view();
    let is_wanted = |topic: &str| topic.starts_with("/view/") || ["/run/registered", "/viewer/state"].contains(&topic);
    while !["/run/registered", "/view/to_bone.cloud"].iter().all(|topic| viewer.channels.contains_key(*topic)) {
        viewer.next().unwrap();
    }
    viewer.subscribe(is_wanted);
    let mut received = Vec::new();
    loop {
        let (topic, time_ns, data) = viewer.data().unwrap();
        if topic == "/viewer/state" {
            if serde_json::from_slice::<Value>(&data).unwrap()["state"] != "running" {
                break;
            }
            continue;
        }
        let schema = viewer.channels[&topic]["schemaName"].as_str().unwrap().to_owned();
        received.push((topic, schema, time_ns, data));
    }
    let place = place_of_scan(&run);
    let registered = received.iter().position(|(topic, ..)| topic == "/run/registered").unwrap();
    let mut second = 0;
    let mut n_drawn = 0;
    for n in registered + 1..received.len() {
        // What a viewer has at each second of the run, as it came.
        let now_ns = received[..n].iter().map(|(_, _, time_ns, _)| *time_ns).max().unwrap();
        if now_ns / 1_000_000_000 == second {
            continue;
        }
        second = now_ns / 1_000_000_000;
        let file = File::received(received[..n].iter().cloned());
        for topic in ["/view/to_bone.cloud", "/run/registered"] {
            let off_mm = off_its_place_mm(&file, topic, now_ns, &place, None).unwrap();
            assert!(off_mm < DRAWN_MM, "{topic} is drawn {off_mm} mm beside its place, {n} messages in");
            n_drawn += 1;
        }
    }
    assert!(n_drawn > 10, "drawn {n_drawn} times");
    assert_eq!(served.interrupt().code(), Some(0));
}

/// Topic and data of a message.
type Received = (String, Vec<u8>);

/// Runs the live procedure, and returns the messages of planes, of the verdict and of the run's end in the order in which they come.
fn live_planes(sets: &[&str]) -> Vec<Received> {
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run");
    let mut arguments = vec!["run", "graphs/variants/fibula_live.toml", "--serve", "--out", run.to_str().unwrap()];
    sets.iter().chain(&[OF_ANY_AGE]).for_each(|set| arguments.extend(["--set", set]));
    let served = Served::start(&arguments);
    let mut viewer = served.view();
    let wanted = ["/view/planes.planes", "/exact/planes.planes", "/exact/verdict.verdict", "/viewer/state"];
    while !wanted.iter().all(|topic| viewer.channels.contains_key(*topic)) {
        viewer.next().unwrap();
    }
    viewer.subscribe(|topic| wanted.contains(&topic));
    let mut got = Vec::new();
    loop {
        let (topic, _, data) = viewer.data().unwrap();
        let state = (topic == "/viewer/state").then(|| serde_json::from_slice::<Value>(&data).unwrap());
        if state.is_some_and(|state| state["state"] != "running") {
            return got;
        }
        got.push((topic, data));
    }
}

#[test]
fn other_viewers_get_the_planes_of_a_live_run_once_it_is_trusted_and_none_of_one_that_is_not() {
    let has_planes = |data: &[u8]| data.windows(7).any(|bytes| bytes == b"plane_1");
    let all = live_planes(&["recording.rate=20"]);
    let first = |wanted: &dyn Fn(&Received) -> bool| all.iter().position(wanted);
    let shown = first(&|(topic, data)| topic == "/view/planes.planes" && has_planes(data)).unwrap();
    let judged = first(&|(topic, _)| topic == "/exact/verdict.verdict").unwrap();
    let last_exact = all.iter().rposition(|(topic, _)| topic == "/exact/planes.planes").unwrap();
    println!("planes were first shown by message {shown} of {}, the verdict was {judged}", all.len());
    assert!(judged < shown, "planes were shown before they were judged");
    assert!(shown < last_exact, "planes are shown while the run goes on, not at its end");

    let refused = live_planes(&["recording.rate=20", "verdict.rules.max_misfit_mm=0.001", "results.require=trusted"]);
    assert!(refused.iter().any(|(topic, _)| topic == "/exact/planes.planes"));
    let n_shown = refused.iter().filter(|(topic, data)| topic == "/view/planes.planes" && has_planes(data)).count();
    assert_eq!(n_shown, 0, "planes of an answer that is not trusted");
}

/// The page in a browser, without a word of complaint.
fn open(browser: &mut Browser, served: &Served) {
    browser.events.clear();
    // A small view, as the renderer has no graphics card.
    let size = json!({ "width": 420, "height": 320, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("document.readyState === 'complete' && typeof osteoflow === 'object'");
}

/// Where a frame lies in the scene, column by column, metres.
fn place(browser: &mut Browser, frame: &str) -> Vec<f64> {
    let value = browser.evaluate(&format!("osteoflow.frames.toRoot({frame:?}).matrix.elements"));
    serde_json::from_value(value).unwrap()
}

#[test]
fn the_page_shows_a_recording_as_it_ended_and_as_it_was_before() {
    let run = shared_run(GRAPH, &WHITE);
    let results = &run.results;
    let served = Served::start(&["view", run.dir.path().to_str().unwrap()]);
    let Some(mut browser) = Browser::start("the_page_shows_a_recording") else { return };
    open(&mut browser, &served);
    browser.wait_until("osteoflow.scene.drawn.get('planes.planes')?.object.visible === true");
    assert_eq!(browser.evaluate("document.getElementById('verdict').className"), "verdict trusted");
    let sentence = results["verdict"]["sentence"].as_str().unwrap();
    assert_eq!(browser.evaluate("document.getElementById('verdict').textContent"), format!("trusted {sentence}"));
    assert_eq!(browser.evaluate("document.getElementById('watermark').textContent"), "simulated · recorded");
    assert_eq!(browser.evaluate("document.getElementById('watermark').hidden"), false);
    // The bone is drawn where the run's results have it: by the marker at the end and the registration.
    let planes = results["planes"].as_array().unwrap().len();
    assert_eq!(browser.evaluate("osteoflow.scene.drawn.get('planes.planes').object.children.length"), planes);
    let first = browser.evaluate("osteoflow.scene.drawn.get('planes.planes').object.children[0].position.toArray()");
    let rows: Vec<Vec<f64>> = serde_json::from_value(results["planes"][0]["matrix"].clone()).unwrap();
    let origin: Vec<f64> = (0..3).map(|k| rows[k][3]).collect();
    let off: f64 = (0..3).map(|k| (first[k].as_f64().unwrap() - origin[k]).abs()).sum();
    assert!(off < 1e-9, "{first} is not {origin:?}");
    // Planned planes on the bone and followed ones in the world are the same planes.
    let ct = place(&mut browser, "ct");
    let planned = browser.evaluate("osteoflow.scene.drawn.get('plan.planes').object.children[0].position.toArray()");
    let planned: Vec<f64> = serde_json::from_value(planned).unwrap();
    let carried: Vec<f64> =
        (0..3).map(|k| 1e3 * ct[12 + k] + (0..3).map(|c| ct[4 * c + k] * planned[c]).sum::<f64>()).collect();
    let off_mm = (0..3).map(|k| (carried[k] - origin[k]).powi(2)).sum::<f64>().sqrt();
    assert!(off_mm < 0.01, "the drawn bone is {off_mm} mm from the drawn planes");
    // Colours of the scan: most of it lies within 0.3 mm of the bone.
    browser.wait_until(
        "osteoflow.scene.drawn.get('to_bone.cloud').object.children[0].geometry.getAttribute('color') !== undefined",
    );
    browser.screenshot("0-recorded");

    // The graph: each node with what it did, and its parameters.
    let of = |browser: &mut Browser, node: &str| {
        browser.evaluate(&format!("[...document.querySelectorAll('#graph details')].find((row) => row.querySelector('b').textContent === '{node}').textContent"))
    };
    browser.wait_until("document.querySelectorAll('#graph details').length > 20 && document.querySelector('#graph span').textContent !== ''");
    let planes = of(&mut browser, "planes");
    assert!(planes.as_str().unwrap().contains("planes602 \u{d7}"), "{planes}");
    let icp = of(&mut browser, "icp");
    assert!(
        ["icp.point_to_plane", "source \u{2190} to_bone.cloud", "max_pair_distance_mm = "]
            .iter()
            .all(|text| icp.as_str().unwrap().contains(text)),
        "{icp}"
    );

    // Back to the start: nothing is judged, and no plane is drawn.
    browser.evaluate("(() => { const time = document.getElementById('time'); time.value = '0'; time.onchange(); })()");
    browser.wait_until("document.getElementById('verdict').className === 'verdict unknown'");
    browser.wait_until("[...osteoflow.scene.drawn.values()].every(({ payload, object }) => payload !== 'geometry/Planes' || !object.visible)");
    // Half-way the view is not empty. Earlier it may be: a surface is logged when it has been read (docs/decisions/0009), and a
    // busy machine reads it after the first scan.
    browser.evaluate("(() => { const time = document.getElementById('time'); time.value = String(0.5 * Number(time.max)); time.onchange(); })()");
    browser.wait_until("[...osteoflow.scene.drawn.values()].some(({ object }) => object.visible)");
    // And from the start on to the end at twenty times the speed.
    browser.evaluate("(() => { const time = document.getElementById('time'); time.value = '0'; time.onchange(); })()");
    browser.wait_until("document.getElementById('verdict').className === 'verdict unknown'");
    browser.evaluate(
        "(() => { document.getElementById('speed').value = '20'; document.getElementById('play').click(); })()",
    );
    browser.wait_until("document.getElementById('verdict').className === 'verdict trusted' && document.getElementById('play').textContent === 'play'");
    browser.wait_until("osteoflow.scene.drawn.get('planes.planes')?.object.visible === true");
    // The player has ended before the page has drawn what came last.
    browser.wait_until(&format!(
        "JSON.stringify(osteoflow.scene.drawn.get('planes.planes').object.children[0].position.toArray()) === JSON.stringify({first})"
    ));
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

/// A viewer that has not asked for it takes the state of a playback for an error, whichever subprotocol it offers.
#[test]
fn the_state_of_a_playback_goes_to_who_asks_for_it() {
    let ran = shared_run(GRAPH, &[]);
    let served = Served::start(&["view", ran.dir.path().to_str().unwrap()]);
    for protocol in ["foxglove.sdk.v1", "foxglove.websocket.v1"] {
        for (query, expected) in [("", false), ("?playback", true)] {
            let mut viewer = Viewer::connect(&format!("{}{query}", served.stream), None, protocol).unwrap();
            viewer.subscribe(|topic| topic.starts_with("/view/"));
            viewer.data().unwrap();
            assert_eq!(viewer.opcodes.contains(&PLAYBACK_STATE), expected, "{protocol} {query}");
        }
    }
}

#[test]
fn a_page_without_webgl_shows_verdict_numbers_graph_and_messages_and_says_what_is_missing() {
    let Some(mut browser) = Browser::start("a_page_without_webgl") else { return };
    let ran = shared_run(GRAPH, &WHITE);
    let served = Served::start(&["view", ran.dir.path().to_str().unwrap()]);
    let none = "const get = HTMLCanvasElement.prototype.getContext; HTMLCanvasElement.prototype.getContext = function (kind, ...rest) { \
                return kind.startsWith('webgl') ? null : get.call(this, kind, ...rest); }";
    browser.call("Page.addScriptToEvaluateOnNewDocument", json!({ "source": none }));
    open(&mut browser, &served);
    let answer = ran.results["verdict"]["answer"].as_str().unwrap();
    browser.wait_until(&format!("document.getElementById('verdict').className === 'verdict {answer}'"));
    browser.wait_until("document.querySelectorAll('#graph details').length > 10 && document.querySelectorAll('#numbers dd').length > 3");
    let said = browser.evaluate("document.querySelector('#view .missing').textContent");
    assert!(said.as_str().unwrap().starts_with("No view in three dimensions: this browser has no WebGL"), "{said}");
    // The planes are in the list, and nothing is thrown by a click that would draw.
    browser.evaluate("[...document.querySelectorAll('#sides button')].filter((b) => !b.hidden && b.id !== 'full').forEach((b) => b.click())");
    browser.wait_until("document.getElementById('shown').textContent.includes('planes')");
    let thrown = browser.complaints(&served.page);
    assert!(thrown.iter().all(|said| said.contains("WebGL context")), "{thrown:?}");
}

#[test]
fn planes_of_a_doubtful_answer_are_hatched_and_of_a_refused_one_not_drawn() {
    let Some(mut browser) = Browser::start("planes_of_a_doubtful_answer") else { return };
    let doubt = "verdict.rules.max_misfit_mm=0.001";
    let (dir, results) = a_run(&[doubt]);
    assert_eq!(results["verdict"]["answer"], "doubtful");
    let served = Served::start(&["view", path(&dir).to_str().unwrap()]);
    open(&mut browser, &served);
    browser.wait_until("document.getElementById('verdict').className === 'verdict doubtful'");
    browser.wait_until("osteoflow.scene.drawn.get('planes.planes')?.object.visible === true");
    let said = browser.evaluate("['verdict', 'reasons'].map((id) => document.getElementById(id).textContent).join()");
    let reasons = results["verdict"]["reasons"].as_array().unwrap().iter();
    for whole in reasons.map(|r| format!("{}; {}", r["reason"].as_str().unwrap(), r["remedy"].as_str().unwrap())) {
        assert_eq!(said.as_str().unwrap().matches(&whole).count(), 1, "{whole} is said once: {said}");
    }
    let hatched = "(() => { let n = 0; osteoflow.scene.drawn.get('planes.planes').object.traverse((part) => { if (part.userData.isPlane) n += part.userData.isHatched ? 1 : 100; }); return n; })()";
    browser.wait_until(&format!("{hatched} === 2"));
    browser.screenshot("0-doubtful");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());

    let (dir, results) = a_run(&[doubt, "results.require=trusted"]);
    assert_eq!(results["verdict"]["answer"], "refused");
    let served = Served::start(&["view", path(&dir).to_str().unwrap()]);
    open(&mut browser, &served);
    browser.wait_until("document.getElementById('verdict').className === 'verdict refused'");
    browser.wait_until(
        "osteoflow.scene.drawn.get('planes.planes')?.object.userData.why === 'the registration is refused'",
    );
    browser.screenshot("0-refused");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    assert_eq!(browser.evaluate("[...osteoflow.scene.drawn.values()].some(({ payload, object }) => payload === 'geometry/Planes' && object.visible)"), false);
}

#[test]
fn a_damaged_recording_is_shown_as_far_as_it_goes_and_says_so_at_the_top() {
    let (_dir, run) = copied_run(GRAPH, &[]);
    let file = run.join("run.mcap");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let served = Served::start(&["view", file.to_str().unwrap()]);
    let mut viewer = served.view();
    viewer.subscribe(|topic| topic == "/viewer/state");
    let (_, _, state) = viewer.data().unwrap();
    let state: Value = serde_json::from_slice(&state).unwrap();
    assert!(state["problem"].as_str().is_some_and(|problem| !problem.is_empty()), "{state}");
    assert_eq!(state["verdict"], Value::Null, "a run that was cut short has no verdict");
    let Some(mut browser) = Browser::start("a_damaged_recording") else { return };
    open(&mut browser, &served);
    browser.wait_until("document.getElementById('problem').hidden === false");
    assert!(browser.evaluate("document.getElementById('problem').textContent").as_str().unwrap().contains("damaged"));
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

#[test]
fn a_live_run_shows_what_is_unknown_as_unknown_and_its_planes_once_it_is_trusted() {
    let Some(mut browser) = Browser::start("a_live_run") else { return };
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run");
    let served = Served::start(&[
        "run",
        "graphs/variants/fibula_live.toml",
        "--set",
        "recording.rate=4",
        "--set",
        OF_ANY_AGE,
        "--out",
        run.to_str().unwrap(),
        "--serve",
    ]);
    open(&mut browser, &served);
    browser.wait_until("osteoflow.state.state === 'running' && osteoflow.state.origin === 'live' && osteoflow.scene.drawn.has('bone.mesh')");
    assert_eq!(browser.evaluate("document.getElementById('origin').textContent"), "simulated");
    // What arrives is drawn at once: the bone, and beside it the scan, which nothing places on the bone yet, grey and said to be so.
    browser.wait_until("osteoflow.scene.drawn.get('bone.mesh').object.visible");
    // All at one time: a moment later it is registered.
    browser.wait_until(
        "(() => { const { scene, beside, verdict } = osteoflow; const [there, here] = [beside.made, scene].map((view) => view?.drawn.get('to_bone.cloud')?.object); \
         return there?.visible === true && !there.children[0].material.vertexColors && here?.visible === false && verdict === null && \
         !document.getElementById('beside').hidden && document.getElementById('verdict').textContent === 'not judged yet' && \
         document.querySelector('#beside .caption').textContent === 'not registered: to_bone.cloud, in bone_marker'; })()",
    );
    // How old the planes are is beside them while the run goes on.
    browser
        .wait_until("/ms old, .* allowed$/.test(document.querySelector('[data-age=\"planes.planes\"]')?.textContent)");
    browser.wait_until("osteoflow.state.state === 'complete'");
    browser.wait_until(
        "osteoflow.verdict.answer === 'trusted' && osteoflow.scene.drawn.get('planes.planes').object.visible",
    );
    browser.wait_until(
        "osteoflow.scene.drawn.get('to_bone.cloud').object.visible && document.getElementById('beside').hidden",
    );
    let ms = browser.evaluate("(() => { const all = [...osteoflow.frameTimes].sort((a, b) => a - b); return all[Math.floor(0.95 * all.length)]; })()");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    println!("the page's script took {ms} ms a frame at 95 %");
    // The page says when the program has gone, and draws no plane of a run that it does not hear any more.
    assert_eq!(served.interrupt().code(), Some(0));
    browser.wait_until("document.body.classList.contains('closed')");
}

#[test]
fn a_bone_and_a_scan_are_registered_shown_and_the_pose_is_that_of_register() {
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run");
    let files = ["tests/data/folder/bone.stl", "tests/data/folder/scan.ply"];
    let served = Served::start(&["view", files[0], files[1], "--out", run.to_str().unwrap()]);
    let until = Instant::now() + LIMIT;
    while !run.join("results.json").exists() {
        assert!(Instant::now() < until, "the registration does not end");
        std::thread::sleep(Duration::from_millis(20));
    }
    let results: Value = serde_json::from_slice(&fs::read(run.join("results.json")).unwrap()).unwrap();
    let registered = osteoflow().arg("register").args(files).args(["--format", "json"]).output().unwrap();
    let registered: Value = serde_json::from_slice(&registered.stdout).unwrap();
    let matrix = |numbers: Vec<f64>| isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap();
    let rows: Vec<Vec<f64>> = serde_json::from_value(results["t_ct_camera"]["matrix"].clone()).unwrap();
    let (ours, theirs) = (matrix(rows.concat()), matrix(serde_json::from_value(registered["T"].clone()).unwrap()));
    let centroid: [f64; 3] = serde_json::from_value(results["icp"]["centroid_mm"].clone()).unwrap();
    let off_mm = (theirs * ours.inverse_transform_point(&Point3::from(centroid)) - Point3::from(centroid)).norm();
    let off_rad = ours.rotation.angle_to(&theirs.rotation);
    assert!(off_mm < 0.02 && off_rad < 1e-3, "{off_mm} mm, {off_rad} rad; the samples of the surface differ");
    assert!(run.join("export").is_dir(), "the pose for 3D Slicer");
    let Some(mut browser) = Browser::start("a_bone_and_a_scan") else { return };
    open(&mut browser, &served);
    browser.wait_until("document.getElementById('verdict').className === 'verdict trusted'");
    browser.wait_until("osteoflow.scene.drawn.get('bone.mesh')?.object.visible && osteoflow.scene.drawn.get('crop.cloud')?.object.visible");
    // The colours are the distances: none of the scan is far from the bone, and the page computes what the verdict measured.
    browser.wait_until("osteoflow.scene.residuals?.has('crop.cloud')");
    let median = browser.evaluate("(() => { const all = [...osteoflow.scene.residuals.get('crop.cloud')].map(Math.abs).sort((a, b) => a - b); return all[all.length >> 1]; })()");
    let expected = results["verdict"]["measured"]["median_mm"].as_f64().unwrap();
    assert!((median.as_f64().unwrap() - expected).abs() < 0.1 * expected, "{median} {expected}");
    browser.evaluate("document.getElementById('glass').click()");
    browser.wait_until("osteoflow.scene.drawn.get('bone.mesh').object.children[0].material.opacity < 1");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());

    let refused = osteoflow().args(["view", files[0], "--out", "x"]).output().unwrap();
    assert_eq!(refused.status.code(), Some(2), "--out is for a registration");
    let missing = osteoflow().args(["view", files[0], "no-scan.ply"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(missing.status.code() == Some(1) && stderr.contains("no-scan.ply"), "{stderr}");
}

/// The ellipsoids that a page draws: where each is, and its semi-axes as vectors, the longest first, in the frame of the points, mm.
fn ellipsoids(browser: &mut Browser) -> Vec<([f64; 3], [[f64; 3]; 3])> {
    let all = browser.evaluate(
        "[...osteoflow.scene.drawn.values()].flatMap(({ object }) => object.children.filter((part) => part.userData.isEllipsoid \
         && object.visible)).map((part) => { part.updateMatrix(); const e = part.matrix.elements; \
         return [e.slice(12, 15), [0, 4, 8].map((k) => e.slice(k, k + 3))]; })",
    );
    serde_json::from_value(all).unwrap()
}

#[test]
fn targets_are_drawn_with_the_ellipsoids_of_the_verdict_on_the_page_and_none_without_a_prediction() {
    let Some(mut browser) = Browser::start("targets_are_drawn_with_the_ellipsoids") else { return };
    let dir = tempfile::tempdir().unwrap();
    let at = [("near", [-87.0, -87.0, -900.0]), ("far", [-87.0, 63.0, -900.0])];
    let rows = at.map(|(name, [x, y, z])| format!("{name},{x},{y},{z}\n")).concat();
    let targets = dir.path().join("targets.csv");
    fs::write(&targets, format!("label,x,y,z\n{rows}")).unwrap();
    let files = ["tests/data/folder/bone.stl", "tests/data/folder/scan.ply"];
    for has_targets in [true, false] {
        let run = dir.path().join(format!("run-{has_targets}"));
        let view = ["view", files[0], files[1], "--out", run.to_str().unwrap(), "--targets", targets.to_str().unwrap()];
        let served = Served::start(if has_targets { &view } else { &view[..5] });
        open(&mut browser, &served);
        browser.wait_until("['trusted', 'doubtful'].includes(osteoflow.state.verdict?.answer)");
        browser.wait_until("osteoflow.scene.drawn.get('bone.mesh')?.object.visible");
        browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
        if !has_targets {
            assert_eq!(ellipsoids(&mut browser), []);
            assert_eq!(browser.evaluate("document.getElementById('errors').hidden"), true);
            continue;
        }
        browser.wait_until("osteoflow.scene.drawn.get('targets.points')?.object.visible");
        browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
        let check = |browser: &mut Browser| {
            let drawn = ellipsoids(browser);
            let results: Value = serde_json::from_slice(&fs::read(run.join("results.json")).unwrap()).unwrap();
            let predicted = results["verdict"]["predicted"]["points"].as_array().unwrap();
            assert_eq!((drawn.len(), predicted.len()), (2, 2), "{predicted:?}");
            for ((place, axes), (point, (name, position))) in drawn.iter().zip(predicted.iter().zip(at)) {
                assert_eq!((&point["name"], *place), (&json!(name), position));
                let semi_axes_mm: [f64; 3] = serde_json::from_value(point["semi_axes_mm"].clone()).unwrap();
                let directions: [[f64; 3]; 3] = serde_json::from_value(point["directions"].clone()).unwrap();
                for ((axis, mm), direction) in axes.iter().zip(semi_axes_mm).zip(directions) {
                    let [axis, direction] = [axis, &direction].map(|v| Vector3::from(*v));
                    // An axis has no sense.
                    let off_mm = (axis - direction * mm).norm().min((axis + direction * mm).norm());
                    assert!(
                        mm > 0.0 && off_mm < 1e-6 * mm.max(1.0),
                        "{name}: {axis:?} is not {mm} mm along {direction:?}"
                    );
                }
            }
            let longest = [0, 1].map(|k| Vector3::from(drawn[k].1[0]).norm());
            assert!(longest[1] > 2.0 * longest[0], "far away it is larger: {longest:?} mm");
            predicted.clone()
        };
        let predicted = check(&mut browser);
        let cell = |row: usize, column: usize| {
            format!("document.querySelector('#errors tbody').rows[{row}].cells[{column}].textContent")
        };
        for (row, point) in predicted.iter().enumerate() {
            let axes: [f64; 3] = serde_json::from_value(point["semi_axes_mm"].clone()).unwrap();
            assert_eq!(browser.evaluate(&cell(row, 0)), point["name"]);
            assert_eq!(browser.evaluate(&cell(row, 3)), json!(axes.map(|mm| format!("{mm:.2}")).join(" \u{d7} ")));
        }
        let legend = browser.evaluate("document.getElementById('errors').textContent").to_string();
        assert!(legend.contains("ellipsoid that holds the point with 90 %"), "{legend}");
        // Of an answer that is refused, or not there, nothing is predicted; what the layer hides is hidden with it.
        for (judge, n) in [("judge('refused', null)", 0), ("choose('targets.points', false)", 0)] {
            browser.evaluate(&format!("osteoflow.scene.{judge}"));
            browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
            assert_eq!(ellipsoids(&mut browser).len(), n, "{judge}");
        }
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
        drop(served);
        // The recording shows the same.
        let served = Served::start(&["view", run.to_str().unwrap()]);
        open(&mut browser, &served);
        browser.wait_until(
            "osteoflow.scene.drawn.get('targets.points')?.object.children.some((part) => part.userData.isEllipsoid)",
        );
        check(&mut browser);
    }
}

#[test]
fn a_page_of_two_files_takes_the_options_of_register_and_has_its_pose_to_the_bit() {
    let files = ["tests/data/folder/bone.stl", "tests/data/folder/scan.ply"];
    let picks = ["tests/data/picks/bone_points.mrk.json", "tests/data/picks/scan_points.mrk.json"];
    let folder = tempfile::tempdir().unwrap();
    let start = folder.path().join("start.txt");
    let start = start.to_str().unwrap();
    osteoflow().arg("register").args(files).args(["--no-verdict", "--out", start]).assert().success();
    let options: [&[&str]; 4] = [
        &["--init", start, "--no-verdict"],
        &["--camera", "0,0,0"],
        &[
            "--method",
            "point_to_point",
            "--max-pair-distance-mm",
            "4",
            "--source-component",
            "largest",
            "--max-points",
            "900",
        ],
        &[
            "--landmarks",
            picks[0],
            picks[1],
            "--seed",
            "7",
            "--target-points",
            "20000",
            "--sphere",
            "0,0,0,100000",
            "--targets",
            picks[0],
        ],
    ];
    for of in options {
        let out = tempfile::tempdir().unwrap();
        let run = out.path().join("run");
        let view = [&["view", files[0], files[1], "--out", run.to_str().unwrap()], of].concat();
        let served = Served::start(&view);
        let until = Instant::now() + LIMIT;
        while !run.join("results.json").exists() {
            assert!(Instant::now() < until, "{of:?}: the registration does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
        drop(served);
        let results: Value = serde_json::from_slice(&fs::read(run.join("results.json")).unwrap()).unwrap();
        let registered = osteoflow().arg("register").args(files).args(of).args(["--format", "json"]).output().unwrap();
        let registered: Value = serde_json::from_slice(&registered.stdout).unwrap();
        let rows: Vec<Vec<f64>> = serde_json::from_value(results["t_ct_camera"]["matrix"].clone()).unwrap();
        let row_by_row: Vec<f64> = serde_json::from_value(registered["T"].clone()).unwrap();
        // A given start is rounded on its way into the graph.
        let tolerance = if of.contains(&"--init") { 1e-9 } else { 0.0 };
        let is_same = rows.concat().iter().zip(&row_by_row).all(|(a, b)| (a - b).abs() <= tolerance);
        assert!(is_same && row_by_row.len() == 16, "{of:?}: {rows:?} {row_by_row:?}");
        assert_eq!(results["verdict"]["answer"], registered["verdict"]["answer"], "{of:?}");
        let predicted = [&results, &registered].map(|of| of["verdict"]["predicted"]["points"].clone());
        assert_eq!(predicted[0], predicted[1], "{of:?}");
        assert_eq!(predicted[0].is_array(), of.contains(&"--targets"), "{of:?}");
    }
    for (arguments, words) in [
        (&["view", files[0], files[1], "--repeat", "2"][..], "are for register"),
        (&["view", files[0], files[1], "--cmaera", "0,0,0"], "--camera"),
        (&["view", "graphs/two_files.toml", "--camera", "0,0,0"], "SCAN"),
    ] {
        let refused = osteoflow().args(arguments).output().unwrap();
        let stderr = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(refused.status.code() == Some(2) && stderr.contains(words), "{arguments:?}: {stderr}");
    }
}

/// The scripts say the types of what they take and give in their comments; a compiler checks that all calls fit them.
#[test]
fn the_scripts_of_the_page_pass_the_check_of_their_types() {
    if skips_slow("the_scripts_of_the_page_pass_the_check_of_their_types") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let node =
        |program: &str, arguments: &[&str]| Command::new(program).args(arguments).current_dir(dir.path()).output();
    let install = ["install", "--silent", "--no-audit", "--no-fund", "typescript@7.0.2", "@types/three@0.185.4"];
    if !node("npm", &install).is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: the_scripts_of_the_page_pass_the_check_of_their_types: npm could not install typescript");
        return;
    }
    let page = dir.path().join("page");
    fs::create_dir_all(&page).unwrap();
    let mut n = 0;
    for folder in ["nodes/pages/viewer/page", "nodes/pages/report/page"] {
        for file in fs::read_dir(crate::common::root().join(folder)).unwrap().map(|entry| entry.unwrap().path()) {
            // The loader is a script in the text of a report, without modules and types.
            if file.extension().is_some_and(|ending| ending == "js") && !file.ends_with("loader.js") {
                fs::copy(&file, page.join(file.file_name().unwrap())).unwrap();
                n += 1;
            }
        }
    }
    assert!(n > 25, "{n} scripts");
    let options = json!({
        "allowJs": true, "checkJs": true, "noEmit": true, "strict": true, "skipLibCheck": true, "types": [],
        "target": "es2022", "module": "es2022", "moduleResolution": "bundler", "lib": ["es2023", "dom", "dom.iterable"],
        "paths": { "three": ["./node_modules/@types/three"] },
    });
    let config = json!({ "compilerOptions": options, "include": ["page/*.js"] });
    fs::write(dir.path().join("tsconfig.json"), config.to_string()).unwrap();
    let check = || node("node", &["node_modules/typescript/bin/tsc", "--project", "."]).unwrap();
    let checked = check();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stdout));
    // A wrong call is found.
    fs::write(page.join("wrong.js"), "import { post } from \"./request.js\";\npost(1, {});\n").unwrap();
    assert!(!check().status.success());
}

#[test]
fn the_vendored_files_are_those_of_the_decision() {
    let root = crate::common::root();
    let decision =
        fs::read_to_string(root.join("docs/decisions/0032-viewers-are-served-by-a-small-server.md")).unwrap();
    let mut n = 0;
    for entry in fs::read_dir(root.join("nodes/pages/viewer/page/three")).unwrap() {
        let file = entry.unwrap().path();
        let Ok(output) = Command::new("sha256sum").arg(&file).output() else {
            return println!("skipped: the vendored files: no sha256sum");
        };
        let sum = String::from_utf8(output.stdout).unwrap().split_whitespace().next().unwrap().to_owned();
        let name = file.file_name().unwrap().to_str().unwrap();
        let row = decision.lines().find(|line| line.starts_with(&format!("| `{name}`"))).unwrap_or_default();
        assert!(row.contains(&sum), "{name}: {sum}");
        n += 1;
    }
    assert_eq!(n, 3);
}
