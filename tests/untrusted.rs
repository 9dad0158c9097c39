//! Files of strangers: what they make a command load, print, write or unpack.

use crate::common::{TOY_GRAPH, build, commands, json, osteoflow_to_spawn, root};
use osteoflow_container::{Compression, MessageHeader, WriteOptions, Writer};
use std::{
    collections::BTreeMap,
    env::consts::DLL_SUFFIX,
    fs::{self, File},
    path::{Path, PathBuf},
    process::Command,
};

/// A library that creates a file as soon as it is loaded.
const MARKER: &str = r#"
#include <stdio.h>
#include <stdlib.h>
__attribute__((constructor)) static void osteoflow_test_loaded(void) {
    const char *path = getenv("OSTEOFLOW_TEST_MARKER");
    FILE *file = path ? fopen(path, "w") : NULL;
    if (file) fclose(file);
}
"#;

/// A folder, and commands in it.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = osteoflow_to_spawn();
        command.current_dir(self.0.path()).args(arguments).env_remove("OSTEOFLOW_PLUGIN_PATH");
        command.env("OSTEOFLOW_TEST_MARKER", self.path("marker"));
        command
    }

    /// Exit code, stdout and stderr.
    fn says(&self, arguments: &[&str]) -> (i32, String, String) {
        let output = self.command(arguments).output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
        (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
    }

    /// Whether the command has loaded the library, and what it says.
    fn loads(&self, arguments: &[&str]) -> (bool, (i32, String, String)) {
        let _ = fs::remove_file(self.path("marker"));
        let said = self.says(arguments);
        (self.path("marker").exists(), said)
    }

    /// A plugin that leaves a mark when it is loaded; `false` if there is no compiler.
    fn plugin(&self, add: &str) -> bool {
        fs::write(self.path("marker.h"), MARKER).unwrap();
        let header = self.path("marker.h").display().to_string();
        let made = self.path("made");
        let arguments = ["-D_POSIX_C_SOURCE=200809L", "-include", &header, &format!("-DADD={add}")];
        build::compile(Path::new("tests/plugins/toy.c"), &made, &arguments)
            && fs::rename(made, self.path(&format!("libtoy{DLL_SUFFIX}"))).is_ok()
    }
}

#[test]
fn commands_that_read_load_no_library_and_those_that_check_a_graph_do_unless_told_not_to() {
    let folder = Folder::new();
    fs::write(folder.path("graph.toml"), format!("plugins = [\"toy\"]\n{TOY_GRAPH}")).unwrap();
    if !folder.plugin("1") {
        return;
    }
    let library = folder.path(&format!("libtoy{DLL_SUFFIX}")).display().to_string();
    let (loaded, (code, _, err)) = folder.loads(&["run", "graph.toml", "--out", "out"]);
    assert!(loaded && code == 0, "{err}");

    // These name the library and load it.
    for command in [&["check", "graph.toml"][..], &["expand", "graph.toml"], &["graph", "graph.toml"]] {
        let (loaded, (code, _, err)) = folder.loads(command);
        assert!(loaded && code == 0, "{command:?}: {err}");
        let (loaded, (code, _, err)) = folder.loads(&[command, &["--no-plugins"]].concat());
        assert!(!loaded && code == 2 && err.contains("no plugins are loaded here"), "{command:?}: {err}");
    }
    // These never do.
    let recording = "out/run.mcap";
    for (command, expected) in [
        (&["validate", recording][..], 0),
        (&["digest", recording], 0),
        (&["diff", recording, recording], 0),
        (&["recover", recording, "saved.mcap"], 0),
        (&["report", "out"], 0),
        (&["info", recording], 0),
    ] {
        let (loaded, (code, out, err)) = folder.loads(command);
        assert!(!loaded && code == expected, "{command:?}: {out}{err}");
    }
    // A recording names the library: it is loaded if it is the recorded one.
    let (loaded, (code, _, err)) = folder.loads(&["replay", recording]);
    assert!(loaded && code == 0, "{err}");
    let (loaded, (code, _, err)) = folder.loads(&["replay", recording, "--no-plugins"]);
    assert!(!loaded && code == 2, "{err}");
    // Another library at its place is not, unless the user names it.
    folder.plugin("2");
    let (loaded, (code, _, err)) = folder.loads(&["replay", recording]);
    assert!(!loaded && code == 2, "{err}");
    assert!(err.contains("its SHA-256 is") && err.contains("--plugin"), "{err}");
    let (loaded, (code, _, err)) = folder.loads(&["replay", recording, "--plugin", &library]);
    assert!(loaded && code == 4, "{err}");
}

