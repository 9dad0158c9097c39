//! Writes a file in whole chunks, each in one call, and never seeks: a process that is killed leaves every chunk that was
//! finished.
//!
//! Long buffers of a message are written from where they are. The writer of the `mcap` crate copies each message into one
//! slice, computes its CRC twice, and goes back to the header of a finished chunk.

use crate::{Attachment, Compression, MAGIC, MAX_RECORD_BYTES, MESSAGE_HEADER_BYTES, Segments, op};
use crc32fast::Hasher;
use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, IoSlice, Write},
};

/// Measured coordinates hardly compress; a higher level costs time and gains nothing.
const ZSTD_LEVEL: i32 = 1;

/// Layout of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WriteOptions {
    /// How channels and metadata are used; empty for no profile.
    pub profile: String,
    /// Name of the writing program.
    pub library: String,
    /// Compression of chunks.
    pub compression: Compression,
    /// Size at which a chunk is written: large enough to compress well, small enough to lose little when a file is cut
    /// short.
    pub chunk_bytes: usize,
    /// Whether messages are written in chunks, which alone are compressed and have a CRC.
    pub chunks: bool,
    /// Whether chunks are followed by message indexes, and the file ends with a summary.
    pub index: bool,
}

impl Default for WriteOptions {
    /// Chunks of 1 MiB, compressed by [`Compression::Zstd`], with index.
    fn default() -> Self {
        Self {
            profile: String::new(),
            library: String::new(),
            compression: Compression::default(),
            chunk_bytes: 1 << 20,
            chunks: true,
            index: true,
        }
    }
}

/// Header of a message to be written.
#[derive(Debug, Clone, Copy)]
pub struct MessageHeader {
    /// Channel, as [`Writer::add_channel`] returned it.
    pub channel_id: u16,
    /// Count of the sender.
    pub sequence: u32,
    /// Time at which the message is recorded, ns.
    pub log_time: u64,
    /// Time at which the message was sent, ns.
    pub publish_time: u64,
}

/// Destination of a file.
pub trait Sink: Write {
    /// Shortens the file to `n_bytes`.
    ///
    /// # Errors
    /// If the system reports one.
    fn truncate(&mut self, n_bytes: u64) -> io::Result<()>;
}

impl Sink for File {
    fn truncate(&mut self, n_bytes: u64) -> io::Result<()> {
        self.set_len(n_bytes)
    }
}

impl Sink for Vec<u8> {
    fn truncate(&mut self, n_bytes: u64) -> io::Result<()> {
        Self::truncate(self, n_bytes as usize);
        Ok(())
    }
}

/// First and last log time of messages.
type Span = Option<(u64, u64)>;

fn extend(span: Span, time: u64) -> Span {
    Some(span.map_or((time, time), |(first, last)| (first.min(time), last.max(time))))
}

/// Records that are not written yet.
#[derive(Default)]
struct Pending {
    bytes: Segments,
    span: Span,
    /// Log time and offset of each message, by channel.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
}

/// Writer of an MCAP file.
pub struct Writer<W> {
    sink: W,
    options: WriteOptions,
    /// Bytes written.
    offset: u64,
    /// CRC of the bytes written.
    crc: Hasher,
    pending: Pending,
    /// Records that the summary repeats.
    schemas: Vec<Vec<u8>>,
    channels: Vec<Vec<u8>>,
    chunk_indexes: Vec<Vec<u8>>,
    attachment_indexes: Vec<Vec<u8>>,
    metadata_indexes: Vec<Vec<u8>>,
    n_messages: BTreeMap<u16, u64>,
    span: Span,
}

