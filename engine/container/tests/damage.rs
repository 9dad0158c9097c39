//! Damaged files: what is intact is read, what is not is named with its place, and nothing is taken for what it is not.

use osteoflow_container::{
    Attachment, Cause, Compression, Damage, End, Location, MAX_RECORD_BYTES, MessageHeader, ReadError, Reader, Record,
    Visitor, WriteOptions, Writer, op,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    io::Cursor,
    ops::ControlFlow,
};

const N_MESSAGES: u32 = 60;

#[derive(Debug, Default)]
struct Contents {
    /// Topic, number and data of each message; the topic is empty if no channel is described.
    messages: Vec<(String, u32, Vec<u8>)>,
    channels: BTreeMap<u16, String>,
    attachments: usize,
    metadata: usize,
    damages: Vec<Damage>,
    /// Channels that were described by the summary before their messages.
    from_summary: BTreeSet<u16>,
    /// CRC of the data as it is stored and as it is computed, and the offset of the record that stores it.
    data_crc: Option<(u32, Option<u32>, u64)>,
    /// Messages by channel, as the summary counts them.
    counts: BTreeMap<u16, u64>,
    last: u64,
}

impl Visitor for Contents {
    fn record(&mut self, location: Location, record: Record<'_>) -> ControlFlow<()> {
        match record {
            Record::Channel(channel) => {
                if self.channels.contains_key(&channel.id) {
                    assert_eq!(self.channels[&channel.id], channel.topic, "a channel changes its topic");
                }
                self.from_summary.insert(channel.id);
                self.channels.insert(channel.id, channel.topic);
            }
            Record::Message(m) => {
                let topic = self.channels.get(&m.channel_id).cloned().unwrap_or_default();
                self.messages.push((topic, m.sequence, m.data.to_vec()));
            }
            Record::Attachment(_) => self.attachments += 1,
            Record::Metadata { .. } => self.metadata += 1,
            Record::Statistics(statistics) => self.counts = statistics.by_channel,
            Record::DataEnd { crc, computed } => self.data_crc = Some((crc, computed, location.offset)),
            _ => {}
        }
        self.last = location.offset;
        ControlFlow::Continue(())
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        self.damages.push(damage);
        ControlFlow::Continue(())
    }
}

impl Contents {
    fn numbers(&self) -> Vec<u32> {
        self.messages.iter().map(|(_, number, _)| *number).collect()
    }
}

fn read(bytes: &[u8]) -> (Contents, End) {
    let mut found = Contents::default();
    let end = Reader::new(Cursor::new(bytes), bytes.len() as u64).read(&mut found).unwrap();
    (found, end)
}

fn data(i: u32) -> Vec<u8> {
    (0..40 + i * 7).map(|k| (k.wrapping_mul(k + i) >> 7) as u8).collect()
}

fn topic(i: u32) -> &'static str {
    ["/a", "/b"][i as usize % 2]
}

/// Messages on two channels, an attachment in the middle, metadata at the end.
fn file(options: WriteOptions) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), WriteOptions { chunk_bytes: 900, ..options }).unwrap();
    let schema = writer.add_schema("Raw", "text", b"bytes").unwrap();
    let channels = ["/a", "/b"].map(|topic| writer.add_channel(schema, topic, "raw", &BTreeMap::new()).unwrap());
    for i in 0..N_MESSAGES {
        let time = 1_000 + u64::from(i);
        let header =
            MessageHeader { channel_id: channels[i as usize % 2], sequence: i, log_time: time, publish_time: time };
        writer.write_message(header, data(i).into()).unwrap();
        if i == N_MESSAGES / 2 {
            let attachment =
                Attachment { log_time: 1, create_time: 1, name: "a.txt", media_type: "text/plain", data: &[7; 300] };
            writer.write_attachment(&attachment).unwrap();
        }
    }
    writer.write_metadata("last", &[("k".to_owned(), "v".to_owned())].into()).unwrap();
    writer.finish().unwrap()
}