/// The commands of each row of the page's table of what runs code, by their first words.
fn rows_of_what_runs_code() -> Vec<Vec<String>> {
    let page = fs::read_to_string(root().join("docs/use/security.md")).unwrap();
    let table = page.split("| Command | Loads code that a file names |\n|---|---|\n").nth(1).unwrap();
    let heads = table.lines().map_while(|line| line.strip_prefix("| ")?.split(" | ").next());
    let command = |words: &str| words.split(' ').next().unwrap_or_default().to_owned();
    heads.map(|head| head.split('`').skip(1).step_by(2).map(command).collect()).collect()
}

#[test]
fn each_command_has_a_row_in_the_table_of_what_runs_code_and_loads_none_that_it_denies() {
    let folder = Folder::new();
    let sweep = "[sweep]\nrepeat = 2\n";
    fs::write(folder.path("graph.toml"), format!("plugins = [\"toy\"]\n{TOY_GRAPH}{sweep}")).unwrap();
    if !folder.plugin("1") {
        return;
    }
    let made = [
        &["run", "graph.toml", "--out", "run"][..],
        &["sweep", "graph.toml", "--out", "sweep"],
        &["export", "sweep", "sweep.zip"],
    ];
    for arguments in made {
        let (code, out, err) = folder.says(arguments);
        assert_eq!(code, 0, "{arguments:?}: {out}{err}");
    }
    let files = ["graph.toml", "run/run.mcap", "run", "sweep", "sweep.zip"];
    let rows = rows_of_what_runs_code();
    let mut n_tried = 0;
    for (name, n_places) in commands() {
        let is_in = |row: &Vec<String>| row.contains(&name);
        assert!(
            rows.iter().any(is_in),
            "{name} has no row in docs/use/security.md: does it load code that a file names?"
        );
        let never = rows[0].contains(&name) && !rows[1..].iter().any(is_in);
        // Its page stays up.
        for (k, file) in files.iter().enumerate().take(if name == "view" { 0 } else { files.len() }) {
            let others = (1..n_places).map(|at| match &*name {
                "diff" | "compare" | "register" => (*file).to_owned(),
                _ => format!("{name}-{k}-{at}.txt"),
            });
            let mut arguments: Vec<String> = [name.clone()].into_iter().collect();
            arguments.extend((n_places > 0).then(|| (*file).to_owned()));
            arguments.extend(others);
            arguments.extend((!never).then(|| "--no-plugins".to_owned()));
            let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
            let (loaded, (code, out, err)) = folder.loads(&arguments);
            assert!(!loaded, "{arguments:?}, {code}: {out}{err}");
            n_tried += 1;
        }
    }
    assert!(n_tried > 100, "{n_tried}");
}

