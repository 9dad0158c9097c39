//! The connections to receivers, on a thread of their own.

use crate::acquire::network::{Role, listen};
use osteoflow_formats::openigtlink::{Body, Message, Metadata, Status};
use osteoflow_node::tracing;
use std::{
    collections::BTreeMap,
    io::{ErrorKind, Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream, ToSocketAddrs},
    sync::mpsc::{self, RecvTimeoutError, SyncSender, sync_channel},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

/// Messages that wait for the thread; more are dropped, because an old pose is worth nothing.
const N_WAITING: usize = 1024;
/// How often the thread looks for receivers.
const LOOK: Duration = Duration::from_millis(20);
/// Time after which a receiver that takes nothing is left.
const STUCK: Duration = Duration::from_millis(500);
/// Time between two tries to connect.
const RETRY: Duration = Duration::from_secs(1);
/// Receivers at a time.
const N_RECEIVERS: usize = 16;
/// Time for receivers to take the last messages.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// The device of statuses.
pub(super) const DEVICE: &str = "Osteoflow";

/// Messages to the thread.
pub(super) enum Task {
    /// Sends a message now. A lasting one is sent to later receivers too, instead of an earlier one of its device and type.
    Send {
        /// The message.
        message: Message,
        /// Whether it is kept for later receivers.
        lasts: bool,
    },
    /// Planes were sent; without more within this time they are reported as old.
    Fresh(Duration),
    /// No planes are shown that could become old.
    Withheld,
}

/// Sends messages to all receivers; ends them when dropped.
pub(super) struct Outlet {
    tasks: Option<SyncSender<Task>>,
    thread: Option<JoinHandle<()>>,
    pub(super) n_dropped: u64,
}

struct Receivers {
    role: Role,
    addresses: Vec<SocketAddr>,
    listener: Option<TcpListener>,
    streams: Vec<Receiver>,
    lasting: BTreeMap<(String, String), Message>,
    tried: Option<Instant>,
    fresh_until: Option<Instant>,
    /// The last status of the node, and whether it has been followed by the report of old planes.
    status: Option<Message>,
    is_stale: bool,
}

/// A receiver that is connected.
struct Receiver {
    stream: TcpStream,
    peer: SocketAddr,
    /// The first bytes that it sent: the version of its header.
    said: Vec<u8>,
}

impl Receiver {
    /// Whether its own messages have header version 2 or later. Until it has sent one it gets version 1, which all receivers read:
    /// the library 1.11 of the distributions knows no other, and loses its place in the stream.
    fn reads_extended(&self) -> bool {
        matches!(self.said[..], [0, version] if version >= 2)
    }

    /// # Errors
    /// The message does not fit, or the receiver does not take it.
    fn send(&mut self, message: &Message) -> Result<(), String> {
        let bytes = if self.reads_extended() {
            message.to_bytes()
        } else {
            Message { extended: None, ..message.clone() }.to_bytes()
        };
        let bytes = bytes.map_err(|error| format!("{}: {error}", message.device))?;
        self.stream.write_all(&bytes).map_err(|error| error.to_string())
    }

    /// Takes what it says; returns whether it is still there.
    fn listen(&mut self) -> bool {
        let mut unread = [0; 4096];
        let _ = self.stream.set_nonblocking(true);
        let is_open = loop {
            match self.stream.read(&mut unread) {
                Ok(0) => break false,
                Ok(n) => self.said.extend(&unread[..n.min(2 - self.said.len())]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => break error.kind() == ErrorKind::WouldBlock,
            }
        };
        let _ = self.stream.set_nonblocking(false);
        is_open
    }
}

impl Outlet {
    /// Listens at `address`, or connects to it as soon as there is a server.
    pub(super) fn open(role: Role, address: &str) -> Result<Self, String> {
        let invalid = |error| format!("\"{address}\" is no address: {error}; write HOST:PORT, such as 127.0.0.1:18945");
        let addresses: Vec<_> = address.to_socket_addrs().map_err(invalid)?.collect();
        let listener = match role {
            Role::Client => None,
            Role::Server => {
                let listener = listen(address)?;
                tracing::info!(address = ?listener.local_addr().ok(), "receivers can connect");
                Some(listener)
            }
        };
        let (tasks, rx) = sync_channel(N_WAITING);
        let receivers = Receivers {
            role,
            addresses,
            listener,
            streams: Vec::new(),
            lasting: BTreeMap::new(),
            tried: None,
            fresh_until: None,
            status: None,
            is_stale: false,
        };
        let thread = thread::Builder::new()
            .name("openigtlink".into())
            .spawn(move || receivers.run(&rx))
            .map_err(|error| format!("no thread could be started: {error}"))?;
        Ok(Self { tasks: Some(tasks), thread: Some(thread), n_dropped: 0 })
    }

    /// Hands a task on. What lasts waits for room, which a stuck receiver delays by [`STUCK`] at most; the rest is dropped.
    pub(super) fn put(&mut self, task: Task) {
        let Some(tasks) = &self.tasks else { return };
        let is_put = match task {
            Task::Send { lasts: true, .. } => tasks.send(task).is_ok(),
            _ => tasks.try_send(task).is_ok(),
        };
        self.n_dropped += u64::from(!is_put);
    }
}

impl Drop for Outlet {
    fn drop(&mut self) {
        self.tasks = None;
        if let Some(thread) = self.thread.take() {
            // It panics nowhere, and its end is what matters.
            let _ = thread.join();
        }
    }
}

/// A status; header version 2 has its sender, too.
pub(super) fn status(code: u16, name: &str, message: &str) -> Message {
    let body = Body::Status(Status::new(code, name, message));
    Message::new(DEVICE, 0, body).extended(0, vec![Metadata::new("Sender", "osteoflow; research use only")])
}

impl Receivers {
    fn run(mut self, tasks: &mpsc::Receiver<Task>) {
        let mut looked: Option<Instant> = None;
        loop {
            if looked.is_none_or(|looked| looked.elapsed() >= LOOK) {
                self.look();
                looked = Some(Instant::now());
            }
            match tasks.recv_timeout(LOOK) {
                Ok(Task::Send { message, lasts }) => {
                    self.send(&message, lasts);
                    if matches!(message.body, Body::Status(_)) {
                        (self.status, self.is_stale) = (Some(message), false);
                    }
                }
                Ok(Task::Fresh(time)) => {
                    self.fresh_until = Some(Instant::now() + time);
                    if std::mem::take(&mut self.is_stale)
                        && let Some(status) = self.status.clone()
                    {
                        self.send(&status, true);
                    }
                }
                Ok(Task::Withheld) => self.fresh_until = None,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if self.fresh_until.is_some_and(|until| Instant::now() > until) {
                (self.fresh_until, self.is_stale) = (None, true);
                let text = "no new planes came; those shown are old";
                self.send(&status(Status::NOT_READY, "stale", text), true);
            }
        }
        self.look();
        self.send(&status(Status::EXITING, "exiting", "the run has ended; planes shown are old"), false);
        self.leave();
    }

    /// Accepts or connects, and takes the version of its header from what a receiver says first.
    fn look(&mut self) {
        match &self.listener {
            Some(listener) => {
                while let Ok((stream, peer)) = listener.accept() {
                    if self.streams.len() < N_RECEIVERS {
                        Self::greet(&mut self.streams, &self.lasting, stream, peer);
                    } else {
                        tracing::warn!(%peer, "turned away, {N_RECEIVERS} receivers are connected");
                    }
                }
            }
            None if self.streams.is_empty() && self.tried.is_none_or(|tried| tried.elapsed() > RETRY) => {
                debug_assert_eq!(self.role, Role::Client);
                self.tried = Some(Instant::now());
                let connect = |a: &SocketAddr| Some((TcpStream::connect_timeout(a, STUCK).ok()?, *a));
                if let Some((stream, peer)) = self.addresses.iter().find_map(connect) {
                    Self::greet(&mut self.streams, &self.lasting, stream, peer);
                }
            }
            None => {}
        }
        let lasting = &self.lasting;
        self.streams.retain_mut(|receiver| {
            let was_known = receiver.reads_extended();
            let is_open = receiver.listen();
            if !is_open {
                tracing::info!(peer = %receiver.peer, "the receiver left");
            } else if receiver.reads_extended() && !was_known {
                // What lasts again, now with its metadata.
                return lasting.values().all(|message| receiver.send(message).is_ok());
            }
            is_open
        });
    }

    fn greet(
        streams: &mut Vec<Receiver>,
        lasting: &BTreeMap<(String, String), Message>,
        stream: TcpStream,
        peer: SocketAddr,
    ) {
        let is_ready = stream.set_nonblocking(false).and_then(|()| stream.set_nodelay(true)).is_ok()
            && stream.set_write_timeout(Some(STUCK)).is_ok();
        let mut receiver = Receiver { stream, peer, said: Vec::new() };
        if is_ready && lasting.values().all(|message| receiver.send(message).is_ok()) {
            tracing::info!(%peer, "a receiver connected");
            streams.push(receiver);
        }
    }

    fn send(&mut self, message: &Message, lasts: bool) {
        if let Err(error) = message.to_bytes() {
            return tracing::warn!("{} is not sent: {error}", message.device);
        }
        self.streams.retain_mut(|receiver| {
            // After part of a message nothing else can be read, so the receiver is left.
            let is_taken = receiver.send(message);
            if let Err(error) = &is_taken {
                tracing::warn!(peer = %receiver.peer, "the receiver is left: {error}");
            }
            is_taken.is_ok()
        });
        if lasts {
            self.lasting.insert((message.device.clone(), message.body.type_name().to_owned()), message.clone());
        }
    }

    /// Lets receivers take what was sent: closing a socket with unread bytes would discard it.
    fn leave(mut self) {
        let until = Instant::now() + LAST_WORDS;
        for receiver in &self.streams {
            let _ = receiver.stream.shutdown(Shutdown::Write);
        }
        while !self.streams.is_empty() && Instant::now() < until {
            self.listener = None;
            self.tried = Some(Instant::now());
            self.look();
            thread::sleep(LOOK);
        }
    }
}
