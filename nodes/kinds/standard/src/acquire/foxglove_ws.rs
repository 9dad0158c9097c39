//! The kind `acquire.foxglove_ws`.

mod connection;
mod ports;
mod protocol;

pub use ports::PortParams;

use connection::{Connection, Received};
use osteoflow_formats::{message_read::Encoded, openigtlink::ClockOffset};
use osteoflow_geometry::StampNs;
use osteoflow_node::{
    Context, Declared, Describe, Emission, NodeError, ParamError, Source, schemars::JsonSchema, serde::Deserialize,
    tracing,
};
use osteoflow_payloads::Flag;
use ports::Port;
use protocol::{Channel, FromServer};
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::{Duration, Instant},
};

/// Warnings of each sort; more are counted.
const N_WARNINGS: usize = 10;
/// Channels of a server that are kept; a server of this many topics is none of a procedure.
const MAX_CHANNELS: usize = 10_000;
/// Topics that a message names.
const N_NAMED: usize = 20;

/// Topics of a running Foxglove bridge: clouds, transforms and points of a ROS 2 system.
///
/// A client of the Foxglove WebSocket protocol that only reads: it subscribes to the topics that its ports name, and to nothing else.
/// Each entry of `out` is a port with a `type` and a topic. Protobuf, JSON and CDR; metres become millimetres. A topic of another schema or
/// encoding, and one that is not advertised, is reported with the topics that are there. Stamps are the sender's; the offset of its
/// clock is reported. A lost tool is an empty with the reason. TLS (`wss://`) is not supported. docs/use/live.md has the rest.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.foxglove_ws"
address = "ws://127.0.0.1:8765"
out.scan        = { type = "geometry/Cloud", topic = "/camera/scan", frame = "camera" }
out.bone_marker = { type = "geometry/Pose", topic = "/tf", parent = "world", child = "bone_marker", to = "world", from = "bone_marker" }
"#)]
pub struct FoxgloveWs {
    params: Params,
    connection: Connection,
    clock: ClockOffset,
    ports: Option<Vec<Port>>,
    events: VecDeque<Event>,
    channels: BTreeMap<u64, Channel>,
    /// Topic, schema and encoding of each subscription.
    subscriptions: BTreeMap<u32, Channel>,
    next_subscription: u32,
    seen: Seen,
    /// Whether the connection has ended for good.
    is_over: bool,
}

/// Parameters of [`FoxgloveWs`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// Address of the server, with the path that it asks for. ws://127.0.0.1:8765: the port of foxglove_bridge.
    pub address: String,
    /// Frames of the server that have other names in the graph, such as `{ camera_depth_optical_frame = "camera" }`.
    pub frames: BTreeMap<String, String>,
    /// Time to wait for the server and for the first of the topics, after which the run fails. 10 s: a bridge takes that long to start.
    #[schemars(range(min = 0.1, max = 86_400.0))]
    pub timeout_s: f64,
    /// Whether to wait for the server again when the connection ends. false: the source ends with it.
    pub reconnect: bool,
    /// Time without an item after which the source is reported as silent. 5 s: longer than any camera's interval.
    #[schemars(range(min = 0.01, max = 86_400.0))]
    pub silent_after_s: f64,
    /// Maximum delay of one topic against another; an item beyond it is late and replaced by an empty. Joins wait this much
    /// longer. 0: sufficient where the server sends in the order of its stamps.
    #[schemars(range(min = 0.0, max = 60_000.0))]
    pub max_delay_ms: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            address: "ws://127.0.0.1:8765".into(),
            frames: BTreeMap::new(),
            timeout_s: 10.0,
            reconnect: true,
            silent_after_s: osteoflow_node::SILENT_AFTER.as_secs_f64(),
            max_delay_ms: 0.0,
        }
    }
}

struct Event {
    stamp_ns: StampNs,
    port: usize,
    emission: Emission,
}

/// What came so far.
#[derive(Default)]
struct Seen {
    newest_ns: StampNs,
    n_items: u64,
    n_warnings: BTreeMap<&'static str, usize>,
    /// Topics that were subscribed to at some time.
    topics: BTreeSet<String>,
    /// Ports whose tool is lost by silence.
    lost: BTreeSet<usize>,
    /// When the connection began.
    connected: Option<Instant>,
    n_connections: u64,
    looked_for_missing: bool,
}

