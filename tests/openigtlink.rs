//! OpenIGTLink from the command line: the whole method from a simulated tracker and camera.

use crate::common::{OF_ANY_AGE, browser::Browser, isometry, osteoflow, root, run_whole, served::Served};
use osteoflow_formats::openigtlink::{Body, Decoder, Message};
use serde_json::Value;
use std::{
    io::{BufRead, BufReader, Read},
    net::{SocketAddr, TcpListener, TcpStream},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

const LIVE: &str = "graphs/variants/fibula_live_openigtlink.toml";
const RECORDED: &str = "graphs/fibula_recorded.toml";

/// A simulated rig at a free port; ended when dropped.
struct Rig {
    process: Child,
    address: String,
}

impl Rig {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(osteoflow().get_program());
        command.current_dir(root()).args(["simulate", "--openigtlink", "0"]).args(arguments);
        let mut process = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(process.stderr.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("SIMULATED procedure over OpenIGTLink at ").unwrap().to_owned();
        Self { process, address }
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// An address that nobody listens at.
fn free_address() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

/// The largest difference between the numbers of two results, and where it is.
fn largest_difference(a: &Value, b: &Value, path: &str) -> (f64, String) {
    let worst =
        |all: Vec<(f64, String)>| all.into_iter().fold((0.0, path.to_owned()), |w, x| if x.0 > w.0 { x } else { w });
    match (a, b) {
        (Value::Number(x), Value::Number(y)) => ((x.as_f64().unwrap() - y.as_f64().unwrap()).abs(), path.to_owned()),
        (Value::Array(x), Value::Array(y)) if x.len() == y.len() => worst(
            x.iter().zip(y).enumerate().map(|(k, (x, y))| largest_difference(x, y, &format!("{path}.{k}"))).collect(),
        ),
        (Value::Object(x), Value::Object(y)) => {
            assert_eq!(x.keys().collect::<Vec<_>>(), y.keys().collect::<Vec<_>>(), "{path}");
            worst(x.iter().map(|(key, x)| largest_difference(x, &y[key], &format!("{path}.{key}"))).collect())
        }
        _ => {
            assert_eq!(a, b, "{path}");
            (0.0, path.to_owned())
        }
    }
}

#[test]
fn the_whole_method_over_openigtlink_gives_the_results_of_the_same_procedure_from_file() {
    let recorded = run_whole(
        RECORDED,
        &["--no-record", "--set", r#"remove=["node.verdict.in.measured", "node.verdict.in.followed"]"#],
    );
    for (workers, scans) in [("1", "image"), ("8", "polydata"), ("2", "point")] {
        let rig = Rig::start(&["--points", "10000", "--rate", "1e6", "--scans", scans]);
        let address = format!("recording.address={}", rig.address);
        let navigation = format!("navigation.address={}", free_address());
        let arguments =
            ["--no-record", "--workers", workers, "--set", &address, "--set", &navigation, "--set", OF_ANY_AGE];
        let live = run_whole(LIVE, &arguments);
        for key in ["poses", "planes", "planes_at_scan", "laser_points", "metrics"] {
            let (difference, at) = largest_difference(&live.results[key], &recorded.results[key], key);
            assert!(difference < 0.05, "{at}: {difference} mm apart");
            println!("{key}, scans as {scans}: at most {difference:.1e} apart, at {at}");
        }
        assert_eq!(live.results["verdict"]["answer"], "trusted");
        assert_eq!(live.results["simulated"], true);
        assert!(!live.stderr.contains("equal to the last bit"), "{}", live.stderr);
        assert!(!live.stderr.contains("late") && !live.stderr.contains("has not come"), "{}", live.stderr);
    }
}

/// Everything that a run sends to a receiver, until it closes.
fn receive(address: SocketAddr) -> Vec<Message> {
    let until = Instant::now() + Duration::from_secs(60);
    let mut stream = loop {
        match TcpStream::connect(address) {
            Ok(stream) => break stream,
            Err(error) => assert!(Instant::now() < until, "{error}"),
        }
        thread::sleep(Duration::from_millis(5));
    };
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let mut decoder = Decoder::default();
    decoder.push(&bytes);
    decoder.map(Result::unwrap).collect()
}

#[test]
fn a_receiver_gets_registration_and_planes_of_the_results_while_they_are_trusted() {
    let rig = Rig::start(&["--points", "10000", "--rate", "10"]);
    let navigation = free_address();
    let receiver = thread::spawn(move || receive(navigation));
    let [address, navigation] = [("recording", rig.address.clone()), ("navigation", navigation.to_string())]
        .map(|(node, address)| format!("{node}.address={address}"));
    let live = run_whole(LIVE, &["--no-record", "--set", &address, "--set", &navigation, "--set", OF_ANY_AGE]);
    let messages = receiver.join().unwrap();
    // At the rate of a tracker all planes are sent; as fast as a file is read, a busy machine leaves some out.
    assert!(!live.stderr.contains("some are not sent"), "{}", live.stderr);
    let transforms = |device: &str| -> Vec<_> {
        let of_device = messages.iter().filter(|message| message.device == device);
        of_device.filter_map(|m| if let Body::Transform(affine) = m.body { Some(affine) } else { None }).collect()
    };
    let planes = transforms("Plane1ToWorld");
    assert!(planes.len() > 20, "{} planes", planes.len());
    let last = planes.last().unwrap().rigid().unwrap().value;
    let expected = isometry(&live.results["planes"][0]["matrix"]);
    assert!((last.translation.vector - expected.translation.vector).norm() < 0.001, "{last} is not {expected}");
    let t_ras_world = transforms("WorldToRas")[0].rigid().unwrap().value;
    let t_ct_world = isometry(&live.results["poses"]["t_ct_world"]["matrix"]);
    let (ras, lps) = (t_ras_world.translation.vector, t_ct_world.translation.vector);
    assert!((ras.x + lps.x).abs() + (ras.y + lps.y).abs() + (ras.z - lps.z).abs() < 0.001, "{ras} is not RAS of {lps}");
    let statuses: Vec<_> = messages
        .iter()
        .filter_map(|m| if let Body::Status(status) = &m.body { Some(status.name.as_str()) } else { None })
        .collect();
    assert!(statuses.contains(&"planes sent") && statuses.last() == Some(&"exiting"), "{statuses:?}");
}

#[test]
fn the_page_draws_at_once_what_comes_over_openigtlink_grey_and_said_to_be_unregistered_until_it_is() {
    let Some(mut browser) = Browser::start("the_page_draws_at_once_what_comes_over_openigtlink") else { return };
    // So slow that a page sees the scan before it is registered.
    let rig = Rig::start(&["--points", "5000", "--rate", "2"]);
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run").display().to_string();
    let [address, navigation] = [("recording", rig.address.clone()), ("navigation", free_address().to_string())]
        .map(|(node, address)| format!("{node}.address={address}"));
    let served = Served::start(&["run", LIVE, "--serve", "--out", &run, "--set", &address, "--set", &navigation]);
    browser.events.clear();
    browser.call("Page.navigate", serde_json::json!({ "url": served.page }));
    // The phantom's scan, which comes first, stands for no scan of the bone.
    browser.wait_until(
        "typeof osteoflow === 'object' && osteoflow.scene.drawn.has('recording.phantom_scan') && osteoflow.scene.derived.has('recording.scan')",
    );
    assert_eq!(
        browser.evaluate("osteoflow.scene.isReplaced('recording.scan') && !osteoflow.scene.drawn.has('to_bone.cloud')"),
        false
    );
    browser.wait_until(
        "(() => { const { scene, beside, verdict } = osteoflow; const there = beside.made?.drawn.get('to_bone.cloud')?.object; \
         return there?.visible === true && !there.children[0].material.vertexColors && verdict === null && \
         scene.drawn.get('bone.mesh')?.object.visible && !scene.drawn.get('to_bone.cloud').object.visible && \
         document.querySelector('#beside .caption').textContent === 'not registered: to_bone.cloud, in bone_marker' && \
         document.getElementById('shown').textContent.includes('not registered: shown beside the bone, in bone_marker'); })()",
    );
    browser.wait_until(
        "osteoflow.verdict?.answer === 'trusted' && osteoflow.scene.drawn.get('to_bone.cloud').object.visible && \
         document.getElementById('beside').hidden && osteoflow.scene.drawn.get('planes.planes')?.object.visible",
    );
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

#[test]
fn a_recorded_run_replays_without_rig_and_receivers() {
    let rig = Rig::start(&["--points", "2000", "--rate", "1e6"]);
    let navigation = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = navigation.local_addr().unwrap();
    drop(navigation);
    let sets = [format!("recording.address={}", rig.address), format!("navigation.address={address}")];
    let live = crate::common::run(LIVE, &["--set", &sets[0], "--set", &sets[1]]);
    drop(rig);
    // Nobody else may listen there if the replay did.
    let _taken = TcpListener::bind(address).unwrap();
    let replay = osteoflow().arg("replay").arg(live.dir.path().join("run.mcap")).output().unwrap();
    let printed = String::from_utf8_lossy(&replay.stdout);
    assert!(printed.contains(", 0 differ, "), "{printed}{}", String::from_utf8_lossy(&replay.stderr));
}

#[test]
fn a_rig_that_leaves_half_way_gives_no_planes_and_the_run_says_why() {
    let rig = Rig::start(&["--points", "2000", "--rate", "1"]);
    let address = format!("recording.address={}", rig.address);
    let navigation = format!("navigation.address={}", free_address());
    let process = thread::spawn(move || {
        thread::sleep(Duration::from_secs(2));
        drop(rig);
    });
    let arguments = ["--no-record", "--set", &address, "--set", &navigation];
    let ran = crate::common::run(LIVE, &arguments);
    process.join().unwrap();
    assert_ne!(ran.code, 0, "{}", ran.stderr);
    assert!(ran.stderr.contains("has not come"), "{}", ran.stderr);
    assert!(ran.results.get("planes").is_none_or(Value::is_null), "{}", ran.results);
}
