//! The server: the page, and the stream to viewers, at one address.

use crate::{
    access::{Access, Credentials, Pass, Refusal, token},
    door::{Door, Role},
    http::{PATIENCE, Request, Response},
    page,
    playback::Playback,
    protocol::{self, FromClient, Level, SUBPROTOCOLS},
    stream::{Out, Stream, Totals, Viewer},
};
use serde_json::Value;
use std::{
    fmt,
    io::{self, Read, Write},
    net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};
use tungstenite::{
    Message, WebSocket,
    handshake::derive_accept_key,
    protocol::{Role as Side, WebSocketConfig},
};

/// Connections at a time; a browser opens six to one address.
const MAX_CONNECTIONS: usize = 64;
/// Longest message of a viewer.
const MAX_MESSAGE_BYTES: usize = 1 << 20;
/// Time after which a viewer that takes nothing is left.
const STUCK: Duration = Duration::from_secs(30);
/// How long a viewer's thread waits for a message before it looks whether to end.
const LOOK: Duration = Duration::from_millis(500);
/// What is said where no door is.
const NOTHING: &str = "there is nothing at this address";
/// Time for viewers to receive the end of the stream.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// How to serve.
#[derive(Debug, Clone)]
pub struct ServeOptions {
    /// Where to listen; port 0 for a free one.
    pub address: SocketAddr,
    /// Origins whose pages may connect besides the server's own, with the most that they may do.
    pub allowed_origins: Vec<(String, Role)>,
    /// What is served: the name of a graph or a file.
    pub name: String,
}

impl ServeOptions {
    /// On the loopback, at a free port.
    pub fn new(name: impl Into<String>) -> Self {
        Self { address: (Ipv4Addr::LOCALHOST, 0).into(), allowed_origins: Vec::new(), name: name.into() }
    }
}

/// What is behind the page and the stream. All of it is optional.
pub trait App: Send + Sync {
    /// The doors that it answers, besides those of the page and the stream. Viewers of the protocol may call some as services.
    fn doors(&self) -> &'static [Door] {
        &[]
    }

    /// Does what a request at one of its doors says; the role of its sender is at least the one that the door needs.
    ///
    /// # Errors
    /// A sentence for the user.
    fn act(&self, door: Door, _role: Role, _request: &[u8]) -> Result<Value, String> {
        Err(format!("there is no {}", door.action().unwrap_or_default()))
    }

    /// Parameters of nodes, `icp.max_iterations`.
    fn parameters(&self) -> Vec<(String, Value)> {
        Vec::new()
    }

    /// Sets parameters, all of them or none.
    ///
    /// # Errors
    /// A sentence for the user.
    fn set_parameters(&self, values: &[(String, Value)], _role: Role) -> Result<(), String> {
        let names: Vec<&str> = values.iter().map(|(name, _)| name.as_str()).collect();
        Err(format!("{} cannot be changed here", names.join(", ")))
    }

    /// The recording that is played, if one is.
    fn playback(&self) -> Option<&Playback> {
        None
    }
}

/// An app without anything: a run that is only watched.
#[derive(Debug, Clone, Copy)]
pub struct NoApp;

impl App for NoApp {}

/// A server that runs.
pub struct Server {
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

struct Shared {
    access: Access,
    name: String,
    /// Changes with each start, so that viewers do not take one run for another.
    session: String,
    stream: Arc<Stream>,
    app: Arc<dyn App>,
    is_ending: AtomicBool,
    n_connections: AtomicUsize,
}

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Server").field("address", &self.shared.access.address).finish_non_exhaustive()
    }
}

impl Server {
    /// Listens, and serves from threads of its own.
    ///
    /// # Errors
    /// The address cannot be listened at, or the system gives no random numbers for the token.
    pub fn start(options: ServeOptions, stream: Arc<Stream>, app: Arc<dyn App>) -> io::Result<Self> {
        let listener = TcpListener::bind(options.address)?;
        let tokens = [token()?, token()?, token()?];
        let access = Access { address: listener.local_addr()?, tokens, allowed_origins: options.allowed_origins };
        let (is_ending, n_connections) = (AtomicBool::new(false), AtomicUsize::new(0));
        let session = token()?;
        let shared = Arc::new(Shared { access, name: options.name, session, stream, app, is_ending, n_connections });
        let of_acceptor = shared.clone();
        let acceptor = thread::Builder::new().name("viewers".into()).spawn(move || accept(&listener, &of_acceptor))?;
        Ok(Self { shared, acceptor: Some(acceptor) })
    }

