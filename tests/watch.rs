//! `run --watch`: a save runs the graph from the first changed node, and nothing upstream of it.

use crate::common::{json, osteoflow_to_spawn, root, run};
use serde_json::Value;
use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, sync_channel},
    thread,
    time::Duration,
};

/// Maximum time to wait for a line, so that a failing test does not hang.
const LIMIT: Duration = Duration::from_secs(120);

/// A watch of `graph.toml` in a folder of its own.
struct Watch {
    dir: tempfile::TempDir,
    child: Child,
    lines: Receiver<String>,
}

impl Watch {
    /// Watches a graph with this text, with JSON output.
    fn begin(text: &str, arguments: &[&str]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("graph.toml"), text).unwrap();
        Self::begin_in(dir, &[&["--format", "json"], arguments].concat())
    }

    fn begin_in(dir: tempfile::TempDir, arguments: &[&str]) -> Self {
        let mut child = osteoflow_to_spawn()
            .current_dir(dir.path())
            .args(["run", "--watch", "graph.toml", "--out", "out"])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (tell, lines) = sync_channel(1000);
        let stdout = BufReader::new(child.stdout.take().unwrap());
        thread::spawn(move || stdout.lines().map_while(Result::ok).try_for_each(|line| tell.send(line)));
        Self { dir, child, lines }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn line(&self) -> String {
        self.lines.recv_timeout(LIMIT).expect("the watch answers")
    }

    /// The output of the next run.
    fn next(&self) -> Value {
        serde_json::from_str(&self.line()).unwrap()
    }

    /// Saves the file as many editors do: by replacing it with a new one.
    fn save(&self, name: &str, text: &str) {
        fs::write(self.path("new"), text).unwrap();
        fs::rename(self.path("new"), self.path(name)).unwrap();
    }

    /// Waits for the end and returns the exit code and stderr.
    fn end(mut self) -> (Option<i32>, String) {
        let code = self.child.wait().unwrap().code();
        let mut printed = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut printed).unwrap();
        (code, printed)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The shipped recorded procedure, with further keys.
fn recorded(more: &str) -> String {
    format!("extends = {:?}\n{more}", root().join("graphs/fibula_recorded.toml"))
}

fn list(of: &Value) -> Vec<&str> {
    of.as_array().unwrap_or_else(|| panic!("no list: {of}")).iter().map(|name| name.as_str().unwrap()).collect()
}

/// The ICP and everything downstream.
const FROM_ICP: [&str; 9] =
    ["icp", "planes_at_scan", "planes", "planes_last", "tre_measured", "fre", "surface", "verdict", "export"];

/// Asserts that a run of the whole graph writes the same results, bit for bit.
fn assert_as_whole(graph: &Path, rerun: &Path) {
    let whole = run(graph.to_str().unwrap(), &["--no-record"]);
    assert_eq!(whole.code, 0, "{}", whole.stderr);
    let text = |dir: &Path| fs::read_to_string(dir.join("results.json")).unwrap();
    assert_eq!(text(rerun), text(whole.dir.path()));
}

#[test]
fn a_saved_swap_of_the_icp_is_run_from_there_on_and_leaves_what_a_run_of_the_whole_leaves() {
    let watch = Watch::begin(&recorded("[node.icp]\nkind = \"icp.point_to_plane\"\n"), &[]);
    let first = watch.next();
    assert_eq!(list(&first["outcome"]["watch"]["kept"]), [""; 0], "{first}");
    assert!(watch.path("out/run.mcap").exists());
    let swaps = [
        ("kind = \"icp.symmetric\"", "icp: kind icp.point_to_plane -> icp.symmetric"),
        ("kind = \"icp.symmetric\"\nmax_pair_distance_mm = 0.1", "icp: max_pair_distance_mm 5.0 -> 0.1"),
        ("kind = \"icp.point_to_plane\"\nmax_pair_distance_mm = 0.1", "icp: kind icp.symmetric -> icp.point_to_plane"),
    ];
    for (n, (icp, change)) in swaps.into_iter().enumerate() {
        watch.save("graph.toml", &recorded(&format!("[node.icp]\n{icp}\n")));
        let answer = watch.next();
        let about = &answer["outcome"]["watch"];
        assert_eq!(list(&about["changes"]), [change]);
        assert_eq!(list(&about["computed"]), FROM_ICP);
        assert!(list(&about["differ"]).contains(&"icp") && !list(&about["differ"]).contains(&"holes"), "{about}");
        let dir = watch.path(&format!("out-{}", n + 2));
        assert_eq!(answer["outcome"]["out_dir"], format!("out-{}", n + 2));
        assert_as_whole(&watch.path("graph.toml"), &dir);
        let manifest = json(&dir.join("manifest.json"));
        assert_eq!(list(&manifest["watch"]["computed"]), FROM_ICP);
        assert!(list(&manifest["watch"]["kept"]).contains(&"hole"));
        assert!(!dir.join("run.mcap").exists(), "a part is no recording of a run");
    }
}

#[test]
fn a_file_that_is_extended_or_named_by_a_parameter_is_watched_as_well() {
    let dir = tempfile::tempdir().unwrap();
    let plan = root().join("tests/data/procedure/plan.json");
    fs::copy(&plan, dir.path().join("plan.json")).unwrap();
    fs::write(dir.path().join("base.toml"), recorded("[node.plan]\npath = \"plan.json\"\n")).unwrap();
    fs::write(dir.path().join("graph.toml"), "extends = \"base.toml\"\n").unwrap();
    let watch = Watch::begin_in(dir, &["--format", "json"]);
    watch.next();

    watch.save("base.toml", &recorded("[node.plan]\npath = \"plan.json\"\n[node.coarse]\non_error = \"skip\"\n"));
    let answer = watch.next();
    assert_eq!(list(&answer["outcome"]["watch"]["changes"]), ["coarse: on_error"]);
    assert_eq!(answer["outcome"]["watch"]["differ"], serde_json::json!([]));

    let mut moved = json(&plan);
    moved["lateral"][0] = 0.5.into();
    watch.save("plan.json", &moved.to_string());
    let answer = watch.next();
    let changes = list(&answer["outcome"]["watch"]["changes"]);
    assert!(matches!(&changes[..], [change] if change.starts_with("plan: ") && change.ends_with(" has changed")));
    assert!(list(&answer["outcome"]["watch"]["kept"]).contains(&"ct_surface"));
    assert_as_whole(&watch.path("graph.toml"), &watch.path("out-3"));
}

#[test]
fn a_fault_is_printed_as_by_check_and_the_watch_continues() {
    let watch = Watch::begin(&recorded(""), &["--no-record"]);
    watch.next();
    watch.save("graph.toml", &recorded("[node.icp]\nmax_iteration = 3\n"));
    let answer = watch.next();
    assert_eq!(answer["outcome"]["exit_code"], 2);
    assert!(answer["faults"][0].to_string().contains("max_iteration"), "{answer}");

    watch.save("graph.toml", &recorded("# as it was\n"));
    let answer = watch.next();
    assert_eq!(answer["outcome"]["watch"]["computed"], serde_json::json!([]), "{answer}");
    assert!(answer.get("icp").is_none() && !watch.path("out-2").exists(), "nothing was run");

    watch.save("graph.toml", &recorded("[node.icp]\nmax_iterations = 3\n"));
    assert_eq!(list(&watch.next()["outcome"]["watch"]["computed"]), FROM_ICP);
    assert_as_whole(&watch.path("graph.toml"), &watch.path("out-2"));
}

#[test]
fn nodes_that_write_files_write_them_into_the_folder_of_each_rerun() {
    let csv = "[node.spots]\nkind = \"output.csv\"\nin = { points = \"laser_points.points\" }\n";
    let watch = Watch::begin(&recorded(csv), &["--no-record"]);
    watch.next();
    watch.save("graph.toml", &recorded(&format!("{csv}[node.icp]\nmax_iterations = 3\n")));
    let answer = watch.next();
    assert!(list(&answer["outcome"]["watch"]["computed"]).contains(&"spots"), "{answer}");
    let text = |dir: &str| fs::read_to_string(watch.path(dir).join("spots.csv")).unwrap();
    assert_eq!(text("out-2"), text("out"));
}

#[test]
fn the_text_output_shows_changes_and_previous_values() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("graph.toml"), recorded("")).unwrap();
    let watch = Watch::begin_in(dir, &["--no-record"]);
    let until = |word: &str| std::iter::repeat_with(|| watch.line()).take_while(|line| !line.contains(word)).collect();
    let first: Vec<String> = until("after the change was seen");
    assert!(first.iter().all(|line| !line.trim_start().starts_with("was ")), "{first:#?}");
    watch.save("graph.toml", &recorded("[node.icp]\nmax_iterations = 3\n"));
    let second: Vec<String> = until("after the change was seen");
    let icp = second.iter().position(|line| line.starts_with("icp ")).unwrap();
    assert!(second[icp + 1].starts_with("  ") && second[icp + 2].starts_with("    was "), "{second:#?}");
    assert!(second.iter().any(|line| line.starts_with("changed since the previous run: ") && line.contains("icp")));
}

