//! The kind `acquire.openigtlink`.

mod connection;
mod ports;

pub use ports::{PatientSpace, PortParams};

use connection::{Connection, Received};
use osteoflow_formats::openigtlink::{Body, ClockOffset, Decoder, Message};
use osteoflow_geometry::StampNs;
use osteoflow_node::{
    Context, Declared, Describe, Emission, NodeError, ParamError, Source, schemars::JsonSchema, serde::Deserialize,
    tracing,
};
use ports::{Given, Port};
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::{Duration, Instant},
};

/// Time after which the rest of a message is given up. Longer than a cloud takes over a slow network.
const STALLED: Duration = Duration::from_secs(5);
/// Warnings of each sort; more are counted.
const N_WARNINGS: usize = 10;

/// Trackers, scans and points over OpenIGTLink, from a PLUS server, 3D Slicer or anything that speaks it.
///
/// Each entry of `out` is a port with a `type`, its frames and a device; PLUS calls the pose of `stylus` in `reference`
/// `StylusToReference`. TRANSFORM, TDATA, POSITION, POINT, POLYDATA, STATUS and STRING of header versions 1 and 2 are read, with
/// their CRC checked; damaged messages are reported and left out. Lengths are millimetres in single precision, transforms are
/// taken as they are, and coordinates in `ct` are turned to LPS. Stamps are the sender's; the offset of its clock is reported
/// once, and again when it jumps. A lost tool is an empty with the reason. docs/use/openigtlink.md has the rest.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.openigtlink"
address = "127.0.0.1:18944"
out.scan   = { type = "geometry/Cloud", device = "Scan", frame = "camera" }
out.stylus = { type = "geometry/Pose", device = "StylusToReference", to = "world", from = "stylus_marker" }
"#)]
pub struct OpenIgtLink {
    params: Params,
    connection: Connection,
    decoder: Decoder,
    clock: ClockOffset,
    ports: Option<Vec<Port>>,
    events: VecDeque<Event>,
    seen: Seen,
    /// Since when the last message has not been complete.
    waits_since: Option<Instant>,
    /// Whether the connection has ended for good.
    is_over: bool,
}

/// Parameters of [`OpenIgtLink`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// Host and port of the sender, or where to listen for it. 127.0.0.1:18944: the port of the protocol.
    pub address: String,
    /// `client` connects to the sender; `server` listens for one sender at a time. client: PLUS is a server.
    pub role: Role,
    /// Time to wait for the first connection, after which the run fails. 10 s: a server takes that long to start.
    #[schemars(range(min = 0.1, max = 86_400.0))]
    pub timeout_s: f64,
    /// Whether to wait for the sender again when the connection ends. false: the source ends with it.
    pub reconnect: bool,
    /// Time without an item after which the source is reported as silent. 5 s: longer than any camera's interval.
    #[schemars(range(min = 0.01, max = 86_400.0))]
    pub silent_after_s: f64,
    /// The least time between two TDATA, which the source then asks for (STT_TDATA): PLUS sends them on request only. Unset: not
    /// asked for.
    #[schemars(range(min = 0, max = 60_000))]
    pub tdata_ms: Option<u32>,
    /// Maximum delay of one device against another; an item beyond it is late and replaced by an empty. Joins wait this much
    /// longer. 0: sufficient where the sender sends in the order of its stamps.
    #[schemars(range(min = 0.0, max = 60_000.0))]
    pub max_delay_ms: f64,
}

/// Who connects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub enum Role {
    /// This side.
    Client,
    /// The other side.
    Server,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            address: "127.0.0.1:18944".into(),
            role: Role::Client,
            timeout_s: 10.0,
            reconnect: true,
            silent_after_s: osteoflow_node::SILENT_AFTER.as_secs_f64(),
            tdata_ms: None,
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
    /// The newest stamp of each device.
    devices: BTreeMap<String, StampNs>,
    /// The newest stamp.
    newest_ns: StampNs,
    n_messages: u64,
    /// Warnings by sort.
    n_warnings: BTreeMap<String, usize>,
    unread: BTreeSet<(String, String)>,
    /// Ports whose tool is lost by silence.
    lost: BTreeSet<usize>,
    /// Flags that were given.
    flags: BTreeSet<usize>,
    first: Option<Instant>,
    looked_for_missing: bool,
}

impl Seen {
    /// Warns, at most [`N_WARNINGS`] times of each sort.
    fn warn(&mut self, sort: &str, message: String, ctx: &mut Context) {
        let n = self.n_warnings.entry(sort.into()).or_default();
        *n += 1;
        match *n {
            n if n < N_WARNINGS => ctx.warn(message),
            N_WARNINGS => ctx.warn(format!("{message}; more of these are not reported")),
            _ => {}
        }
    }
}

impl Source for OpenIgtLink {
    const KIND: &'static str = "acquire.openigtlink";
    const LIVE: bool = true;
    type Params = Params;
    type Outputs = Declared<PortParams>;

