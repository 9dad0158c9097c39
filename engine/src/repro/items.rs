//! `inputs.mcap`: the items that the ports of a firing had joined.

use super::bundle::{Given, Input, Shown};
use crate::{
    plan::Plan,
    recording::{
        Gathered, Gathering, RecordingError, codec,
        format::{EXACT_ENCODING, EXACT_SCHEMA_ENCODING, REPRO_PROFILE, Topic, WireHeader},
        scan::{Scanned, scan},
        typed,
        wires::Wire,
    },
    runtime::Failed,
};
use osteoflow_container::{Compression, MessageHeader, WriteOptions, Writer};
use osteoflow_node::{Body, DisplayContext, Field, FrameEdge, Item, Joined, PayloadType, Registry, Slot, Value};
use std::{borrow::Cow, collections::BTreeMap, fs::File, io, path::Path};

/// Writes the items of a firing, with pictures for viewers, and returns what each port brought.
pub(super) fn write(path: &Path, plan: &Plan, failed: &Failed<'_>, joined: &Joined) -> io::Result<Vec<Input>> {
    let node = &plan.nodes[failed.node];
    let options = WriteOptions {
        profile: REPRO_PROFILE.into(),
        library: concat!("osteoflow ", env!("CARGO_PKG_VERSION")).into(),
        // Compression would cost time and gain little.
        compression: Compression::None,
        ..WriteOptions::default()
    };
    let mut file = Writer::new(File::create(path)?, options)?;
    let firing = [("node", node.name.to_string()), ("item", failed.item.to_string())];
    file.write_metadata("osteoflow.repro", &firing.map(|(key, value)| (key.to_owned(), value)).into())?;
    let mut inputs = Vec::new();
    for (input, slot) in node.inputs.iter().zip(&joined.slots) {
        let (given, items): (Given, Cow<'_, [Item]>) = match slot {
            Slot::Item(item) => (Given::Item, std::slice::from_ref(item).into()),
            Slot::Items(items) => (Given::Items, items.into()),
            Slot::Absent(empty) => {
                let body = Body::Empty(empty.clone());
                (Given::Absent, vec![Item { number: 0, stamp_ns: failed.stamp_ns, body }].into())
            }
        };
        let (name, payload) = (input.port.name, input.port.payload);
        let version = payload.ty().map_or(0, |ty| ty.version);
        let header = WireHeader { payload: payload.name().into(), version, ..WireHeader::default() };
        let schema = file.add_schema(&header.schema_name(), EXACT_SCHEMA_ENCODING, codec::schema_text().as_bytes())?;
        let exact = file.add_channel(schema, &Topic::Exact(name).name(), EXACT_ENCODING, &header.to_metadata())?;
        // Where the port takes any payload, that of the first value.
        let first = || items.iter().find_map(|item| item.body.value()).map(Value::ty);
        let view = match payload.ty().or_else(first).and_then(PayloadType::display) {
            Some(display) => {
                let schema = file.add_schema(&display.schema_name, &display.schema_encoding, &display.schema_data)?;
                let topic = Topic::View(name).name();
                Some(file.add_channel(schema, &topic, &display.message_encoding, &BTreeMap::new())?)
            }
            None => None,
        };
        let mut shown = Vec::new();
        for item in &*items {
            // Viewers take no time before the first nanosecond.
            let stamp_ns = item.stamp_ns.max(failed.stamp_ns).max(1);
            let (sequence, log_time) = (item.number as u32, stamp_ns as u64);
            let head = |channel_id| MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
            let message = codec::parts_on(payload, item);
            shown.push(show(item, message.len() as u64));
            file.write_message(head(exact), codec::framed(message))?;
            // The items of one firing have no tree of frames.
            let context = DisplayContext { stamp_ns, wire: "", edge: FrameEdge::Unplanned, anchored: false };
            if let (Some(view), Body::Value(value)) = (view, &item.body)
                && let Some(picture) = value.to_display(&context)
            {
                file.write_message(head(view), picture.into())?;
            }
        }
        let (port, join) = (name.into(), input.port.join.name().into());
        inputs.push(Input { port, join, wire: plan.wires_of(input), given, items: shown });
    }
    file.finish()?;
    Ok(inputs)
}

fn show(item: &Item, bytes: u64) -> Shown {
    const MAX_TEXT: usize = 80;
    let about = match &item.body {
        Body::Value(value) => {
            let view = value.to_view();
            let columns = view.columns.iter().map(|column| format!("{} {}", column.rows(), column.name));
            let texts = view.head.iter().filter_map(|(name, field)| match field {
                Field::Text(text) if (1..=MAX_TEXT).contains(&text.len()) => {
                    Some(format!("{name} {}", text.replace('\n', " ")))
                }
                _ => None,
            });
            let parts = columns.chain(texts).collect::<Vec<_>>().join(", ");
            let payload = value.ty().name;
            if parts.is_empty() { payload.into() } else { format!("{payload}: {parts}") }
        }
        Body::Empty(empty) => format!("empty: {}", empty.reason),
    };
    Shown { number: item.number, stamp_ns: item.stamp_ns, bytes, about }
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
