//! Reads a file from its magic to its end, past damage.

use crate::{
    MAGIC, MAX_RECORD_BYTES,
    chunk::{Unpacking, unpack},
    op,
    record::{self, ChunkHeader, RECORD_HEAD, Record},
    resync,
};
use std::{
    fmt,
    fs::File,
    io::{self, BufRead, BufReader, Read, Seek, SeekFrom},
    ops::{ControlFlow, Range},
    path::Path,
};

/// Longest header of a chunk; a longer one names no known compression.
const MAX_CHUNK_HEAD: u64 = 64;

/// Location of a record in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Location {
    /// Offset in the file of the record, or of the chunk that holds it.
    pub offset: u64,
    /// Offset in the unpacked chunk, for a record in a chunk.
    pub in_chunk: Option<u64>,
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.in_chunk {
            None => write!(f, "byte {}", self.offset),
            Some(at) => write!(f, "byte {at} of the unpacked chunk at byte {}", self.offset),
        }
    }
}

/// Bytes of a file that could not be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// Offsets of the bytes that are lost.
    pub bytes: Range<u64>,
    /// The cause.
    pub what: String,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "bytes {} to {}: {}", self.bytes.start, self.bytes.end, self.what)
    }
}

/// End of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// The file ends with its footer and magic.
    Complete {
        /// Bytes after the closing magic.
        trailing: u64,
    },
    /// The file ends without footer and magic.
    Truncated(Damage),
    /// The visitor stopped.
    Stopped,
}

/// Bytes read so far, and bytes in total.
pub type Progress<'a> = &'a mut dyn FnMut(u64, u64);

/// Receives the records of a file in file order.
pub trait Visitor {
    /// Visits an intact record. The records of a chunk follow its header, and only if all of them are intact.
    fn record(&mut self, place: Location, record: Record<'_>) -> ControlFlow<()>;

    /// Visits bytes that are lost; reading resumes after them.
    fn damage(&mut self, damage: Damage) -> ControlFlow<()>;

    /// Reports progress in bytes of the file.
    fn progress(&mut self, _at: u64, _of: u64) {}
}

/// A file that cannot be read at all.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The system reports an error.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file does not begin as an MCAP file; the reason.
    #[error("{0}")]
    NotMcap(String),
}

/// Reader of an MCAP file. Memory: one record or unpacked chunk, whatever the file claims.
pub struct Reader<R> {
    reader: BufReader<R>,
    n_bytes: u64,
    body: Vec<u8>,
}

/// What became of one record.
enum Step {
    Next(u64),
    /// The footer with the closing magic was there.
    End(u64),
    /// Damaged; where the next record should begin, if the lengths can be believed.
    Damaged(String, Option<u64>),
    Stopped,
}

impl Reader<File> {
    /// Opens a file.
    ///
    /// # Errors
    /// If the file cannot be opened, or is no regular file.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let metadata = file.metadata()?;
        if !metadata.is_file() {
            return Err(io::Error::other("it is no regular file; a recording is read from a file"));
        }
        Ok(Self::new(file, metadata.len()))
    }
}

impl<R: Read + Seek> Reader<R> {
    /// Reads from `reader`, which holds `n_bytes`.
    pub fn new(reader: R, n_bytes: u64) -> Self {
        Self { reader: BufReader::with_capacity(1 << 16, reader), n_bytes, body: Vec::new() }
    }

    /// Length of the file.
    pub fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    /// Visits every record, from the first to the last.
    ///
    /// # Errors
    /// [`ReadError`] if the file is no MCAP file or the system reports an error; damage is not an error.
    pub fn read(&mut self, visit: &mut impl Visitor) -> Result<End, ReadError> {
        if let Some(damage) = self.start_magic()?
            && visit.damage(damage).is_break()
        {
            return Ok(End::Stopped);
        }
        let mut at = MAGIC.len() as u64;
        loop {
            visit.progress(at, self.n_bytes);
            match self.step(at, visit)? {
                Step::Next(next) => at = next,
                Step::End(end) => return Ok(End::Complete { trailing: self.n_bytes - end }),
                Step::Stopped => return Ok(End::Stopped),
                Step::Damaged(what, next) => {
                    let next = match next {
                        Some(next) if self.begins_record(next)? => Some(next),
                        _ => resync::next_record(&mut self.reader, at + 1, self.n_bytes)?,
                    };
                    let damage = Damage { bytes: at..next.unwrap_or(self.n_bytes), what };
                    match next {
                        Some(next) => {
                            if visit.damage(damage).is_break() {
                                return Ok(End::Stopped);
                            }
                            at = next;
                        }
                        None => return Ok(End::Truncated(damage)),
                    }
                }
            }
        }
    }