#[test]
fn the_summary_counts_the_messages_of_each_channel() {
    let (found, _) = read(&file(chunked(Compression::None)));
    let of = |topic: &str| found.channels.iter().find(|(_, known)| *known == topic).map(|(id, _)| *id).unwrap();
    let half = u64::from(N_MESSAGES / 2);
    assert_eq!(found.counts, BTreeMap::from([(of("/a"), u64::from(N_MESSAGES) - half), (of("/b"), half)]));
}

fn chunked(compression: Compression) -> WriteOptions {
    WriteOptions { compression, ..WriteOptions::default() }
}

fn unchunked() -> WriteOptions {
    WriteOptions { chunks: false, ..WriteOptions::default() }
}

/// Opcode, offset and end of each record.
fn records(bytes: &[u8]) -> Vec<(u8, usize, usize)> {
    let (mut at, mut found) = (8, Vec::new());
    while at + 9 <= bytes.len() - 8 {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        found.push((bytes[at], at, at + 9 + length));
        at += 9 + length;
    }
    found
}

fn of_kind(bytes: &[u8], opcode: u8) -> Vec<(usize, usize)> {
    records(bytes).into_iter().filter(|r| r.0 == opcode).map(|r| (r.1, r.2)).collect()
}

/// Makes the stored CRCs of the whole file unknown.
fn without_section_crcs(bytes: &mut [u8]) {
    for (opcode, _, end) in records(bytes) {
        if opcode == op::DATA_END || opcode == op::FOOTER {
            bytes[end - 4..end].fill(0);
        }
    }
}

/// Damaged lengths of a record: too small, too large by little and by much, and beyond the file.
const LENGTHS: [fn(u64) -> u64; 5] = [|n| n / 2, |n| n + 9, |n| n + 0x1000, |n| n | 1 << 40, |_| u64::MAX];

#[test]
fn records_behind_a_damaged_length_are_read_and_the_damage_is_named() {
    for compression in Compression::ALL {
        let bytes = file(chunked(compression));
        let chunks = of_kind(&bytes, op::CHUNK);
        let (start, end) = chunks[chunks.len() / 2];
        for length in LENGTHS {
            let mut damaged = bytes.clone();
            let n = length((end - start - 9) as u64);
            damaged[start + 1..start + 9].copy_from_slice(&n.to_le_bytes());
            let (found, ended) = read(&damaged);
            assert_eq!(ended, End::Complete { trailing: 0 }, "{compression:?}, length {n}");
            assert_eq!(found.damages.len(), 1, "{compression:?}, length {n}: {:?}", found.damages);
            assert_eq!(found.damages[0].bytes.start, start as u64);
            assert!(found.damages[0].bytes.end >= end as u64, "{compression:?}, length {n}: {:?}", found.damages);
            let numbers = found.numbers();
            assert!(numbers.contains(&0) && numbers.contains(&(N_MESSAGES - 1)), "{compression:?}, {n}: {numbers:?}");
            assert!((45..N_MESSAGES as usize).contains(&numbers.len()), "{compression:?}, {n}: {numbers:?}");
            assert_eq!((found.attachments, found.metadata), (1, 1), "{compression:?}, length {n}");
        }
    }
}

#[test]
fn messages_behind_a_damaged_length_are_read_in_a_file_without_chunks() {
    let bytes = file(unchunked());
    let messages = of_kind(&bytes, op::MESSAGE);
    for (at, length) in (0..N_MESSAGES as usize).flat_map(|at| LENGTHS.map(|length| (at, length))) {
        let (start, end) = messages[at];
        let mut damaged = bytes.clone();
        let n = length((end - start - 9) as u64);
        damaged[start + 1..start + 9].copy_from_slice(&n.to_le_bytes());
        let (found, ended) = read(&damaged);
        assert_eq!(ended, End::Complete { trailing: 0 }, "message {at}, length {n}");
        assert!(!found.damages.is_empty(), "message {at}, length {n}: the damage is not named");
        let numbers = found.numbers();
        let expected: Vec<u32> = (0..N_MESSAGES).filter(|i| *i != at as u32).collect();
        // A message before an absurd length is lost with it: its own length may be the damaged one.
        let fewer: Vec<u32> = expected.iter().copied().filter(|i| i + 1 != at as u32).collect();
        assert!(numbers == expected || numbers == fewer, "message {at}, length {n}: {numbers:?}");
        for (topic_read, number, data_read) in &found.messages {
            assert_eq!((&**topic_read, data_read), (topic(*number), &data(*number)), "message {at}, length {n}");
        }
        assert_eq!((found.attachments, found.metadata), (1, 1), "message {at}, length {n}");
    }
}

