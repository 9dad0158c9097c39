//! Passes on how the crate is compiled.

fn main() {
    let level = std::env::var("OPT_LEVEL").unwrap_or_default();
    println!("cargo::rustc-env=OSTEOFLOW_ALGORITHMS_OPT_LEVEL={level}");
    println!("cargo::rerun-if-changed=build.rs");
}
