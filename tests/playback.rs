//! Playback through any method: recorded wires and topics of other programs in graphs with other names, and plugins whose files
//! are gone.

use crate::common::{
    osteoflow,
    python::{Folder, HELPED},
    root, run_whole, shared_run,
};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
};

const RECORDED: &str = "graphs/fibula_recorded.toml";
/// What fibula_recorded.toml reads: a recording of another program, with Foxglove's schemas.
const FOREIGN: &str = "tests/data/procedure/procedure.mcap";
/// A bag of ROS 2.
const BAG: &str = "tests/data/ros2_bag/ros2_bag.mcap";

/// A graph of a live scanner and a tracker that is not there, with names of its own.
const SCANNER: &str = r#"
[graph]
format = 1
name = "scanner"

[node.scanner]
kind    = "acquire.foxglove_ws"
address = "ws://127.0.0.1:9"
out.cloud = { type = "geometry/Cloud", topic = "/no/such", frame = "camera" }

[node.tracker]
kind    = "acquire.foxglove_ws"
address = "ws://127.0.0.1:9"
out.marker = { type = "geometry/Pose", topic = "/no/such", to = "world", from = "camera_marker" }

[node.few]
kind    = "cloud.downsample"
in      = { cloud = "scanner.cloud" }
cell_mm = 3.0

[results]
clouds = { from = "few.cloud", all = true }
marker = "tracker.marker"
"#;

/// The exit code, stdout as JSON and stderr of a replay.
fn replay(recording: &Path, arguments: &[&str]) -> (Option<i32>, Value, String) {
    let output = osteoflow().args(["replay", "--format", "json"]).arg(recording).args(arguments).output().unwrap();
    let answer = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code(), answer, String::from_utf8_lossy(&output.stderr).into_owned())
}

/// A folder with the graph of the scanner.
fn scanner() -> (tempfile::TempDir, String) {
    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("scanner.toml");
    fs::write(&graph, SCANNER).unwrap();
    let graph = graph.to_str().unwrap().to_owned();
    (dir, graph)
}

/// What the graph gives on the file that the recorded run read.
fn expected() -> (Value, Value) {
    let results = shared_run(RECORDED, &[]).path("run.mcap");
    let recording = osteoflow_engine::Recording::open(&results).unwrap();
    let n = |wire: &str| Value::from(recording.wires[wire].messages.len());
    (n("recording.scan"), n("recording.camera_marker"))
}

