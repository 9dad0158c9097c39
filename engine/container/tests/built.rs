//! Files built byte by byte: each boundary of what is a record, a damage and an end.

use osteoflow_container::{
    Damage, End, Location, MAGIC, MAX_RECORD_BYTES, MESSAGE_HEADER_BYTES, ReadError, Reader, Record, Visitor,
    damage_message, op,
};
use std::{
    io::{self, Cursor, Read, Seek, SeekFrom},
    ops::ControlFlow,
};

/// What was read, line by line.
#[derive(Default)]
struct Log {
    lines: Vec<String>,
    damages: Vec<Damage>,
    /// Stops at the line of this number.
    stop_at: Option<usize>,
    /// Place and data of each message of the current chunk.
    data: Vec<(u64, Vec<u8>)>,
}

impl Log {
    fn add(&mut self, line: String) -> ControlFlow<()> {
        self.lines.push(line);
        if self.stop_at == Some(self.lines.len()) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl Visitor for Log {
    fn record(&mut self, location: Location, record: Record<'_>) -> ControlFlow<()> {
        let what = match record {
            Record::Header { .. } => return ControlFlow::Continue(()),
            Record::Schema { id, .. } => format!("schema {id}"),
            Record::Channel(channel) => format!("channel {} of schema {}", channel.id, channel.schema_id),
            Record::Message(message) => {
                self.data.extend(location.in_chunk.map(|at| (at + MESSAGE_HEADER_BYTES, message.data.to_vec())));
                format!("message {} of {} bytes", message.sequence, message.data.len())
            }
            Record::Chunk(header) => format!("chunk of {} bytes", header.n_unpacked),
            Record::Metadata { name, .. } => format!("metadata {name}"),
            Record::DataEnd { .. } => "data end".into(),
            Record::Footer { summary_start, .. } => format!("footer {summary_start}"),
            _ => "other".into(),
        };
        self.add(format!("{what} at {location}"))
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        self.damages.push(damage.clone());
        self.add(damage.to_string())
    }

    fn chunk_end(&mut self, records: &mut Vec<u8>) {
        for (at, data) in self.data.drain(..) {
            assert_eq!(
                records[at as usize..][..data.len()],
                data,
                "the data of a message are {at} bytes into the chunk"
            );
        }
    }
}

fn claimed(opcode: u8, length: u64, content: &[u8]) -> Vec<u8> {
    [&[opcode], &length.to_le_bytes()[..], content].concat()
}

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    claimed(opcode, content.len() as u64, content)
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

fn header() -> Vec<u8> {
    record(op::HEADER, &[text(""), text("")].concat())
}

fn schema(id: u16) -> Vec<u8> {
    record(op::SCHEMA, &[&id.to_le_bytes()[..], &text("S"), &text("e"), &text("data")].concat())
}

fn channel(id: u16, schema_id: u16) -> Vec<u8> {
    let ids = [id.to_le_bytes(), schema_id.to_le_bytes()].concat();
    record(op::CHANNEL, &[&ids[..], &text("/t"), &text("raw"), &text("")].concat())
}

fn message(channel: u16, sequence: u32, n_bytes: usize) -> Vec<u8> {
    record(op::MESSAGE, &[&channel.to_le_bytes()[..], &sequence.to_le_bytes(), &[0; 16], &vec![7; n_bytes]].concat())
}

fn metadata(name: &str) -> Vec<u8> {
    record(op::METADATA, &[text(name), text("")].concat())
}

/// A chunk without compression that claims `n_unpacked` bytes.
fn chunk_of(records: &[u8], n_unpacked: u64, compression: &str) -> Vec<u8> {
    let head = [&[0; 16][..], &n_unpacked.to_le_bytes(), &[0; 4], &text(compression)].concat();
    record(op::CHUNK, &[&head[..], &(records.len() as u64).to_le_bytes(), records].concat())
}

fn chunk(records: &[Vec<u8>]) -> Vec<u8> {
    let records = records.concat();
    chunk_of(&records, records.len() as u64, "")
}

/// Magic, header and these records; 33 bytes come before the first.
fn begun(records: &[Vec<u8>]) -> Vec<u8> {
    [&MAGIC[..], &header(), &records.concat()].concat()
}

const START: u64 = 8 + 9 + 8;

/// A whole file with this summary; no CRC is stored.
fn whole(records: &[Vec<u8>], summary: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = [begun(records), record(op::DATA_END, &[0; 4])].concat();
    let start = if summary.is_empty() { 0 } else { bytes.len() as u64 };
    bytes.extend(summary.concat());
    bytes.extend(record(op::FOOTER, &[&start.to_le_bytes()[..], &[0; 12]].concat()));
    bytes.extend(MAGIC);
    bytes
}

fn read(bytes: &[u8]) -> (Vec<String>, End) {
    let mut log = Log::default();
    let end = Reader::new(Cursor::new(bytes), bytes.len() as u64).read(&mut log).unwrap();
    (log.lines, end)
}

/// The lines, and the damage that the file ends with.
fn truncated(bytes: &[u8]) -> (Vec<String>, String) {
    match read(bytes) {
        (lines, End::Truncated(damage)) => (lines, damage.to_string()),
        (lines, end) => panic!("{end:?} after {lines:?}"),
    }
}

#[test]
fn a_damaged_magic_before_a_header_is_a_damage_and_anything_else_no_mcap() {
    let with = |rest: &[u8]| [b"\x89MCAP9\r\n", rest].concat();
    let error = |bytes: &[u8]| match Reader::new(Cursor::new(bytes), bytes.len() as u64).read(&mut Log::default()) {
        Err(ReadError::NotMcap { start }) => start,
        other => panic!("{other:?}"),
    };
    let (lines, _) = read(&with(&[header(), vec![9]].concat()));
    assert_eq!(lines, ["bytes 0 to 8: the magic of MCAP is damaged"]);
    let (lines, end) = read(&with(&whole(&[metadata("a")], &[])[8..]));
    assert_eq!((lines.len(), end), (4, End::Complete { trailing: 0 }), "{lines:?}");
    // Nothing behind the header confirms its length, it has another opcode, or it is malformed.
    let malformed = record(op::HEADER, &[1; 20]);
    let other = record(0x80, &[text(""), text("")].concat());
    for rest in
        [header(), [other, vec![9]].concat(), [malformed, vec![9]].concat(), vec![op::HEADER; 9], vec![op::HEADER; 8]]
    {
        assert_eq!(error(&with(&rest)), b"\x89MCAP9\r\n", "{rest:?}");
    }
    let long = "x".repeat(0xffff);
    let long = record(op::HEADER, &[text(&long), text("")].concat());
    assert_eq!(error(&with(&[long, vec![0; 99]].concat())).len(), 8, "no header is so long");
}

#[test]
fn a_file_ends_where_its_bytes_do() {
    let cut = |rest: &[u8]| truncated(&begun(&[metadata("a"), rest.to_vec()]));
    let at = START + metadata("a").len() as u64;
    let read = format!("metadata a at byte {START}");
    let damage = |n: u64, cause: &str| (vec![read.clone()], format!("bytes {at} to {}: {cause}", at + n));
    assert_eq!(cut(&[]), damage(0, "the file ends without its footer"));
    let head = "the file ends inside the head of a record: 9 bytes are needed";
    assert_eq!(cut(&[op::MESSAGE]), damage(1, &format!("{head}, 1 are left")));
    assert_eq!(cut(&[1; 8]), damage(8, &format!("{head}, 8 are left")));
    let inside = "the file ends inside metadata";
    assert_eq!(
        cut(&claimed(op::METADATA, 9, &[1; 8])),
        damage(17, &format!("{inside}: 9 bytes are needed, 8 are left"))
    );
    assert_eq!(cut(&claimed(op::METADATA, 1, &[])), damage(9, &format!("{inside}: 1 bytes are needed, 0 are left")));
    assert_eq!(cut(&[0; 30]), damage(30, "unknown record: no record has opcode 0"));
    // Up to twice the longest record is the length of a record that was cut; more is a damaged length.
    let longest = 2 * MAX_RECORD_BYTES;
    let said = format!("{inside}: {longest} bytes are needed, 8 are left");
    assert_eq!(cut(&claimed(op::METADATA, longest, &[1; 8])), damage(17, &said));
    let said = format!("metadata claims {} bytes, but at most 8 are possible", longest + 1);
    assert_eq!(cut(&claimed(op::METADATA, longest + 1, &[1; 8])), damage(17, &said));
    // A record of nine bytes ends the file.
    let (lines, damage) = truncated(&begun(&[record(op::SUMMARY_OFFSET, &[])]));
    assert_eq!(lines, [format!("other at byte {START}")]);
    assert_eq!(damage, format!("bytes {0} to {0}: the file ends without its footer", START + 9));
}

#[test]
fn behind_a_malformed_record_reading_goes_on_where_it_ends_if_a_record_begins_there() {
    let faulty = record(op::METADATA, &[1; 5]);
    let next = START + faulty.len() as u64;
    let cause = "metadata: a field of 16843009 bytes at its byte 4 goes beyond its end, 1 are left";
    let damaged = format!("bytes {START} to {next}: {cause}");
    let with = |rest: &[u8]| truncated(&begun(&[faulty.clone(), rest.to_vec()]));
    let goes_on = |rest: &[u8], line: Option<&str>| {
        let (lines, end) = with(rest);
        let line = line.map(|line| format!("{line} at byte {next}"));
        assert_eq!(lines, [damaged.clone()].into_iter().chain(line).collect::<Vec<_>>());
        assert!(end.ends_with("the file ends without its footer"), "{end}");
    };
    goes_on(&[], None);
    goes_on(&record(op::SUMMARY_OFFSET, &[]), Some("other"));
    goes_on(&message(1, 3, 2), Some("message 3 of 2 bytes"));
    for rest in [vec![op::MESSAGE; 8], claimed(op::MESSAGE, 5, &[0; 4]), record(0x80, &[]), record(0, &[]), vec![0; 9]]
    {
        let end = next + rest.len() as u64;
        assert_eq!(with(&rest), (vec![], format!("bytes {START} to {end}: {cause}")), "{rest:?}");
    }
}

#[test]
fn a_record_of_an_unknown_opcode_is_passed_over_if_another_begins_behind_it() {
    let known = whole(&[record(0x90, &[1; 5]), metadata("a")], &[]);
    assert_eq!(read(&known).0[..2], [format!("other at byte {START}"), format!("metadata a at byte {}", START + 14)]);
    let (lines, end) = truncated(&begun(&[record(0x90, &[1; 5]), vec![0; 30]]));
    assert_eq!(lines, [""; 0]);
    assert!(end.ends_with("unknown record: no record has opcode 144"), "{end}");
    // Opcodes of the format need no confirmation.
    let (lines, _) = truncated(&begun(&[record(op::SUMMARY_OFFSET, &[1; 5]), vec![0; 30]]));
    assert_eq!(lines, [format!("other at byte {START}")]);
}

#[test]
fn a_message_outside_of_chunks_needs_a_record_behind_it() {
    let (lines, end) = truncated(&begun(&[message(1, 1, 4), vec![0; 30]]));
    assert_eq!(lines, [""; 0]);
    assert!(end.ends_with("message: no record follows its 26 bytes"), "{end}");
}

#[test]
fn messages_behind_damage_are_searched_for_in_files_without_chunks_only() {
    let damaged = |n_gap: usize| [vec![0; n_gap], message(1, 2, 0), message(1, 3, 0), metadata("a")].concat();
    let first = [channel(1, 0), message(1, 1, 0), metadata("m")].concat();
    let words = |records: &[Vec<u8>]| {
        let (lines, _) = read(&whole(records, &[]));
        lines.iter().map(|line| line.split(" at ").next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let found = words(&[first.clone(), damaged(20)]);
    assert_eq!(found[4..], ["message 2 of 0 bytes", "message 3 of 0 bytes", "metadata a", "data end", "footer 0"]);
    // They may be of a damaged chunk.
    let found = words(&[first, chunk(&[message(1, 0, 0)]), damaged(20)]);
    assert_eq!(found[6..], ["metadata a", "data end", "footer 0"], "{found:?}");
}

#[test]
fn a_footer_is_the_end_only_before_the_closing_magic() {
    let good = whole(&[], &[]);
    for n in [0, 1, 5, 100] {
        let (lines, end) = read(&[&good[..], &vec![3; n]].concat());
        assert_eq!(end, End::Complete { trailing: n as u64 });
        assert_eq!(lines, [format!("data end at byte {START}"), format!("footer 0 at byte {}", START + 13)]);
    }
    for n in [1, 7, 8] {
        let (_, end) = truncated(&good[..good.len() - n]);
        assert!(end.ends_with("footer: the closing magic does not follow it"), "{end}");
    }
    let mut other = good.clone();
    *other.last_mut().unwrap() ^= 1;
    assert!(truncated(&other).1.ends_with("the closing magic does not follow it"));
}

#[test]
fn a_chunk_holds_whole_records_of_the_data_only() {
    let said = |records: &[u8]| {
        let (lines, _) = read(&whole(&[chunk_of(records, records.len() as u64, ""), metadata("a")], &[]));
        assert!(lines[1].starts_with("metadata a"), "{lines:?}");
        lines[0].split_once(": ").unwrap().1.to_owned()
    };
    let good = message(1, 1, 4);
    assert_eq!(said(&[&good[..], &[5; 8]].concat()), "chunk: 8 bytes remain at its end, too few for a record");
    assert_eq!(
        said(&[&good[..], &claimed(op::MESSAGE, 23, &[0; 22])].concat()),
        format!("chunk: a message at its byte {} claims 23 bytes, 22 are left", good.len())
    );
    assert_eq!(said(&metadata("b")), "chunk: a metadata at its byte 0 does not belong into a chunk");
    assert_eq!(
        said(&[&good[..], &record(op::MESSAGE, &[0; 21])].concat()),
        format!(
            "chunk: at its byte {}: message: a field of 8 bytes at its byte 14 goes beyond its end, 7 are left",
            good.len()
        )
    );
    let twice =
        [schema(1), record(op::SCHEMA, &[&[1, 0][..], &text("T"), &text("e"), &text("data")].concat())].concat();
    assert_eq!(
        said(&twice),
        format!(
            "chunk: at its byte {}: schema: number 1 is described twice: as \"S\" (e) and as \"T\" (e)",
            schema(1).len()
        )
    );
    let more = |n: u64| chunk_of(&good, n, "");
    let size = |n: u64| read(&whole(&[more(n)], &[])).0[0].split_once(": ").unwrap().1.to_owned();
    let n = good.len() as u64;
    assert_eq!(
        size(n - 1),
        format!("the chunk's \"\" data cannot be unpacked: it holds more than the {} bytes it claims", n - 1)
    );
    assert_eq!(
        size(n + 1),
        format!("the chunk's \"\" data cannot be unpacked: it holds fewer than the {} bytes it claims", n + 1)
    );
    let name = read(&whole(&[chunk_of(&good, n, "brotli")], &[])).0[0].clone();
    assert!(
        name.ends_with("the chunk's \"brotli\" data cannot be unpacked: its name is not known; none, lz4 and zstd are"),
        "{name}"
    );
}

#[test]
fn records_of_a_chunk_have_their_place_in_it() {
    let records = [schema(1), channel(1, 1), record(0x80, &[1, 2]), message(1, 1, 4), message(1, 2, 0)];
    let mut at = 0;
    let mut expected = vec![format!("chunk of {} bytes at byte {START}", records.concat().len())];
    let what = ["schema 1", "channel 1 of schema 1", "other", "message 1 of 4 bytes", "message 2 of 0 bytes"];
    for (what, record) in what.iter().zip(&records) {
        expected.push(format!("{what} at byte {at} of the unpacked chunk at byte {START}"));
        at += record.len();
    }
    let (lines, end) = read(&whole(&[chunk(&records)], &[]));
    assert_eq!((&lines[..6], end), (&expected[..], End::Complete { trailing: 0 }));
}

#[test]
fn a_length_that_no_chunk_has_is_no_cut_file() {
    let long = chunk_of(&[], MAX_RECORD_BYTES + 1, "");
    let (_, end) = truncated(&begun(&[long, vec![0; 40]]));
    let expected = format!(
        "the unpacked chunk claims {} bytes, but at most {MAX_RECORD_BYTES} are possible",
        MAX_RECORD_BYTES + 1
    );
    assert!(end.ends_with(&expected), "{end}");
}

#[test]
fn channels_and_schemas_that_only_the_summary_describes_come_before_their_use() {
    let summary = [metadata("s"), schema(2), schema(1), channel(1, 1), channel(2, 2), channel(3, 0)];
    let places = |data: &[Vec<u8>]| {
        let mut at = START + data.concat().len() as u64 + 13;
        summary.iter().map(|record| (at, at += record.len() as u64).0).collect::<Vec<_>>()
    };
    for (data, expected) in [
        (vec![message(1, 1, 0)], vec!["schema 1 at 2", "channel 1 of schema 1 at 3", "message"]),
        (vec![message(3, 1, 0)], vec!["channel 3 of schema 0 at 5", "message"]),
        (vec![channel(7, 2)], vec!["schema 2 at 1", "channel 7"]),
        (vec![schema(1), message(1, 1, 0)], vec!["schema 1", "channel 1 of schema 1 at 3", "message"]),
        (vec![message(9, 1, 0)], vec!["message"]),
        (vec![chunk(&[message(1, 1, 0)])], vec!["schema 1 at 2", "channel 1 of schema 1 at 3", "chunk"]),
        (
            vec![chunk(&[message(2, 1, 0), message(1, 2, 0)])],
            vec!["schema 1 at 2", "schema 2 at 1", "channel 1 of schema 1 at 3", "channel 2 of schema 2 at 4", "chunk"],
        ),
        (vec![chunk(&[channel(7, 2), message(7, 1, 0)])], vec!["schema 2 at 1", "chunk"]),
        (vec![chunk(&[schema(2), channel(7, 2), message(7, 1, 0)])], vec!["chunk"]),
    ] {
        let at = places(&data);
        let (lines, end) = read(&whole(&data, &summary));
        assert_eq!(end, End::Complete { trailing: 0 });
        for (line, expected) in lines.iter().zip(&expected) {
            let expected = match expected.split_once(" at ") {
                Some((what, place)) => format!("{what} at byte {}", at[place.parse::<usize>().unwrap()]),
                None => (*expected).to_owned(),
            };
            assert!(line.starts_with(&expected), "{line} for {expected}: {lines:?}");
        }
        // The visitor may stop at each of them.
        for n in 1..=expected.len() {
            let bytes = whole(&data, &summary);
            let mut log = Log { stop_at: Some(n), ..Log::default() };
            let end = Reader::new(Cursor::new(&bytes), bytes.len() as u64).read(&mut log).unwrap();
            assert_eq!((end, log.lines.len()), (End::Stopped, n), "{:?}", log.lines);
        }
    }
}

#[test]
fn a_summary_that_is_not_where_the_footer_says_is_not_believed() {
    let data = [message(1, 1, 0)];
    let bytes = whole(&data, &[schema(1), channel(1, 1)]);
    let first = |bytes: &[u8]| read(bytes).0[0].clone();
    assert!(first(&bytes).starts_with("schema 1"));
    let start_at = bytes.len() - 8 - 20;
    let start = u64::from_le_bytes(bytes[start_at..start_at + 8].try_into().unwrap());
    for other in [0, 7, bytes.len() as u64, u64::MAX] {
        let mut changed = bytes.clone();
        changed[start_at..start_at + 8].copy_from_slice(&other.to_le_bytes());
        assert!(first(&changed).starts_with("message 1"), "{other}: {}", first(&changed));
    }
    // A CRC that is right or zero; it covers the footer up to itself.
    let crc_at = bytes.len() - 8 - 4;
    for (crc, is_believed) in [(crc32fast::hash(&bytes[start as usize..crc_at]), true), (1, false)] {
        let mut changed = bytes.clone();
        changed[crc_at..crc_at + 4].copy_from_slice(&crc.to_le_bytes());
        assert_eq!(first(&changed).starts_with("schema 1"), is_believed, "{crc}");
    }
    for at in [bytes.len() - 1, bytes.len() - 8 - 29] {
        let mut changed = bytes.clone();
        changed[at] ^= 0x40;
        assert!(first(&changed).starts_with("message 1"), "byte {at}");
    }
    // A record of the summary that claims too many bytes hides those behind it, and one without an identifier is passed over.
    let long = whole(&data, &[claimed(op::SUMMARY_OFFSET, 10_000, &[]), schema(1), channel(1, 1)]);
    assert!(first(&long).starts_with("message 1"));
    let short = whole(&data, &[record(op::CHANNEL, &[1]), schema(1), channel(1, 1)]);
    assert!(first(&short).starts_with("schema 1"));
    let wrong = whole(&data, &[schema(1), record(op::CHANNEL, &[1, 0, 1, 0, 9])]);
    assert!(first(&wrong).starts_with("message 1"), "a channel that is malformed");
}

#[test]
fn chunks_and_bytes_are_read_again_where_they_were_found() {
    let records = [channel(1, 0), message(1, 1, 4)].concat();
    let bytes = whole(&[chunk_of(&records, records.len() as u64, "")], &[]);
    let mut reader = Reader::new(Cursor::new(&bytes), bytes.len() as u64);
    assert_eq!(reader.n_bytes(), bytes.len() as u64);
    assert_eq!(reader.chunk_at(START).unwrap(), records);
    let end = bytes.len() as u64;
    assert_eq!(reader.bytes_at(3, 5).unwrap(), bytes[3..8]);
    assert_eq!(reader.bytes_at(end - 4, 4).unwrap(), bytes[bytes.len() - 4..]);
    for (at, n) in [(end - 4, 5), (end, 1), (u64::MAX, 2)] {
        let said = reader.bytes_at(at, n).unwrap_err().to_string();
        assert_eq!(said, format!("the file has changed: byte {at} is beyond its end"));
    }
    let mut changed = bytes.clone();
    changed[START as usize + 25] ^= 1;
    let said = Reader::new(Cursor::new(&changed), end).chunk_at(START).unwrap_err().to_string();
    assert!(said.starts_with(&format!("the chunk at byte {START} has changed: the chunk's \"\" data")), "{said}");
}

#[test]
fn only_a_regular_file_is_opened() {
    let dir = tempfile::tempdir().unwrap();
    let error = |path: &std::path::Path| Reader::open(path).map(drop).unwrap_err();
    assert_eq!(error(dir.path()).to_string(), "it is no regular file; a recording is read from a file");
    assert_eq!(error(&dir.path().join("none")).kind(), io::ErrorKind::NotFound);
    let path = dir.path().join("a.mcap");
    let bytes = whole(&[metadata("a")], &[]);
    std::fs::write(&path, &bytes).unwrap();
    let mut log = Log::default();
    let mut reader = Reader::open(&path).unwrap();
    assert_eq!(reader.n_bytes(), bytes.len() as u64);
    assert_eq!(reader.read(&mut log).unwrap(), End::Complete { trailing: 0 });
    assert_eq!(log.lines.len(), 3);
}

/// Zeros between a beginning and an end.
struct Sparse {
    start: Vec<u8>,
    end: Vec<u8>,
    n_bytes: u64,
    at: u64,
}

impl Read for Sparse {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let n = out.len().min((self.n_bytes - self.at) as usize);
        for (byte, at) in out[..n].iter_mut().zip(self.at..) {
            let in_end = at.checked_sub(self.n_bytes - self.end.len() as u64).and_then(|k| self.end.get(k as usize));
            *byte = *in_end.or(self.start.get(at as usize)).unwrap_or(&0);
        }
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for Sparse {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::Current(by) => self.at.checked_add_signed(by).unwrap(),
            SeekFrom::End(_) => unreachable!("the reader knows its length"),
        };
        Ok(self.at)
    }
}

#[test]
fn a_record_that_is_longer_than_any_is_passed_over_unread() {
    let length = MAX_RECORD_BYTES + 1;
    let start = begun(&[claimed(op::METADATA, length, &[])]);
    // A message that no search would find.
    let end = whole(&[message(1, 7, 0)], &[])[START as usize..].to_vec();
    let n_bytes = start.len() as u64 + length + end.len() as u64;
    let mut log = Log::default();
    let ended = Reader::new(Sparse { start, end, n_bytes, at: 0 }, n_bytes).read(&mut log).unwrap();
    assert_eq!(ended, End::Complete { trailing: 0 });
    let next = START + 9 + length;
    assert_eq!(
        log.lines[..2],
        [
            format!(
                "bytes {START} to {next}: metadata claims {length} bytes, but at most {MAX_RECORD_BYTES} are possible"
            ),
            format!("message 7 of 0 bytes at byte {next}"),
        ]
    );
}

#[test]
fn a_warning_names_the_first_damage_their_number_and_the_cut() {
    let damage = |at: u64| Damage { bytes: at..at + 1, cause: osteoflow_container::Cause::NoFooter };
    let complete = End::Complete { trailing: 0 };
    let cut = End::Truncated(damage(9));
    let said = |damages: &[Damage], end: &End| damage_message(damages, end).unwrap_or_default();
    assert_eq!(said(&[], &complete), "");
    assert_eq!(said(&[], &End::Stopped), "");
    let one = "bytes 1 to 2: the file ends without its footer";
    assert_eq!(said(&[damage(1)], &complete), format!("the file is damaged: {one}"));
    assert_eq!(said(&[damage(1), damage(5)], &complete), format!("the file is damaged in 2 places, first {one}"));
    let end = "the file was cut short: bytes 9 to 10: the file ends without its footer";
    assert_eq!(said(&[], &cut), end);
    assert_eq!(said(&[damage(1)], &cut), format!("the file is damaged: {one}; {end}"));
}
