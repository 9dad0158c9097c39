//! How the program finds itself: the file with its code, what starts another process of it, and the arguments that it was called
//! with. As a library of Python its executable is the interpreter.

use anyhow::{Context, Result};
use osteoflow_engine::{hash::program, plugin::Launcher};
use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
    sync::OnceLock,
};

/// The interpreter that runs this library, and the arguments with which it runs the command.
static HOST: OnceLock<(PathBuf, Vec<OsString>)> = OnceLock::new();

/// The arguments of the command, without its name.
static ARGUMENTS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Names the interpreter that runs this library, the arguments with which it runs [`crate::main`], and the file of the library:
/// another process of it looks at plugins, and the file identifies the program.
pub fn hosted_by(program: PathBuf, before: Vec<OsString>, library: PathBuf) {
    program::set_file(library);
    let _ = HOST.set((program, before));
}

/// Notes the arguments of the command, the program's name first. Only the first call counts.
pub(crate) fn set_arguments(arguments: &[OsString]) {
    let _ = ARGUMENTS.set(arguments.iter().skip(1).cloned().collect());
}

/// The arguments of the command, without its name; of a program that calls the library those of the process.
pub(crate) fn arguments() -> Vec<String> {
    let of_process = || env::args_os().skip(1).collect();
    let arguments = ARGUMENTS.get().cloned().unwrap_or_else(of_process);
    arguments.iter().map(|argument| argument.to_string_lossy().into_owned()).collect()
}

/// The interpreter that runs this library, if it is known.
pub(crate) fn interpreter() -> Option<&'static Path> {
    HOST.get().map(|(program, _)| &**program).filter(|program| !program.as_os_str().is_empty())
}

/// This program with a subcommand, to be started as another process.
pub(crate) fn launcher(subcommand: &str) -> Result<Launcher> {
    let (program, mut arguments) = match HOST.get() {
        // An application with Python inside may not know its interpreter; any other loads the library, too.
        Some((_, before)) => (interpreter().unwrap_or(Path::new("python3")).to_owned(), before.clone()),
        None => {
            let own = env::current_exe().context("the path of this program is unknown")?;
            // This is the running program even if its file was replaced since. Not under valgrind, where it is valgrind
            // itself.
            (if own.is_file() { own } else { "/proc/self/exe".into() }, Vec::new())
        }
    };
    arguments.push(subcommand.into());
    Ok(Launcher::new(program, arguments))
}
