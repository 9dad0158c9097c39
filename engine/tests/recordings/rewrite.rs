//! Copies recordings with another order of messages, other chunks or another compression.

use mcap::{Compression, WriteOptions, Writer, records::MessageHeader, records::Record};
use std::{collections::BTreeMap, fs, path::Path};

/// A small random number generator, the same on every platform.
pub(crate) struct Draw(pub(crate) u64);

impl Draw {
    pub(crate) fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % n.max(1)
    }
}

pub(crate) struct Layout {
    pub(crate) chunk_bytes: Option<u64>,
    pub(crate) compression: Option<Compression>,
    pub(crate) shuffle: Option<u64>,
    /// Whether chunks have CRCs; without them, damage is detected later.
    pub(crate) crc: bool,
}

/// Copies messages from `from` to `to`; `change` may alter the header and bytes of each or return `false` to omit it.
pub(crate) fn rewrite(
    from: &Path,
    to: &Path,
    layout: &Layout,
    change: impl FnMut(&str, &mut MessageHeader, &mut Vec<u8>) -> bool,
) {
    write(from, to, layout, change, |_| ());
}

/// Copies all messages; `change` may alter the metadata of each channel.
pub(crate) fn rewrite_about(from: &Path, to: &Path, layout: &Layout, change: impl Fn(&mut BTreeMap<String, String>)) {
    write(from, to, layout, |_, _, _| true, change);
}

fn write(
    from: &Path,
    to: &Path,
    layout: &Layout,
    mut change: impl FnMut(&str, &mut MessageHeader, &mut Vec<u8>) -> bool,
    change_about: impl Fn(&mut BTreeMap<String, String>),
) {
    let bytes = fs::read(from).unwrap();
    let mut metadata = Vec::new();
    for record in mcap::read::LinearReader::new(&bytes).unwrap() {
        if let Record::Metadata(m) = record.unwrap() {
            metadata.push(m);
        }
    }
    let mut messages = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        messages.push(message.unwrap());
    }
    if let Some(seed) = layout.shuffle {
        let mut draw = Draw(seed);
        for i in (1..messages.len()).rev() {
            messages.swap(i, draw.below(i as u64 + 1) as usize);
        }
    }
    let options = WriteOptions::new()
        .profile("osteoflow")
        .compression(layout.compression)
        .calculate_chunk_crcs(layout.crc)
        .use_chunks(layout.chunk_bytes.is_some())
        .chunk_size(layout.chunk_bytes);
    let mut writer: Writer<_> = options.create(fs::File::create(to).unwrap()).unwrap();
    // In the order of the recorder: the graph first, counts and results last.
    let (front, back): (Vec<_>, Vec<_>) = metadata.iter().partition(|m| m.name == "osteoflow");
    front.iter().for_each(|m| writer.write_metadata(m).unwrap());
    let mut ids = BTreeMap::new();
    for message in &messages {
        let channel = &message.channel;
        let id = *ids.entry(channel.topic.clone()).or_insert_with(|| {
            let schema = channel.schema.as_ref().unwrap();
            let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data).unwrap();
            let mut about = channel.metadata.clone();
            change_about(&mut about);
            writer.add_channel(schema, &channel.topic, &channel.message_encoding, &about).unwrap()
        });
        let mut header = MessageHeader {
            channel_id: id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        // Changed is the item, not the sequence of bytes that it is in.
        let is_framed = channel.message_encoding == "cdr";
        let mut data = message.data[if is_framed { 8 } else { 0 }..].to_vec();
        if change(&channel.topic, &mut header, &mut data) {
            if is_framed {
                let head = [[0, 1, 0, 0], (data.len() as u32).to_le_bytes()].concat();
                data.splice(..0, head);
            }
            writer.write_to_known_channel(&header, &data).unwrap();
        }
    }
    back.iter().for_each(|m| writer.write_metadata(m).unwrap());
    writer.finish().unwrap();
}

/// Copies all messages unchanged.
pub(crate) fn copy(from: &Path, to: &Path, layout: &Layout) {
    rewrite(from, to, layout, |_, _, _| true);
}