impl<W: Sink> Writer<W> {
    /// Writes the header of a file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(sink: W, options: WriteOptions) -> io::Result<Self> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(record(op::HEADER, |r| {
            text(r, &options.profile);
            text(r, &options.library);
        }));
        let mut writer = Self {
            sink,
            options,
            offset: 0,
            crc: Hasher::new(),
            pending: Pending::default(),
            schemas: Vec::new(),
            channels: Vec::new(),
            chunk_indexes: Vec::new(),
            attachment_indexes: Vec::new(),
            metadata_indexes: Vec::new(),
            n_messages: BTreeMap::new(),
            span: None,
        };
        writer.write(&[&bytes])?;
        Ok(writer)
    }

    /// Adds a schema and returns its identifier; an equal schema is written once.
    ///
    /// # Errors
    /// If there are too many schemas, or it is too long.
    pub fn add_schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> io::Result<u16> {
        let schema = |id: u16| {
            record(op::SCHEMA, |r| {
                number(r, id.to_le_bytes());
                text(r, name);
                text(r, encoding);
                number(r, (data.len() as u32).to_le_bytes());
                r.extend_from_slice(data);
            })
        };
        // The identifier follows the opcode and the length.
        let same = |known: &Vec<u8>| known[11..] == schema(0)[11..];
        if let Some(known) = self.schemas.iter().position(same) {
            return next_id(known, "schemas");
        }
        let id = next_id(self.schemas.len(), "schemas")?;
        let schema = schema(id);
        check_length("schema", schema.len())?;
        self.pending.bytes.tail().extend(&schema);
        self.schemas.push(schema);
        Ok(id)
    }

    /// Adds a channel and returns its identifier. `schema_id` is 0 for messages without a schema.
    ///
    /// # Errors
    /// If there are too many channels, it is too long, or the schema was not added.
    pub fn add_channel(
        &mut self,
        schema_id: u16,
        topic: &str,
        message_encoding: &str,
        metadata: &BTreeMap<String, String>,
    ) -> io::Result<u16> {
        if usize::from(schema_id) > self.schemas.len() {
            return Err(invalid(format!("channel \"{topic}\" names schema {schema_id}, which was not added")));
        }
        let id = next_id(self.channels.len(), "channels")?;
        let channel = record(op::CHANNEL, |r| {
            number(r, id.to_le_bytes());
            number(r, schema_id.to_le_bytes());
            text(r, topic);
            text(r, message_encoding);
            map(r, metadata);
        });
        check_length("channel", channel.len())?;
        self.pending.bytes.tail().extend(&channel);
        self.channels.push(channel);
        Ok(id)
    }

    /// Adds a message, and writes the chunk when it is large enough.
    ///
    /// # Errors
    /// If the channel was not added, the message is too long, or the chunk cannot be written.
    pub fn write_message(&mut self, header: MessageHeader, data: Segments) -> io::Result<()> {
        let MessageHeader { channel_id, sequence, log_time, publish_time } = header;
        if channel_id == 0 || usize::from(channel_id) > self.channels.len() {
            return Err(invalid(format!("a message of channel {channel_id}, which was not added")));
        }
        let n_record = MESSAGE_HEADER_BYTES as usize + data.len();
        check_length("message", n_record)?;
        if (self.pending.bytes.len() + n_record) as u64 > MAX_RECORD_BYTES {
            self.flush()?;
        }
        let at = self.pending.bytes.len() as u64;
        self.pending.index.entry(channel_id).or_default().push((log_time, at));
        self.pending.span = extend(self.pending.span, log_time);
        *self.n_messages.entry(channel_id).or_default() += 1;
        let tail = self.pending.bytes.tail();
        tail.push(op::MESSAGE);
        number(tail, (22 + data.len() as u64).to_le_bytes());
        number(tail, channel_id.to_le_bytes());
        number(tail, sequence.to_le_bytes());
        number(tail, log_time.to_le_bytes());
        number(tail, publish_time.to_le_bytes());
        self.pending.bytes.append(data);
        if self.pending.bytes.len() >= self.options.chunk_bytes { self.flush() } else { Ok(()) }
    }

    /// Writes a metadata record after the pending chunk.
    ///
    /// # Errors
    /// If it is too long or cannot be written.
    pub fn write_metadata(&mut self, name: &str, entries: &BTreeMap<String, String>) -> io::Result<()> {
        self.flush()?;
        let bytes = record(op::METADATA, |r| {
            text(r, name);
            map(r, entries);
        });
        check_length("metadata record", bytes.len())?;
        self.metadata_indexes.push(record(op::METADATA_INDEX, |r| {
            number(r, self.offset.to_le_bytes());
            number(r, (bytes.len() as u64).to_le_bytes());
            text(r, name);
        }));
        self.write(&[&bytes])
    }

    /// Writes an attachment after the pending chunk.
    ///
    /// # Errors
    /// If it is too long or cannot be written.
    pub fn write_attachment(&mut self, attachment: &Attachment<'_>) -> io::Result<()> {
        self.flush()?;
        let Attachment { log_time, create_time, name, media_type, data } = *attachment;
        let mut head = record(op::ATTACHMENT, |r| {
            number(r, log_time.to_le_bytes());
            number(r, create_time.to_le_bytes());
            text(r, name);
            text(r, media_type);
            number(r, (data.len() as u64).to_le_bytes());
        });
        let n_bytes = head.len() + data.len() + 4;
        check_length("attachment", n_bytes)?;
        head[1..9].copy_from_slice(&(n_bytes as u64 - 9).to_le_bytes());
        let mut crc = Hasher::new();
        crc.update(&head[9..]);
        crc.update(data);
        self.attachment_indexes.push(record(op::ATTACHMENT_INDEX, |r| {
            number(r, self.offset.to_le_bytes());
            number(r, (n_bytes as u64).to_le_bytes());
            number(r, log_time.to_le_bytes());
            number(r, create_time.to_le_bytes());
            number(r, (data.len() as u64).to_le_bytes());
            text(r, name);
            text(r, media_type);
        }));
        self.write(&[&head, data, &crc.finalize().to_le_bytes()])
    }

    /// Whether records wait for their chunk to be written.
    pub fn has_pending(&self) -> bool {
        !self.pending.bytes.is_empty()
    }

    /// Writes the pending records as a chunk.
    ///
    /// # Errors
    /// If the chunk cannot be written; the file then ends before it.
    pub fn flush(&mut self) -> io::Result<()> {
        if !self.has_pending() {
            return Ok(());
        }
        let pending = std::mem::take(&mut self.pending);
        if let Some((first, last)) = pending.span {
            self.span = extend(extend(self.span, first), last);
        }
        if self.options.chunks {
            return self.write_chunk(pending);
        }
        self.write(&pending.bytes.slices().collect::<Vec<_>>())
    }

    fn write_chunk(&mut self, pending: Pending) -> io::Result<()> {
        let Pending { mut bytes, span, index } = pending;
        bytes.end_tail();
        let n_unpacked = bytes.len();
        let mut unpacked_crc = Hasher::new();
        bytes.slices().for_each(|slice| unpacked_crc.update(slice));
        let packed = pack(self.options.compression, &bytes)?;
        let n_packed = packed.as_ref().map_or(n_unpacked, Vec::len);
        let (first, last) = span.unwrap_or((0, 0));
        let compression = self.options.compression.name_in_chunk();

        let mut head = record(op::CHUNK, |r| {
            number(r, first.to_le_bytes());
            number(r, last.to_le_bytes());
            number(r, (n_unpacked as u64).to_le_bytes());
            number(r, unpacked_crc.clone().finalize().to_le_bytes());
            text(r, compression);
            number(r, (n_packed as u64).to_le_bytes());
        });
        let n_chunk = (head.len() + n_packed) as u64;
        head[1..9].copy_from_slice(&(n_chunk - 9).to_le_bytes());

        let (mut indexes, mut offsets) = (Vec::new(), Vec::new());
        for (channel_id, messages) in index.iter().filter(|_| self.options.index) {
            number(&mut offsets, channel_id.to_le_bytes());
            number(&mut offsets, (self.offset + n_chunk + indexes.len() as u64).to_le_bytes());
            indexes.extend(record(op::MESSAGE_INDEX, |r| {
                number(r, channel_id.to_le_bytes());
                number(r, (16 * messages.len() as u32).to_le_bytes());
                for (log_time, at) in messages {
                    number(r, log_time.to_le_bytes());
                    number(r, at.to_le_bytes());
                }
            }));
        }
        self.chunk_indexes.push(record(op::CHUNK_INDEX, |r| {
            number(r, first.to_le_bytes());
            number(r, last.to_le_bytes());
            number(r, self.offset.to_le_bytes());
            number(r, n_chunk.to_le_bytes());
            number(r, (offsets.len() as u32).to_le_bytes());
            r.extend_from_slice(&offsets);
            number(r, (indexes.len() as u64).to_le_bytes());
            text(r, compression);
            number(r, (n_packed as u64).to_le_bytes());
            number(r, (n_unpacked as u64).to_le_bytes());
        }));

        let mut slices = vec![IoSlice::new(&head)];
        match &packed {
            Some(packed) => slices.push(IoSlice::new(packed)),
            None => slices.extend(bytes.slices().map(IoSlice::new)),
        }
        slices.push(IoSlice::new(&indexes));
        self.write_slices(&mut slices)?;

        self.offset += n_chunk + indexes.len() as u64;
        self.crc.update(&head);
        match &packed {
            Some(packed) => self.crc.update(packed),
            None => self.crc.combine(&unpacked_crc),
        }
        self.crc.update(&indexes);
        Ok(())
    }

    /// Writes the pending chunk and the end of the file.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        self.flush()?;
        let data_end = record(op::DATA_END, |r| number(r, self.crc.clone().finalize().to_le_bytes()));
        let start = self.offset + data_end.len() as u64;
        let (summary, offsets_start) = if self.options.index { self.summary(start) } else { (Vec::new(), 0) };
        let mut footer = record(op::FOOTER, |r| {
            number(r, (if summary.is_empty() { 0 } else { start }).to_le_bytes());
            number(r, offsets_start.to_le_bytes());
            number(r, 0u32.to_le_bytes());
        });
        let at_crc = footer.len() - 4;
        let mut crc = Hasher::new();
        crc.update(&summary);
        crc.update(&footer[..at_crc]);
        footer[at_crc..].copy_from_slice(&crc.finalize().to_le_bytes());
        self.write(&[&data_end, &summary, &footer, MAGIC])?;
        Ok(self.sink)
    }

    /// The summary at offset `start`, and the offset of its summary offsets.
    fn summary(&self, start: u64) -> (Vec<u8>, u64) {
        let (first, last) = self.span.unwrap_or((0, 0));
        let statistics = record(op::STATISTICS, |r| {
            number(r, self.n_messages.values().sum::<u64>().to_le_bytes());
            number(r, (self.schemas.len() as u16).to_le_bytes());
            number(r, (self.channels.len() as u32).to_le_bytes());
            number(r, (self.attachment_indexes.len() as u32).to_le_bytes());
            number(r, (self.metadata_indexes.len() as u32).to_le_bytes());
            number(r, (self.chunk_indexes.len() as u32).to_le_bytes());
            number(r, first.to_le_bytes());
            number(r, last.to_le_bytes());
            number(r, (10 * self.n_messages.len() as u32).to_le_bytes());
            for (channel_id, n) in &self.n_messages {
                number(r, channel_id.to_le_bytes());
                number(r, n.to_le_bytes());
            }
        });
        let groups = [
            (op::SCHEMA, self.schemas.concat()),
            (op::CHANNEL, self.channels.concat()),
            (op::STATISTICS, statistics),
            (op::CHUNK_INDEX, self.chunk_indexes.concat()),
            (op::ATTACHMENT_INDEX, self.attachment_indexes.concat()),
            (op::METADATA_INDEX, self.metadata_indexes.concat()),
        ];
        let (mut summary, mut offsets) = (Vec::new(), Vec::new());
        for (opcode, records) in groups.iter().filter(|(_, records)| !records.is_empty()) {
            offsets.extend(record(op::SUMMARY_OFFSET, |r| {
                r.push(*opcode);
                number(r, (start + summary.len() as u64).to_le_bytes());
                number(r, (records.len() as u64).to_le_bytes());
            }));
            summary.extend_from_slice(records);
        }
        let offsets_start = start + summary.len() as u64;
        summary.extend(offsets);
        (summary, offsets_start)
    }

    fn write(&mut self, bytes: &[&[u8]]) -> io::Result<()> {
        self.write_slices(&mut bytes.iter().map(|bytes| IoSlice::new(bytes)).collect::<Vec<_>>())?;
        for bytes in bytes {
            self.offset += bytes.len() as u64;
            self.crc.update(bytes);
        }
        Ok(())
    }

    fn write_slices(&mut self, slices: &mut [IoSlice<'_>]) -> io::Result<()> {
        let written = write_all(&mut self.sink, slices);
        written.inspect_err(|_| {
            // The file ends with its last whole record. If that fails as well, readers stop at the unfinished one.
            let _ = self.sink.truncate(self.offset);
        })
    }
}

