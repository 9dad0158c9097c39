//! Writes a file in whole chunks and never seeks: a process that is killed leaves every chunk that was finished.
//!
//! The `mcap` crate makes the records. What it writes is appended record by record, and an unfinished file gets no footer.

use crate::{Attachment, Compression, MAX_RECORD_BYTES, MESSAGE_HEADER_BYTES, Segments};
use mcap::{
    McapError,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};
use std::{
    borrow::Cow,
    collections::BTreeMap,
    fs::File,
    io::{self, Write},
};

/// Measured coordinates hardly compress; a higher level costs time and gains nothing.
const COMPRESSION_LEVEL: u32 = 1;

/// Longer slices are written from where they are.
const DIRECT_BYTES: usize = 64 << 10;

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

/// Appends to a sink, and shortens it to its last whole record when a write fails.
struct Appender<W> {
    sink: W,
    /// Bytes that are not written yet.
    buffer: Vec<u8>,
    /// Bytes written.
    n_bytes: u64,
    /// Bytes of whole records among them.
    n_whole: u64,
    has_failed: bool,
}

impl<W: Sink> Appender<W> {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.has_failed {
            return Err(io::Error::other("an earlier write to the file has failed"));
        }
        let written = self.sink.write_all(&self.buffer).and_then(|()| self.sink.write_all(bytes));
        self.n_bytes += (self.buffer.len() + bytes.len()) as u64;
        self.buffer.clear();
        written.inspect_err(|_| {
            self.has_failed = true;
            // If that fails as well, readers stop at the unfinished record.
            let _ = self.sink.truncate(self.n_whole);
        })
    }
}

impl<W: Sink> Write for Appender<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if bytes.len() < DIRECT_BYTES {
            self.buffer.extend_from_slice(bytes);
        } else {
            self.append(bytes)?;
        }
        Ok(bytes.len())
    }

    /// Called behind a whole record.
    fn flush(&mut self) -> io::Result<()> {
        self.append(&[])?;
        self.n_whole = self.n_bytes;
        Ok(())
    }
}

/// Writer of an MCAP file. If it is dropped unfinished, the file ends with its last whole record.
pub struct Writer<W: Sink> {
    /// `None` once the file is finished.
    mcap: Option<mcap::Writer<NoSeek<Appender<W>>>>,
    chunk_bytes: usize,
    last_schema: u16,
    last_channel: u16,
    /// Bytes of the records that wait for their chunk to be written.
    n_pending: usize,
    /// Whether a message is among them.
    has_message: bool,
}

