//! A failing node is named, the rest of the graph finishes, and its item can be run again alone.

use crate::common::{Ran, is_slow_run, json, osteoflow, run, shared_run};
use osteoflow_engine::Recording;
use serde_json::Value;
use std::{
    collections::BTreeSet,
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

const GRAPH: &str = "graphs/fibula.toml";
/// Settings that record every wire of a procedure that takes less time.
const ALL_WIRES: [&str; 6] =
    ["--set", "record.wires=[\"*\"]", "--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];

/// Runs `work` for every name, a few at a time.
fn for_each(names: &[String], work: impl Fn(&str) + Sync) {
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                while let Some(name) = names.get(next.fetch_add(1, Ordering::Relaxed)) {
                    work(name);
                }
            });
        }
    });
}

struct Whole {
    manifest: Value,
    recording: Recording,
}

fn whole(ran: &Ran) -> Whole {
    let manifest = json(&ran.dir.path().join("manifest.json"));
    Whole { manifest, recording: Recording::open(&ran.dir.path().join("run.mcap")).unwrap() }
}

impl Whole {
    fn nodes(&self) -> Vec<String> {
        self.manifest["nodes"].as_array().unwrap().iter().map(|n| n["name"].as_str().unwrap().to_owned()).collect()
    }

    fn node(&self, name: &str) -> &Value {
        self.manifest["nodes"].as_array().unwrap().iter().find(|n| n["name"] == name).unwrap()
    }

    /// The node and everything downstream of it.
    fn downstream(&self, name: &str) -> BTreeSet<String> {
        let node = |end: &Value| end.as_str().unwrap().rsplit_once('.').unwrap().0.to_owned();
        let mut reached = BTreeSet::from([name.to_owned()]);
        loop {
            let links = self.manifest["links"].as_array().unwrap().iter();
            let fed: BTreeSet<_> =
                links.filter(|l| reached.contains(&node(&l["from"]))).map(|l| node(&l["to"])).collect();
            let before = reached.len();
            reached.extend(fed);
            if reached.len() == before {
                return reached;
            }
        }
    }
}

fn repro(dir: &Path) -> (i32, Value) {
    let output = osteoflow().args(["repro", "--format", "json"]).arg(dir).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let stderr = String::from_utf8_lossy(&output.stderr);
    (output.status.code().unwrap(), serde_json::from_str(&printed).unwrap_or_else(|e| panic!("{e}: {printed}{stderr}")))
}

/// A failure injected into the node is named, the rest is as in the run without it, and `repro` repeats it.
fn check(before: &Whole, node: &str, how: &str) {
    let ran = run(GRAPH, &[&ALL_WIRES[..], &["--inject", &format!("{node}={how}")]].concat());
    // A panic refuses the run even if only optional results depend on the node.
    assert_eq!(ran.code, 3, "{node}: {}", ran.stderr);
    let refused = &ran.results["refused"];
    assert_eq!((refused["node"].as_str(), refused["item"].as_u64()), (Some(node), Some(0)), "{refused}");
    let reason = refused["reason"].as_str().unwrap();
    if how == "panic" {
        assert!(reason.starts_with("panicked at engine/runtime/src/inject.rs:"), "{node}: {reason}");
    }
    assert!(reason.ends_with(&format!("was injected into {node} at item 0")), "{reason}");
    let named = format!("node \"{node}\", item 0: {reason}");
    let line = ran.stderr.lines().find(|line| line.contains(&named)).unwrap_or_else(|| panic!("{}", ran.stderr));
    assert!(line.contains(":") && line.starts_with("refused: graphs/"), "{line}");

    let after = whole(&ran);
    assert_eq!(after.recording.truncated, None, "{node}");
    let fed = before.downstream(node);
    for other in before.nodes().iter().filter(|other| !fed.contains(*other)) {
        for count in ["items", "skipped", "failed"] {
            let (was, is) = (&before.node(other)[count], &after.node(other)[count]);
            assert_eq!(was, is, "{count} of {other}, where {node} fails");
        }
    }
    for (name, wire) in &before.recording.wires {
        let (producer, is) = (name.rsplit_once('.').unwrap().0, &after.recording.wires[name]);
        if !fed.contains(producer) {
            assert!(wire.messages == is.messages, "{name} is not as it was, where {node} fails");
        }
        if producer == node {
            let items = is.items().unwrap();
            assert_eq!(items.len(), 1, "{name}");
            assert_eq!(items[0].body.as_ref().unwrap_err().reason, reason);
        }
    }
    for link in after.manifest["links"].as_array().unwrap() {
        let count = |key: &str| link[key].as_u64().unwrap();
        assert_eq!(count("sent"), count("received") + count("dropped"), "{link}, where {node} fails");
    }

    let (code, printed) = repro(&ran.dir.path().join(format!("repro/{node}-0")));
    assert_eq!((code, &printed["same"]), (0, &Value::Bool(true)), "{node}: {printed:#}");
    assert_eq!((&printed["injected"], &printed["failed_now"]["reason"]), (&how.into(), &reason.into()));
}

