//! The `mcap` crate as the other side: it reads the files of [`Writer`], and [`Reader`] reads its files.

use osteoflow_container::{
    Attachment, Compression, Damage, End, Location, MessageHeader, Reader, Record, Visitor, WriteOptions, Writer,
};
use std::{collections::BTreeMap, io::Cursor, ops::ControlFlow};

/// Topic, schema, sequence, log time, publish time and data of a message.
type Message = (String, String, u32, u64, u64, Vec<u8>);
type Map = BTreeMap<String, String>;

/// Contents of a file, for any reader.
#[derive(Debug, Default, PartialEq)]
struct Content {
    messages: Vec<Message>,
    channels: BTreeMap<String, (String, Map)>,
    metadata: Vec<(String, Map)>,
    attachments: Vec<(String, String, u64, u64, Vec<u8>)>,
}

fn map(key: &str, value: &str) -> Map {
    [(key.to_owned(), value.to_owned())].into()
}

fn content() -> Content {
    let topics = [("/a", "A"), ("/b", "B"), ("/c", "")];
    let message = |i: u32| {
        let (topic, schema) = topics[i as usize % 3];
        let data = (0..i * 90).map(|k| (k.wrapping_mul(k + i) >> 7) as u8).collect();
        (topic.into(), schema.into(), i, 1_000 + u64::from(i), 900 + u64::from(i), data)
    };
    Content {
        messages: (0..60).map(message).collect(),
        channels: topics.map(|(topic, _)| (topic.to_owned(), ("raw".to_owned(), map("topic", topic)))).into(),
        metadata: vec![("first".into(), map("k", "v")), ("last".into(), Map::new())],
        attachments: vec![("plan.json".into(), "application/json".into(), 7, 6, b"{}".to_vec())],
    }
}

fn options(compression: Compression, chunks: bool, index: bool) -> WriteOptions {
    WriteOptions { compression, chunks, index, chunk_bytes: 2_000, ..WriteOptions::default() }
}

fn written(content: &Content, options: WriteOptions) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), options).unwrap();
    let mut metadata = content.metadata.iter();
    metadata.by_ref().take(1).for_each(|(name, entries)| writer.write_metadata(name, entries).unwrap());
    let mut ids = BTreeMap::new();
    for (topic, schema, sequence, log_time, publish_time, data) in &content.messages {
        let channel_id = *ids.entry(topic).or_insert_with(|| {
            let schema = if schema.is_empty() { 0 } else { writer.add_schema(schema, "text", b"as it is").unwrap() };
            let (encoding, about) = &content.channels[topic];
            writer.add_channel(schema, topic, encoding, about).unwrap()
        });
        let header =
            MessageHeader { channel_id, sequence: *sequence, log_time: *log_time, publish_time: *publish_time };
        writer.write_message(header, data.clone().into()).unwrap();
    }
    for (name, media_type, log_time, create_time, data) in &content.attachments {
        let (log_time, create_time) = (*log_time, *create_time);
        writer.write_attachment(&Attachment { log_time, create_time, name, media_type, data }).unwrap();
    }
    metadata.for_each(|(name, entries)| writer.write_metadata(name, entries).unwrap());
    writer.finish().unwrap()
}

