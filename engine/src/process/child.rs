//! The process of a node: started, listened to, and stopped.

use super::socket::Socket;
use std::{
    collections::VecDeque,
    ffi::OsString,
    io::{self, BufRead, BufReader, Write},
    os::{
        fd::OwnedFd,
        unix::{net::UnixStream, process::CommandExt},
    },
    path::PathBuf,
    process::{Child as Process, Command, ExitStatus, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

/// How long a process may take to end by itself once it is told to.
const END_WITHIN: Duration = Duration::from_secs(2);
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Lines that are kept of what it prints, for an error.
const N_LINES: usize = 3;

/// A program that runs nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Launcher {
    /// The program.
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
}

/// A running process.
pub(crate) struct Child {
    process: Process,
    pub(crate) socket: Socket,
    said: Arc<Mutex<VecDeque<String>>>,
    forwarder: Option<JoinHandle<()>>,
}

impl Child {
    /// Starts the process, with the socket as its standard input. What it prints goes to standard error.
    pub(crate) fn start(launcher: &Launcher) -> io::Result<Self> {
        let (ours, theirs) = UnixStream::pair()?;
        let (reader, writer) = io::pipe()?;
        let mut command = Command::new(&launcher.program);
        command.args(&launcher.arguments).stdin(Stdio::from(OwnedFd::from(theirs)));
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
        Ok(Self { process, socket: Socket::new(ours), said, forwarder: Some(forwarder) })
    }

    /// How the process ended, with what it printed last. Call when the connection is closed.
    pub(crate) fn obituary(&mut self) -> String {
        let Some(status) = self.wait(END_WITHIN) else {
            self.kill();
            return "its process closed the connection and went on, and was stopped".into();
        };
        let how = match (signal(status), status.code()) {
            (Some(signal), _) => format!("its process ended by {signal}"),
            (None, Some(0)) => "its process ended with exit code 0, without an answer".into(),
            (None, code) => format!("its process ended with exit code {}", code.unwrap_or_default()),
        };
        format!("{how}{}", self.last_words())
    }

    /// What it printed last, for an error.
    pub(crate) fn last_words(&mut self) -> String {
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
        if self.wait(END_WITHIN).is_none() {
            self.kill();
        }
        self.last_words();
    }
}

/// The signal that ended a process.
pub(crate) fn signal(status: ExitStatus) -> Option<String> {
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