#[test]
fn a_recorded_run_plays_into_a_graph_with_other_names_by_maps_and_what_does_not_fit_is_listed() {
    let recording = shared_run(RECORDED, &[]).path("run.mcap");
    let (_dir, graph) = scanner();
    let maps = ["--map", "scanner.cloud=recording.scan", "--map", "tracker.marker=/exact/recording.camera_marker"];
    let (code, answer, printed) = replay(&recording, &[&["--graph", &graph], &maps[..]].concat());
    assert_eq!(code, Some(0), "{printed}");
    let wire = |name: &str| {
        let wires = answer["wires"].as_array().unwrap();
        wires.iter().find(|wire| wire["wire"] == name).unwrap_or_else(|| panic!("no {name}: {answer:#}")).clone()
    };
    let (n_scans, n_markers) = expected();
    for (name, n) in [("scanner.cloud", n_scans), ("tracker.marker", n_markers)] {
        let wire = wire(name);
        assert_eq!((&wire["part"], &wire["replayed"]), (&"played".into(), &n), "{name}");
    }
    assert_eq!(answer["results"]["clouds"][0]["frame"], "camera", "{answer:#}");
    assert!(answer["results_equal"].is_null(), "other results are not compared");
    // A live run's recording is played likewise.
    let live = run_whole("graphs/variants/fibula_live.toml", &["--set", "recording.rate=1e9"]);
    let (code, of_live, printed) = replay(&live.path("run.mcap"), &[&["--graph", &graph], &maps[..]].concat());
    assert_eq!(code, Some(0), "{printed}");
    assert_eq!(of_live["results"]["clouds"], answer["results"]["clouds"]);
    // A simulated one, whose source has a wire of this name.
    let simulated = run_whole("graphs/calibration.toml", &[]);
    let recorded = osteoflow_engine::Recording::open(&simulated.path("run.mcap")).unwrap();
    let of = |payload: &str| recorded.wires.iter().find(|(_, wire)| wire.payload == payload && wire.source).unwrap().0;
    let cloud = format!("scanner.cloud={}", of("geometry/Cloud"));
    let marker = format!("tracker.marker={}", of("geometry/Pose"));
    let (code, _, printed) =
        replay(&simulated.path("run.mcap"), &["--graph", &graph, "--map", &cloud, "--map", &marker]);
    assert!(code == Some(0) || printed.contains("of the graph; change it"), "{printed}");

    let cases: [(&[&str], &str); 6] = [
        (&[], "no recorded wire is an output of a source of"),
        (&["--map", "scanner.cloud=recording.scan"], "--map tracker.marker=WIRE, of geometry/Pose: "),
        (
            &["--map", "scanner.cloud=recording.camera_marker"],
            "was recorded with geometry/Pose; of geometry/Cloud, which",
        ),
        (&["--map", "scanner.cloud=no.such"], "the recording has no wire \"no.such\"; of geometry/Cloud"),
        (
            &["--map", "scaner.cloud=recording.scan"],
            "the graph has no output \"scaner.cloud\"; its sources have scanner.cloud",
        ),
        (
            &["--map", "scanner.cloud=recording.scan", "--map", "tracker.marker=recording.bone_marker"],
            "but \"camera_marker\" on tracker.marker of the graph",
        ),
    ];
    for (maps, expected) in cases {
        let (code, _, printed) = replay(&recording, &[&["--graph", &graph], maps].concat());
        assert!(code == Some(2) && printed.contains(expected), "{maps:?}: {code:?} {printed}");
    }
    assert!(replay(&recording, &["--graph", &graph, "--map", "scanner"]).2.contains("write NODE.PORT=TOPIC"));
}

#[test]
fn topics_of_another_program_play_into_any_graph_by_its_own_reader() {
    let (_dir, graph) = scanner();
    let foreign = root().join(FOREIGN);
    let maps = ["--map", "scanner.cloud=/camera/scan", "--map", "tracker.marker=/tracker/camera_marker"];
    let (code, answer, printed) = replay(&foreign, &[&["--graph", &graph], &maps[..]].concat());
    assert_eq!(code, Some(0), "{printed}");
    let recording = shared_run(RECORDED, &[]).path("run.mcap");
    let own = ["--map", "scanner.cloud=recording.scan", "--map", "tracker.marker=recording.camera_marker"];
    let (_, of_run, _) = replay(&recording, &[&["--graph", &graph], &own[..]].concat());
    assert_eq!(answer["results"]["clouds"], of_run["results"]["clouds"], "the same bits as from the run that read it");
    assert_eq!(answer["results"]["marker"], of_run["results"]["marker"]);
    assert!(answer["not_compared"].as_str().unwrap().contains("recording of another program"), "{answer:#}");
    // A graph whose source reads topics needs no map: its topics are there.
    let (code, answer, printed) = replay(&foreign, &["--graph", "graphs/variants/fibula_live.toml"]);
    assert_eq!(code, Some(0), "{printed}");
    let straight = shared_run(RECORDED, &[]);
    assert_eq!(answer["results"]["poses"], straight.results["poses"], "{printed}");

    let cases: [(&[&str], &str); 5] = [
        (
            &["--graph", &graph, "--map", "scanner.cloud=/tracker/camera_marker"],
            "of geometry/Cloud, which scanner.cloud gives, it has /camera/",
        ),
        (&["--graph", &graph, "--map", "scanner.cloud=/no/such"], "the recording has no topic /no/such"),
        (&[], "its topics are /camera/calibration (foxglove.PointCloud)"),
        (&["--graph", &graph, "--from", "few"], "--from needs the wires of a run"),
        (&["--graph", &graph, "--map", "few.cloud=/camera/scan"], "is no source"),
    ];
    for (arguments, expected) in cases {
        let (code, _, printed) = replay(&foreign, arguments);
        assert!(code == Some(2) && printed.contains(expected), "{arguments:?}: {code:?} {printed}");
    }
}

