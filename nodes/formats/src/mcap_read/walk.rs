//! The one pass over a recording, from its magic to its end or to where it can no longer be followed.

use super::{Attachment, McapError, Message, Place, Recording, Topic, fields::Fields};
use bytes::Bytes;
use mcap::{MAGIC, records::op};
use osteoflow_geometry::StampNs;
use std::{
    collections::BTreeMap,
    io::{self, Read},
    sync::Arc,
};

/// More than any recorder's chunk: a size field above it is damage, or a trap.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// A record's own bytes in front of its content: opcode and length.
const RECORD_HEAD: u64 = 9;

/// A schema as a channel needs it.
struct Schema {
    name: Arc<str>,
    encoding: Arc<str>,
}

/// A channel as it was described.
#[derive(PartialEq)]
struct Channel {
    schema_id: u16,
    topic: String,
    message_encoding: Arc<str>,
}

/// A message whose channel may be described later, as a summary does for a damaged chunk.
struct Found {
    channel_id: u16,
    place: Place,
    sequence: u32,
    log_time: u64,
    publish_time: u64,
    data: Bytes,
}

/// Whether reading can go on behind a fault.
enum Fault {
    /// The record is damaged, the next one can be found.
    Skip(McapError),
    /// The file cannot be followed any further.
    Stop(McapError),
}

/// The state of the pass.
pub(super) struct Walk<'a, R> {
    path: &'a str,
    reader: R,
    n_bytes: u64,
    allow_truncated: bool,
    keep: &'a dyn Fn(&str) -> bool,
    at: u64,
    crc: crc32fast::Hasher,
    summary_start: Option<u64>,
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Channel>,
    channel_order: Vec<u16>,
    n_found: BTreeMap<u16, usize>,
    found: Vec<Found>,
    recording: Recording,
}

impl<'a, R: Read> Walk<'a, R> {
    pub(super) fn new(
        path: &'a str,
        reader: R,
        n_bytes: u64,
        allow_truncated: bool,
        keep: &'a dyn Fn(&str) -> bool,
    ) -> Self {
        Self {
            path,
            reader,
            n_bytes,
            allow_truncated,
            keep,
            at: 0,
            crc: crc32fast::Hasher::new(),
            summary_start: None,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            channel_order: Vec::new(),
            n_found: BTreeMap::new(),
            found: Vec::new(),
            recording: Recording::default(),
        }
    }

    /// Reads everything.
    pub(super) fn read(mut self) -> Result<Recording, McapError> {
        self.start_magic()?;
        loop {
            match self.record() {
                Ok(true) => {}
                Ok(false) => break,
                Err(Fault::Skip(error)) if self.allow_truncated => self.recording.notes.push(left_out(&error)),
                Err(Fault::Stop(error)) if self.allow_truncated && !matches!(error, McapError::Io { .. }) => {
                    let n = self.n_messages();
                    self.recording.notes.push(format!("{}; {n} messages before it are used", left_out(&error)));
                    break;
                }
                Err(Fault::Skip(error) | Fault::Stop(error)) => return Err(error),
            }
        }
        self.finish()
    }

    fn n_messages(&self) -> usize {
        self.n_found.values().sum()
    }

    fn start_magic(&mut self) -> Result<(), McapError> {
        if self.n_bytes == 0 {
            return Err(McapError::Empty { path: self.path.into() });
        }
        let start = self.bytes(self.n_bytes.min(MAGIC.len() as u64))?;
        if start == MAGIC {
            return Ok(());
        }
        let hint = match start.as_slice() {
            s if s.starts_with(b"#ROSBAG") => ", a ROS 1 bag; convert it with `mcap convert`",
            s if s.starts_with(b"SQLite") => ", a ROS 2 bag of the older kind; convert it with `ros2 bag convert`",
            s if MAGIC.starts_with(s) => "; the file was cut short in its first bytes",
            _ => "; is it another kind of file, or damaged?",
        };
        let found = start.iter().map(|b| format!("{b:02X}")).collect::<Vec<_>>().join(" ");
        Err(McapError::WrongMagic { path: self.path.into(), found, hint })
    }

