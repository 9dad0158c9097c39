//! The connection to a server of the Foxglove WebSocket protocol.

use super::protocol::{SUBPROTOCOLS, shortened};
use bytes::Bytes;
use osteoflow_node::{Context, NodeError};
use std::{
    io::ErrorKind,
    net::{TcpStream, ToSocketAddrs},
    time::{Duration, Instant},
};
use tungstenite::{
    ClientRequestBuilder, Error, HandshakeError, Message, WebSocket, http::Uri, protocol::WebSocketConfig,
};

/// How long a call waits for bytes before it looks whether to stop.
const LOOK: Duration = Duration::from_millis(50);
/// How long one try to connect takes at most; below the half second within which a source stops.
const TRY: Duration = Duration::from_millis(300);
/// How long a server may take to answer the request for the protocol.
const HANDSHAKE: Duration = Duration::from_secs(3);
/// Largest message: eight times an uncompressed image of 1920 by 1440 pixels.
pub(super) const MAX_BYTES: usize = 64 << 20;

/// A connection, or the wish for one.
pub(super) struct Connection {
    uri: Uri,
    socket: Option<WebSocket<TcpStream>>,
    /// Since when a connection is waited for.
    waits_since: Instant,
    /// Why the last try failed.
    why: String,
}

/// What a call gave.
#[derive(Debug)]
pub(super) enum Received {
    /// JSON, as far as it is.
    Text(String),
    Binary(Bytes),
    /// Nothing yet.
    Nothing,
    /// A server was found.
    Connected,
    /// The server closed the connection, or it broke.
    Ended(String),
    /// The server refuses this client.
    Refused(String),
}

/// The address of a server.
///
/// # Errors
/// What is wrong with it.
pub(super) fn uri(address: &str) -> Result<Uri, String> {
    let uri: Uri = address.parse().map_err(|error| format!("\"{address}\" is no address: {error}"))?;
    match (uri.scheme_str(), uri.host()) {
        (Some("wss"), _) => {
            Err("TLS (wss) is not supported; use ws:// in a network that you trust, or a tunnel".into())
        }
        (Some("ws"), Some(_)) => Ok(uri),
        _ => Err(format!("\"{address}\" is not ws://HOST:PORT, such as ws://127.0.0.1:8765")),
    }
}

impl Connection {
    pub(super) fn new(uri: Uri) -> Self {
        Self { uri, socket: None, waits_since: Instant::now(), why: "nobody listens there".into() }
    }

    /// Counts the time to connect from now.
    pub(super) fn begin(&mut self) {
        self.waits_since = Instant::now();
    }

    /// How long a connection has been waited for; zero while there is one.
    pub(super) fn waited(&self) -> Duration {
        if self.socket.is_some() { Duration::ZERO } else { self.waits_since.elapsed() }
    }

    /// Why the last try to connect failed.
    pub(super) fn why(&self) -> &str {
        &self.why
    }

    /// Waits briefly for a message or for the server.
    pub(super) fn receive(&mut self, ctx: &Context) -> Result<Received, NodeError> {
        let Some(socket) = &mut self.socket else { return self.connect(ctx) };
        let ended = match socket.read() {
            Ok(Message::Text(text)) => return Ok(Received::Text(text.as_str().to_owned())),
            Ok(Message::Binary(bytes)) => return Ok(Received::Binary(bytes)),
            Ok(Message::Close(Some(frame))) if !frame.reason.is_empty() => {
                format!("the server closed the connection: {}", shortened(&frame.reason))
            }
            Ok(Message::Close(_)) | Err(Error::ConnectionClosed | Error::AlreadyClosed) => {
                "the server closed the connection".into()
            }
            Ok(_) => return Ok(Received::Nothing),
            Err(Error::Io(error)) if is_waiting(error.kind()) => return Ok(Received::Nothing),
            Err(Error::Capacity(error)) => {
                format!(
                    "the server sent a message above {} MiB ({error}), and the connection was closed",
                    MAX_BYTES >> 20
                )
            }
            Err(error) => format!("the connection broke: {error}"),
        };
        self.socket = None;
        self.waits_since = Instant::now();
        Ok(Received::Ended(ended))
    }

    /// Sends a text; a connection that breaks is found by the next `receive`.
    pub(super) fn send(&mut self, text: String) {
        if let Some(socket) = &mut self.socket {
            let _ = socket.send(Message::text(text));
        }
    }

    fn connect(&mut self, ctx: &Context) -> Result<Received, NodeError> {
        let began = Instant::now();
        let (host, port) = (self.uri.host().unwrap_or_default(), self.uri.port_u16().unwrap_or(80));
        let addresses = (host.trim_matches(['[', ']']), port)
            .to_socket_addrs()
            .map_err(|error| NodeError::new(format!("\"{host}:{port}\" is no address: {error}")))?;
        for address in addresses {
            match TcpStream::connect_timeout(&address, TRY) {
                Ok(stream) => {
                    stream.set_nodelay(true)?;
                    stream.set_read_timeout(Some(LOOK))?;
                    stream.set_write_timeout(Some(TRY))?;
                    return Ok(self.handshake(stream, ctx));
                }
                Err(error) => self.why = error.to_string(),
            }
        }
        ctx.wait_until(began + TRY);
        Ok(Received::Nothing)
    }

    /// Asks for the protocol.
    fn handshake(&mut self, stream: TcpStream, ctx: &Context) -> Received {
        let began = Instant::now();
        let request = ClientRequestBuilder::new(self.uri.clone()).with_header("Sec-WebSocket-Protocol", SUBPROTOCOLS);
        let config = WebSocketConfig::default().max_message_size(Some(MAX_BYTES)).max_frame_size(Some(MAX_BYTES));
        let mut shake = tungstenite::client::client_with_config(request, stream, Some(config));
        loop {
            match shake {
                Ok((socket, _)) => {
                    self.socket = Some(socket);
                    return Received::Connected;
                }
                Err(HandshakeError::Interrupted(_)) if ctx.cancelled() => return Received::Nothing,
                Err(HandshakeError::Interrupted(_)) if began.elapsed() > HANDSHAKE => {
                    self.why = format!("it did not answer the request for a WebSocket within {HANDSHAKE:?}");
                    return Received::Nothing;
                }
                Err(HandshakeError::Interrupted(next)) => shake = next.handshake(),
                Err(HandshakeError::Failure(Error::Http(answer))) => {
                    let body = String::from_utf8_lossy(answer.body().as_deref().unwrap_or_default()).into_owned();
                    return Received::Refused(format!("{} {}", answer.status(), shortened(body.trim())));
                }
                Err(HandshakeError::Failure(error)) => {
                    self.why = format!("it does not speak the protocol ({error}); is it a Foxglove WebSocket server?");
                    ctx.wait_until(began + TRY);
                    return Received::Nothing;
                }
            }
        }
    }
}

fn is_waiting(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