    /// Visits the schemas and channels that the summary repeats, if the file has one: a damaged chunk may be the only
    /// other place that describes a channel.
    ///
    /// # Errors
    /// [`ReadError::Io`].
    pub fn summary(&mut self, visit: &mut impl Visitor) -> Result<(), ReadError> {
        let n_tail = RECORD_HEAD + 20 + MAGIC.len() as u64;
        if self.n_bytes < n_tail + MAGIC.len() as u64 {
            return Ok(());
        }
        let tail = self.read_at(self.n_bytes - n_tail, n_tail)?;
        if tail[0] != op::FOOTER || tail[n_tail as usize - MAGIC.len()..] != *MAGIC {
            return Ok(());
        }
        let mut at = u64::from_le_bytes(tail[9..17].try_into().expect("eight bytes"));
        let end = self.n_bytes - n_tail;
        while at != 0 && at + RECORD_HEAD <= end {
            let (opcode, length) = self.head(at)?;
            let Some(next) = (at + RECORD_HEAD).checked_add(length).filter(|next| *next <= end) else { break };
            if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                let body = self.read_at(at + RECORD_HEAD, length)?;
                let Ok(record) = record::parse(opcode, &body) else { break };
                if visit.record(Location { offset: at, in_chunk: None }, record).is_break() {
                    break;
                }
            }
            at = next;
        }
        Ok(())
    }

    /// Looks for the magic; answers what is wrong with it where a header follows all the same.
    fn start_magic(&mut self) -> Result<Option<Damage>, ReadError> {
        let n_magic = MAGIC.len() as u64;
        let start = self.read_at(0, self.n_bytes.min(n_magic))?;
        let reason = match start.as_slice() {
            s if s == MAGIC => return Ok(None),
            [] => "it is empty; was the program stopped before anything was written",
            s if MAGIC.starts_with(s) => "it was cut short in its first bytes",
            _ => "it is no MCAP file",
        };
        if self.n_bytes > n_magic + RECORD_HEAD {
            let (opcode, length) = self.head(n_magic)?;
            let fits = length < u64::from(u16::MAX).min(self.n_bytes - n_magic - RECORD_HEAD);
            if opcode == op::HEADER && fits {
                let body = self.read_at(n_magic + RECORD_HEAD, length)?;
                if record::parse(opcode, &body).is_ok() {
                    return Ok(Some(Damage { bytes: 0..n_magic, what: "the magic of MCAP is damaged".into() }));
                }
            }
        }
        Err(ReadError::NotMcap(reason.into()))
    }

    fn seek(&mut self, to: u64) -> io::Result<()> {
        let here = self.reader.stream_position()?;
        // Keeps what is buffered where it can.
        match i64::try_from(i128::from(to) - i128::from(here)) {
            Ok(by) => self.reader.seek_relative(by),
            Err(_) => self.reader.seek(SeekFrom::Start(to)).map(drop),
        }
    }

    /// Reads `n` bytes that lie within the file.
    fn read_at(&mut self, at: u64, n: u64) -> io::Result<Vec<u8>> {
        self.seek(at)?;
        let mut bytes = vec![0; n as usize];
        self.reader.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    fn head(&mut self, at: u64) -> io::Result<(u8, u64)> {
        self.seek(at)?;
        let mut head = [0; RECORD_HEAD as usize];
        self.reader.read_exact(&mut head)?;
        Ok((head[0], u64::from_le_bytes(head[1..].try_into().expect("eight bytes follow the opcode"))))
    }

    /// Whether a record, or the end of the file, can be at this place.
    fn begins_record(&mut self, at: u64) -> io::Result<bool> {
        if at + RECORD_HEAD > self.n_bytes {
            return Ok(at == self.n_bytes);
        }
        let (opcode, length) = self.head(at)?;
        Ok((op::HEADER..=op::DATA_END).contains(&opcode) && length <= self.n_bytes - at - RECORD_HEAD)
    }

    fn step(&mut self, at: u64, visit: &mut impl Visitor) -> Result<Step, ReadError> {
        let left = self.n_bytes - at;
        if left < RECORD_HEAD {
            let what = if left == 0 { "the file ends without its end record" } else { "the file ends within a record" };
            return Ok(Step::Damaged(what.into(), None));
        }
        let (opcode, length) = self.head(at)?;
        let left = left - RECORD_HEAD;
        if opcode == 0 {
            return Ok(Step::Damaged("no record begins with a zero byte".into(), None));
        }
        if length > left {
            let name = op::name(opcode);
            let what = format!("a {name} claims {length} bytes, the file has {left} more");
            return Ok(Step::Damaged(what, None));
        }
        let next = at + RECORD_HEAD + length;
        let place = Location { offset: at, in_chunk: None };
        if opcode == op::CHUNK {
            return self.chunk(place, length, visit);
        }
        if length > MAX_RECORD_BYTES {
            let name = op::name(opcode);
            let what = format!("a {name} of {length} bytes; at most {MAX_RECORD_BYTES} are read at once");
            return Ok(Step::Damaged(what, Some(next)));
        }
        let mut body = std::mem::take(&mut self.body);
        body.clear();
        self.reader.by_ref().take(length).read_to_end(&mut body)?;
        let step = match record::parse(opcode, &body) {
            Err(what) => Step::Damaged(format!("{}: {what}", op::name(opcode)), Some(next)),
            // An opcode of no version of the format is one that was damaged, unless what follows vouches for it.
            Ok(Record::Other) if opcode > op::DATA_END && !self.begins_record(next)? => {
                Step::Damaged(format!("no record has opcode {opcode}"), None)
            }
            Ok(Record::Footer { .. }) if !self.closes(next)? => {
                Step::Damaged("the closing magic does not follow the footer".into(), None)
            }
            Ok(record) => {
                let end = matches!(record, Record::Footer { .. }).then_some(next + MAGIC.len() as u64);
                match (visit.record(place, record), end) {
                    (ControlFlow::Break(()), _) => Step::Stopped,
                    (ControlFlow::Continue(()), Some(end)) => Step::End(end),
                    (ControlFlow::Continue(()), None) => Step::Next(next),
                }
            }
        };
        self.body = body;
        Ok(step)
    }

    /// Whether the closing magic is at this place.
    fn closes(&mut self, at: u64) -> io::Result<bool> {
        let n = MAGIC.len() as u64;
        Ok(at + n <= self.n_bytes && self.read_at(at, n)? == MAGIC)
    }

    fn chunk(&mut self, place: Location, length: u64, visit: &mut impl Visitor) -> Result<Step, ReadError> {
        let next = place.offset + RECORD_HEAD + length;
        let mut body = std::mem::take(&mut self.body);
        let unpacked = self.unpacked(place.offset, length, &mut body)?;
        let step = match unpacked {
            Err((what, consistent)) => Step::Damaged(format!("chunk: {what}"), consistent.then_some(next)),
            Ok(head) => match check_records(&body) {
                Err(what) => Step::Damaged(format!("chunk: {what}"), Some(next)),
                Ok(()) => match tell_chunk(place, head, &body, visit) {
                    ControlFlow::Break(()) => Step::Stopped,
                    ControlFlow::Continue(()) => Step::Next(next),
                },
            },
        };
        self.body = body;
        Ok(step)
    }

    /// Unpacks the chunk at `at` into `out`; or what is wrong, and whether its head agrees with the record's length.
    fn unpacked(&mut self, at: u64, length: u64, out: &mut Vec<u8>) -> io::Result<Result<ChunkHeader, (String, bool)>> {
        let start = self.read_at(at + RECORD_HEAD, length.min(MAX_CHUNK_HEAD))?;
        let head = match record::chunk_head(&start, length) {
            Ok(head) => head,
            Err(what) => return Ok(Err((what, false))),
        };
        self.seek(at + head.n_head)?;
        match unpack(&head, self.reader.by_ref().take(head.n_packed), out) {
            Ok(()) => Ok(Ok(head)),
            Err(Unpacking::Io(error)) => Err(error),
            Err(Unpacking::Damaged(what)) => Ok(Err((what, true))),
        }
    }

    /// Unpacks the chunk at an offset at which [`read`](Self::read) has found one.
    ///
    /// # Errors
    /// If the file has changed since then.
    pub fn chunk_at(&mut self, at: u64) -> io::Result<Vec<u8>> {
        let (_, length) = self.head(at)?;
        let mut out = Vec::new();
        match self.unpacked(at, length, &mut out)? {
            Ok(_) => Ok(out),
            Err((what, _)) => Err(io::Error::other(format!("the chunk at byte {at} has changed: {what}"))),
        }
    }

    /// Reads `n` bytes of a record that [`read`](Self::read) has found.
    ///
    /// # Errors
    /// If the file has changed since then.
    pub fn bytes_at(&mut self, at: u64, n: u64) -> io::Result<Vec<u8>> {
        if at.checked_add(n).is_none_or(|end| end > self.n_bytes) {
            return Err(io::Error::other(format!("the file has changed: byte {at} is beyond its end")));
        }
        self.read_at(at, n)
    }

    /// Computes the CRC of a range of the file.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn crc(&mut self, bytes: Range<u64>) -> io::Result<u32> {
        self.seek(bytes.start)?;
        let mut hasher = crc32fast::Hasher::new();
        let mut left = bytes.end - bytes.start;
        while left > 0 {
            let buffer = self.reader.fill_buf()?;
            if buffer.is_empty() {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            let n = buffer.len().min(usize::try_from(left).unwrap_or(usize::MAX));
            hasher.update(&buffer[..n]);
            self.reader.consume(n);
            left -= n as u64;
        }
        Ok(hasher.finalize())
    }
}

