//! `osteoflow new plugin`: its output builds, runs in its graph, and agrees with the built-in kinds; its refusals.
//!
//! The cold build of the crate alone takes longer than a minute on two cores, so it runs only with SLOW_TESTS; the same file is
//! an example of this workspace, which is built with everything else.

use crate::common::{Ran, build, is_slow_run, isometry, osteoflow, osteoflow_to_spawn, root, run_whole};
use serde_json::Value;
use std::{
    env::consts::{DLL_PREFIX, DLL_SUFFIX},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Writes a plugin into a new folder named after it.
fn written(name: &str, arguments: &[&str]) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join(name);
    osteoflow().args(["new", "plugin", name, "--out"]).arg(&folder).args(arguments).assert().success();
    (dir, folder)
}

/// The plugin in Rust, with the SDK of this repository.
fn written_crate(name: &str) -> (tempfile::TempDir, PathBuf) {
    written(name, &["--sdk", root().to_str().unwrap()])
}

fn library(name: &str) -> String {
    format!("{DLL_PREFIX}{name}{DLL_SUFFIX}")
}

/// Runs a command that must succeed.
fn done(command: &mut Command) {
    let output = command.output().unwrap();
    let printed = [output.stdout, output.stderr].map(|printed| String::from_utf8_lossy(&printed).into_owned()).concat();
    assert!(output.status.success(), "{command:?}: {printed}");
}

fn ran(graph: &Path, arguments: &[&str]) -> Ran {
    run_whole(graph.to_str().unwrap(), &[&["--no-record"], arguments].concat())
}

/// Settings of a procedure that takes less time.
const SMALL: [&str; 8] = {
    let [a, b, c, d] = crate::common::WHITE;
    ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true", a, b, c, d]
};

/// Puts a built library where the graph of a written crate expects it, and compares its run with the built-in ICP's.
fn assert_registers_as_built_in(folder: &Path, library_file: &Path) {
    let release = folder.join("target/release");
    fs::create_dir_all(&release).unwrap();
    fs::copy(library_file, release.join(library("my_plugin"))).unwrap();
    let own = ran(&folder.join("graphs/my_plugin.toml"), &SMALL);
    let published = ["--set", "icp.kind=icp.published", "--set", "icp.reading=change_1e-5"];
    let built_in = ran(&folder.join("graphs/fibula.toml"), &[&SMALL[..], &published].concat());
    let poses = [&own, &built_in].map(|ran| isometry(&ran.results["poses"]["t_ct_world"]["matrix"]));
    let apart = (poses[0].to_homogeneous() - poses[1].to_homogeneous()).amax();
    assert!(apart < 1e-9, "{apart} mm between my_plugin.point_to_point and icp.published");
    assert_eq!(own.results["icp"]["iterations"], built_in.results["icp"]["iterations"]);
    let tre_mm = own.results["metrics"]["tre_true_mm"]["mean_abs"]["norm"].as_f64().unwrap();
    assert!(tre_mm < 0.3, "a TRE of {tre_mm} mm, but the built-in ICP leaves 0.16 mm");
}

#[test]
fn the_crate_registers_as_the_built_in_icp_does_to_1e_9_mm_and_logs_through_the_program() {
    // The example has the name of the template.
    let (_dir, folder) = written_crate("my_plugin");
    assert_registers_as_built_in(&folder, &build::example("template_icp"));

    let graph = folder.join("graphs/my_plugin.toml");
    let out = folder.join("out");
    let logged = osteoflow()
        .env("OSTEOFLOW_LOG", "debug")
        .arg("run")
        .arg(graph)
        .args(SMALL)
        .arg("--out")
        .arg(out)
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&logged.stderr).into_owned();
    assert!(printed.contains("registered n_steps=") && printed.contains(" n_pairs=5000 rms_mm=0.1"), "{printed}");
}

/// Builds and tests the written crate alone, then runs its graph.
fn alone(toolchain: &[&str], profile: &[&str]) {
    let (_dir, folder) = written_crate("my_plugin");
    let target = root().join("target/new_plugin").join(toolchain.concat());
    let cargo = |command: &str| {
        let mut cargo = Command::new("cargo");
        // Variables of cargo for this test must not reach another toolchain.
        for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("CARGO") || name.starts_with("RUST")) {
            if !["CARGO_HOME", "RUSTUP_HOME"].contains(&name.as_str()) {
                cargo.env_remove(name);
            }
        }
        cargo.current_dir(&folder).env("CARGO_TARGET_DIR", &target);
        done(cargo.args(toolchain).arg(command).arg("--offline").args(profile));
    };
    cargo("build");
    let built = if profile.is_empty() { "debug" } else { "release" };
    assert_registers_as_built_in(&folder, &target.join(built).join(library("my_plugin")));
    cargo("test");
}

#[test]
fn the_crate_builds_alone_and_its_test_passes() {
    if is_slow_run() {
        alone(&[], &["--release"]);
    }
}

#[test]
fn the_crate_of_another_profile_loads() {
    if is_slow_run() {
        alone(&[], &[]);
    }
}

#[test]
fn the_crate_of_another_compiler_loads() {
    if !is_slow_run() {
        return;
    }
    if Command::new("cargo").args(["+nightly", "--version"]).output().is_ok_and(|output| output.status.success()) {
        alone(&["+nightly"], &["--release"]);
    } else {
        eprintln!("skipped: the_crate_of_another_compiler_loads: there is no nightly toolchain");
    }
}

#[test]
fn the_plugin_in_c_builds_tests_itself_and_crops_as_the_built_in_sphere_to_the_last_bit() {
    assert_crops_as_built_in("c", "cc", "CFLAGS", &[&[], &["test"]]);
}

