//! Nodes in processes of their own: the same bits as in the program, and what goes wrong there stays there and is named.

use crate::common::{build, osteoflow, osteoflow_to_spawn, page::without_progress, root};
use serde_json::Value;
use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::mpsc::sync_channel,
    thread,
    time::{Duration, Instant},
};

/// Time after which a test that waits for a line fails.
const LIMIT: Duration = Duration::from_secs(60);

const GRAPH: &str = r#"
plugins = ["libdies.so"]

[graph]
format = 1

[node.recording]
kind = "acquire.simulated"

[node.dies]
kind = "dies.relay"
in   = { value = "recording.laser" }
how  = "not"

[record]
wires = ["dies.value"]

[results]
relayed   = { from = "dies.value", all = true }
simulated = "recording.simulated"
"#;

/// A folder with the graph above and its plugin; `None` where there is no C++ compiler.
struct Folder(tempfile::TempDir);

/// What a command left.
struct Left {
    code: Option<i32>,
    stderr: String,
    results: Value,
    dir: PathBuf,
}

impl Folder {
    fn new(more: &str) -> Option<Self> {
        let folder = Self(tempfile::tempdir().unwrap());
        let library = folder.path("libdies.so");
        build::compile(Path::new("tests/plugins/dies.cpp"), &library, &[]).then_some(())?;
        fs::write(folder.path("graph.toml"), format!("{GRAPH}{more}")).unwrap();
        Some(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, out: &str, arguments: &[&str]) -> Left {
        let dir = self.path(out);
        let output = osteoflow()
            .arg("run")
            .arg(self.path("graph.toml"))
            .arg("--out")
            .arg(&dir)
            .args(arguments)
            .output()
            .unwrap();
        let results = fs::read(dir.join("results.json")).unwrap_or_default();
        Left {
            code: output.status.code(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
            results: serde_json::from_slice(&results).unwrap_or(Value::Null),
            dir,
        }
    }
}

/// The digest of a run.
fn digest(dir: &Path) -> String {
    let output = osteoflow().args(["digest", "--format", "json"]).arg(dir.join("run.mcap")).output().unwrap();
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    answer["files"][0]["digest"].as_str().unwrap().to_owned()
}

#[test]
fn every_node_of_a_graph_apart_gives_the_same_bits() {
    let dir = tempfile::tempdir().unwrap();
    let graph = "graphs/variants/fibula_export.toml";
    let expanded = osteoflow().args(["expand", graph]).output().unwrap().stdout;
    let text = String::from_utf8(expanded).unwrap();
    let names: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("[node.")?.strip_suffix(']')).collect();
    assert!(names.len() > 25, "{names:?}");
    let run = |out: &str, sets: &[String]| {
        let mut command = osteoflow();
        command.args(["run", graph, "--no-cache", "--out"]).arg(dir.path().join(out));
        let output = command.args(sets).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let out = dir.path().join(out);
        (digest(&out), fs::read_to_string(out.join("results.json")).unwrap(), output.stderr)
    };
    let sets: Vec<String> =
        names.iter().flat_map(|name| ["--set".to_owned(), format!("{name}.process=true")]).collect();
    let (here, apart) = (run("here", &[]), run("apart", &sets));
    assert_eq!(here.0, apart.0);
    assert_eq!(here.1, apart.1);
    // What the runs say is the same, but for the folder, and for how far one is that takes long.
    let said = |bytes: &[u8]| without_progress(&String::from_utf8_lossy(bytes).replace("/apart", "/here"));
    assert_eq!(said(&here.2), said(&apart.2));
}

#[test]
fn a_process_that_dies_is_named_and_the_rest_of_the_run_is_whole() {
    let Some(folder) = Folder::new("") else { return };
    let whole = folder.run("whole", &["--set", "dies.process=true"]);
    assert_eq!((whole.code, whole.results["relayed"].as_array().unwrap().len()), (Some(0), 3), "{}", whole.stderr);
    assert_eq!(digest(&whole.dir), digest(&folder.run("here", &[]).dir), "the plugin in the program");
    for (how, expected) in [
        ("exit", "its process ended with exit code 0, without an answer"),
        ("abort", "its process ended by signal 6, SIGABRT (abort, or an exception that nothing caught)"),
        ("overflow", "its process ended by signal"),
        ("segv", "its process ended by signal 11, SIGSEGV (invalid memory, or its stack is full)"),
        ("write", "its process ended by signal 11, SIGSEGV (invalid memory, or its stack is full)"),
        ("throw", "its process ended by signal 6, SIGABRT (abort, or an exception that nothing caught)"),
    ] {
        let died = folder.run(how, &["--set", "dies.process=true", "--set", &format!("dies.how={how}")]);
        assert_eq!(died.code, Some(3), "{how}: {}", died.stderr);
        for text in ["node \"dies\", item 1: its process ended", expected, "libdies.so"] {
            assert!(died.stderr.contains(text), "{how}: {text}: {}", died.stderr);
        }
        assert_eq!(died.results["verdict"]["answer"], "refused", "{how}");
        assert_eq!((&died.results["refused"]["node"], &died.results["refused"]["item"]), (&"dies".into(), &1.into()));
        let saved = died.dir.join("repro/dies-1");
        assert!(saved.join("inputs.mcap").is_file(), "{how}: the input is saved");
        let again = osteoflow().arg("repro").arg(&saved).output().unwrap();
        let said = String::from_utf8_lossy(&[again.stdout, again.stderr].concat()).into_owned();
        assert!(said.contains(expected), "{how}: {said}");
        let validated = osteoflow().arg("validate").arg(&died.dir).output().unwrap();
        assert_eq!(validated.status.code(), Some(0), "{how}: {}", String::from_utf8_lossy(&validated.stdout));
    }
    let skipped = folder
        .run("skipped", &["--set", "dies.process=true", "--set", "dies.how=abort", "--set", "dies.on_error=skip"]);
    let warning = "warning: node \"dies\", item 1: its process ended by signal 6";
    assert!(skipped.code == Some(0) && skipped.stderr.contains(warning), "{}", skipped.stderr);
    let wires = osteoflow().args(["digest", "--format", "json"]).arg(&skipped.dir).output().unwrap();
    let wires = String::from_utf8(wires.stdout).unwrap();
    let digests: Value = serde_json::from_str(&wires).unwrap();
    let wire =
        digests["files"][0]["wires"].as_array().unwrap().iter().find(|wire| wire["wire"] == "dies.value").unwrap();
    assert_eq!((&wire["items"], &wire["values"]), (&3.into(), &2.into()), "a new process takes the third item: {wire}");
}

#[test]
fn a_process_that_does_not_answer_in_time_is_stopped() {
    let Some(folder) = Folder::new("") else { return };
    let began = Instant::now();
    let slow = folder.run("slow", &["--set", "dies.how=loop", "--set", "dies.stop_after_s=0.5"]);
    let expected = "node \"dies\", item 1: it did not answer within 0.5 s, and its process was stopped";
    assert!(slow.code == Some(3) && slow.stderr.contains(expected), "{}", slow.stderr);
    assert!(began.elapsed() < Duration::from_secs(60));
    let check = |sets: &[&str]| {
        let mut command = osteoflow();
        command.arg("check").arg(folder.path("graph.toml"));
        sets.iter().for_each(|set| {
            command.args(["--set", set]);
        });
        String::from_utf8(command.output().unwrap().stderr).unwrap()
    };
    let said = check(&["dies.process=false", "dies.stop_after_s=1"]);
    assert!(said.contains("stop_after_s ends a process of the node, but process is false"), "{said}");
    for wrong in ["0", "-1", "true", "1e9"] {
        let said = check(&[&format!("dies.stop_after_s={wrong}")]);
        assert!(said.contains("a number of seconds above 0 and at most 86400"), "{wrong}: {said}");
    }
}

#[test]
fn a_row_of_a_sweep_that_dies_is_a_row_with_its_reason_and_the_sweep_goes_past_it() {
    let factor =
        "\n[sweep.factor.how]\nkey = \"dies.how\"\nvalues = [\"not\", \"exit\", \"abort\", \"throw\", \"segv\"]\n";
    let Some(folder) = Folder::new(factor) else { return };
    let out = folder.path("sweep");
    let sweep = |more: &[&str]| {
        let mut command = osteoflow();
        let output = command.arg("sweep").arg(folder.path("graph.toml")).arg("--out").arg(&out).args(more).output();
        output.unwrap()
    };
    let first = sweep(&[]);
    let said = String::from_utf8_lossy(&first.stderr).into_owned();
    let rows = fs::read_to_string(out.join("runs.csv")).unwrap();
    assert_eq!(rows.lines().count(), 6, "{said}\n{rows}");
    for (how, reason) in [("exit", "exit code 0"), ("abort", "SIGABRT"), ("throw", "SIGABRT"), ("segv", "SIGSEGV")] {
        let row = rows.lines().find(|line| line.contains(&format!(",{how},"))).unwrap();
        assert!(row.contains("refused") && row.contains(reason), "{row}");
    }
    let again = sweep(&["--resume"]);
    let said = String::from_utf8_lossy(&[again.stdout, again.stderr].concat()).into_owned();
    assert_eq!(again.status.code(), first.status.code(), "{said}");
    assert_eq!(fs::read_to_string(out.join("runs.csv")).unwrap(), rows);
}

#[test]
fn a_watch_outlives_a_node_that_dies() {
    let Some(folder) = Folder::new("") else { return };
    let mut command: Command = osteoflow_to_spawn();
    command.arg("run").arg(folder.path("graph.toml")).args(["--watch", "--format", "json", "--out"]);
    let mut watch = command.arg(folder.path("watched")).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let (send, lines) = sync_channel(1000);
    let stdout = BufReader::new(watch.stdout.take().unwrap());
    thread::spawn(move || stdout.lines().map_while(Result::ok).try_for_each(|line| send.send(line)));
    let next = || -> Value { serde_json::from_str(&lines.recv_timeout(LIMIT).expect("the watch answers")).unwrap() };
    let save = |how: &str| {
        let text = GRAPH.replace("how  = \"not\"", &format!("how  = \"{how}\""));
        fs::write(folder.path("graph.toml"), text).unwrap();
    };
    let is_whole = |answer: &Value| answer["relayed"].as_array().is_some_and(|relayed| relayed.len() == 3);
    let first = next();
    assert!(is_whole(&first), "{first}");
    for (how, expected) in [("abort", "SIGABRT"), ("exit", "exit code 0"), ("overflow", "ended by signal")] {
        save(how);
        let died = next();
        assert!(died["refused"]["reason"].as_str().is_some_and(|reason| reason.contains(expected)), "{how}: {died}");
    }
    save("not");
    let last = next();
    assert!(is_whole(&last), "{last}");
    watch.kill().unwrap();
    watch.wait().unwrap();
}

#[test]
fn a_process_that_is_killed_between_two_items_is_named_at_the_next() {
    let late = "\n[node.late]\nkind = \"dies.relay\"\nin   = { value = \"recording.laser\" }\nhow  = \"late\"\nprocess = true\n";
    let Some(folder) = Folder::new(late) else { return };
    let sets = ["dies.in.value=late.value", "dies.how=killed", "dies.process=true"];
    let left = folder.run("out", &sets.map(|set| ["--set", set]).concat());
    assert_eq!(left.code, Some(3), "{}", left.stderr);
    let named = "node \"dies\", item 2: its process ended by signal 9, SIGKILL";
    assert!(left.stderr.contains(named), "{}", left.stderr);
    assert_eq!((&left.results["refused"]["node"], &left.results["refused"]["item"]), (&"dies".into(), &2.into()));
    assert!(left.dir.join("repro/dies-2").is_dir(), "the item is saved");
}

/// Ten times the limits of an idle machine (docs/project/performance.md): what exceeds them copies or waits, whatever the load.
#[test]
fn a_firing_apart_costs_at_most_ten_times_its_limit() {
    let limits = [Duration::from_millis(5), Duration::from_millis(1)];
    let mut least = [Duration::MAX; 2];
    for _ in 0..3 {
        let Some(cases) = crate::common::apart::measure(100) else { return };
        for (least, case) in least.iter_mut().zip(&cases) {
            assert!(case.here < case.apart, "{}: {:?} apart, {:?} here", case.name, case.apart, case.here);
            *least = case.more().min(*least);
        }
        if least.iter().zip(&limits).all(|(least, limit)| least < limit) {
            return;
        }
    }
    panic!("{least:?} more than in the program");
}

#[test]
fn the_worker_is_not_for_users() {
    let output = osteoflow_to_spawn().arg("worker").stdin(Stdio::null()).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("this command is run by others"), "{said}");
    assert!(root().join("docs/extend/processes.md").is_file());
}
