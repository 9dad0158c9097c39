//! A run or a sweep as one file, run again in another folder after the first is gone.

use crate::common::{
    TOY_GRAPH, build, copy_folder, json, osteoflow_to_spawn,
    python::{self, HELPED},
    root,
};
use serde_json::{Value, json};
use std::{
    env::consts::DLL_SUFFIX,
    fs::{self, File},
    io::{Read, Write},
    path::{Path, PathBuf},
    process::Command,
};
use zip::{ZipArchive, ZipWriter, write::SimpleFileOptions};

/// Two folders: the one in which the experiment was made, and another.
struct Places {
    dir: tempfile::TempDir,
    python: Option<PathBuf>,
}

impl Places {
    fn new(python: Option<PathBuf>) -> Self {
        let places = Self { dir: tempfile::tempdir().unwrap(), python };
        ["here", "there"].iter().for_each(|name| fs::create_dir(places.path(name)).unwrap());
        places
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        fs::write(self.path(name), text).unwrap();
    }

    /// Exit code and all that was printed of a command in one of the folders.
    fn says(&self, place: &str, arguments: &[&str]) -> (i32, String) {
        self.says_with(place, arguments, |_| {})
    }

    fn says_with(&self, place: &str, arguments: &[&str], with: impl Fn(&mut Command)) -> (i32, String) {
        let mut command = osteoflow_to_spawn();
        command.current_dir(self.path(place)).args(arguments).env("PYTHONDONTWRITEBYTECODE", "1");
        command.envs(self.python.iter().map(|python| ("OSTEOFLOW_PYTHON", python)));
        with(&mut command);
        let output = command.output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code().unwrap(), String::from_utf8_lossy(&text).into_owned())
    }

    fn ends_well(&self, place: &str, arguments: &[&str]) -> String {
        let (code, text) = self.says(place, arguments);
        assert_eq!(code, 0, "{arguments:?}: {text}");
        text
    }

    /// Unpacks an archive by other means; asserts that nothing in it names a folder of this machine.
    fn unpacked(&self, archive: &str) -> PathBuf {
        let to = self.path("unpacked");
        let _ = fs::remove_dir_all(&to);
        let mut zip = ZipArchive::new(File::open(self.path(archive)).unwrap()).unwrap();
        for at in 0..zip.len() {
            let mut entry = zip.by_index(at).unwrap();
            let name = entry.name().unwrap().into_owned();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            let text = String::from_utf8_lossy(&bytes);
            assert!(!text.contains(self.dir.path().to_str().unwrap()), "{name} names the folder: {text}");
            let file = to.join(&name);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, bytes).unwrap();
        }
        to
    }
}

const GRAPH: &str = r#"
plugins = ["st.py"]
[graph]
format = 1
name = "numbers"
[node.src]
kind = "st.src"
[node.f]
kind = "st.f"
in = { cloud = "src.cloud" }
[record]
wires = ["*"]
[results]
f = "f.r"
[sweep]
repeat = 3
[sweep.columns]
number = "f.number"
"#;

/// A sweep and a run with a plugin that is two files; `None` without Python.
fn with_plugin(test: &str) -> Option<Places> {
    let places = Places::new(Some(python::python(test)?));
    for (name, text) in [("st.py", HELPED), ("g.toml", GRAPH), ("helper.py", "SCALE = 1.5\n")] {
        places.write(&format!("here/{name}"), text);
    }
    Some(places)
}

