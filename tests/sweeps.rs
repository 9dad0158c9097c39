//! Sweeps from the command line: stopped and resumed, split and merged, compared, and on a user's bone.

use crate::common::{osteoflow, osteoflow_to_spawn, reproduce, root, shared_folder, skips_slow};
use serde_json::Value;
use std::{
    fs,
    path::Path,
    process::Stdio,
    sync::LazyLock,
    thread,
    time::{Duration, Instant},
};

/// The procedure with an exact CT surface, swept over two kinds of ICP.
const SMALL: &str = r#"extends = "GRAPH"
[graph]
name = "small"
[node.recording]
camera.n_points = 4000
[node.bone]
exact = true
[sweep]
repeat = 4
units  = ["bone", "procedure"]
[sweep.factor]
bone = { keys = ["recording.bone.shape_seed", "plan.bone.shape_seed", "bone.bone.shape_seed"], values = [1] }
icp  = { key = "icp.kind", values = ["icp.point_to_point", "icp.point_to_plane"] }
[sweep.columns]
tre_mm = "metrics.tre_true_mm.mean_abs.norm"
[sweep.points]
tre_mm = { from = "metrics.tre_true_mm.points" }
[sweep.limit]
tre_mm = 2.0
[sweep.compare]
factor = "icp"
margin = { tre_mm = 1.0 }
"#;

fn small(dir: &Path) -> String {
    let file = dir.join("small.toml");
    fs::write(&file, SMALL.replace("GRAPH", root().join("graphs/fibula.toml").to_str().unwrap())).unwrap();
    file.to_str().unwrap().to_owned()
}

/// The small sweep, made once for the tests that only read it.
struct Swept {
    graph: String,
    out: String,
    printed: String,
}

static SWEPT: LazyLock<Swept> = LazyLock::new(|| {
    let dir = tempfile::tempdir_in(shared_folder()).unwrap().keep();
    let (graph, out) = (small(&dir), path(&dir, "whole"));
    let (printed, err, code) = output(&["sweep", &graph, "--out", &out]);
    assert_eq!(code, 0, "{err}");
    Swept { graph, out, printed }
});

fn path(dir: &Path, name: &str) -> String {
    dir.join(name).to_str().unwrap().to_owned()
}

/// The stdout, stderr and exit code of a command.
fn output(args: &[&str]) -> (String, String, i32) {
    let output = osteoflow().args(args).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (text(&output.stdout), text(&output.stderr), output.status.code().unwrap())
}