#[test]
fn the_plugin_in_cpp_builds_without_warnings_and_crops_as_the_built_in_sphere_to_the_last_bit() {
    assert_crops_as_built_in("cpp", "c++", "CXXFLAGS", &[&[]]);
}

fn assert_crops_as_built_in(lang: &str, compiler: &str, flags: &str, targets: &[&[&str]]) {
    let (_dir, folder) = written("my_crop", &["--lang", lang]);
    if ![compiler, "make"].iter().all(|name| Command::new(name).arg("--version").output().is_ok()) {
        eprintln!("skipped: the plugin in {lang}: there is no {compiler} or no make");
        return;
    }
    for target in targets {
        let flags = format!("{flags}=-O2 -Wall -Wextra -Werror -pedantic");
        done(Command::new("make").current_dir(&folder).arg(flags).args(*target));
    }
    let own = ran(&folder.join("graphs/my_crop.toml"), &SMALL);
    let graph = fs::read_to_string(folder.join("graphs/my_crop.toml")).unwrap();
    let built_in = folder.join("graphs/built_in.toml");
    // The built-in one also crops to the region, if there is one.
    let alike = graph.replace("plugins = [\"../build/my_crop\"]", "remove = [\"node.crop.in.region\"]");
    fs::write(&built_in, alike.replace("my_crop.sphere", "crop.sphere")).unwrap();
    assert_eq!(own.results, ran(&built_in, &SMALL).results);
    assert!(own.results["icp"]["n_pairs"].as_u64().unwrap() > 1000);
}

#[test]
fn names_that_make_no_crate_or_no_stage_are_refused_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |arguments: &[&str]| {
        let output = osteoflow().current_dir(dir.path()).args(["new", "plugin"]).args(arguments).assert().code(2);
        String::from_utf8_lossy(&output.get_output().stderr).into_owned()
    };
    for (name, why) in [
        ("MyIcp", "snake case"),
        ("my-icp", "snake case"),
        ("1icp", "snake case"),
        ("../icp", "snake case"),
        ("match", "word of Rust"),
        ("core", "word of Rust"),
        ("icp", "stage of built-in nodes"),
    ] {
        let printed = refused(&[name]);
        assert!(printed.contains(why), "{name}: {printed}");
    }
    assert!(refused(&["my_icp", "--sdk", "."]).contains("engine/node"), "a folder that is no checkout");
    assert!(refused(&["my_crop", "--lang", "c", "--sdk", "."]).contains("--sdk is for Rust"));
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);

    fs::create_dir(dir.path().join("my_icp")).unwrap();
    fs::write(dir.path().join("my_icp/notes.txt"), "mine").unwrap();
    assert!(refused(&["my_icp"]).contains("my_icp is not empty"));
    assert_eq!(fs::read_dir(dir.path().join("my_icp")).unwrap().count(), 1);
}

#[test]
fn what_is_written_is_the_template_under_its_new_name() {
    let (_dir, folder) = written_crate("spiral_icp");
    let text = |path: &str| fs::read_to_string(folder.join(path)).unwrap();
    let template = fs::read_to_string(root().join("nodes/template/rust/icp.rs")).unwrap();
    assert_eq!(text("src/lib.rs"), template.replace("my_plugin", "spiral_icp"));
    assert!(text("graphs/spiral_icp.toml").contains("kind = \"spiral_icp.point_to_point\""));
    let manifest: toml::Table = text("Cargo.toml").parse().unwrap();
    assert_eq!(manifest["package"]["name"].as_str(), Some("spiral_icp"));
    let sdk = manifest["dependencies"]["osteoflow-node"]["path"].as_str().unwrap();
    assert_eq!(Path::new(sdk), root().join("engine/node").canonicalize().unwrap());
    assert!(manifest["workspace"].as_table().unwrap().is_empty() && manifest.contains_key("profile"));

    // Without --sdk it is that of the checkout in which the program lies, which needs no network.
    osteoflow().args(["new", "plugin", "my_icp", "--out"]).arg(folder.join("a")).assert().success();
    let manifest: toml::Table = fs::read_to_string(folder.join("a/Cargo.toml")).unwrap().parse().unwrap();
    let sdk = manifest["dependencies"]["osteoflow-node"]["path"].as_str().unwrap();
    assert_eq!(Path::new(sdk), root().join("engine/node").canonicalize().unwrap());

    // A program that lies elsewhere.
    let program = folder.join("osteoflow");
    fs::copy(osteoflow_to_spawn().get_program(), &program).unwrap();
    let mut elsewhere = Command::new(program);
    elsewhere.args(["new", "plugin", "my_icp", "--format", "json", "--out"]).arg(folder.join("b"));
    let output = elsewhere.output().unwrap();
    // Where this program was built outside git, it asks for the SDK; else it names the revision.
    if output.status.success() {
        let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(printed["commands"].as_array().unwrap().len(), 3);
        assert!(printed["note"].as_str().unwrap().contains("--sdk names a checkout"), "{printed}");
        let manifest: toml::Table = fs::read_to_string(folder.join("b/Cargo.toml")).unwrap().parse().unwrap();
        for name in ["osteoflow-node", "osteoflow-payloads"] {
            let dependency = &manifest["dependencies"][name];
            assert_eq!(dependency["rev"].as_str().unwrap().len(), 40, "{dependency}");
            assert!(dependency["git"].as_str().unwrap().starts_with("https://"), "{dependency}");
        }
    } else {
        assert!(String::from_utf8_lossy(&output.stderr).contains("--sdk"));
    }
}
