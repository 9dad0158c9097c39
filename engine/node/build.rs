//! Tells the crate which compiler builds it: a plugin says so in its description.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = Command::new(rustc).arg("--version").output().ok().and_then(|out| String::from_utf8(out.stdout).ok());
    println!("cargo::rustc-env=OSTEOFLOW_RUSTC={}", version.as_deref().unwrap_or("rustc").trim());
}