#[test]
fn a_bag_of_ros_2_plays_into_a_graph_whose_frames_it_has_or_is_given() {
    let (_dir, graph) = scanner();
    let bag = root().join(BAG);
    let maps = ["--map", "scanner.cloud=/camera/points", "--map", "tracker.marker=/tf"];
    let replay = |sets: &[&str]| {
        let sets: Vec<_> = sets.iter().flat_map(|set| ["--set", set]).collect();
        replay(&bag, &[&["--graph", &graph][..], &maps, &sets].concat())
    };
    let (code, _, printed) = replay(&[]);
    let frame = "frame is \"optical\" in it, but \"camera\" on scanner.cloud of the graph";
    assert!(code == Some(2) && printed.contains(frame), "{code:?} {printed}");
    // As the error says.
    let camera = printed.split("--set '").nth(1).unwrap().split('\'').next().unwrap();
    let (code, answer, printed) = replay(&[camera]);
    let words = "has no transform camera_marker -> world, but marker -> map";
    assert!(code == Some(3) && answer.to_string().contains(words), "{code:?} {printed} {answer:#}");
    let (code, answer, printed) = replay(&[camera, "tracker.frames={ map = \"world\", marker = \"camera_marker\" }"]);
    assert_eq!(code, Some(0), "{printed} {answer:#}");
    assert_eq!(answer["results"]["clouds"].as_array().unwrap().len(), 3);
    assert_eq!(answer["results"]["clouds"][0]["frame"], "camera");
    assert_eq!(
        (&answer["results"]["marker"]["to"], &answer["results"]["marker"]["from"]),
        (&"world".into(), &"camera_marker".into())
    );
}

const GRAPH: &str = "plugins = [\"st.py\"]\n[graph]\nformat = 1\nname = \"carried\"\n[node.src]\nkind = \"st.src\"\n[node.f]\n\
                     kind = \"st.f\"\nin = { cloud = \"src.cloud\" }\n[record]\nwires = [\"*\"]\n[results]\nf = \"f.r\"\n";

#[test]
fn a_recording_carries_the_text_of_its_plugins_which_runs_only_if_the_user_trusts_it() {
    let files = [("st.py", HELPED), ("g.toml", GRAPH), ("helper.py", "SCALE = 1.5\n")];
    let Some(folder) = Folder::new("the text of plugins in a recording", &files) else { return };
    folder.ends_well(&["run", "g.toml", "--out", "r"]);
    folder.ends_well(&["run", "g.toml", "--out", "without", "--set", "record.plugins=false"]);
    let said = folder.ends_well(&["info", "r/run.mcap"]);
    assert!(said.contains("st.py") && said.contains("--allow-plugins"), "{said}");
    folder.ends_well(&["validate", "r/run.mcap"]);
    for file in ["st.py", "helper.py"] {
        fs::remove_file(folder.path(file)).unwrap();
    }
    let (code, text) = folder.says(&["replay", "r"]);
    assert!(code == Some(2) && text.contains("add --allow-plugins"), "{code:?} {text}");
    let text = folder.ends_well(&["replay", "r", "--allow-plugins"]);
    assert!(text.contains("0 differ, results equal"), "{text}");
    // Another file at its place is not run instead.
    folder.write("st.py", "raise SystemExit(3)\n");
    let (code, text) = folder.says(&["replay", "r"]);
    assert!(
        code == Some(2) && text.contains("not that of the recorded run") && text.contains("--allow-plugins"),
        "{text}"
    );
    folder.ends_well(&["replay", "r", "--allow-plugins"]);
    // A module that only a firing imports is carried, too, and named where it has changed.
    let lazy = HELPED.replace("import helper\n", "").replace("    return R", "    import helper\n    return R");
    folder.write("st.py", &lazy);
    folder.write("helper.py", "SCALE = 3.5\n");
    folder.ends_well(&["run", "g.toml", "--out", "lazy"]);
    folder.write("helper.py", "SCALE = 4.5\n");
    let (code, text) = folder.says(&["replay", "lazy"]);
    assert!(
        code == Some(2) && text.contains("helper.py, which it loads, is not as in the recorded run"),
        "{code:?} {text}"
    );
    fs::remove_file(folder.path("helper.py")).unwrap();
    folder.ends_well(&["validate", "lazy/run.mcap"]);
    let text = folder.ends_well(&["replay", "lazy", "--allow-plugins"]);
    assert!(text.contains("0 differ, results equal"), "{text}");
    let (code, text) = folder.says(&["replay", "without", "--allow-plugins"]);
    assert!(code == Some(2) && text.contains("carries the text of no plugin"), "{code:?} {text}");
    assert!(!String::from_utf8_lossy(&fs::read(folder.path("without/run.mcap")).unwrap()).contains("helper.SCALE"));
    // Recovered with the rest; a changed text is found.
    let bytes = fs::read(folder.path("r/run.mcap")).unwrap();
    fs::write(folder.path("cut.mcap"), &bytes[..bytes.len() - 40]).unwrap();
    let recovered = folder.says(&["recover", "cut.mcap", "saved.mcap"]);
    assert!(folder.path("saved.mcap").exists(), "{recovered:?}");
    let (code, text) = folder.says(&["replay", "saved.mcap", "--allow-plugins"]);
    assert_eq!(code, Some(0), "{text}");
    let at = bytes.windows(11).position(|window| window == b"SCALE = 1.5").unwrap();
    let mut changed = bytes.clone();
    changed[at + 8] = b'9';
    fs::write(folder.path("changed.mcap"), &changed).unwrap();
    let (code, text) = folder.says(&["validate", "changed.mcap"]);
    assert!(code == Some(1) && text.contains("has another SHA-256"), "{code:?} {text}");
    let (code, text) = folder.says(&["replay", "changed.mcap", "--allow-plugins"]);
    assert!(code == Some(1) && text.contains("has another SHA-256"), "{code:?} {text}");
}

