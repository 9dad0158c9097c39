//! An MCAP file that grows by whole chunks: what ends the process leaves every chunk that was finished.
//!
//! A chunk's rows stay where the payloads have them until the chunk is written, in one call, behind a header that is
//! known by then; nothing in the file is ever gone back to. The `mcap` crate's writer copies each message into one slice,
//! sums it twice and writes a header that holds only once the chunk is finished; it reads what is written here.

use crc32fast::Hasher;
use osteoflow_node::Buffer;
use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, IoSlice, Write},
};

/// Chunks of this size compress well and lose little where a file is cut short.
const CHUNK_BYTES: usize = 1 << 20;
/// Longer rows are written from where they lie; shorter ones are cheaper copied.
const LONG_ROWS: usize = 4 << 10;
/// Measured coordinates hardly compress; more effort buys time lost and no space.
const ZSTD_LEVEL: i32 = 1;

/// How chunks are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Compression {
    /// As they are: the least time.
    None,
    /// LZ4: little time, little gain.
    Lz4,
    /// Zstandard at its first level: the smallest files.
    #[default]
    Zstd,
}

impl Compression {
    /// Every way, in the order of effort.
    pub const ALL: [Self; 3] = [Self::None, Self::Lz4, Self::Zstd];

    /// Its name in a graph file.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }

    /// The way of that name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|way| way.name() == name)
    }

    /// Its name in a chunk.
    fn in_chunk(self) -> &'static str {
        match self {
            Self::None => "",
            packed => packed.name(),
        }
    }
}

/// The bytes of a message: short ones of its own, and rows that a payload shares.
#[derive(Default)]
pub(crate) struct Parts {
    parts: Vec<Part>,
    tail: Vec<u8>,
    n_bytes: usize,
}

enum Part {
    Own(Vec<u8>),
    Rows(Buffer),
}

impl Part {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Own(bytes) => bytes,
            Self::Rows(rows) => (**rows).as_ref(),
        }
    }
}

impl Parts {
    /// How many bytes it has.
    pub(crate) fn len(&self) -> usize {
        self.n_bytes + self.tail.len()
    }

    /// Where bytes of its own are added.
    pub(crate) fn tail(&mut self) -> &mut Vec<u8> {
        &mut self.tail
    }

    /// Adds rows without copying them, unless they are few.
    pub(crate) fn rows(&mut self, rows: &Buffer) {
        let bytes: &[u8] = (**rows).as_ref();
        if bytes.len() < LONG_ROWS {
            self.tail.extend_from_slice(bytes);
        } else {
            self.end_tail();
            self.n_bytes += bytes.len();
            self.parts.push(Part::Rows(rows.clone()));
        }
    }

    /// Adds bytes that need not be kept elsewhere.
    pub(crate) fn bytes(&mut self, bytes: Vec<u8>) {
        if bytes.len() < LONG_ROWS {
            self.tail.extend_from_slice(&bytes);
        } else {
            self.end_tail();
            self.n_bytes += bytes.len();
            self.parts.push(Part::Own(bytes));
        }
    }

    /// All in one piece.
    pub(crate) fn concat(self) -> Vec<u8> {
        if self.parts.is_empty() {
            return self.tail;
        }
        let mut all = Vec::with_capacity(self.len());
        self.slices().for_each(|slice| all.extend_from_slice(slice));
        all
    }

    /// All in the pieces in which they lie.
    pub(crate) fn slices(&self) -> impl Iterator<Item = &[u8]> {
        self.parts.iter().map(Part::bytes).chain([&*self.tail]).filter(|slice| !slice.is_empty())
    }

    fn end_tail(&mut self) {
        if !self.tail.is_empty() {
            self.n_bytes += self.tail.len();
            self.parts.push(Part::Own(std::mem::take(&mut self.tail)));
        }
    }