#[test]
fn a_sweep_with_a_plugin_runs_again_from_one_file_after_its_folder_is_gone() {
    let Some(places) = with_plugin("a sweep with a plugin as one file") else { return };
    places.ends_well("here", &["sweep", "g.toml", "--out", "s"]);
    places.ends_well("here", &["export", "s", "../s.zip"]);
    places.ends_well("here", &["export", "s", "../s2.zip"]);
    assert!(fs::read(places.path("s.zip")).unwrap() == fs::read(places.path("s2.zip")).unwrap(), "not the same bytes");
    let (code, text) = places.says("here", &["export", "s", "../s.zip"]);
    assert!(code == 2 && text.contains("nothing is overwritten"), "{text}");
    let unpacked = places.unpacked("s.zip");
    let lock = fs::read_to_string(unpacked.join("requirements.lock")).unwrap();
    assert!(lock.lines().any(|line| line.starts_with("numpy==")) && lock.contains("# CPython 3."), "{lock}");
    fs::remove_dir_all(places.path("here")).unwrap();

    let text = places.ends_well("there", &["info", "../s.zip"]);
    assert!(
        text.contains("a sweep of the graph numbers") && text.contains("plugins/1/helper.py, plugins/1/st.py"),
        "{text}"
    );
    assert!(text.contains("osteoflow sweep ../s.zip --allow-plugins --out again"), "{text}");
    let (code, text) = places.says("there", &["sweep", "../s.zip", "--out", "again"]);
    assert!(code == 2 && text.contains("plugins/1/st.py") && text.contains("--allow-plugins"), "{text}");
    assert!(!places.path("there/s").exists(), "something was unpacked");
    places.ends_well("there", &["sweep", "../s.zip", "--allow-plugins", "--out", "again"]);
    let text = places.ends_well("there", &["compare", "../s.zip", "again"]);
    assert!(text.contains("runs.csv: equal, byte for byte") && text.ends_with("equal\n"), "{text}");
    assert!(fs::read_to_string(places.path("there/again/runs.csv")).unwrap().contains("1.5"));
    // What was unpacked stays, and a sweep goes on from it.
    fs::remove_file(places.path("there/again/runs/000002.json")).unwrap();
    places.ends_well("there", &["sweep", "../s.zip", "--allow-plugins", "--out", "again", "--resume"]);
    places.ends_well("there", &["compare", "--same", "again", "../s.zip"]);
    // One row of it, to look at.
    places.ends_well("there", &["sweep", "../s.zip", "--allow-plugins", "--only", "2", "--record", "row"]);
    let [one, row] = ["again/runs/000002.json", "row/results.json"].map(|name| {
        let text = fs::read_to_string(places.path(&format!("there/{name}"))).unwrap();
        serde_json::from_str::<Value>(&text).unwrap()
    });
    assert_eq!(one["results"], row);
    // An edited module is another experiment, and not taken for this one.
    places.write("there/s/plugins/1/helper.py", "SCALE = 2.5\n");
    let (code, text) = places.says("there", &["sweep", "../s.zip", "--allow-plugins", "--out", "other"]);
    assert!(code == 2 && text.contains("s holds something else than ../s.zip"), "{text}");
    // The folder itself is run as it is, and the comparison says value and cause.
    places.ends_well("there", &["sweep", "s", "--allow-plugins", "--out", "other"]);
    let (code, text) = places.says("there", &["compare", "../s.zip", "other"]);
    assert!(code == 4 && text.contains("runs.csv, run 0: number 1.5 and 2.5 (+1e0)"), "{code} {text}");
    assert!(
        text.contains("helper (") && text.contains("helper.py) differs") && text.contains("3 values differ"),
        "{text}"
    );
}

