//! The kind `acquire.openigtlink`.

mod images;
mod ports;

pub use ports::{PatientSpace, PortParams};

use super::network::{Inbox, Incoming, NetworkParams, OpenError, Peer, Port, Protocol, Role, is_waiting};
use osteoflow_formats::openigtlink::{Body, Decoder, Message, Status};
use osteoflow_geometry::StampNs;
use osteoflow_node::{
    Context, DeclaredPort, Describe, NodeError, ParamError, params, schemars::JsonSchema, serde::Deserialize, tracing,
};
use ports::Content;
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    io::{Read, Write},
    net::TcpStream,
    time::{Duration, Instant},
};

/// Time after which the rest of a message is given up. Longer than a cloud takes over a slow network.
const STALLED: Duration = Duration::from_secs(5);
/// Bytes that are read at a time.
const PIECE: usize = 64 << 10;
/// Form of an address.
const ADDRESS: &str = "HOST:PORT, such as 127.0.0.1:18944";
/// Devices without a port that are remembered.
const N_UNREAD: usize = 100;
/// Longest time for which messages wait until the offset of the sender's clock is known.
const SETTLE: Duration = Duration::from_secs(1);

/// Trackers, scans and points over OpenIGTLink, from a PLUS server, 3D Slicer or anything that speaks it.
///
/// Each entry of `out` is a port with a `type`, its frames and a device; PLUS calls the pose of `stylus` in `reference`
/// `StylusToReference`. docs/use/openigtlink.md lists the messages. A damaged message is left out and reported. Coordinates in
/// `ct` are turned to LPS. Stamps are the sender's; the offset of its clock is reported once, and again when it jumps. A lost
/// tool is an empty that says why.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.openigtlink"
address = "127.0.0.1:18944"
out.scan   = { type = "geometry/Cloud", device = "Scan", frame = "camera" }
out.stylus = { type = "geometry/Pose", device = "StylusToReference", to = "world", from = "stylus_marker" }
"#)]
pub struct OpenIgtLink {
    stream: TcpStream,
    buffer: Vec<u8>,
    decoder: Decoder,
    /// Since when the last message has not been complete.
    waits_since: Option<Instant>,
    /// Why the connection has ended, and whether in order.
    end: Option<(String, bool)>,
    /// Devices that no port reads, with the type of their messages.
    unread: BTreeMap<String, String>,
    /// Devices that ports name, with the type of the messages that none of these ports reads.
    instead: BTreeMap<String, String>,
    /// Devices that send no stamps.
    without_stamp: BTreeSet<String>,
    clock: Clock,
    /// Messages that wait for the offset of the sender's clock, with their times of arrival.
    held: VecDeque<(Message, StampNs)>,
    /// When the first of them came.
    held_since: Option<Instant>,
}

/// The clock of the stamps that a source gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Clock {
    /// That of the sender, as it wrote them.
    Sender,
    /// That of this machine: the sender's stamps and the offset of its clock.
    Receiver,
}

/// Parameters of [`OpenIgtLink`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Host and port of the sender, or where to listen for it. 127.0.0.1:18944: the protocol's port.
    #[param("127.0.0.1:18944")]
    pub address: String,
    /// `client` connects to the sender; `server` listens for one sender at a time. `client`: PLUS is a server.
    #[param(Role::Client)]
    pub role: Role,
    /// Least time between two TDATA, for which the source then asks (STT_TDATA): PLUS sends them on request only. Unset: not
    /// asked for.
    #[schemars(range(min = 0, max = 60_000))]
    pub tdata_ms: Option<u32>,
    /// The clock of the stamps. `sender`: as they are sent. `receiver`: corrected by the offset of the sender's clock, for
    /// joins with another source; the first messages wait for at most 1 s until 20 of them give the offset, and a jump of the
    /// clock corrects it again. `sender`: stamps of one sender agree, while the offset contains the shortest delay of a
    /// message.
    #[param(Clock::Sender)]
    pub clock: Clock,
    /// Whether each body must have the CRC of its header. true: a damaged number is left out; false: for a sender that writes
    /// none.
    #[param(true)]
    pub crc: bool,
    /// What every source over a network has.
    #[serde(flatten)]
    pub network: NetworkParams,
}

