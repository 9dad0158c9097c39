//! Builds plugins for the tests and benches of the workspace.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    process::Command,
    sync::Mutex,
};

/// The folder of the workspace, from any crate in it.
fn root() -> &'static Path {
    let mut folders = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    folders.find(|folder| folder.join("engine/node/include").is_dir()).expect("a crate of the workspace")
}

/// Compiles a C or C++ file, relative to the workspace, into a library. Prints a note and returns `false` if there is no
/// compiler.
pub(crate) fn compile(source: &Path, library: &Path, arguments: &[&str]) -> bool {
    let is_c = source.extension().is_some_and(|extension| extension == "c");
    let (compiler, standard) = if is_c { ("cc", "-std=c11") } else { ("c++", "-std=c++11") };
    let compiled = Command::new(compiler)
        .current_dir(root())
        .args([standard, "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"])
        .args(["-I", "engine/node/include", "-I", "nodes/kinds/payloads/include"])
        .arg(source)
        .arg("-o")
        .arg(library)
        .args(arguments)
        .output();
    match compiled {
        Ok(output) if output.status.success() => true,
        Ok(output) => panic!("{}: {}", source.display(), String::from_utf8_lossy(&output.stderr)),
        Err(error) => {
            println!("skipped {}: there is no {compiler} here: {error}", source.display());
            false
        }
    }
}

/// The library of an example of the workspace, in the profile of the caller.
pub(crate) fn example(name: &str) -> PathBuf {
    // This executable is deps/NAME-HASH, next to examples/.
    let own = std::env::current_exe().expect("the process has a file");
    let target = own.parent().and_then(Path::parent).expect("in target/PROFILE/deps");
    let profile = match target.file_name().and_then(|name| name.to_str()) {
        Some("debug") => "dev",
        Some(profile) => profile,
        None => "release",
    };
    // Cargo is asked once for each of them.
    static BUILT: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let mut built = BUILT.lock().expect("each example builds");
    if !built.contains(name) {
        let status = Command::new(env!("CARGO"))
            .current_dir(root())
            // For the whole workspace, so that nothing is recompiled with other features.
            .args(["build", "--profile", profile, "--workspace", "--example", name])
            .status()
            .expect("cargo runs");
        assert!(status.success(), "the example {name} builds");
        built.insert(name.to_owned());
    }
    target.join(format!("examples/{}{name}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX))
}