#[test]
fn a_rerun_with_another_package_says_which() {
    let Some(places) = with_plugin("a rerun with another package") else { return };
    for version in ["1.0", "2.0"] {
        let site = format!("site-{version}");
        places.write(
            &format!("{site}/scales-{version}.dist-info/METADATA"),
            &format!("Name: scales\nVersion: {version}\n"),
        );
        places.write(&format!("{site}/scales-{version}.dist-info/top_level.txt"), "scales\n");
        places.write(&format!("{site}/scales/__init__.py"), &format!("SCALE = {version}\n"));
    }
    let with = |version: &str| {
        let site = places.path(&format!("site-{version}"));
        move |command: &mut Command| {
            command.env("PYTHONPATH", &site);
        }
    };
    places.write("here/helper.py", "from scales import SCALE\n");
    assert_eq!(places.says_with("here", &["run", "g.toml", "--out", "r"], with("1.0")).0, 0);
    places.ends_well("here", &["export", "r", "../r.zip"]);
    assert!(fs::read_to_string(places.unpacked("r.zip").join("requirements.lock")).unwrap().contains("scales==1.0\n"));
    for (version, code) in [("1.0", 0), ("2.0", 4)] {
        let out = format!("again-{version}");
        let (ended, text) =
            places.says_with("there", &["run", "../r.zip", "--allow-plugins", "--out", &out], with(version));
        assert_eq!(ended, 0, "{text}");
        let (said, text) = places.says("there", &["compare", "../r.zip", &out]);
        assert_eq!(said, code, "{text}");
        assert_eq!(text.contains("scales 1.0 against 2.0"), code == 4, "{text}");
        assert_eq!(text.contains("f.number: 1.0 and 2.0 (+1e0)"), code == 4, "{text}");
    }
}

const FILES: &str = r#"
[graph]
format = 1
name = "files"
frames = ["ct"]
[node.bone]
kind = "surface.any"
path = "HERE/in/bone.stl"
[node.scan]
kind = "acquire.cloud"
path = "in/scan.ply"
[node.crop]
kind = "crop.box"
in   = { cloud = "scan.cloud" }
min_mm = [-1000, -1000, -1000]
[node.write]
kind = "output.ply"
in = { cloud = "crop.cloud" }
[record]
wires = ["bone.report", "crop.*"]
[results]
bone = "bone.report"
crop = "crop.cloud"
[sweep.factor]
scan = { key = "scan.path", values = ["in/scan.ply", "HERE/in/second.ply"] }
[sweep.columns]
n = "crop.n_points"
"#;

/// A graph that reads files, by relative and absolute paths.
fn with_files() -> Places {
    let places = Places::new(None);
    let ply = |n: u32| {
        let rows: String = (0..n).map(|k| format!("{k} {} 0\n", k * k % 7)).collect();
        format!(
            "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n{rows}"
        )
    };
    places.write("here/in/scan.ply", &ply(20));
    places.write("here/in/second.ply", &ply(30));
    fs::copy(root().join("tests/data/folder/bone.stl"), places.path("here/in/bone.stl")).unwrap();
    places.write("here/g.toml", &FILES.replace("HERE", places.path("here").to_str().unwrap()));
    places
}

