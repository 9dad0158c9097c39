//! Reads a file from its magic to its end, past damage.

mod summary;

use crate::{
    Cause, Channel, Damage, End, MAGIC, MAX_RECORD_BYTES, chunk,
    descriptions::Descriptions,
    input::Input,
    op,
    record::{self, ChunkHeader, RECORD_HEAD, Record},
    resync,
};
use crc32fast::Hasher;
use std::{
    fmt,
    fs::File,
    io::{self, Read, Seek},
    ops::{ControlFlow, Range},
    path::Path,
};
use summary::{Summary, Unknown};

/// Longest header of a chunk; a longer one names no known compression.
const MAX_CHUNK_HEADER: u64 = 64;
const N_MAGIC: u64 = MAGIC.len() as u64;

/// Location of a record in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Location {
    /// Offset in the file of the record, or of the chunk that holds it.
    pub offset: u64,
    /// Offset in the unpacked chunk, for a record in a chunk.
    pub in_chunk: Option<u64>,
}

impl Location {
    fn at(offset: u64) -> Self {
        Self { offset, in_chunk: None }
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.in_chunk {
            None => write!(f, "byte {}", self.offset),
            Some(at) => write!(f, "byte {at} of the unpacked chunk at byte {}", self.offset),
        }
    }
}

/// Bytes read so far, and bytes in total.
pub type Progress<'a> = &'a mut dyn FnMut(u64, u64);

/// Receives the records of a file in file order.
pub trait Visitor {
    /// Visits an intact record. The records of a chunk follow its header, and only if all of them are intact.
    ///
    /// A channel or schema that only the summary describes, because of damage, is visited before its first use, with its
    /// location in the summary.
    fn record(&mut self, location: Location, record: Record<'_>) -> ControlFlow<()>;

    /// Visits bytes that are lost; reading resumes after them.
    fn damage(&mut self, damage: Damage) -> ControlFlow<()>;

    /// Called after the last record of a chunk with the buffer that its messages borrow from, which may be taken: their
    /// data begin [`MESSAGE_HEADER_BYTES`](crate::MESSAGE_HEADER_BYTES) behind [`Location::in_chunk`].
    fn chunk_end(&mut self, _records: &mut Vec<u8>) {}

    /// Reports progress in bytes of the file.
    fn progress(&mut self, _at: u64, _of: u64) {}
}

/// A file that cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The system reports an error.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file has no bytes.
    #[error("it is empty; was the program stopped before anything was written?")]
    Empty,
    /// The file does not begin as an MCAP file.
    #[error("{}", if MAGIC.starts_with(.start) { "it was cut short in its first bytes" } else { "it is no MCAP file" })]
    NotMcap {
        /// Its first bytes.
        start: Vec<u8>,
    },
}

/// Reader of an MCAP file. Memory: a chunk packed and unpacked, or one record, whatever the file claims.
pub struct Reader<R> {
    input: Input<R>,
    /// Current record with its head, or the unpacked records of the current chunk.
    records: Vec<u8>,
    packed: Vec<u8>,
    described: Descriptions,
    summary: Summary,
    /// Whether messages have been outside of chunks so far.
    is_unchunked: bool,
    has_chunks: bool,
    section_crc: Option<SectionCrc>,
}

/// CRC of the bytes of a section up to an offset.
#[derive(Default)]
struct SectionCrc {
    crc: Hasher,
    start: u64,
    end: u64,
}

impl SectionCrc {
    /// Calls `add` to add the bytes at `bytes`, after those before them that are missing, such as damaged ones.
    ///
    /// Does nothing for bytes before [`end`](Self::end), such as the record that ended the previous section.
    fn add<R: Read + Seek>(
        &mut self,
        input: &mut Input<R>,
        bytes: Range<u64>,
        add: impl FnOnce(&mut Hasher),
    ) -> io::Result<()> {
        if self.end <= bytes.start {
            self.add_up_to(input, bytes.start)?;
            add(&mut self.crc);
            self.end = bytes.end;
        }
        Ok(())
    }

    /// Reads and adds the missing bytes before `end`.
    fn add_up_to<R: Read + Seek>(&mut self, input: &mut Input<R>, end: u64) -> io::Result<()> {
        if self.end < end {
            input.hash(self.end, end, &mut self.crc)?;
            self.end = end;
        }
        Ok(())
    }
}

