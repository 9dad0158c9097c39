//! A graph that is changed on the page: parameters, kinds, the region of interest; what is refused, and what is written back.

use crate::common::browser::Browser;
use crate::common::served::Served;
use crate::common::skips_slow;
use crate::common::{osteoflow, read_by_viewers};
use serde_json::{Value, json};
use std::{
    fs,
    net::TcpStream,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

const LIMIT: Duration = Duration::from_secs(60);

/// A copy of the shipped graphs that may be written, and the folder of the runs.
pub(crate) struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    pub(crate) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in ["fibula.toml", "variants/fibula_point_to_point.toml"] {
            let to = folder.path().join(name);
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs").join(name), to).unwrap();
        }
        Self { folder }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    /// Serves a graph of the folder and waits for its first run.
    pub(crate) fn view(&self, graph: &str, arguments: &[&str]) -> Served {
        let (graph, out, picks) = (self.path(graph), self.path("run"), self.path("picks"));
        let mut all = vec!["view", graph.to_str().unwrap(), "--out", out.to_str().unwrap(), "--picks"];
        all.push(picks.to_str().unwrap());
        all.extend(arguments);
        let served = Served::start(&all);
        self.results(1);
        served
    }

    /// The folder of the n-th run.
    pub(crate) fn run(&self, n: usize) -> PathBuf {
        self.path(&if n == 1 { "run".to_owned() } else { format!("run-{n}") })
    }

    /// The results of the n-th run, once it has ended.
    pub(crate) fn results(&self, n: usize) -> Value {
        let (file, until) = (self.run(n).join("results.json"), Instant::now() + LIMIT);
        // The manifest is written last.
        while !self.run(n).join("manifest.json").exists() {
            assert!(Instant::now() < until, "run {n} does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
        serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap()
    }

    /// The results of the same graph from the command line.
    fn on_command_line(&self, graph: &str, sets: &[&str]) -> Value {
        let out = tempfile::tempdir().unwrap();
        let sets = sets.iter().flat_map(|set| ["--set", set]);
        let (graph, out_dir) = (self.path(graph), out.path().join("run"));
        let run = osteoflow().arg("run").arg(graph).args(sets).arg("--out").arg(&out_dir).output().unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        serde_json::from_str(&fs::read_to_string(out_dir.join("results.json")).unwrap()).unwrap()
    }
}

/// Posts JSON; the status and the answer.
fn post(served: &Served, path: &str, body: &Value) -> (u16, String) {
    let answer = served.ask("POST", path, "", &body.to_string());
    let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
    (status, answer.split_once("\r\n\r\n").unwrap().1.to_owned())
}

fn set(served: &Served, key: &str, value: Value) -> (u16, String) {
    post(served, "set", &json!({ "values": { key: value } }))
}

#[test]
fn a_change_runs_the_graph_again_and_is_written_into_its_file_alone() {
    let bench = Bench::new();
    let before = bench.text("fibula.toml");
    let served = bench.view("fibula.toml", &[]);
    let (status, answer) = set(&served, "icp.kind", json!("icp.point_to_point"));
    assert_eq!(status, 200, "{answer}");
    assert_eq!(bench.results(2), bench.on_command_line("fibula.toml", &["icp.kind=icp.point_to_point"]));
    assert_ne!(bench.results(2)["icp"], bench.results(1)["icp"]);
    assert_eq!(bench.text("fibula.toml"), before, "the file is as it was until it is written");

    // Every run can be replayed.
    let replayed = osteoflow().arg("replay").arg(bench.run(2)).output().unwrap();
    assert!(replayed.status.success(), "{}", String::from_utf8_lossy(&replayed.stderr));

    assert_eq!(post(&served, "write", &json!({})).0, 200);
    let expected = before.replace("kind = \"icp.point_to_plane\"  ", "kind = \"icp.point_to_point\"  ");
    assert_ne!(expected, before);
    assert_eq!(bench.text("fibula.toml"), expected);
    // The file now says what was run: there is nothing to run again.
    std::thread::sleep(Duration::from_millis(500));
    assert!(!bench.run(3).exists());
    assert_eq!(bench.on_command_line("fibula.toml", &[]), bench.results(2));
    let (status, message) = post(&served, "write", &json!({}));
    assert_eq!((status, message.trim()), (422, "nothing was changed"));

    // A change of the file from elsewhere is run, too, and a fault is said and not run.
    fs::write(bench.path("fibula.toml"), &before).unwrap();
    assert_eq!(bench.results(3), bench.results(1));
    fs::write(bench.path("fibula.toml"), before.replace("seed   = 42", "seed   = ")).unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let (status, message) = set(&served, "icp.max_iterations", json!(50));
    assert!(status == 422 && !bench.run(4).exists(), "{message}");
    fs::write(bench.path("fibula.toml"), &before).unwrap();
    assert!(served.interrupt().success());
}

#[test]
fn the_page_adds_no_code_and_no_file_from_outside_of_the_graphs_folder() {
    let (bench, elsewhere) = (Bench::new(), tempfile::tempdir().unwrap());
    let outside = |name: &str| elsewhere.path().join(name).display().to_string();
    let mark = elsewhere.path().join("MARK");
    let plugin = format!("open({:?}, 'w').write('run')\n", mark.display().to_string());
    let module = "plugins = [\"mark.py\"]\n[graph]\nformat = 1\nname = \"m\"\nframes = [\"ct\"]\n[module]\ndoc = \"x\"\n\
                  [node.a]\nkind = \"surface.simulated\"\n[module.outputs]\nmesh = { from = \"a.mesh\", doc = \"x\" }\n";
    for folder in [elsewhere.path(), bench.folder.path()] {
        fs::write(folder.join("mark.py"), &plugin).unwrap();
        fs::write(folder.join("mod.toml"), module).unwrap();
        fs::write(folder.join("secret.txt"), "root:x:0:0\n").unwrap();
    }
    #[cfg(unix)]
    std::os::unix::fs::symlink(elsewhere.path(), bench.path("link")).unwrap();
    let served = bench.view("fibula.toml", &[]);
    let out = "leads out of the graph's folder";
    let up = format!("../{}/secret.txt", elsewhere.path().file_name().unwrap().to_str().unwrap());
    let module = |file: &str| json!({ "extra.kind": "module", "extra.file": file });
    let surface = |file: &str| json!({ "bone.kind": "surface.file", "bone.path": file });
    for (values, expected) in [
        (module(&outside("mod.toml")), out),
        (module(&bench.path("mod.toml").display().to_string()), "SHA-256"),
        (surface("Cargo.toml"), out),
        (json!({ "bone.kind": "surface.ct", "bone.path": "nodes" }), out),
        (surface(&outside("secret.txt")), out),
        (surface(&up), out),
        (surface("variants/../link/secret.txt"), if cfg!(unix) { out } else { "bone" }),
        (json!({ "bone.kind": "surface.file", "bone.path": [outside("secret.txt")] }), out),
        (json!({ "bone.kind": "surface.file", "bone.more": { "path": outside("secret.txt") } }), out),
        (json!({ "keep.kind": "output.ply", "keep.path": outside("new.ply") }), out),
    ] {
        let (status, message) = post(&served, "set", &json!({ "values": values }));
        assert!(status == 422 && message.contains(expected), "{values}: {status} {message}");
        assert!(!message.contains("root:x"), "{message}");
    }
    assert!(!mark.exists(), "the plugin was run");
    let (status, message) = post(&served, "set", &json!({ "values": { "icp.max_iterations": 50 } }));
    assert_eq!(status, 200, "{message}");
}

#[test]
fn a_change_that_the_graph_refuses_changes_nothing_and_says_why() {
    let bench = Bench::new();
    let served = bench.view("fibula.toml", &[]);
    for (key, value, expected) in [
        ("icp.max_iterations", json!(-1), "max_iterations takes a whole number from 1 to 100000, found -1"),
        ("icp.max_iterations", json!("many"), "max_iterations"),
        ("icp.max_iteration", json!(5), "did you mean \"max_iterations\""),
        ("icp.kind", json!("icp.nothing"), "there is no kind \"icp.nothing\""),
        ("icp.kind", json!("hole.boundary"), "icp"),
        ("nothing.kind", json!("icp.point_to_plane"), "nothing"),
        ("plan.path", json!("plan.json"), "plan.simulated has no parameter \"path\""),
        ("icp", json!(1), "is no key"),
        ("icp.max_iterations\n[graph]", json!(1), "is no key"),
        ("icp.kind=x.y", json!(1), "is no key"),
        ("extends.x", json!("other.toml"), "extends"),
        ("plugins.x", json!("/tmp/evil.so"), "plugins"),
    ] {
        let (status, message) = set(&served, key, value.clone());
        assert!(status == 422 && message.contains(expected), "{key} = {value}: {status} {message}");
    }
    for (path, body, status) in [
        ("set", json!([1]), 422),
        ("set", json!({ "values": { "icp.trim_fraction": { "a": null } } }), 422),
        ("region", json!({ "node": "crop" }), 422),
        ("region", json!({ "node": "icp", "region": region(&[0.0, 0.0, 0.0]) }), 422),
        ("region", json!({ "node": "crop", "region": region(&[0.0, 0.0]) }), 422),
        ("nothing", json!({}), 404),
    ] {
        let (answered, message) = post(&served, path, &body);
        assert_eq!(answered, status, "{path} {body}: {message}");
    }
    // One of two is refused: neither is made.
    let two = json!({ "values": { "icp.trim_fraction": 0.1, "icp.max_iterations": 0 } });
    assert_eq!(post(&served, "set", &two).0, 422);
    assert_eq!(post(&served, "revert", &json!({})).0, 200);
    std::thread::sleep(Duration::from_millis(400));
    assert!(!bench.run(2).exists() && !bench.path("picks").exists());
}

#[test]
fn a_picked_plan_is_merged_with_the_known_one_and_the_graph_runs_with_it() {
    let bench = Bench::new();
    let served = bench.view("fibula.toml", &[]);
    let known = served.get("/TOKEN/picks", "");
    let known: Value = serde_json::from_str(known.split_once("\r\n\r\n").unwrap().1).unwrap();
    let mut plan = known["plan"].clone();
    let shown = ["units", "landmarks", "assessment", "planes"];
    plan.as_object_mut().unwrap().retain(|key, _| shown.contains(&key.as_str()));
    let moved = plan["landmarks"]["P1"][2].as_f64().unwrap() + 0.5;
    plan["landmarks"]["P1"][2] = moved.into();
    let (status, answer) = post(&served, "save/plan", &plan);
    assert!(status == 200 && answer.contains("the graph runs with it"), "{answer}");
    let file = |key: &str, name: &str| format!("plan.{key}={}", bench.path("picks/picks-1").join(name).display());
    let (path, made_for) = (file("path", "plan.json"), file("made_for", "made_for.json"));
    let again = bench.on_command_line("fibula.toml", &["plan.kind=plan.file", &path, &made_for]);
    assert_eq!(bench.results(2), again);
    let by_the_new = bench.on_command_line("fibula.toml", &["plan.kind=plan.file", &path]);
    assert_ne!(by_the_new["coarse"], bench.results(1)["coarse"], "the landmark was moved");
    // What the page does not see is as it was: the calibration starts where it did.
    let rms = |results: &Value| results["calibration"]["icp"]["rms_mm"].as_f64().unwrap();
    assert!(
        (rms(&again) - rms(&bench.results(1))).abs() < 1e-9,
        "rotations are written as matrices, to the last digit"
    );
    // A plan of fewer landmarks is not saved, and nothing is run.
    plan["landmarks"].as_object_mut().unwrap().remove("P3");
    assert_eq!(post(&served, "save/plan", &plan).0, 422);
    assert!(!bench.path("picks/picks-2").exists());
}

#[test]
fn a_point_that_is_planned_elsewhere_now_is_not_judged_by_what_was_measured_at_its_old_place() {
    let bench = Bench::new();
    let served = bench.view("fibula.toml", &[]);
    let first = bench.results(1);
    assert_eq!(
        (&first["verdict"]["answer"], &first["metrics"]["tre_measured_mm"]["n"]),
        (&json!("trusted"), &json!(5))
    );
    let known = served.get("/TOKEN/picks", "");
    let known: Value = serde_json::from_str(known.split_once("\r\n\r\n").unwrap().1).unwrap();
    assert_eq!(known["runs"], json!(["plan"]), "the page says so at its button");
    let mut plan = known["plan"].clone();
    let shown = ["units", "landmarks", "assessment", "planes"];
    plan.as_object_mut().unwrap().retain(|key, _| shown.contains(&key.as_str()));
    // Far enough for the stylus, which touched the old places, to contradict any registration.
    let mut shift = |key: &str, mm: f64| {
        let moved = plan["assessment"][key][2].as_f64().unwrap() + mm;
        plan["assessment"][key][2] = moved.into();
        plan.clone()
    };
    let two = [("M3", 12.0), ("M1", -9.0)].map(|(key, mm)| shift(key, mm));
    let mean = |results: &Value, metric: &str| results["metrics"][metric]["mean_abs"]["norm"].as_f64().unwrap();
    for (k, plan) in two.iter().enumerate() {
        let (status, answer) = post(&served, "save/plan", plan);
        assert!(status == 200 && answer.contains("the graph runs with it"), "{answer}");
        let results = bench.results(k + 2);
        assert_eq!(results["verdict"]["answer"], "trusted", "{}", results["verdict"]);
        // Of the second change, too, what counts is the plan by which the procedure was made.
        assert_eq!(results["metrics"]["tre_measured_mm"]["n"], 4 - k);
        let names = |results: &Value| -> Vec<Value> {
            let points = results["metrics"]["tre_measured_mm"]["points"].as_array().unwrap().iter();
            points.map(|point| point["name"].clone()).collect()
        };
        let left: Vec<Value> =
            names(&first).into_iter().filter(|name| name != "M3" && (k == 0 || name != "M1")).collect();
        assert_eq!(names(&results), left);
        // The truth at the new places is that of the registration, which did not change.
        assert_eq!(results["metrics"]["tre_true_mm"]["n"], 5);
        let off = (mean(&results, "tre_true_mm") - mean(&first, "tre_true_mm")).abs();
        assert!(off < 0.05, "the true error at the moved points differs by {off} mm");
        // No plane was moved; matrices are written with the digits of doubles.
        for (cut, before) in
            [0, 1].map(|n| (&results["metrics"]["cuts"]["cuts"][n], &first["metrics"]["cuts"]["cuts"][n]))
        {
            let off =
                ["offset_mm", "moved_mm"].map(|key| (cut[key].as_f64().unwrap() - before[key].as_f64().unwrap()).abs());
            assert!(off.iter().all(|mm| *mm < 1e-9), "{cut} {before}");
        }
        let manifest = fs::read_to_string(bench.run(k + 2).join("manifest.json")).unwrap();
        let said =
            "measured for a plan that had it elsewhere, or not at all; the old measurement is left out, touch it again";
        assert!(manifest.contains(said), "{manifest}");
        let rms = |results: &Value| results["icp"]["rms_mm"].as_f64().unwrap();
        assert!((rms(&results) - rms(&first)).abs() < 1e-9, "the registration is the same");
    }
    // The same from the command line; and without the plan that the procedure was made for the old measurements count, as for a
    // procedure by the new plan.
    let file = |name: &str| bench.path("picks/picks-2").join(name).display().to_string();
    let sets = [
        "plan.kind=plan.file".to_owned(),
        format!("plan.path={}", file("plan.json")),
        format!("plan.made_for={}", file("made_for.json")),
    ];
    let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
    assert_eq!(bench.on_command_line("fibula.toml", &sets), bench.results(3));
    let contradicted = bench.on_command_line("fibula.toml", &sets[..2]);
    assert_ne!(contradicted["verdict"]["answer"], "trusted");
    // All of them moved: nothing is left, and that is no error of the registration.
    let mut all = two[1].clone();
    for (_, place) in all["assessment"].as_object_mut().unwrap() {
        place[2] = (place[2].as_f64().unwrap() + 3.0).into();
    }
    assert_eq!(post(&served, "save/plan", &all).0, 200);
    let results = bench.results(4);
    assert!(results["metrics"]["tre_measured_mm"].get("n").is_none(), "{}", results["metrics"]["tre_measured_mm"]);
    assert_ne!(results["verdict"]["answer"], "refused", "{}", results["verdict"]);
}

#[test]
fn a_landmark_that_is_planned_elsewhere_now_was_located_at_its_old_place_and_the_registration_starts_there() {
    let bench = Bench::new();
    let served = bench.view("fibula.toml", &[]);
    let first = bench.results(1);
    let known = served.get("/TOKEN/picks", "");
    let known: Value = serde_json::from_str(known.split_once("\r\n\r\n").unwrap().1).unwrap();
    let mut plan = known["plan"].clone();
    plan.as_object_mut()
        .unwrap()
        .retain(|key, _| ["units", "landmarks", "assessment", "planes"].contains(&key.as_str()));
    let before = plan["landmarks"].clone();
    let residuals = |results: &Value| -> Vec<f64> {
        let pairs = results["coarse"]["pairs"].as_array().unwrap().iter();
        pairs.map(|pair| pair["residual_mm"].as_f64().unwrap()).collect()
    };
    // One, which would not fit the others, then all by so much that the start would be of another place on the bone.
    for (k, names) in [&["P2"][..], &["P1", "P2", "P3"]].iter().enumerate() {
        for name in *names {
            plan["landmarks"][name][2] = (before[name][2].as_f64().unwrap() + 40.0).into();
        }
        let (status, answer) = post(&served, "save/plan", &plan);
        assert!(status == 200 && answer.contains("the graph runs with it"), "{answer}");
        let results = bench.results(k + 2);
        assert_eq!(results["verdict"]["answer"], "trusted", "{names:?}: {}", results["verdict"]);
        let off = residuals(&results).iter().zip(residuals(&first)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{names:?}: the start differs by {off} mm");
        let manifest = fs::read_to_string(bench.run(k + 2).join("manifest.json")).unwrap();
        let said = format!(
            "{} {} planned elsewhere than when the procedure was made",
            names.join(", "),
            if k == 0 { "is" } else { "are" }
        );
        assert!(manifest.contains(&said), "{said}: {manifest}");
        assert!(!results["verdict"].to_string().contains("aimed there"), "{}", results["verdict"]);
    }
    // The page shows them where they are planned now.
    let Some(mut browser) = Browser::start("a_landmark_that_is_planned_elsewhere_now") else { return };
    browser.events.clear();
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("typeof osteoflow === 'object' && osteoflow.picking.history.now.landmarks.length === 3");
    for name in ["P1", "P2", "P3"] {
        let z = plan["landmarks"][name][2].as_f64().unwrap();
        browser.wait_until(&format!(
            "Math.abs(osteoflow.picking.history.now.landmarks.find((pick) => pick.name === '{name}').position[2] - {z}) < 1e-6"
        ));
    }
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

#[test]
fn picked_pairs_start_the_registration_of_two_files() {
    let bench = Bench::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = |name: &str| root.join("tests/data").join(name).display().to_string();
    let (bone, scan) = (file("folder/bone.stl"), file("folder/scan.ply"));
    let (out, picks) = (bench.path("run"), bench.path("picks"));
    let served =
        Served::start(&["view", &bone, &scan, "--out", out.to_str().unwrap(), "--picks", picks.to_str().unwrap()]);
    bench.results(1);
    let read = |name: &str| {
        let markups: Value = serde_json::from_str(&fs::read_to_string(file(name)).unwrap()).unwrap();
        let points = markups["markups"][0]["controlPoints"].as_array().unwrap().iter();
        points.map(|point| json!({ "name": point["label"], "position": point["position"] })).collect::<Vec<_>>()
    };
    let pairs = json!({ "bone": read("picks/bone_points.mrk.json"), "scan": read("picks/scan_points.mrk.json") });
    let (status, answer) = post(&served, "save/pairs", &pairs);
    assert!(status == 200 && answer.contains("the registration starts from them"), "{answer}");
    let picked =
        |node: &str| format!("{node}.path={}", picks.join("picks-1").join(format!("{node}.mrk.json")).display());
    let command = tempfile::tempdir().unwrap();
    let ran = osteoflow()
        .arg("run")
        .arg(root.join("graphs/variants/two_files_picked.toml"))
        .args(["--set", &format!("bone.path={bone}"), "--set", &format!("scan.path={scan}")])
        .args(["--set", &picked("bone_points"), "--set", &picked("scan_points")])
        .arg("--out")
        .arg(command.path().join("run"))
        .output()
        .unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let again: Value = serde_json::from_slice(&fs::read(command.path().join("run/results.json")).unwrap()).unwrap();
    assert_eq!(bench.results(2), again);
    assert_eq!(post(&served, "write", &json!({})).0, 422, "the graph is no file of the user's");
}

#[test]
fn a_viewer_of_the_protocol_sets_parameters_and_calls_services() {
    let bench = Bench::new();
    let served = bench.view("fibula.toml", &[]);
    let mut viewer = Client::connect(&served.stream);
    let set = |values: Value| json!({ "op": "setParameters", "parameters": values, "id": "a" });
    let value = |name: &str, value: Value| json!({ "name": name, "value": value });
    viewer.send(&set(json!([value("icp.kind", json!("icp.point_to_point")), value("icp.trim_fraction", json!(0.1))])));
    let answer = viewer.text("parameterValues");
    let expected = json!([value("icp.kind", json!("icp.point_to_point")), value("icp.trim_fraction", json!(0.1))]);
    assert_eq!((&answer["parameters"], &answer["id"]), (&expected, &json!("a")));
    // Both at once: one run.
    let both = bench.on_command_line("fibula.toml", &["icp.kind=icp.point_to_point", "icp.trim_fraction=0.1"]);
    assert_eq!(bench.results(2), both);

    // One that is refused leaves the other as it was, and both are answered with what they are.
    viewer.send(&set(json!([value("icp.trim_fraction", json!(0.2)), value("icp.max_iterations", json!(-5))])));
    let message = viewer.text("status");
    assert!(message["message"].as_str().unwrap().contains("found -5"), "{message}");
    viewer.send(&json!({ "op": "getParameters", "parameterNames": ["icp.trim_fraction"], "id": "b" }));
    assert_eq!(viewer.values("b"), json!([value("icp.trim_fraction", json!(0.1))]));

    let services = viewer.services.clone();
    let revert = services.as_array().unwrap().iter().find(|service| service["name"] == "revert").unwrap();
    let mut call = vec![2];
    call.extend((revert["id"].as_u64().unwrap() as u32).to_le_bytes());
    call.extend(9_u32.to_le_bytes());
    call.extend(4_u32.to_le_bytes());
    call.extend(b"json{}");
    viewer.socket.send(Message::binary(call)).unwrap();
    assert_eq!(bench.results(3), bench.results(1));
}

/// A viewer that speaks the protocol.
struct Client {
    socket: WebSocket<TcpStream>,
    services: Value,
}

impl Client {
    fn connect(address: &str) -> Self {
        let host = address.strip_prefix("ws://").unwrap().split('/').next().unwrap();
        let connection = TcpStream::connect(host).unwrap();
        connection.set_read_timeout(Some(LIMIT)).unwrap();
        let request = ClientRequestBuilder::new(address.parse().unwrap()).with_sub_protocol("foxglove.websocket.v1");
        let mut client = Self { socket: tungstenite::client(request, connection).unwrap().0, services: Value::Null };
        client.services = client.text("advertiseServices")["services"].clone();
        for service in client.services.as_array().unwrap() {
            for part in ["request", "response"] {
                let schema = serde_json::from_str(service[part]["schema"].as_str().unwrap()).unwrap();
                assert_eq!(read_by_viewers(&schema), Ok(()), "{service}");
            }
        }
        client
    }

    fn send(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    /// The next text message with this `op`.
    fn text(&mut self, op: &str) -> Value {
        loop {
            if let Message::Text(text) = self.socket.read().unwrap() {
                let message: Value = serde_json::from_str(&text).unwrap();
                if message["op"] == op {
                    return message;
                }
            }
        }
    }

    /// The parameters of the answer with this id.
    fn values(&mut self, id: &str) -> Value {
        loop {
            let answer = self.text("parameterValues");
            if answer["id"] == id {
                return answer["parameters"].clone();
            }
        }
    }
}

/// A region of one box, whose smallest corner is given.
fn region(min: &[f64]) -> Value {
    json!({
        "format": "osteoflow-region", "version": 1, "units": "mm", "frame": "camera",
        "keep": [{ "shape": "box", "min": min, "max": [500.0, 500.0, 500.0] }],
    })
}

#[test]
fn a_variant_takes_away_what_a_new_kind_does_not_have() {
    if skips_slow("a_variant_takes_away_what_a_new_kind_does_not_have") {
        return;
    }
    let bench = Bench::new();
    let name = "variants/fibula_point_to_point.toml";
    let served = bench.view(name, &[]);
    // The base sets a parameter of the crop that the region's kind does not have.
    let wired = "region = \"recording.region\" }\n";
    let bounded = bench.text("fibula.toml").replace(wired, &format!("{wired}min_mm = [-500.0, -500.0, -500.0]\n"));
    fs::write(bench.path("fibula.toml"), bounded).unwrap();
    bench.results(2);
    let (status, answer) =
        post(&served, "region", &json!({ "node": "crop", "region": region(&[-500.0, -500.0, 1.0]) }));
    assert_eq!(status, 200, "{answer}");
    let answer: Value = serde_json::from_str(&answer).unwrap();
    assert_eq!(answer["changes"]["removed"], json!(["node.crop.min_mm"]));
    assert_eq!(bench.results(3)["icp"], bench.results(1)["icp"], "all points are in this region");
    // Each region has a folder of its own, and a box is one of 3D Slicer, too.
    assert!(bench.path("picks/picks-1/region.mrk.json").exists());

    assert_eq!(post(&served, "write", &json!({})).0, 200);
    let written: toml::Table = bench.text(name).parse().unwrap();
    let removed = written["remove"].as_array().unwrap();
    assert!(removed.contains(&"node.crop.min_mm".into()), "{removed:?}");
    // Where the graph is, the path is short.
    assert_eq!(written["node"]["crop"]["kind"].as_str(), Some("crop.file"));
    assert_eq!(bench.on_command_line(name, &[]), bench.results(3));
}

#[test]
fn a_live_graph_is_run_once_and_nothing_of_it_can_be_changed() {
    let bench = Bench::new();
    let out = bench.path("run");
    let graph = "graphs/variants/fibula_live.toml";
    let served = Served::start(&["view", graph, "--set", "recording.rate=1000", "--out", out.to_str().unwrap()]);
    bench.results(1);
    for (path, body) in [("set", json!({ "values": { "icp.max_iterations": 50 } })), ("revert", json!({}))] {
        let (status, message) = post(&served, path, &body);
        assert!(status == 422 && message.contains("\"recording\" is a live source"), "{path}: {status} {message}");
    }
    assert!(served.interrupt().success());
    assert!(!bench.run(2).exists());
}

#[test]
fn what_the_command_line_sets_is_not_written_over() {
    let bench = Bench::new();
    let before = bench.text("fibula.toml");
    let served = bench.view("fibula.toml", &["--set", "icp.max_iterations=40"]);
    assert_eq!(set(&served, "icp.max_iterations", json!(41)).0, 200);
    let (status, message) = post(&served, "write", &json!({}));
    assert!(status == 422 && message.contains("--set of the command line"), "{message}");
    assert_eq!(bench.text("fibula.toml"), before);
}

#[test]
fn a_region_of_another_frame_or_scan_is_no_silent_result() {
    let bench = Bench::new();
    let save = |name: &str, value: &Value| fs::write(bench.path(name), value.to_string()).unwrap();
    let mut wrong = region(&[-500.0, -500.0, -500.0]);
    wrong["frame"] = "ct".into();
    save("frame.json", &wrong);
    save("empty.json", &region(&[499.0, 499.0, 499.0]));
    let mut moved = region(&[-500.0, -500.0, -500.0]);
    moved["keep"][0]["max"] = json!([-20.0, 500.0, 500.0]);
    moved["drawn_on"] = json!({ "n_points": 20000, "n_inside": 19999 });
    save("moved.json", &moved);
    for (file, expected) in [
        ("frame.json", "the drawn region of interest"),
        ("empty.json", "lies in the drawn region; was it drawn on another scan?"),
        ("moved.json", "19999 of 20000 did when it was drawn; was the camera moved since?"),
    ] {
        let path = format!("crop.path={}", bench.path(file).display());
        let out = bench.path(&format!("{file}.run"));
        let mut command = osteoflow();
        command.arg("run").arg(bench.path("fibula.toml")).args(["--set", "crop.kind=crop.file", "--set", &path]);
        let run = command.arg("--out").arg(out).output().unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(said.contains(expected), "{file}: {said}");
    }
}

/// The page in a browser.
fn open(browser: &mut Browser, served: &Served) {
    browser.events.clear();
    let size = json!({ "width": 1000, "height": 700, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("document.readyState === 'complete' && typeof osteoflow === 'object'");
    browser.wait_until("osteoflow.state.state === 'complete' && osteoflow.scene.drawn.has('recording.scan')");
    // The bone is in the middle of the view, wherever it was followed to.
    browser.wait_until(
        "(() => { const { camera, drawn } = osteoflow.scene; const mesh = drawn.get('bone.mesh').object.children[0]; \
         mesh.geometry.computeBoundingBox(); const at = mesh.geometry.boundingBox.min.clone().add(mesh.geometry.boundingBox.max); \
         at.multiplyScalar(0.5).applyMatrix4(mesh.matrixWorld).project(camera); \
         return Math.abs(at.x) < 0.1 && Math.abs(at.y) < 0.1 && at.z < 1; })()",
    );
}

#[test]
fn a_kind_changed_and_a_lasso_drawn_on_the_page_are_the_runs_of_the_command_line() {
    let Some(mut browser) = Browser::start("a_kind_changed_and_a_lasso_drawn_on_the_page") else { return };
    let bench = Bench::new();
    let before = bench.text("fibula.toml");
    let served = bench.view("fibula.toml", &[]);
    open(&mut browser, &served);

    // The kind, by its field.
    let field = |key: &str| format!("document.getElementById('field-{key}')");
    browser.wait_until(&format!("{} !== null", field("icp.kind")));
    browser.evaluate(&format!("{}.closest('details').open = true", field("icp.kind")));
    let choose = |browser: &mut Browser, key: &str, value: &str| {
        browser.evaluate(&format!(
            "(() => {{ const input = {}; input.value = '{value}'; input.dispatchEvent(new Event('change')); }})()",
            field(key)
        ));
    };
    choose(&mut browser, "icp.kind", "icp.point_to_point");
    browser.wait_until("osteoflow.state.run === 'run-2' && osteoflow.state.state === 'complete'");
    let numbers = browser.evaluate("document.getElementById('numbers').textContent");
    let rms = |n: usize| bench.results(n)["icp"]["rms_mm"].as_f64().unwrap();
    for n in [1, 2] {
        // Three digits, as the page shows them.
        let digits = browser.evaluate(&format!("({}).toPrecision(3)", rms(n)));
        assert!(numbers.as_str().unwrap().contains(digits.as_str().unwrap()), "{numbers}: {digits}");
    }
    assert!(numbers.as_str().unwrap().contains(" was "), "{numbers}");

    // A value that is refused is put back, with the reason beside it.
    choose(&mut browser, "icp.max_iterations", "0");
    let fault = format!("{}.closest('.field').querySelector('.fault').textContent", field("icp.max_iterations"));
    browser.wait_until(&format!("{fault}.includes('from 1 to 100000')"));
    assert_eq!(browser.evaluate(&format!("{}.value", field("icp.max_iterations"))), "500");

    // Written into the file by its button.
    browser.evaluate("document.getElementById('write').click()");
    browser.wait_until("document.getElementById('changes').closest('section').hidden");
    assert_eq!(bench.text("fibula.toml"), before.replace("\"icp.point_to_plane\"  ", "\"icp.point_to_point\"  "));

    // A lasso around the scan without its ends, by the mouse.
    browser.evaluate("document.getElementById('draw').click()");
    browser.wait_until("osteoflow.region.isOpen");
    let [left, top, width, height] = ["left", "top", "width", "height"].map(|side| {
        let value = browser.evaluate(&format!("document.getElementById('view').getBoundingClientRect().{side}"));
        value.as_f64().unwrap()
    });
    let at = |x: f64, y: f64| [left + x * width, top + y * height];
    browser.stroke(&[at(0.25, 0.25), at(0.75, 0.25), at(0.75, 0.66), at(0.25, 0.66)]);
    let count = |browser: &mut Browser| {
        let text = browser.evaluate("document.getElementById('region-count').textContent");
        text.as_str().unwrap().split(' ').next().unwrap().parse::<usize>().unwrap()
    };
    let lassoed = count(&mut browser);
    assert!((2000..19000).contains(&lassoed), "{lassoed} points");
    // Cut some away with the brush, take that back, and cut again.
    for id in ["region-cut", "region-brush"] {
        browser.evaluate(&format!("document.getElementById('{id}').click()"));
    }
    browser.stroke(&[at(0.48, 0.5), at(0.52, 0.5)]);
    let cut = count(&mut browser);
    assert!(cut < lassoed, "{cut} of {lassoed}");
    browser.evaluate("document.getElementById('region-undo').click()");
    assert_eq!(count(&mut browser), lassoed);
    browser.evaluate("document.getElementById('region-save').click()");
    browser.wait_until("osteoflow.state.run === 'run-3' && ['complete', 'refused'].includes(osteoflow.state.state)");
    browser.wait_until("!osteoflow.region.isOpen");

    // The file has what was counted, and the command line gives the page's run.
    let file = bench.path("picks/picks-1/region.json");
    let saved: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    assert_eq!((&saved["drawn_on"]["n_inside"], &saved["frame"]), (&json!(lassoed), &json!("camera")));
    browser.wait_until("osteoflow.scene.drawn.has('to_bone.cloud')");
    let shown = browser.evaluate("osteoflow.scene.drawn.get('to_bone.cloud').object.userData.points.length / 3");
    assert_eq!(shown, lassoed, "points that the run kept");
    // Loaded again, it is the region that was drawn; one of another frame is refused with both frames.
    browser.evaluate("document.getElementById('draw').click()");
    browser.wait_until("osteoflow.region.isOpen && document.getElementById('region-load') !== null");
    let load = |browser: &mut Browser, region: &Value| {
        let text = json!(region.to_string());
        browser.evaluate(&format!(
            "(() => {{ const files = new DataTransfer(); files.items.add(new File([{text}], 'region.json')); const input = \
             document.getElementById('region-load'); input.files = files.files; input.dispatchEvent(new Event('change')); }})()"
        ));
    };
    let log = "document.querySelector('#log li').textContent";
    for (key, value, said) in [
        ("frame", json!("ct"), "the region was drawn in frame ct, but this cloud is in camera"),
        ("format", json!("other"), "its format is not osteoflow-region"),
        ("keep", json!([{ "shape": "ball" }]), "keep[0]: \"ball\" is no shape"),
        (
            "keep",
            json!([{ "shape": "box", "min": [0, 0], "max": [1, 1, 1] }]),
            "keep[0].min: 3 numbers are expected, found [0,0]",
        ),
        ("keep", json!([]), "it has no shapes"),
    ] {
        let mut other = saved.clone();
        other[key] = value;
        load(&mut browser, &other);
        browser.wait_until(&format!("{log}.includes({})", json!(said)));
        assert_eq!(browser.evaluate("osteoflow.region.shapes.length"), 0, "{said}");
    }
    load(&mut browser, &saved);
    browser.wait_until("osteoflow.region.shapes.length > 0");
    assert_eq!(count(&mut browser), lassoed);
    browser.evaluate("document.getElementById('region-close').click()");

    let path = format!("crop.path={}", file.display());
    let again = bench.on_command_line("fibula.toml", &["crop.kind=crop.file", &path]);
    assert_eq!(again, bench.results(3));
    // A fault in the file: the verdict of the run before is not that of the graph.
    let good = bench.text("fibula.toml");
    let file = bench.path("fibula.toml");
    fs::write(&file, good.replace("[graph]", "[grap]")).unwrap();
    browser.wait_until("document.getElementById('verdict').className === 'verdict old'");
    let words = browser.evaluate("document.getElementById('verdict').textContent");
    assert!(words.as_str().unwrap().starts_with("of the last run, not of the graph as it is now:"), "{words}");
    assert_eq!(browser.evaluate("document.getElementById('problem').hidden"), false);
    browser.wait_until("[...osteoflow.scene.drawn.values()].every(({ payload, object }) => payload !== 'geometry/Planes' || !object.visible)");
    fs::write(&file, good).unwrap();
    browser.wait_until("document.getElementById('verdict').className !== 'verdict old' && osteoflow.verdict !== null");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}