#[test]
fn the_values_of_named_variables_are_part_of_what_a_plugin_is() {
    let node =
        HELPED.replace("import helper\n", "import os\n").replace("helper.SCALE", "os.environ.get(\"MODEL\", \"0\")");
    let graph = GRAPH.replace("kind = \"st.f\"\n", "kind = \"st.f\"\nenv = [\"MODEL\"]\n");
    let graph = format!("{graph}[sweep]\nrepeat = 3\n[sweep.columns]\nnumber = \"f.number\"\n");
    let Some(folder) = Folder::new("variables of the environment", &[("st.py", &node), ("g.toml", &graph)]) else {
        return;
    };
    let with = |model: Option<&str>, arguments: &[&str]| {
        let mut command = osteoflow();
        command.current_dir(folder.0.path()).env("OSTEOFLOW_PYTHON", &folder.1).env_remove("MODEL");
        command.env("OSTEOFLOW_CACHE", folder.path("cache"));
        model.into_iter().for_each(|model| {
            command.env("MODEL", model);
        });
        let output = command.args(arguments).output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
    };
    let json = |file: &str| -> Value { serde_json::from_slice(&fs::read(folder.path(file)).unwrap()).unwrap() };
    let environment = |file: &str| json(file)["plugins"][0]["loads"]["environment"].to_string();
    assert_eq!(with(Some("2"), &["run", "g.toml", "--out", "r"]).0, Some(0));
    assert!(environment("r/manifest.json").contains("\"MODEL=2\""), "{}", environment("r/manifest.json"));
    assert_eq!(with(None, &["run", "g.toml", "--out", "u"]).0, Some(0));
    assert!(environment("u/manifest.json").contains("\"MODEL unset\""), "{}", environment("u/manifest.json"));
    let (code, text) = with(Some("3"), &["replay", "r"]);
    assert!(code == Some(4) && text.contains("MODEL=2 against 3"), "{code:?} {text}");
    assert_eq!(with(Some("2"), &["replay", "r"]).0, Some(0));
    let (code, text) = with(Some("2"), &["diff", "r", "u"]);
    assert!(code == Some(4) && text.contains("plugin st: MODEL=2 against unset"), "{code:?} {text}");
    // A sweep is not continued nor merged with another value.
    assert_eq!(with(Some("2"), &["sweep", "g.toml", "--out", "s"]).0, Some(0));
    assert!(environment("s/sweep.json").contains("\"MODEL=2\""));
    fs::remove_file(folder.path("s/runs/000002.json")).unwrap();
    let (code, text) = with(Some("3"), &["sweep", "g.toml", "--out", "s", "--resume"]);
    assert!(code == Some(2) && text.contains("MODEL=2 against 3"), "{code:?} {text}");
    assert_eq!(with(Some("2"), &["sweep", "g.toml", "--shard", "1/2", "--out", "p1"]).0, Some(0));
    assert_eq!(with(Some("3"), &["sweep", "g.toml", "--shard", "2/2", "--out", "p2"]).0, Some(0));
    let (code, text) = with(None, &["sweep", "--merge", "p1", "p2", "--out", "m"]);
    assert!(code == Some(2) && text.contains("MODEL="), "{code:?} {text}");
    // The numbers are those of each value.
    for (model, number) in [(Some("5"), 5.0), (Some("6"), 6.0), (Some("5"), 5.0)] {
        assert_eq!(with(model, &["run", "g.toml", "--out", "again", "--force"]).0, Some(0));
        assert_eq!(json("again/results.json")["f"]["number"], number);
    }
    // An item that failed is run again with the value named by which it differs.
    folder.write(
        "st.py",
        &node.replace(
            "    return R",
            "    if os.environ[\"MODEL\"] == \"bad\":\n        raise ValueError(1)\n    return R",
        ),
    );
    assert_eq!(with(Some("bad"), &["run", "g.toml", "--out", "failed"]).0, Some(3));
    let (code, text) = with(Some("bad"), &["repro", "failed/repro/f-0"]);
    assert!(code == Some(0) && !text.contains("against"), "{code:?} {text}");
    let (code, text) = with(Some("good"), &["repro", "failed/repro/f-0"]);
    assert!(text.contains("MODEL=bad against good"), "{code:?} {text}");
    // What env may not be.
    let faults = [
        ("env = [\"MODEL\"]", "env = \"MODEL\"", "env takes a list of names"),
        ("env = [\"MODEL\"]", "env = [\"A=B\"]", "no environment variable is called \"A=B\""),
        ("kind = \"st.src\"\n", "kind = \"acquire.simulated\"\nenv = [\"MODEL\"]\n", "env is for kinds of plugins"),
    ];
    for (from, to, expected) in faults {
        folder.write("wrong.toml", &graph.replace(from, to));
        let (code, text) = with(None, &["check", "wrong.toml"]);
        assert!(code == Some(2) && text.contains(expected) && text.contains("wrong.toml:"), "{to}: {code:?} {text}");
    }
    let mut check = std::process::Command::new(crate::common::program());
    check.current_dir(folder.0.path()).env("OSTEOFLOW_PYTHON", &folder.1).args(["check", "g.toml"]);
    check.env("MODEL", <std::ffi::OsStr as std::os::unix::ffi::OsStrExt>::from_bytes(b"\xff"));
    let said = String::from_utf8(check.output().unwrap().stderr).unwrap();
    assert!(said.contains("the environment variable MODEL is no text"), "{said}");
}