fn write_all(sink: &mut impl Write, mut slices: &mut [IoSlice<'_>]) -> io::Result<()> {
    // Skips empty slices.
    IoSlice::advance_slices(&mut slices, 0);
    while !slices.is_empty() {
        match sink.write_vectored(slices) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(n) => IoSlice::advance_slices(&mut slices, n),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Packs the records of a chunk; `None` without compression.
fn pack(compression: Compression, bytes: &Segments) -> io::Result<Option<Vec<u8>>> {
    let out = Vec::with_capacity(bytes.len() / 2);
    match compression {
        Compression::None => Ok(None),
        Compression::Zstd => {
            let mut encoder = zstd::stream::write::Encoder::new(out, ZSTD_LEVEL)?;
            bytes.slices().try_for_each(|slice| encoder.write_all(slice))?;
            encoder.finish().map(Some)
        }
        Compression::Lz4 => {
            // The chunk has a CRC, and some readers compute the checksums of blocks wrongly.
            let checksum = lz4::liblz4::BlockChecksum::NoBlockChecksum;
            let mut encoder = lz4::EncoderBuilder::new().block_checksum(checksum).build(out)?;
            bytes.slices().try_for_each(|slice| encoder.write_all(slice))?;
            let (packed, ended) = encoder.finish();
            ended.map(|()| Some(packed))
        }
    }
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, message)
}

/// Refuses a record that no reader of ours takes.
fn check_length(what: &str, n_bytes: usize) -> io::Result<()> {
    if n_bytes as u64 <= MAX_RECORD_BYTES {
        return Ok(());
    }
    Err(invalid(format!("a {what} of {n_bytes} bytes; at most {MAX_RECORD_BYTES} are written")))
}

fn next_id(index: usize, what: &str) -> io::Result<u16> {
    let too_many = || io::Error::other(format!("an MCAP file holds at most {} {what}", u16::MAX));
    u16::try_from(index + 1).map_err(|_| too_many())
}

fn record(op: u8, fill: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = vec![op, 0, 0, 0, 0, 0, 0, 0, 0];
    fill(&mut bytes);
    let n_bytes = (bytes.len() - 9) as u64;
    bytes[1..9].copy_from_slice(&n_bytes.to_le_bytes());
    bytes
}

fn number<const N: usize>(out: &mut Vec<u8>, bytes: [u8; N]) {
    out.extend_from_slice(&bytes);
}

fn text(out: &mut Vec<u8>, text: &str) {
    number(out, (text.len() as u32).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
}

fn map(out: &mut Vec<u8>, entries: &BTreeMap<String, String>) {
    let n_bytes: usize = entries.iter().map(|(key, value)| 8 + key.len() + value.len()).sum();
    number(out, (n_bytes as u32).to_le_bytes());
    for (key, value) in entries {
        text(out, key);
        text(out, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SharedBytes;
    use std::sync::Arc;

    fn header(channel_id: u16, sequence: u32, log_time: u64) -> MessageHeader {
        MessageHeader { channel_id, sequence, log_time, publish_time: log_time }
    }

    fn options(compression: Compression) -> WriteOptions {
        WriteOptions { compression, ..WriteOptions::default() }
    }

    fn parts(bytes: Vec<u8>) -> Segments {
        let mut parts = Segments::default();
        parts.tail().extend(&bytes[..bytes.len() / 2]);
        parts.push_shared(&(Arc::new(bytes[bytes.len() / 2..].to_vec()) as SharedBytes));
        parts
    }

    fn message(i: u32) -> Vec<u8> {
        (0..i * 9_000).map(|k| (k.wrapping_mul(k + i) >> 7) as u8).collect()
    }

    /// Two channels, several chunks, metadata before and after.
    fn written(compression: Compression, path: &std::path::Path) {
        let file = File::create(path).unwrap();
        let mut mcap = Writer::new(file, options(compression)).unwrap();
        let about = BTreeMap::from([("k".to_owned(), "v".to_owned())]);
        mcap.write_metadata("first", &about).unwrap();
        let schema = mcap.add_schema("s", "e", b"data").unwrap();
        assert_eq!(mcap.add_schema("s", "e", b"data").unwrap(), schema, "a schema is written once");
        let channels = ["/a", "/b"].map(|topic| mcap.add_channel(schema, topic, "raw", &about).unwrap());
        for i in 0..40 {
            mcap.write_message(header(channels[i as usize % 2], i, 1_000 + u64::from(i)), parts(message(i))).unwrap();
        }
        mcap.write_metadata("last", &BTreeMap::new()).unwrap();
        mcap.finish().unwrap();
    }

    #[test]
    fn other_readers_find_messages_sums_indexes_and_summary_in_order() {
        for compression in Compression::ALL {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("a.mcap");
            written(compression, &path);
            let bytes = std::fs::read(&path).unwrap();
            for (i, found) in mcap::MessageStream::new(&bytes).unwrap().enumerate() {
                let found = found.unwrap();
                assert_eq!((found.sequence, found.log_time), (i as u32, 1_000 + i as u64), "{compression:?}");
                assert!(*found.data == message(i as u32), "{compression:?}: message {i}");
                assert_eq!(found.channel.topic, ["/a", "/b"][i % 2]);
            }
            let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
            let stats = summary.stats.as_ref().unwrap();
            assert_eq!((stats.message_count, stats.channel_count, stats.schema_count), (40, 2, 1));
            assert_eq!((stats.message_start_time, stats.message_end_time), (1_000, 1_039));
            assert_eq!(summary.metadata_indexes.len(), 2);
            assert!(summary.chunk_indexes.len() > 3, "{} chunks", summary.chunk_indexes.len());
            let streamed: usize = summary
                .chunk_indexes
                .iter()
                .map(|chunk| {
                    assert_eq!(
                        summary.read_message_indexes(&bytes, chunk).unwrap().len(),
                        chunk.message_index_offsets.len()
                    );
                    summary.stream_chunk(&bytes, chunk).unwrap().map(Result::unwrap).count()
                })
                .sum();
            assert_eq!(streamed, 40, "{compression:?}: the indexes lead to every message");
            assert_eq!(linear(&bytes), Ok(40), "{compression:?}: every sum holds");
        }
    }

    /// How many messages a reader finds from the start to the end, every sum checked; or how many before the end is missed.
    fn linear(bytes: &[u8]) -> Result<usize, usize> {
        use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
        let options = LinearReaderOptions::default()
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_prevalidate_chunk_crcs(true);
        let mut reader = LinearReader::new_with_options(options);
        let (mut at, mut n_messages) = (0, 0);
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(n)) => {
                    let n = n.min(bytes.len() - at);
                    reader.insert(n).copy_from_slice(&bytes[at..at + n]);
                    reader.notify_read(n);
                    at += n;
                }
                Ok(LinearReadEvent::Record { opcode, .. }) => n_messages += usize::from(opcode == op::MESSAGE),
                Err(_) => return Err(n_messages),
            }
        }
        Ok(n_messages)
    }

    #[test]
    fn what_is_flushed_is_in_the_file_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let mut mcap = Writer::new(File::create(&path).unwrap(), options(Compression::Zstd)).unwrap();
        let channel = mcap.add_channel(0, "/a", "raw", &BTreeMap::new()).unwrap();
        mcap.write_message(header(channel, 0, 5), parts(message(1))).unwrap();
        let before = std::fs::metadata(&path).unwrap().len();
        mcap.flush().unwrap();
        assert!(std::fs::metadata(&path).unwrap().len() > before);
        std::mem::forget(mcap);
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(linear(&bytes), Err(1), "the message is there, the end is not");
    }

    #[test]
    fn identifiers_end_at_the_largest_and_records_at_the_longest() {
        assert_eq!((next_id(0, "schemas").unwrap(), next_id(65_534, "schemas").unwrap()), (1, 65_535));
        let message = next_id(65_535, "schemas").unwrap_err().to_string();
        assert_eq!(message, "an MCAP file holds at most 65535 schemas");
        assert!(check_length("schema", MAX_RECORD_BYTES as usize).is_ok());
        let message = check_length("schema", MAX_RECORD_BYTES as usize + 1).unwrap_err().to_string();
        assert_eq!(message, "a schema of 1073741825 bytes; at most 1073741824 are written");
    }

    #[test]
    fn a_full_disk_is_an_error_and_not_a_panic() {
        let Ok(full) = File::options().write(true).open("/dev/full") else { return };
        let error = Writer::new(full, options(Compression::None)).err().expect("nothing fits there");
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
}