/// Whether an address has a host and a port.
pub(crate) fn is_host_port(address: &str) -> bool {
    address.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok())
}

impl Protocol for OpenIgtLink {
    const KIND: &'static str = "acquire.openigtlink";
    const PEER: &'static str = "sender";
    const MISSING: &'static str = "has not come";
    type Params = Params;
    type PortParams = PortParams;
    type Port = Content;

    fn network(params: &Params) -> &NetworkParams {
        &params.network
    }

    fn peer(params: &Params) -> Result<Peer, ParamError> {
        let Params { address, role, .. } = params;
        if !is_host_port(address) {
            return Err(ParamError::new("address", format!("\"{address}\" is not {ADDRESS}")));
        }
        Ok(Peer { role: *role, host_port: address.clone(), shown: address.clone(), form: ADDRESS })
    }

    fn ports(declared: &[DeclaredPort]) -> Result<Vec<Port<Content>>, ParamError> {
        let ports = declared.iter().map(Content::port).collect::<Result<Vec<_>, _>>()?;
        let mut known = BTreeMap::new();
        for (Port { name, payload, streams, .. }, declared) in ports.iter().zip(declared) {
            for device in streams {
                if let Some(other) = known.insert((device, payload), name) {
                    let message = format!("ports \"{other}\" and \"{name}\" both read {payload} of {device}");
                    return Err(declared.refused("device", format!("{message}; wire one port to both places")));
                }
            }
        }
        Ok(ports)
    }

    fn open(mut stream: TcpStream, params: &Params, _ctx: &Context) -> Result<Self, OpenError> {
        // PLUS answers in the header version of its client, and states lost tools in the metadata of version 2 only.
        let hello = Body::Status(Status::new(Status::OK, "OK", ""));
        let query = params.tdata_ms.map(|interval_ms| Body::StartTracking { interval_ms, coordinates: String::new() });
        for body in [Some(hello), query].into_iter().flatten() {
            if let Ok(bytes) = Message::new("Osteoflow", 0, body).extended(0, Vec::new()).to_bytes() {
                // A sender that takes nothing is no fault.
                let _ = stream.write_all(&bytes);
            }
        }
        Ok(Self {
            stream,
            buffer: vec![0; PIECE],
            decoder: if params.crc { Decoder::default() } else { Decoder::without_crc() },
            waits_since: None,
            end: None,
            unread: BTreeMap::new(),
            instead: BTreeMap::new(),
            without_stamp: BTreeSet::new(),
            clock: params.clock,
            held: VecDeque::new(),
            held_since: None,
        })
    }

    fn receive(&mut self, inbox: &mut Inbox<Content>, ctx: &mut Context) -> Result<Incoming, NodeError> {
        if let Some((message, arrived_ns)) = self.held(inbox, ctx) {
            let now_ns = inbox.arrived_ns();
            inbox.arrived_at(arrived_ns);
            self.message(&message, inbox, ctx);
            inbox.arrived_at(now_ns);
            return Ok(Incoming::Message);
        }
        match self.decoder.next() {
            Some(Ok(message)) => {
                self.waits_since = None;
                inbox.observe(sent_ns(&message), ctx);
                if self.clock == Clock::Receiver && !inbox.is_corrected() {
                    self.held_since.get_or_insert_with(Instant::now);
                    self.held.push_back((message, inbox.arrived_ns()));
                } else {
                    self.message(&message, inbox, ctx);
                }
                return Ok(Incoming::Message);
            }
            Some(Err(damage)) => {
                self.waits_since = None;
                return Ok(Incoming::Damage(damage.to_string()));
            }
            None if !self.decoder.is_waiting() => self.waits_since = None,
            None => {
                let since = *self.waits_since.get_or_insert_with(Instant::now);
                if self.end.is_some() || since.elapsed() > STALLED {
                    self.waits_since = None;
                    if let Some(damage) = self.decoder.give_up() {
                        return Ok(Incoming::Damage(damage.to_string()));
                    }
                }
            }
        }
        if let Some((reason, is_orderly)) = self.end.clone() {
            return Ok(Incoming::End { reason, is_orderly });
        }
        match self.stream.read(&mut self.buffer) {
            Ok(0) => self.end = Some(("the sender closed the connection".into(), true)),
            Ok(n) => {
                inbox.arrive(ctx);
                self.decoder.push(&self.buffer[..n]);
            }
            Err(error) if is_waiting(&error) => {}
            Err(error) => self.end = Some((format!("the connection broke: {error}"), false)),
        }
        Ok(Incoming::Nothing)
    }