#[test]
fn messages_of_a_damaged_chunk_are_not_taken_for_messages_outside_of_chunks() {
    let bytes = file(chunked(Compression::None));
    let (start, end) = of_kind(&bytes, op::CHUNK)[0];
    for damage in [|b: &mut [u8]| b[0] = 0x7f, |b: &mut [u8]| b[1] ^= 0x40, |b: &mut [u8]| b[45] ^= 1] {
        let mut damaged = bytes.clone();
        damage(&mut damaged[start..end]);
        let (found, _) = read(&damaged);
        assert!(!found.numbers().contains(&0), "a message was taken from a damaged chunk");
        assert!(found.numbers().contains(&(N_MESSAGES - 1)));
        // The channels were described in that chunk and in the summary.
        assert!(found.messages.iter().all(|(read, i, _)| read == topic(*i)), "{:?}", found.channels);
    }
}

#[test]
fn the_crc_of_the_data_is_of_every_byte_before_its_end_whole_or_damaged() {
    for options in [unchunked(), chunked(Compression::None), chunked(Compression::Zstd)] {
        let bytes = file(options.clone());
        let read = |bytes: &[u8]| {
            let mut found = Contents::default();
            Reader::new(Cursor::new(bytes), bytes.len() as u64).with_section_crcs().read(&mut found).unwrap();
            let (stored, computed, end) = found.data_crc.unwrap();
            assert_eq!(computed, Some(crc32fast::hash(&bytes[..end as usize])), "{options:?}: {:?}", found.damages);
            (Some(stored) == computed, found)
        };
        assert!(read(&bytes).0, "{options:?}");
        for (opcode, start, end) in records(&bytes) {
            if ![op::MESSAGE, op::CHUNK].contains(&opcode) {
                continue;
            }
            let mut flipped = bytes.clone();
            flipped[end - 1] ^= 1;
            let (is_right, found) = read(&flipped);
            assert!(!is_right, "{options:?}, record at {start}");
            // Nothing but the CRC of the data shows it in a message outside of chunks.
            assert_eq!(found.damages.is_empty(), opcode == op::MESSAGE, "{options:?}: {:?}", found.damages);
            for damage in [|b: &mut [u8]| b[0] = 0, |b: &mut [u8]| b[1] ^= 0x10, |b: &mut [u8]| b[6] = 1] {
                let mut damaged = bytes.clone();
                damage(&mut damaged[start..]);
                let (is_right, found) = read(&damaged);
                assert!(!is_right && !found.damages.is_empty(), "{options:?}, record at {start}");
            }
        }
    }
}

#[test]
fn a_summary_that_is_damaged_is_not_believed() {
    let mut bytes = file(chunked(Compression::Zstd));
    let (start, end) = of_kind(&bytes, op::CHUNK)[0];
    bytes[(start + end) / 2] ^= 0x10;
    let topic_at = bytes.len() - 1 - bytes.iter().rev().position(|b| *b == b'a').unwrap();
    let in_summary = bytes.windows(2).rposition(|w| w == b"/a").unwrap();
    assert!(topic_at >= in_summary);
    bytes[in_summary + 1] = b'z';
    let (found, _) = read(&bytes);
    assert!(found.messages.iter().all(|(topic, ..)| topic.is_empty()), "{:?}", found.channels);
    assert!(found.damages[0].to_string().contains("CRC") || found.damages[0].to_string().contains("unpacked"));
}