fn json(path: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_sweep_that_is_killed_half_way_and_resumed_leaves_the_tables_of_one_that_was_not() {
    let dir = tempfile::tempdir().unwrap();
    let (cut, Swept { graph, out: whole, .. }) = (path(dir.path(), "cut"), &*SWEPT);
    let mut child = osteoflow_to_spawn()
        .args(["sweep", graph, "--out", &cut, "--workers", "1", "--quiet"])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let n_there = || {
        let entries = fs::read_dir(dir.path().join("cut/runs")).into_iter().flatten();
        entries.filter(|e| e.as_ref().unwrap().path().extension().is_some_and(|end| end == "json")).count()
    };
    let began = Instant::now();
    while n_there() < 3 && began.elapsed() < Duration::from_secs(120) {
        thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let n_left = n_there();
    assert!((3..8).contains(&n_left), "{n_left} runs were there when it was killed");
    let (_, err, code) = output(&["sweep", graph, "--out", &cut]);
    assert!(code == 2 && err.contains("--resume"), "{err}");
    let (out, err, code) = output(&["sweep", graph, "--out", &cut, "--resume", "--format", "json"]);
    assert_eq!(code, 0, "{err}");
    let answer: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(answer["runs"]["there_before"], n_left);
    for name in ["runs.csv", "points.csv", "summary.json"] {
        let read = |dir: &str| fs::read(Path::new(dir).join(name)).unwrap();
        assert!(read(whole) == read(&cut), "{name} differs");
    }
    let (_, err, code) = output(&["sweep", graph, "--set", "icp.max_iterations=7", "--out", &cut, "--resume"]);
    assert!(code == 2 && err.contains("another sweep"), "{err}");
}

#[test]
fn the_summary_counts_units_and_compares_in_pairs() {
    let Swept { out, printed: table, .. } = &*SWEPT;
    assert!(
        table.contains("SIMULATED") && table.contains("1 bone, 4 procedures") && table.contains("none: n = 1 bone"),
        "{table}"
    );
    let summary = json(&path(Path::new(out), "summary.json"));
    let column = &summary["groups"][0]["columns"]["tre_mm"];
    assert!(column["mean_interval"]["no_interval"].as_str().unwrap().contains("n = 1 bone"), "{column}");
    let comparison = &summary["comparisons"][0];
    assert_eq!((&comparison["n"], &comparison["unit"]), (&4.into(), &"procedure".into()));
    assert!(comparison["tost"]["equivalent"].is_boolean() && comparison["p_holm"].is_number(), "{comparison}");
    let points = &summary["groups"][1]["points"]["tre_mm"]["z"];
    assert_eq!(points["n"], 20);
    assert!(points["within_points"]["sd_within"].is_number() && points["within_procedures"]["sd_within"].is_number());
    let rows = fs::read_to_string(path(Path::new(out), "runs.csv")).unwrap();
    assert_eq!(rows.lines().next().unwrap(), "run,bone,icp,procedure,seed,status,verdict,tre_mm,reason");
    assert_eq!(rows.lines().count(), 9);
    let points = fs::read_to_string(path(Path::new(out), "points.csv")).unwrap();
    assert_eq!(points.lines().next().unwrap(), "run,bone,icp,procedure,seed,measure,point,axis,value_mm");
}

#[test]
fn two_sweeps_are_compared_in_pairs_within_a_margin_and_missing_runs_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    const NOISY: &str = "recording.camera.depth_noise_mm=0.2";
    let (noisy, Swept { graph, out: exact, .. }) = (path(dir.path(), "noisy"), &*SWEPT);
    assert_eq!(output(&["sweep", graph, "--out", &noisy, "--quiet", "--set", NOISY]).2, 0);
    let compared = |margin: &str| output(&["compare", exact, &noisy, "--margin", margin]);
    let (answer, err, code) = compared("tre_mm=5");
    assert!(code == 0 && err.is_empty(), "{err}");
    assert!(
        answer.contains(&format!("[2] {noisy}"))
            && answer.contains("    tre_mm at icp = icp.point_to_plane  4 procedures"),
        "{answer}"
    );
    assert_eq!(answer.matches(" within 5").count(), 2, "{answer}");
    let (answer, ..) = compared("tre_mm=0.000001");
    assert_eq!(answer.matches("not shown within 1.00e-6").count(), 2, "{answer}");
    let (_, err, code) = compared("tre=5");
    assert!(code == 2 && err.contains("no column tre; it has tre_mm"), "{err}");
    let (_, err, code) = compared("tre_mm=-1");
    assert!(code == 2 && err.contains("above zero"), "{err}");

    let run = |n: usize| path(Path::new(&noisy), &format!("runs/{n:06}.json"));
    fs::remove_file(run(0)).unwrap();
    let mut refused = json(&run(7));
    (refused["status"], refused["results"]) = ("refused".into(), Value::Null);
    fs::write(run(7), refused.to_string()).unwrap();
    let (answer, err, code) = compared("tre_mm=5");
    assert!(code == 0 && err.contains(&format!("{noisy} is not finished: it has 7 of 8 runs")), "{err}");
    assert!(answer.contains("1 of 4 pairs left out, with a run that has no value"), "{answer}");
}

#[test]
fn a_sweep_without_any_result_is_refused_and_one_without_a_value_in_a_column_warns() {
    let dir = tempfile::tempdir().unwrap();
    let (graph, out) = (small(dir.path()), path(dir.path(), "out"));
    let one = ["--set", "sweep.repeat=1", "--set", "sweep.columns.tre_mm=metrics.tre_true_mm.mean_abs.nrm"];
    let (_, err, code) = output(&[&["sweep", &graph, "--out", &out], &one[..]].concat());
    assert!(code == 0 && err.contains("tre_mm has no value in any run") && err.contains("mean_abs.nrm"), "{err}");
    let (out, far) = (path(dir.path(), "none"), ["--set", "icp.max_pair_distance_mm=0.000001"]);
    let (answer, err, code) = output(&[&["sweep", &graph, "--out", &out, "--quiet"], &one[..2], &far[..]].concat());
    assert_eq!(code, 3, "{answer}{err}");
    assert!(
        err.contains("none of 2 runs has results; run 0: ") && answer.contains("2 of 2 runs have no results"),
        "{err}"
    );
    assert!(fs::read_to_string(path(Path::new(&out), "runs.csv")).unwrap().contains("refused"));
    let (_, err, code) = output(&["sweep", &graph, "--set", "icp.kind=icp.symmetric"]);
    assert!(code == 2 && err.contains("icp.kind is set by the factor \"icp\""), "{err}");
    let (listed, _, code) = output(&["sweep", &graph, "--shard", "2/3", "--dry-run"]);
    assert!(code == 0 && listed.lines().count() == 3, "{listed}");
}

#[test]
fn the_report_of_a_sweep_tells_a_refusal_once_with_the_runs_that_it_stopped() {
    let dir = tempfile::tempdir().unwrap();
    let (graph, out) = (small(dir.path()), path(dir.path(), "out"));
    // No point pairs within a millionth of a millimetre: two runs of four are refused, by the same words.
    let reach = "sweep.factor.reach={key=\"icp.max_pair_distance_mm\",values=[5.0,0.000001]}";
    let sets = ["--set", "sweep.repeat=1", "--set", reach, "--set", "remove=[\"sweep.compare\"]", "--quiet"];
    let (_, err, code) = output(&[&["sweep", &graph, "--out", &out], &sets[..]].concat());
    assert!(code == 0, "{err}");
    let (_, err, code) = output(&["report", &out]);
    assert!(code == 0, "{err}");
    let page = fs::read_to_string(path(Path::new(&out), "report.html")).unwrap().replace("<wbr>", "");
    let reasons: Vec<&str> = page.split("points lie within").skip(1).collect();
    assert_eq!(reasons.len(), 1, "{reasons:#?}");
    assert!(page.contains("2 without results (run "), "the runs are named beside it");
}

#[test]
fn a_sweep_without_columns_says_so_instead_of_empty_statistics() {
    let dir = tempfile::tempdir().unwrap();
    let (graph, out) = (small(dir.path()), path(dir.path(), "out"));
    let removed = "remove=[\"sweep.columns\",\"sweep.points\",\"sweep.limit\",\"sweep.compare\"]";
    let (answer, err, code) = output(&["sweep", &graph, "--out", &out, "--set", "sweep.repeat=1", "--set", removed]);
    assert!(code == 0 && answer.contains("[sweep.columns]") && !answer.contains("statistics"), "{answer}{err}");
}

#[test]
fn a_table_has_one_number_of_runs_and_those_of_units_have_their_names() {
    let (answer, err, code) = output(&["sweep", &SWEPT.graph, "--out", &SWEPT.out, "--resume", "--verbose"]);
    assert_eq!(code, 0, "{err}");
    let head = answer.lines().find(|line| line.contains("95 % interval")).unwrap();
    let words: Vec<&str> = head.split_whitespace().collect();
    assert!(!words.contains(&"n") && words.contains(&"procedures"), "{head}");
}

#[test]
fn a_factor_over_files_does_not_need_the_file_of_the_graph() {
    let dir = tempfile::tempdir().unwrap();
    let bone = root().join("tests/data/procedure/bone.stl");
    fs::copy(&bone, dir.path().join("b.stl")).unwrap();
    let text = format!(
        "extends = \"{}\"\n[graph]\nname = \"files\"\n[node.bone]\npath = \"to be set.stl\"\n[sweep]\n\
         [sweep.factor]\nbone = {{ key = \"bone.path\", values = [\"{}\", \"b.stl\"] }}\n\
         [sweep.columns]\nrms_mm = \"icp.rms_mm\"\n",
        root().join("graphs/fibula_recorded.toml").display(),
        bone.display()
    );
    let file = path(dir.path(), "files.toml");
    fs::write(&file, &text).unwrap();
    let out = path(dir.path(), "out");
    let (_, stderr, code) = output(&["sweep", &file, "--out", &out]);
    assert_eq!(code, 0, "{stderr}");
    let summary = json(&format!("{out}/summary.json"));
    assert_eq!((&summary["n_runs"], &summary["notes"]), (&2.into(), &serde_json::json!([])), "{summary}");
    // A file that a run does read must be there.
    fs::write(&file, text.replace("\"b.stl\"", "\"gone.stl\"")).unwrap();
    let (_, stderr, code) = output(&["sweep", &file, "--out", &path(dir.path(), "again")]);
    assert!(code == 2 && stderr.contains("there is no file ") && stderr.contains("gone.stl"), "{stderr}");
}

#[test]
fn two_runs_are_compared_number_by_number() {
    let dir = tempfile::tempdir().unwrap();
    let graph = root().join("graphs/fibula.toml");
    let run = |name: &str, kind: &str| {
        let out = path(dir.path(), name);
        let sets = ["--set", "bone.exact=true", "--set", kind];
        let code =
            output(&[&["run", graph.to_str().unwrap(), "--out", &out, "--quiet", "--no-record"], &sets[..]].concat()).2;
        assert_eq!(code, 0);
        out
    };
    let (a, b) = (run("a", "icp.kind=icp.point_to_point"), run("b", "icp.kind=icp.point_to_plane"));
    let (answer, _, code) = output(&["compare", &a, &b]);
    assert!(code == 0 && answer.contains("TRE, true, mean mm") && !answer.contains("points.M1"), "{answer}");
    let (answer, _, code) = output(&["compare", "-v", &a, &b]);
    assert!(code == 0 && answer.contains("metrics.tre_true_mm.points.M1.x"), "{answer}");
    assert!(!answer.contains("metrics.tre_true_mm.n "), "equal numbers are left out:\n{answer}");
    let (answer, ..) = output(&["compare", &a, &a]);
    assert!(answer.contains("are equal"), "{answer}");
    let (_, err, code) = output(&["compare", &a, dir.path().to_str().unwrap()]);
    assert!(code == 1 && err.contains("results.json"), "{err}");
}

#[test]
fn the_experiments_run_on_a_users_bone_and_the_page_has_their_n() {
    if skips_slow("the_experiments_run_on_a_users_bone_and_the_page_has_their_n") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let own = path(dir.path(), "own");
    assert_eq!(output(&["simulate", "--points", "1000", "--seed", "3", "--out", &own, "--quiet"]).2, 0);
    let (bone, plan, out) =
        (path(Path::new(&own), "bone.stl"), path(Path::new(&own), "plan.json"), path(dir.path(), "out"));
    let sets = ["--set", "sweep.repeat=2"];
    let own = ["--only", "accuracy_camera", "--bone", &bone, "--plan", &plan];
    let name = "the_experiments_run_on_a_users_bone_and_the_page_has_their_n";
    let args = [&["--quiet", "--out", &out], &own[..], &sets[..]].concat();
    let Some((answer, err, code)) = reproduce(name, &args) else { return };
    assert_eq!(code, 0, "{answer}{err}");
    let page = fs::read_to_string(path(Path::new(&out), "paper-reproduction.md")).unwrap();
    assert!(page.contains("1 bone, 2 procedures") && page.contains("SIMULATED") && !page.contains('{'), "{page}");
    assert!(page.contains("\nWritten by `graphs/paper/reproduce.py --bone "), "{page}");
    let rows = fs::read_to_string(path(Path::new(&out), "accuracy_camera/runs.csv")).unwrap();
    assert!(rows.lines().nth(1).unwrap().starts_with("0,bone,0,1,complete,"), "{rows}");
    let again =
        format!("graphs/paper/reproduce.py --bone {bone} --plan {plan} --only accuracy_camera --set sweep.repeat=2");
    let row = page.lines().find(|line| line.contains("registered by camera") && line.contains("axis x")).unwrap();
    assert!(row.contains("axis x; y; z, mm | 0.5 ± 0.1; 0.4 ± 0.04; 0.9 ± 0.1 | "), "{row}");
    assert!(page.contains(&format!("| accuracy_camera | `{again}` | 2 | 0 |")), "{again}: {page}");
    assert_eq!(page.matches("A run without results").count(), 0, "none was refused:\n{page}");
}
