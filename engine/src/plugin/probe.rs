//! Asks a library what it is, in a process of its own: one that crashes, hangs or is garbage takes nothing with it.

use super::{Library, PluginAbout};
use serde::{Deserialize, Serialize};
use std::{
    ffi::OsString,
    io::{self, Read},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, sync_channel},
    thread,
    time::{Duration, Instant},
};

/// The program that looks at a library: it prints [`answer`] of the file that follows its arguments.
#[derive(Debug, Clone)]
pub struct Prober {
    /// The program.
    pub program: PathBuf,
    /// What it is called with before the file.
    pub arguments: Vec<OsString>,
    /// How long a library may take; then it is stopped.
    pub timeout: Duration,
}

impl Prober {
    /// Ten seconds: loading takes milliseconds, and a large library on a slow network drive some seconds.
    pub const TIMEOUT: Duration = Duration::from_secs(10);
}

/// Why there is no description.
#[derive(Debug, thiserror::Error)]
pub(super) enum ProbeError {
    #[error("{0}")]
    Refused(String),
    #[error("it crashed while it was loaded: {0}")]
    Crashed(String),
    #[error(
        "it was not loaded within {:?}; something that it does when it is loaded does not end \
         (OSTEOFLOW_PLUGIN_TIMEOUT_S allows more)",
        .0
    )]
    Hung(Duration),
    #[error("it ended the process that looked at it: {0}")]
    Ended(String),
    #[error("the process that looks at it cannot be started: {0}")]
    Start(io::Error),
}

/// What the process prints.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Answer {
    Plugin(Box<PluginAbout>),
    Refused(String),
}

/// Begins the line of the answer: the library may print lines too.
const MARK: &str = "osteoflow plugin: ";
/// No description is longer, nor is more read of what a library prints.
const MOST_BYTES: u64 = 64 << 20;
/// So long the program's end is waited for between two looks.
const LOOK: Duration = Duration::from_millis(1);
/// What a program that has ended printed is there by then, unless one that it has started goes on.
const REST: Duration = Duration::from_secs(1);

/// The answer of the process that looks at a library: lines to be printed on stdout. It loads the library.
pub fn answer(file: &Path) -> String {
    let answer = match Library::load(file) {
        Ok(library) => Answer::Plugin(Box::new(library.about().clone())),
        Err(error) => Answer::Refused(error.why.to_string()),
    };
    let json = serde_json::to_string(&answer).unwrap_or_else(|error| format!("{{\"refused\":\"{error}\"}}"));
    // On a line of its own, whatever the library has printed.
    format!("\n{MARK}{json}\n")
}

/// What the library says of itself.
pub(super) fn probe(prober: &Prober, file: &Path) -> Result<PluginAbout, ProbeError> {
    let mut command = Command::new(&prober.program);
    command.args(&prober.arguments).arg(file);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(ProbeError::Start)?;
    let (out, err) = (read(child.stdout.take()), read(child.stderr.take()));
    let ended = wait(&mut child, prober.timeout).map_err(ProbeError::Start)?;
    let Some(status) = ended else { return Err(ProbeError::Hung(prober.timeout)) };
    let printed = |bytes: Receiver<Vec<u8>>| bytes.recv_timeout(REST).unwrap_or_default();
    let (out, err) = (printed(out), printed(err));
    let said = || {
        let text = String::from_utf8_lossy(&err);
        let last = text.lines().rfind(|line| !line.trim().is_empty()).map(|line| line.trim().to_owned());
        last.map(|line| format!("; it printed {line:?}")).unwrap_or_default()
    };
    if let Some(signal) = signal(status) {
        return Err(ProbeError::Crashed(format!("{signal}{}", said())));
    }
    let text = String::from_utf8_lossy(&out);
    let line = text.lines().rev().find_map(|line| line.strip_prefix(MARK));
    match line.and_then(|line| serde_json::from_str(line).ok()) {
        Some(Answer::Plugin(about)) if status.success() => Ok(*about),
        Some(Answer::Refused(why)) if status.success() => Err(ProbeError::Refused(why)),
        _ => {
            let code = status.code().map_or("none".into(), |code| code.to_string());
            Err(ProbeError::Ended(format!("exit code {code}{}", said())))
        }
    }
}

/// All that comes, on a thread: who waits for it need not wait for ever.
fn read(from: Option<impl Read + Send + 'static>) -> Receiver<Vec<u8>> {
    let (tell, told) = sync_channel(1);
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(from) = from {
            let mut from = from.take(MOST_BYTES);
            let _ = from.read_to_end(&mut bytes);
            // What prints on must not wait for us.
            let _ = io::copy(&mut from.into_inner(), &mut io::sink());
        }
        let _ = tell.send(bytes);
    });
    told
}

/// `None`: it was stopped.
fn wait(child: &mut Child, timeout: Duration) -> io::Result<Option<ExitStatus>> {
    let end = Instant::now() + timeout;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if Instant::now() >= end {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        thread::sleep(LOOK);
    }
}

/// The signal that ended a process.
#[cfg(unix)]
fn signal(status: ExitStatus) -> Option<String> {
    let number = std::os::unix::process::ExitStatusExt::signal(&status)?;
    let name = match number {
        4 => "SIGILL, an instruction that the processor does not have",
        6 => "SIGABRT, it stopped itself",
        8 => "SIGFPE, a division by zero",
        9 => "SIGKILL, the system or somebody stopped it",
        11 => "SIGSEGV, memory that it may not touch",
        7 | 10 => "SIGBUS, memory that is not there",
        _ => return Some(format!("signal {number}")),
    };
    Some(format!("signal {number} ({name})"))
}

#[cfg(not(unix))]
fn signal(_: ExitStatus) -> Option<String> {
    None
}
