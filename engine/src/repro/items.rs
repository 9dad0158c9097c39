//! `inputs.mcap`: the items that the ports of a firing had joined.

use crate::recording::{
    Gathered, Gathering, RecordingError, codec,
    format::{EXACT_ENCODING, EXACT_SCHEMA_ENCODING, REPRO_PROFILE, Topic, WireHeader},
    scan::{Scanned, scan},
    typed,
    wires::Wire,
};
use osteoflow_container::{Compression, MessageHeader, WriteOptions, Writer};
use osteoflow_node::{Body, DisplayContext, FrameEdge, Item, PayloadType, PortPayload, Registry, StampNs};
use std::{collections::BTreeMap, fs::File, io, path::Path};

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
        let firing = [("node", node.to_owned()), ("item", item.to_string())];
        writer.write_metadata("osteoflow.repro", &firing.map(|(key, value)| (key.to_owned(), value)).into())?;
        Ok(Self { writer })
    }

    /// Adds the channels of a port; `ty` is the type of its items.
    pub(super) fn port(&mut self, name: &str, payload: PortPayload, ty: Option<&PayloadType>) -> io::Result<Port> {
        let version = payload.ty().map_or(0, |ty| ty.version);
        let header = WireHeader { payload: payload.name().into(), version, ..WireHeader::default() };
        let schema =
            self.writer.add_schema(&header.schema_name(), EXACT_SCHEMA_ENCODING, codec::schema_text().as_bytes())?;
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
        self.writer.write_message(header(port.exact), codec::framed(message))?;
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
    DisplayContext { stamp_ns, wire: "", edge: FrameEdge::Unplanned, anchored: false }
}

/// Reads the items of each port, in the order in which they were written.
///
/// # Errors
/// [`RecordingError`] if the file is damaged or holds a payload that is unknown here.
pub(super) fn read(path: &Path, registry: &Registry) -> Result<BTreeMap<String, Vec<Item>>, RecordingError> {
    let mut gathered = Gathering::default();
    let Scanned { damage, n_unknown, .. } = scan(path, &mut gathered, &mut |_, _| {})?;
    let mut ports = BTreeMap::new();
    for (name, Gathered { about: Wire { header, .. }, messages }) in gathered.wires {
        // On a port that takes any payload, each value names its own.
        let item = |(number, message): (Option<u64>, Vec<u8>)| {
            let item = codec::decode(&message).map_err(|error| error.to_string());
            let item = item.and_then(|item| typed(item, &header.payload, header.version, registry));
            item.map_err(|reason| RecordingError::item(&name, number.unwrap_or_default(), reason))
        };
        ports.insert(name.clone(), messages.into_iter().map(item).collect::<Result<_, _>>()?);
    }
    let unknown =
        (n_unknown > 0).then(|| format!("{n_unknown} messages belong to channels that nothing in the file describes"));
    match damage.or(unknown) {
        Some(reason) => Err(RecordingError::foreign(path, reason)),
        None => Ok(ports),
    }
}