    fn new(params: Params) -> Result<Self, ParamError> {
        if params.address.rsplit_once(':').is_none_or(|(_, port)| port.parse::<u16>().is_err()) {
            let message = format!("\"{}\" is not HOST:PORT, such as 127.0.0.1:18944", params.address);
            return Err(ParamError::new("address", message));
        }
        Ok(Self {
            connection: Connection::new(params.role, params.address.clone(), params.tdata_ms),
            params,
            decoder: Decoder::default(),
            clock: ClockOffset::default(),
            ports: None,
            events: VecDeque::new(),
            seen: Seen::default(),
            waits_since: None,
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
            self.ports = Some(read_ports(ctx)?);
            let Params { role, address, tdata_ms, .. } = &self.params;
            self.connection = Connection::new(*role, address.clone(), *tdata_ms);
        }
        loop {
            if let Some(Event { stamp_ns, port, emission }) = self.events.pop_front() {
                ctx.set_stamp_ns(stamp_ns);
                return Ok(Some(Declared::one(port, emission)));
            }
            if self.is_over || ctx.cancelled() {
                return Ok(None);
            }
            let received = match self.connection.receive(ctx)? {
                Received::Bytes(bytes) => {
                    self.decoder.push(bytes);
                    Ok(true)
                }
                Received::Nothing => Ok(false),
                Received::Connected(peer) => {
                    tracing::info!(%peer, "connected");
                    if self.seen.n_messages > 0 {
                        ctx.warn(format!("connected again, with {peer}"));
                    }
                    Ok(false)
                }
                Received::Ended(why) => Err(why),
            };
            for peer in std::mem::take(&mut self.connection.turned_away) {
                let message = format!("{peer} connected while another sender was, and was turned away");
                self.seen.warn("turned away", message, ctx);
            }
            match received {
                Ok(has_bytes) => self.take(has_bytes, ctx),
                Err(why) => {
                    self.take(false, ctx);
                    self.end(&why, ctx);
                    // An answer without items passes the warning on now.
                    if self.events.is_empty() && !self.is_over {
                        return Ok(Some(Declared::one(0, Emission::Silent)));
                    }
                }
            }
            self.check_waiting(ctx)?;
        }
    }
}

fn read_ports(ctx: &Context) -> Result<Vec<Port>, NodeError> {
    let ports = ctx.declared().iter().map(Port::new).collect::<Result<Vec<_>, _>>()?;
    let mut known = BTreeMap::new();
    for port in &ports {
        for device in &port.devices {
            if let Some(other) = known.insert((device, port.payload), &port.name) {
                let name = &port.name;
                let message = format!("ports \"{other}\" and \"{name}\" both read {} of {device}", port.payload);
                return Err(NodeError::new(format!("{message}; wire one port to both places")));
            }
        }
    }
    Ok(ports)
}

impl OpenIgtLink {
    /// Takes the messages that are complete.
    fn take(&mut self, has_bytes: bool, ctx: &mut Context) {
        if has_bytes {
            let arrived_ns = ctx.clock_ns();
            while let Some(read) = self.decoder.next() {
                self.waits_since = None;
                match read {
                    Ok(message) => self.message(&message, arrived_ns, ctx),
                    Err(damage) => self.seen.warn("damage", damage.to_string(), ctx),
                }
            }
        }
        match self.waits_since {
            _ if !self.decoder.is_waiting() => self.waits_since = None,
            None => self.waits_since = Some(Instant::now()),
            Some(since) if since.elapsed() > STALLED => {
                self.waits_since = None;
                if let Some(damage) = self.decoder.give_up() {
                    self.seen.warn("damage", damage.to_string(), ctx);
                }
            }
            Some(_) => {}
        }
    }