impl<W: Sink> Writer<W> {
    /// Writes the header of a file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(sink: W, options: WriteOptions) -> io::Result<Self> {
        let appender = Appender { sink, buffer: Vec::new(), n_bytes: 0, n_whole: 0, has_failed: false };
        let compression = match options.compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        };
        let mcap = mcap::WriteOptions::new()
            .profile(options.profile)
            .library(options.library)
            .compression(compression)
            .compression_level(COMPRESSION_LEVEL)
            .compression_threads(0)
            .use_chunks(options.chunks)
            .chunk_size(None)
            .disable_seeking(true)
            .emit_message_indexes(options.index)
            .emit_summary_records(options.index)
            .emit_summary_offsets(options.index)
            .create(NoSeek::new(appender))
            .map_err(io_error)?;
        let chunk_bytes = options.chunk_bytes;
        let mut writer =
            Self { mcap: Some(mcap), chunk_bytes, last_schema: 0, last_channel: 0, n_pending: 0, has_message: false };
        writer.mcap().flush().map_err(io_error)?;
        Ok(writer)
    }

    fn mcap(&mut self) -> &mut mcap::Writer<NoSeek<Appender<W>>> {
        self.mcap.as_mut().expect("only `finish` and `drop` take it")
    }

    /// Adds a schema and returns its identifier; an equal schema is written once.
    ///
    /// # Errors
    /// If there are too many schemas, or it is too long.
    pub fn add_schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> io::Result<u16> {
        let n_bytes = checked_length("schema", 23 + name.len() + encoding.len() + data.len())?;
        next_id(self.last_schema, "schemas")?;
        let id = self.mcap().add_schema(name, encoding, data).map_err(io_error)?;
        self.last_schema = self.last_schema.max(id);
        self.n_pending += n_bytes;
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
        let n_bytes = 25 + topic.len() + message_encoding.len() + n_bytes_of(metadata);
        let n_bytes = checked_length("channel", n_bytes)?;
        let id = next_id(self.last_channel, "channels")?;
        let added = self.mcap().add_channel_with_id(id, schema_id, topic, message_encoding, metadata);
        self.last_channel = added.map_err(io_error)?;
        self.n_pending += n_bytes;
        Ok(id)
    }

    /// Adds a message, and writes the chunk when it is large enough.
    ///
    /// # Errors
    /// If the channel was not added, the message is too long, or the chunk cannot be written.
    pub fn write_message(&mut self, header: MessageHeader, data: Segments) -> io::Result<()> {
        let n_bytes = checked_length("message", MESSAGE_HEADER_BYTES as usize + data.len())?;
        if (self.n_pending + n_bytes) as u64 > MAX_RECORD_BYTES {
            self.flush()?;
        }
        self.mcap().write_to_known_channel(&header, &data.contiguous()).map_err(io_error)?;
        self.n_pending += n_bytes;
        self.has_message = true;
        if self.n_pending >= self.chunk_bytes { self.flush() } else { Ok(()) }
    }

    /// Writes a metadata record after the pending chunk.
    ///
    /// # Errors
    /// If it is too long or cannot be written.
    pub fn write_metadata(&mut self, name: &str, entries: &BTreeMap<String, String>) -> io::Result<()> {
        self.flush()?;
        checked_length("metadata record", 17 + name.len() + n_bytes_of(entries))?;
        let metadata = Metadata { name: name.into(), metadata: entries.clone() };
        self.mcap().write_metadata(&metadata).and_then(|()| self.mcap().flush()).map_err(io_error)
    }

    /// Writes an attachment after the pending chunk.
    ///
    /// # Errors
    /// If it is too long or cannot be written.
    pub fn write_attachment(&mut self, attachment: &Attachment<'_>) -> io::Result<()> {
        self.flush()?;
        let Attachment { log_time, create_time, name, media_type, data } = *attachment;
        checked_length("attachment", 45 + name.len() + media_type.len() + data.len())?;
        let (name, media_type) = (name.into(), media_type.into());
        let attachment = mcap::Attachment { log_time, create_time, name, media_type, data: Cow::Borrowed(data) };
        self.mcap().attach(&attachment).and_then(|()| self.mcap().flush()).map_err(io_error)
    }

    /// Whether records wait for their chunk to be written.
    pub fn has_pending(&self) -> bool {
        self.n_pending > 0
    }

    /// Writes the pending records as a chunk, if a message is among them: a chunk without one has the time 0, from which viewers
    /// would begin.
    ///
    /// # Errors
    /// If the chunk cannot be written; the file then ends before it.
    pub fn flush(&mut self) -> io::Result<()> {
        if !std::mem::take(&mut self.has_message) {
            return Ok(());
        }
        self.n_pending = 0;
        self.mcap().flush().map_err(io_error)
    }

    /// Writes the pending chunk and the end of the file.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        self.mcap().finish().map_err(io_error)?;
        let mcap = self.mcap.take().expect("it was finished just now");
        Ok(mcap.into_inner().into_inner().sink)
    }
}

impl<W: Sink> Drop for Writer<W> {
    fn drop(&mut self) {
        // Dropped by itself, it would end the file as if it were whole.
        drop(self.mcap.take().map(mcap::Writer::into_inner));
    }
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::new(io::ErrorKind::InvalidInput, error),
    }
}

/// The length of a record, unless no reader of ours takes it.
fn checked_length(what: &str, n_bytes: usize) -> io::Result<usize> {
    if n_bytes as u64 <= MAX_RECORD_BYTES {
        return Ok(n_bytes);
    }
    let message = format!("a {what} of {n_bytes} bytes; at most {MAX_RECORD_BYTES} are written");
    Err(io::Error::new(io::ErrorKind::InvalidInput, message))
}

/// The identifier after `last`. The largest one is left out: the `mcap` crate counts beyond it.
fn next_id(last: u16, what: &str) -> io::Result<u16> {
    let too_many = || io::Error::other(format!("at most {} {what} are written to an MCAP file", u16::MAX - 1));
    if last < u16::MAX - 1 { Ok(last + 1) } else { Err(too_many()) }
}

fn n_bytes_of(entries: &BTreeMap<String, String>) -> usize {
    entries.iter().map(|(key, value)| 8 + key.len() + value.len()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SharedBytes, op};
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
        assert_eq!((next_id(0, "schemas").unwrap(), next_id(65_533, "schemas").unwrap()), (1, 65_534));
        let message = next_id(65_534, "schemas").unwrap_err().to_string();
        assert_eq!(message, "at most 65534 schemas are written to an MCAP file");
        assert!(checked_length("schema", MAX_RECORD_BYTES as usize).is_ok());
        let message = checked_length("schema", MAX_RECORD_BYTES as usize + 1).unwrap_err().to_string();
        assert_eq!(message, "a schema of 1073741825 bytes; at most 1073741824 are written");
    }

    #[test]
    fn a_full_disk_is_an_error_and_not_a_panic() {
        let Ok(full) = File::options().write(true).open("/dev/full") else { return };
        let error = Writer::new(full, options(Compression::None)).err().expect("nothing fits there");
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
}
