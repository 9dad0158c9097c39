//! The Python package: the wheel, tried in a fresh environment without Rust, and its tests, run by pytest in the environment of the tests.

use crate::common::{is_slow_run, program, python::python, root};
use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::OnceLock,
};

const PACKAGE: &str = "nodes/python";

/// What the tests need beside the package and NumPy.
const NEEDED: [&str; 2] = ["maturin>=1.7,<2", "pytest"];
/// What the module for 3D Slicer needs beside them; its tests are left out without it.
const VTK: &str = "vtk";
/// What single tests need, which are left out without it: installed with `SLOW_TESTS`.
const OPTIONAL: [&str; 6] = ["pandas", "matplotlib", "nbclient", "ipykernel", "dask[distributed]", "optuna"];

fn skip(why: &str) {
    eprintln!("skipped: python package: {why}");
}

/// The folder for what is built: that of the test itself.
fn target() -> PathBuf {
    let program = program();
    program.ancestors().nth(2).unwrap().to_owned()
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// The Python of an environment with what the tests need; `None` if there is none, with the reason.
fn environment() -> Result<PathBuf, String> {
    let system = if cfg!(windows) { "python" } else { "python3" };
    let newer = "import sys; sys.exit(sys.version_info < (3, 9))";
    match Command::new(system).args(["-c", newer]).status() {
        Ok(status) if status.success() => {}
        Ok(_) => return Err(format!("{system} is older than 3.9")),
        Err(error) => return Err(format!("{system}: {error}")),
    }
    let python = python("python package").ok_or("no environment can be made")?;
    let install = |packages: &[&str]| {
        let options = ["-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check"];
        let patience = ["--retries=1", "--timeout=20"];
        let installed = Command::new(&python).args(options).args(patience).args(packages).output();
        let installed = installed.map_err(|error| error.to_string())?;
        let why = || format!("pip installs no {}: {}", packages.join(", "), text(&installed).trim());
        if installed.status.success() { Ok(()) } else { Err(why()) }
    };
    install(&NEEDED)?;
    for package in [VTK].iter().chain(if is_slow_run() { &OPTIONAL[..] } else { &[] }) {
        if let Err(why) = install(&[package]) {
            eprintln!("python package: {why}");
        }
    }
    // Compiles what is imported, which is a small part of the packages; the tests write no bytecode.
    let optional = ["pandas", "matplotlib.pyplot", "nbclient", "ipykernel.kernelapp", "distributed", "optuna"];
    for package in ["pytest"].iter().chain(if is_slow_run() { &optional[..] } else { &[] }) {
        let mut import = Command::new(&python);
        let _ = import.args(["-c", &format!("import {package}")]).env_remove("PYTHONDONTWRITEBYTECODE").output();
    }
    Ok(python)
}

/// The wheel that nodes/python/wheel.py builds, and the Python of the environment; made once. What cargo has compiled for the program is
/// used again.
pub(crate) fn wheel() -> Result<(PathBuf, PathBuf), String> {
    static WHEEL: OnceLock<Result<(PathBuf, PathBuf), String>> = OnceLock::new();
    let built = WHEEL.get_or_init(|| {
        let python = environment()?;
        let out = tempfile::tempdir_in(target()).unwrap().keep();
        let mut build = script(&python);
        build.args(["--no-try", "--maturin"]).arg(&python).arg("--out").arg(&out);
        let output = build.output().unwrap();
        assert!(output.status.success(), "nodes/python/wheel.py: {}", text(&output));
        let mut wheels = std::fs::read_dir(&out).unwrap();
        let wheel = wheels.next().unwrap().unwrap().path();
        // One place for it, so that none are left behind.
        let kept = target().join("wheels").join(wheel.file_name().unwrap());
        std::fs::create_dir_all(kept.parent().unwrap()).unwrap();
        std::fs::rename(&wheel, &kept).unwrap();
        std::fs::remove_dir(&out).unwrap();
        Ok((kept, python))
    });
    built.clone()
}

/// The script that builds and tries a wheel.
fn script(python: &Path) -> Command {
    let mut script = Command::new(python);
    script.arg(root().join(PACKAGE).join("wheel.py")).env("CARGO_TARGET_DIR", target());
    script.env("PYTHONDONTWRITEBYTECODE", "1");
    script
}

#[test]
fn a_wheel_works_in_a_fresh_environment_without_rust() {
    let (wheel, python) = match wheel() {
        Ok(built) => built,
        Err(why) => return skip(&why),
    };
    let name = wheel.file_name().unwrap().to_str().unwrap();
    assert!(name.starts_with(concat!("osteoflow-", env!("CARGO_PKG_VERSION"), "-cp39-abi3-")), "{name}");
    if cfg!(target_os = "linux") {
        assert!(
            name.contains("-manylinux_2_") || name.contains("-musllinux_"),
            "{name}: pip would not take it elsewhere"
        );
    }
    let tried = script(&python).arg("--wheel").arg(&wheel).output().unwrap();
    assert!(tried.status.success(), "{}", text(&tried));
    print!("{}", String::from_utf8_lossy(&tried.stdout));
    for (python, numpy) in if is_slow_run() { other_pythons() } else { Vec::new() } {
        let tried =
            script(&python).arg("--wheel").arg(&wheel).args(["--numpy", &numpy, "--python"]).arg(&python).output();
        let tried = tried.unwrap();
        assert!(tried.status.success(), "{}, {numpy}: {}", python.display(), text(&tried));
        print!("{}", String::from_utf8_lossy(&tried.stdout));
    }
}

/// The other interpreters of this machine, each with the newest numpy, and those of the oldest numpy.
fn other_pythons() -> Vec<(PathBuf, String)> {
    let versions = std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".pyenv/versions"));
    let of_pyenv = versions.and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let folders: Vec<PathBuf> = of_pyenv
        .map(|version| version.path().join("bin"))
        .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap()))
        .collect();
    let mut found = Vec::new();
    for minor in 9..=14 {
        let name = format!("python3.{minor}");
        match folders.iter().map(|folder| folder.join(&name)).find(|python| python.is_file()) {
            Some(python) if minor == 9 => {
                found.extend(["numpy", "numpy==1.22.4"].map(|numpy| (python.clone(), numpy.to_owned())));
            }
            Some(python) => found.push((python, "numpy".to_owned())),
            None => skip(&format!("there is no {name}")),
        }
    }
    found
}

#[test]
fn the_package_gives_the_bits_of_the_command() {
    let (wheel, python) = match wheel() {
        Ok(built) => built,
        Err(why) => return skip(&why),
    };
    let install = ["-m", "pip", "install", "--quiet", "--no-deps", "--force-reinstall", "--disable-pip-version-check"];
    let installed = Command::new(&python).args(install).arg(&wheel).output().unwrap();
    assert!(installed.status.success(), "pip install {}: {}", wheel.display(), text(&installed));
    let tested = Command::new(&python)
        .args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "-o", "faulthandler_timeout=120"])
        .arg(root().join(PACKAGE).join("tests"))
        .env("OSTEOFLOW_COMMAND", program())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .current_dir(root())
        .output()
        .unwrap();
    assert!(tested.status.success(), "{}", text(&tested));
    // Tests that pytest left out are counted here, by their names.
    for line in text(&tested).lines().filter(|line| line.contains("skipped") || line.starts_with("SKIPPED")) {
        eprintln!("skipped: python package: {line}");
    }
}
