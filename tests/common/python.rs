//! A Python interpreter with packages, for tests.

use std::{
    path::{Path, PathBuf},
    process::Command,
    sync::Mutex,
};

/// The interpreter of an environment with numpy and scipy, made once below the target directory; a note and `None` where Python
/// or the registry of packages is missing.
pub(crate) fn python(test: &str) -> Option<PathBuf> {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _one = ONE_AT_A_TIME.lock().unwrap();
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
    let interpreter = dir.join("bin/python");
    let works = || {
        let output = Command::new(&interpreter).args(["-c", "import numpy, scipy"]).output();
        output.is_ok_and(|output| output.status.success())
    };
    // Compiles on import what is imported, which is a small part of the packages.
    if !works() {
        let made = |command: &mut Command| command.output().is_ok_and(|output| output.status.success());
        let is_made = made(Command::new("python3").args(["-m", "venv"]).arg(&dir))
            && made(Command::new(&interpreter).args([
                "-m",
                "pip",
                "install",
                "--quiet",
                "--no-compile",
                "numpy",
                "scipy",
            ]))
            && works();
        if !is_made {
            println!("skipped: {test}: no Python environment with numpy and scipy could be made");
            return None;
        }
    }
    Some(interpreter)
}
