//! The page beside a camera of 20 clouds of 20,000 points a second: 30 minutes, with SLOW_TESTS only.
//!
//! Memory of page and program, and messages lost, decide; times are printed for docs/project/measured.md.

use crate::common::{browser::Browser, is_slow_run, served::Served};
use osteoflow_formats::{
    mesh_or_cloud::read_mesh,
    openigtlink::{Affine, Body, Message, PolyData, device_name},
};
use osteoflow_geometry::{
    SurfaceOrigin,
    nalgebra::{Isometry3, Point3, Vector3},
};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use serde_json::{Value, json};
use std::{
    fs,
    io::{ErrorKind, Read, Write},
    net::{TcpListener, TcpStream},
    path::Path,
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};
use tungstenite::{ClientRequestBuilder, Message as Frame};

const HZ: u32 = 20;
const N_POINTS: usize = 20_000;
/// Growth of memory that is none: a garbage collector's slack, with room.
const FLAT_BYTES: f64 = 48e6;
/// What may wait for a viewer, as docs/begin/viewing.md has it.
const WAITING_BYTES: f64 = 64e6;

/// Clouds on the bone's surface, each with its own noise of 0.3 mm.
fn clouds() -> Vec<Vec<[f32; 3]>> {
    let mesh = read_mesh(Path::new("tests/data/folder/bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let mut uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX);
    let mut cloud = || {
        let point = || {
            let face = mesh.faces()[(uniform() * (mesh.faces().len() - 1) as f64) as usize];
            let [a, b, c] = face.map(|k| mesh.vertices()[k as usize]);
            let (s, t) = (uniform(), uniform());
            let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
            let noise = Vector3::from_fn(|_, _| 0.6 * (uniform() - 0.5));
            let p: Point3<f64> = a + s * (b - a) + t * (c - a) + noise;
            [p.x as f32, p.y as f32, p.z as f32]
        };
        std::iter::repeat_with(point).take(N_POINTS).collect()
    };
    (0..10).map(|_| cloud()).collect()
}

/// Sends clouds and the pose of the bone for a time, to one client; returns the number of clouds.
fn camera(clouds: Vec<Vec<[f32; 3]>>, time: Duration) -> (String, JoinHandle<u32>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let sender = thread::spawn(move || {
        let mut stream = listener.accept().unwrap().0;
        let began = Instant::now();
        let n = HZ * time.as_secs() as u32;
        for k in 0..n {
            thread::sleep((Duration::from_secs(1) * k / HZ).saturating_sub(began.elapsed()));
            let stamp_ns = 1_750_000_000_000_000_000 + i64::from(k) * 1_000_000_000 / i64::from(HZ);
            let turn = Isometry3::new(Vector3::new(0.0, 0.0, 500.0), Vector3::z() * (f64::from(k) * 0.002));
            let cloud = clouds[k as usize % clouds.len()].clone();
            for (device, body) in [
                (device_name("world", "ct"), Body::Transform(Affine::of(&turn))),
                ("Scan".into(), Body::PolyData(PolyData::of_points(cloud))),
            ] {
                stream.write_all(&Message::new(device, stamp_ns, body).to_bytes().unwrap()).unwrap();
            }
        }
        finish(&mut stream);
        n
    });
    (address, sender)
}

/// Closes a connection once the other side has read all of it.
fn finish(stream: &mut TcpStream) {
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    let mut unread = [0; 1024];
    loop {
        match stream.read(&mut unread) {
            Ok(0) => return,
            Err(error) if error.kind() != ErrorKind::Interrupted => return,
            _ => {}
        }
    }
}

/// A graph that reads the camera and crops its clouds.
fn graph(folder: &Path, address: &str) -> String {
    let bone = fs::canonicalize("tests/data/folder/bone.stl").unwrap();
    let text = format!(
        r#"[graph]
format = 1
name = "camera"
frames = ["world", "ct"]

[node.bone]
kind = "surface.file"
path = {bone:?}

[node.camera]
kind = "acquire.openigtlink"
address = "{address}"
reconnect = false
out.scan = {{ type = "geometry/Cloud", device = "Scan", frame = "ct", space = "lps" }}
out.bone = {{ type = "geometry/Pose", device = "{}", to = "world", from = "ct", space = "lps" }}

[node.crop]
kind = "crop.box"
in   = {{ cloud = "camera.scan" }}
"#,
        device_name("world", "ct")
    );
    let path = folder.join("camera.toml");
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// Reads every channel of a stream, and draws nothing; returns the number of messages at the stream's end.
fn reader(stream: &str) -> JoinHandle<u32> {
    let host = stream.strip_prefix("ws://").unwrap().split('/').next().unwrap();
    let connection = TcpStream::connect(host).unwrap();
    let request = ClientRequestBuilder::new(stream.parse().unwrap()).with_sub_protocol("foxglove.sdk.v1");
    let (mut socket, _) = tungstenite::client(request, connection).unwrap();
    thread::spawn(move || {
        let mut n = 0;
        loop {
            match socket.read() {
                Ok(Frame::Binary(_)) => n += 1,
                Ok(Frame::Text(text)) => {
                    let message: Value = serde_json::from_str(&text).unwrap();
                    let Some(channels) = message["channels"].as_array().filter(|_| message["op"] == "advertise") else {
                        continue;
                    };
                    let rows: Vec<_> =
                        channels.iter().map(|it| json!({ "id": it["id"], "channelId": it["id"] })).collect();
                    let subscribe = json!({ "op": "subscribe", "subscriptions": rows });
                    socket.send(Frame::text(subscribe.to_string())).unwrap();
                }
                Ok(_) => {}
                Err(_) => return n,
            }
        }
    })
}

/// Number of messages that viewers lost, as the command says it at its end.
fn n_lost(said: &str) -> u32 {
    let Some((_, rest)) = said.split_once("slow viewers lost ") else { return 0 };
    rest.split(' ').next().unwrap().replace(',', "").parse().unwrap()
}

/// Median and 95 % of the latency from camera to crop, ms, the numbers of clouds sent and dropped.
fn of_manifest(run: &Path) -> (f64, f64, u64, u64) {
    let manifest: Value = serde_json::from_slice(&fs::read(run.join("manifest.json")).unwrap()).unwrap();
    let find = |list: &str, keep: &dyn Fn(&Value) -> bool| {
        manifest[list].as_array().unwrap().iter().find(|row| keep(row)).cloned().unwrap_or_else(|| panic!("{list}"))
    };
    let latency = find("latencies", &|row| row["source"] == "camera");
    let wire = find("links", &|row| row["from"] == "camera.scan");
    let ms = |name: &str| latency[name].as_f64().unwrap_or_else(|| panic!("{name} in {latency}"));
    (ms("p50_ms"), ms("p95_ms"), wire["sent"].as_u64().unwrap(), wire["dropped"].as_u64().unwrap())
}

#[test]
fn beside_a_fast_camera_memory_stays_and_only_the_viewer_loses_messages() {
    if !is_slow_run() {
        eprintln!("skipped: beside_a_fast_camera: it takes half an hour; set SLOW_TESTS");
        return;
    }
    let minutes = 30;
    let (time, all) = (Duration::from_secs(60 * minutes), clouds());
    let folder = tempfile::tempdir().unwrap();
    let Some(mut browser) = Browser::start("beside_a_fast_camera") else { return };

    let (address, sender) = camera(all.clone(), Duration::from_secs(20));
    let alone = folder.path().join("alone");
    let graph_file = graph(folder.path(), &address);
    let ran = crate::common::osteoflow().arg("run").arg(&graph_file).arg("--out").arg(&alone).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    assert_eq!(sender.join().unwrap(), 20 * HZ);
    let (p50, p95, ..) = of_manifest(&alone);

    let (address, sender) = camera(all.clone(), Duration::from_secs(20));
    let read = folder.path().join("read");
    let served = Served::start(&["run", &graph(folder.path(), &address), "--serve", "--out", read.to_str().unwrap()]);
    let reading = reader(&served.stream);
    assert_eq!(sender.join().unwrap(), 20 * HZ);
    while !read.join("manifest.json").exists() {
        thread::sleep(Duration::from_millis(100));
    }
    let said = served.interrupt_and_read();
    let (n_read, n_lost) = (reading.join().unwrap(), n_lost(&said));
    println!("a viewer that only reads got {n_read} messages and lost {n_lost}");
    // A busy machine may be slow; what is not read is counted.
    assert!(n_read + n_lost > 2 * 20 * HZ, "{n_read} messages read and {n_lost} lost of the clouds of two wires");
    let (read_p50, read_p95, ..) = of_manifest(&read);

    let (address, sender) = camera(all, time);
    let run = folder.path().join("served");
    let served = Served::start(&["run", &graph(folder.path(), &address), "--serve", "--out", run.to_str().unwrap()]);
    let size = json!({ "width": 420, "height": 320, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("typeof osteoflow === 'object' && osteoflow.scene.drawn.get('camera.scan')?.object.visible");
    let memory = |browser: &mut Browser| {
        browser.call("HeapProfiler.enable", json!({}));
        browser.call("HeapProfiler.collectGarbage", json!({}));
        let heap = browser.call("Runtime.getHeapUsage", json!({}));
        let page = heap["usedSize"].as_f64().unwrap() + heap["backingStorageSize"].as_f64().unwrap_or(0.0);
        (page, served.resident_bytes())
    };
    let began = Instant::now();
    // After a first part in which buffers fill.
    thread::sleep(time / 6);
    let first = memory(&mut browser);
    let mut rows = vec![first];
    while began.elapsed() + time / 6 < time - Duration::from_secs(10) {
        thread::sleep(time / 6);
        rows.push(memory(&mut browser));
    }
    assert!(rows.len() >= 4, "{} measurements", rows.len());
    let ms = browser.evaluate("(() => { const all = [...osteoflow.frameTimes].sort((a, b) => a - b); return all[Math.floor(0.95 * all.length)]; })()");
    let n = sender.join().unwrap();
    browser.wait_until("osteoflow.state.state === 'complete'");
    let said = served.interrupt_and_read();

    let (served_p50, served_p95, sent, dropped) = of_manifest(&run);
    println!("{minutes} min, {n} clouds of {N_POINTS} points at {HZ} Hz");
    println!(
        "camera to crop, ms: alone {p50:.2} ({p95:.2} at 95 %), read by a program {read_p50:.2} ({read_p95:.2}), \
         drawn by a browser {served_p50:.2} ({served_p95:.2})"
    );
    println!("the page's script: {ms} ms a frame at 95 %");
    for (page, program) in &rows {
        println!("page {:.1} MB, program {:.1} MB", page / 1e6, program / 1e6);
    }
    println!("{}", said.lines().find(|line| line.contains("slow viewers")).unwrap_or("no message was lost"));
    assert_eq!((sent, dropped), (u64::from(n), 0), "clouds on the graph's wire");
    for (page, program) in &rows {
        assert!(page - first.0 < FLAT_BYTES, "the page grows from {} to {page} bytes", first.0);
        assert!(
            program - first.1 < FLAT_BYTES + WAITING_BYTES,
            "the program grows from {} to {program} bytes",
            first.1
        );
    }
}
