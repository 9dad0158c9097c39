//! The kind `acquire.foxglove_ws`.

mod ports;
mod protocol;

use super::{
    network::{Inbox, Incoming, NetworkParams, OpenError, Peer, Port, Protocol, Role, is_waiting},
    topic_params::PortParams,
    topic_port::Findings,
    topics::FrameNames,
};
use osteoflow_formats::mcap_read;
use osteoflow_geometry::StampNs;
use osteoflow_node::{
    Context, DeclaredPort, Describe, NodeError, ParamError, params, schemars::JsonSchema, serde::Deserialize, tracing,
};
use ports::Content;
use protocol::{Channel, FromServer, SUBPROTOCOLS, shortened};
use std::{
    collections::BTreeMap,
    net::TcpStream,
    time::{Duration, Instant},
};
use tungstenite::{
    ClientRequestBuilder, Error, HandshakeError, Message, WebSocket, http::Uri, protocol::WebSocketConfig,
};

/// How long a server may take to answer the request for the protocol.
const HANDSHAKE: Duration = Duration::from_secs(3);
/// Largest message: eight times an uncompressed image of 1920 by 1440 pixels.
const MAX_BYTES: usize = 64 << 20;
/// Channels of a server that are kept; a server of this many topics is none of a procedure.
const MAX_CHANNELS: usize = 10_000;
/// Topics that a message names.
const N_NAMED: usize = 20;
/// Form of an address.
const ADDRESS: &str = "ws://HOST:PORT, such as ws://127.0.0.1:8765";

/// Topics of a running Foxglove bridge: clouds, images, transforms and points of a ROS 2 system.
///
/// A client that only reads the topics that its ports name. Ports are those of `acquire.mcap`, so a graph for a recording reads
/// the bridge by another kind and an address. A topic of another schema or encoding, or one that is not advertised, is reported
/// with the topics that are there. Stamps are the sender's; the offset of its clock is reported. A lost tool is an empty that
/// says why. TLS (`wss://`) is not supported. docs/use/live.md has the rest.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.foxglove_ws"
address = "ws://127.0.0.1:8765"
out.scan        = { type = "geometry/Cloud", topic = "/camera/scan", frame = "camera" }
out.bone_marker = { type = "geometry/Pose", topic = "/tf", parent = "world", child = "bone_marker", to = "world", from = "bone_marker" }
"#)]
pub struct FoxgloveWs {
    socket: WebSocket<TcpStream>,
    found: Findings,
    timeout_s: f64,
    channels: BTreeMap<u64, Channel>,
    /// The channel of each subscription.
    subscriptions: BTreeMap<u32, Channel>,
    next_subscription: u32,
}

/// Parameters of [`FoxgloveWs`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Address of the server, with its path. ws://127.0.0.1:8765: that of foxglove_bridge.
    #[param("ws://127.0.0.1:8765")]
    pub address: String,
    /// Frames with another name in the graph, such as `{ camera_depth_optical_frame = "camera" }`.
    pub frames: BTreeMap<String, String>,
    /// What every source over a network has.
    #[serde(flatten)]
    pub network: NetworkParams,
}

/// The address of a server.
///
/// # Errors
/// What is wrong with it.
fn uri(address: &str) -> Result<Uri, String> {
    let uri: Uri = address.parse().map_err(|error| format!("\"{address}\" is no address: {error}"))?;
    match (uri.scheme_str(), uri.host()) {
        (Some("wss"), _) => {
            Err("TLS (wss) is not supported; use ws:// in a network that you trust, or a tunnel".into())
        }
        (Some("ws"), Some(_)) => Ok(uri),
        _ => Err(format!("\"{address}\" is not {ADDRESS}")),
    }
}

impl Protocol for FoxgloveWs {
    const KIND: &'static str = "acquire.foxglove_ws";
    const PEER: &'static str = "server";
    const MISSING: &'static str = "was not advertised";
    type Params = Params;
    type PortParams = PortParams;
    type Port = Content;

    fn network(params: &Params) -> &NetworkParams {
        &params.network
    }

    fn peer(params: &Params) -> Result<Peer, ParamError> {
        let uri = uri(&params.address).map_err(|message| ParamError::new("address", message))?;
        let (host, port) = (uri.host().unwrap_or_default(), uri.port_u16().unwrap_or(80));
        // The path may be a token.
        let (host_port, shown) = (format!("{host}:{port}"), params.address.splitn(4, '/').take(3).collect::<Vec<_>>());
        Ok(Peer { role: Role::Client, host_port, shown: shown.join("/"), form: ADDRESS })
    }