    /// The address of the page, with the token of a role.
    pub fn page(&self, role: Role) -> String {
        format!("http://{}/{}/", self.host(), self.shared.access.token(role))
    }

    /// The address for viewers of the protocol, with the token of a role.
    pub fn stream_address(&self, role: Role) -> String {
        format!("ws://{}/{}", self.host(), self.shared.access.token(role))
    }

    fn host(&self) -> SocketAddr {
        let mut address = self.shared.access.address;
        if address.ip().is_unspecified() {
            // The address of this machine in its network is not known here.
            address.set_ip(IpAddr::V4(Ipv4Addr::LOCALHOST));
        }
        address
    }

    /// Sends what waits, closes all connections, and returns how many messages were sent.
    pub fn end(mut self) -> Totals {
        self.close()
    }

    fn close(&mut self) -> Totals {
        let Some(acceptor) = self.acceptor.take() else { return self.shared.stream.totals() };
        self.shared.stream.end();
        let began = Instant::now();
        while self.shared.n_connections.load(Ordering::Relaxed) > 0 && began.elapsed() < LAST_WORDS {
            thread::sleep(Duration::from_millis(5));
        }
        self.shared.is_ending.store(true, Ordering::Relaxed);
        // Wakes the acceptor.
        let _ = TcpStream::connect_timeout(&self.host(), Duration::from_secs(1));
        let _ = acceptor.join();
        self.shared.stream.totals()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.close();
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for connection in listener.incoming() {
        if shared.is_ending.load(Ordering::Relaxed) {
            return;
        }
        let Ok(connection) = connection else { continue };
        if shared.n_connections.fetch_add(1, Ordering::Relaxed) >= MAX_CONNECTIONS {
            shared.n_connections.fetch_sub(1, Ordering::Relaxed);
            let _ = connection.shutdown(Shutdown::Both);
            continue;
        }
        let of_thread = shared.clone();
        let started = thread::Builder::new().name("viewer".into()).spawn(move || {
            serve(connection, &of_thread);
            of_thread.n_connections.fetch_sub(1, Ordering::Relaxed);
        });
        if started.is_err() {
            shared.n_connections.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// A connection that must have sent its request by a time.
struct Deadline<'a>(&'a TcpStream, Instant);

impl Read for Deadline<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let remaining = self.1.saturating_duration_since(Instant::now());
        self.0.set_read_timeout(Some(remaining.max(Duration::from_millis(1))))?;
        self.0.read(buffer)
    }
}

fn serve(mut connection: TcpStream, shared: &Arc<Shared>) {
    let _ = connection.set_nodelay(true);
    let _ = connection.set_write_timeout(Some(STUCK));
    let by = Instant::now() + PATIENCE;
    let response = match Request::read(&mut Deadline(&connection, by)) {
        Ok(request) => match answer(&connection, request, by, shared) {
            Some(response) => response,
            None => return,
        },
        Err(Some((status, message))) => Response::refused(status, message),
        Err(None) => return,
    };
    let _ = response.write(&mut connection);
}

/// The response to a request, whose body is read once its sender is known to be admitted; `None` if none is due any more.
fn answer(mut connection: &TcpStream, mut request: Request, by: Instant, shared: &Arc<Shared>) -> Option<Response> {
    let path = request.path.split('?').next().unwrap_or_default().to_owned();
    let credentials = Credentials { path: &path, hosts: request.all("host"), origins: request.all("origin") };
    let is_stream = request.lists("upgrade", "websocket");
    let admitted = shared.access.check(&credentials).and_then(|(rest, pass)| {
        if !is_stream && !["GET", "POST"].contains(&&*request.method) {
            return Err(Refusal(405, "GET and POST are served".into()));
        }
        let door = if is_stream { Some(Door::Stream) } else { Door::of_request(&request.method, rest) };
        let door = door.ok_or_else(|| Refusal(404, NOTHING.into()))?;
        pass.admits(door).map_err(|message| Refusal(403, message))?;
        Ok((rest.to_owned(), pass, door))
    });
    let body = request.read_body(&mut Deadline(connection, by), admitted.is_ok());
    let (rest, pass, door) = match admitted {
        Ok(admitted) => admitted,
        Err(Refusal(status, message)) => return Some(Response::refused(status, &message)),
    };
    if let Err(fault) = body {
        return fault.map(|(status, message)| Response::refused(status, message));
    }
    if door != Door::Stream {
        return Some(respond(&request, &rest, door, pass.role, shared));
    }
    match upgrade(&request) {
        Err(message) => Some(Response::refused(400, message)),
        Ok(head) => {
            let query = request.path.split_once('?').map_or("", |(_, query)| query);
            let plays = query.split('&').any(|word| word == "playback");
            if connection.write_all(head.as_bytes()).is_ok()
                && let Ok(connection) = connection.try_clone()
            {
                view(connection, shared, plays, &pass);
            }
            None
        }
    }
}

fn respond(request: &Request, rest: &str, door: Door, role: Role, shared: &Shared) -> Response {
    if door != Door::Page {
        return match shared.app.doors().contains(&door).then(|| shared.app.act(door, role, &request.body)) {
            Some(Ok(value)) => Response::json(&value),
            Some(Err(message)) => Response::refused(422, &message),
            None => Response::refused(404, NOTHING),
        };
    }
    // Relative addresses of the page need the slash.
    if rest.is_empty() && !request.path.ends_with('/') {
        let mut moved = Response::refused(308, "the page is one slash further");
        moved.headers = format!("Location: {}/\r\n", request.path);
        return moved;
    }
    page::file(rest, &shared.access.allowed_origins).unwrap_or_else(|| Response::refused(404, NOTHING))
}

/// The head of the answer that makes a connection a WebSocket.
///
/// # Errors
/// What the request lacks.
fn upgrade(request: &Request) -> Result<String, &'static str> {
    let [key] = request.all("sec-websocket-key")[..] else { return Err("one Sec-WebSocket-Key is needed") };
    let is_whole = request.method == "GET" && request.lists("connection", "upgrade");
    if !is_whole || request.all("sec-websocket-version") != ["13"] {
        return Err("this is no handshake of WebSocket version 13");
    }
    let offered = SUBPROTOCOLS.iter().find(|known| request.words("sec-websocket-protocol").any(|word| word == **known));
    let protocol = offered.ok_or("the subprotocol foxglove.sdk.v1 or foxglove.websocket.v1 is needed")?;
    Ok(format!(
        "HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Accept: {}\r\n\
         Sec-WebSocket-Protocol: {protocol}\r\n\r\n",
        derive_accept_key(key.as_bytes())
    ))
}