#[test]
fn names_from_files_reach_the_terminal_without_control_sequences() {
    let folder = Folder::new();
    let escape = "\\u001b]0;title\\u0007\\u001b[2J\\u001b[8m";
    let graph = format!(
        "[graph]\nformat = 1\nname = \"x{escape}\"\n[node.a]\nkind = \"no{escape}.kind\"\n[node.\"b{escape}\"]\nkind = \"c\"\n"
    );
    fs::write(folder.path("graph.toml"), graph).unwrap();
    let forged = serde_json::json!({ "format": 2, "hash": "\u{1b}[2J", "n_runs": 1, "shard": "\u{1b}[2J" });
    fs::create_dir_all(folder.path("sweep/runs")).unwrap();
    fs::write(folder.path("sweep/sweep.json"), forged.to_string()).unwrap();
    fs::write(folder.path("x\u{1b}[2J.mcap"), "no recording").unwrap();
    for color in ["always", "never"] {
        for command in [
            &["check", "graph.toml"][..],
            &["run", "graph.toml"],
            &["report", "sweep"],
            &["validate", "x\u{1b}[2J.mcap"],
            &["info", "x\u{1b}[2J.mcap"],
        ] {
            let (_, out, err) = folder.says(&[command, &["--color", color]].concat());
            let said = format!("{out}{err}");
            assert!(!said.is_empty(), "{command:?}");
            let controls: String = said.replace("\x1b[", "").chars().filter(|c| c.is_control() && *c != '\n').collect();
            assert_eq!(controls, "", "{command:?}: {said:?}");
            for sequence in ["\x1b[2J", "\x1b[8m", "\x1b]0"] {
                assert!(!said.contains(sequence), "{command:?}: {said:?}");
            }
        }
    }
    let (_, _, err) = folder.says(&["check", "graph.toml"]);
    assert!(err.contains("\\u{1b}"), "the name is shown with its escapes: {err}");
}

/// A recording of many messages without content, which pack to a thousandth of their size.
fn bomb(path: &Path, topic: &str, n_messages: u32) -> u64 {
    let options =
        WriteOptions { compression: Compression::Zstd, chunk_bytes: 8 << 20, index: false, ..Default::default() };
    let mut writer = Writer::new(File::create(path).unwrap(), options).unwrap();
    let channel = writer.add_channel(0, topic, "cdr", &BTreeMap::new()).unwrap();
    for _ in 0..n_messages {
        let header = MessageHeader { channel_id: channel, sequence: 0, log_time: 1, publish_time: 1 };
        writer.write_message(header, Vec::new().into()).unwrap();
    }
    writer.finish().unwrap();
    fs::metadata(path).unwrap().len()
}

#[test]
fn a_small_file_that_unpacks_to_much_is_refused_with_limit_and_place() {
    let folder = Folder::new();
    let n_messages = if crate::common::is_slow_run() { 34_000_000 } else { 1_000_000 };
    let n_bytes = bomb(&folder.path("bomb.mcap"), "/exact/scan.cloud", n_messages);
    assert!(n_bytes < u64::from(n_messages) / 50, "{n_bytes}");
    for command in [&["replay", "bomb.mcap"][..], &["info", "bomb.mcap"]] {
        let mut limited = folder.command(command);
        limited.env("OSTEOFLOW_MAX_RECORDING_MB", "64");
        let output = limited.output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
        assert!(output.status.code().is_some(), "{command:?} was killed: {err}");
        assert!(err.contains("64 MB of memory") && err.contains("byte"), "{command:?}: {err}");
    }
    // Read as a stream, it takes a chunk.
    let (code, out, _) = folder.says(&["validate", "bomb.mcap", "--quiet"]);
    assert!(code == 1 && out.contains("not sound"), "{out}");
    if crate::common::is_slow_run() {
        let (code, _, err) = folder.says(&["replay", "bomb.mcap"]);
        assert!(code == 1 && err.contains("4096 MB of memory"), "{err}");
    }
}