impl Seen {
    /// Warns, at most [`N_WARNINGS`] times of each sort.
    fn warn(&mut self, sort: &'static str, message: String, ctx: &mut Context) {
        let n = self.n_warnings.entry(sort).or_default();
        *n += 1;
        match *n {
            n if n < N_WARNINGS => ctx.warn(message),
            N_WARNINGS => ctx.warn(format!("{message}; more of these are not reported")),
            _ => {}
        }
    }
}

impl Source for FoxgloveWs {
    const KIND: &'static str = "acquire.foxglove_ws";
    const LIVE: bool = true;
    type Params = Params;
    type Outputs = Declared<PortParams>;

    fn new(params: Params) -> Result<Self, ParamError> {
        let uri = connection::uri(&params.address).map_err(|message| ParamError::new("address", message))?;
        Ok(Self {
            connection: Connection::new(uri),
            params,
            clock: ClockOffset::default(),
            ports: None,
            events: VecDeque::new(),
            channels: BTreeMap::new(),
            subscriptions: BTreeMap::new(),
            next_subscription: 1,
            seen: Seen::default(),
            is_over: false,
        })
    }

    fn max_delay_ns(&self) -> StampNs {
        (self.params.max_delay_ms * 1e6).round() as StampNs
    }

    fn silent_after(&self) -> Duration {
        Duration::from_secs_f64(self.params.silent_after_s)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        if self.ports.is_none() {
            self.ports = Some(ctx.declared().iter().map(Port::new).collect::<Result<_, _>>()?);
            self.connection.begin();
        }
        loop {
            if let Some(Event { stamp_ns, port, emission }) = self.events.pop_front() {
                ctx.set_stamp_ns(stamp_ns);
                return Ok(Some(Declared::one(port, emission)));
            }
            if self.is_over || ctx.cancelled() {
                return Ok(None);
            }
            match self.connection.receive(ctx)? {
                Received::Text(text) => match FromServer::of_text(&text) {
                    Ok(message) => self.message(message, ctx)?,
                    Err(damage) => self.seen.warn("damage", damage, ctx),
                },
                Received::Binary(bytes) => match FromServer::of_binary(&bytes) {
                    Ok(message) => self.message(message, ctx)?,
                    Err(damage) => self.seen.warn("damage", damage, ctx),
                },
                Received::Connected => {
                    tracing::info!(address = self.params.address, "connected");
                    self.seen.n_connections += 1;
                    self.seen.connected = Some(Instant::now());
                    if self.seen.n_connections > 1 {
                        ctx.warn("connected again".to_owned());
                    }
                }
                Received::Refused(answer) if self.seen.n_connections == 0 => {
                    let address = without_path(&self.params.address);
                    return Err(NodeError::new(format!("{address} refuses the connection: {answer}")));
                }
                Received::Refused(answer) => {
                    self.seen.warn("refused", format!("the server refuses the connection: {answer}"), ctx);
                    ctx.wait_until(Instant::now() + Duration::from_millis(300));
                }
                Received::Ended(why) => {
                    self.end(&why, ctx);
                    // An answer without items passes the warning on now.
                    if self.events.is_empty() && !self.is_over {
                        return Ok(Some(Declared::one(0, Emission::Silent)));
                    }
                }
                Received::Nothing => {}
            }
            self.check_waiting(ctx)?;
        }
    }
}

impl FoxgloveWs {
    fn message(&mut self, message: FromServer, ctx: &mut Context) -> Result<(), NodeError> {
        match message {
            FromServer::Info(name) => tracing::info!(name, "a server of the Foxglove WebSocket protocol"),
            FromServer::Advertise(channels, n_unread) => {
                if n_unread > 0 {
                    let message = format!("{n_unread} advertised channels lack id, topic, encoding or schemaName");
                    self.seen.warn("damage", message, ctx);
                }
                self.advertised(channels, ctx)?;
            }
            FromServer::Unadvertise(ids) => {
                for id in ids {
                    self.channels.remove(&id);
                    let ended = self.subscriptions.extract_if(.., |_, channel| channel.id == id).map(|(_, c)| c.topic);
                    for topic in ended.collect::<Vec<_>>() {
                        let why = format!("{topic} is no longer advertised");
                        self.lose(|port| port.topics.contains(&topic), &why);
                        self.seen.warn("unadvertised", why, ctx);
                    }
                }
            }
            FromServer::Status(0, message) => tracing::info!(message, "status of the server"),
            FromServer::Status(level, message) => {
                let level = if level == 1 { "warns" } else { "reports an error" };
                self.seen.warn("status", format!("the server {level}: {message}"), ctx);
            }
            FromServer::Data { subscription, log_time_ns, data } => match self.subscriptions.get(&subscription) {
                Some(channel) => {
                    let channel = channel.clone();
                    let message = Encoded {
                        schema_name: &channel.schema_name,
                        message_encoding: &channel.encoding,
                        publish_time_ns: StampNs::try_from(log_time_ns).unwrap_or(0),
                        data,
                    };
                    self.data(&channel.topic, &message, ctx);
                }
                None => {
                    let message = format!("a message of subscription {subscription} came, which was not asked for");
                    self.seen.warn("unknown subscription", message, ctx);
                }
            },
            FromServer::Other => {}
        }
        Ok(())
    }