#[test]
fn inputs_travel_with_a_sweep_or_are_found_by_their_contents() {
    let places = with_files();
    places.ends_well("here", &["sweep", "g.toml", "--out", "s"]);
    places.ends_well("here", &["export", "s", "../s.zip"]);
    places.ends_well("here", &["export", "s", "../bare.zip", "--no-data"]);
    places.ends_well("here", &["sweep", "g.toml", "--shard", "1/2", "--out", "part"]);
    let (code, text) = places.says("here", &["export", "part", "../part.zip"]);
    assert!(code == 2 && text.contains("part is part 1/2 of a sweep") && text.contains("--merge"), "{text}");
    places.ends_well("here", &["run", "g.toml", "--out", "r"]);
    places.unpacked("bare.zip");
    let unpacked = places.unpacked("s.zip");
    let source = fs::read_to_string(unpacked.join("sources/g.toml")).unwrap();
    assert!(source.contains("\"inputs/1/bone.stl\"") && source.contains("[sweep.factor]"), "{source}");
    // A file that is no longer what was read is not packed.
    fs::rename(places.path("here/in"), places.path("moved")).unwrap();
    fs::rename(places.path("moved/second.ply"), places.path("moved/renamed.ply")).unwrap();
    places.write("here/in/scan.ply", "ply\n");
    let (code, text) = places.says("here", &["export", "s", "../x.zip"]);
    assert!(
        code == 2 && text.contains("3 input files are not what the sweep read") && text.contains("scan.ply ("),
        "{text}"
    );
    assert!(!places.path("x.zip").exists());
    places.ends_well("here", &["export", "s", "../x.zip", "--data", "../moved"]);
    assert!(
        fs::read(places.path("s.zip")).unwrap() == fs::read(places.path("x.zip")).unwrap(),
        "other bytes than before"
    );
    // A run names its files from the folder of the graph, as its manifest does.
    places.ends_well("here", &["export", "r", "../r.zip", "--data", "../moved"]);
    places.unpacked("r.zip");
    fs::remove_dir_all(places.path("here")).unwrap();

    places.ends_well("there", &["sweep", "../s.zip", "--out", "again"]);
    let text = places.ends_well("there", &["compare", "../s.zip", "again"]);
    assert!(text.contains("runs.csv: equal, byte for byte"), "{text}");
    let (code, text) = places.says("there", &["sweep", "../bare.zip", "--out", "bare-again"]);
    assert!(
        code == 2
            && text.contains("3 inputs were left out")
            && text.contains("inputs/1/scan.ply (")
            && text.contains("--data DIR"),
        "{text}"
    );
    let (code, text) = places.says("there", &["sweep", "../bare.zip", "--out", "bare-again", "--data", "again"]);
    assert!(code == 2 && text.contains("no file of the --data folders has their contents"), "{text}");
    places.ends_well("there", &["sweep", "../bare.zip", "--out", "bare-again", "--data", "../moved"]);
    places.ends_well("there", &["compare", "../s.zip", "bare-again"]);
    places.ends_well("there", &["run", "../r.zip", "--out", "run-again", "--unpack", "of-run"]);
    let text = places.ends_well("there", &["compare", "../r.zip", "run-again"]);
    assert!(text.contains("results.json: equal") && text.contains("run.mcap (items): equal"), "{text}");
    // Another setting is another experiment, whose numbers are named.
    places.ends_well(
        "there",
        &["run", "../r.zip", "--unpack", "of-run", "--set", "crop.min_mm=[5,-1000,-1000]", "--out", "other"],
    );
    let (code, text) = places.says("there", &["compare", "../r.zip", "other"]);
    assert!(
        code == 4 && text.contains("crop.n_points: 20 and 15 (-5e0)") && text.contains("wire crop.cloud"),
        "{text}"
    );
}

#[test]
fn an_export_is_the_same_archive_from_any_folder() {
    let places = Places::new(None);
    let graph = "[graph]\nformat = 1\nframes = [\"camera\"]\n[node.scan]\nkind = \"acquire.cloud\"\npath = \"s.xyz\"\n\
                 frame = \"camera\"\n[node.keep]\nkind = \"output.ply\"\nin = { cloud = \"scan.cloud\" }\n";
    places.write("here/a/g.toml", graph);
    places.write("here/a/s.xyz", "1.0 2.0 3.0\n4.0 5.0 6.0\n");
    places.ends_well("here", &["run", "a/g.toml", "--out", "r", "--quiet"]);
    let archive = |place: &str, run: &str, name: &str| {
        let to = places.path(name);
        places.ends_well(place, &["export", run, to.to_str().unwrap(), "--quiet"]);
        fs::read(to).unwrap()
    };
    let absolute = places.path("here/r");
    let here = archive("here", "r", "one.zip");
    assert!(here == archive("there", "../here/r", "two.zip") && here == archive("here/a", "../r", "three.zip"));
    assert!(here == archive("there", absolute.to_str().unwrap(), "four.zip"));
    // A graph of the same name in the current folder is another one.
    places.write("there/a/g.toml", graph);
    assert!(here == archive("there", "../here/r", "five.zip"));
}

