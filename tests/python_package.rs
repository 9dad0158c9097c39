//! The Python package: its tests, run by pytest in the environment of the tests.

use crate::common::{is_slow_run, program, python::python, root};
use std::{
    path::PathBuf,
    process::{Command, Output},
};

const PACKAGE: &str = "nodes/python";

/// What the tests need beside the package and NumPy.
const NEEDED: [&str; 2] = ["maturin>=1.7,<2", "pytest"];
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
    for package in if is_slow_run() { &OPTIONAL[..] } else { &[] } {
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

#[test]
fn the_package_gives_the_bits_of_the_command() {
    let python = match environment() {
        Ok(python) => python,
        Err(why) => return skip(&why),
    };
    let target = target();
    let install =
        ["-m", "pip", "install", "--quiet", "--no-build-isolation", "--no-deps", "--disable-pip-version-check"];
    // What cargo has compiled for the program is used again.
    let path = std::env::join_paths(
        std::iter::once(python.parent().unwrap().to_owned())
            .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    );
    let installed = Command::new(&python)
        .args(install)
        .arg(root().join(PACKAGE))
        .env("CARGO_TARGET_DIR", &target)
        .env("PATH", path.unwrap())
        .output()
        .unwrap();
    assert!(installed.status.success(), "pip install ./{PACKAGE}: {}", text(&installed));
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
