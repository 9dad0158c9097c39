//! Reads a library's description in a separate process, which contains crashes, hangs and invalid libraries.

use super::{Library, PluginDescription, load::loads_since};
use crate::{hash::mapped::mapped, process::Launcher};
use serde::{Deserialize, Serialize};
use std::{
    io::{self, Read},
    path::Path,
    process::{Child, ExitStatus, Stdio},
    sync::mpsc::{Receiver, sync_channel},
    thread,
    time::{Duration, Instant},
};

/// Reads a library in another process.
#[derive(Debug, Clone)]
pub struct Prober {
    /// Prints the [`answer`] for the file given as last argument.
    pub launcher: Launcher,
    /// Time limit for a library.
    pub timeout: Duration,
}

impl Prober {
    /// Ten seconds: loading takes milliseconds, or a few seconds for a large library on a slow network drive.
    pub const TIMEOUT: Duration = Duration::from_secs(10);
}

/// Why a description could not be read.
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
    #[error("the program that looks at it, {0}, cannot be started: {1}")]
    Start(String, io::Error),
}

/// The output of the process.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ProbeReply {
    Plugin(Box<PluginDescription>),
    Refused(String),
}

/// Starts the line of the answer: the library may print lines too.
const MARK: &str = "osteoflow plugin: ";
/// Maximum size of a description, and of the output read from a library.
const MAX_ANSWER_BYTES: u64 = 64 << 20;
/// Interval between checks whether the process has ended.
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Time limit for reading the output of an ended process; a child process may keep the pipe open.
const OUTPUT_TIMEOUT: Duration = Duration::from_secs(1);

/// Loads the library and returns the answer to be printed on stdout.
pub fn answer(file: &Path) -> String {
    let before = mapped();
    let answer = match Library::load(file) {
        Ok(library) => {
            let loads = loads_since(&before, file);
            ProbeReply::Plugin(Box::new(PluginDescription { loads, ..library.description().clone() }))
        }
        Err(error) => ProbeReply::Refused(error.why.to_string()),
    };
    let json = serde_json::to_string(&answer).unwrap_or_else(|error| format!("{{\"refused\":\"{error}\"}}"));
    // Start a new line, whatever the library has printed.
    format!("\n{MARK}{json}\n")
}

/// Reads the description of a library in another process.
pub(super) fn probe(prober: &Prober, file: &Path) -> Result<PluginDescription, ProbeError> {
    let mut command = prober.launcher.command();
    command.arg(file);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let start = |error| ProbeError::Start(prober.launcher.program.display().to_string(), error);
    let mut child = command.spawn().map_err(start)?;
    let (out, err) = (read(child.stdout.take()), read(child.stderr.take()));
    let ended = wait(&mut child, prober.timeout).map_err(start)?;
    let Some(status) = ended else { return Err(ProbeError::Hung(prober.timeout)) };
    let printed = |bytes: Receiver<Vec<u8>>| bytes.recv_timeout(OUTPUT_TIMEOUT).unwrap_or_default();
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
        Some(ProbeReply::Plugin(description)) if status.success() => Ok(*description),
        Some(ProbeReply::Refused(why)) if status.success() => Err(ProbeError::Refused(why)),
        _ => {
            let code = status.code().map_or("none".into(), |code| code.to_string());
            Err(ProbeError::Ended(format!("exit code {code}{}", said())))
        }
    }
}

/// Reads all output on a thread, so that the receiver can stop waiting.
fn read(from: Option<impl Read + Send + 'static>) -> Receiver<Vec<u8>> {
    let (sender, receiver) = sync_channel(1);
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(from) = from {
            let mut from = from.take(MAX_ANSWER_BYTES);
            let _ = from.read_to_end(&mut bytes);
            // Drain the rest, so that the process does not block on a full pipe.
            let _ = io::copy(&mut from.into_inner(), &mut io::sink());
        }
        let _ = sender.send(bytes);
    });
    receiver
}

/// Waits for the process; `None` if it was killed after the timeout.
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
        thread::sleep(POLL_INTERVAL);
    }
}

#[cfg(unix)]
use crate::process::child::signal;

#[cfg(not(unix))]
fn signal(_: ExitStatus) -> Option<String> {
    None
}