#[test]
fn items_out_of_order_count_where_a_file_is_read_as_a_stream() {
    let folder = Folder::new();
    let path = folder.path("gaps.mcap");
    let mut writer = Writer::new(File::create(&path).unwrap(), WriteOptions::default()).unwrap();
    let channel = writer.add_channel(0, "/exact/scan.cloud", "cdr", &BTreeMap::new()).unwrap();
    for k in 0..20_000_u64 {
        // An empty item, the number of which leaves a gap (docs/use/recording.md, "The layout of a message").
        let mut data = b"OSTEOVW1".to_vec();
        data.extend([1_u64.to_le_bytes(), (2 * k + 1).to_le_bytes()].concat());
        data.resize(64, 0);
        let header = MessageHeader { channel_id: channel, sequence: k as u32, log_time: 1, publish_time: 1 };
        writer.write_message(header, data.into()).unwrap();
    }
    writer.finish().unwrap();
    for command in [&["digest", "gaps.mcap"][..], &["recover", "gaps.mcap", "saved.mcap"]] {
        let output = folder.command(command).env("OSTEOFLOW_MAX_RECORDING_MB", "1").output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && err.contains("more than 1 MB of memory"), "{command:?}: {err}");
        assert!(!folder.path("saved.mcap").exists());
        let output = folder.command(command).env("OSTEOFLOW_MAX_RECORDING_MB", "5 GB").output().unwrap();
        let err = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(1) && err.contains("is \"5 GB\", but a whole number"),
            "{command:?}: {err}"
        );
    }
}

#[cfg(unix)]
#[test]
fn a_forged_sweep_cannot_write_outside_of_its_folder_and_has_one_file_for_each_run() {
    use std::os::unix::fs::symlink;
    let folder = Folder::new();
    let graph = format!(
        "extends = {:?}\n[graph]\nname = \"small\"\n[sweep]\nrepeat = 2\n[sweep.columns]\nrms = \"icp.rms_mm\"\n",
        root().join("graphs/fibula.toml")
    );
    fs::write(folder.path("graph.toml"), graph).unwrap();
    let (code, _, err) = folder.says(&["sweep", "graph.toml", "--out", "sweep", "--quiet"]);
    assert_eq!(code, 0, "{err}");
    let resume = ["sweep", "graph.toml", "--out", "sweep", "--resume", "--quiet"];

    // An empty file is what a power cut may leave: the run is computed again.
    let first = folder.path("sweep/runs/000000.json");
    let whole = json(&first);
    fs::write(&first, "").unwrap();
    let (code, _, err) = folder.says(&resume);
    assert!(code == 0 && json(&first) == whole, "{err}");

    // A run under the number of another, and a second file for a run.
    fs::copy(&first, folder.path("sweep/runs/000001.json")).unwrap();
    let (code, _, err) = folder.says(&["report", "sweep"]);
    assert!(code == 1 && err.contains("000001.json") && err.contains("it holds run 0"), "{err}");
    fs::remove_file(folder.path("sweep/runs/000001.json")).unwrap();
    fs::write(folder.path("sweep/runs/0.json"), whole.to_string()).unwrap();
    let (code, _, err) = folder.says(&resume);
    assert!(code == 1 && err.contains("run 0 is read from 000000.json only"), "{err}");
    fs::remove_file(folder.path("sweep/runs/0.json")).unwrap();

    // Links lead nowhere.
    let elsewhere = folder.path("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    fs::write(elsewhere.join("mine"), "mine").unwrap();
    symlink(elsewhere.join("mine"), folder.path("sweep/runs/000001.json")).unwrap();
    for name in ["runs.csv", "points.csv", "report.html", "citations.bib"] {
        let _ = fs::remove_file(folder.path("sweep").join(name));
        symlink(elsewhere.join("mine"), folder.path("sweep").join(name)).unwrap();
    }
    fs::remove_file(folder.path("sweep/runs/000001.json")).unwrap();
    assert_eq!(folder.says(&resume).0, 0);
    assert_eq!(folder.says(&["report", "sweep"]).0, 0);
    assert_eq!(fs::read_to_string(elsewhere.join("mine")).unwrap(), "mine");
    let _ = fs::remove_dir_all(folder.path("sweep/figures"));
    symlink(&elsewhere, folder.path("sweep/figures")).unwrap();
    let (code, _, err) = folder.says(&["report", "sweep"]);
    assert!(code == 1 && err.contains("figures") && err.contains("link"), "{err}");
    fs::rename(folder.path("sweep/runs"), folder.path("moved")).unwrap();
    symlink(folder.path("moved"), folder.path("sweep/runs")).unwrap();
    let (code, _, err) = folder.says(&resume);
    assert!(code == 1 && err.contains("not a folder"), "{err}");
    assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 1);
}

