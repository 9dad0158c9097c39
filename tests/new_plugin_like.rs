//! `osteoflow new plugin --like KIND`: in each language each kind of node is written, builds without warnings, runs in its graph,
//! and gives what the built-in nodes give; what is wrong in its input is refused.
//!
//! The sources in Rust are examples of this workspace under the name of the template, which are built with everything else.

use crate::common::{
    Ran, build, is_slow_run, isometry, osteoflow, point, python::python, root, run, run_whole, shared_run,
};
use osteoflow_geometry::nalgebra::Point3;
use serde_json::Value;
use std::{
    env::consts::{DLL_PREFIX, DLL_SUFFIX},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

const LANGUAGES: [&str; 4] = ["rust", "c", "cpp", "python"];

/// The languages in which the plugin of a kind is built: one of the four, each of them in a kind or more; all with `SLOW_TESTS`.
fn languages_of(kind: &str) -> Vec<&'static str> {
    if is_slow_run() {
        return LANGUAGES.into();
    }
    let at = KINDS.iter().position(|other| *other == kind).unwrap();
    vec![["cpp", "c", "python", "rust", "cpp", "python"][at]]
}

const KINDS: [&str; 6] = ["icp", "hole", "crop", "metric", "source", "sink"];

/// The name of the plugin in the templates, since the examples in Rust have it.
const NAME: &str = "my_plugin";

/// Settings of a procedure that takes less time.
const SMALL: [&str; 8] = {
    let [a, b, c, d] = crate::common::WHITE;
    ["--set", "recording.camera.n_points=8000", "--set", "bone.exact=true", a, b, c, d]
};

/// A plugin in its folder, ready to run.
struct Plugin {
    dir: tempfile::TempDir,
    /// `--python` and the interpreter, for a plugin in Python.
    arguments: Vec<String>,
}

/// Writes a plugin and gives its folder, and the commands that the program prints.
fn written(name: &str, lang: &str, kind: &str) -> (tempfile::TempDir, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let mut new = osteoflow();
    new.args(["new", "plugin", name, "--lang", lang, "--like", kind, "--format", "json", "--out"]).arg(dir.path());
    if lang == "rust" {
        new.arg("--sdk").arg(root());
    }
    let output = new.output().unwrap();
    assert!(output.status.success(), "{lang} {kind}: {}", String::from_utf8_lossy(&output.stderr));
    let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
    (dir, serde_json::from_value(printed["commands"].clone()).unwrap())
}

/// Runs a command that must succeed.
fn done(command: &mut Command) {
    let output = command.output().unwrap();
    let printed = [output.stdout, output.stderr].map(|printed| String::from_utf8_lossy(&printed).into_owned()).concat();
    assert!(output.status.success(), "{command:?}: {printed}");
}

impl Plugin {
    /// Writes a plugin and builds it, with all warnings as errors; a note and `None` where the tools of its language are missing.
    fn new(lang: &str, kind: &str) -> Option<Self> {
        let (dir, _) = written(NAME, lang, kind);
        let mut arguments = vec!["--no-record".to_owned()];
        match lang {
            "rust" => {
                let release = dir.path().join("target/release");
                fs::create_dir_all(&release).unwrap();
                let library = format!("{DLL_PREFIX}{NAME}{DLL_SUFFIX}");
                fs::copy(build::example(&format!("template_{kind}")), release.join(library)).unwrap();
            }
            "python" => {
                let interpreter = python(&format!("{kind} in Python"))?;
                arguments.extend(["--python".to_owned(), interpreter.to_str().unwrap().to_owned()]);
            }
            _ => {
                let (compiler, flags) = if lang == "c" { ("cc", "CFLAGS") } else { ("c++", "CXXFLAGS") };
                if ![compiler, "make"].iter().all(|name| Command::new(name).arg("--version").output().is_ok()) {
                    eprintln!("skipped: {kind} in {lang}: there is no {compiler} or no make");
                    return None;
                }
                let targets: &[&[&str]] = if lang == "c" { &[&[], &["test"]] } else { &[&[]] };
                for target in targets {
                    let flags = format!("{flags}=-O2 -Wall -Wextra -Werror -pedantic");
                    done(Command::new("make").current_dir(dir.path()).arg(flags).args(*target));
                }
            }
        }
        Some(Self { dir, arguments })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join("graphs").join(name)
    }