fn written_by_mcap(content: &Content, options: &WriteOptions) -> Vec<u8> {
    let crate_options = mcap::WriteOptions::new()
        .compression(match options.compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        })
        .compression_threads(0)
        .use_chunks(options.chunks)
        .chunk_size(options.chunks.then_some(2_000))
        .emit_message_indexes(options.index)
        .emit_summary_records(options.index)
        .emit_summary_offsets(options.index);
    let mut writer = crate_options.create(Cursor::new(Vec::new())).unwrap();
    let metadata =
        |(name, metadata): &(String, Map)| mcap::records::Metadata { name: name.clone(), metadata: metadata.clone() };
    writer.write_metadata(&metadata(&content.metadata[0])).unwrap();
    for (topic, schema, sequence, log_time, publish_time, data) in &content.messages {
        let schema = if schema.is_empty() { 0 } else { writer.add_schema(schema, "text", b"as it is").unwrap() };
        let (encoding, about) = &content.channels[topic];
        let channel_id = writer.add_channel(schema, topic, encoding, about).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: *sequence,
            log_time: *log_time,
            publish_time: *publish_time,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    for (name, media_type, log_time, create_time, data) in &content.attachments {
        let attachment = mcap::Attachment {
            log_time: *log_time,
            create_time: *create_time,
            name: name.clone(),
            media_type: media_type.clone(),
            data: data.into(),
        };
        writer.attach(&attachment).unwrap();
    }
    writer.write_metadata(&metadata(&content.metadata[1])).unwrap();
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[derive(Default)]
struct Gather {
    content: Content,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, (String, u16)>,
    damages: Vec<Damage>,
    n_sections: usize,
}

impl Visitor for Gather {
    fn record(&mut self, _: Location, record: Record<'_>) -> ControlFlow<()> {
        match record {
            Record::Schema { id, name, .. } => drop(self.schemas.insert(id, name.into())),
            Record::Channel(channel) => {
                self.channels.insert(channel.id, (channel.topic.clone(), channel.schema_id));
                self.content.channels.insert(channel.topic, (channel.message_encoding, channel.metadata));
            }
            Record::Message(m) => {
                let (topic, schema_id) = self.channels[&m.channel_id].clone();
                let schema = self.schemas.get(&schema_id).cloned().unwrap_or_default();
                self.content.messages.push((topic, schema, m.sequence, m.log_time, m.publish_time, m.data.into()));
            }
            Record::Metadata { name, entries } => self.content.metadata.push((name.into(), entries)),
            Record::Attachment(a) => self.content.attachments.push((
                a.name.into(),
                a.media_type.into(),
                a.log_time,
                a.create_time,
                a.data.into(),
            )),
            Record::DataEnd { crc, computed } | Record::Footer { crc, computed, .. } => {
                assert!(crc != 0 && computed == Some(crc), "stored {crc:08x}, computed {computed:08x?}");
                self.n_sections += 1;
            }
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        self.damages.push(damage);
        ControlFlow::Continue(())
    }
}

fn read(bytes: &[u8]) -> Content {
    let mut gather = Gather::default();
    let mut reader = Reader::new(Cursor::new(bytes), bytes.len() as u64).with_section_crcs();
    let end = reader.read(&mut gather).unwrap();
    assert_eq!((end, gather.damages, gather.n_sections), (End::Complete { trailing: 0 }, vec![], 2));
    gather.content
}

/// Reads by the `mcap` crate; every CRC is checked.
fn read_by_mcap(bytes: &[u8]) -> Content {
    use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
    let options = LinearReaderOptions::default()
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true)
        .with_prevalidate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options);
    let (mut at, mut content) = (0, Content::default());
    let (mut schemas, mut channels) = (BTreeMap::new(), BTreeMap::new());
    while let Some(event) = reader.next_event() {
        match event.unwrap() {
            LinearReadEvent::ReadRequest(n) => {
                let n = n.min(bytes.len() - at);
                reader.insert(n).copy_from_slice(&bytes[at..at + n]);
                reader.notify_read(n);
                at += n;
            }
            LinearReadEvent::Record { opcode, data } => match mcap::parse_record(opcode, data).unwrap() {
                mcap::records::Record::Schema { header, .. } => drop(schemas.insert(header.id, header.name)),
                mcap::records::Record::Channel(channel) => {
                    channels.insert(channel.id, (channel.topic.clone(), channel.schema_id));
                    content.channels.insert(channel.topic, (channel.message_encoding, channel.metadata));
                }
                mcap::records::Record::Message { header: h, data } => {
                    let (topic, schema) = channels[&h.channel_id].clone();
                    let schema = schemas.get(&schema).cloned().unwrap_or_default();
                    content.messages.push((topic, schema, h.sequence, h.log_time, h.publish_time, data.into_owned()));
                }
                mcap::records::Record::Metadata(m) => content.metadata.push((m.name, m.metadata)),
                mcap::records::Record::Attachment { header: h, data, .. } => {
                    let data = data.into_owned();
                    content.attachments.push((h.name, h.media_type, h.log_time, h.create_time, data));
                }
                _ => {}
            },
        }
    }
    content
}

fn layouts() -> impl Iterator<Item = WriteOptions> {
    Compression::ALL.into_iter().flat_map(|compression| {
        [(true, true), (true, false), (false, true), (false, false)]
            .map(|(chunks, index)| options(compression, chunks, index))
    })
}

#[test]
fn a_written_file_is_read_the_same_by_both_sides_in_every_layout() {
    let content = content();
    for options in layouts() {
        let bytes = written(&content, options.clone());
        assert_eq!(read(&bytes), content, "{options:?}");
        assert_eq!(read_by_mcap(&bytes), content, "{options:?}");
        let Some(summary) = mcap::Summary::read(&bytes).unwrap().filter(|s| s.stats.is_some()) else {
            assert!(!options.index, "{options:?}: no summary");
            continue;
        };
        assert!(options.index, "{options:?}");
        let stats = summary.stats.as_ref().unwrap();
        assert_eq!((stats.message_count, stats.channel_count, stats.schema_count), (60, 3, 2));
        assert_eq!((stats.message_start_time, stats.message_end_time), (1_000, 1_059));
        assert_eq!((stats.attachment_count, stats.metadata_count), (1, 2));
        assert_eq!((summary.attachment_indexes.len(), summary.metadata_indexes.len()), (1, 2));
        let attachment = mcap::read::attachment(&bytes, &summary.attachment_indexes[0]).unwrap();
        assert_eq!((&*attachment.name, &*attachment.data), ("plan.json", b"{}".as_slice()));
        let metadata = summary.metadata_indexes.iter().map(|i| mcap::read::metadata(&bytes, i).unwrap());
        assert_eq!(metadata.map(|m| (m.name, m.metadata)).collect::<Vec<_>>(), content.metadata);
        let indexed: usize = summary
            .chunk_indexes
            .iter()
            .map(|i| summary.stream_chunk(&bytes, i).unwrap().map(Result::unwrap).count())
            .sum();
        assert_eq!(indexed, if options.chunks { 60 } else { 0 }, "{options:?}");
        assert!(!options.chunks || summary.chunk_indexes.len() > 3, "{} chunks", summary.chunk_indexes.len());
    }
}

#[test]
fn a_file_of_the_mcap_crate_is_read_in_every_layout() {
    let content = content();
    for options in layouts() {
        assert_eq!(read(&written_by_mcap(&content, &options)), content, "{options:?}");
    }
}
