//! Files as values of a factor, lists of extended files, and single runs.

use super::*;
use crate::plugin::Kinds;

impl Desk {
    fn write(&self, name: &str, text: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// The settings of all runs.
    fn sets(&self) -> Vec<Vec<String>> {
        self.check().runs.iter().map(|run| run.row.sets.clone()).collect()
    }
}

/// The graph of toys whose last node has a parameter that takes any text.
fn with_counter(counter: &str, sweep: &str) -> String {
    graph(counter, &format!("\n[sweep.columns]\nlast = \"values.last\"\n{sweep}"))
}

#[test]
fn the_files_of_a_pattern_are_values_in_the_order_of_their_numbers() {
    let sweep = "[sweep.factor]\nscan = { key = \"shared.counter\", files = \"scans/*.ply\" }\n";
    let desk = Desk::new(&with_counter("sweep-files", sweep));
    for name in ["scan_10.ply", "scan_2.ply", "other.txt", ".hidden.ply"] {
        desk.write(&format!("scans/{name}"), "");
    }
    let sweep = desk.check();
    let labels: Vec<_> = sweep.spec.factors[0].levels.iter().map(|level| level.label.clone()).collect();
    assert_eq!(labels, ["scan_2", "scan_10"]);
    assert_eq!(desk.sets()[0], ["shared.counter=\"scans/scan_2.ply\"", "graph.seed=7"]);
    // The same labels twice: the paths tell them apart.
    for name in ["a/s.ply", "b/s.ply"] {
        desk.write(name, "");
    }
    fs::write(&desk.graph, fs::read_to_string(&desk.graph).unwrap().replace("scans/*.ply", "?/s.ply")).unwrap();
    let labels: Vec<_> = desk.check().spec.factors[0].levels.iter().map(|level| level.label.clone()).collect();
    assert_eq!(labels, ["a/s.ply", "b/s.ply"]);
}

#[test]
fn files_that_are_not_there_and_files_beside_values_are_faults_with_what_is_there() {
    let sweep = r#"[sweep.factor]
none   = { key = "last.sleep_us", files = "scans/*.pcd" }
folder = { key = "last.noise", files = "scan/*.ply" }
both   = { key = "last.bad", files = "scans/*.ply", values = [true] }
range  = { key = "last.gate", files = "scans/*.ply", n = 3 }
labels = { key = "last.budget_us", files = "scans/*.ply", labels = ["a", "b"] }
keyed  = { key = "last.most_looks", variants = "scans/*.ply" }
gone   = { variants = ["gone.toml"] }
wrong  = { variants = "wrong.toml" }
"#;
    let desk = Desk::new(&with_counter("sweep-no-files", sweep));
    desk.write("scans/a.ply", "");
    desk.write("other.toml", "");
    desk.write("wrong.toml", "extends = [\"toy.toml\", \"other.toml\"]\n[sweep]\nrepeat = 3\n");
    let message = desk.faults();
    for expected in [
        "factor \"none\": no file matches scans/*.pcd",
        "scans has: a.ply",
        "there is no folder scan\n",
        "factor \"both\" has values and files",
        "factor \"range\" has files and a range",
        "factor \"labels\" has 1 values and 2 labels",
        "factor \"keyed\" has variants and a key",
        "there is no graph file",
        "gone.toml",
        "a variant changes a run, and not the sweep",
        "wrong.toml:2:2",
        "which the graph of the sweep does not",
        "wrong.toml:1:24",
    ] {
        assert!(message.contains(expected), "{expected}\n---\n{message}");
    }
}

#[test]
fn variants_are_merged_over_the_graph_frozen_and_told_apart_when_a_sweep_is_resumed() {
    let sweep = "[sweep]\nrepeat = 2\n[sweep.factor]\nmethod = { variants = \"v/*.toml\" }\n";
    let desk = Desk::new(&with_counter("sweep-variants", sweep));
    desk.write("v/slow.toml", "extends = \"../toy.toml\"\n[node.last]\nsleep_us = 1\n");
    desk.write("v/none.toml", "remove = [\"node.shared.takes\"]\n[node.last]\nin.a = \"scan.p0\"\n");
    let checked = desk.check();
    let text = |run: usize| checked.runs[run].plan.resolved.clone();
    assert!(text(2).contains("sleep_us = 1\n") && text(2).contains("takes = \"draws\""), "{}", text(2));
    assert!(!text(0).contains("takes") && text(0).contains("in.a = { from = \"scan.p0\""), "{}", text(0));
    assert_eq!(checked.runs[0].row.values[0], ("method".into(), "none".into()));
    let (_, runs, _) = desk.sweep("out", &options(2, true));
    assert_eq!(desk.sweep("alone", &options(1, false)).1, runs, "with and without sharing");
    // Each run can be checked again from the folder, though the files are gone.
    for name in ["v/slow.toml", "v/none.toml"] {
        fs::rename(desk.path(name), desk.path(&format!("{name}.was"))).unwrap();
    }
    let folder = Folder::open(&desk.path("out")).unwrap();
    for run in 0..4 {
        let checked_again = again(&folder, run, &[], &Kinds::from(&registry())).unwrap().unwrap();
        assert_eq!(checked_again.plan.resolved, text(run), "run {run}");
    }
    for name in ["v/slow.toml", "v/none.toml"] {
        fs::rename(desk.path(&format!("{name}.was")), desk.path(name)).unwrap();
    }
    desk.check().resume(&desk.path("out"), &options(1, true)).unwrap();
    desk.write("v/slow.toml", "[node.last]\nsleep_us = 2\n");
    desk.write("v/third.toml", "[node.last]\nsleep_us = 3\n");
    fs::remove_file(desk.path("v/none.toml")).unwrap();
    let message = desk.check().resume(&desk.path("out"), &options(1, true)).unwrap_err().to_string();
    for expected in [
        "its table [sweep] differs: its factor method has another value \"slow\", ",
        "its factor method has no value \"third\", ",
        "its factor method has the value \"none\"; ",
    ] {
        assert!(message.contains(expected), "{expected}\n---\n{message}");
    }
}

#[test]
fn a_variant_and_a_factor_of_the_same_key_are_refused_and_its_faults_are_in_its_file() {
    let sweep = "[sweep.factor]\nmethod = { variants = [\"a.toml\", \"b.toml\"] }\nnamed = { variants = \"named.toml\" }\nslow = { key = \"last.sleep_us\", \
                 values = [1] }\ntakes = { values = [{ remove = [\"node.shared.takes\"] }], labels = [\"none\"] }\n";
    let desk = Desk::new(&with_counter("sweep-variant-keys", sweep));
    desk.write("a.toml", "[graph]\nname = \"a\"\n[node.last]\nsleep_us = 1\n");
    desk.write("named.toml", "[graph]\nformat = 1\nname = \"named\"\n");
    desk.write("b.toml", "remove = [\"node.shared.takes\"]\n");
    let message = desk.faults();
    assert!(message.contains("factor \"method\" and factor \"slow\" both set last.sleep_us"), "{message}");
    assert!(message.contains("factor \"method\" and factor \"takes\" both set shared.takes"), "{message}");
    assert_eq!(message.matches("both set").count(), 2, "a variant has a name of its own: {message}");
    let one = "[sweep.factor]\nmethod = { variants = [\"a.toml\"] }\n";
    fs::write(&desk.graph, with_counter("sweep-variant-keys", one)).unwrap();
    desk.write("a.toml", "[node.last]\nsleep_us = true\nsleep = 3\n");
    let message = desk.faults();
    assert!(message.contains("a.toml:2:12") && message.contains("a.toml:3:1"), "{message}");
    assert!(message.contains("in run 0 of the sweep: method = \"a\""), "{message}");
    let message = desk.faults_with(&["last.sleep_us=3"]);
    assert!(message.contains("last.sleep_us is set by the factor \"method\""), "{message}");
}

#[test]
fn extended_files_are_merged_in_their_order_each_once() {
    let desk = Desk::new("extends = [\"a.toml\", \"b.toml\"]\n[node.last]\nsleep_us = 9\n");
    desk.write("base.toml", &graph("sweep-extends", ""));
    desk.write("a.toml", "extends = \"base.toml\"\n[node.last]\nnoise = true\nmost_looks = 1\n");
    desk.write("b.toml", "extends = \"base.toml\"\nremove = [\"node.last.noise\"]\n[node.last]\nmost_looks = 2\n");
    let kinds = &Kinds::from(&registry());
    let plan = crate::check::check(&desk.graph, &[], kinds).unwrap_or_else(|f| panic!("{f}")).plan;
    let last = &plan.nodes.iter().find(|node| *node.name == *"last").unwrap().params;
    assert_eq!((&last["noise"], &last["most_looks"], &last["sleep_us"]), (&json!(false), &json!(2), &json!(9)));
    let files = crate::check::files(&desk.graph, &[], kinds);
    let names: Vec<_> = files.iter().filter_map(|file| file.file_name()?.to_str()).collect();
    assert_eq!(names, ["toy.toml", "a.toml", "base.toml", "b.toml"], "what is watched");
    // A fault is in the file that wrote it; a file that is named twice, or extends itself, is one.
    desk.write("b.toml", "extends = [\"base.toml\", \"toy.toml\"]\n[node.last]\nmost_looks = -2\n");
    fs::write(&desk.graph, "extends = [\"a.toml\", \"b.toml\", \"./a.toml\"]\n").unwrap();
    let message = crate::check::check(&desk.graph, &[], kinds).unwrap_err().render(false);
    for expected in
        ["b.toml:3:14", "a.toml twice", "toy.toml:1:32", "files extend each other in a circle", "b.toml:1:25"]
    {
        assert!(message.contains(expected), "{expected}\n---\n{message}");
    }
}

#[test]
fn kinds_with_other_parameters_are_values_that_are_tables() {
    let sweep = r#"
[sweep]
twice = 0
[sweep.factor]
kind = { values = [
    { shared.kind = "toy.kept_with_seed", shared.takes = "draws" },
    { shared.kind = "toy.add", shared.sleep_us = 1, remove = ["node.shared.counter"] },
], labels = ["kept", "add"] }
[sweep.columns]
last = "values.last"
"#;
    let desk = Desk::new(&graph("sweep-kinds", sweep).replace("takes   = \"draws\"\n", ""));
    let (_, runs, _) = desk.sweep("out", &options(2, true));
    assert_eq!(desk.sweep("alone", &options(1, false)).1, runs);
    assert_eq!(runs.matches(",complete,").count(), 2, "{runs}");
    let folder = Folder::open(&desk.path("out")).unwrap();
    for (run, one) in desk.check().runs.iter().enumerate() {
        let checked_again = again(&folder, run, &[], &Kinds::from(&registry())).unwrap().unwrap();
        assert_eq!(checked_again.plan.resolved, one.plan.resolved, "run {run} of the frozen graph");
    }
    // What one kind alone has is not written for all.
    let plain = sweep.replace(", remove = [\"node.shared.counter\"]", "");
    fs::write(&desk.graph, graph("sweep-kinds", &plain).replace("takes   = \"draws\"\n", "")).unwrap();
    let message = desk.faults();
    assert!(message.contains("counter") && message.contains("remove") && message.contains("in run 1"), "{message}");
}

#[test]
fn single_runs_are_checked_alone_and_numbers_that_are_not_there_are_named() {
    let desk = Desk::new(&graph("sweep-only", SIX));
    let kinds = Kinds::from(&registry());
    let runs = check_only(&desk.graph, &[], &kinds, &[4, 1], 1, None).unwrap();
    let whole = desk.check();
    for (run, number) in runs.iter().zip([4, 1]) {
        assert_eq!((&run.row, &run.plan.resolved), (&whole.runs[number].row, &whole.runs[number].plan.resolved));
    }
    let message = check_only(&desk.graph, &[], &kinds, &[6], 1, None).unwrap_err().render(false);
    assert!(message.contains("toy.toml has no run 6") && message.contains("runs 0 to 5"), "{message}");
}