    /// Subscribes to the topics of ports.
    fn advertised(&mut self, channels: Vec<Channel>, ctx: &mut Context) -> Result<(), NodeError> {
        let mut wanted = Vec::new();
        for channel in channels {
            if self.channels.len() >= MAX_CHANNELS && !self.channels.contains_key(&channel.id) {
                let message =
                    format!("more than {MAX_CHANNELS} channels are advertised; {} is left out", channel.topic);
                self.seen.warn("channels", message, ctx);
                continue;
            }
            let readers = self.ports.iter().flatten().filter(|port| port.topics.contains(&channel.topic));
            let checks: Vec<_> = readers.map(|port| port.check(&channel)).collect();
            let is_known = self.channels.insert(channel.id, channel.clone()).is_some_and(|known| known == channel);
            if checks.is_empty() || (is_known && self.subscriptions.values().any(|s| s.id == channel.id)) {
                continue;
            }
            if let Some(fault) = checks.into_iter().find_map(Result::err) {
                if self.seen.n_items == 0 {
                    return Err(NodeError::new(format!("{fault}; {}", self.there())));
                }
                self.seen.warn("schema", fault, ctx);
                continue;
            }
            if self.subscriptions.values().any(|s| s.topic == channel.topic && s.id != channel.id) {
                let message = format!("{} is advertised twice; the first channel is read", channel.topic);
                self.seen.warn("twice", message, ctx);
                continue;
            }
            self.subscriptions.retain(|_, s| s.id != channel.id);
            self.seen.topics.insert(channel.topic.clone());
            wanted.push((self.next_subscription, channel.id));
            self.subscriptions.insert(self.next_subscription, channel);
            self.next_subscription = self.next_subscription.wrapping_add(1);
        }
        if !wanted.is_empty() {
            self.connection.send(protocol::subscribe(&wanted));
        }
        Ok(())
    }

    /// The items of a message on a topic.
    fn data(&mut self, topic: &str, message: &Encoded<'_>, ctx: &mut Context) {
        let ports = self.ports.as_deref_mut().unwrap_or_default();
        let mut events = Vec::new();
        for (index, port) in ports.iter_mut().enumerate().filter(|(_, port)| port.topics.iter().any(|t| t == topic)) {
            match port.give(topic, message.clone(), &self.params.frames) {
                Ok(given) => {
                    given.notes.into_iter().for_each(|note| self.seen.warn("content", note, ctx));
                    if !given.items.is_empty() {
                        self.seen.lost.remove(&index);
                    }
                    let event = |(stamp_ns, emission)| Event { stamp_ns, port: index, emission };
                    events.extend(given.items.into_iter().map(event));
                }
                Err(error) => {
                    let reason = format!("{topic}: {error}");
                    self.seen.warn("content", reason.clone(), ctx);
                    let stamp_ns = message.publish_time_ns.max(port.last_ns.unwrap_or(0));
                    events.push(Event { stamp_ns, port: index, emission: Emission::Empty(reason) });
                }
            }
        }
        // Constants have no time.
        let Some(newest_ns) = events.iter().map(|event| event.stamp_ns).filter(|ns| *ns > 0).max() else {
            self.events.extend(events);
            return;
        };
        if let Some(note) = self.clock.add(newest_ns, ctx.clock_ns()) {
            ctx.warn(format!("of the sender: {note}"));
        }
        let mut before = Vec::new();
        for (index, port) in ports.iter().enumerate() {
            if let Some(default) = port.default.filter(|_| self.seen.n_items == 0) {
                let stamp_ns = events.iter().map(|event| event.stamp_ns).min().unwrap_or(newest_ns);
                before.push(Event { stamp_ns, port: index, emission: Emission::value(Flag(default)) });
            }
            if let (Some(lost_after_ns), Some(last_ns)) = (port.lost_after_ns, port.last_ns) {
                let lost_ns = last_ns.saturating_add(lost_after_ns);
                if lost_ns < newest_ns && self.seen.lost.insert(index) {
                    let seconds = lost_after_ns as f64 * 1e-9;
                    let reason = format!("{} was not sent for {seconds:.2} s", port.topics.join(", "));
                    before.push(Event { stamp_ns: lost_ns, port: index, emission: Emission::Empty(reason) });
                }
            }
        }
        self.seen.n_items += events.len() as u64;
        self.seen.newest_ns = self.seen.newest_ns.max(newest_ns);
        self.events.extend(before);
        self.events.extend(events);
    }

