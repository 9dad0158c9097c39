//! Tells the command what it was built from and how: a recording names both. Outside git there is no revision, and
//! nothing fails.

use std::{env, path::Path, process::Command};

/// What the program is built from; other files may change without it.
const SOURCES: [&str; 4] = ["engine", "nodes", "Cargo.toml", "Cargo.lock"];

fn main() {
    let rustc = env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    tell("GIT_REVISION", &revision().unwrap_or_default());
    tell("COMPILER", &said(&rustc, &["--version"]).unwrap_or_default());
    tell("RUSTFLAGS", &flags.replace('\u{1f}', " "));
    for (name, variable) in
        [("TARGET", "TARGET"), ("OPT_LEVEL", "OPT_LEVEL"), ("TARGET_FEATURES", "CARGO_CFG_TARGET_FEATURE")]
    {
        tell(name, &env::var(variable).unwrap_or_default());
    }
    SOURCES.iter().for_each(|path| println!("cargo::rerun-if-changed={path}"));
    // The first changes when another branch is checked out, the second with each commit.
    for file in ["HEAD", "logs/HEAD"] {
        let path = said("git", &["rev-parse", "--git-path", file]);
        if let Some(path) = path.filter(|path| Path::new(path).exists()) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
}

fn tell(name: &str, value: &str) {
    println!("cargo::rustc-env=OSTEOFLOW_BUILD_{name}={value}");
}

/// The commit, and whether the sources differ from it. Of a repository that merely holds this one there is nothing to say.
fn revision() -> Option<String> {
    if !said("git", &["rev-parse", "--show-prefix"])?.is_empty() {
        return None;
    }
    let commit = said("git", &["rev-parse", "HEAD"])?;
    let changed = said("git", &[&["status", "--porcelain", "--"][..], &SOURCES].concat())?;
    Some(if changed.is_empty() { commit } else { format!("{commit}, changed") })
}

/// What a program says on stdout, if it is there and succeeds.
fn said(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