    fn append(&mut self, other: Self) {
        for part in other.parts {
            match part {
                Part::Own(bytes) => self.bytes(bytes),
                Part::Rows(rows) => self.rows(&rows),
            }
        }
        self.tail.extend_from_slice(&other.tail);
    }
}

/// What stands before a message's bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MessageHead {
    pub(crate) channel: u16,
    pub(crate) sequence: u32,
    pub(crate) time_ns: u64,
}

/// The first and the last time of messages.
type Span = Option<(u64, u64)>;

fn extend(span: Span, time_ns: u64) -> Span {
    Some(span.map_or((time_ns, time_ns), |(first, last)| (first.min(time_ns), last.max(time_ns))))
}

#[derive(Default)]
struct Chunk {
    bytes: Parts,
    span: Span,
    /// For each channel, each message's time and its place in the chunk.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
}

/// The file, and what its summary will say.
pub(crate) struct McapFile {
    file: File,
    compression: Compression,
    /// How long the file is.
    offset: u64,
    /// Of everything before the summary.
    sum: Hasher,
    chunk: Chunk,
    /// Records that the summary repeats.
    schemas: Vec<Vec<u8>>,
    channels: Vec<Vec<u8>>,
    chunk_indexes: Vec<Vec<u8>>,
    metadata_indexes: Vec<Vec<u8>>,
    n_messages: BTreeMap<u16, u64>,
    span: Span,
}

const HEADER: u8 = 0x01;
const FOOTER: u8 = 0x02;
const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const CHUNK: u8 = 0x06;
const MESSAGE_INDEX: u8 = 0x07;
const CHUNK_INDEX: u8 = 0x08;
const STATISTICS: u8 = 0x0b;
const METADATA: u8 = 0x0c;
const METADATA_INDEX: u8 = 0x0d;
const SUMMARY_OFFSET: u8 = 0x0e;
const DATA_END: u8 = 0x0f;

impl McapFile {
    /// Begins the file.
    pub(crate) fn begin(file: File, library: &str, compression: Compression) -> io::Result<Self> {
        let mut this = Self {
            file,
            compression,
            offset: 0,
            sum: Hasher::new(),
            chunk: Chunk::default(),
            schemas: Vec::new(),
            channels: Vec::new(),
            chunk_indexes: Vec::new(),
            metadata_indexes: Vec::new(),
            n_messages: BTreeMap::new(),
            span: None,
        };
        let mut bytes = mcap::MAGIC.to_vec();
        bytes.extend(record(HEADER, |r| {
            text(r, "osteoflow");
            text(r, library);
        }));
        this.write(&bytes)?;
        Ok(this)
    }

    /// Adds a schema, or finds it where it has been added before.
    pub(crate) fn schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> io::Result<u16> {
        let of = |id: u16| {
            record(SCHEMA, |r| {
                number(r, id.to_le_bytes());
                text(r, name);
                text(r, encoding);
                number(r, (data.len() as u32).to_le_bytes());
                r.extend_from_slice(data);
            })
        };
        // A record begins with nine bytes of its own and the number.
        let same = |known: &Vec<u8>| known[11..] == of(0)[11..];
        let place = self.schemas.iter().position(same).unwrap_or(self.schemas.len());
        let id = id(place, "schemas")?;
        if place == self.schemas.len() {
            self.schemas.push(of(id));
            self.chunk.bytes.tail().extend(&self.schemas[place]);
        }
        Ok(id)
    }

    /// Adds a channel.
    pub(crate) fn channel(
        &mut self,
        schema: u16,
        topic: &str,
        encoding: &str,
        about: &BTreeMap<String, String>,
    ) -> io::Result<u16> {
        let id = id(self.channels.len(), "channels")?;
        let channel = record(CHANNEL, |r| {
            number(r, id.to_le_bytes());
            number(r, schema.to_le_bytes());
            text(r, topic);
            text(r, encoding);
            texts(r, about);
        });
        self.chunk.bytes.tail().extend(&channel);
        self.channels.push(channel);
        Ok(id)
    }