/// Outcome of one record.
enum Step {
    Next(u64),
    /// The footer, with the end of the closing magic.
    End(u64),
    /// Damage, with the offset at which the next record should begin, if the lengths can be believed.
    Damaged(Cause, Option<u64>),
    Stopped,
}

impl Reader<File> {
    /// Opens a file.
    ///
    /// # Errors
    /// If the file cannot be opened, or is no regular file.
    pub fn open(path: &Path) -> io::Result<Self> {
        // Before it is opened, because opening a pipe waits for its writer.
        let metadata = std::fs::metadata(path)?;
        if !metadata.is_file() {
            return Err(io::Error::other("it is no regular file; a recording is read from a file"));
        }
        Ok(Self::new(File::open(path)?, metadata.len()))
    }
}

impl<R: Read + Seek> Reader<R> {
    /// Reads from `reader`, which stands at its start and holds `n_bytes`.
    pub fn new(reader: R, n_bytes: u64) -> Self {
        Self {
            input: Input::new(reader, n_bytes),
            records: Vec::new(),
            packed: Vec::new(),
            described: Descriptions::default(),
            summary: Summary::default(),
            is_unchunked: false,
            has_chunks: false,
            section_crc: None,
        }
    }

    /// Computes the CRCs of the data and the summary as well, for [`Record::DataEnd`] and [`Record::Footer`].
    #[must_use]
    pub fn with_section_crcs(mut self) -> Self {
        self.section_crc = Some(SectionCrc::default());
        self
    }

    /// Length of the file.
    pub fn n_bytes(&self) -> u64 {
        self.input.n_bytes()
    }

    /// Visits every record, from the first to the last.
    ///
    /// # Errors
    /// [`ReadError`] if the file is no MCAP file or the system reports an error; damage is not an error.
    pub fn read(&mut self, visitor: &mut impl Visitor) -> Result<End, ReadError> {
        if let Some(damage) = self.start_magic()?
            && visitor.damage(damage).is_break()
        {
            return Ok(End::Stopped);
        }
        self.summary = self.index_summary()?;
        let n_bytes = self.n_bytes();
        let mut at = N_MAGIC;
        loop {
            visitor.progress(at, n_bytes);
            let (cause, next) = match self.step(at, visitor)? {
                Step::Next(next) => {
                    at = next;
                    continue;
                }
                Step::End(end) => return Ok(End::Complete { trailing: n_bytes - end }),
                Step::Stopped => return Ok(End::Stopped),
                Step::Damaged(cause, next) => (cause, next),
            };
            let next = match next {
                Some(next) if self.begins_record(next)? => Some(next),
                _ => self.resync(at)?,
            };
            let Some(next) = next else {
                return Ok(End::Truncated(Damage { bytes: at..n_bytes, cause: self.truncated(at, cause) }));
            };
            if visitor.damage(Damage { bytes: at..next, cause }).is_break() {
                return Ok(End::Stopped);
            }
            at = next;
        }
    }

    /// A record that ends beyond the file is the last one of a truncated file, unless its length is absurd.
    fn truncated(&self, at: u64, cause: Cause) -> Cause {
        match cause {
            Cause::Length { what, length, limit }
                if at + RECORD_HEAD + limit == self.n_bytes() && length <= 2 * MAX_RECORD_BYTES.max(self.n_bytes()) =>
            {
                Cause::Truncated { what, needed: length, available: limit }
            }
            other => other,
        }
    }

    fn resync(&mut self, at: u64) -> io::Result<Option<u64>> {
        let is_chunk = at < self.n_bytes() && self.input.array::<1>(at)?[0] == op::CHUNK;
        let (described, summary) = (&self.described, &self.summary);
        let has_channel = |id: u16| described.has_channel(id) || summary.channels.contains_key(&id);
        // Inside a damaged chunk nothing confirms a message.
        let loose = self.is_unchunked && !self.has_chunks && !is_chunk;
        resync::next_record(&mut self.input, at + 1, loose.then_some(&has_channel))
    }

