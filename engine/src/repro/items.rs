//! `inputs.mcap`: the items that the ports of a firing had joined.

use crate::recording::{
    RecordingError, codec,
    format::{EXACT_ENCODING, MetadataRecord, ReproRecord, Topic, WireHeader},
    known,
};
use mcap::{
    McapError, WriteOptions, Writer,
    records::{MessageHeader, Metadata, Record},
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use osteoflow_node::{Body, Item, PayloadType, PortPayload, Registry, StampNs};
use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufWriter, Read},
    path::Path,
};

/// The longest record that is believed; a point cloud of a thousand million bytes still fits.
const MAX_RECORD_BYTES: usize = 1 << 31;
/// What is read at a time at most, whatever a record claims to need.
const READ_BYTES: usize = 1 << 20;

/// Writes items as they are handed in, one at a time, so that a firing of many never lies in memory twice.
pub(super) struct Items {
    writer: Writer<BufWriter<File>>,
}

/// The channels of one port.
pub(super) struct Port {
    payload: PortPayload,
    exact: u16,
    view: Option<u16>,
}

impl Items {
    pub(super) fn create(path: &Path, node: &str, item: u64) -> Result<Self, McapError> {
        // Chunks bound what is lost should the disk fill; compression would cost time and buys little.
        let options = WriteOptions::new().profile("osteoflow-repro").compression(None);
        let mut writer = options.create(BufWriter::new(File::create(path)?))?;
        let firing = ReproRecord { node: node.into(), item };
        writer.write_metadata(&Metadata { name: ReproRecord::NAME.into(), metadata: firing.to_metadata() })?;
        Ok(Self { writer })
    }

    /// The channels of a port; `ty` is what it brings.
    pub(super) fn port(
        &mut self,
        name: &str,
        payload: PortPayload,
        ty: Option<&PayloadType>,
    ) -> Result<Port, McapError> {
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

    /// Writes an item of the port, and its picture for viewers; answers its bytes.
    pub(super) fn item(&mut self, port: &Port, item: &Item, log_time_ns: StampNs) -> Result<u64, McapError> {
        // Viewers take no time before the first nanosecond.
        let log_time_ns = item.stamp_ns.max(log_time_ns).max(1);
        let header = |channel_id| MessageHeader {
            channel_id,
            sequence: item.number as u32,
            log_time: log_time_ns as u64,
            publish_time: log_time_ns as u64,
        };
        let bytes = codec::encode_on(port.payload, item);
        self.writer.write_to_known_channel(&header(port.exact), &bytes)?;
        if let (Some(view), Body::Value(value)) = (port.view, &item.body)
            && let Some(picture) = value.to_display(log_time_ns)
        {
            self.writer.write_to_known_channel(&header(view), &picture)?;
        }
        Ok(bytes.len() as u64)
    }

    pub(super) fn finish(mut self) -> Result<(), McapError> {
        self.writer.finish().map(drop)
    }
}

/// The items of each port, in the order in which they were written.
///
/// # Errors
/// [`RecordingError`] if the file is damaged or holds what is unknown here.
pub(super) fn read(path: &Path, registry: &Registry) -> Result<BTreeMap<String, Vec<Item>>, RecordingError> {
    let io = |source| RecordingError::Read { path: path.into(), source };
    let foreign = |reason: String| RecordingError::Foreign { path: path.into(), reason };
    let mut file = File::open(path).map_err(io)?;
    let options =
        LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    let mut ports: BTreeMap<u16, (String, String, u32)> = BTreeMap::new();
    let mut items: BTreeMap<String, Vec<Item>> = BTreeMap::new();
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| foreign(error.to_string()))? {
            LinearReadEvent::ReadRequest(n_bytes) => {
                let n_read = file.read(reader.insert(n_bytes.min(READ_BYTES))).map_err(io)?;
                reader.notify_read(n_read);
            }
            LinearReadEvent::Record { data, opcode } => {
                match mcap::parse_record(opcode, data).map_err(|error| foreign(error.to_string()))? {
                    Record::Channel(channel) if channel.message_encoding == EXACT_ENCODING => {
                        let Some(Topic::Exact(port)) = Topic::parse(&channel.topic) else { continue };
                        let header = WireHeader::from_metadata(&channel.metadata);
                        ports.insert(channel.id, (port.to_owned(), header.payload, header.version));
                    }
                    Record::Message { header, data } => {
                        let Some((port, payload, version)) = ports.get(&header.channel_id) else { continue };
                        let fault = |reason: String| RecordingError::Item {
                            wire: port.clone(),
                            number: header.sequence.into(),
                            reason,
                        };
                        let recorded = codec::decode(&data).map_err(|error| fault(error.to_string()))?;
                        // Where a port takes any payload, each value names its own.
                        let (payload, version) =
                            recorded.payload.clone().unwrap_or_else(|| (payload.clone(), *version));
                        let item = match recorded.body {
                            Err(empty) => {
                                let body = Body::Empty(empty.into());
                                Item { number: recorded.number, stamp_ns: recorded.stamp_ns, body }
                            }
                            Ok(_) => {
                                let ty = known(&payload, version, registry).map_err(fault)?;
                                recorded.into_item(ty).map_err(|error| fault(error.to_string()))?
                            }
                        };
                        items.entry(port.clone()).or_default().push(item);
                    }
                    _ => {}
                }
            }
        }
    }
    Ok(items)
}