    /// Adds a message; a chunk that is long enough by then is written.
    pub(crate) fn message(&mut self, head: MessageHead, message: Parts) -> io::Result<()> {
        let MessageHead { channel, sequence, time_ns } = head;
        let at = self.chunk.bytes.len() as u64;
        self.chunk.index.entry(channel).or_default().push((time_ns, at));
        self.chunk.span = extend(self.chunk.span, time_ns);
        *self.n_messages.entry(channel).or_default() += 1;
        let tail = self.chunk.bytes.tail();
        tail.push(MESSAGE);
        number(tail, (22 + message.len() as u64).to_le_bytes());
        number(tail, channel.to_le_bytes());
        number(tail, sequence.to_le_bytes());
        number(tail, time_ns.to_le_bytes());
        number(tail, time_ns.to_le_bytes());
        self.chunk.bytes.append(message);
        if self.chunk.bytes.len() >= CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Adds named texts; before them the chunk is finished.
    pub(crate) fn metadata(&mut self, name: &str, entries: &BTreeMap<String, String>) -> io::Result<()> {
        self.flush()?;
        let bytes = record(METADATA, |r| {
            text(r, name);
            texts(r, entries);
        });
        self.metadata_indexes.push(record(METADATA_INDEX, |r| {
            number(r, self.offset.to_le_bytes());
            number(r, (bytes.len() as u64).to_le_bytes());
            text(r, name);
        }));
        self.write(&bytes)
    }

    /// Whether something waits for its chunk to be finished.
    pub(crate) fn waits(&self) -> bool {
        self.chunk.bytes.len() > 0
    }

    /// Writes what waits as a chunk.
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        if !self.waits() {
            return Ok(());
        }
        let Chunk { mut bytes, span, index } = std::mem::take(&mut self.chunk);
        bytes.end_tail();
        let n_plain = bytes.len();
        let mut sum = Hasher::new();
        bytes.slices().for_each(|slice| sum.update(slice));
        let plain_sum = sum.clone().finalize();
        let packed = pack(self.compression, &bytes)?;
        let n_packed = packed.as_ref().map_or(n_plain, Vec::len);
        let (first, last) = span.unwrap_or((0, 0));
        let way = self.compression.in_chunk();

        let mut head = vec![CHUNK];
        number(&mut head, ((8 + 8 + 8 + 4 + 4 + way.len() + 8 + n_packed) as u64).to_le_bytes());
        number(&mut head, first.to_le_bytes());
        number(&mut head, last.to_le_bytes());
        number(&mut head, (n_plain as u64).to_le_bytes());
        number(&mut head, plain_sum.to_le_bytes());
        text(&mut head, way);
        number(&mut head, (n_packed as u64).to_le_bytes());

        let n_chunk = (head.len() + n_packed) as u64;
        let (mut tail, mut places) = (Vec::new(), Vec::new());
        for (channel, messages) in &index {
            number(&mut places, channel.to_le_bytes());
            number(&mut places, (self.offset + n_chunk + tail.len() as u64).to_le_bytes());
            tail.extend(record(MESSAGE_INDEX, |r| {
                number(r, channel.to_le_bytes());
                number(r, (16 * messages.len() as u32).to_le_bytes());
                for (time_ns, at) in messages {
                    number(r, time_ns.to_le_bytes());
                    number(r, at.to_le_bytes());
                }
            }));
        }
        let chunk_index = record(CHUNK_INDEX, |r| {
            number(r, first.to_le_bytes());
            number(r, last.to_le_bytes());
            number(r, self.offset.to_le_bytes());
            number(r, n_chunk.to_le_bytes());
            number(r, (places.len() as u32).to_le_bytes());
            r.extend_from_slice(&places);
            number(r, (tail.len() as u64).to_le_bytes());
            text(r, way);
            number(r, (n_packed as u64).to_le_bytes());
            number(r, (n_plain as u64).to_le_bytes());
        });

        let mut slices = vec![IoSlice::new(&head)];
        match &packed {
            Some(packed) => slices.push(IoSlice::new(packed)),
            None => slices.extend(bytes.slices().map(IoSlice::new)),
        }
        slices.push(IoSlice::new(&tail));
        write_all(&mut self.file, &mut slices).inspect_err(|_| cut(&self.file, self.offset))?;

        self.offset += n_chunk + tail.len() as u64;
        self.sum.update(&head);
        match &packed {
            Some(packed) => self.sum.update(packed),
            None => self.sum.combine(&sum),
        }
        self.sum.update(&tail);
        self.chunk_indexes.push(chunk_index);
        self.span = [Some(first), Some(last)].into_iter().flatten().filter(|_| span.is_some()).fold(self.span, extend);
        Ok(())
    }