#[test]
fn a_folder_that_is_read_as_a_whole_travels_with_the_files_of_it_that_are_named_too() {
    let places = Places::new(None);
    fs::create_dir_all(places.path("here/tests/data")).unwrap();
    copy_folder(&root().join("graphs"), &places.path("here/graphs"));
    copy_folder(&root().join("tests/data/folder"), &places.path("here/tests/data/folder"));
    places.ends_well("here", &["run", "graphs/fibula_folder.toml", "--out", "r"]);
    places.ends_well("here", &["export", "r", "../r.zip"]);
    let unpacked = places.unpacked("r.zip");
    assert!(
        unpacked.join("inputs/1/folder/bone.stl").is_file() && unpacked.join("sources/fibula_recorded.toml").is_file()
    );
    fs::remove_dir_all(places.path("here")).unwrap();
    places.ends_well("there", &["run", "../r.zip", "--out", "again"]);
    let text = places.ends_well("there", &["compare", "../r.zip", "again"]);
    assert!(text.contains("results.json: equal"), "{text}");
}

#[test]
fn a_run_without_results_has_its_reason_again_at_another_line() {
    let places = with_files();
    let graph = fs::read_to_string(places.path("here/g.toml")).unwrap()
        + "[sweep.draw]\nx = { key = \"crop.min_mm\", choice = [[900.0, 900.0, 900.0]] }\n";
    places.write("here/g.toml", &graph);
    places.says("here", &["sweep", "g.toml", "--out", "s"]);
    let reasons = fs::read_to_string(places.path("here/s/runs.csv")).unwrap();
    assert!(reasons.contains("g.toml:") && reasons.contains("node \"\"crop\"\""), "{reasons}");
    places.ends_well("here", &["export", "s", "../s.zip"]);
    places.unpacked("s.zip");
    fs::remove_dir_all(places.path("here")).unwrap();
    places.says("there", &["sweep", "../s.zip", "--out", "again"]);
    let text = places.ends_well("there", &["compare", "../s.zip", "again"]);
    assert!(text.contains("another line of the graph") && text.ends_with("equal\n"), "{text}");
}

#[test]
fn a_compiled_plugin_travels_with_a_run() {
    let places = Places::new(None);
    let library = places.path(&format!("here/libtoy{DLL_SUFFIX}"));
    if !build::compile(Path::new("tests/plugins/toy.c"), &library, &["-DADD=1"]) {
        return;
    }
    places.write("here/g.toml", &format!("plugins = [\"toy\"]\n{TOY_GRAPH}"));
    places.ends_well("here", &["run", "g.toml", "--out", "r"]);
    places.ends_well("here", &["export", "r", "../r.zip"]);
    places.unpacked("r.zip");
    fs::remove_dir_all(places.path("here")).unwrap();
    places.ends_well("there", &["run", "../r.zip", "--allow-plugins", "--out", "again"]);
    places.ends_well("there", &["compare", "../r.zip", "again"]);
    let (code, text) = places.says("there", &["run", "../r.zip", "--no-plugins", "--out", "without"]);
    assert!(code == 2 && text.contains("no plugins are loaded here"), "{text}");
}

/// Rewrites an archive: each file by its name, and what `change` gives for it.
fn forged(
    from: &Path,
    to: &Path,
    change: impl Fn(&str, Vec<u8>) -> Option<Vec<u8>>,
    add: impl FnOnce(&mut ZipWriter<File>),
) {
    let mut zip = ZipArchive::new(File::open(from).unwrap()).unwrap();
    let mut out = ZipWriter::new(File::create(to).unwrap());
    for at in 0..zip.len() {
        let mut entry = zip.by_index(at).unwrap();
        let (name, mut bytes) = (entry.name().unwrap().into_owned(), Vec::new());
        entry.read_to_end(&mut bytes).unwrap();
        if let Some(bytes) = change(&name, bytes) {
            out.start_file(&*name, SimpleFileOptions::default()).unwrap();
            out.write_all(&bytes).unwrap();
        }
    }
    add(&mut out);
    out.finish().unwrap();
}