/// Changes the bytes of an uncompressed chunk and repairs its CRC.
fn change_chunk(bytes: &mut [u8], chunk: (usize, usize), change: impl FnOnce(&mut [u8])) {
    // Times, size, CRC, an empty compression and the packed size come before the records.
    let records = chunk.0 + 9 + 40;
    change(&mut bytes[records..chunk.1]);
    let crc = crc32fast::hash(&bytes[records..chunk.1]);
    bytes[chunk.0 + 33..chunk.0 + 37].copy_from_slice(&crc.to_le_bytes());
    without_section_crcs(bytes);
}

fn replace(bytes: &mut [u8], from: &[u8], to: &[u8]) {
    let at = bytes.windows(from.len()).position(|w| w == from).unwrap();
    bytes[at..at + to.len()].copy_from_slice(to);
}

#[test]
fn channels_that_are_swapped_in_the_data_contradict_the_summary() {
    let mut bytes = file(chunked(Compression::None));
    let chunk = of_kind(&bytes, op::CHUNK)[0];
    change_chunk(&mut bytes, chunk, |records| {
        replace(records, b"/a", b"/x");
        replace(records, b"/b", b"/a");
        replace(records, b"/x", b"/b");
    });
    let (found, end) = read(&bytes);
    assert_eq!(end, End::Complete { trailing: 0 });
    let said: Vec<_> = found.damages.iter().map(ToString::to_string).collect();
    assert_eq!(said.len(), 2, "{said:?}");
    assert!(said[0].contains("number 1 is described twice: as \"/b\" (schema 1, raw) and as \"/a\""), "{said:?}");
}

#[test]
fn a_chunk_that_describes_a_channel_anew_is_refused_and_the_others_are_read() {
    let bytes = file(chunked(Compression::None));
    let chunks = of_kind(&bytes, op::CHUNK);
    let channel = {
        let records = &bytes[chunks[0].0 + 49..chunks[0].1];
        let at = records.windows(2).position(|w| w == b"/a").unwrap() - 8 - 9;
        let length = u64::from_le_bytes(records[at + 1..at + 9].try_into().unwrap()) as usize;
        records[at..at + 9 + length].to_vec()
    };
    for (from, to) in [(b"/a", b"/q"), (b"/a", b"/b")] {
        let mut other = channel.clone();
        replace(&mut other, from, to);
        // In place of the first message of a later chunk, whose rest is taken by a record of a later version.
        let mut damaged = bytes.clone();
        change_chunk(&mut damaged, chunks[2], |records| {
            let length = u64::from_le_bytes(records[1..9].try_into().unwrap()) as usize;
            let rest = length - other.len();
            records[..other.len()].copy_from_slice(&other);
            records[other.len()] = 0x7f;
            records[other.len() + 1..other.len() + 9].copy_from_slice(&(rest as u64).to_le_bytes());
        });
        let (found, end) = read(&damaged);
        assert_eq!((end, found.damages.len()), (End::Complete { trailing: 0 }, 1), "{:?}", found.damages);
        assert!(found.damages[0].to_string().contains("number 1 is described twice"), "{:?}", found.damages);
        assert_eq!(found.damages[0].bytes, chunks[2].0 as u64..chunks[2].1 as u64);
        assert!(found.numbers().contains(&(N_MESSAGES - 1)));
    }
}

#[test]
fn a_chunk_that_claims_another_size_is_refused() {
    for compression in Compression::ALL {
        let bytes = file(chunked(compression));
        let chunks = of_kind(&bytes, op::CHUNK);
        let (start, end) = chunks[1];
        let size = u64::from_le_bytes(bytes[start + 25..start + 33].try_into().unwrap());
        for claim in [0, size - 1, size + 1, 1 << 29, MAX_RECORD_BYTES + 1, u64::MAX] {
            let mut damaged = bytes.clone();
            damaged[start + 25..start + 33].copy_from_slice(&claim.to_le_bytes());
            let (found, _) = read(&damaged);
            assert_eq!(found.damages.len(), 1, "{compression:?} claims {claim}: {:?}", found.damages);
            assert_eq!(found.damages[0].bytes, start as u64..end as u64, "{compression:?} claims {claim}");
            let named = matches!(
                found.damages[0].cause,
                Cause::Compression { .. } | Cause::Length { what: "the unpacked chunk", .. }
            );
            assert!(named, "{compression:?} claims {claim}: {:?}", found.damages);
        }
    }
}