    fn instead(&self, port: &Port<Content>) -> Option<String> {
        if port.n_messages > 0 {
            return None;
        }
        let (device, kind) = port.streams.iter().find_map(|device| Some((device, self.instead.get(device)?)))?;
        let (name, payload) = (&port.name, port.payload);
        let remedy = match ports::payloads_of(kind) {
            [] => "no port reads that type; let its sender send another".into(),
            payloads => format!("a port of {} reads it", payloads.join(" or ")),
        };
        Some(format!("port \"{name}\": {device} sends {kind}, which gives no {payload}; {remedy}"))
    }

    fn unread(&self) -> Vec<String> {
        self.unread.iter().map(|(device, kind)| format!("{device} ({kind})")).collect()
    }

    fn others(&self) -> String {
        let named = self.instead.iter().map(|(device, kind)| format!("{device} as {kind}"));
        let unread: Vec<String> = self.unread.keys().cloned().chain(named).collect();
        if unread.is_empty() { "nothing else came".into() } else { format!("unread are {}", unread.join(", ")) }
    }
}

/// The sender's stamp, if it gives one.
fn sent_ns(message: &Message) -> Option<StampNs> {
    Some(message.stamp_ns).filter(|ns| *ns > 0)
}

impl OpenIgtLink {
    /// The next message that has waited long enough for the offset of the sender's clock.
    fn held(&mut self, inbox: &mut Inbox<Content>, ctx: &mut Context) -> Option<(Message, StampNs)> {
        let has_waited = self.held_since.is_some_and(|since| since.elapsed() > SETTLE) || self.end.is_some();
        if self.held.is_empty() || !(inbox.knows_clock() || has_waited) {
            return None;
        }
        if !inbox.is_corrected() {
            inbox.settle(ctx);
        }
        self.held.pop_front()
    }

    fn message(&mut self, message: &Message, inbox: &mut Inbox<Content>, ctx: &mut Context) {
        let Message { device, body, .. } = message;
        let sent_ns = sent_ns(message);
        if sent_ns.is_none() && self.without_stamp.len() < N_UNREAD && self.without_stamp.insert(device.clone()) {
            let note = format!("{device} has no stamp; the time of its arrival is used");
            inbox.warn("no stamp", note, ctx);
        }
        let stamp_ns = inbox.corrected(sent_ns);
        let tools: Vec<_> = match body {
            Body::Tracking(tools) => tools.iter().map(|tool| (&tool.name, Some(&tool.matrix))).collect(),
            _ => vec![(device, None)],
        };
        for (device, matrix) in tools {
            let taken = inbox.offer(device, ctx, |port| port.read(message, device, matrix, stamp_ns));
            if taken.is_some() || matches!(body, Body::Status(_)) {
                continue;
            }
            let is_named = inbox.ports.iter().any(|port| port.reads(device));
            let kind = body.type_name();
            let map = if is_named { &mut self.instead } else { &mut self.unread };
            if map.len() < N_UNREAD && map.insert(device.clone(), kind.into()).is_none() {
                tracing::info!(device, kind, "no port reads this device");
            }
        }
    }
}

#[cfg(test)]
mod tests;