/// What changes the list of the files of an archive.
fn listed(edit: impl Fn(&mut Value)) -> impl Fn(&str, Vec<u8>) -> Option<Vec<u8>> {
    move |name, bytes| {
        if name != "experiment.json" {
            return Some(bytes);
        }
        let mut index: Value = serde_json::from_slice(&bytes).unwrap();
        edit(&mut index);
        Some(index.to_string().into_bytes())
    }
}

#[test]
fn an_archive_of_a_stranger_writes_nothing_outside_of_its_folder_and_unpacks_to_no_more_than_it_says() {
    let places = with_files();
    places.ends_well("here", &["run", "g.toml", "--out", "r"]);
    places.ends_well("here", &["export", "r", "../r.zip"]);
    let from = places.path("r.zip");
    let keep = |_: &str, bytes: Vec<u8>| Some(bytes);
    let entry = |path: &str, bytes: u64| json!({ "path": path, "role": "result", "bytes": bytes, "sha256": "00", "included": true });
    let push = |entry: Value| move |index: &mut Value| index["files"].as_array_mut().unwrap().push(entry.clone());
    let file = |name: &'static str| {
        move |zip: &mut ZipWriter<File>| {
            zip.start_file(name, SimpleFileOptions::default()).unwrap();
            zip.write_all(b"owned").unwrap();
        }
    };
    let is_refused = |what: &str, said: &str| {
        for (command, out) in [("run", "--out"), ("sweep", "--out")] {
            let (code, text) = places.says("there", &[command, "../forged.zip", out, "again"]);
            assert!(code != 0 && text.contains(said), "{what}: {code} {text}");
        }
        let (code, text) = places.says("there", &["compare", "../forged.zip", "../here/r"]);
        assert!(code != 0 && text.contains(said), "{what}: {code} {text}");
        let left: Vec<_> =
            fs::read_dir(places.path("there")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(left.is_empty(), "{what}: {left:?} was left");
        assert!(!places.path("evil").exists() && !places.path("there/evil").exists(), "{what}");
    };
    let to = places.path("forged.zip");

    forged(&from, &to, listed(push(entry("../evil", 5))), file("../evil"));
    is_refused("a name with ..", "leads out of the archive");
    let absolute = places.path("evil").display().to_string();
    forged(&from, &to, listed(push(entry(&absolute, 5))), |_| {});
    is_refused("an absolute name", "leads out of the archive");
    forged(&from, &to, keep, file("evil"));
    is_refused("a file that is not listed", "it is not listed");
    forged(&from, &to, listed(push(entry("evil", 7))), |zip| {
        zip.add_symlink("evil", "../evil", SimpleFileOptions::default()).unwrap();
    });
    is_refused("a link", "it is a link or a folder");
    forged(&from, &to, listed(push(entry("evil", 5))), file("evil"));
    is_refused("another content", "its SHA-256 is another");
    forged(&from, &to, |name, bytes| (name != "results/results.json").then_some(bytes), |_| {});
    is_refused("a missing file", "is listed, and missing");
    forged(&from, &to, listed(push(entry("evil", 1 << 40))), file("evil"));
    is_refused("a bomb that says so", "would unpack to");
    forged(&from, &to, listed(push(entry("evil", 5))), |zip| {
        zip.start_file("evil", SimpleFileOptions::default()).unwrap();
        (0..64).for_each(|_| zip.write_all(&[0; 1 << 20]).unwrap());
    });
    is_refused("a bomb that does not", "its size is not the listed one");
    forged(&from, &to, |name, bytes| (name != "experiment.json").then_some(bytes), |_| {});
    is_refused("another zip", "it has no experiment.json");

    // A graph that names code outside of the archive: it is not loaded, also where the archive's own would be.
    let mark = places.path("mark");
    places.write("evil.py", &format!("open({:?}, 'w').close()\n", mark.display().to_string()));
    let graph = format!("plugins = [{:?}]\n", places.path("evil.py").display().to_string());
    let graph = graph + &fs::read_to_string(places.unpacked("r.zip").join("graph.toml")).unwrap();
    let digest = osteoflow_engine::hash::Digest::of(graph.as_bytes()).to_string();
    let list = listed(|index| {
        let entry =
            index["files"].as_array_mut().unwrap().iter_mut().find(|entry| entry["path"] == "graph.toml").unwrap();
        (entry["sha256"], entry["bytes"]) = (digest.as_str().into(), graph.len().into());
    });
    let change = |name: &str, bytes: Vec<u8>| {
        if name == "graph.toml" { Some(graph.clone().into_bytes()) } else { list(name, bytes) }
    };
    forged(&from, &to, change, |_| {});
    for allow in [&[][..], &["--allow-plugins"]] {
        let (code, text) = places.says("there", &[&["run", "../forged.zip", "--out", "again"][..], allow].concat());
        assert!(code == 2 && text.contains("evil.py") && !mark.exists(), "{code} {text}");
    }
}