#[test]
#[cfg(unix)]
fn ctrl_c_between_two_runs_ends_the_watch_as_done() {
    let watch = Watch::begin(&recorded(""), &["--no-record"]);
    watch.next();
    let signalled = Command::new("kill").args(["-INT", &watch.child.id().to_string()]).status().unwrap();
    assert!(signalled.success());
    let (code, printed) = watch.end();
    assert_eq!(code, Some(0), "{printed}");
}

#[test]
fn a_graph_that_cannot_be_watched_is_refused_before_anything_runs() {
    let live = format!("extends = {:?}\n", root().join("graphs/variants/fibula_live.toml"));
    let (code, printed) = Watch::begin(&live, &[]).end();
    assert!(code == Some(2) && printed.contains("node \"recording\" is a live source"), "{printed}");

    let folder = root().join("graphs/fibula_folder.toml");
    let reads_its_own = format!("extends = {folder:?}\n[node.recording]\npath = \".\"\n");
    let (code, printed) = Watch::begin(&reads_its_own, &[]).end();
    assert!(code == Some(2) && printed.contains("each run would start the next"), "{printed}");

    let dir = tempfile::tempdir().unwrap();
    let (code, printed) = Watch::begin_in(dir, &[]).end();
    assert!(code == Some(2) && printed.contains("there is no graph file graph.toml"), "{printed}");
}
