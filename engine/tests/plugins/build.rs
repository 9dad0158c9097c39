//! Builds the plugins of tests and benches.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// The library of a C file in `c/`, or `None` where there is no compiler.
pub(crate) fn c_library(name: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let library = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("lib{name}.so"));
    let compiled = Command::new("cc")
        .args(["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-I"])
        .arg(root.join("node/include"))
        .arg(root.join(format!("tests/plugins/c/{name}.c")))
        .arg("-o")
        .arg(&library)
        .output();
    match compiled {
        Ok(output) => assert!(output.status.success(), "{name}.c: {}", String::from_utf8_lossy(&output.stderr)),
        Err(error) => {
            println!("skipped {name}.c: there is no C compiler here: {error}");
            return None;
        }
    }
    Some(library)
}

/// The library of an example of this crate.
pub(crate) fn rust_library(name: &str) -> PathBuf {
    // With all of the workspace, so that nothing is compiled again with other features.
    let built = Command::new(env!("CARGO"))
        .args(["build", "--release", "--workspace", "--example", name])
        .status()
        .expect("cargo runs");
    assert!(built.success(), "the example {name} builds");
    // The test's or bench's own file, deps/NAME-HASH, stands beside examples/.
    let deps = std::env::current_exe().expect("the process has a file");
    deps.parent().and_then(Path::parent).expect("in target/PROFILE/deps").join(format!("examples/lib{name}.so"))
}