    /// Reads `n` bytes, which are known to be there.
    fn bytes(&mut self, n: u64) -> Result<Vec<u8>, McapError> {
        let mut bytes = vec![0; n as usize];
        self.reader.read_exact(&mut bytes).map_err(|source| McapError::Io { path: self.path.into(), source })?;
        self.at += n;
        self.crc.update(&bytes);
        Ok(bytes)
    }

    /// Reads one record; false behind the last one.
    fn record(&mut self) -> Result<bool, Fault> {
        let place = Place::at(self.at);
        let crc_before = self.crc.clone();
        let left = self.n_bytes - self.at;
        if left < RECORD_HEAD {
            let what = if left == 0 { "the recording, before its end record and footer" } else { "a record's head" };
            return Err(Fault::Stop(self.truncated(place, what, RECORD_HEAD, left)));
        }
        let head = self.bytes(RECORD_HEAD).map_err(Fault::Stop)?;
        let opcode = head[0];
        let length = u64::from_le_bytes(head[1..].try_into().expect("eight bytes follow the opcode"));
        let left = self.n_bytes - self.at;
        if opcode == 0 {
            return Err(Fault::Stop(self.malformed(place, "record", "opcode 0 is no record".into())));
        }
        if length > left {
            // A cut file lacks some of its last chunk; a length beyond any chunk is damage to the length itself.
            let error = if length > 2 * MAX_CHUNK_BYTES.max(self.n_bytes) {
                McapError::Length { path: self.path.into(), place, what: record_name(opcode), length, limit: left }
            } else {
                self.truncated(place, record_name(opcode), length, left)
            };
            return Err(Fault::Stop(error));
        }
        let body = self.bytes(length).map_err(Fault::Stop)?;
        match opcode {
            op::FOOTER => {
                self.footer(place, &head, &body, crc_before)?;
                return Ok(false);
            }
            op::DATA_END => self.data_end(place, &body, crc_before)?,
            op::CHUNK => self.chunk(place, body)?,
            op::ATTACHMENT => self.attachment(place, &body)?,
            op::METADATA => self.metadata(place, &body)?,
            op::STATISTICS => self.statistics(place, &body)?,
            op::SCHEMA | op::CHANNEL => self.describe(place, opcode, &body)?,
            op::MESSAGE => {
                let body = Bytes::from(body);
                if let Some(found) = self.message(place, &body)? {
                    self.found.push(found);
                }
            }
            // The header, indexes and what later versions of the format may add are not needed for a linear read.
            _ => {}
        }
        Ok(true)
    }

    fn truncated(&self, place: Place, what: &'static str, needed: u64, available: u64) -> McapError {
        McapError::Truncated { path: self.path.into(), place, what, needed, available, n_messages: self.n_messages() }
    }

    fn malformed(&self, place: Place, what: &'static str, reason: String) -> McapError {
        McapError::Malformed { path: self.path.into(), place, what, reason }
    }

