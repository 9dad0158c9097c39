//! Gathers the messages of a recording in one pass.

use super::{Attachment, McapError, Message, Recording, Topic};
use bytes::Bytes;
use osteoflow_container::{
    Allowance, Cause, Channel, Damage, End, Location, MESSAGE_HEADER_BYTES, Reader, Record, Statistics, Visitor,
};
use osteoflow_geometry::StampNs;
use std::{
    collections::{BTreeMap, btree_map::Entry},
    io::{Read, Seek},
    ops::ControlFlow,
    sync::Arc,
};

/// Name and encoding of a schema.
type Schema = (Arc<str>, Arc<str>);

/// A message whose channel may be described later.
struct PendingMessage {
    channel_id: u16,
    location: Location,
    sequence: u32,
    log_time: u64,
    publish_time: u64,
    /// Empty until the end of its chunk.
    data: Bytes,
    n_bytes: usize,
}

/// State of the pass.
pub(super) struct Pass<'a> {
    path: &'a str,
    allow_truncated: bool,
    keep: &'a dyn Fn(&str) -> bool,
    schemas: BTreeMap<u16, Schema>,
    /// Each with its encoding and whether its messages are wanted.
    channels: BTreeMap<u16, (Channel, Arc<str>, bool)>,
    channel_order: Vec<u16>,
    n_by_channel: BTreeMap<u16, usize>,
    pending: Vec<PendingMessage>,
    /// Index in `pending` of the first message of the current chunk.
    chunk_start: usize,
    statistics: Option<Statistics>,
    data_end: u64,
    recording: Recording,
    failed: Option<McapError>,
    allowance: Allowance,
}

impl<'a> Pass<'a> {
    pub(super) fn new(path: &'a str, allow_truncated: bool, keep: &'a dyn Fn(&str) -> bool) -> Self {
        Self {
            path,
            allow_truncated,
            keep,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            channel_order: Vec::new(),
            n_by_channel: BTreeMap::new(),
            pending: Vec::new(),
            chunk_start: 0,
            statistics: None,
            data_end: 0,
            recording: Recording::default(),
            failed: None,
            allowance: Allowance::from_env(),
        }
    }

    /// Reads everything.
    pub(super) fn read<R: Read + Seek>(mut self, reader: Reader<R>) -> Result<Recording, McapError> {
        let end = reader.with_section_crcs().read(&mut self).map_err(|error| McapError::of(self.path, error))?;
        if let Some(error) = self.failed {
            return Err(error);
        }
        match end {
            End::Truncated(damage) => {
                let n_messages = self.n_messages();
                if !self.allow_truncated {
                    return Err(McapError::Truncated { path: self.path.into(), damage, n_messages });
                }
                let note = self.note(&damage);
                self.recording.notes.push(format!("{note}; {n_messages} messages before it are used"));
            }
            End::Complete { trailing } if trailing > 0 => {
                self.recording.notes.push(format!("{trailing} bytes follow the closing magic and were not read"));
            }
            End::Complete { .. } | End::Stopped => {}
        }
        self.compare_statistics();
        self.finish()
    }

    fn n_messages(&self) -> usize {
        self.n_by_channel.values().sum()
    }

    fn note(&self, damage: &Damage) -> String {
        format!("{}: byte {}: {}", self.path, damage.bytes.start, damage.cause)
    }

    /// Notes damage, or stops at it.
    fn tolerate(&mut self, damage: Damage, note: impl FnOnce(String) -> String) -> ControlFlow<()> {
        if self.allow_truncated {
            let text = self.note(&damage);
            self.recording.notes.push(note(text));
            return ControlFlow::Continue(());
        }
        self.failed = Some(match &damage.cause {
            Cause::Magic { start } => McapError::damaged_magic(self.path, start),
            _ => McapError::Damaged { path: self.path.into(), damage },
        });
        ControlFlow::Break(())
    }

    /// Compares the CRC of a section; where it does not hold, its bytes are used on request.
    fn section(
        &mut self,
        what: &'static str,
        bytes: std::ops::Range<u64>,
        stored: u32,
        computed: Option<u32>,
    ) -> ControlFlow<()> {
        match computed {
            Some(computed) if stored != 0 && computed != stored => {
                // The bytes are used all the same.
                self.tolerate(Damage { bytes, cause: Cause::Crc { what, stored, computed } }, |note| note)
            }
            _ => ControlFlow::Continue(()),
        }
    }

    fn compare_statistics(&mut self) {
        let Some(statistics) = self.statistics.take() else { return };
        let n_read = self.n_messages();
        if statistics.n_messages != n_read as u64 {
            let stated = statistics.n_messages;
            self.recording.notes.push(format!("the summary counts {stated} messages, but {n_read} could be read"));
            return;
        }
        for (id, stated) in statistics.by_channel {
            let n_read = self.n_by_channel.get(&id).copied().unwrap_or(0);
            if stated != n_read as u64 {
                let topic = self.channels.get(&id).map_or("unknown", |(channel, ..)| &channel.topic);
                let note = format!("the summary counts {stated} messages of \"{topic}\", but {n_read} could be read");
                self.recording.notes.push(note);
            }
        }
    }

