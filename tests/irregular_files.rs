//! Pipes instead of files: a command that opened one would wait for a writer for ever.

use crate::common::{commands, osteoflow_to_spawn, root};
use std::{
    fs,
    io::Read as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

/// Longer than any of these commands takes on a busy machine.
const LIMIT: Duration = Duration::from_secs(60);

/// Exit code and messages of a command, which is killed if it does not end.
fn ended(arguments: &[String]) -> (Option<i32>, String) {
    let mut child = osteoflow_to_spawn()
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break Some(status),
            None if began.elapsed() > LIMIT => break None,
            None => std::thread::sleep(Duration::from_millis(10)),
        }
    };
    if status.is_none() {
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let mut err = String::new();
    child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
    (status.and_then(|status| status.code()), err)
}

fn pipe(path: &Path) -> String {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    path.display().to_string()
}

#[test]
fn a_pipe_in_the_place_of_any_file_is_refused_by_its_name_and_waited_for_by_no_command() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let text = |path: PathBuf| path.display().to_string();
    // By their endings, too.
    let pipes: Vec<String> =
        ["pipe", "pipe.toml", "pipe.mcap", "pipe.zip", "pipe.ply"].map(|name| pipe(&at(name))).into();
    let folder = at("folder");
    fs::create_dir(&folder).unwrap();
    for name in [
        "run.mcap",
        "results.json",
        "manifest.json",
        "layout.json",
        "sweep.toml",
        "sweep.json",
        "runs.csv",
        "summary.json",
        "repro.json",
        "experiment.json",
        "graph.toml",
        "metadata.yaml",
        "procedure.toml",
        "inputs.mcap",
        "a.dcm",
    ] {
        pipe(&folder.join(name));
    }
    let mut n = 0;
    for (command, n_files) in commands().into_iter().filter(|(_, n_files)| *n_files > 0) {
        for file in pipes.iter().chain([&text(folder.clone())]) {
            // The page of a graph shows its faults until the file is mended.
            if command == "view" && (file.ends_with(".toml") || *file == text(folder.clone())) {
                continue;
            }
            let mut arguments = vec![command.clone()];
            arguments.extend(std::iter::repeat_n(file.clone(), n_files));
            match command.as_str() {
                "record" => arguments.extend(["--wires=*".into(), format!("--out={}", text(at("out.mcap")))]),
                "recover" | "export" | "convert" => arguments.push(text(at("out.ply"))),
                "view" => arguments.push("--address=0".into()),
                "sensor" => arguments.push("--part=plane".into()),
                _ => {}
            }
            let (code, err) = ended(&arguments);
            let code = code.unwrap_or_else(|| panic!("{arguments:?} waits"));
            let is_named = err.contains("pipe") || *file == text(folder.clone());
            assert!((code != 0 && is_named) || command == "runs" || command == "info", "{arguments:?}: {code}, {err}");
            n += 1;
        }
    }
    assert!(n > 90, "{n} calls");
}

#[test]
fn a_pipe_behind_an_option_or_within_a_graph_is_refused_too() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = pipe(&dir.path().join("pipe.toml"));
    let graph = |name: &str, text: &str| {
        let path = dir.path().join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let extends = graph("extends.toml", "extends = \"pipe.toml\"\n");
    let module =
        graph("module.toml", "[graph]\nformat = 1\nname = \"a\"\n[node.m]\nkind = \"module\"\nfile = \"pipe.toml\"\n");
    let sweep = graph("sweep.toml", "extends = \"pipe.toml\"\n[sweep.factor]\nmethod = { variants = \"*.toml\" }\n");
    let shipped = |name: &str| root().join("graphs").join(name).display().to_string();
    let (fibula, recorded) = (shipped("fibula.toml"), shipped("fibula_recorded.toml"));
    let scan = graph("scan.xyz", "1 2 3\n4 5 6\n7 8 10\n1 4 9\n");
    let in_ = |option: &str| format!("{option}={pipe}");
    let cases: [&[&str]; 12] = [
        &["check", &extends],
        &["run", &module],
        &["sweep", &sweep],
        &["check", &fibula, "--set", &format!("extends={pipe}")],
        &["run", &recorded, "--set", &format!("recording.path={pipe}")],
        &["check", &fibula, &in_("--plugin")],
        &["register", &scan, &scan, &in_("--init")],
        &["register", &scan, &scan, &in_("--region")],
        &["register", &scan, &scan, "--landmarks", &pipe, &pipe],
        &["simulate", &in_("--bone"), "--out=never"],
        &["info", &scan, &in_("--columns")],
        &["info", &scan, &in_("--times")],
    ];
    for case in cases {
        let arguments: Vec<String> = case.iter().map(|argument| (*argument).to_owned()).collect();
        let (code, err) = ended(&arguments);
        let code = code.unwrap_or_else(|| panic!("{arguments:?} waits"));
        assert!(code != 0 && !err.is_empty(), "{arguments:?}: {code}, {err}");
    }
}
