//! What the writer refuses, when it writes, and what a sink that fails leaves.

use osteoflow_container::{
    Attachment, Compression, MAX_RECORD_BYTES, MESSAGE_HEADER_BYTES, MessageHeader, Segments, SharedBytes, Sink,
    WriteOptions, Writer,
};
use std::{
    cell::RefCell,
    collections::BTreeMap,
    fs::File,
    io::{self, Read, Seek, Write},
    rc::Rc,
    sync::Arc,
};

fn options() -> WriteOptions {
    WriteOptions { compression: Compression::None, ..WriteOptions::default() }
}

fn header(channel_id: u16, log_time: u64) -> MessageHeader {
    MessageHeader { channel_id, sequence: 0, log_time, publish_time: 0 }
}

fn no_entries() -> BTreeMap<String, String> {
    BTreeMap::new()
}

/// A file in memory that can still be looked at.
#[derive(Clone, Default)]
struct Shared(Rc<RefCell<Vec<u8>>>);

impl Shared {
    fn n_bytes(&self) -> usize {
        self.0.borrow().len()
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Sink for Shared {
    fn truncate(&mut self, n_bytes: u64) -> io::Result<()> {
        Sink::truncate(&mut *self.0.borrow_mut(), n_bytes)
    }
}

#[test]
fn what_was_not_added_cannot_be_used() {
    let mut writer = Writer::new(Vec::new(), options()).unwrap();
    let said = |error: io::Error| (error.kind(), error.to_string());
    let invalid = |text: &str| (io::ErrorKind::InvalidInput, text.to_owned());
    let error = writer.add_channel(1, "/a", "raw", &no_entries()).unwrap_err();
    assert_eq!(said(error), invalid("Channel `/a` referenced unknown schema 1"));
    assert_eq!(writer.add_schema("S", "e", b"1").unwrap(), 1);
    assert_eq!(writer.add_schema("S", "e", b"2").unwrap(), 2, "other data are another schema");
    assert_eq!(writer.add_schema("S", "e", b"1").unwrap(), 1);
    assert_eq!(writer.add_schema("S", "e", b"2").unwrap(), 2);
    for (schema, id) in [(0, 1), (1, 2), (2, 3)] {
        assert_eq!(writer.add_channel(schema, "/a", "raw", &no_entries()).unwrap(), id);
    }
    assert!(writer.add_channel(3, "/a", "raw", &no_entries()).is_err());
    for channel in [0, 4] {
        let error = writer.write_message(header(channel, 1), Segments::default()).unwrap_err();
        assert_eq!(said(error), invalid(&format!("Message 0 referenced unknown channel {channel}")));
    }
    for channel in 1..=3 {
        writer.write_message(header(channel, 1), Segments::default()).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn a_chunk_is_written_when_it_is_large_enough_or_asked_for() {
    let sink = Shared::default();
    let mut writer = Writer::new(sink.clone(), WriteOptions { chunk_bytes: 500, ..options() }).unwrap();
    let start = sink.n_bytes();
    assert!(!writer.has_pending());
    writer.flush().unwrap();
    assert_eq!(sink.n_bytes(), start, "no empty chunk is written");
    let channel = writer.add_channel(0, "", "", &no_entries()).unwrap();
    assert!(writer.has_pending());
    // 9 + 16 bytes of the channel, and 31 of the message's header, leave 444 up to 500.
    writer.write_message(header(channel, 1), vec![7; 443].into()).unwrap();
    assert!(writer.has_pending());
    assert_eq!(sink.n_bytes(), start);
    writer.flush().unwrap();
    let first = sink.n_bytes();
    assert!(first > start && !writer.has_pending());
    writer.write_message(header(channel, 1), vec![7; 500 - 31].into()).unwrap();
    assert!(sink.n_bytes() > first && !writer.has_pending(), "exactly 500 bytes");
}

#[test]
fn no_chunk_is_longer_than_the_longest_record() {
    // Zeros that are never touched take no memory.
    let zeros = |n: u64| {
        let mut data = Segments::default();
        data.push_shared(&(Arc::new(vec![0_u8; n as usize]) as SharedBytes));
        data
    };
    let largest = MAX_RECORD_BYTES - MESSAGE_HEADER_BYTES;
    for (n, is_flushed) in [(largest - 31 - 25, false), (largest - 31 - 24, true), (largest, true)] {
        let sink = Shared::default();
        let mut writer = Writer::new(sink.clone(), WriteOptions { chunk_bytes: usize::MAX, ..options() }).unwrap();
        let start = sink.n_bytes();
        let channel = writer.add_channel(0, "", "", &no_entries()).unwrap();
        writer.write_message(header(channel, 1), Segments::default()).unwrap();
        writer.write_message(header(channel, 1), zeros(n)).unwrap();
        assert_eq!(sink.n_bytes() > start, is_flushed, "{n} bytes after {}", 25 + 31);
    }
    let mut writer = Writer::new(Vec::new(), options()).unwrap();
    let channel = writer.add_channel(0, "", "", &no_entries()).unwrap();
    let error = writer.write_message(header(channel, 1), zeros(largest + 1)).unwrap_err();
    let expected = format!("a message of {} bytes; at most {MAX_RECORD_BYTES} are written", MAX_RECORD_BYTES + 1);
    assert_eq!((error.kind(), error.to_string()), (io::ErrorKind::InvalidInput, expected));
    // Opcode and length, two times, two texts, the length of the data and the CRC come beside the data.
    let data = vec![0; MAX_RECORD_BYTES as usize - (9 + 16 + 5 + 4 + 8 + 4) + 1];
    let attachment = Attachment { log_time: 0, create_time: 0, name: "n", media_type: "", data: &data };
    let said = writer.write_attachment(&attachment).unwrap_err().to_string();
    assert_eq!(said, format!("a attachment of {} bytes; at most {MAX_RECORD_BYTES} are written", MAX_RECORD_BYTES + 1));
}

#[test]
fn the_times_of_a_chunk_and_of_the_file_are_the_first_and_the_last_in_any_order() {
    for chunks in [true, false] {
        let mut writer = Writer::new(Vec::new(), WriteOptions { chunks, ..options() }).unwrap();
        let channel = writer.add_channel(0, "/a", "raw", &no_entries()).unwrap();
        for times in [[50, 30, 70], [20, 10, 40]] {
            for time in times {
                writer.write_message(header(channel, time), vec![1].into()).unwrap();
            }
            writer.flush().unwrap();
        }
        let bytes = writer.finish().unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let statistics = summary.stats.unwrap();
        assert_eq!((statistics.message_start_time, statistics.message_end_time), (10, 70));
        let spans: Vec<_> = summary.chunk_indexes.iter().map(|c| (c.message_start_time, c.message_end_time)).collect();
        assert_eq!(spans, if chunks { vec![(30, 70), (10, 40)] } else { vec![] });
    }
}

/// Takes a few bytes at a time, is interrupted before each, and fails behind `n_bytes`.
struct Slow {
    bytes: Vec<u8>,
    n_bytes: usize,
    is_interrupted: bool,
    failure: fn() -> io::Result<usize>,
    truncated: Rc<RefCell<Vec<u64>>>,
}

impl Write for Slow {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.is_interrupted = !self.is_interrupted;
        if self.is_interrupted {
            return Err(io::ErrorKind::Interrupted.into());
        }
        let n = bytes.len().min(7).min(self.n_bytes - self.bytes.len());
        if n == 0 {
            return (self.failure)();
        }
        self.bytes.extend(&bytes[..n]);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Sink for Slow {
    fn truncate(&mut self, n_bytes: u64) -> io::Result<()> {
        self.truncated.borrow_mut().push(n_bytes);
        Sink::truncate(&mut self.bytes, n_bytes)
    }
}

fn write_all<W: Sink>(sink: W) -> io::Result<W> {
    let mut writer = Writer::new(sink, options())?;
    let channel = writer.add_channel(0, "/a", "raw", &no_entries())?;
    writer.write_message(header(channel, 1), vec![7; 100].into())?;
    writer.write_metadata("m", &no_entries())?;
    writer.finish()
}

#[test]
fn a_sink_that_takes_little_and_is_interrupted_gets_every_byte() {
    let failure = || unreachable!("it takes all bytes");
    let truncated = Rc::<RefCell<Vec<u64>>>::default();
    let slow =
        Slow { bytes: Vec::new(), n_bytes: usize::MAX, is_interrupted: false, failure, truncated: truncated.clone() };
    assert_eq!(write_all(slow).unwrap().bytes, write_all(Vec::new()).unwrap());
    assert!(truncated.borrow().is_empty());
}

#[test]
fn a_sink_that_fails_is_shortened_to_the_last_whole_record() {
    let whole = write_all(Vec::new()).unwrap();
    let first = 8 + 9 + 8;
    for (failure, kind) in [
        ((|| Ok(0)) as fn() -> io::Result<usize>, io::ErrorKind::WriteZero),
        (|| Err(io::ErrorKind::StorageFull.into()), io::ErrorKind::StorageFull),
    ] {
        for n_bytes in [0, 5, first, first + 20, whole.len() - 30] {
            let truncated = Rc::<RefCell<Vec<u64>>>::default();
            let slow =
                Slow { bytes: Vec::new(), n_bytes, is_interrupted: false, failure, truncated: truncated.clone() };
            let error = write_all(slow).err().unwrap();
            assert_eq!(error.kind(), kind, "{n_bytes} bytes");
            let ends = truncated.borrow();
            assert_eq!(ends.len(), 1, "{ends:?}");
            assert!(ends[0] <= n_bytes as u64 && (ends[0] == 0 || ends[0] >= first as u64), "{ends:?} of {n_bytes}");
            assert_eq!(ends[0] == 0, n_bytes < first, "{ends:?} of {n_bytes}");
        }
    }
}

#[test]
fn sinks_are_shortened() {
    let mut bytes = vec![1, 2, 3, 4];
    Sink::truncate(&mut bytes, 2).unwrap();
    assert_eq!(bytes, [1, 2]);
    let mut file = tempfile::tempfile().unwrap();
    file.write_all(&[1, 2, 3, 4]).unwrap();
    <File as Sink>::truncate(&mut file, 3).unwrap();
    file.rewind().unwrap();
    let mut read = Vec::new();
    file.read_to_end(&mut read).unwrap();
    assert_eq!(read, [1, 2, 3]);
}