    fn message(&mut self, location: Location, message: &osteoflow_container::Message<'_>) -> ControlFlow<()> {
        let channel_id = message.channel_id;
        *self.n_by_channel.entry(channel_id).or_default() += 1;
        let last = &mut self.recording.last_publish_time_ns;
        *last = (*last).max(Some(stamp(message.publish_time)));
        if self.channels.get(&channel_id).is_some_and(|(.., is_wanted)| !is_wanted) {
            return ControlFlow::Continue(());
        }
        let taken = self.allowance.take(message.data.len());
        if let Some(source) = self.allowance.exceeded() {
            let reason = format!("at {location}: {source}");
            self.failed = Some(McapError::Unreadable { path: self.path.into(), reason });
            return taken;
        }
        self.pending.push(PendingMessage {
            channel_id,
            location,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
            data: match location.in_chunk {
                Some(_) => Bytes::new(),
                None => Bytes::copy_from_slice(message.data),
            },
            n_bytes: message.data.len(),
        });
        ControlFlow::Continue(())
    }

    /// Sorts the messages by topic, now that all channels are known.
    fn finish(mut self) -> Result<Recording, McapError> {
        let mut n_unknown = 0;
        for message in std::mem::take(&mut self.pending) {
            let Some((channel, message_encoding, is_wanted)) = self.channels.get(&message.channel_id) else {
                if !self.allow_truncated {
                    let (location, channel) = (message.location, message.channel_id);
                    let reason =
                        format!("{location}: a message belongs to channel {channel}, which the file does not describe");
                    return Err(McapError::Unreadable { path: self.path.into(), reason });
                }
                n_unknown += 1;
                continue;
            };
            if !is_wanted {
                continue;
            }
            let message = Message {
                log_time_ns: stamp(message.log_time),
                publish_time_ns: stamp(message.publish_time),
                sequence: message.sequence,
                schema_name: self.schemas.get(&channel.schema_id).map_or_else(|| "".into(), |(name, _)| name.clone()),
                message_encoding: message_encoding.clone(),
                data: message.data,
            };
            match self.recording.messages.get_mut(&channel.topic) {
                Some(messages) => messages.push(message),
                None => {
                    self.recording.messages.insert(channel.topic.clone(), vec![message]);
                }
            }
        }
        if n_unknown > 0 {
            self.recording
                .notes
                .push(format!("{n_unknown} messages were left out: their channels are described in a damaged part"));
        }
        for id in &self.channel_order {
            let (channel, ..) = &self.channels[id];
            let schema = self.schemas.get(&channel.schema_id);
            let topic = Topic {
                name: channel.topic.clone(),
                schema_name: schema.map_or(String::new(), |(name, _)| name.to_string()),
                schema_encoding: schema.map_or(String::new(), |(_, encoding)| encoding.to_string()),
                message_encoding: channel.message_encoding.clone(),
                n_messages: self.n_by_channel.get(id).copied().unwrap_or(0),
            };
            self.recording.add_topic(topic);
        }
        Ok(self.recording)
    }
}

impl Visitor for Pass<'_> {
    fn record(&mut self, location: Location, record: Record<'_>) -> ControlFlow<()> {
        match record {
            Record::Schema { id, name, encoding, .. } => {
                self.schemas.entry(id).or_insert_with(|| (name.into(), encoding.into()));
            }
            Record::Channel(channel) => {
                let id = channel.id;
                if let Entry::Vacant(vacant) = self.channels.entry(id) {
                    let message_encoding = channel.message_encoding.as_str().into();
                    let is_wanted = (self.keep)(&channel.topic);
                    vacant.insert((channel, message_encoding, is_wanted));
                    self.channel_order.push(id);
                }
            }
            Record::Message(message) => return self.message(location, &message),
            Record::Chunk(_) => self.chunk_start = self.pending.len(),
            Record::Attachment(attachment) => self.recording.attachments.push(Attachment {
                name: attachment.name.into(),
                media_type: attachment.media_type.into(),
                data: Bytes::copy_from_slice(attachment.data),
            }),
            Record::Metadata { name, entries } => {
                self.recording.metadata.entry(name.into()).or_default().extend(entries);
            }
            Record::Statistics(statistics) => self.statistics = Some(statistics),
            Record::DataEnd { crc, computed } => {
                self.data_end = location.offset;
                return self.section("the data section", 0..location.offset, crc, computed);
            }
            Record::Footer { crc, computed, .. } => {
                return self.section("the summary", self.data_end..location.offset, crc, computed);
            }
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn chunk_end(&mut self, records: &mut Vec<u8>) {
        let pending = &mut self.pending[self.chunk_start..];
        let n_kept: usize = pending.iter().map(|f| f.n_bytes).sum();
        let range = |f: &PendingMessage| {
            let start = (f.location.in_chunk.unwrap_or(0) + MESSAGE_HEADER_BYTES) as usize;
            start..start + f.n_bytes
        };
        if n_kept < records.len() / 2 {
            // Most of the chunk is not wanted, so it is not kept alive.
            for message in pending {
                message.data = Bytes::copy_from_slice(&records[range(message)]);
            }
        } else {
            let records = Bytes::from(std::mem::take(records));
            for message in pending {
                message.data = records.slice(range(message));
            }
        }
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        let n_bytes = damage.bytes.end - damage.bytes.start;
        self.tolerate(damage, |note| format!("{note}; {n_bytes} bytes are left out"))
    }
}

fn stamp(time: u64) -> StampNs {
    StampNs::try_from(time).unwrap_or(StampNs::MAX)
}