#[test]
fn what_made_two_recordings_differ_is_named_above_the_numbers() {
    let files = [("st.py", HELPED), ("g.toml", GRAPH), ("helper.py", "A = 1\nSCALE = 1.5\n")];
    let Some(folder) = Folder::new("what made two recordings", &files) else { return };
    folder.ends_well(&["run", "g.toml", "--out", "a"]);
    folder.ends_well(&["run", "g.toml", "--out", "same"]);
    folder.write("helper.py", "A = 1\nSCALE = 2.5\n");
    let parameters = format!("{GRAPH}# \n")
        .replace("in = { cloud = \"src.cloud\" }", "in.cloud = { from = \"src.cloud\", capacity = 9 }");
    folder.write("h.toml", &parameters);
    folder.ends_well(&["run", "h.toml", "--out", "b", "--set", "graph.seed=7"]);
    let (code, text) = folder.says(&["diff", "a", "b"]);
    assert_eq!(code, Some(4), "{text}");
    let expected = [
        "[graph] seed: A 0, B 7",
        "[node.f] in.cloud.capacity: A 4, B 9",
        "plugin st: helper (",
        "helper.py) differs",
        "plugin st: helper: line 2: A `SCALE = 1.5`, B `SCALE = 2.5`",
    ];
    let first = text.find("first divergence").unwrap();
    for words in expected {
        assert!(text[..first].contains(words), "{words}: {text}");
    }
    let (code, text) = folder.says(&["diff", "a", "same"]);
    assert!(code == Some(0) && !text.contains("made by"), "{code:?} {text}");
    // The file of the plugin, by its line.
    folder.write("st.py", &HELPED.replace("np.arange(30.0)", "np.arange(1.0, 31.0)"));
    folder.ends_well(&["run", "g.toml", "--out", "c"]);
    let (_, text) = folder.says(&["diff", "b", "c"]);
    assert!(
        text.contains("plugin st: A ") && text.contains("B `yield 0, Cloud(\"camera\", np.arange(1.0, 31.0)"),
        "{text}"
    );
    let path: PathBuf = folder.path("a");
    let (_, answer) = folder.says(&["diff", "--format", "json", path.to_str().unwrap(), "b"]);
    assert!(answer.contains("\"made\""), "{answer}");
}

