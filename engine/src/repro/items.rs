//! `inputs.mcap`: the items that the ports of a firing had joined.

use crate::recording::{
    RecordingError, codec,
    format::{EXACT_ENCODING, MetadataRecord, REPRO_PROFILE, ReproRecord, Topic, WireHeader},
    known, too_large,
    wires::{Carries, Channels, Wire},
};
use osteoflow_container::{
    Allowance, Compression, Damage, Location, Message, MessageHeader, Reader, Record, Visitor, WriteOptions, Writer,
    damage_message,
};
use osteoflow_node::{Body, DisplayContext, FrameEdge, Item, PayloadType, PortPayload, Registry, StampNs};
use std::{collections::BTreeMap, fs::File, io, ops::ControlFlow, path::Path};

/// Writes the items of a firing, one at a time, so that they are not copied all at once.
pub(super) struct Items {
    writer: Writer<File>,
}

/// The channels of one port.
pub(super) struct Port {
    payload: PortPayload,
    exact: u16,
    view: Option<u16>,
}

impl Items {
    pub(super) fn create(path: &Path, node: &str, item: u64) -> io::Result<Self> {
        let options = WriteOptions {
            profile: REPRO_PROFILE.into(),
            library: concat!("osteoflow ", env!("CARGO_PKG_VERSION")).into(),
            // Compression would cost time and gain little.
            compression: Compression::None,
            ..WriteOptions::default()
        };
        let mut writer = Writer::new(File::create(path)?, options)?;
        let firing = ReproRecord { node: node.into(), item };
        writer.write_metadata(ReproRecord::NAME, &firing.to_metadata())?;
        Ok(Self { writer })
    }

    /// Adds the channels of a port; `ty` is the type of its items.
    pub(super) fn port(&mut self, name: &str, payload: PortPayload, ty: Option<&PayloadType>) -> io::Result<Port> {
        let version = match payload {
            PortPayload::Type(ty) => ty.version,
            PortPayload::Any => 0,
        };
        let header = WireHeader { payload: payload.name().into(), version, ..WireHeader::default() };
        let schema = self.writer.add_schema(&header.schema_name(), EXACT_ENCODING, codec::LAYOUT.as_bytes())?;
        let exact =
            self.writer.add_channel(schema, &Topic::Exact(name).name(), EXACT_ENCODING, &header.to_metadata())?;
        let view = match ty.and_then(PayloadType::display) {
            Some(d) => {
                let schema = self.writer.add_schema(&d.schema_name, &d.schema_encoding, &d.schema_data)?;
                let topic = Topic::View(name).name();
                Some(self.writer.add_channel(schema, &topic, &d.message_encoding, &BTreeMap::new())?)
            }
            None => None,
        };
        Ok(Port { payload, exact, view })
    }

    /// Writes an item of the port, and its picture for viewers; returns its size in bytes.
    pub(super) fn item(&mut self, port: &Port, item: &Item, log_time_ns: StampNs) -> io::Result<u64> {
        // Viewers take no time before the first nanosecond.
        let log_time_ns = item.stamp_ns.max(log_time_ns).max(1);
        let (sequence, log_time) = (item.number as u32, log_time_ns as u64);
        let header = |channel_id| MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        let message = codec::parts_on(port.payload, item);
        let n_bytes = message.len() as u64;
        self.writer.write_message(header(port.exact), message)?;
        if let (Some(view), Body::Value(value)) = (port.view, &item.body)
            && let Some(picture) = value.to_display(&unplanned(log_time_ns))
        {
            self.writer.write_message(header(view), picture.into())?;
        }
        Ok(n_bytes)
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.writer.finish().map(drop)
    }
}

/// The items of one firing have no tree of frames.
fn unplanned(stamp_ns: StampNs) -> DisplayContext<'static> {
    DisplayContext { stamp_ns, wire: "", edge: FrameEdge::Unplanned }
}

/// Reads the items of each port, in the order in which they were written.
///
/// # Errors
/// [`RecordingError`] if the file is damaged or holds a payload that is unknown here.
pub(super) fn read(path: &Path, registry: &Registry) -> Result<BTreeMap<String, Vec<Item>>, RecordingError> {
    let mut reader = Reader::open(path).map_err(|source| RecordingError::Read { path: path.into(), source })?;
    let mut pass = Pass {
        registry,
        channels: Channels::default(),
        items: BTreeMap::new(),
        damages: Vec::new(),
        n_unknown: 0,
        failed: None,
        allowance: Allowance::from_env(),
        full_at: None,
    };
    let end = reader.read(&mut pass).map_err(|error| RecordingError::of(path, error))?;
    too_large(path, &pass.allowance, pass.full_at, reader.n_bytes())?;
    if let Some(error) = pass.failed {
        return Err(error);
    }
    let unknown = (pass.n_unknown > 0)
        .then(|| format!("{} messages belong to channels that nothing in the file describes", pass.n_unknown));
    match damage_message(&pass.damages, &end).or(unknown) {
        Some(reason) => Err(RecordingError::Foreign { path: path.into(), reason }),
        None => Ok(pass.items),
    }
}

struct Pass<'a> {
    registry: &'a Registry,
    channels: Channels,
    items: BTreeMap<String, Vec<Item>>,
    damages: Vec<Damage>,
    n_unknown: u64,
    failed: Option<RecordingError>,
    allowance: Allowance,
    full_at: Option<Location>,
}

impl Pass<'_> {
    fn item(&self, port: &Wire, message: &Message<'_>) -> Result<Item, RecordingError> {
        let fault =
            |reason: String| RecordingError::Item { wire: port.name.clone(), number: message.sequence.into(), reason };
        let recorded = codec::decode(message.data).map_err(|error| fault(error.to_string()))?;
        match recorded.body {
            Err(empty) => {
                Ok(Item { number: recorded.number, stamp_ns: recorded.stamp_ns, body: Body::Empty(empty.into()) })
            }
            Ok(_) => {
                // On a port that takes any payload, each value names its own.
                let named =
                    recorded.payload.clone().unwrap_or_else(|| (port.header.payload.clone(), port.header.version));
                let ty = known(&named.0, named.1, self.registry).map_err(fault)?;
                recorded.into_item(ty).map_err(|error| fault(error.to_string()))
            }
        }
    }
}

impl Visitor for Pass<'_> {
    fn record(&mut self, place: Location, record: Record<'_>) -> ControlFlow<()> {
        match record {
            Record::Channel(channel) => drop(self.channels.add(channel)),
            Record::Message(message) => {
                let port = match self.channels.get(message.channel_id) {
                    Some(Carries::Exact(port)) => port,
                    Some(_) => return ControlFlow::Continue(()),
                    None => {
                        self.n_unknown += 1;
                        return ControlFlow::Continue(());
                    }
                };
                if self.allowance.take(message.data.len()).is_break() {
                    self.full_at = Some(place);
                    return ControlFlow::Break(());
                }
                match self.item(port, &message) {
                    Ok(item) => self.items.entry(port.name.clone()).or_default().push(item),
                    Err(error) => {
                        self.failed = Some(error);
                        return ControlFlow::Break(());
                    }
                }
            }
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        self.damages.push(damage);
        ControlFlow::Break(())
    }
}