    fn ports(declared: &[DeclaredPort]) -> Result<Vec<Port<Content>>, ParamError> {
        declared.iter().map(Content::port).collect()
    }

    fn is_timed(port: &DeclaredPort) -> bool {
        PortParams::is_timed(port)
    }

    fn open(stream: TcpStream, params: &Params, ctx: &Context) -> Result<Self, OpenError> {
        let began = Instant::now();
        let uri = uri(&params.address).map_err(OpenError::NotReady)?;
        let request = ClientRequestBuilder::new(uri).with_header("Sec-WebSocket-Protocol", SUBPROTOCOLS);
        let config = WebSocketConfig::default().max_message_size(Some(MAX_BYTES)).max_frame_size(Some(MAX_BYTES));
        let mut shake = tungstenite::client::client_with_config(request, stream, Some(config));
        let socket = loop {
            match shake {
                Ok((socket, _)) => break socket,
                Err(HandshakeError::Interrupted(_)) if ctx.cancelled() => {
                    return Err(OpenError::NotReady("the run was stopped".into()));
                }
                Err(HandshakeError::Interrupted(_)) if began.elapsed() > HANDSHAKE => {
                    let why = format!("it did not answer the request for a WebSocket within {HANDSHAKE:?}");
                    return Err(OpenError::NotReady(why));
                }
                Err(HandshakeError::Interrupted(next)) => shake = next.handshake(),
                Err(HandshakeError::Failure(Error::Http(response))) => {
                    let body = String::from_utf8_lossy(response.body().as_deref().unwrap_or_default()).into_owned();
                    return Err(OpenError::Refused(format!("{} {}", response.status(), shortened(body.trim()))));
                }
                Err(HandshakeError::Failure(error)) => {
                    let why = format!("it does not speak the protocol ({error}); is it a Foxglove WebSocket server?");
                    return Err(OpenError::NotReady(why));
                }
            }
        };
        let found = Findings { frames: FrameNames::new(&params.frames), ..Findings::default() };
        let (timeout_s, channels, subscriptions) = (params.network.timeout_s, BTreeMap::new(), BTreeMap::new());
        Ok(Self { socket, found, timeout_s, channels, subscriptions, next_subscription: 1 })
    }

    fn receive(&mut self, inbox: &mut Inbox<Content>, ctx: &mut Context) -> Result<Incoming, NodeError> {
        let message = match self.socket.read() {
            Ok(Message::Text(text)) => FromServer::of_text(&text),
            Ok(Message::Binary(bytes)) => FromServer::of_binary(&bytes),
            Ok(Message::Close(Some(frame))) if !frame.reason.is_empty() => {
                return Ok(end(format!("the server closed the connection: {}", shortened(&frame.reason))));
            }
            Ok(Message::Close(_)) | Err(Error::ConnectionClosed | Error::AlreadyClosed) => {
                return Ok(end("the server closed the connection".into()));
            }
            Ok(_) => return Ok(Incoming::Nothing),
            Err(Error::Io(error)) if is_waiting(&error) => return Ok(Incoming::Nothing),
            Err(Error::Capacity(error)) => {
                let size = format!("the server sent a message above {} MiB ({error})", MAX_BYTES >> 20);
                return Ok(end(format!("{size}, and the connection was closed")));
            }
            Err(error) => return Ok(end(format!("the connection broke: {error}"))),
        };
        match message {
            Ok(message) => self.message(message, inbox, ctx).map(|()| Incoming::Message),
            Err(damage) => Ok(Incoming::Damage(damage)),
        }
    }

    fn is_useless(&self, inbox: &Inbox<Content>) -> Option<String> {
        if inbox.ports.iter().any(|port| port.missing().len() < port.streams.len()) {
            return None;
        }
        let topics: Vec<&str> = inbox.ports.iter().flat_map(Port::missing).collect();
        let (wanted, timeout_s, others) = (topics.join(", "), self.timeout_s, self.others());
        Some(format!("none of {wanted} was advertised within {timeout_s} s; {others}"))
    }

    fn others(&self) -> String {
        let described = |c: &Channel| shortened(&format!("{} ({})", c.topic, c.schema_name));
        let mut topics: Vec<String> = self.channels.values().map(described).collect();
        topics.sort();
        match topics.len() {
            0 => "the server advertises no topic".into(),
            n if n > N_NAMED => format!("the server has {} and {} more", topics[..N_NAMED].join(", "), n - N_NAMED),
            _ => format!("the server has {}", topics.join(", ")),
        }
    }
}

fn end(reason: String) -> Incoming {
    Incoming::End { reason, is_orderly: false }
}