#[test]
fn an_interpreter_without_numpy_is_named_with_the_ways_to_another() {
    let Some(folder) = Folder::new("an interpreter without numpy", &[("st.py", HELPED), ("g.toml", GRAPH)]) else {
        return;
    };
    let hidden = folder.path("hidden");
    fs::create_dir_all(hidden.join("numpy")).unwrap();
    fs::write(hidden.join("numpy/__init__.py"), "raise ModuleNotFoundError(\"No module named 'numpy'\")\n").unwrap();
    let mut check = osteoflow();
    check.current_dir(folder.0.path()).env("PYTHONPATH", &hidden).args(["check", "g.toml", "--python"]).arg(&folder.1);
    let said = String::from_utf8(check.output().unwrap().stderr).unwrap();
    let interpreter = format!("the interpreter {}", folder.1.display());
    assert!(said.contains(&interpreter) && said.contains("No module named 'numpy'"), "{said}");
    assert!(said.contains("--python FILE, OSTEOFLOW_PYTHON, or plugins = [{ file ="), "{said}");
}

#[test]
fn a_recorded_stream_is_thinned_by_a_sample_and_loses_nothing_by_chance() {
    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("thin.toml");
    let write = |policy: &str| {
        let source = format!("kind = \"acquire.mcap\"\npath = {:?}", root().join(FOREIGN));
        let text = SCANNER.replace("kind    = \"acquire.foxglove_ws\"\naddress = \"ws://127.0.0.1:9\"", &source);
        let text = text.replacen("/no/such", "/camera/laser_p1\", \"/camera/laser_p2\", \"/camera/laser_p3", 1);
        let text = text.replacen(
            "topic = \"/camera/laser_p1\", \"/camera/laser_p2\", \"/camera/laser_p3\"",
            "topics = [\"/camera/laser_p1\", \"/camera/laser_p2\", \"/camera/laser_p3\"]",
            1,
        );
        let text = text.replace("/no/such", "/tracker/camera_marker");
        fs::write(
            &graph,
            text.replace("cloud = \"scanner.cloud\"", &format!("cloud = {{ from = \"scanner.cloud\", {policy} }}")),
        )
        .unwrap();
    };
    write("policy = \"sample\", every = 2");
    let path = graph.to_str().unwrap();
    let [first, again] = ["1", "8"].map(|workers| run_whole(path, &["--workers", workers, "--no-record"]).results);
    assert_eq!(first, again);
    let clouds = first["clouds"].as_array().unwrap();
    assert_eq!(
        clouds.iter().filter(|cloud| cloud["frame"] == "camera").count(),
        2,
        "items 0 and 2 of three: {clouds:?}"
    );
    write("policy = \"drop_old\"");
    let refused = crate::common::run(path, &[]);
    assert!(refused.code == 2 && refused.stderr.contains("is no live source"), "{}", refused.stderr);
}