#[cfg(unix)]
#[test]
fn files_for_other_programs_are_not_written_through_links() {
    use std::os::unix::fs::symlink;
    let folder = Folder::new();
    let graph = root().join("graphs/fibula.toml").display().to_string();
    let mine = folder.path("mine");
    fs::create_dir(&mine).unwrap();
    let names = ["bone.stl", "landmarks.mrk.json", "planes.mrk.json", "scan.ply", "scan.vtk", "scan_to_ct.tfm"];
    for name in names {
        fs::write(mine.join(name), "mine").unwrap();
    }
    let run = ["run", &graph, "--out", "run", "--force", "--quiet"];
    // Links with the names of the files, then one with that of the folder.
    let links: [&dyn Fn(); 2] = [
        &|| {
            fs::create_dir_all(folder.path("run/export")).unwrap();
            for name in names {
                symlink(mine.join(name), folder.path("run/export").join(name)).unwrap();
            }
        },
        &|| {
            fs::remove_dir_all(folder.path("run/export")).unwrap();
            symlink(&mine, folder.path("run/export")).unwrap();
        },
    ];
    for link in links {
        link();
        let (code, _, err) = folder.says(&run);
        assert_eq!(code, 0, "{err}");
        for name in names {
            assert_eq!(fs::read_to_string(mine.join(name)).unwrap(), "mine", "{name}");
            assert!(fs::metadata(folder.path("run/export").join(name)).unwrap().len() > 100, "{name}");
        }
    }
}

#[test]
fn the_report_of_a_damaged_recording_or_of_other_results_says_so_at_its_top() {
    let folder = Folder::new();
    let graph = root().join("graphs/fibula.toml").display().to_string();
    assert_eq!(folder.says(&["run", &graph, "--out", "run", "--quiet"]).0, 0);
    let (code, _, err) = folder.says(&["report", "run"]);
    assert!(code == 0 && err.is_empty(), "{err}");
    let results = fs::read_to_string(folder.path("run/results.json")).unwrap();
    let recording = fs::read(folder.path("run/run.mcap")).unwrap();
    let check = |what: &str, words: &str| {
        let (code, _, err) = folder.says(&["report", "run"]);
        assert!(code == 1 && err.contains(words), "{what}: {err}");
        let page = fs::read_to_string(folder.path("run/report.html")).unwrap().replace("<wbr>", "");
        let (sound, verdict) = (page.find("NOT SOUND").unwrap(), page.find("class=\"verdict").unwrap());
        assert!(sound < verdict, "{what}");
    };
    // The results of another run.
    fs::write(folder.path("run/results.json"), results.replacen("\"rms_mm\": 0.", "\"rms_mm\": 1.", 1)).unwrap();
    check("results", "results.json holds other results");
    fs::write(folder.path("run/results.json"), &results).unwrap();
    // A bit in a chunk, and one in the recorded graph.
    for (at, words) in [(recording.len() / 2, "damaged"), (2000, "not sound")] {
        let mut bytes = recording.clone();
        bytes[at] ^= 1;
        fs::write(folder.path("run/run.mcap"), bytes).unwrap();
        check("a bit", words);
    }
    fs::write(folder.path("run/run.mcap"), &recording[..recording.len() / 2]).unwrap();
    check("cut short", "cut short");
}