    fn arguments<'a>(&'a self, more: &[&'a str]) -> Vec<&'a str> {
        self.arguments.iter().map(String::as_str).chain(more.iter().copied()).collect()
    }

    /// Runs the graph of the plugin.
    fn run(&self, more: &[&str]) -> Ran {
        run_whole(self.path("my_plugin.toml").to_str().unwrap(), &self.arguments(&[&SMALL[..], more].concat()))
    }

    /// A graph of the source alone, which reads a text, and its answer as digest, or the error.
    fn read(&self, kind: &str, text: &str, params: &str) -> Result<String, String> {
        let file = self.path("given.xyz");
        fs::write(&file, text).unwrap();
        let plugins = fs::read_to_string(self.path("my_plugin.toml")).unwrap();
        let plugins = plugins.lines().find(|line| line.starts_with("plugins")).unwrap();
        let graph = format!(
            "{plugins}\n[graph]\nformat = 1\n[node.file]\nkind = \"{kind}\"\npath = \"given.xyz\"\nframe = \"bone_marker\"\n\
             {params}\n[record]\nwires = [\"*\"]\n[results]\ncloud = \"file.cloud\"\n"
        );
        fs::write(self.path("read.toml"), graph).unwrap();
        let ran = run(self.path("read.toml").to_str().unwrap(), &self.arguments(&[])[1..]);
        if ran.code != 0 {
            return Err(ran.stderr);
        }
        assert_eq!(ran.results["cloud"]["frame"], "bone_marker");
        let output = osteoflow().args(["digest", "--format", "json"]).arg(ran.dir.path()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let digests: Value = serde_json::from_slice(&output.stdout).unwrap();
        Ok(digests["files"][0]["wires"][0]["digest"].as_str().unwrap().to_owned())
    }
}

/// The results of the built-in procedure.
fn built_in() -> &'static Value {
    &shared_run("graphs/fibula.toml", &[&["--no-record"], &SMALL[..]].concat()).results
}

/// The laser points of a run, in the world.
fn laser_points(results: &Value) -> Vec<(String, Point3<f64>)> {
    let points = results["laser_points"].as_array().unwrap().iter();
    points.map(|p| (p["name"].to_string(), point(&p["position_mm"]))).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

/// The points of a text file, by their bits.
fn rows(path: &Path) -> Vec<[u64; 3]> {
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let row = |line: &str| line.split(' ').map(|word| word.parse::<f64>().unwrap().to_bits()).collect::<Vec<_>>();
    lines.map(|line| row(line).try_into().unwrap()).collect()
}

#[test]
fn an_icp_of_each_language_agrees_with_the_built_in_one_within_a_millimetre() {
    for lang in languages_of("icp") {
        let Some(plugin) = Plugin::new(lang, "icp") else { continue };
        let results = plugin.run(&[]).results;
        let [own, known] = [&results, built_in()].map(|results| isometry(&results["poses"]["t_ct_world"]["matrix"]));
        for (name, p) in laser_points(built_in()) {
            let apart_mm = (own * p - known * p).norm();
            // Both have a TRE below 0.2 mm.
            assert!(apart_mm < 0.4, "{lang}: {apart_mm} mm apart at {name}");
        }
        let report = &results["icp"];
        assert!(report["observability"].is_null(), "{lang}: the report is that of the built-in ICP");
        assert_eq!((&report["converged"], &results["verdict"]["answer"]), (&true.into(), &"trusted".into()), "{lang}");
        assert!(number(&report["rms_mm"]) < 0.2 && number(&report["n_pairs"]) > 1000.0, "{lang}: {report}");
        let stopped = plugin.run(&["--set", "icp.max_iterations=1"]).results;
        assert_eq!(stopped["icp"]["converged"], false, "{lang}");
        assert_eq!(stopped["verdict"]["answer"], "doubtful", "{lang}");
    }
}

#[test]
fn a_hole_detector_of_each_language_finds_the_spots_of_the_built_in_one() {
    for lang in languages_of("hole") {
        let Some(plugin) = Plugin::new(lang, "hole") else { continue };
        let results = plugin.run(&[]).results;
        let points = laser_points(&results);
        assert_eq!(points.len(), 3, "{lang}");
        for (k, ((name, own), (known_name, known))) in points.into_iter().zip(laser_points(built_in())).enumerate() {
            let apart_mm = (own - known).norm();
            assert!(name == known_name && apart_mm < 1.0, "{lang}: {name} is {apart_mm} mm off");
            let report = &results["holes"][k];
            assert!(report["n_missing"].is_number() && report["confidence"].is_null(), "{lang}: {report}");
            let radius_mm = number(&report["hole_radius_mm"]);
            assert!((radius_mm - 2.0).abs() < 0.3, "{lang}: {name} has a radius of {radius_mm} mm, the spot of 2 mm");
        }
        assert_eq!(results["verdict"]["answer"], "trusted", "{lang}");
        let graph = plugin.path("my_plugin.toml");
        let strict = [&SMALL[..], &["--set", "hole.min_points=100000"]].concat();
        let refused = run(graph.to_str().unwrap(), &plugin.arguments(&strict));
        assert!(refused.code != 0 && refused.stderr.contains("100000 are needed"), "{lang}: {}", refused.stderr);
    }
}

#[test]
fn a_crop_of_each_language_keeps_the_points_of_the_built_in_sphere() {
    let more = ["--set", "results.given=recording.scan", "--set", "results.kept=crop.cloud"];
    let sphere =
        ["--set", "crop.kind=crop.sphere", "--set", "crop.centre_mm=[0.0, 0.0, 250.0]", "--set", "crop.radius_mm=60.0"];
    let known = run_whole("graphs/fibula.toml", &[&["--no-record"], &SMALL[..], &more, &sphere].concat()).results;
    for lang in languages_of("crop") {
        let Some(plugin) = Plugin::new(lang, "crop") else { continue };
        let own = plugin.run(&more).results;
        let [n_given, n_kept] = ["given", "kept"].map(|name| number(&own[name]["n_points"]));
        assert!(n_given > n_kept && n_kept > 1000.0, "{lang}: {n_kept} of {n_given} points");
        assert_eq!((&own["kept"], &own["poses"]), (&known["kept"], &known["poses"]), "{lang}");
        let graph = plugin.path("my_plugin.toml");
        let tiny = [&SMALL[..], &["--set", "crop.radius_mm=0.001"]].concat();
        let refused = run(graph.to_str().unwrap(), &plugin.arguments(&tiny));
        assert!(
            refused.code != 0 && refused.stderr.contains("none of 8000 points is within 0.001"),
            "{}",
            refused.stderr
        );
    }
}

#[test]
fn a_metric_of_each_language_is_the_built_in_error_of_the_points() {
    for lang in languages_of("metric") {
        let Some(plugin) = Plugin::new(lang, "metric") else { continue };
        let results = plugin.run(&["--set", "own_tre.limit_mm=0.19"]).results;
        let points = results["metrics"]["tre_true_mm"]["points"].as_array().unwrap();
        let off_mm: Vec<f64> = points.iter().map(|point| number(&point["norm"])).collect();
        let n = off_mm.len() as f64;
        let n_good = off_mm.iter().filter(|&&off_mm| off_mm <= 0.19).count() as f64;
        assert!(n_good > 0.0 && n_good < n, "the limit divides the points: {off_mm:?}");
        let expected = [off_mm.iter().sum::<f64>() / n, off_mm.iter().copied().fold(0.0, f64::max), n_good / n];
        for (name, expected) in ["mean_mm", "max_mm", "share_good"].iter().zip(expected) {
            let found = number(&results["metrics"]["own_tre"][name]);
            // The quaternion of the pose has length 1 within 1e-9, 2 m from the bone.
            assert!((found - expected).abs() < 1e-6, "{lang}: {name} is {found}, expected {expected}");
        }
    }
}

#[test]
fn a_source_of_each_language_gives_the_points_of_its_file_bit_for_bit() {
    let given = "# x y z\n0.1 0.30000000000000004 -1e-300\n\n  1\t2 3 # the second\r\n99.99999999999999 3.141592653589793 -0.0\n";
    for lang in languages_of("source") {
        let Some(plugin) = Plugin::new(lang, "source") else { continue };
        let results = plugin.run(&[]).results;
        let about = &results["points_file"];
        assert_eq!((&about["n_points"], &about["frame"]), (&20.into(), &"bone_marker".into()), "{lang}");
        let rms_mm = number(&results["metrics"]["points_file_mm"]["rms_all_mm"]);
        assert!(rms_mm < 0.2, "{lang}: {rms_mm} mm from the surface on which they were taken");
        // The built-in reader takes no comment behind a point.
        let plain = given.replace(" # the second", "").replace("# x y z\n", "");
        let [own, known] = [("my_plugin.xyz", given), ("acquire.cloud", &plain)].map(|(kind, text)| {
            [plugin.read(kind, text, "").unwrap(), plugin.read(kind, text, "unit_mm = 1000.0").unwrap()]
        });
        assert_eq!(own, known, "{lang}");
        assert_ne!(own[0], own[1], "{lang}: the unit changes the points");
        for (text, expected) in [
            ("1 2 3\n4 5\n", "given.xyz:2: three numbers are expected, found \"4 5\""),
            ("1 2 3\n4 5 nan\n", "given.xyz:2: three numbers are expected, found \"4 5 nan\""),
            ("1 2 3\n4 5 6 7\n", "given.xyz:2: three numbers are expected, found \"4 5 6 7\""),
            ("1 2 3\n4 5 6,5\n", "given.xyz:2: three numbers are expected, found \"4 5 6,5\""),
            ("1 2 3\n\n4 5 6", "given.xyz:3: the last line does not end"),
            ("# none\n", "given.xyz:1: the file has no points"),
        ] {
            let message = plugin.read("my_plugin.xyz", text, "").unwrap_err();
            assert!(message.contains("node \"file\", item 0: ") && message.contains(expected), "{lang}: {message}");
        }
        // A file that is missing is a fault of the graph; a folder is there, and cannot be read.
        fs::create_dir(plugin.path("folder")).unwrap();
        for (path, code) in [("nowhere.xyz", 2), ("folder", 3)] {
            let graph = fs::read_to_string(plugin.path("read.toml")).unwrap().replace("given.xyz", path);
            fs::write(plugin.path("wrong.toml"), graph).unwrap();
            let refused = run(plugin.path("wrong.toml").to_str().unwrap(), &plugin.arguments(&[]));
            assert_eq!(refused.code, code, "{lang}: {}", refused.stderr);
            assert!(refused.stderr.contains(&format!("graphs/{path}")), "{lang}: {}", refused.stderr);
        }
    }
}

#[test]
fn a_sink_of_each_language_writes_every_point_of_its_wire_with_all_bits() {
    let mut before: Option<Vec<[u64; 3]>> = None;
    for lang in languages_of("sink") {
        let Some(plugin) = Plugin::new(lang, "sink") else { continue };
        let ran = plugin.run(&["--set", "results.scan=to_bone.cloud"]);
        let file = ran.dir.path().join(ran.results["scan_file"].as_str().unwrap());
        let first = fs::read_to_string(&file).unwrap().lines().next().unwrap().to_owned();
        assert!(first.starts_with("# frame bone_marker, unit 1"), "{lang}: {first}");
        let rows = rows(&file);
        assert_eq!(rows.len() as u64, ran.results["scan"]["n_points"].as_u64().unwrap(), "{lang}");
        assert!(before.replace(rows.clone()).is_none_or(|before| before == rows), "{lang}: other points");
        let metres = plugin.run(&["--set", "scan_file.unit_mm=1000"]);
        let metres = self::rows(&metres.dir.path().join("scan_file-0.xyz"));
        assert_eq!(f64::from_bits(metres[7][2]), f64::from_bits(rows[7][2]) / 1000.0, "{lang}");
    }
}

#[test]
fn what_is_written_has_the_name_of_the_plugin_alone_and_the_commands_of_its_page() {
    for lang in LANGUAGES {
        for kind in KINDS {
            let (dir, commands) = written("spiral", lang, kind);
            let mut folders = vec![dir.path().to_owned()];
            while let Some(folder) = folders.pop() {
                for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
                    if entry.is_dir() {
                        folders.push(entry);
                        continue;
                    }
                    // That of the checkout, which has the template.
                    if entry.ends_with("Cargo.lock") {
                        continue;
                    }
                    let text = fs::read_to_string(&entry).unwrap();
                    assert!(!text.contains("my_plugin"), "{lang} {kind}: my_plugin in {}", entry.display());
                    if entry.ends_with("README.md") || entry.ends_with("graphs/spiral.toml") {
                        for placeholder in ["VARIANT", "SUMMARY", "BUILD", "USE", "POINTS"] {
                            assert!(!text.contains(placeholder), "{lang} {kind}: {placeholder} in {}", entry.display());
                        }
                    }
                }
            }
            let page = fs::read_to_string(dir.path().join("README.md")).unwrap();
            let block = page.split("```sh\n").nth(1).unwrap().split("\n```").next().unwrap();
            assert_eq!(block.lines().collect::<Vec<_>>(), &commands[1..], "{lang} {kind}");
            let listed = page.lines().filter(|line| line.starts_with("| `")).filter_map(|line| line.split('|').nth(1));
            let files: Vec<_> = listed.flat_map(|cell| cell.split('`').skip(1).step_by(2)).collect();
            assert!(files.len() > 2 && files.contains(&"graphs/points.xyz") == (kind == "source"), "{lang} {kind}");
            for file in files {
                assert!(dir.path().join(file).is_file(), "{lang} {kind}: there is no {file}");
            }
        }
    }
}

#[test]
fn the_crates_of_all_kinds_build_alone_without_warnings_and_their_tests_pass() {
    if !is_slow_run() {
        return;
    }
    for kind in KINDS {
        let (dir, _) = written(NAME, "rust", kind);
        for command in
            [&["rustc", "--release", "--offline", "--", "-D", "warnings"][..], &["test", "--release", "--offline"]]
        {
            let mut cargo = Command::new("cargo");
            cargo.current_dir(dir.path()).env("CARGO_TARGET_DIR", root().join("target/new_plugin"));
            done(cargo.args(command));
        }
    }
}

#[test]
fn the_page_of_a_plugin_in_c_describes_its_kind_by_the_command_it_names() {
    let Some(plugin) = Plugin::new("c", "crop") else { return };
    let page = fs::read_to_string(plugin.dir.path().join("README.md")).unwrap();
    let command = page.split('`').find(|words| words.starts_with("osteoflow inspect")).unwrap();
    let output = osteoflow().current_dir(plugin.dir.path()).args(command.split(' ').skip(1)).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(printed.contains("Points within a distance of a centre."), "{printed}");
}

#[test]
fn a_kind_that_no_template_is_like_is_refused_with_the_list_and_help_explains_each() {
    let dir = tempfile::tempdir().unwrap();
    let output = osteoflow().current_dir(dir.path()).args(["new", "plugin", "x", "--like", "icq"]).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(printed.contains(&format!("[possible values: {}]", KINDS.join(", "))), "{printed}");
    for name in ["fibula", "numpy"] {
        let output = osteoflow().current_dir(dir.path()).args(["new", "plugin", name, "--lang", "python"]).output();
        let printed = String::from_utf8(output.unwrap().stderr).unwrap();
        assert!(printed.contains("choose another name, such as my_"), "{printed}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0, "nothing is written");
    let help = osteoflow().args(["new", "plugin", "--help"]).output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    for kind in KINDS {
        let line = help.lines().find(|line| line.trim_start().starts_with(&format!("- {kind}:")));
        assert!(line.is_some_and(|line| line.contains("s ")), "{kind}: {help}");
    }
}

/// The kinds that the templates are like, in the procedure.
fn published(lang: &str, kind: &str) -> Option<(Plugin, String, Vec<String>)> {
    let plugin = Plugin::new(lang, kind)?;
    let graph = fs::read_to_string(plugin.path("my_plugin.toml")).unwrap();
    let of_node = graph.split(&format!("[node.{kind}]")).nth(1).unwrap();
    let own = of_node.split("kind").nth(1).unwrap().split('"').nth(1).unwrap().to_owned();
    let file = graph.split("plugins = [\"").nth(1).unwrap().split('"').next().unwrap();
    let file = plugin.path(file).display().to_string();
    let mut arguments = vec!["--plugin".to_owned(), file];
    arguments.extend_from_slice(&plugin.arguments[1..]);
    Some((plugin, own, arguments))
}

/// The exit code, stdout as JSON and stderr of a command.
fn answer(command: &[&str], arguments: &[String], more: &[&str]) -> (Option<i32>, Value, String) {
    let output = osteoflow().args(command).args(["--format", "json"]).args(arguments).args(more).output().unwrap();
    let json = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code(), json, String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn a_plugin_of_each_language_takes_the_place_of_a_recorded_kind_and_gives_it_back() {
    let base = shared_run("graphs/fibula.toml", &SMALL);
    let recording = base.path("run.mcap").display().to_string();
    // Each kind in all languages, which differ in how they are built alone.
    for (kind, node, others) in [
        ("icp", "icp", [&["icp.kind=icp.published", "icp.reading=change_1e-5"][..], &["icp.kind=icp.point_to_plane"]]),
        (
            "hole",
            "hole",
            [&["hole.kind=hole.boundary", "hole.min_confidence=0.0"], &["hole.kind=hole.cloud_difference"]],
        ),
    ] {
        // With SLOW_TESTS each kind in all languages.
        let languages: &[&str] = if kind == "icp" { &["python", "rust"] } else { &["c"] };
        for lang in if is_slow_run() { &LANGUAGES[..] } else { languages } {
            let Some((plugin, own, arguments)) = published(lang, kind) else { continue };
            let set = format!("{node}.kind={own}");
            let (code, replayed, printed) = answer(&["replay", &recording], &arguments, &["--set", &set]);
            assert_eq!(code, Some(4), "{lang} {kind}: {printed}");
            // The bits of the run of the plugin's own graph.
            let mut record = SMALL.to_vec();
            let out = plugin.dir.path().join("recorded");
            record.extend(["--out", out.to_str().unwrap()]);
            let graph = plugin.path("my_plugin.toml");
            let (code, _, printed) = answer(&["run", graph.to_str().unwrap()], &arguments[2..], &record);
            assert_eq!(code, Some(0), "{lang} {kind}: {printed}");
            let results = crate::common::json(&out.join("results.json"));
            assert_eq!(replayed["results"]["poses"], results["poses"], "{lang} {kind}");
            // By a graph.
            let graph = ["--graph", graph.to_str().unwrap()];
            let (code, by_graph, printed) = answer(&["replay", &recording], &arguments, &graph);
            assert_eq!(code, Some(4), "{lang} {kind}: {printed}");
            assert_eq!(by_graph["results"]["poses"], results["poses"], "{lang} {kind}");
            // The recording of the plugin's run gives the kind of the base back, and takes another.
            let own_recording = out.join("run.mcap").display().to_string();
            for other in others {
                let sets: Vec<_> = other.iter().flat_map(|set| ["--set", set]).collect();
                let (code, back, printed) = answer(&["replay", &own_recording], &arguments, &sets);
                assert_eq!(code, Some(4), "{lang} {kind} {other:?}: {printed}");
                let is_back = back["results"]["poses"] == base.results["poses"];
                assert_eq!(is_back, other.len() == 1, "{lang} {kind} {other:?}: {printed}");
            }
        }
    }
    // The published ICP as the old kind.
    let set = ["--set", "icp.kind=icp.published", "--set", "icp.reading=change_1e-5"];
    let published_run = run_whole("graphs/fibula.toml", &[&SMALL[..], &set].concat());
    let recording = published_run.path("run.mcap").display().to_string();
    let Some((plugin, own, arguments)) = published("python", "icp") else { return };
    let kind = format!("icp.kind={own}");
    let (code, _, printed) = answer(&["replay", &recording], &arguments, &["--set", &kind]);
    let take_away = "--set 'remove=[\"node.icp.reading\"]'";
    assert!(code == Some(2) && printed.contains(take_away), "what was written for it is no parameter: {printed}");
    let sets = ["--set", &kind, "--set", "remove=[\"node.icp.reading\"]"];
    let (code, replayed, printed) = answer(&["replay", &recording], &arguments, &sets);
    assert_eq!(code, Some(4), "{printed}");
    assert_eq!(replayed["results"]["poses"], plugin.run(&[]).results["poses"]);
}

#[test]
fn a_failed_item_is_run_again_through_another_kind() {
    let failing = [&SMALL[..], &["--set", "icp.max_pair_distance_mm=0.0001"]].concat();
    let ran = run("graphs/fibula.toml", &failing);
    let bundle = ran.path("repro/icp-0").display().to_string();
    let (code, same, printed) = answer(&["repro", &bundle], &[], &[]);
    assert_eq!((code, &same["same"]), (Some(0), &true.into()), "{printed}");
    let (code, wider, printed) = answer(&["repro", &bundle], &[], &["--set", "icp.max_pair_distance_mm=5"]);
    assert_eq!((code, &wider["failed_now"]), (Some(4), &Value::Null), "{printed}");
    let published_kind = ["--set", "icp.kind=icp.published", "--set", "icp.reading=change_1e-5"];
    let (code, again, printed) = answer(&["repro", &bundle], &[], &published_kind);
    assert_eq!((code, &again["run_as"]), (Some(0), &"icp.published".into()), "it fails likewise: {printed}");
    for lang in ["python", "c", "rust"] {
        let Some((_plugin, own, arguments)) = published(lang, "icp") else { continue };
        // With what the user wrote, and without.
        let kind = format!("icp.kind={own}");
        let (code, failed, printed) = answer(&["repro", &bundle], &arguments, &["--set", &kind]);
        let is_refused = code == Some(2) && printed.contains("max_pair_distance_mm takes a number from 0.001");
        let fails = code == Some(4) && failed["failed_now"]["reason"].is_string();
        assert!(fails || is_refused, "{lang}: {printed} {failed:#}");
        let sets = ["--set", &kind, "--set", "remove=[\"node.icp.max_pair_distance_mm\"]"];
        let (code, other, printed) = answer(&["repro", &bundle], &arguments, &sets);
        assert_eq!((code, &other["run_as"]), (Some(4), &own.as_str().into()), "{lang}: {printed}");
        assert!(other["failed_now"].is_null(), "{lang}: {other:#}");
    }
    let cases: [(&[&str], &str); 5] = [
        (&["--set", "hole.min_points=1"], "a bundle has one node, \"icp\""),
        (&["--set", "remove=[\"node.icp.max_pair_distance_mm\", \"node.hole.min_points\"]"], "a bundle has one node"),
        (&["--set", "icp.kind=no.such"], "there is no kind \"no.such\""),
        (&["--set", "icp.no_such=1"], "no_such"),
        (
            &["--set", "icp.kind=hole.boundary", "--set", "remove=[\"node.icp.max_pair_distance_mm\"]"],
            "which the bundle lacks",
        ),
    ];
    for (sets, expected) in cases {
        let (code, _, printed) = answer(&["repro", &bundle], &[], sets);
        assert!(code == Some(2) && printed.contains(expected), "{sets:?}: {code:?} {printed}");
    }
}

#[test]
fn a_watch_runs_again_with_the_kind_that_is_edited_into_the_graph() {
    let plugins: Vec<_> = ["python", "c", "rust"].into_iter().filter_map(|lang| published(lang, "icp")).collect();
    let dir = tempfile::tempdir().unwrap();
    let graph = |kind: &str, files: &[&str]| {
        let base = root().join("graphs/fibula.toml");
        let camera = "camera = { n_points = 8000, surface_error_mm = 0.0, edge_outliers = 0.0 }";
        let small = format!("[node.recording]\n{camera}\n[node.bone]\nexact = true\n");
        let text = format!("extends = {base:?}\nplugins = {files:?}\n{small}[node.icp]\nkind = \"{kind}\"\n");
        let reading = if kind == "icp.published" { "reading = \"change_1e-5\"\n" } else { "" };
        let text = format!("{text}{reading}");
        fs::write(dir.path().join("new"), text).unwrap();
        fs::rename(dir.path().join("new"), dir.path().join("graph.toml")).unwrap();
    };
    graph("icp.published", &[]);
    let mut command = crate::common::osteoflow_to_spawn();
    command.current_dir(dir.path()).args(["run", "--watch", "graph.toml", "--out", "out", "--format", "json"]);
    plugins.iter().for_each(|(plugin, ..)| {
        command.args(&plugin.arguments[1..]);
    });
    let mut watch = command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::null()).spawn().unwrap();
    let (send, lines) = std::sync::mpsc::sync_channel(1000);
    let stdout = std::io::BufReader::new(watch.stdout.take().unwrap());
    std::thread::spawn(move || {
        std::io::BufRead::lines(stdout).map_while(Result::ok).try_for_each(|line| send.send(line))
    });
    let next = || -> Value {
        serde_json::from_str(&lines.recv_timeout(std::time::Duration::from_secs(120)).expect("it answers")).unwrap()
    };
    let first = next();
    for (plugin, own, arguments) in &plugins {
        graph(own, &[&arguments[1]]);
        let exchanged = next();
        let about = &exchanged["outcome"]["watch"];
        let change = about["changes"][0].as_str().unwrap_or_default();
        assert!(change.starts_with(&format!("icp: kind icp.published -> {own}")), "{about}");
        assert!(about["kept"].as_array().unwrap().contains(&"hole".into()), "{about}");
        assert_eq!(exchanged["poses"], plugin.run(&[]).results["poses"], "{own}");
        graph("icp.published", &[]);
        assert_eq!(next()["poses"], first["poses"], "{own}");
    }
    watch.kill().unwrap();
    watch.wait().unwrap();
}