    /// Checks the magic; a damaged one that a header follows is a damage.
    fn start_magic(&mut self) -> Result<Option<Damage>, ReadError> {
        let start = self.input.read(0, self.n_bytes().min(N_MAGIC))?;
        if start == MAGIC {
            return Ok(None);
        }
        if start.is_empty() {
            return Err(ReadError::Empty);
        }
        if self.n_bytes() > N_MAGIC + RECORD_HEAD {
            let (opcode, length) = self.input.head(N_MAGIC)?;
            let fits = length < u64::from(u16::MAX).min(self.n_bytes() - N_MAGIC - RECORD_HEAD);
            if opcode == op::HEADER && fits {
                let header = self.input.read(N_MAGIC + RECORD_HEAD, length)?;
                if record::parse(opcode, &header).is_ok() {
                    return Ok(Some(Damage { bytes: 0..N_MAGIC, cause: Cause::Magic { start } }));
                }
            }
        }
        Err(ReadError::NotMcap { start })
    }

    /// Whether a record that fits into the file, or its end, is at this offset.
    fn begins_record(&mut self, at: u64) -> io::Result<bool> {
        if at + RECORD_HEAD > self.n_bytes() {
            return Ok(at == self.n_bytes());
        }
        let (opcode, length) = self.input.head(at)?;
        Ok((op::HEADER..=op::DATA_END).contains(&opcode) && length <= self.n_bytes() - at - RECORD_HEAD)
    }

    fn step(&mut self, at: u64, visitor: &mut impl Visitor) -> Result<Step, ReadError> {
        let left = self.n_bytes() - at;
        if left < RECORD_HEAD {
            let cause = match left {
                0 => Cause::NoFooter,
                _ => Cause::Truncated { what: "the head of a record", needed: RECORD_HEAD, available: left },
            };
            return Ok(Step::Damaged(cause, None));
        }
        let (opcode, length) = self.input.head(at)?;
        let (what, limit) = (op::name(opcode), left - RECORD_HEAD);
        if opcode == 0 {
            return Ok(Step::Damaged(Cause::malformed(what)("no record has opcode 0".into()), None));
        }
        if length > limit {
            return Ok(Step::Damaged(Cause::Length { what, length, limit }, None));
        }
        if opcode == op::CHUNK {
            return self.chunk(at, length, visitor);
        }
        let next = at + RECORD_HEAD + length;
        if length > MAX_RECORD_BYTES {
            return Ok(Step::Damaged(Cause::Length { what, length, limit: MAX_RECORD_BYTES }, Some(next)));
        }
        let mut bytes = std::mem::take(&mut self.records);
        self.input.read_into(at, RECORD_HEAD + length, &mut bytes)?;
        let step = self.record(at, &bytes, visitor);
        self.records = bytes;
        step
    }

    /// Visits a record outside of chunks; `bytes` are its head and content.
    fn record(&mut self, at: u64, bytes: &[u8], visitor: &mut impl Visitor) -> Result<Step, ReadError> {
        let next = at + bytes.len() as u64;
        let (opcode, content) = (bytes[0], &bytes[RECORD_HEAD as usize..]);
        let parsed = record::parse(opcode, content).and_then(|record| {
            self.described.check(&record)?;
            Ok(record)
        });
        let mut record = match parsed {
            Ok(record) => record,
            Err(cause) => return Ok(Step::Damaged(cause, Some(next))),
        };
        let malformed = |reason: String| Ok(Step::Damaged(Cause::malformed(op::name(opcode))(reason), None));
        let mut unknown = Unknown::default();
        match &mut record {
            // Nothing else confirms the length of a message outside of chunks.
            Record::Message(message) => {
                if !resync::is_plausible(&mut self.input, next)? {
                    return malformed(format!("no record follows its {} bytes", content.len()));
                }
                self.is_unchunked = true;
                if !self.described.has_channel(message.channel_id) {
                    unknown.channels.insert(message.channel_id);
                }
            }
            Record::Channel(channel) => {
                self.is_unchunked = true;
                if !self.described.has_schema(channel.schema_id) {
                    unknown.schemas.insert(channel.schema_id);
                }
            }
            // An opcode of no version of the format is damaged, unless the next record confirms it.
            Record::Other if opcode > op::DATA_END && !self.begins_record(next)? => {
                return malformed(format!("no record has opcode {opcode}"));
            }
            Record::DataEnd { crc, computed } if *crc != 0 => *computed = self.end_section(at, next)?,
            Record::DataEnd { .. } => drop(self.end_section(next, next)?),
            Record::Footer { summary_start, crc, computed } => {
                let closes = next + N_MAGIC <= self.n_bytes() && self.input.array(next)? == *MAGIC;
                if !closes {
                    return malformed("the closing magic does not follow it".into());
                }
                let starts =
                    *summary_start == 0 || self.section_crc.as_ref().is_some_and(|s| s.start == *summary_start);
                if *crc != 0 && starts {
                    // The CRC covers the footer up to itself.
                    *computed = self.end_section(next - 4, next)?;
                }
            }
            _ => {}
        }
        if !unknown.is_empty() && self.describe_from_summary(&unknown, visitor)?.is_break() {
            return Ok(Step::Stopped);
        }
        if let Some(section) = &mut self.section_crc {
            section.add(&mut self.input, at..next, |crc| crc.update(bytes))?;
        }
        self.described.add(&record);
        let is_end = matches!(record, Record::Footer { .. });
        Ok(match visitor.record(Location::at(at), record) {
            ControlFlow::Break(()) => Step::Stopped,
            ControlFlow::Continue(()) if is_end => Step::End(next + N_MAGIC),
            ControlFlow::Continue(()) => Step::Next(next),
        })
    }

