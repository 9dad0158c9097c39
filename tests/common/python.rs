//! A Python interpreter with packages, for tests.

use super::osteoflow;
use std::{
    fs,
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

/// That interpreter with further packages, which are installed where they are missing; a note and `None` where they cannot be had.
pub(crate) fn python_with(test: &str, packages: &[&str], modules: &str) -> Option<PathBuf> {
    let interpreter = python(test)?;
    let works = |arguments: &[&str]| {
        Command::new(&interpreter).args(arguments).output().is_ok_and(|output| output.status.success())
    };
    let import = format!("import {modules}");
    let install = [&["-m", "pip", "install", "--quiet"], packages].concat();
    if works(&["-c", &import]) || (works(&install) && works(&["-c", &import])) {
        return Some(interpreter);
    }
    println!("skipped: {test}: {} could not be installed", packages.join(", "));
    None
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

/// A plugin whose source gives one cloud and whose node a number that `helper.py` beside it decides.
pub(crate) const HELPED: &str = r#"
import helper
import numpy as np
from osteoflow_node import Cloud, node, payload, source


@payload("st/R")
class R:
    """A number."""

    number: float


@source("st.src", output="cloud")
def src() -> Cloud:
    """One cloud."""
    yield 0, Cloud("camera", np.arange(30.0).reshape(10, 3))


@node("st.f", output="r")
def f(cloud: Cloud) -> R:
    """A number that helper.py decides."""
    return R(float(helper.SCALE))
"#;

/// A folder with files, and the interpreter for its plugins; `None` where there is no Python.
pub(crate) struct Folder(pub(crate) tempfile::TempDir, pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new(test: &str, files: &[(&str, &str)]) -> Option<Self> {
        let folder = Self(tempfile::tempdir().unwrap(), python(test)?);
        files.iter().for_each(|(name, text)| folder.write(name, text));
        Some(folder)
    }

    /// Runs the program in the folder, with a store of its own; the exit code, and all that was printed.
    pub(crate) fn says(&self, arguments: &[&str]) -> (Option<i32>, String) {
        let mut command = osteoflow();
        command.current_dir(self.0.path()).env("OSTEOFLOW_CACHE", self.path("cache")).env_remove("OMP_NUM_THREADS");
        let output = command.args(arguments).env("OSTEOFLOW_PYTHON", &self.1).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8_lossy(&text).into_owned())
    }

    /// As [`Self::says`], which must end well.
    pub(crate) fn ends_well(&self, arguments: &[&str]) -> String {
        let (code, text) = self.says(arguments);
        assert_eq!(code, Some(0), "{arguments:?}: {text}");
        text
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        fs::write(self.path(name), text).unwrap();
    }
}
