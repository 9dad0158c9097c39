//! Passes the version of the compiler to the crate, for the description of a plugin.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = Command::new(rustc).arg("--version").output().ok().and_then(|out| String::from_utf8(out.stdout).ok());
    println!("cargo::rustc-env=OSTEOFLOW_RUSTC={}", version.as_deref().unwrap_or("rustc").trim());
}
