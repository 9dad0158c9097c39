//! The kind `acquire.openigtlink`.

mod ports;

pub use ports::{PatientSpace, PortParams};

use super::network::{Inbox, Incoming, NetworkParams, OpenError, Peer, Port, Protocol, Role, is_waiting};
use osteoflow_formats::openigtlink::{Body, Decoder, Message, Status};
use osteoflow_node::{
    Context, DeclaredPort, Describe, NodeError, ParamError, schemars::JsonSchema, serde::Deserialize, tracing,
};
use ports::Content;
use std::{
    collections::{BTreeMap, BTreeSet},
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
    stream: TcpStream,
    buffer: Vec<u8>,
    decoder: Decoder,
    /// Since when the last message has not been complete.
    waits_since: Option<Instant>,
    /// Why the connection has ended, and whether in order.
    end: Option<(String, bool)>,
    /// Devices that no port reads; with their type where a port names them.
    unread: BTreeSet<String>,
    /// Devices that send no stamps.
    without_stamp: BTreeSet<String>,
}

/// Parameters of [`OpenIgtLink`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Host and port of the sender, or where to listen for it. 127.0.0.1:18944: the port of the protocol.
    pub address: String,
    /// `client` connects to the sender; `server` listens for one sender at a time. client: PLUS is a server.
    pub role: Role,
    /// The least time between two TDATA, which the source then asks for (STT_TDATA): PLUS sends them on request only. Unset: not
    /// asked for.
    #[schemars(range(min = 0, max = 60_000))]
    pub tdata_ms: Option<u32>,
    /// What every source over a network has.
    #[serde(flatten)]
    pub network: NetworkParams,
}

impl Default for Params {
    fn default() -> Self {
        let network = NetworkParams::default();
        Self { address: "127.0.0.1:18944".into(), role: Role::Client, tdata_ms: None, network }
    }
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

    fn ports(declared: &[DeclaredPort]) -> Result<Vec<Port<Content>>, NodeError> {
        let ports = declared.iter().map(Content::port).collect::<Result<Vec<_>, _>>()?;
        let mut known = BTreeMap::new();
        for Port { name, payload, streams, .. } in &ports {
            for device in streams {
                if let Some(other) = known.insert((device, payload), name) {
                    let message = format!("ports \"{other}\" and \"{name}\" both read {payload} of {device}");
                    return Err(NodeError::new(format!("{message}; wire one port to both places")));
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
            decoder: Decoder::default(),
            waits_since: None,
            end: None,
            unread: BTreeSet::new(),
            without_stamp: BTreeSet::new(),
        })
    }

    fn receive(&mut self, inbox: &mut Inbox<Content>, ctx: &mut Context) -> Result<Incoming, NodeError> {
        match self.decoder.next() {
            Some(Ok(message)) => {
                self.waits_since = None;
                self.message(&message, inbox, ctx);
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

    fn others(&self) -> String {
        let unread: Vec<&str> = self.unread.iter().map(String::as_str).collect();
        if unread.is_empty() { "nothing else came".into() } else { format!("unread are {}", unread.join(", ")) }
    }
}

impl OpenIgtLink {
    fn message(&mut self, message: &Message, inbox: &mut Inbox<Content>, ctx: &mut Context) {
        let Message { device, body, .. } = message;
        let sent_ns = Some(message.stamp_ns).filter(|ns| *ns > 0);
        if sent_ns.is_none() && self.without_stamp.len() < N_UNREAD && self.without_stamp.insert(device.clone()) {
            let note = format!("{device} has no stamp; the time of its arrival is used");
            inbox.warn("no stamp", note, ctx);
        }
        let stamp_ns = inbox.stamp(sent_ns, ctx);
        let tools: Vec<_> = match body {
            Body::Tracking(tools) => tools.iter().map(|tool| (&tool.name, Some(&tool.matrix))).collect(),
            _ => vec![(device, None)],
        };
        for (device, matrix) in tools {
            let taken = inbox.offer(device, ctx, |port| port.read(message, device, matrix, stamp_ns));
            if taken.is_some() || matches!(body, Body::Status(_)) || self.unread.len() >= N_UNREAD {
                continue;
            }
            let is_named = inbox.ports.iter().any(|port| port.reads(device));
            let kind = body.type_name();
            if self.unread.insert(if is_named { format!("{device} as {kind}") } else { device.clone() }) {
                tracing::info!(device, kind, "no port reads this device");
            }
        }
    }
}

#[cfg(test)]
mod tests;