    /// The CRC of the current section up to `end`, if it is computed; the next section begins at `next`.
    fn end_section(&mut self, end: u64, next: u64) -> io::Result<Option<u32>> {
        let Some(mut section) = self.section_crc.take() else { return Ok(None) };
        self.section_crc = Some(SectionCrc { crc: Hasher::new(), start: next, end: next });
        section.add_up_to(&mut self.input, end)?;
        Ok(Some(section.crc.finalize()))
    }

    fn chunk(&mut self, at: u64, length: u64, visitor: &mut impl Visitor) -> Result<Step, ReadError> {
        let next = at + RECORD_HEAD + length;
        self.has_chunks = true;
        let mut records = std::mem::take(&mut self.records);
        let unpacked = self.unpack(at, length, &mut records)?;
        let checked = unpacked.and_then(|header| {
            let descriptions = check_records(&records, &self.described).map_err(|cause| (cause, Some(next)))?;
            Ok((header, descriptions))
        });
        let step = match checked {
            Err((cause, next)) => Step::Damaged(cause, next),
            Ok((header, ChunkDescriptions { described, unknown })) => {
                if !unknown.is_empty() && self.describe_from_summary(&unknown, visitor)?.is_break() {
                    return Ok(Step::Stopped);
                }
                self.described.append(described);
                match visit_chunk(Location::at(at), header, &records, visitor) {
                    ControlFlow::Break(()) => Step::Stopped,
                    ControlFlow::Continue(()) => {
                        visitor.chunk_end(&mut records);
                        Step::Next(next)
                    }
                }
            }
        };
        self.records = records;
        Ok(step)
    }

    /// Unpacks the chunk at `at` into `records`; or the cause of its damage, with the end of the chunk if its lengths agree.
    fn unpack(
        &mut self,
        at: u64,
        length: u64,
        records: &mut Vec<u8>,
    ) -> io::Result<Result<ChunkHeader, (Cause, Option<u64>)>> {
        let start = self.input.read(at + RECORD_HEAD, length.min(MAX_CHUNK_HEADER))?;
        let header = match record::chunk_header(&start, length) {
            Ok(header) => header,
            Err(cause) => return Ok(Err((cause, None))),
        };
        let damaged = |cause| Ok(Err((cause, Some(at + header.n_record))));
        if let Err(cause) = chunk::check_sizes(&header) {
            return damaged(cause);
        }
        let (start, n) = (at + header.n_head, header.n_packed);
        let is_packed = !header.compression.is_empty();
        let unpacked = if is_packed {
            self.input.read_into(start, n, &mut self.packed)?;
            chunk::unpack(&header, &self.packed, records)
        } else {
            self.input.read_into(start, n, records)?;
            Ok(())
        };
        let checked = unpacked
            .and_then(|()| chunk::check_unpacked(&header, records))
            .and_then(|()| chunk::check_crc(&header, records));
        let crc = match checked {
            Ok(crc) => crc,
            Err(cause) => return damaged(cause),
        };
        if let Some(section) = &mut self.section_crc {
            section.add(&mut self.input, start..start + n, |section| match is_packed {
                true => section.update(&self.packed),
                false => section.combine(&crc),
            })?;
        }
        Ok(Ok(header))
    }