#[test]
fn an_attachment_that_is_damaged_is_named_and_the_rest_is_read() {
    let mut bytes = file(chunked(Compression::Zstd));
    let (start, end) = of_kind(&bytes, op::ATTACHMENT)[0];
    bytes[(start + end) / 2] ^= 1;
    let (found, _) = read(&bytes);
    assert_eq!((found.attachments, found.messages.len()), (0, N_MESSAGES as usize));
    assert!(matches!(found.damages[0].cause, Cause::Crc { what: "the attachment", .. }), "{:?}", found.damages);
}

#[test]
fn every_cut_is_a_truncated_file_with_every_whole_record_before_it() {
    for options in [chunked(Compression::Lz4), unchunked()] {
        let bytes = file(options);
        let (mut n_before, whole) = (0, read(&bytes).0.messages);
        for cut in 8..bytes.len() {
            let (found, end) = read(&bytes[..cut]);
            let End::Truncated(damage) = end else { panic!("cut at {cut}: {end:?}") };
            assert_eq!(damage.bytes.end, cut as u64, "cut at {cut}");
            assert!(
                matches!(damage.cause, Cause::Truncated { .. } | Cause::NoFooter | Cause::Malformed { .. }),
                "{damage}"
            );
            assert_eq!(found.damages, [], "cut at {cut}");
            assert_eq!(found.messages, whole[..found.messages.len()], "cut at {cut}");
            assert!(found.messages.len() >= n_before, "cut at {cut}: fewer messages than before");
            n_before = found.messages.len();
        }
        assert_eq!(n_before, N_MESSAGES as usize);
    }
}

#[test]
fn an_empty_file_and_one_of_another_kind_are_named() {
    let error =
        |bytes: &[u8]| Reader::new(Cursor::new(bytes), bytes.len() as u64).read(&mut Contents::default()).unwrap_err();
    assert!(matches!(error(b""), ReadError::Empty));
    assert_eq!(error(b"#ROSBAG V2.0\n").to_string(), "it is no MCAP file");
    assert_eq!(error(b"\x89MCA").to_string(), "it was cut short in its first bytes");
}

/// A generator for tests: small, and the same everywhere.
struct Draw(u64);

impl Draw {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n
    }
}

#[test]
fn no_damage_makes_a_message_that_was_not_written() {
    let mut draw = Draw(5);
    let (mut n_read, mut n_damaged) = (0, 0);
    for compression in Compression::ALL {
        let bytes = file(chunked(compression));
        for round in 0..600 {
            let mut damaged = bytes.clone();
            for _ in 0..=draw.below(3) {
                let at = draw.below(damaged.len());
                match draw.below(5) {
                    0 => damaged[at] ^= 1 << draw.below(8),
                    1 => damaged[at] = draw.below(256) as u8,
                    2 => {
                        let end = (at + 1 + draw.below(600)).min(damaged.len());
                        damaged[at..end].fill([0, 0xff][draw.below(2)]);
                    }
                    3 => {
                        // Bytes are missing, as after a lost block.
                        let end = (at + 1 + draw.below(600)).min(damaged.len());
                        damaged.drain(at..end);
                    }
                    _ => damaged.truncate(at.max(30)),
                }
            }
            let mut found = Contents::default();
            let end = Reader::new(Cursor::new(&damaged), damaged.len() as u64).read(&mut found);
            if end.is_err() {
                continue;
            }
            n_read += found.messages.len();
            n_damaged += found.damages.len();
            for (topic_read, number, data_read) in &found.messages {
                assert!(*number < N_MESSAGES && *data_read == data(*number), "{compression:?}, round {round}");
                let fits = topic_read.is_empty() || topic_read == topic(*number);
                assert!(fits, "{compression:?}, round {round}: message {number} on {topic_read}");
            }
        }
    }
    assert!(
        n_read > 30_000 && n_damaged > 500,
        "{n_read} messages, {n_damaged} damages: too much damage, or too little"
    );
}