/// The records of an unpacked chunk: where each begins, its opcode and its content.
fn records(chunk: &[u8]) -> impl Iterator<Item = Result<(u64, u8, &[u8]), String>> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let left = &chunk[at..];
        if left.is_empty() {
            return None;
        }
        let Some((head, rest)) = left.split_at_checked(RECORD_HEAD as usize) else {
            at = chunk.len();
            return Some(Err(format!("{} bytes remain at its end, too few for a record", left.len())));
        };
        let length = u64::from_le_bytes(head[1..].try_into().expect("eight bytes follow the opcode"));
        let Some(body) = usize::try_from(length).ok().and_then(|n| rest.get(..n)) else {
            let place = at;
            at = chunk.len();
            let (name, n_left) = (op::name(head[0]), rest.len());
            return Some(Err(format!("a {name} at its byte {place} claims {length} bytes, {n_left} are left")));
        };
        let start = at as u64;
        at += RECORD_HEAD as usize + body.len();
        Some(Ok((start, head[0], body)))
    })
}

fn check_records(chunk: &[u8]) -> Result<(), String> {
    for entry in records(chunk) {
        let (at, opcode, body) = entry?;
        let parsed = record::parse(opcode, body);
        let record = parsed.map_err(|what| format!("a {} at its byte {at}: {what}", op::name(opcode)))?;
        if !matches!(record, Record::Schema { .. } | Record::Channel(_) | Record::Message(_) | Record::Other) {
            return Err(format!("a {} at its byte {at} does not belong into a chunk", op::name(opcode)));
        }
    }
    Ok(())
}

fn tell_chunk(place: Location, head: ChunkHeader, chunk: &[u8], visit: &mut impl Visitor) -> ControlFlow<()> {
    visit.record(place, Record::Chunk(head))?;
    for (at, opcode, body) in records(chunk).filter_map(Result::ok) {
        if let Ok(record) = record::parse(opcode, body) {
            visit.record(Location { in_chunk: Some(at), ..place }, record)?;
        }
    }
    ControlFlow::Continue(())
}

/// Warning about a file that is damaged or truncated; `None` for a complete one.
pub fn damage_message(damages: &[Damage], end: &End) -> Option<String> {
    let cut = match end {
        End::Truncated(damage) => Some(format!("the file was cut short: {damage}")),
        End::Complete { .. } | End::Stopped => None,
    };
    let damaged = damages.first().map(|first| match damages.len() {
        1 => format!("the file is damaged: {first}"),
        n => format!("the file is damaged in {n} places, first {first}"),
    });
    match (damaged, cut) {
        (Some(damaged), Some(cut)) => Some(format!("{damaged}; {cut}")),
        (damaged, cut) => damaged.or(cut),
    }
}