impl FoxgloveWs {
    fn message(&mut self, message: FromServer, inbox: &mut Inbox<Content>, ctx: &mut Context) -> Result<(), NodeError> {
        match message {
            FromServer::Info(name, metadata) => {
                tracing::info!(name, "a server of the Foxglove WebSocket protocol");
                for port in &mut inbox.ports {
                    port.inform(&metadata).map_err(|error| NodeError::new(error.message))?;
                }
            }
            FromServer::Advertise(channels, n_unread) => {
                if n_unread > 0 {
                    let message = format!("{n_unread} advertised channels lack id, topic, encoding or schemaName");
                    inbox.warn("damage", message, ctx);
                }
                self.subscribe(channels, inbox, ctx)?;
            }
            FromServer::Unadvertise(ids) => {
                for id in ids {
                    self.channels.remove(&id);
                    let ended = self.subscriptions.extract_if(.., |_, channel| channel.id == id).map(|(_, c)| c.topic);
                    for topic in ended.collect::<Vec<_>>() {
                        let why = format!("{topic} is no longer advertised");
                        inbox.lose(&why, |port| port.reads(&topic));
                        inbox.warn("unadvertised", why, ctx);
                    }
                }
            }
            FromServer::Status(0, message) => tracing::info!(message, "status of the server"),
            FromServer::Status(level, message) => {
                let level = if level == 1 { "warns" } else { "reports an error" };
                inbox.warn("status", format!("the server {level}: {message}"), ctx);
            }
            FromServer::Data { subscription, log_time_ns, data } => match self.subscriptions.get(&subscription) {
                Some(Channel { topic, schema_name, encoding, .. }) => {
                    let time_ns = StampNs::try_from(log_time_ns).unwrap_or(0);
                    let message = mcap_read::Message {
                        log_time_ns: time_ns,
                        publish_time_ns: time_ns,
                        sequence: 0,
                        schema_name: schema_name.clone(),
                        message_encoding: encoding.clone(),
                        data,
                    };
                    inbox.arrive(ctx);
                    let found = &mut self.found;
                    let newest_ns = inbox.offer(topic, ctx, |port| Some(port.read(topic, &message, found)));
                    // Constants have no time.
                    if let Some(sent_ns) = newest_ns.filter(|ns| *ns > 0) {
                        inbox.stamp(Some(sent_ns), ctx);
                    }
                }
                None => {
                    let message = format!("a message of subscription {subscription} came, which was not asked for");
                    inbox.warn("unknown subscription", message, ctx);
                }
            },
            FromServer::Other => {}
        }
        Ok(())
    }

    /// Subscribes to the topics of ports.
    fn subscribe(
        &mut self,
        channels: Vec<Channel>,
        inbox: &mut Inbox<Content>,
        ctx: &mut Context,
    ) -> Result<(), NodeError> {
        let mut wanted = Vec::new();
        for channel in channels {
            if self.channels.len() >= MAX_CHANNELS && !self.channels.contains_key(&channel.id) {
                let message =
                    format!("more than {MAX_CHANNELS} channels are advertised; {} is left out", channel.topic);
                inbox.warn("channels", message, ctx);
                continue;
            }
            for port in 0..inbox.ports.len() {
                let late = inbox.ports[port].advertised(&channel.topic).map_err(NodeError::new)?;
                late.into_iter().for_each(|late| inbox.warn("advertised late", late, ctx));
            }
            let readers = inbox.ports.iter().filter(|port| port.reads(&channel.topic));
            let checks: Vec<_> = readers.map(|port| port.check(&channel)).collect();
            let is_known = self.channels.insert(channel.id, channel.clone()).is_some_and(|known| known == channel);
            if checks.is_empty() || (is_known && self.subscriptions.values().any(|s| s.id == channel.id)) {
                continue;
            }
            // Its messages are those of another channel now.
            self.subscriptions.retain(|_, s| s.id != channel.id);
            if let Some(fault) = checks.into_iter().find_map(Result::err) {
                if !inbox.has_items() {
                    return Err(NodeError::new(format!("{fault}; {}", self.others())));
                }
                inbox.warn("schema", fault, ctx);
                continue;
            }
            if self.subscriptions.values().any(|s| s.topic == channel.topic) {
                let message = format!("{} is advertised twice; the first channel is read", channel.topic);
                inbox.warn("twice", message, ctx);
                continue;
            }
            inbox.note_present(&channel.topic);
            wanted.push((self.next_subscription, channel.id));
            self.subscriptions.insert(self.next_subscription, channel);
            self.next_subscription = self.next_subscription.wrapping_add(1);
        }
        if !wanted.is_empty() {
            // A connection that breaks is found by the next read.
            let _ = self.socket.send(Message::text(protocol::subscribe(&wanted)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
