//! Connections to a peer, or from it.

use osteoflow_node::{Context, NodeError, schemars::JsonSchema, serde::Deserialize};
use std::{
    io::{self, ErrorKind},
    net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs},
    time::{Duration, Instant},
};

/// Time for which a read waits for bytes before the source checks whether to stop.
const LOOK: Duration = Duration::from_millis(50);
/// Longest time of one try to connect; below the half second within which a source stops.
pub(super) const TRY: Duration = Duration::from_millis(300);

/// Who connects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// This side.
    Client,
    /// The other side.
    Server,
}

/// The other side, or where to listen for it.
#[derive(Debug, Clone)]
pub(crate) struct Peer {
    pub(crate) role: Role,
    /// Host and port.
    pub(crate) host_port: String,
    /// The address in messages.
    pub(crate) shown: String,
    /// The form of an address, with an example, in messages.
    pub(crate) form: &'static str,
}

/// Makes connections, one at a time.
pub(super) struct Connector {
    pub(super) peer: Peer,
    listener: Option<TcpListener>,
    /// Since when a connection is waited for.
    pub(super) since: Instant,
    /// Why the last try failed.
    pub(super) why: String,
    /// Peers that came while another was connected.
    pub(super) turned_away: Vec<SocketAddr>,
}

impl Connector {
    pub(super) fn new(peer: Peer) -> Self {
        let why = "nobody listens there".into();
        Self { peer, listener: None, since: Instant::now(), why, turned_away: Vec::new() }
    }

    /// Waits from now.
    pub(super) fn restart(&mut self) {
        self.since = Instant::now();
    }

    /// The message when nobody was connected in time.
    pub(super) fn no_connection(&self, peer: &str, timeout_s: f64) -> String {
        let (shown, why) = (&self.peer.shown, &self.why);
        match self.peer.role {
            Role::Client => format!("no connection to {shown} within {timeout_s} s: {why}"),
            Role::Server => format!("no {peer} connected to {shown} within {timeout_s} s"),
        }
    }

    /// A new connection, if there is one; waits briefly for it unless one is open.
    pub(super) fn stream(
        &mut self,
        is_open: bool,
        ctx: &Context,
    ) -> Result<Option<(TcpStream, SocketAddr)>, NodeError> {
        let connection = match self.peer.role {
            Role::Client if is_open => None,
            Role::Client => self.connect(ctx)?,
            Role::Server => self.accept()?,
        };
        match connection {
            Some((_, peer)) if is_open => {
                // A second sender could give another pose of the same tool.
                self.turned_away.push(peer);
                Ok(None)
            }
            Some((stream, peer)) => {
                stream.set_nonblocking(false)?;
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(LOOK))?;
                stream.set_write_timeout(Some(TRY))?;
                Ok(Some((stream, peer)))
            }
            None => {
                if self.peer.role == Role::Server && !is_open {
                    ctx.wait_until(Instant::now() + LOOK);
                }
                Ok(None)
            }
        }
    }

    fn connect(&mut self, ctx: &Context) -> Result<Option<(TcpStream, SocketAddr)>, NodeError> {
        let (began, Peer { host_port, form, .. }) = (Instant::now(), &self.peer);
        let addresses = host_port
            .to_socket_addrs()
            .map_err(|error| NodeError::new(format!("\"{host_port}\" is no address: {error}; write {form}")))?;
        for address in addresses {
            match TcpStream::connect_timeout(&address, TRY) {
                Ok(stream) => return Ok(Some((stream, address))),
                Err(error) => self.why = format!("{error}; is the server running there?"),
            }
        }
        ctx.wait_until(began + TRY);
        Ok(None)
    }

    fn accept(&mut self) -> Result<Option<(TcpStream, SocketAddr)>, NodeError> {
        let listener = match &self.listener {
            Some(listener) => listener,
            None => self.listener.insert(listen(&self.peer.host_port).map_err(NodeError::new)?),
        };
        Ok(listener.accept().ok())
    }
}

/// Listens at an address without waiting there.
///
/// # Errors
/// The reason, with the address.
pub(crate) fn listen(address: &str) -> Result<TcpListener, String> {
    TcpListener::bind(address)
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
        .map_err(|error| format!("cannot listen at {address}: {error}"))
}

/// Whether a read failed because nothing came in time.
pub(crate) fn is_waiting(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
