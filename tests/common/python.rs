//! A Python interpreter with packages, for tests.

use std::{
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

/// The interpreter of an environment with numpy and scipy, made once below the target directory; a note and `None` where Python
/// or the registry of packages is missing.
pub(crate) fn python(test: &str) -> Option<PathBuf> {
    static INTERPRETER: OnceLock<Option<PathBuf>> = OnceLock::new();
    let interpreter = INTERPRETER.get_or_init(made);
    if interpreter.is_none() {
        println!("skipped: {test}: no Python environment with numpy and scipy could be made");
    }
    interpreter.clone()
}

fn made() -> Option<PathBuf> {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
    let interpreter = dir.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let works = || {
        let mut import = Command::new(&interpreter);
        // Compiles on import what is imported, which is a small part of the packages and takes longer than the import itself.
        import.args(["-c", "import numpy, scipy.sparse.csgraph, scipy.spatial"]).env_remove("PYTHONDONTWRITEBYTECODE");
        import.output().is_ok_and(|output| output.status.success())
    };
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
            return None;
        }
    }
    Some(interpreter)
}