    /// Unpacks the chunk at an offset at which [`read`](Self::read) has found one.
    ///
    /// # Errors
    /// If the file has changed since then.
    pub fn chunk_at(&mut self, at: u64) -> io::Result<Vec<u8>> {
        let (_, length) = self.input.head(at)?;
        let mut records = Vec::new();
        match self.unpack(at, length, &mut records)? {
            Ok(_) => Ok(records),
            Err((cause, _)) => Err(io::Error::other(format!("the chunk at byte {at} has changed: {cause}"))),
        }
    }

    /// Reads `n` bytes of a record that [`read`](Self::read) has found.
    ///
    /// # Errors
    /// If the file has changed since then.
    pub fn bytes_at(&mut self, at: u64, n: u64) -> io::Result<Vec<u8>> {
        if at.checked_add(n).is_none_or(|end| end > self.n_bytes()) {
            return Err(io::Error::other(format!("the file has changed: byte {at} is beyond its end")));
        }
        self.input.read(at, n)
    }
}

/// The records of an unpacked chunk: offset, opcode and content.
fn records(chunk: &[u8]) -> impl Iterator<Item = Result<(u64, u8, &[u8]), Cause>> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let (start, left) = (at, &chunk[at..]);
        if left.is_empty() {
            return None;
        }
        at = chunk.len();
        let Some((head, rest)) = left.split_at_checked(RECORD_HEAD as usize) else {
            let reason = format!("{} bytes remain at its end, too few for a record", left.len());
            return Some(Err(Cause::malformed("chunk")(reason)));
        };
        let length = u64::from_le_bytes(head[1..].try_into().expect("eight bytes follow the opcode"));
        let Some(content) = usize::try_from(length).ok().and_then(|n| rest.get(..n)) else {
            let reason =
                format!("a {} at its byte {start} claims {length} bytes, {} are left", op::name(head[0]), rest.len());
            return Some(Err(Cause::malformed("chunk")(reason)));
        };
        at = start + RECORD_HEAD as usize + content.len();
        Some(Ok((start as u64, head[0], content)))
    })
}

/// What the records of a chunk describe, and what they leave to the summary.
#[derive(Default)]
struct ChunkDescriptions {
    described: Descriptions,
    unknown: Unknown,
}

/// Checks all records of a chunk.
fn check_records(chunk: &[u8], known: &Descriptions) -> Result<ChunkDescriptions, Cause> {
    let mut of_chunk = ChunkDescriptions::default();
    for entry in records(chunk) {
        let (at, opcode, content) = entry?;
        let at_byte = |cause: Cause| Cause::malformed("chunk")(format!("at its byte {at}: {cause}"));
        let record = record::parse(opcode, content).map_err(at_byte)?;
        match &record {
            Record::Schema { .. } | Record::Channel(_) => {
                known.check(&record).and_then(|()| of_chunk.described.check(&record)).map_err(at_byte)?;
                of_chunk.described.add(&record);
                if let Record::Channel(Channel { schema_id: id, .. }) = record
                    && !known.has_schema(id)
                    && !of_chunk.described.has_schema(id)
                {
                    of_chunk.unknown.schemas.insert(id);
                }
            }
            Record::Message(message) => {
                let id = message.channel_id;
                if !known.has_channel(id) && !of_chunk.described.has_channel(id) {
                    of_chunk.unknown.channels.insert(id);
                }
            }
            Record::Other => {}
            _ => {
                let reason = format!("a {} at its byte {at} does not belong into a chunk", op::name(opcode));
                return Err(Cause::malformed("chunk")(reason));
            }
        }
    }
    Ok(of_chunk)
}

/// Compiled here, whatever the visitor: other crates are compiled for their size.
fn visit_chunk(location: Location, header: ChunkHeader, chunk: &[u8], visitor: &mut dyn Visitor) -> ControlFlow<()> {
    visitor.record(location, Record::Chunk(header))?;
    for (at, opcode, content) in records(chunk).filter_map(Result::ok) {
        if let Ok(record) = record::parse(opcode, content) {
            visitor.record(Location { in_chunk: Some(at), ..location }, record)?;
        }
    }
    ControlFlow::Continue(())
}
