//! The connection to a sender.

use super::Role;
use osteoflow_formats::openigtlink::{Body, Message, Status};
use osteoflow_node::{Context, NodeError};
use std::{
    io::{ErrorKind, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs},
    time::{Duration, Instant},
};

/// How long a call waits for bytes before it looks whether to stop.
const LOOK: Duration = Duration::from_millis(50);
/// How long one try to connect takes at most; below the half second within which a source stops.
const TRY: Duration = Duration::from_millis(300);
/// Bytes that are read at a time.
const PIECE: usize = 64 << 10;

/// A connection, or the wish for one.
pub(super) struct Connection {
    role: Role,
    address: String,
    /// The least time between two TDATA that are asked for.
    tdata_ms: Option<u32>,
    listener: Option<TcpListener>,
    stream: Option<TcpStream>,
    peer: Option<SocketAddr>,
    buffer: Vec<u8>,
    /// Since when a connection is waited for.
    waits_since: Instant,
    /// Senders that came while another was connected.
    pub(super) turned_away: Vec<SocketAddr>,
}

/// What a call gave.
pub(super) enum Received<'a> {
    /// Bytes.
    Bytes(&'a [u8]),
    /// Nothing yet.
    Nothing,
    /// A sender was found.
    Connected(SocketAddr),
    /// The sender closed the connection, or it broke.
    Ended(String),
}

impl Connection {
    pub(super) fn new(role: Role, address: String, tdata_ms: Option<u32>) -> Self {
        Self {
            role,
            address,
            tdata_ms,
            listener: None,
            stream: None,
            peer: None,
            buffer: vec![0; PIECE],
            waits_since: Instant::now(),
            turned_away: Vec::new(),
        }
    }

    /// How long a connection has been waited for; zero while there is one.
    pub(super) fn waited(&self) -> Duration {
        if self.stream.is_some() { Duration::ZERO } else { self.waits_since.elapsed() }
    }

    /// Waits briefly for bytes or for a sender.
    pub(super) fn receive(&mut self, ctx: &Context) -> Result<Received<'_>, NodeError> {
        if self.role == Role::Server {
            self.accept()?;
        }
        if let (Some(_), Some(peer)) = (&self.stream, self.peer.take()) {
            return Ok(Received::Connected(peer));
        }
        let Some(stream) = &mut self.stream else {
            match self.role {
                Role::Server => {
                    ctx.wait_until(Instant::now() + LOOK);
                }
                Role::Client => self.connect(ctx)?,
            }
            return Ok(Received::Nothing);
        };
        match stream.read(&mut self.buffer) {
            Ok(0) => Ok(self.ended("the sender closed the connection".into())),
            Ok(n) => Ok(Received::Bytes(&self.buffer[..n])),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) =>
            {
                Ok(Received::Nothing)
            }
            Err(error) => Ok(self.ended(format!("the connection broke: {error}"))),
        }
    }

    fn ended(&mut self, why: String) -> Received<'static> {
        self.stream = None;
        self.waits_since = Instant::now();
        Received::Ended(why)
    }

    fn connect(&mut self, ctx: &Context) -> Result<(), NodeError> {
        let began = Instant::now();
        let addresses = self.address.to_socket_addrs().map_err(|error| {
            NodeError::new(format!(
                "\"{}\" is no address: {error}; write HOST:PORT, such as 127.0.0.1:18944",
                self.address
            ))
        })?;
        for address in addresses {
            if let Ok(stream) = TcpStream::connect_timeout(&address, TRY) {
                return self.take(stream, address);
            }
        }
        ctx.wait_until(began + TRY);
        Ok(())
    }

    fn accept(&mut self) -> Result<(), NodeError> {
        if self.listener.is_none() {
            let listener = TcpListener::bind(&self.address)
                .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
                .map_err(|error| NodeError::new(format!("cannot listen at {}: {error}", self.address)))?;
            self.listener = Some(listener);
        }
        let Some(Ok((stream, peer))) = self.listener.as_ref().map(TcpListener::accept) else { return Ok(()) };
        if self.stream.is_some() {
            // A second sender could give another pose of the same tool.
            self.turned_away.push(peer);
            return Ok(());
        }
        self.take(stream, peer)
    }

    fn take(&mut self, mut stream: TcpStream, peer: SocketAddr) -> Result<(), NodeError> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(LOOK))?;
        stream.set_write_timeout(Some(TRY))?;
        // PLUS answers in the header version of its client, and states lost tools in the metadata of version 2 only.
        let hello = Some(Body::Status(Status::new(Status::OK, "OK", "")));
        let query = self.tdata_ms.map(|interval_ms| Body::StartTracking { interval_ms, coordinates: String::new() });
        for body in hello.into_iter().chain(query) {
            if let Ok(bytes) = Message::new("Osteoflow", 0, body).extended(0, Vec::new()).to_bytes() {
                // A sender that takes nothing is no fault.
                let _ = stream.write_all(&bytes);
            }
        }
        (self.stream, self.peer) = (Some(stream), Some(peer));
        Ok(())
    }
}