    /// Ends the file with its summary.
    pub(crate) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        let data_end = record(DATA_END, |r| number(r, self.sum.clone().finalize().to_le_bytes()));
        let start = self.offset + data_end.len() as u64;
        let (first, last) = self.span.unwrap_or((0, 0));
        let statistics = record(STATISTICS, |r| {
            number(r, self.n_messages.values().sum::<u64>().to_le_bytes());
            number(r, (self.schemas.len() as u16).to_le_bytes());
            number(r, (self.channels.len() as u32).to_le_bytes());
            number(r, 0u32.to_le_bytes());
            number(r, (self.metadata_indexes.len() as u32).to_le_bytes());
            number(r, (self.chunk_indexes.len() as u32).to_le_bytes());
            number(r, first.to_le_bytes());
            number(r, last.to_le_bytes());
            number(r, (10 * self.n_messages.len() as u32).to_le_bytes());
            for (channel, n) in &self.n_messages {
                number(r, channel.to_le_bytes());
                number(r, n.to_le_bytes());
            }
        });
        let (mut summary, mut offsets) = (Vec::new(), Vec::new());
        let groups = [
            (SCHEMA, self.schemas.concat()),
            (CHANNEL, self.channels.concat()),
            (STATISTICS, statistics),
            (CHUNK_INDEX, self.chunk_indexes.concat()),
            (METADATA_INDEX, self.metadata_indexes.concat()),
        ];
        for (group, records) in groups.iter().filter(|(_, records)| !records.is_empty()) {
            offsets.extend(record(SUMMARY_OFFSET, |r| {
                r.push(*group);
                number(r, (start + summary.len() as u64).to_le_bytes());
                number(r, (records.len() as u64).to_le_bytes());
            }));
            summary.extend_from_slice(records);
        }
        let offsets_start = start + summary.len() as u64;
        summary.extend(offsets);
        let mut footer = record(FOOTER, |r| {
            number(r, start.to_le_bytes());
            number(r, offsets_start.to_le_bytes());
            number(r, 0u32.to_le_bytes());
        });
        let place_of_sum = footer.len() - 4;
        let mut sum = Hasher::new();
        sum.update(&summary);
        sum.update(&footer[..place_of_sum]);
        footer[place_of_sum..].copy_from_slice(&sum.finalize().to_le_bytes());
        self.write(&[data_end, summary, footer, mcap::MAGIC.to_vec()].concat())
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes).inspect_err(|_| cut(&self.file, self.offset))?;
        self.offset += bytes.len() as u64;
        self.sum.update(bytes);
        Ok(())
    }
}

/// Takes away what was written of a record that found no room, so that the file ends with its last whole one.
fn cut(file: &File, len: u64) {
    // Where that fails too, readers stop at the record that is not whole.
    let _ = file.set_len(len);
}

