//! Passes the commit and the build settings to the program, which writes them into recordings. Outside git there is no
//! commit, which is not an error.

use std::{env, path::Path, process::Command};

/// The sources of the program; a change of other files leaves it unchanged.
const SOURCES: [&str; 4] = ["engine", "nodes", "Cargo.toml", "Cargo.lock"];

fn main() {
    let rustc = env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    set_variable("GIT_REVISION", &revision().unwrap_or_default());
    set_variable("COMPILER", &stdout_of(&rustc, &["--version"]).unwrap_or_default());
    set_variable("RUSTFLAGS", &flags.replace('\u{1f}', " "));
    for (name, variable) in [("TARGET", "TARGET"), ("TARGET_FEATURES", "CARGO_CFG_TARGET_FEATURE")] {
        set_variable(name, &env::var(variable).unwrap_or_default());
    }
    SOURCES.iter().for_each(|path| println!("cargo::rerun-if-changed={path}"));
    // The first changes when another branch is checked out, the second with each commit.
    for file in ["HEAD", "logs/HEAD"] {
        let path = stdout_of("git", &["rev-parse", "--git-path", file]);
        if let Some(path) = path.filter(|path| Path::new(path).exists()) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
}

fn set_variable(name: &str, value: &str) {
    println!("cargo::rustc-env=OSTEOFLOW_BUILD_{name}={value}");
}

/// The commit, and whether the sources differ from it; `None` if this folder is only inside another repository.
fn revision() -> Option<String> {
    if !stdout_of("git", &["rev-parse", "--show-prefix"])?.is_empty() {
        return None;
    }
    let commit = stdout_of("git", &["rev-parse", "HEAD"])?;
    let changed = stdout_of("git", &[&["status", "--porcelain", "--"][..], &SOURCES].concat())?;
    Some(if changed.is_empty() { commit } else { format!("{commit}, changed") })
}

/// The stdout of a program; `None` if it is missing or fails.
fn stdout_of(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
