//! Plugins: found, inspected, run, rebuilt, recorded and refused. The tests compile them from C.

use crate::common::{TOY_GRAPH as GRAPH, assert_golden, build, is_slow_run, json, osteoflow_to_spawn, root};
use serde_json::{Value, json};
use std::{
    env::consts::DLL_SUFFIX,
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::mpsc::sync_channel,
    thread,
    time::Duration,
};

/// Time after which a test that waits for a line fails.
const LIMIT: Duration = Duration::from_secs(120);

/// A folder with a graph and the plugins compiled for it.
struct Folder(tempfile::TempDir);

impl Folder {
    /// A folder with this `graph.toml`; `None` if there is no C compiler.
    fn new(graph: &str) -> Option<Self> {
        if let Err(error) = Command::new("cc").arg("--version").output() {
            println!("skipped: there is no C compiler here: {error}");
            return None;
        }
        let folder = Self(tempfile::tempdir().unwrap());
        fs::write(folder.path("graph.toml"), graph).unwrap();
        Some(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Compiles a C file of tests/plugins and replaces the library atomically.
    fn compile(&self, source: &str, library: &str, arguments: &[&str]) -> PathBuf {
        let (library, made) = (self.path(library), self.path("made"));
        fs::create_dir_all(library.parent().unwrap()).unwrap();
        let arguments = [&["-D_POSIX_C_SOURCE=200809L"], arguments].concat();
        assert!(build::compile(&Path::new("tests/plugins").join(source), &made, &arguments), "there was a compiler");
        fs::rename(&made, &library).unwrap();
        library
    }

    fn toy(&self, library: &str, add: &str) -> PathBuf {
        self.compile("toy.c", library, &[&format!("-DADD={add}")])
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = osteoflow_to_spawn();
        command.current_dir(self.0.path()).args(arguments);
        command.env_remove("OSTEOFLOW_PLUGIN_PATH").env("OSTEOFLOW_PLUGIN_TIMEOUT_S", "60");
        command
    }

    /// Exit code, stdout and stderr, with `DIR` for the path of the folder.
    fn says(&self, command: &mut Command) -> (i32, String, String) {
        let output = command.output().unwrap();
        let dir = self.0.path().canonicalize().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).replace(dir.to_str().unwrap(), "DIR");
        (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
    }

    fn run(&self, arguments: &[&str]) -> (i32, String, String) {
        self.says(&mut self.command(&[&["run", "graph.toml", "--force", "--out", "out"], arguments].concat()))
    }

    /// The result `sum` of a complete run.
    fn sum(&self, arguments: &[&str]) -> Value {
        let (code, _, err) = self.run(arguments);
        assert_eq!(code, 0, "{err}");
        json(&self.path("out/results.json"))["sum"].clone()
    }
}

fn naming(plugins: &str) -> String {
    format!("plugins = {plugins}\n{GRAPH}")
}

fn sha256(path: &Path) -> String {
    osteoflow_engine::hash::Digest::of(&fs::read(path).unwrap()).to_string()
}

#[test]
fn a_graph_names_its_plugin_by_file_or_by_name_relative_to_itself() {
    let Some(folder) = Folder::new("") else { return };
    let file = format!("libtoy{DLL_SUFFIX}");
    folder.toy(&file, "1");
    folder.toy(&format!("deep/{file}"), "2");
    let sums = [(format!("[\"{file}\"]"), 43.0), ("[\"toy\"]".into(), 43.0), ("[\"deep/toy\"]".into(), 44.0)];
    for (plugins, sum) in sums {
        fs::write(folder.path("graph.toml"), naming(&plugins)).unwrap();
        assert_eq!(folder.sum(&[]), json!({ "value": sum }), "{plugins}");
    }
    // A base graph names its own plugins, relative to itself.
    fs::write(folder.path("deep/base.toml"), naming("[\"toy\"]")).unwrap();
    fs::write(folder.path("graph.toml"), "extends = \"deep/base.toml\"\n").unwrap();
    assert_eq!(folder.sum(&[]), json!({ "value": 44.0 }));
}

#[test]
fn the_command_line_and_the_environment_also_name_plugins() {
    let Some(folder) = Folder::new(GRAPH) else { return };
    let (code, _, err) = folder.run(&[]);
    assert_eq!(code, 2);
    assert!(err.contains("there is no kind \"toy.give\""), "{err}");
    let library = format!("libtoy{DLL_SUFFIX}");
    folder.toy(&format!("far/{library}"), "1");
    assert_eq!(folder.sum(&["--plugin", "far/toy"]), json!({ "value": 43.0 }));
    // It is listed though the graph does not name it.
    assert_eq!(json(&folder.path("out/manifest.json"))["plugins"][0]["kinds"], json!(["toy.add", "toy.give"]));
    let mut by_path = folder.command(&["run", "graph.toml", "--force", "--out", "out"]);
    let (code, _, err) = folder.says(by_path.env("OSTEOFLOW_PLUGIN_PATH", folder.path("far")));
    assert_eq!(code, 0, "{err}");
    // A library on the command line replaces one of the same file name in the graph.
    folder.toy(&format!("near/{library}"), "100");
    fs::write(folder.path("graph.toml"), naming("[\"near/toy\"]")).unwrap();
    assert_eq!(folder.sum(&[]), json!({ "value": 142.0 }));
    assert_eq!(folder.sum(&["--plugin", &format!("far/{library}")]), json!({ "value": 43.0 }));
}

#[test]
fn a_manifest_lists_the_libraries_and_a_replay_reports_changed_ones() {
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    let library = folder.toy(&format!("libtoy{DLL_SUFFIX}"), "1");
    assert_eq!(folder.sum(&[]), json!({ "value": 43.0 }));
    let manifest = json(&folder.path("out/manifest.json"));
    let first = sha256(&library);
    assert_eq!(
        manifest["plugins"],
        json!([{
            "name": "toy", "version": "1.2.3", "path": library.canonicalize().unwrap(), "sha256": first,
            "abi": [1, 0], "sdk": "osteoflow.h 1.0", "compiler": "a compiler", "kinds": ["toy.add", "toy.give"],
        }])
    );
    let (code, _, err) = folder.says(folder.command(&["replay", "out/run.mcap"]).current_dir("/"));
    assert_eq!(code, 1, "a path of another folder: {err}");
    let recording = folder.path("out/run.mcap");
    let replay = || folder.says(folder.command(&["replay", "--quiet", recording.to_str().unwrap()]).current_dir("/"));
    let (code, out, err) = replay();
    assert_eq!((code, err.as_str()), (0, ""), "{out}");
    assert_eq!(folder.says(&mut folder.command(&["validate", "out/run.mcap"])).0, 0);
    // The same library built with another constant.
    folder.toy(&format!("libtoy{DLL_SUFFIX}"), "2");
    let (code, _, err) = replay();
    let other = sha256(&library);
    assert!(code == 2 && err.contains(&format!("its SHA-256 is {other}")), "{err}");
    // The user names it.
    let named = ["replay", "--quiet", recording.to_str().unwrap(), "--plugin", library.to_str().unwrap()];
    let (code, out, err) = folder.says(folder.command(&named).current_dir("/"));
    assert_eq!(code, 4, "{out}{err}");
    let shown = |sha256: &str| format!("libtoy{DLL_SUFFIX} (sha256 {sha256})");
    assert!(err.contains("plugin toy: the recording DIR/") && err.contains(&shown(&first)), "{err}");
    assert!(err.contains(&format!("{}\n", shown(&other))), "{err}");
    assert!(out.contains("first divergence: wire add.sum, item 0"), "{out}");
    // The library is missing.
    fs::remove_file(&library).unwrap();
    let (code, _, err) = replay();
    assert_eq!(code, 2, "{err}");
    assert!(err.contains("libtoy") && err.contains("there is no such file"), "{err}");
    // It has moved into a folder of plugins: the recorded library is found there, another of its name is not taken for it.
    for (folder_name, add, expected) in [("moved", "1", 0), ("other", "3", 2)] {
        let moved = folder.toy(&format!("{folder_name}/libtoy{DLL_SUFFIX}"), add);
        assert_eq!(sha256(&moved) == first, add == "1", "the compiler gives the same bytes");
        let mut replay = folder.command(&["replay", "--quiet", recording.to_str().unwrap()]);
        let (code, out, err) = folder.says(replay.env("OSTEOFLOW_PLUGIN_PATH", moved.parent().unwrap()));
        assert_eq!(code, expected, "{folder_name}: {out}{err}");
    }
}

#[test]
fn repro_repeats_a_failed_item_of_a_plugin() {
    let graph = naming("[\"toy\"]").replace("number = 40", "number = 999");
    let Some(folder) = Folder::new(&graph) else { return };
    let library = format!("libtoy{DLL_SUFFIX}");
    folder.toy(&library, "1");
    assert_eq!(folder.run(&[]).0, 3);
    let (code, out, err) = folder.says(&mut folder.command(&["repro", "out/repro/add-0"]));
    assert_eq!((code, err.as_str()), (0, ""), "{out}");
    assert!(out.contains("a thousand is too much"), "{out}");
    folder.toy(&library, "0.5");
    let (code, _, err) = folder.says(&mut folder.command(&["repro", "out/repro/add-0"]));
    assert!(code == 2 && err.contains("its SHA-256 is"), "{err}");
    let (code, out, err) = folder.says(&mut folder.command(&["repro", "out/repro/add-0", "--plugin", &library]));
    assert_eq!(code, 4, "{out}{err}");
    assert!(err.contains("plugin toy: the bundle DIR/"), "{err}");
    // It has moved into a folder of plugins, where another of its name is not taken for it.
    fs::remove_file(folder.path(&library)).unwrap();
    for (folder_name, add, expected) in [("moved", "1", 0), ("other", "3", 2)] {
        let moved = folder.toy(&format!("{folder_name}/{library}"), add);
        let mut repro = folder.command(&["repro", "out/repro/add-0"]);
        let (code, out, err) = folder.says(repro.env("OSTEOFLOW_PLUGIN_PATH", moved.parent().unwrap()));
        assert_eq!(code, expected, "{folder_name}: {out}{err}");
    }
}

#[test]
fn check_knows_ports_and_parameters_of_plugins() {
    let graph =
        naming("[\"toy\"]").replace("number = 40", "number = 5001").replace("number = \"give", "nubmer = \"give");
    let Some(folder) = Folder::new(&graph) else { return };
    folder.toy(&format!("libtoy{DLL_SUFFIX}"), "1");
    let (code, _, err) = folder.says(&mut folder.command(&["check", "graph.toml"]));
    assert_eq!(code, 2);
    assert!(err.contains("graph.toml:8:10") && err.contains("5000"), "{err}");
    assert!(err.contains("did you mean \"number\"?"), "{err}");
    let (code, schema, _) = folder.says(&mut folder.command(&["schema", "--plugin", "toy"]));
    assert_eq!(code, 0);
    assert!(schema.contains("\"toy.add\""));
}

#[test]
fn inspect_shows_the_plugin_of_a_kind_and_its_compiler() {
    let Some(folder) = Folder::new(GRAPH) else { return };
    folder.toy(&format!("libtoy{DLL_SUFFIX}"), "1");
    let file = format!("DIR/libtoy{DLL_SUFFIX}");
    let inspect = |arguments: &[&str]| {
        let (code, out, err) = folder.says(&mut folder.command(&[&["inspect", "--plugin", "toy"], arguments].concat()));
        assert_eq!((code, err.as_str()), (0, ""), "{out}");
        out
    };
    let kind = inspect(&["toy.give"]);
    assert!(kind.contains("Gives three numbers") && kind.contains("≤ 5000"), "{kind}");
    assert!(kind.contains(&format!("from plugin toy 1.2.3 ({file})")), "{kind}");
    assert!(inspect(&[]).contains(&format!("Adds to a number. (from plugin toy 1.2.3 ({file}))")));
    let table = inspect(&["--plugins"]);
    assert!(table.contains("toy.give, toy.add in") && table.contains("osteoflow.h 1.0"), "{table}");
    let json: Value = serde_json::from_str(&inspect(&["--plugins", "--format", "json"])).unwrap();
    assert_eq!(json["plugins"][0]["kinds"], json!(["toy.give", "toy.add"]));
    assert_eq!(json["refused"], json!([]));
}

#[test]
fn the_description_of_a_plugin_is_cached_until_its_file_changes() {
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    let library = folder.toy(&format!("libtoy{DLL_SUFFIX}"), "1");
    let store = folder.path("store");
    let n_cached = || {
        let (code, _, err) = folder.says(folder.command(&["check", "graph.toml"]).env("OSTEOFLOW_CACHE", &store));
        assert_eq!(code, 0, "{err}");
        let names = fs::read_dir(&store).unwrap().map(|entry| entry.unwrap().file_name());
        names.filter(|name| name.to_string_lossy().contains("plugin_probe")).count()
    };
    assert_eq!([n_cached(), n_cached()], [1, 1]);
    folder.toy(&format!("libtoy{DLL_SUFFIX}"), "2");
    assert_eq!([n_cached(), n_cached()], [2, 2]);
    // Cached answers belong to one version of the library.
    let sum = || {
        let mut run = folder.command(&["run", "graph.toml", "--force", "--out", "out"]);
        assert_eq!(folder.says(run.env("OSTEOFLOW_CACHE", &store)).0, 0);
        let n_recalled = json(&folder.path("out/manifest.json"))["store"]["recalled"].as_array().unwrap().len();
        (json(&folder.path("out/results.json"))["sum"]["value"].clone(), n_recalled)
    };
    assert_eq!([sum(), sum()], [(json!(44.0), 0), (json!(44.0), 3)]);
    folder.toy(&format!("libtoy{DLL_SUFFIX}"), "3");
    assert_eq!([sum(), sum()], [(json!(45.0), 0), (json!(45.0), 3)]);
    assert!(library.exists());
}

#[test]
fn a_watch_runs_a_rebuilt_plugin() {
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    let library = format!("libtoy{DLL_SUFFIX}");
    folder.toy(&library, "1");
    let mut child = folder
        .command(&["run", "--watch", "graph.toml", "--out", "out", "--format", "json"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let (send, lines) = sync_channel(1000);
    let stdout = BufReader::new(child.stdout.take().unwrap());
    thread::spawn(move || stdout.lines().map_while(Result::ok).try_for_each(|line| send.send(line)));
    let next = || -> Value { serde_json::from_str(&lines.recv_timeout(LIMIT).expect("the watch answers")).unwrap() };
    assert_eq!(next()["sum"], json!({ "value": 43.0 }));
    folder.toy(&library, "2");
    let second = next();
    assert_eq!(second["sum"], json!({ "value": 44.0 }), "{second}");
    assert!(second.to_string().contains("the plugin of its kind has changed"), "{second}");
    // Overwritten in place, as by `cp`, while the program has the previous version loaded.
    let third = folder.toy("third", "3");
    fs::copy(&third, folder.path(&library)).unwrap();
    let third = next();
    assert_eq!(third["sum"], json!({ "value": 45.0 }), "{third}");
    // Half a library is a fault; the watch continues with the next complete one.
    fs::write(folder.path(&library), "half").unwrap();
    assert_eq!(next()["outcome"]["exit_code"], 2);
    folder.toy(&library, "4");
    assert_eq!(next()["sum"], json!({ "value": 46.0 }));
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Output of `check` for a graph with a good library and each bad one of tests/plugins/bad.
#[test]
#[cfg(target_os = "linux")]
fn each_bad_library_is_refused_by_name_and_everything_else_is_checked() {
    let Some(folder) = Folder::new("") else { return };
    folder.toy("libgood.so", "1");
    let graph = naming("[\"bad\", \"good\"]").replace("number = 40", "number = 9999");
    fs::write(folder.path("graph.toml"), graph).unwrap();
    for bad in bad_libraries(&folder, |name| !name.starts_with("emit_")) {
        let mut check = folder.command(&["check", "graph.toml"]);
        let (code, _, err) = folder.says(check.env("OSTEOFLOW_PLUGIN_TIMEOUT_S", timeout(&bad)));
        assert_eq!(code, 2, "{bad}: {err}");
        assert!(err.contains("5000"), "{bad}: the parameter of the good one is a fault too: {err}");
        assert_golden(&root().join(format!("tests/plugins/bad/{bad}.txt")), &err);
        // A library that was not named explicitly is left out.
        let mut inspect = folder.command(&["inspect", "toy"]);
        inspect.env("OSTEOFLOW_PLUGIN_PATH", folder.0.path()).env("OSTEOFLOW_PLUGIN_TIMEOUT_S", timeout(&bad));
        let (code, out, err) = folder.says(&mut inspect);
        assert_eq!(code, 0, "{bad}: {err}");
        assert!(out.contains("toy.add") && err.contains("libbad.so is left out: "), "{bad}: {out}{err}");
    }
}

/// An invalid answer refuses the run with the name of the node.
#[test]
#[cfg(target_os = "linux")]
fn each_bad_answer_of_a_plugin_is_refused_by_name() {
    let Some(folder) = Folder::new(&naming("[\"bad\"]")) else { return };
    for bad in bad_libraries(&folder, |name| name.starts_with("emit_")) {
        let (code, _, err) = folder.run(&["--quiet"]);
        assert_eq!(code, 3, "{bad}: {err}");
        assert_golden(&root().join(format!("tests/plugins/bad/{bad}.txt")), &err);
    }
}

/// Before poses were checked, this run ended with a mean true TRE of 0.67 mm instead of 0.13 mm.
#[test]
fn a_quaternion_of_a_plugin_that_is_half_a_thousandth_too_long_is_refused_at_its_node() {
    let Some(folder) = Folder::new("") else { return };
    folder.compile("lengthen.c", &format!("liblengthen{DLL_SUFFIX}"), &[]);
    let fibula = root().join("graphs/fibula.toml");
    let nodes = ["to_world", "to_world_laser", "calibration"];
    let swaps = nodes.map(|node| format!("[node.{node}.in]\nt_world_camera_marker = \"longer.pose\"\n"));
    let graph = format!(
        "plugins = [\"lengthen\"]\nextends = {fibula:?}\n[node.longer]\nkind = \"toy.lengthen\"\n\
         in = {{ pose = \"camera_marker.pose\" }}\n{}",
        swaps.concat()
    );
    fs::write(folder.path("graph.toml"), graph).unwrap();
    let small = ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];
    let run = |scale: &str| {
        let set = format!("longer.scale={scale}");
        folder.run(&[&["--quiet", "--no-record", "--set", &set], &small[..]].concat())
    };
    let tre_mm = || {
        let results = json(&folder.path("out/results.json"));
        let tre: Vec<f64> = results["metrics"]["tre_true_mm"]["points"]
            .as_array()
            .unwrap_or_else(|| panic!("{}", results["metrics"]["tre_true_mm"]))
            .iter()
            .map(|point| point["norm"].as_f64().unwrap())
            .collect();
        tre.iter().sum::<f64>() / tre.len() as f64
    };
    let (code, _, err) = run("1.0");
    assert_eq!(code, 0, "{err}");
    let exact_mm = tre_mm();
    // What double precision leaves, and what the limit allows: 0.002 mm at 1 m.
    for scale in ["1.000000000000001", "1.0000005"] {
        let (code, _, err) = run(scale);
        assert_eq!(code, 0, "{scale}: {err}");
        let off_mm = (tre_mm() - exact_mm).abs();
        assert!(off_mm < 0.01, "{scale}: the TRE is off by {off_mm} mm");
    }
    for (scale, said) in [
        ("1.0005", "the quaternion has length 1.0005 instead of 1, off by 5.0e-4 where 1e-6 is allowed"),
        ("0.9995", "off by 5.0e-4 where 1e-6 is allowed"),
        ("0.0", "the quaternion is zero"),
    ] {
        let (code, _, err) = run(scale);
        assert_eq!(code, 3, "{scale}: {err}");
        let place = "node \"longer\", item 0: output \"pose\": geometry/Pose: the view is not a valid payload: \
                     t_world_camera_marker is no rigid motion: ";
        assert!(err.contains(place) && err.contains(said), "{scale}: {err}");
        let refused = json(&folder.path("out/results.json"))["refused"].to_string();
        assert!(refused.contains("longer"), "{refused}");
    }
}

/// Makes `libbad.so` from each file in tests/plugins/bad in turn, and from two that are not libraries.
fn bad_libraries<'f>(folder: &'f Folder, is_wanted: fn(&str) -> bool) -> impl Iterator<Item = String> + 'f {
    let files = fs::read_dir(root().join("tests/plugins/bad")).unwrap().map(|entry| entry.unwrap().path());
    let names = files.filter(|file| file.extension().is_some_and(|e| e == "c"));
    let mut names: Vec<_> = names.map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    names.extend(["text_file".into(), "truncated".into()]);
    names.retain(|name| name != "dependency" && is_wanted(name));
    names.sort();
    names.into_iter().inspect(|name| {
        let library = folder.path("libbad.so");
        match name.as_str() {
            "text_file" => fs::write(&library, "plugins = [\"libbad.so\"]\n").unwrap(),
            "truncated" => fs::write(&library, &fs::read(folder.path("libgood.so")).unwrap()[..200]).unwrap(),
            "missing_dependency" => {
                let dependency = folder.compile("bad/dependency.c", "libdependency.so", &[]);
                let here = format!("-L{}", folder.0.path().display());
                folder.compile("bad/missing_dependency.c", "libbad.so", &[&here, "-ldependency"]);
                fs::remove_file(dependency).unwrap();
            }
            _ => drop(folder.compile(&format!("bad/{name}.c"), "libbad.so", &["-Wno-unused-function"])),
        }
    })
}

/// Short for the library that hangs; long for the others, because the machine may be busy.
fn timeout(bad: &str) -> &'static str {
    if bad == "hang" { "0.5" } else { "60" }
}

#[test]
#[cfg(target_os = "linux")]
fn a_truncated_or_damaged_library_never_crashes_the_program() {
    let Some(folder) = Folder::new(&naming("[\"bad\"]")) else { return };
    let good = fs::read(folder.toy("libgood.so", "1")).unwrap();
    let check = |what: &str, bytes: &[u8]| {
        fs::write(folder.path("libbad.so"), bytes).unwrap();
        let mut check = folder.command(&["check", "graph.toml"]);
        let (code, _, err) = folder.says(check.env("OSTEOFLOW_PLUGIN_TIMEOUT_S", "5"));
        // A changed text or count may also give a valid plugin that does not match the graph.
        assert!(code == 0 || (code == 2 && err.contains("error: ")), "{what}: {code} {err}");
    };
    for eighth in 0..8 {
        check(&format!("{eighth} eighths"), &good[..good.len() * eighth / 8]);
    }
    let mut random = 1u64;
    for _ in 0..if is_slow_run() { 1000 } else { 40 } {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let (at, bit) = ((random >> 33) as usize % good.len(), random >> 61);
        let mut bytes = good.clone();
        bytes[at] ^= 1 << bit;
        check(&format!("bit {bit} of byte {at}"), &bytes);
    }
}

#[test]
fn two_plugins_with_one_kind_are_a_fault_but_not_the_same_library_twice() {
    let Some(folder) = Folder::new(&naming("[\"a\", \"b\"]")) else { return };
    let first = folder.toy(&format!("liba{DLL_SUFFIX}"), "1");
    fs::copy(first, folder.path(&format!("libb{DLL_SUFFIX}"))).unwrap();
    assert_eq!(folder.sum(&[]), json!({ "value": 43.0 }));
    folder.toy(&format!("libb{DLL_SUFFIX}"), "2");
    let (code, _, err) = folder.run(&[]);
    assert_eq!(code, 2);
    let said = "plugin \"b\" is refused: there is a kind \"toy.give\" already, of plugin toy (DIR/liba";
    assert!(err.contains(said) && err.contains("graph.toml:1:17"), "{err}");
}

#[test]
fn a_type_mismatch_between_a_plugin_and_a_built_in_kind_is_a_fault_at_its_line() {
    let graph =
        format!("{}\n[node.crop]\nkind = \"cloud.merge\"\nin = {{ clouds = \"add.sum\" }}\n", naming("[\"toy\"]"));
    let Some(folder) = Folder::new(&graph) else { return };
    folder.toy(&format!("libtoy{DLL_SUFFIX}"), "1");
    let (code, _, err) = folder.says(&mut folder.command(&["check", "graph.toml"]));
    assert_eq!(code, 2);
    assert!(err.contains("takes geometry/Cloud, but \"add.sum\" gives toy/Number"), "{err}");
    assert!(err.contains("graph.toml:22:"), "{err}");
}

#[test]
fn a_parameter_that_a_plugin_refuses_is_shown_where_it_is_set() {
    let graph = naming("[\"toy\"]").replace("\n[record]", "\n[node.add.at]\nlimit = 2\n\n[record]");
    let Some(folder) = Folder::new(&graph) else { return };
    folder.compile("refuse.c", &format!("libtoy{DLL_SUFFIX}"), &["-Wno-unused-function"]);
    let said = ": node \"add\": parameter \"at.limit\": the limit is above 1";
    let (code, _, err) = folder.run(&["--quiet"]);
    assert_eq!(code, 2, "{err}");
    let line = graph.lines().position(|line| line == "limit = 2").unwrap() + 1;
    assert!(err.contains(&format!("graph.toml:{line}{said}")), "{err}");
    let (code, _, err) = folder.run(&["--quiet", "--set", "add.at.limit=3"]);
    assert_eq!(code, 2, "{err}");
    assert!(err.contains(&format!("command line:1{said}")), "{err}");
    assert_eq!(folder.sum(&["--set", "add.at.limit=1"]), json!({ "value": 43.0 }));
}

/// How a run with a plugin that ends the process ended: its exit code or signal, and stderr.
#[cfg(target_os = "linux")]
fn end_of_crash(folder: &Folder, how: &str, arguments: &[&str]) -> (Result<i32, i32>, String) {
    use std::os::unix::process::ExitStatusExt;
    folder.compile(
        "crash.c",
        "libtoy.so",
        &[&format!("-DHOW=\"{how}\""), "-Wno-infinite-recursion", "-Wno-unused-function"],
    );
    let arguments = [&["run", "graph.toml", "--force", "--out", "out"], arguments].concat();
    let output = folder.command(&arguments).output().unwrap();
    let dir = folder.0.path().canonicalize().unwrap();
    let err = String::from_utf8_lossy(&output.stderr).replace(dir.to_str().unwrap(), "DIR");
    (output.status.code().ok_or_else(|| output.status.signal().unwrap()), err)
}

const SIGABRT: i32 = 6;
const SIGSEGV: i32 = 11;

#[test]
#[cfg(target_os = "linux")]
fn a_plugin_that_crashes_is_named_with_its_node_and_item_and_the_signal_ends_the_program() {
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    let at_item = "crashed: node \"add\", item 1, in plugin DIR/libtoy.so: ";
    for workers in ["1", "2"] {
        for (how, signal, said) in [
            ("segfault", SIGSEGV, format!("{at_item}SIGSEGV")),
            ("abort", SIGABRT, format!("{at_item}SIGABRT")),
            // Rust ends the process by an abort after its message.
            ("overflow", SIGABRT, format!("{at_item}SIGSEGV")),
            ("create", SIGSEGV, "crashed: node \"add\", while it was built, in plugin DIR/libtoy.so: ".into()),
            ("thread", SIGSEGV, "crashed: on a thread that no node was called on, during node \"add\", item 1".into()),
        ] {
            let (end, err) = end_of_crash(&folder, how, &["--workers", workers]);
            assert_eq!(end, Err(signal), "{how}: {err}");
            assert!(err.contains(&said), "{how}: {err}");
            assert_eq!(err.matches("crashed: ").count(), 1, "{how}: {err}");
            assert_eq!(err.contains("has overflowed its stack"), how == "overflow", "{how}: {err}");
        }
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_plugin_that_calls_exit_does_not_end_the_program_as_if_all_were_well() {
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    for workers in ["1", "2"] {
        let (end, err) = end_of_crash(&folder, "exit", &["--quiet", "--workers", workers]);
        let said = "ended: node \"add\", item 1, in plugin DIR/libtoy.so: it called exit(), which ends the program\n";
        assert_eq!((end, err.as_str()), (Ok(1), said));
        assert!(!folder.path("out/results.json").exists(), "the run was not whole");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn an_exception_that_leaves_a_plugin_in_cpp_is_named_with_its_node() {
    let graph = GRAPH.replace("toy.add", "toy.throw");
    let Some(folder) = Folder::new(&format!("plugins = [\"toy\", \"throw_out\"]\n{graph}")) else { return };
    if let Err(error) = Command::new("c++").arg("--version").output() {
        return println!("skipped: there is no C++ compiler here: {error}");
    }
    folder.compile("throw_out.cpp", "libthrow_out.so", &[]);
    let (end, err) = end_of_crash(&folder, "", &["--quiet"]);
    assert_eq!(end, Err(SIGABRT), "{err}");
    assert!(err.contains("crashed: node \"add\", item 1, in plugin DIR/libthrow_out.so: SIGABRT"), "{err}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_plugin_that_crashes_when_it_is_destroyed_costs_no_results() {
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    let (end, err) = end_of_crash(&folder, "destroy", &["--quiet"]);
    assert_eq!(end, Err(SIGSEGV), "{err}");
    let said = "node \"add\", while it was destroyed after the files of the run were written, in plugin DIR/libtoy.so";
    assert!(err.contains(said), "{err}");
    assert_eq!(json(&folder.path("out/results.json"))["sum"], json!({ "value": 43.0 }));
    assert_eq!(json(&folder.path("out/manifest.json"))["plugins"][0]["name"], "toy");
    let (code, _, err) = folder.says(&mut folder.command(&["validate", "out/run.mcap"]));
    assert_eq!(code, 0, "{err}");
}

/// A run of a source that gives a lie on one of its ports: exit code and stderr.
#[cfg(unix)]
fn reported(folder: &Folder, how: &str, port: usize) -> (i32, String) {
    let names = ["cloud", "pose", "target", "planes", "points", "mesh"];
    let graph = format!(
        "plugins = [\"lies\"]\n[graph]\nformat = 1\n[node.liar]\nkind = \"lies.give\"\nhow = \"{how}\"\nport = {port}\n\
         [results]\nanswer = \"liar.{}\"\n",
        names[port]
    );
    fs::write(folder.path("graph.toml"), graph).unwrap();
    let (code, _, err) = folder.run(&["--quiet"]);
    (code, err)
}

#[test]
fn what_a_plugin_gives_is_held_to_what_it_means_and_a_lie_is_refused_at_its_node() {
    let Some(folder) = Folder::new("") else { return };
    folder.compile("lies.c", &format!("liblies{DLL_SUFFIX}"), &[]);
    for port in 0..6 {
        let (code, err) = reported(&folder, "", port);
        assert_eq!(code, 0, "without a lie, port {port}: {err}");
    }
    let (cloud, pose, target, planes, points, mesh) = (0, 1, 2, 3, 4, 5);
    let poses = [cloud, pose, planes];
    let stamped = [cloud, pose, planes, points];
    for (how, ports, said) in [
        ("quaternion of length 2", &poses[..], "the quaternion has length 2 instead of 1"),
        ("quaternion, 5e-6 too long", &poses[..], "off by 5.0e-6 where 1e-6 is allowed"),
        ("quaternion of zeros", &poses[..], "the quaternion is zero"),
        ("quaternion of NaN", &poses[..], "the quaternion is not finite"),
        ("translation of infinity", &poses[..], "the translation is not finite"),
        ("normal of length 0.5", &[cloud, target], "normal 1 has length 0.5 instead of 1"),
        ("normal of NaN", &[cloud, target], "normal 1 has length NaN instead of 1"),
        ("point of NaN", &[cloud, target, points, mesh], "is not finite"),
        ("point of infinity", &[cloud, target, points, mesh], "is not finite"),
        ("value of the end of time", &stamped[..], "stamp_ns 9223372036854775807 is more than 146 years from 1970"),
        ("stamp of the end of time", &[mesh], "gave stamp 9223372036854775807 ns, more than 146 years from 1970"),
        ("stamp of the begin of time", &[mesh], "gave stamp -9223372036854775808 ns, more than 146 years from 1970"),
        (
            "stamps that run backwards",
            &stamped[..],
            "gave stamp -1000 ns after 0 ns; stamps never decrease along a wire",
        ),
    ] {
        for port in ports {
            let (code, err) = reported(&folder, how, *port);
            assert_eq!(code, 3, "{how}, port {port}: {err}");
            assert!(err.contains("node \"liar\", item ") && err.contains(said), "{how}, port {port}: {err}");
        }
    }
    // A frame that the graph does not name, of a library in the process of the run.
    for port in 0..6 {
        reported(&folder, "", port);
        let graph = fs::read_to_string(folder.path("graph.toml")).unwrap();
        fs::write(folder.path("graph.toml"), graph.replace("format = 1", "format = 1\nframes = [\"elsewhere\"]"))
            .unwrap();
        let (code, _, err) = folder.run(&["--quiet"]);
        let said = "but the graph's are elsewhere; give one of them, or add it to frames in [graph]";
        assert!(code == 3 && err.contains("node \"liar\", item 0") && err.contains(said), "port {port}: {err}");
    }
}

#[test]
fn check_plugins_names_the_node_that_writes_into_its_input() {
    let Some(folder) = Folder::new("") else { return };
    folder.compile("lies.c", &format!("liblies{DLL_SUFFIX}"), &[]);
    let run = |how: &str, arguments: &[&str]| {
        let graph = format!(
            "plugins = [\"lies\"]\n[graph]\nformat = 1\n[node.give]\nkind = \"lies.give\"\n[node.write]\n\
             kind = \"lies.write\"\nhow = \"{how}\"\nin = {{ cloud = \"give.cloud\" }}\n[results]\nread = \"write.text\"\n"
        );
        fs::write(folder.path("graph.toml"), graph).unwrap();
        let (code, _, err) = folder.run(&[&["--quiet"], arguments].concat());
        (code, err)
    };
    assert_eq!(run("", &["--check-plugins"]), (0, String::new()), "it only reads");
    assert_eq!(run("column", &[]), (0, String::new()), "nobody looked");
    for (how, place) in [("column", "input \"cloud\", column \"points\", row 1"), ("head", "input \"cloud\", the head")]
    {
        let (code, err) = run(how, &["--check-plugins"]);
        assert_eq!(code, 3, "{how}: {err}");
        let said = format!("node \"write\", item 0: it wrote into {place}: lent memory is read-only");
        assert!(err.contains(&said), "{how}: {err}");
    }
}

/// A node that does not return is named while the run goes on, and when the user stops it.
#[test]
#[cfg(target_os = "linux")]
fn a_busy_node_is_named_when_the_run_is_stopped() {
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    folder.compile("crash.c", "libtoy.so", &["-DHOW=\"hang\"", "-Wno-infinite-recursion", "-Wno-unused-function"]);
    let mut child = folder.command(&["run", "graph.toml", "--out", "out"]).stderr(Stdio::piped()).spawn().unwrap();
    let (send, lines) = sync_channel(1000);
    let stderr = BufReader::new(child.stderr.take().unwrap());
    thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| send.send(line)));
    let interrupt = || {
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        lines.recv_timeout(LIMIT).expect("it says that it stops")
    };
    assert!(lines.recv_timeout(LIMIT).unwrap().starts_with("running "));
    while !folder.path("hangs").exists() {
        thread::sleep(Duration::from_millis(20));
    }
    thread::sleep(Duration::from_millis(1500));
    let said = interrupt();
    let busy =
        "stopping after the current work (node \"add\", item 1, busy for 1 s); press Ctrl-C again to leave at once";
    assert_eq!(said.replace("busy for 2 s", "busy for 1 s"), busy);
    assert!(interrupt().starts_with("left: "));
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

/// Describes, builds, fires and frees a node under valgrind. Leaks are not counted, because names of kinds and ports live as
/// long as the process.
#[test]
#[cfg(target_os = "linux")]
fn a_run_with_a_plugin_has_no_memory_errors() {
    if !is_slow_run() {
        return;
    }
    if let Err(error) = Command::new("valgrind").arg("--version").output() {
        println!("skipped: valgrind is missing: {error}");
        return;
    }
    let Some(folder) = Folder::new(&naming("[\"toy\"]")) else { return };
    folder.toy("libtoy.so", "1");
    let run = folder.command(&["run", "graph.toml", "--workers", "2", "--out", "out"]);
    let mut valgrind = Command::new("valgrind");
    valgrind.arg("--error-exitcode=99");
    valgrind.arg(run.get_program()).args(run.get_args()).current_dir(folder.0.path());
    valgrind.env("OSTEOFLOW_CACHE", "off").env("OSTEOFLOW_PLUGIN_TIMEOUT_S", "60");
    let (code, _, err) = folder.says(&mut valgrind);
    assert!(code == 0 && err.contains("ERROR SUMMARY: 0 errors"), "{err}");
    assert_eq!(json(&folder.path("out/results.json"))["sum"], json!({ "value": 43.0 }));
}