fn write_all(file: &mut File, mut slices: &mut [IoSlice<'_>]) -> io::Result<()> {
    IoSlice::advance_slices(&mut slices, 0);
    while !slices.is_empty() {
        match file.write_vectored(slices) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(n) => IoSlice::advance_slices(&mut slices, n),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// The packed bytes of a chunk, where it is to be packed.
fn pack(compression: Compression, bytes: &Parts) -> io::Result<Option<Vec<u8>>> {
    let out = Vec::with_capacity(bytes.len() / 2);
    match compression {
        Compression::None => Ok(None),
        Compression::Zstd => {
            let mut encoder = zstd::stream::write::Encoder::new(out, ZSTD_LEVEL)?;
            bytes.slices().try_for_each(|slice| encoder.write_all(slice))?;
            encoder.finish().map(Some)
        }
        Compression::Lz4 => {
            // The chunk has a sum of its own, and some readers get that of blocks wrong.
            let checksum = lz4::liblz4::BlockChecksum::NoBlockChecksum;
            let mut encoder = lz4::EncoderBuilder::new().block_checksum(checksum).build(out)?;
            bytes.slices().try_for_each(|slice| encoder.write_all(slice))?;
            let (packed, ended) = encoder.finish();
            ended.map(|()| Some(packed))
        }
    }
}

fn id(place: usize, what: &str) -> io::Result<u16> {
    let too_many = || io::Error::other(format!("an MCAP file holds at most {} {what}", u16::MAX));
    u16::try_from(place + 1).map_err(|_| too_many())
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

fn texts(out: &mut Vec<u8>, entries: &BTreeMap<String, String>) {
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
    use std::sync::Arc;

    fn head(channel: u16, sequence: u32, time_ns: u64) -> MessageHead {
        MessageHead { channel, sequence, time_ns }
    }

    fn parts(bytes: Vec<u8>) -> Parts {
        let mut parts = Parts::default();
        parts.tail().extend(&bytes[..bytes.len() / 2]);
        parts.rows(&(Arc::new(bytes[bytes.len() / 2..].to_vec()) as Buffer));
        parts
    }

    fn message(i: u32) -> Vec<u8> {
        (0..i * 9_000).map(|k| (k.wrapping_mul(k + i) >> 7) as u8).collect()
    }

    /// Two channels, several chunks, metadata before and after.
    fn written(compression: Compression, path: &std::path::Path) {
        let file = File::create(path).unwrap();
        let mut mcap = McapFile::begin(file, "test", compression).unwrap();
        let about = BTreeMap::from([("k".to_owned(), "v".to_owned())]);
        mcap.metadata("first", &about).unwrap();
        let schema = mcap.schema("s", "e", b"data").unwrap();
        assert_eq!(mcap.schema("s", "e", b"data").unwrap(), schema, "a schema is written once");
        let channels = ["/a", "/b"].map(|topic| mcap.channel(schema, topic, "raw", &about).unwrap());
        for i in 0..40 {
            mcap.message(head(channels[i as usize % 2], i, 1_000 + u64::from(i)), parts(message(i))).unwrap();
        }
        mcap.metadata("last", &BTreeMap::new()).unwrap();
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
                Ok(LinearReadEvent::Record { opcode, .. }) => n_messages += usize::from(opcode == MESSAGE),
                Err(_) => return Err(n_messages),
            }
        }
        Ok(n_messages)
    }

    #[test]
    fn what_is_flushed_is_in_the_file_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let mut mcap = McapFile::begin(File::create(&path).unwrap(), "test", Compression::Zstd).unwrap();
        let channel = mcap.channel(0, "/a", "raw", &BTreeMap::new()).unwrap();
        mcap.message(head(channel, 0, 5), parts(message(1))).unwrap();
        let before = std::fs::metadata(&path).unwrap().len();
        mcap.flush().unwrap();
        assert!(std::fs::metadata(&path).unwrap().len() > before);
        std::mem::forget(mcap);
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(linear(&bytes), Err(1), "the message is there, the end is not");
    }

    #[test]
    fn a_full_disk_is_an_error_and_not_a_panic() {
        let Ok(full) = File::options().write(true).open("/dev/full") else { return };
        let error = McapFile::begin(full, "test", Compression::None).err().expect("nothing fits there");
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
}