    fn message(&mut self, message: &Message, arrived_ns: StampNs, ctx: &mut Context) {
        let seen = &mut self.seen;
        seen.n_messages += 1;
        seen.first.get_or_insert_with(Instant::now);
        let stamp_ns = if message.stamp_ns > 0 {
            if let Some(note) = self.clock.add(message.stamp_ns, arrived_ns) {
                ctx.warn(format!("of the sender: {note}"));
            }
            message.stamp_ns
        } else {
            let reason = format!("{} has no stamp; the time of its arrival is used", message.device);
            if !seen.devices.contains_key(&message.device) {
                seen.warn("no stamp", reason, ctx);
            }
            arrived_ns
        };
        let names: Vec<(&str, Option<usize>)> = match &message.body {
            Body::Tracking(tools) => tools.iter().enumerate().map(|(k, tool)| (tool.name.as_str(), Some(k))).collect(),
            _ => vec![(message.device.as_str(), None)],
        };
        let ports = self.ports.as_deref_mut().unwrap_or_default();
        let begin = self.events.len();
        for (device, tool) in names {
            let mut is_read = false;
            for (index, port) in ports.iter_mut().enumerate() {
                if !port.devices.iter().any(|known| known == device) {
                    continue;
                }
                let Some(Given { emission, note }) = port.give(message, device, tool, stamp_ns) else { continue };
                is_read = true;
                if let Some(note) = note {
                    seen.warn(device, note, ctx);
                }
                seen.lost.remove(&index);
                seen.flags.insert(index);
                self.events.push_back(Event { stamp_ns, port: index, emission });
            }
            seen.devices.insert(device.into(), stamp_ns);
            let kind = (device.to_owned(), message.body.type_name().to_owned());
            let is_new = !is_read && seen.unread.len() < 100 && seen.unread.insert(kind);
            if is_new && !matches!(message.body, Body::Status(_)) {
                tracing::info!(device, kind = message.body.type_name(), "no port reads this device");
            }
        }
        // Before the items of this message: tools that are lost by now, and flags that did not come.
        let mut before = Vec::new();
        let has_item = self.events.range(begin..).any(|event| ports[event.port].payload != "report/Flag");
        for (index, port) in ports.iter().enumerate() {
            if let Some(default) = port.default.filter(|_| has_item && seen.flags.insert(index)) {
                before.push(Event {
                    stamp_ns,
                    port: index,
                    emission: Emission::value(osteoflow_payloads::Flag(default)),
                });
            }
            let last_ns = port.devices.iter().filter_map(|device| seen.devices.get(device)).max();
            if let (Some(lost_after_ns), Some(last_ns)) = (port.lost_after_ns, last_ns) {
                let lost_ns = last_ns.saturating_add(lost_after_ns);
                if lost_ns < stamp_ns && seen.lost.insert(index) {
                    let reason =
                        format!("{} was not sent for {:.2} s", port.devices.join(", "), lost_after_ns as f64 * 1e-9);
                    before.push(Event { stamp_ns: lost_ns, port: index, emission: Emission::Empty(reason) });
                }
            }
        }
        before.sort_by_key(|event| event.stamp_ns);
        for (k, event) in before.into_iter().enumerate() {
            self.events.insert(begin + k, event);
        }
        seen.newest_ns = seen.newest_ns.max(stamp_ns);
    }

    /// The connection has ended.
    fn end(&mut self, why: &str, ctx: &mut Context) {
        if let Some(damage) = self.decoder.give_up() {
            self.seen.warn("damage", damage.to_string(), ctx);
            while let Some(Ok(message)) = self.decoder.next() {
                let arrived_ns = ctx.clock_ns();
                self.message(&message, arrived_ns, ctx);
            }
        }
        self.decoder = Decoder::default();
        self.waits_since = None;
        if !self.params.reconnect {
            self.check_missing(ctx);
            self.is_over = true;
            return;
        }
        ctx.warn(format!("{why}; waiting for the sender again"));
        // Where a tool is while nobody says is unknown.
        for (index, port) in self.ports.iter().flatten().enumerate() {
            let was_seen = port.devices.iter().any(|device| self.seen.devices.contains_key(device));
            if port.payload == "geometry/Pose" && was_seen {
                let emission = Emission::Empty(format!("{}: {why}", port.devices.join(", ")));
                self.events.push_back(Event { stamp_ns: self.seen.newest_ns, port: index, emission });
            }
        }
    }

    fn check_waiting(&mut self, ctx: &mut Context) -> Result<(), NodeError> {
        let waited = self.connection.waited().as_secs_f64();
        if self.seen.n_messages == 0 && waited > self.params.timeout_s {
            let Params { address, role, timeout_s, .. } = &self.params;
            return Err(NodeError::new(match role {
                Role::Client => {
                    format!("no connection to {address} within {timeout_s} s; is the server running there?")
                }
                Role::Server => format!("no sender connected to {address} within {timeout_s} s"),
            }));
        }
        let is_due = self.seen.first.is_some_and(|first| first.elapsed().as_secs_f64() > self.params.silent_after_s);
        if is_due {
            self.check_missing(ctx);
        }
        Ok(())
    }

    /// Reports, once, the devices that did not come.
    fn check_missing(&mut self, ctx: &mut Context) {
        if std::mem::replace(&mut self.seen.looked_for_missing, true) {
            return;
        }
        let unread: Vec<&str> = self.seen.unread.iter().map(|(device, _)| device.as_str()).collect();
        for port in self.ports.iter().flatten() {
            let missing: Vec<_> =
                port.devices.iter().filter(|d| !self.seen.devices.contains_key(*d)).cloned().collect();
            if missing.is_empty() || port.default.is_some() {
                continue;
            }
            let others = if unread.is_empty() {
                "nothing else came".into()
            } else {
                format!("unread are {}", unread.join(", "))
            };
            ctx.warn(format!("port \"{}\": {} has not come; {others}", port.name, missing.join(", ")));
        }
    }
}

#[cfg(test)]
mod tests;