/// A connection that one thread reads and another writes. Each write is whole, so that frames of both stay whole.
struct Duplex(TcpStream, Arc<Mutex<TcpStream>>);

impl Read for Duplex {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Write for Duplex {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.1.lock().unwrap_or_else(PoisonError::into_inner).write_all(bytes).map(|()| bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Serves a viewer until it leaves; `plays` if its address asks for the state of a playback (`?playback`).
fn view(connection: TcpStream, shared: &Arc<Shared>, plays: bool, pass: &Pass) {
    let (Ok(for_writer), Ok(to_close)) = (connection.try_clone(), connection.try_clone()) else { return };
    let (Ok(a), Ok(b)) = (connection.try_clone(), connection.try_clone()) else { return };
    let _ = connection.set_read_timeout(None);
    let both = Arc::new(Mutex::new(for_writer));
    let config =
        WebSocketConfig::default().max_message_size(Some(MAX_MESSAGE_BYTES)).max_frame_size(Some(MAX_MESSAGE_BYTES));
    let mut reader = WebSocket::from_raw_socket(Duplex(a, both.clone()), Side::Server, Some(config));
    let mut writer = WebSocket::from_raw_socket(Duplex(b, both), Side::Server, None);

    let services = shared.services();
    let offers = services.iter().any(|door| pass.admits(*door).is_ok());
    let info = protocol::server_info(
        &shared.name,
        &shared.session,
        pass.role,
        offers,
        shared.app.playback().map(Playback::range_ns),
    );
    if writer.send(Message::text(info)).is_err() {
        return;
    }
    let viewer = shared.stream.join();
    if plays {
        viewer.take_playback();
    }
    if let Some(state) = shared.app.playback().map(Playback::state) {
        viewer.send(Out::Binary(protocol::playback_state(&state, false, "")));
    }
    if offers {
        viewer.send(Out::Text(protocol::advertise_services(&services, pass.role)));
    }
    let of_writer = viewer.clone();
    let ending = shared.clone();
    let started = thread::Builder::new().name("viewer".into()).spawn(move || {
        while let Some(messages) = of_writer.take(LOOK) {
            for message in messages {
                let message = match message {
                    Out::Text(text) => Message::text(text),
                    Out::Binary(bytes) => Message::binary(bytes),
                };
                if writer.send(message).is_err() {
                    let _ = to_close.shutdown(Shutdown::Both);
                    return;
                }
            }
            if ending.is_ending.load(Ordering::Relaxed) {
                break;
            }
        }
        let _ = writer.close(None);
        let _ = writer.flush();
        let _ = to_close.shutdown(Shutdown::Both);
    });
    if started.is_ok() {
        while let Ok(message) = reader.read() {
            let request = match &message {
                Message::Text(text) => protocol::read_text(text),
                Message::Binary(bytes) => protocol::read_binary(bytes),
                _ => continue,
            };
            if let Err(fault) = request.and_then(|request| shared.reply(&viewer, pass, &services, request)) {
                viewer.send(Out::Text(protocol::status(Level::Error, &fault, "request")));
            }
            if viewer.is_closed() {
                // Its thread may wait for it to read.
                let _ = connection.shutdown(Shutdown::Both);
                break;
            }
        }
    }
    shared.stream.leave(&viewer);
}

impl Shared {
    /// The doors that viewers of the protocol may call.
    fn services(&self) -> Vec<Door> {
        self.app.doors().iter().copied().filter(|door| door.service().is_some()).collect()
    }

    /// Replies to a message of a viewer.
    ///
    /// # Errors
    /// A sentence for the viewer.
    fn reply(&self, viewer: &Viewer, pass: &Pass, services: &[Door], request: FromClient) -> Result<(), String> {
        let door = request.door(services);
        let admitted = door.and_then(|door| pass.admits(door).map(|()| door));
        match request {
            // These are answered in a way of their own where they are refused.
            FromClient::SetParameters { .. } | FromClient::Service(_) => {}
            _ => drop(admitted.clone()?),
        }
        match request {
            FromClient::Subscribe(pairs) => {
                pairs.into_iter().try_for_each(|(id, channel)| self.stream.subscribe(viewer, id, channel))?;
            }
            FromClient::Unsubscribe(ids) => ids.into_iter().for_each(|id| viewer.unsubscribe(id)),
            FromClient::GetParameters { names, id } => {
                let all = self.app.parameters();
                let requested = all.into_iter().filter(|(name, _)| names.is_empty() || names.contains(name));
                let values: Vec<_> = requested.collect();
                viewer.send(Out::Text(protocol::parameter_values(&values, id.as_deref())));
            }
            FromClient::SetParameters { values, id } => {
                let set = admitted.and_then(|_| self.app.set_parameters(&values, pass.role));
                // Of a refused one the viewer is sent what it still is.
                let now = self.app.parameters().into_iter();
                let now: Vec<_> = now.filter(|(name, _)| values.iter().any(|(set, _)| set == name)).collect();
                viewer.send(Out::Text(protocol::parameter_values(&now, id.as_deref())));
                set?;
                self.stream.publish_parameters(&now);
            }
            FromClient::Service(call) => {
                let request = call.request.to_string();
                viewer.send(match admitted.and_then(|door| self.app.act(door, pass.role, request.as_bytes())) {
                    Ok(reply) => Out::Binary(protocol::service_response(&call, &reply)),
                    Err(message) => Out::Text(protocol::service_failure(&call, &message)),
                });
            }
            FromClient::Playback(request) => {
                let speed = request.speed;
                if !(speed > 0.0 && speed <= 1e6) {
                    return Err(format!("a playback speed of {speed} is not possible"));
                }
                viewer.take_playback();
                let playback = self.app.playback().ok_or("nothing is played back: this is live")?;
                let state = playback.play(request.plays, speed, request.seek_ns);
                // The playback announces a jump to all viewers, before what follows it.
                let bytes = protocol::playback_state(&state, false, &request.id);
                viewer.send(Out::Binary(bytes));
            }
            FromClient::Other => {}
        }
        Ok(())
    }
}