    /// The connection has ended.
    fn end(&mut self, why: &str, ctx: &mut Context) {
        self.channels.clear();
        self.subscriptions.clear();
        if !self.params.reconnect {
            ctx.warn(why.to_owned());
            self.check_missing(ctx);
            self.is_over = true;
            return;
        }
        ctx.warn(format!("{why}; waiting for the server again"));
        self.lose(|_| true, why);
    }

    /// Where a tool is while nobody says is unknown.
    fn lose(&mut self, is_lost: impl Fn(&Port) -> bool, why: &str) {
        for (index, port) in self.ports.iter().flatten().enumerate() {
            if port.payload == "geometry/Pose" && port.last_ns.is_some_and(|ns| ns > 0) && is_lost(port) {
                let emission = Emission::Empty(format!("{}: {why}", port.topics.join(", ")));
                self.events.push_back(Event { stamp_ns: self.seen.newest_ns, port: index, emission });
            }
        }
    }

    fn check_waiting(&mut self, ctx: &mut Context) -> Result<(), NodeError> {
        let Params { address, timeout_s, silent_after_s, .. } = &self.params;
        let waited = self.connection.waited().as_secs_f64();
        if self.seen.n_connections == 0 {
            if waited > *timeout_s {
                let (address, why) = (without_path(address), self.connection.why());
                return Err(NodeError::new(format!("no connection to {address} within {timeout_s} s: {why}")));
            }
            return Ok(());
        }
        let since = self.seen.connected.map_or(0.0, |at| at.elapsed().as_secs_f64());
        if self.seen.topics.is_empty() && since > *timeout_s {
            let topics: Vec<&str> =
                self.ports.iter().flatten().flat_map(|p| p.topics.iter().map(String::as_str)).collect();
            let (wanted, there) = (topics.join(", "), self.there());
            return Err(NodeError::new(format!("none of {wanted} was advertised within {timeout_s} s; {there}")));
        }
        if since > *silent_after_s {
            self.check_missing(ctx);
        }
        Ok(())
    }

    /// Reports, once, the topics that were not advertised.
    fn check_missing(&mut self, ctx: &mut Context) {
        if std::mem::replace(&mut self.seen.looked_for_missing, true) {
            return;
        }
        let there = self.there();
        for port in self.ports.iter().flatten() {
            let missing: Vec<&str> =
                port.topics.iter().filter(|t| !self.seen.topics.contains(*t)).map(String::as_str).collect();
            if !missing.is_empty() {
                ctx.warn(format!("port \"{}\": {} was not advertised; {there}", port.name, missing.join(", ")));
            }
        }
    }

    /// The topics that the server has.
    fn there(&self) -> String {
        let mut topics: Vec<String> =
            self.channels.values().map(|c| protocol::shortened(&format!("{} ({})", c.topic, c.schema_name))).collect();
        topics.sort();
        match topics.len() {
            0 => "the server advertises no topic".into(),
            n if n > N_NAMED => format!("the server has {} and {} more", topics[..N_NAMED].join(", "), n - N_NAMED),
            _ => format!("the server has {}", topics.join(", ")),
        }
    }
}

/// The address without what may be a token.
fn without_path(address: &str) -> String {
    let after = address.find("://").map_or(0, |at| at + 3);
    address[after..].find('/').map_or(address, |at| &address[..after + at]).to_owned()
}

#[cfg(test)]
mod tests;