    /// Makes the fault of a damaged record from what is wrong with it.
    fn skip(&self, place: Place, what: &'static str) -> impl Fn(String) -> Fault + use<'a, R> {
        let path = self.path;
        move |reason| Fault::Skip(McapError::Malformed { path: path.into(), place, what, reason })
    }

    fn check_crc(&self, place: Place, what: &'static str, stored: u32, calculated: u32) -> Result<(), Fault> {
        // Zero says that the writer did not compute one.
        if stored == 0 || stored == calculated {
            return Ok(());
        }
        Err(Fault::Skip(McapError::BadCrc { path: self.path.into(), place, what, stored, calculated }))
    }

    fn data_end(&mut self, place: Place, body: &[u8], before: crc32fast::Hasher) -> Result<(), Fault> {
        self.crc = crc32fast::Hasher::new();
        self.summary_start = Some(self.at);
        let stored = Fields::new(body).u32().map_err(self.skip(place, "data end"))?;
        self.check_crc(place, "the data section", stored, before.finalize())
    }

    fn footer(&mut self, place: Place, head: &[u8], body: &[u8], mut crc: crc32fast::Hasher) -> Result<(), Fault> {
        let skip = self.skip(place, "footer");
        let mut fields = Fields::new(body);
        let summary_start = fields.u64().map_err(&skip)?;
        fields.u64().map_err(&skip)?;
        let stored = fields.u32().map_err(&skip)?;
        let left = self.n_bytes - self.at;
        let magic = self.bytes(left.min(MAGIC.len() as u64)).map_err(Fault::Stop)?;
        if magic != MAGIC {
            let error = if left < MAGIC.len() as u64 {
                self.truncated(place, "the closing magic", MAGIC.len() as u64, left)
            } else {
                self.malformed(place, "footer", "the closing magic does not follow it".into())
            };
            return Err(Fault::Stop(error));
        }
        if self.at < self.n_bytes {
            let n = self.n_bytes - self.at;
            self.recording.notes.push(format!("{n} bytes follow the closing magic and were not read"));
        }
        if self.summary_start.is_some_and(|start| summary_start == start || summary_start == 0) {
            crc.update(head);
            crc.update(&body[..16]);
            let result = self.check_crc(place, "the summary", stored, crc.finalize());
            // Nothing follows the footer.
            return result.map_err(|fault| match fault {
                Fault::Skip(error) | Fault::Stop(error) => Fault::Stop(error),
            });
        }
        Ok(())
    }

    fn attachment(&mut self, place: Place, body: &[u8]) -> Result<(), Fault> {
        let skip = self.skip(place, "attachment");
        let mut fields = Fields::new(body);
        fields.take(16).map_err(&skip)?;
        let name = fields.text().map_err(&skip)?;
        let media_type = fields.text().map_err(&skip)?;
        let n_bytes = fields.u64().map_err(&skip)?;
        let data = fields.take(n_bytes).map_err(&skip)?;
        let n_checked = fields.at;
        let stored = fields.u32().map_err(&skip)?;
        self.check_crc(place, "an attachment", stored, crc32fast::hash(&body[..n_checked]))?;
        let data = Bytes::copy_from_slice(data);
        self.recording.attachments.push(Attachment { name, media_type, data });
        Ok(())
    }

    fn metadata(&mut self, place: Place, body: &[u8]) -> Result<(), Fault> {
        let mut fields = Fields::new(body);
        let name = fields.text().map_err(self.skip(place, "metadata"))?;
        let values = fields.map().map_err(self.skip(place, "metadata"))?;
        self.recording.metadata.entry(name).or_default().extend(values);
        Ok(())
    }

    fn statistics(&mut self, place: Place, body: &[u8]) -> Result<(), Fault> {
        let n_said = Fields::new(body).u64().map_err(self.skip(place, "statistics"))?;
        let n_read = self.n_messages();
        if n_said != n_read as u64 {
            self.recording.notes.push(format!("the summary counts {n_said} messages, but {n_read} could be read"));
        }
        Ok(())
    }

    fn describe(&mut self, place: Place, opcode: u8, body: &[u8]) -> Result<(), Fault> {
        let what = record_name(opcode);
        let skip = self.skip(place, what);
        let mut fields = Fields::new(body);
        let id = fields.u16().map_err(&skip)?;
        if opcode == op::SCHEMA {
            let name = fields.text().map_err(&skip)?.into();
            let encoding = fields.text().map_err(&skip)?.into();
            let n_bytes = fields.u32().map_err(&skip)?;
            fields.take(n_bytes.into()).map_err(&skip)?;
            if self.schemas.get(&id).is_some_and(|s| s.name != name) {
                return Err(skip(format!("schema {id} is described twice, with different names")));
            }
            self.schemas.entry(id).or_insert(Schema { name, encoding });
            return Ok(());
        }
        let schema_id = fields.u16().map_err(&skip)?;
        let topic = fields.text().map_err(&skip)?;
        let message_encoding = fields.text().map_err(&skip)?.into();
        let channel = Channel { schema_id, topic, message_encoding };
        match self.channels.get(&id) {
            Some(known) if *known == channel => {}
            Some(known) => {
                let reason =
                    format!("channel {id} is described twice: as \"{}\" and as \"{}\"", known.topic, channel.topic);
                return Err(skip(reason));
            }
            None => {
                self.channels.insert(id, channel);
                self.channel_order.push(id);
            }
        }
        Ok(())
    }

    /// Counts a message; none where nobody wants it.
    fn message(&mut self, place: Place, body: &Bytes) -> Result<Option<Found>, Fault> {
        let skip = self.skip(place, "message");
        let mut fields = Fields::new(body);
        let channel_id = fields.u16().map_err(&skip)?;
        let sequence = fields.u32().map_err(&skip)?;
        let log_time = fields.u64().map_err(&skip)?;
        let publish_time = fields.u64().map_err(&skip)?;
        let wanted = self.channels.get(&channel_id).is_none_or(|c| (self.keep)(&c.topic));
        let data = body.slice(fields.at..);
        *self.n_found.entry(channel_id).or_default() += 1;
        Ok(wanted.then_some(Found { channel_id, place, sequence, log_time, publish_time, data }))
    }

    fn chunk(&mut self, place: Place, body: Vec<u8>) -> Result<(), Fault> {
        let records = self.unpack(place, body)?;
        // A chunk counts whole or not at all: its messages are taken only when all of it could be read.
        let (n_before, counts_before) = (self.found.len(), self.n_found.clone());
        let result = self.chunk_records(place, &records);
        if result.is_err() {
            self.found.truncate(n_before);
            self.n_found = counts_before;
            return result;
        }
        let n_kept: usize = self.found[n_before..].iter().map(|f| f.data.len()).sum();
        if n_kept < records.len() / 2 {
            // Most of the chunk is of no interest, so it is not kept alive.
            for found in &mut self.found[n_before..] {
                found.data = Bytes::copy_from_slice(&found.data);
            }
        }
        Ok(())
    }

    fn chunk_records(&mut self, chunk: Place, records: &Bytes) -> Result<(), Fault> {
        let mut at = 0;
        while at < records.len() {
            let place = chunk.inside(at);
            let left = (records.len() - at) as u64;
            if left < RECORD_HEAD {
                return Err(self.skip(place, "chunk")(format!("{left} bytes remain, too few for a record")));
            }
            let opcode = records[at];
            let length = &records[at + 1..at + RECORD_HEAD as usize];
            let length = u64::from_le_bytes(length.try_into().expect("eight bytes follow the opcode"));
            let limit = left - RECORD_HEAD;
            if length > limit {
                let path = self.path.into();
                return Err(Fault::Skip(McapError::Length { path, place, what: record_name(opcode), length, limit }));
            }
            let start = at + RECORD_HEAD as usize;
            at = start + length as usize;
            let body = records.slice(start..at);
            match opcode {
                op::SCHEMA | op::CHANNEL => self.describe(place, opcode, &body)?,
                op::MESSAGE => {
                    if let Some(found) = self.message(place, &body)? {
                        self.found.push(found);
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// The records of a chunk, unpacked and checked.
    fn unpack(&self, place: Place, body: Vec<u8>) -> Result<Bytes, Fault> {
        let skip = self.skip(place, "chunk");
        let mut fields = Fields::new(&body);
        fields.take(16).map_err(&skip)?;
        let n_unpacked = fields.u64().map_err(&skip)?;
        let stored_crc = fields.u32().map_err(&skip)?;
        let compression = fields.text().map_err(&skip)?;
        let n_packed = fields.u64().map_err(&skip)?;
        if n_unpacked > MAX_CHUNK_BYTES {
            let (what, limit) = ("the unpacked chunk", MAX_CHUNK_BYTES);
            return Err(Fault::Skip(McapError::Length {
                path: self.path.into(),
                place,
                what,
                length: n_unpacked,
                limit,
            }));
        }
        let start = fields.at;
        let n_packed = fields.take(n_packed).map_err(&skip)?.len();
        let packed = Bytes::from(body).slice(start..start + n_packed);
        let cannot = |reason: String| {
            Fault::Skip(McapError::Compression {
                path: self.path.into(),
                place,
                compression: compression.clone(),
                reason,
            })
        };
        let records = match compression.as_str() {
            "" => packed,
            "zstd" => {
                let decoder = zstd::stream::read::Decoder::with_buffer(&*packed);
                decoder.and_then(|d| read_at_most(d, n_unpacked)).map_err(|e| cannot(e.to_string()))?
            }
            "lz4" => {
                let decoder = lz4::Decoder::new(&*packed);
                decoder.and_then(|d| read_at_most(d, n_unpacked)).map_err(|e| cannot(e.to_string()))?
            }
            _ => return Err(cannot("its name is not known".into())),
        };
        if records.len() as u64 != n_unpacked {
            let more = if records.len() as u64 > n_unpacked { "more than" } else { "fewer than" };
            return Err(cannot(format!("it holds {more} the {n_unpacked} bytes it claims")));
        }
        self.check_crc(place, "a chunk", stored_crc, crc32fast::hash(&records))?;
        Ok(records)
    }

    /// Sorts the messages by topic, now that all channels are known.
    fn finish(mut self) -> Result<Recording, McapError> {
        let mut n_unknown = 0;
        for found in std::mem::take(&mut self.found) {
            let Some(channel) = self.channels.get(&found.channel_id) else {
                let (path, place, channel) = (self.path.into(), found.place, found.channel_id);
                if !self.allow_truncated {
                    return Err(McapError::UnknownChannel { path, place, channel });
                }
                n_unknown += 1;
                continue;
            };
            if !(self.keep)(&channel.topic) {
                continue;
            }
            let message = Message {
                log_time_ns: stamp(found.log_time),
                publish_time_ns: stamp(found.publish_time),
                sequence: found.sequence,
                schema_name: self.schemas.get(&channel.schema_id).map_or_else(|| "".into(), |s| s.name.clone()),
                message_encoding: channel.message_encoding.clone(),
                data: found.data,
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
            let channel = &self.channels[id];
            let schema = self.schemas.get(&channel.schema_id);
            let topic = Topic {
                name: channel.topic.clone(),
                schema_name: schema.map_or(String::new(), |s| s.name.to_string()),
                schema_encoding: schema.map_or(String::new(), |s| s.encoding.to_string()),
                message_encoding: channel.message_encoding.to_string(),
                n_messages: self.n_found.get(id).copied().unwrap_or(0),
            };
            let same = self.recording.topics.iter_mut().find(|t| {
                (&t.name, &t.schema_name, &t.message_encoding)
                    == (&topic.name, &topic.schema_name, &topic.message_encoding)
            });
            match same {
                Some(known) => known.n_messages += topic.n_messages,
                None => self.recording.topics.push(topic),
            }
        }
        Ok(self.recording)
    }
}

/// What a note says of a fault that was passed over: the error without its advice.
fn left_out(error: &McapError) -> String {
    let said = error.to_string();
    let said = said.split("; set allow_truncated").next().unwrap_or_default();
    said.split("; copy the file again").next().unwrap_or_default().to_owned()
}

/// Unpacks no more than one byte beyond `limit`, growing as bytes arrive, so that a false size costs nothing.
fn read_at_most(reader: impl Read, limit: u64) -> io::Result<Bytes> {
    let mut bytes = Vec::with_capacity(limit.min(1 << 22) as usize);
    reader.take(limit + 1).read_to_end(&mut bytes)?;
    Ok(bytes.into())
}

fn stamp(time: u64) -> StampNs {
    StampNs::try_from(time).unwrap_or(StampNs::MAX)
}

fn record_name(opcode: u8) -> &'static str {
    match opcode {
        op::HEADER => "header",
        op::FOOTER => "footer",
        op::SCHEMA => "schema",
        op::CHANNEL => "channel",
        op::MESSAGE => "message",
        op::CHUNK => "chunk",
        op::MESSAGE_INDEX => "message index",
        op::CHUNK_INDEX => "chunk index",
        op::ATTACHMENT => "attachment",
        op::ATTACHMENT_INDEX => "attachment index",
        op::STATISTICS => "statistics",
        op::METADATA => "metadata",
        op::METADATA_INDEX => "metadata index",
        op::SUMMARY_OFFSET => "summary offset",
        op::DATA_END => "data end",
        _ => "record of an unknown kind",
    }
}
