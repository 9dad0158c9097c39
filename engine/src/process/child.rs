//! The process of a node: started, listened to, and stopped.

use super::{Launcher, socket::Socket};
use std::{
    collections::VecDeque,
    io::{self, BufRead, BufReader, Write},
    os::{
        fd::OwnedFd,
        unix::{net::UnixStream, process::CommandExt},
    },
    process::{Child as Process, ExitStatus, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

/// How long a process may take to end by itself once it is told to.
const END_WITHIN: Duration = Duration::from_secs(2);
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Lines that are kept of what it prints, for an error.
const N_LINES: usize = 3;

/// A running process.
pub(crate) struct Child {
    process: Process,
    pub(crate) socket: Socket,
    said: Arc<Mutex<VecDeque<String>>>,
    forwarder: Option<JoinHandle<()>>,
    /// Whether its end is reported by an error, or was brought about.
    is_reported: bool,
    /// The node that it serves, or served last.
    pub(crate) node: String,
}

impl Child {
    /// Starts the process, with the socket as its standard input. What it prints goes to standard error.
    pub(crate) fn start(launcher: &Launcher) -> io::Result<Self> {
        let (ours, theirs) = UnixStream::pair()?;
        let (reader, writer) = io::pipe()?;
        let mut command = launcher.command();
        command.stdin(Stdio::from(OwnedFd::from(theirs)));
        command.stdout(writer.try_clone()?).stderr(writer);
        // Ctrl-C on the terminal is for the program, which ends its runs in order.
        command.process_group(0);
        let process = command.spawn()?;
        // The command holds the other ends of socket and pipe open.
        drop(command);
        let said = Arc::new(Mutex::new(VecDeque::new()));
        let kept = said.clone();
        let forward = move || {
            let mut reader = BufReader::new(reader);
            let mut line = Vec::new();
            while reader.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
                let _ = io::stderr().write_all(&line);
                let text = String::from_utf8_lossy(&line).trim().to_owned();
                line.clear();
                if !text.is_empty() {
                    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                    kept.push_back(text);
                    if kept.len() > N_LINES {
                        kept.pop_front();
                    }
                }
            }
        };
        let forwarder = thread::Builder::new().name("worker output".into()).spawn(forward)?;
        Ok(Self {
            process,
            socket: Socket::new(ours),
            said,
            forwarder: Some(forwarder),
            is_reported: false,
            node: String::new(),
        })
    }

    /// How the process ended, with what it printed last. Call when the connection is closed.
    pub(crate) fn ending(&mut self) -> String {
        self.is_reported = true;
        let Some(status) = self.wait(END_WITHIN) else {
            self.kill();
            return "its process closed the connection and went on, and was stopped".into();
        };
        let without = if status.success() { ", without an answer" } else { "" };
        format!("its process {}{without}{}", how(status), self.printed())
    }

    /// What it printed last, for an error.
    pub(crate) fn printed(&mut self) -> String {
        // Children of its own may keep the pipe open.
        let end = Instant::now() + Duration::from_millis(200);
        while self.forwarder.as_ref().is_some_and(|forwarder| !forwarder.is_finished()) && Instant::now() < end {
            thread::sleep(POLL_INTERVAL);
        }
        let said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        let said: Vec<&str> = said.iter().map(String::as_str).collect();
        if said.is_empty() { String::new() } else { format!("; it printed {:?}", said.join(" | ")) }
    }

    /// Stops the process at once.
    pub(crate) fn kill(&mut self) {
        self.is_reported = true;
        let _ = self.process.kill();
        let _ = self.process.wait();
    }

    fn wait(&mut self, limit: Duration) -> Option<ExitStatus> {
        let end = Instant::now() + limit;
        loop {
            match self.process.try_wait() {
                Ok(Some(status)) => return Some(status),
                Ok(None) if Instant::now() < end => thread::sleep(POLL_INTERVAL),
                _ => return None,
            }
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // It destroys its node and ends when the connection is closed.
        self.socket.close();
        match self.wait(END_WITHIN) {
            Some(status) if status.success() || self.is_reported => {}
            Some(status) => {
                let (printed, node) = (self.printed(), &self.node);
                tracing::warn!("node \"{node}\": after its end its process {}{printed}", how(status));
            }
            None => {
                self.kill();
                let node = &self.node;
                tracing::warn!(
                    "node \"{node}\": after its end its process did not end within {END_WITHIN:?}, and was stopped"
                );
            }
        }
        self.printed();
    }
}

/// How a process ended.
fn how(status: ExitStatus) -> String {
    match signal(status) {
        Some(signal) => format!("ended by {signal}"),
        None => format!("ended with exit code {}", status.code().unwrap_or_default()),
    }
}

/// The signal that ended a process.
pub(crate) fn signal(status: ExitStatus) -> Option<String> {
    let number = std::os::unix::process::ExitStatusExt::signal(&status)?;
    let name = signal_name(number).map_or_else(String::new, |name| format!(", {name}"));
    Some(format!("signal {number}{name}"))
}

/// Name of a signal that ends a process, and what raises it.
pub const fn signal_name(number: i32) -> Option<&'static str> {
    Some(match number {
        4 => "SIGILL (invalid instruction)",
        6 => "SIGABRT (abort, or an exception that nothing caught)",
        8 => "SIGFPE (invalid arithmetic)",
        9 => "SIGKILL (stopped from outside, or memory is exhausted)",
        11 => "SIGSEGV (invalid memory, or its stack is full)",
        7 | 10 => "SIGBUS (invalid memory)",
        _ => return None,
    })
}