#[test]
fn the_metadata_of_an_archive_describes_each_of_its_files_and_is_a_workflow_run_crate() {
    let places = with_files();
    places.ends_well("here", &["sweep", "g.toml", "--out", "s"]);
    places.ends_well("here", &["export", "s", "../s.zip", "--licence", "https://creativecommons.org/licenses/by/4.0/"]);
    let dir = places.unpacked("s.zip");
    let metadata = json(&dir.join("ro-crate-metadata.json"));
    let entities = metadata["@graph"].as_array().unwrap();
    let entity = |id: &str| entities.iter().find(|entity| entity["@id"] == id).unwrap_or_else(|| panic!("no {id}"));
    let mut parts: Vec<&str> =
        entity("./")["hasPart"].as_array().unwrap().iter().map(|part| part["@id"].as_str().unwrap()).collect();
    for part in &parts {
        let about = entity(part);
        assert_eq!(about["contentSize"], fs::metadata(dir.join(part)).unwrap().len().to_string(), "{part}");
        assert_eq!(about["sha256"].as_str().unwrap().len(), 64, "{part}");
    }
    parts.extend(["experiment.json", "ro-crate-metadata.json"]);
    parts.sort_unstable();
    let mut zip = ZipArchive::new(File::open(places.path("s.zip")).unwrap()).unwrap();
    let mut names: Vec<_> = (0..zip.len()).map(|at| zip.by_index(at).unwrap().name().unwrap().into_owned()).collect();
    names.sort();
    assert_eq!(parts, names);
    let licence = &entity("./")["license"]["@id"];
    assert_eq!(entity(licence.as_str().unwrap())["@type"], "CreativeWork");
    assert_eq!(entity("#run")["instrument"]["@id"], "graph.toml");
    assert_eq!(entity("#run")["object"].as_array().unwrap().len(), 3);
    assert!(entity("graph.toml")["@type"].as_array().unwrap().contains(&"ComputationalWorkflow".into()));

    let validator = std::env::var_os("OSTEOFLOW_ROCRATE_VALIDATOR").unwrap_or("rocrate-validator".into());
    let mut command = Command::new(validator);
    command.args(["-y", "validate", "--no-paging", "-np", "-p", "workflow-run-crate", "-l", "required"]).arg(&dir);
    let Ok(output) = command.output() else {
        println!("skipped: the metadata of an archive is a workflow run crate: no rocrate-validator");
        return;
    };
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    if ["urlopen error", "Failed to resolve", "NameResolutionError"].iter().any(|no_network| text.contains(no_network))
    {
        println!("skipped: the metadata of an archive is a workflow run crate: its contexts cannot be fetched");
        return;
    }
    assert!(output.status.success(), "{text}");
}
