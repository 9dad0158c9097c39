mod files;
mod growth;
mod study;

use super::*;
use osteoflow_toy::{n_fired, registry};
use serde_json::{Value as Json, json};
use std::{fs, path::PathBuf};

/// A graph of toy nodes; runs with the same seed share `shared`.
fn graph(counter: &str, sweep: &str) -> String {
    format!(
        r#"
[graph]
format = 1
name = "toy"
seed = 7

[node.scan]
kind  = "toy.script"
out   = {{ p0 = {{ type = "toy/Number", calls = [] }} }}
calls = [{{ stamp_ns = 10, give = [[0, 1.5]] }}]

[node.shared]
kind    = "toy.kept_with_seed"
in      = {{ a = "scan.p0" }}
counter = "{counter}"
takes   = "draws"

[node.last]
kind  = "toy.add"
in    = {{ a = "shared.out", b = "scan.p0" }}

[results]
"values.shared" = "shared.out"
"values.last"   = "last.out"
all             = {{ from = "shared.out", all = true }}
{sweep}"#
    )
}

struct Desk {
    dir: tempfile::TempDir,
    graph: PathBuf,
}

impl Desk {
    fn new(text: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let graph = dir.path().join("toy.toml");
        fs::write(&graph, text).unwrap();
        Self { dir, graph }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn check(&self) -> Sweep {
        check(&self.graph, &[], &registry(), 2).unwrap_or_else(|faults| panic!("{}", faults.render(false)))
    }

    /// Faults of a graph that has some.
    fn faults(&self) -> String {
        self.faults_with(&[])
    }

    /// Faults with settings of the command line.
    fn faults_with(&self, sets: &[&str]) -> String {
        let sets: Vec<_> = sets.iter().map(|set| (*set).to_owned()).collect();
        check(&self.graph, &sets, &registry(), 2).map(|_| ()).unwrap_err().render(false)
    }

    /// Sweeps into a new folder and returns its tables.
    fn sweep(&self, out: &str, options: &SweepOptions) -> (SweepCounts, String, String) {
        let sweep = self.check();
        let folder = sweep.begin(&self.path(out), options).unwrap();
        let swept = sweep.run(&folder, options, &()).unwrap();
        folder.write_tables().unwrap();
        let read = |name| fs::read_to_string(self.path(out).join(name)).unwrap();
        (swept, read(RUNS), read(POINTS))
    }
}

fn options(workers: usize, share: bool) -> SweepOptions {
    SweepOptions { workers, run: RunOptions::default(), share, shard: None, retry_failed: false }
}

const SIX: &str = r#"
[sweep]
repeat = 3
units  = ["trial"]
[sweep.factor]
noise = { key = "last.noise", values = [false, true] }
[sweep.columns]
last   = "values.last"
[sweep.points]
all = { from = "all", axes = [] }
"#;

#[test]
fn the_tables_are_the_same_for_any_number_of_workers_with_and_without_sharing() {
    let desk = Desk::new(&graph("sweep-same", SIX));
    let (swept, runs, points) = desk.sweep("one", &options(1, false));
    assert_eq!((swept.n_run, swept.n_shared, swept.n_computed), (6, 0, 18));
    for (name, workers, share) in [("a", 1, true), ("b", 2, true), ("c", 8, true), ("d", 8, false)] {
        assert_eq!(desk.sweep(name, &options(workers, share)).1, runs, "{workers} workers, sharing: {share}");
        assert_eq!(desk.sweep(&format!("{name}2"), &options(workers, share)).2, points);
    }
    let lines: Vec<_> = runs.lines().collect();
    assert_eq!(lines[0], "run,noise,trial,seed,status,verdict,last,reason");
    assert!(lines[1].starts_with("0,false,0,7,complete,,"), "{}", lines[1]);
    assert!(lines[6].starts_with("5,true,2,9,complete,,"), "{}", lines[6]);
}

#[test]
fn shared_nodes_are_computed_once() {
    // A run that is computed twice fires again.
    let desk = Desk::new(&graph("sweep-once", &SIX.replace("[sweep]", "[sweep]\ntwice = 0")));
    let (swept, ..) = desk.sweep("out", &options(4, true));
    assert_eq!(n_fired("sweep-once"), 3, "once for each of three seeds");
    assert_eq!((swept.n_shared, swept.n_computed), (6, 12), "scan and shared of three runs came from three others");
}

#[test]
fn a_stopped_sweep_resumes_and_gives_the_same_tables() {
    let desk = Desk::new(&graph("sweep-resume", SIX));
    let (_, runs, points) = desk.sweep("whole", &options(2, true));
    desk.sweep("cut", &options(2, true));
    // State after a kill: some complete runs, and a half-written file under another name.
    for run in [1, 4, 5] {
        fs::remove_file(desk.path("cut/runs").join(format!("{run:06}.json"))).unwrap();
    }
    fs::write(desk.path("cut/runs/000001.json.99.part"), "{\"run\":").unwrap();
    fs::remove_file(desk.path("cut").join(RUNS)).unwrap();
    let sweep = desk.check();
    let folder = sweep.resume(&desk.path("cut"), &options(1, true)).unwrap();
    let swept = sweep.run(&folder, &options(2, true), &()).unwrap();
    assert_eq!((swept.n_before, swept.n_run, swept.n_missing), (3, 3, 0));
    folder.write_tables().unwrap();
    assert_eq!(fs::read_to_string(desk.path("cut").join(RUNS)).unwrap(), runs);
    assert_eq!(fs::read_to_string(desk.path("cut").join(POINTS)).unwrap(), points);
}

#[test]
fn a_changed_graph_does_not_resume_in_the_folder_of_another() {
    let desk = Desk::new(&graph("sweep-changed", SIX));
    desk.sweep("out", &options(1, true));
    fs::write(&desk.graph, graph("sweep-changed", &SIX.replace("[false, true]", "[true, false]"))).unwrap();
    let message = desk.check().resume(&desk.path("out"), &options(1, true)).unwrap_err().to_string();
    assert!(message.contains("its table [sweep] differs") && message.contains("sweep.toml"), "{message}");
    let message = desk.check().resume(&desk.path("nothing"), &options(1, true)).unwrap_err().to_string();
    assert!(message.contains("holds no sweep"), "{message}");
}

#[test]
fn merged_shards_equal_the_whole_and_a_missing_one_is_named() {
    let desk = Desk::new(&graph("sweep-shards", SIX));
    let (_, runs, points) = desk.sweep("whole", &options(2, true));
    let shards: Vec<_> = (1..=4)
        .map(|index| {
            let dir = format!("shard{index}");
            desk.sweep(&dir, &SweepOptions { shard: Some(Shard { index, of: 4 }), ..options(1, true) });
            Folder::open(&desk.path(&dir)).unwrap()
        })
        .collect();
    let message = merge(&shards[..3], &desk.path("part")).unwrap_err().to_string();
    assert!(message.starts_with("2 of 6 runs are in none of the folders"), "{message}");
    for order in [[0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]] {
        let merged = desk.path(&format!("merged {order:?}"));
        merge(&order.map(|k| shards[k].clone()), &merged).unwrap();
        assert_eq!(fs::read_to_string(merged.join(RUNS)).unwrap(), runs, "in the order {order:?}");
        assert_eq!(fs::read_to_string(merged.join(POINTS)).unwrap(), points, "in the order {order:?}");
    }
}

/// Changes a file when the first run has ended.
struct Meddler(PathBuf);

impl Watcher for Meddler {
    fn ended(&self, _: &Done) {
        fs::write(&self.0, "changed").unwrap();
    }
}

#[test]
fn an_input_that_changes_during_a_sweep_stops_it_and_no_run_of_the_changed_file_is_stored() {
    let desk = Desk::new(&graph("sweep-meddled", SIX));
    let file = desk.path("input.txt");
    fs::write(&file, "as it was").unwrap();
    let mut sweep = desk.check();
    sweep.runs.iter_mut().for_each(|run| run.plan.input_files.push(file.clone()));
    sweep.files = Stamps::of([file.clone()]);
    let folder = sweep.begin(&desk.path("out"), &options(1, true)).unwrap();
    let message = sweep.run(&folder, &options(1, true), &Meddler(file)).unwrap_err().to_string();
    assert!(message.contains("input.txt has changed while the sweep ran"), "{message}");
    assert_eq!(folder.runs().unwrap(), [0], "the run before the change");
}

#[test]
fn a_failing_run_is_a_row_with_its_reason_and_the_others_go_on() {
    let sweep = r#"
[sweep.factor]
number = { key = "scan.calls[0].give[0][1]", values = [1.0, 13.0, 666.0, 2.0] }
[sweep.columns]
last = "values.last"
"#;
    let text = graph("sweep-fails", sweep).replace(r#""toy.kept_with_seed""#, r#""toy.add""#);
    let desk = Desk::new(&text.replace("counter = \"sweep-fails\"\ntakes   = \"draws\"\n", ""));
    let (swept, runs, _) = desk.sweep("out", &options(2, true));
    assert_eq!(swept.n_run, 4);
    let lines: Vec<_> = runs.lines().collect();
    assert_eq!(lines[1], "0,1.0,0,7,complete,,2.0,");
    assert!(
        lines[2].starts_with("1,13.0,0,7,refused,refused,,") && lines[2].contains("13 is not a number"),
        "{}",
        lines[2]
    );
    assert!(lines[3].starts_with("2,666.0,0,7,refused,refused,,") && lines[3].contains("the beast"), "{}", lines[3]);
    assert_eq!(lines[4], "3,2.0,0,7,complete,,4.0,");
}

/// Numbers that are judged, with a result that is withheld if they are refused, and a report that is not.
const JUDGED: &str = r#"
[graph]
format = 1
name = "toy"

[node.scan]
kind  = "toy.script"
out   = { p0 = { type = "toy/Number", calls = [] } }
calls = [{ stamp_ns = 10, give = [[0, 1.5]] }]

[node.fit]
kind = "toy.add"
in   = { a = "scan.p0" }

[node.judge]
kind = "toy.judge"
in   = { number = "fit.out" }
doubtful_above = 2.0
refused_above  = 5.0

[results]
verdict = "judge.verdict"
fit     = "fit.out"
size    = "judge.remark"

[sweep.factor]
number  = { key = "scan.calls[0].give[0][1]", values = [1.0, 3.0, 9.0, 13.0] }
require = { key = "results.require", values = ["doubtful", "trusted"] }
[sweep.columns]
fit  = "fit"
size = "size.number"
rule = "verdict.reasons.0.rule"
[sweep.points]
point = { from = "verdict.assumptions", axes = [] }
"#;

#[test]
fn each_run_has_its_verdict_and_refused_ones_keep_the_columns_of_their_reports() {
    let desk = Desk::new(JUDGED);
    let (_, runs, _) = desk.sweep("out", &options(2, true));
    assert_eq!(desk.sweep("alone", &options(1, false)).1, runs, "with and without sharing");
    let rows: Vec<_> = runs.lines().map(|line| line.splitn(10, ',').collect::<Vec<_>>()).collect();
    assert_eq!(rows[0].join(","), "run,number,require,repeat,seed,status,verdict,fit,size,rule,reason");
    let columns = |row: usize| [5, 6, 7, 8].map(|column| rows[row + 1][column]);
    for (row, expected) in [
        (0, ["complete", "trusted", "1.0", "1.0"]),
        (1, ["complete", "trusted", "1.0", "1.0"]),
        (2, ["complete", "doubtful", "3.0", "3.0"]),
        (3, ["refused", "refused", "", "3.0"]),
        (4, ["refused", "refused", "", "9.0"]),
        (5, ["refused", "refused", "", "9.0"]),
        (6, ["refused", "refused", "", ""]),
        (7, ["refused", "refused", "", ""]),
    ] {
        assert_eq!(columns(row), expected, "run {row}:\n{runs}");
    }
    let folder = Folder::open(&desk.path("out")).unwrap();
    let done: Vec<_> = folder.done().unwrap().map(Result::unwrap).collect();
    let reason = |run: usize| done[run].reason.clone().unwrap_or_default();
    assert!(reason(4).ends_with("the result is refused: 9 is too large; take a smaller number"), "{}", reason(4));
    assert!(reason(3).ends_with("require = \"trusted\": 3 is too large; take a smaller number"), "{}", reason(3));
    let rule = |run: usize| at_path(&done[run].results, "verdict.reasons.0.rule").and_then(Json::as_str);
    assert_eq!([2, 3, 4, 6].map(rule), [Some("size"), Some("require"), Some("size"), Some("failure")]);
    assert_eq!(without_value(&folder.spec().unwrap(), &done), [], "a reason may be in refused runs alone");
    // A folder of an earlier version, whose runs have no verdict.
    let path = desk.path("out").join(RUNS_DIR).join("000006.json");
    let mut run: Json = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    run["results"].as_object_mut().unwrap().remove("verdict");
    fs::write(&path, run.to_string()).unwrap();
    folder.write_tables().unwrap();
    assert!(fs::read_to_string(desk.path("out").join(RUNS)).unwrap().contains("6,13.0,doubtful,0,0,refused,,,,,"));
}

#[test]
fn points_are_those_of_complete_runs() {
    let text = JUDGED.replace("size    = \"judge.remark\"", "size = { from = \"judge.remark\", all = true }");
    let text = text.replace("\"verdict.assumptions\", axes = []", "\"size\", axes = [\"number\"]");
    let text = text.replace("size = \"size.number\"", "size = \"size.0.number\"");
    let (_, runs, points) = Desk::new(&text).sweep("out", &options(2, true));
    assert_eq!(runs.matches(",9.0,size,").count(), 2, "the column of refused runs is there:\n{runs}");
    let rows: Vec<_> = points.lines().skip(1).map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(rows, ["0", "1", "2"], "{points}");
}

#[test]
fn a_column_may_name_the_verdict_only_if_the_graph_has_one_and_none_may_be_called_so() {
    let columns = "\n[sweep.columns]\nanswer = \"verdict.answer\"\nverdict = \"values.last\"\n";
    let message = Desk::new(&graph("sweep-no-verdict", columns)).faults();
    assert!(message.contains("column \"answer\" asks for verdict.answer, which no run has"), "{message}");
    assert!(message.contains("a column of the sweep cannot be called \"verdict\""), "{message}");
    let asked = JUDGED.replace("fit  = \"fit\"", "fit = \"fit\"\nwhat = \"require\"");
    let message = Desk::new(&asked).faults();
    assert!(message.contains("column \"what\" asks for require, which no run has"), "{message}");
}

#[test]
fn paired_factors_go_together_and_others_are_crossed() {
    let factor = |name: &str, values: Json| {
        let levels = values.as_array().unwrap().iter();
        let levels =
            levels.map(|label| Level { label: label.clone(), sets: vec![format!("n.{name}={label}")], variant: None });
        Factor { name: name.into(), levels: levels.collect() }
    };
    let spec = Spec {
        repeat: 2,
        repeat_name: "trial".into(),
        same_seed: true,
        twice: 0.0,
        factors: vec![factor("a", json!([1, 2])), factor("b", json!(["x", "y"])), factor("c", json!([10, 20]))],
        pair: vec![vec!["a".into(), "c".into()]],
        draws: vec![Draw {
            name: "d".into(),
            keys: vec!["n.d".into(), "m.d".into()],
            distribution: Distribution::Uniform([-1.0, 1.0]),
        }],
        units: Vec::new(),
        columns: Vec::new(),
        points: Vec::new(),
        limits: Vec::new(),
        compare: Vec::new(),
    };
    let rows = rows(&spec, 5);
    let formatted: Vec<_> = rows
        .iter()
        .map(|row| row.values[..4].iter().map(|(_, v)| v.to_string()).collect::<Vec<_>>().join(" "))
        .collect();
    let expected = [
        "1 \"x\" 10 0",
        "1 \"x\" 10 1",
        "1 \"y\" 10 0",
        "1 \"y\" 10 1",
        "2 \"x\" 20 0",
        "2 \"x\" 20 1",
        "2 \"y\" 20 0",
        "2 \"y\" 20 1",
    ];
    assert_eq!(formatted, expected);
    assert_eq!(rows[0].values[4], rows[2].values[4], "a draw is the same under all factors");
    assert_ne!(rows[0].values[4], rows[1].values[4], "and anew for each repeat");
    assert!(rows.iter().all(|row| row.seed == 5 && !row.sets.iter().any(|set| set.starts_with("graph.seed"))));
    assert_eq!(rows[0].sets.iter().filter(|set| set.contains(".d=")).count(), 2);
}

#[test]
fn a_range_is_evenly_spaced_and_ends_at_both_ends_exactly() {
    let levels = |range: &str| {
        let graph = JUDGED.split("[sweep").next().unwrap();
        let factor = format!("[sweep.factor]\nx = {{ key = \"judge.doubtful_above\", {range} }}\n");
        let factor = Desk::new(&format!("{graph}{factor}")).check().spec.factors.remove(0);
        factor.levels.into_iter().map(|level| level.label.as_f64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(levels("from = 0.5, to = 2.5, n = 5"), [0.5, 1.0, 1.5, 2.0, 2.5]);
    assert_eq!(levels("from = 2, to = -2, n = 3"), [2.0, 0.0, -2.0]);
    // In the logarithm, and back, 10 is 10.000000000000002, and 0.1 + 2 * 0.1 is not 0.3 either.
    for (from, to) in [(1.0, 10.0), (10.0, 1.0), (0.3, 7.0)] {
        let found = levels(&format!("from = {from}, to = {to}, n = 3, log = true"));
        assert_eq!((found.len(), found[0], found[2]), (3, from, to));
        assert!((found[1] / (from * to).sqrt() - 1.0).abs() < 1e-12, "{found:?}");
    }
    let found = levels("from = 0.1, to = 0.3, n = 8");
    assert_eq!((found[0], found[7]), (0.1, 0.3));
}

#[test]
fn draws_follow_their_distributions() {
    let draw = |distribution| Draw { name: "d".into(), keys: Vec::new(), distribution };
    let values = |distribution| {
        let spec = Spec {
            repeat: 4000,
            repeat_name: "r".into(),
            same_seed: true,
            twice: 0.0,
            factors: Vec::new(),
            pair: Vec::new(),
            draws: vec![draw(distribution)],
            units: Vec::new(),
            columns: Vec::new(),
            points: Vec::new(),
            limits: Vec::new(),
            compare: Vec::new(),
        };
        rows(&spec, 1).into_iter().map(|row| row.values[1].1.clone()).collect::<Vec<_>>()
    };
    let numbers = |distribution| values(distribution).iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>();
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let sd = |x: &[f64]| (x.iter().map(|v| (v - mean(x)).powi(2)).sum::<f64>() / x.len() as f64).sqrt();
    // Each bound is four standard errors of 4000 draws.
    let uniform = numbers(Distribution::Uniform([-10.0, 10.0]));
    assert!(uniform.iter().all(|x| (-10.0..=10.0).contains(x)) && mean(&uniform).abs() < 0.37, "{}", mean(&uniform));
    assert!((sd(&uniform) - 5.7735).abs() < 0.2, "{}", sd(&uniform));
    let normal = numbers(Distribution::Normal([3.0, 2.0]));
    assert!(
        (mean(&normal) - 3.0).abs() < 0.13 && (sd(&normal) - 2.0).abs() < 0.09,
        "{} {}",
        mean(&normal),
        sd(&normal)
    );
    let log = numbers(Distribution::LogUniform([1.0, 100.0]));
    let below_ten = log.iter().filter(|x| **x < 10.0).count();
    assert!((below_ten as f64 - 2000.0).abs() < 127.0, "{below_ten}");
    let whole = numbers(Distribution::Integers([1, 4]));
    assert!((1..=4).all(|k| (whole.iter().filter(|x| **x == f64::from(k)).count() as f64 - 1000.0).abs() < 110.0));
    let choice = values(Distribution::Choice(vec![json!("a"), json!("b")]));
    assert!((choice.iter().filter(|v| *v == "a").count() as f64 - 2000.0).abs() < 127.0);
}

#[test]
fn every_fault_of_a_sweep_is_reported_at_its_line() {
    let sweep = r#"
[sweep]
repeat = 0
tile   = 3
units  = ["nois", "trial"]
pair   = [["noise", "short"]]
limit   = { las = 2.0, last = inf }
compare = [{ factor = "noise", to = 3 }, { factor = "noise" }, { factor = "noises" }, 4]
[sweep.factor]
noise = { key = "last.noise", values = [false, true] }
short = { key = "last.sleep_us", values = [1] }
twice = { key = "last.sleep_us", values = [1, 1] }
none  = { values = [1] }
range = { key = "last.sleep_us", from = 0.0, to = 1.0 }
run   = { key = "last.noise", values = [true] }
[sweep.draw]
d = { key = "last.sleep_us", uniform = [2.0, 1.0] }
e = { key = "last.sleep_us" }
turned = { key = "last.sleep_us", integers = [2, 1] }
wide = { key = "last.sleep_us", integers = [-9223372036854775808, 9223372036854775807] }
endless = { key = "last.sleep_us", uniform = [0.0, inf] }
[sweep.columns]
last = "values.last"
[sweep.points]
all = { axes = ["x"] }
"#;
    let message = Desk::new(&graph("sweep-faults", sweep)).faults();
    for expected in [
        "repeat takes a whole number of at least 1, found 0",
        "[sweep] has no key \"tile\"",
        "units \"nois\" and \"trial\" are no factors",
        "paired factors \"noise\", \"short\" have different numbers of values",
        "limit: there is no column \"las\"",
        "did you mean \"last\"?",
        "factor \"twice\" has the value 1 twice",
        "factor \"none\" does not say what it sets",
        "factor \"range\" does not say how many values",
        "a column of the sweep cannot be called \"run\"",
        "draw \"d\": uniform takes two numbers, the smaller first",
        "draw \"e\" needs one distribution",
        "draw \"turned\": integers takes two whole numbers, the smaller first",
        "draw \"wide\": integers takes two whole numbers, the smaller first",
        "draw \"endless\": uniform takes two numbers, the smaller first",
        "limit of \"last\" takes a number above zero",
        "points \"all\" does not say its list",
        "factor \"noise\" has no value 3 to compare with",
        "factor \"noise\" is compared twice",
        "compare needs the name of a factor",
        "compare takes a table, found 4",
    ] {
        assert!(message.contains(expected), "{expected}\n---\n{message}");
    }
    assert_eq!(
        message.matches("toy.toml:").count(),
        message.matches(" --> ").count() + message.matches("::: ").count(),
        "{message}"
    );
}

#[test]
fn a_fault_of_one_run_is_reported_with_its_settings() {
    let sweep = "[sweep.factor]\nwait = { key = \"last.sleep_us\", values = [1, \"long\"] }\n";
    let message = Desk::new(&graph("sweep-row", sweep)).faults();
    assert!(message.contains("in run 1 of the sweep: wait = \"long\", repeat = 0"), "{message}");
    let message = Desk::new(&graph("sweep-none", "")).faults();
    assert!(message.contains("has no table [sweep]"), "{message}");
}

#[test]
fn a_key_set_twice_is_refused() {
    let faults = |sweep: &str| Desk::new(&graph("sweep-clash", sweep)).faults();
    let message = faults(
        r#"
[sweep.factor]
noise = { key = "last.noise", values = [false, true] }
again = { values = [{ node.last = { noise = true, sleep_us = 1 } }, { last.sleep_us = 2 }] }
seeds = { key = "graph.seed", values = [1, 2] }
size  = { key = "sweep.repeat", values = [1, 2] }
[sweep.draw]
wait = { keys = ["last.sleep_us"], integers = [1, 9] }
more = { key = "last.sleep_us", integers = [1, 9] }
"#,
    );
    for expected in [
        "factor \"noise\" and factor \"again\" both set last.noise, of which a run has one value",
        "factor \"again\" and draw \"wait\" both set last.sleep_us",
        "factor \"again\" and draw \"more\" both set last.sleep_us",
        "draw \"wait\" and draw \"more\" both set last.sleep_us",
        "take last.noise out of one of them",
        "factor \"seeds\" cannot set graph.seed",
        "factor \"size\" cannot set sweep.repeat",
        "toy.toml:30:1",
    ] {
        assert!(message.contains(expected), "{expected}\n---\n{message}");
    }
    assert_eq!(message.matches("both set").count(), 4, "{message}");
}

#[test]
fn other_keys_of_one_node_and_paired_values_that_never_meet_are_accepted() {
    for sweep in [
        r#"
[sweep.factor]
noise = { values = [{ last.noise = true }, { last.noise = false, last.sleep_us = 1 }], labels = ["a", "b"] }
first = { key = "scan.calls[0].give[0][1]", values = [1.0, 2.0] }
[sweep.draw]
stamp = { key = "scan.calls[0].stamp_ns", integers = [1, 9] }
"#,
        r#"
[sweep]
pair = ["short", "long"]
[sweep.factor]
short = { values = [{ last.sleep_us = 1 }, { last.noise = true }], labels = ["a", "b"] }
long  = { values = [{ last.noise = true }, { last.sleep_us = 2 }], labels = ["a", "b"] }
"#,
        "[sweep]\nsame_seed = true\n[sweep.factor]\nseeds = { key = \"graph.seed\", values = [1, 2] }\n",
    ] {
        Desk::new(&graph("sweep-no-clash", sweep)).check();
    }
}

#[test]
fn a_setting_of_the_command_line_that_no_run_would_use_is_refused() {
    let sweep = r#"
[sweep.factor]
noise = { key = "last.noise", values = [false, true] }
some  = { values = [{ last.sleep_us = 1 }, { shared.takes = "draws" }], labels = ["waits", "as it is"] }
[sweep.draw]
stamp = { key = "scan.calls[0].stamp_ns", integers = [1, 9] }
"#;
    let desk = Desk::new(&graph("sweep-overridden", sweep));
    let message = desk.faults_with(&["graph.seed=3", "node.last={ noise = true }"]);
    for expected in [
        "last.noise is set by the factor \"noise\" of the sweep",
        "--set node.last={ noise = true }",
        "set sweep.factor.noise.values='[..]' instead",
    ] {
        assert!(message.contains(expected), "{expected}\n---\n{message}");
    }
    let message = desk.faults_with(&["scan.calls[0].stamp_ns=3"]);
    assert!(
        message.contains("scan.calls[0].stamp_ns is set by the draw \"stamp\"") && message.contains("sweep.draw.stamp")
    );
    let sets = ["last.sleep_us=7", "graph.seed=3", "sweep.factor.noise.values=[true]"].map(str::to_owned);
    let sweep = check(&desk.graph, &sets, &registry(), 1).unwrap();
    let waits: Vec<_> = sweep.runs.iter().map(|run| run.plan.resolved.contains("sleep_us = 7")).collect();
    assert_eq!(waits, [false, true], "the run of the value that leaves the key alone takes it");
}

#[test]
fn a_path_that_begins_with_no_result_suggests_the_nearest() {
    let sweep = r#"
[sweep.columns]
good    = "values.last"
whole   = "values"
always  = "notice"
swapped = "values.lsat.mean"
short   = "shared"
nothing = "quite.another.thing"
[sweep.points]
list = { from = "al.0" }
"#;
    let message = Desk::new(&graph("sweep-paths", sweep)).faults();
    for expected in [
        "column \"swapped\" asks for values.lsat.mean, which no run has",
        "did you mean \"values.last.mean\"?",
        "did you mean \"values.shared\"?",
        "column \"nothing\" asks for quite.another.thing",
        "points \"list\" asks for al.0",
        "did you mean \"all.0\"?",
        "its results: values.shared, values.last, all",
        "toy.toml:31:11",
    ] {
        assert!(message.contains(expected), "{expected}\n---\n{message}");
    }
    assert_eq!(message.matches("which no run has").count(), 4, "{message}");
}

#[test]
fn a_unit_that_is_nearly_a_factor_is_not_taken_for_the_repeats() {
    let sweep = |units| {
        format!(
            "[sweep]\nunits = {units}\n[sweep.factor]\nnoise = {{ key = \"last.noise\", values = [false, true] }}\n"
        )
    };
    let message = Desk::new(&graph("sweep-unit", &sweep("[\"nosie\"]"))).faults();
    assert!(
        message.contains("unit \"nosie\" is no factor") && message.contains("did you mean \"noise\"?"),
        "{message}"
    );
    for fine in ["[\"trial\"]", "[\"noise\", \"noises\"]"] {
        Desk::new(&graph("sweep-unit", &sweep(fine))).check();
    }
}

#[test]
fn a_part_of_a_sweep_lists_its_own_runs_and_its_folder_takes_the_others_too() {
    let desk = Desk::new(&graph("sweep-part", SIX));
    let sweep = desk.check();
    let shard = |index| Some(Shard { index, of: 3 });
    let part = |shard| SweepOptions { shard, ..options(1, true) };
    let mut all = Vec::new();
    for index in 1..=3 {
        let listed: Vec<_> = sweep.part(shard(index)).map(|row| row.run).collect();
        let dir = format!("part{index}");
        desk.sweep(&dir, &SweepOptions { shard: shard(index), ..options(1, true) });
        assert_eq!(Folder::open(&desk.path(&dir)).unwrap().runs().unwrap(), listed);
        all.extend(listed);
    }
    all.sort_unstable();
    assert_eq!(all, [0, 1, 2, 3, 4, 5]);
    // In the folder of a part, another part and the whole go on.
    for (options, n_before, n_run) in [(part(shard(1)), 2, 0), (part(shard(2)), 0, 2), (part(None), 4, 2)] {
        let folder = sweep.resume(&desk.path("part1"), &options).unwrap();
        let swept = sweep.run(&folder, &options, &()).unwrap();
        assert_eq!((swept.n_before, swept.n_run), (n_before, n_run), "{:?}", options.shard);
        folder.write_tables().unwrap();
    }
    let (_, runs, _) = desk.sweep("whole", &options(1, true));
    assert_eq!(fs::read_to_string(desk.path("part1").join(RUNS)).unwrap(), runs);
}

#[test]
fn columns_and_points_without_a_value_are_named() {
    let sweep = r#"
[sweep.columns]
last  = "values.last"
wrong = "values.last.mean"
[sweep.points]
all  = { from = "all", axes = ["x"] }
"#;
    let desk = Desk::new(&graph("sweep-empty", sweep));
    desk.sweep("out", &options(1, true));
    let folder = Folder::open(&desk.path("out")).unwrap();
    let (spec, runs) = (folder.spec().unwrap(), folder.done().unwrap().map(Result::unwrap).collect::<Vec<_>>());
    assert_eq!(without_value(&spec, &runs), [("wrong", "values.last.mean"), ("all", "all")]);
}