#[test]
fn a_panic_in_any_node_of_fibula_is_named_the_rest_drains_and_the_item_fails_again_alone() {
    let before = whole(shared_run(GRAPH, &ALL_WIRES));
    // Each is a run of its own.
    let every = if is_slow_run() { 1 } else { 8 };
    let nodes: Vec<String> = before.nodes().into_iter().step_by(every).collect();
    for_each(&nodes, |node| check(&before, node, "panic"));
    let failing = if is_slow_run() { &["recording", "icp", "planes"][..] } else { &["recording", "planes"] };
    let failing: Vec<String> = failing.iter().map(|node| (*node).to_owned()).collect();
    for_each(&failing, |node| check(&before, node, "error"));
}

#[test]
fn a_node_that_skips_errors_goes_on_after_an_injected_one_and_five_items_are_saved() {
    let mut arguments = vec!["--set".to_owned(), "planes.on_error=skip".into()];
    for item in 0..7 {
        arguments.extend(["--inject".to_owned(), format!("planes@{item}={}", ["panic", "error"][item % 2])]);
    }
    let ran = run(GRAPH, &arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let whole = whole(&ran);
    let node = whole.node("planes");
    assert_eq!(node["failed"], 7);
    assert!(node["items"].as_u64().unwrap() > 7, "{node}");
    let items = whole.recording.wires["planes.planes"].items().unwrap();
    let reason = |item: usize| items[item].body.as_ref().map_err(|empty| empty.reason.clone()).err();
    assert!(reason(0).unwrap().ends_with("a panic was injected into planes at item 0"), "{:?}", reason(0));
    assert_eq!(reason(1).unwrap(), "an error was injected into planes at item 1");
    assert_eq!(reason(7), None, "it goes on");
    let bundles = std::fs::read_dir(ran.dir.path().join("repro")).unwrap().map(|e| e.unwrap().path());
    let mut bundles: Vec<_> = bundles.collect();
    bundles.sort();
    assert_eq!(bundles.len(), 5);
    assert!(ran.stderr.contains("node \"planes\" failed 2 more times; these failures are not saved"), "{}", ran.stderr);
    for bundle in bundles {
        let (code, printed) = repro(&bundle);
        assert_eq!((code, &printed["same"]), (0, &Value::Bool(true)), "{printed:#}");
    }
}

#[test]
fn an_error_returned_by_a_node_is_repeated_alone_with_the_same_message() {
    let ran = run(GRAPH, &["--set", "icp.max_pair_distance_mm=0.0001"]);
    assert_eq!((ran.code, &ran.results["refused"]["node"]), (3, &"icp".into()), "{}", ran.stderr);
    let bundle = ran.dir.path().join("repro/icp-0");
    let (code, printed) = repro(&bundle);
    assert_eq!((code, &printed["same"], &printed["injected"]), (0, &Value::Bool(true), &Value::Null), "{printed:#}");
    assert_eq!(printed["failed_now"]["reason"], ran.results["refused"]["reason"]);

    // With a parameter that lets it succeed, it does not fail, which differs.
    let path = bundle.join("repro.json");
    let mut description = json(&path);
    let table = description["node"]["table"].as_str().unwrap();
    let wider = table.replace("max_pair_distance_mm = 0.0001", "max_pair_distance_mm = 5.0");
    assert_ne!(wider, table);
    description["node"]["table"] = wider.into();
    std::fs::write(&path, description.to_string()).unwrap();
    let (code, printed) = repro(&bundle);
    assert_eq!((code, &printed["same"], &printed["failed_now"]), (4, &Value::Bool(false), &Value::Null), "{printed:#}");
}

#[test]
fn a_damaged_bundle_is_refused_with_the_reason() {
    let ran = run(GRAPH, &["--inject", "icp", "--no-record"]);
    let bundle = ran.dir.path().join("repro/icp-0");
    let printed = |dir: &Path| {
        let output = osteoflow().arg("repro").arg(dir).output().unwrap();
        (output.status.code().unwrap(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let expect = |dir: &Path, code: i32, words: &str| {
        let (found, text) = printed(dir);
        assert!(found == code && text.contains(words), "{found}, expected {code} and \"{words}\": {text}");
    };
    expect(ran.dir.path(), 1, "a repro bundle is a folder repro/NODE-ITEM of a run");
    let inputs = bundle.join("inputs.mcap");
    let bytes = std::fs::read(&inputs).unwrap();
    for cut in [0, 5, bytes.len() / 2, bytes.len() - 9] {
        std::fs::write(&inputs, &bytes[..cut]).unwrap();
        let (code, text) = printed(&bundle);
        assert!(code == 1 || (code == 0 && cut > bytes.len() - 10), "cut at {cut}: {code} {text}");
        assert!(!text.contains("panicked at"), "{text}");
    }
    std::fs::remove_file(&inputs).unwrap();
    expect(&bundle, 1, "cannot read");
    let path = bundle.join("repro.json");
    let text = std::fs::read_to_string(&path).unwrap();
    for (from, to, code, words) in [
        ("icp.point_to_plane", "icp.no_such", 2, "there is no kind \"icp.no_such\""),
        ("\"format_version\": 3", "\"format_version\": 2", 1, "it has version 2, this program reads version 3"),
        ("min_pairs = 10", "min_pairs = \\\"x\\\"", 2, "min_pairs takes a whole number"),
        ("{", "[", 1, "describes no failed firing"),
    ] {
        std::fs::write(&path, text.replacen(from, to, if from == "{" { 1 } else { usize::MAX })).unwrap();
        expect(&bundle, code, words);
    }
}

#[test]
fn force_removes_the_bundles_of_an_earlier_run_and_nothing_else() {
    let ran = run(GRAPH, &["--inject", "icp", "--no-record"]);
    std::fs::write(ran.dir.path().join("repro/notes.txt"), "mine").unwrap();
    let again =
        osteoflow().args(["run", GRAPH, "--no-record", "--force", "--out"]).arg(ran.dir.path()).output().unwrap();
    assert!(again.status.success(), "{}", String::from_utf8_lossy(&again.stderr));
    assert!(!ran.dir.path().join("repro/icp-0").exists() && ran.dir.path().join("repro/notes.txt").exists());
}

#[test]
fn an_injection_that_names_no_node_is_a_fault_and_one_that_never_fires_is_reported() {
    let ran = run(GRAPH, &["--inject", "icpp"]);
    assert!(ran.code == 2 && ran.stderr.contains("did you mean \"icp\"?"), "{} {}", ran.code, ran.stderr);
    let ran = run(GRAPH, &["--inject", "icp@99", "--no-record"]);
    assert_eq!(ran.code, 0);
    assert!(ran.stderr.contains("icp@99=panic was not injected: the node did not fire at item 99"), "{}", ran.stderr);
}
