use super::{
    rewrite::{Layout, copy},
    toy::{record, registry},
};
use osteoflow_engine::{
    Recording, ReplayOptions, RunOptions,
    recording::digest::digest,
    recover::{RecoverError, RecoverReport, recover},
    replay,
    validate::validate,
};
use std::{
    fs,
    path::{Path, PathBuf},
};

fn saved(from: &Path, to: &Path) -> Result<RecoverReport, RecoverError> {
    let _ = fs::remove_file(to);
    recover(from, to, &mut |_, _| {})
}

type Flip<'a> = &'a dyn Fn(&mut Vec<u8>);

/// A recording of many small chunks.
fn chunked(dir: &Path) -> PathBuf {
    let original = record(dir, &[], 1);
    let path = dir.join("chunked.mcap");
    copy(&original, &path, &Layout { chunk_bytes: Some(4096), compression: None, shuffle: None, crc: true });
    path
}

/// Offset and length of each chunk.
fn chunks(bytes: &[u8]) -> Vec<(usize, usize)> {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let mut chunks: Vec<_> =
        summary.chunk_indexes.iter().map(|i| (i.chunk_start_offset as usize, i.chunk_length as usize)).collect();
    chunks.sort_unstable();
    chunks
}

/// The recording as version 2 of the format has it: exact messages are the items alone, in an encoding of their own.
fn as_version_2(from: &Path, to: &Path) {
    let bytes = fs::read(from).unwrap();
    let mut writer = mcap::WriteOptions::new().profile("osteoflow").create(fs::File::create(to).unwrap()).unwrap();
    for record in mcap::read::LinearReader::new(&bytes).unwrap() {
        if let mcap::records::Record::Metadata(mut about) = record.unwrap() {
            if about.name == "osteoflow" {
                about.metadata.insert("format_version".into(), "2".into());
            }
            writer.write_metadata(&about).unwrap();
        }
    }
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        let channel = &message.channel;
        if channel.topic.starts_with("/exact/") {
            let schema = channel.schema.as_ref().unwrap();
            let schema = writer.add_schema(&schema.name, "osteoflow-view", b"layout").unwrap();
            let channel_id = writer.add_channel(schema, &channel.topic, "osteoflow-view", &channel.metadata).unwrap();
            let (sequence, log_time, publish_time) = (message.sequence, message.log_time, message.publish_time);
            let head = mcap::records::MessageHeader { channel_id, sequence, log_time, publish_time };
            writer.write_to_known_channel(&head, &message.data[8..]).unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn a_recording_of_version_2_is_refused_by_its_number() {
    let dir = tempfile::tempdir().unwrap();
    let old = dir.path().join("old.mcap");
    as_version_2(&record(dir.path(), &[], 1), &old);
    let replayed = replay(&old, &ReplayOptions::default(), &registry(), &RunOptions::default(), &());
    let validated = validate(&old, &registry(), &mut |_, _| {}).unwrap();
    let out = dir.path().join("out.mcap");
    for refused in [
        saved(&old, &out).unwrap_err().to_string(),
        replayed.unwrap_err().to_string(),
        digest(&old, &mut |_, _| {}).unwrap_err().to_string(),
        validated.findings.iter().map(|finding| format!("{finding}\n")).collect(),
    ] {
        assert!(refused.contains("has format version 2, this program reads version 3"), "{refused}");
    }
    assert!(!out.exists(), "nothing would read it");
}

#[test]
fn a_file_cut_anywhere_gives_every_whole_chunk_in_a_sound_file_that_replays() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = fs::read(chunked(dir.path())).unwrap();
    let chunks = chunks(&bytes);
    let (cut, out) = (dir.path().join("cut.mcap"), dir.path().join("out.mcap"));
    let (mut least, mut n_replayed) = (0, 0);
    for at in (0..bytes.len()).step_by(997) {
        fs::write(&cut, &bytes[..at]).unwrap();
        match saved(&cut, &out) {
            Ok(report) => {
                let n_items: u64 = report.wires.iter().map(|wire| wire.n_items).sum();
                assert!(n_items >= least, "{n_items} items of {at} bytes, {least} of fewer");
                least = n_items;
                let n_whole = chunks.iter().filter(|(start, n)| start + n <= at).count();
                assert!((n_items > 0) == (n_whole > 0), "{at}: {n_items} items of {n_whole} whole chunks");
                let sound = fs::read(&out).unwrap();
                let n_messages = mcap::MessageStream::new(&sound).unwrap().map(Result::unwrap).count();
                assert_eq!(n_messages as u64, report.n_messages, "another reader counts otherwise");
                let counted = !report.lost.iter().any(|lost| lost.contains("osteoflow.wires"));
                assert!(report.wires.iter().all(|wire| wire.missing.is_empty() && wire.open_end != counted), "{at}");
                if n_items > 0 && at % 5 == 0 {
                    let recording = Recording::open(&out).unwrap();
                    assert!(recording.truncated.as_ref().is_some_and(|said| said.contains("recovered")));
                    if recording.wires.contains_key("constant.wave") && recording.wires.len() == 4 {
                        let replayed =
                            replay(&out, &ReplayOptions::default(), &registry(), &RunOptions::default(), &()).unwrap();
                        assert!(replayed.is_equal(), "{at}: {:#?}", replayed.wires);
                        n_replayed += 1;
                    }
                }
            }
            Err(RecoverError::Nothing { .. } | RecoverError::Read(_)) => {
                assert!(at < chunks[0].0 + chunks[0].1, "nothing was saved of {at} bytes");
                assert!(!out.exists(), "a file was left that holds nothing");
            }
            Err(error) => panic!("{at}: {error}"),
        }
    }
    assert!(n_replayed > 5, "only {n_replayed} were replayed");
}

#[test]
fn chunks_behind_a_damaged_one_are_found_and_holes_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = chunked(dir.path());
    let bytes = fs::read(&path).unwrap();
    let chunks = chunks(&bytes);
    let (start, length) = chunks[chunks.len() / 2];
    let (damaged, out) = (dir.path().join("damaged.mcap"), dir.path().join("out.mcap"));
    // Damages the length, the middle of the items and the whole header; the last writes zeros, as a failing disk does.
    let flips: [Flip<'_>; 4] =
        [&|b| b[start + 6] ^= 0x10, &|b| b[start + length / 2] ^= 1, &|b| b[start..start + 60].fill(0xff), &|b| {
            b[start - 100..start + length / 2].fill(0)
        }];
    for (i, flip) in flips.iter().enumerate() {
        let mut copy = bytes.clone();
        flip(&mut copy);
        fs::write(&damaged, &copy).unwrap();
        let report = saved(&damaged, &out).unwrap();
        assert!(!report.is_whole() && report.is_recording(), "{i}: {report:?}");
        let beat = report.wires.iter().find(|wire| wire.wire == "beat.wave").unwrap();
        let n_missing: u64 = beat.missing.iter().map(|r| r.end() - r.start() + 1).sum();
        assert!(n_missing > 0 && n_missing < 10, "{i}: {beat:?}");
        assert_eq!(beat.n_items + n_missing, 40, "{i}: {beat:?}");
        assert_eq!(Some(&beat.before_damage), beat.missing.first().map(|hole| hole.start()), "{i}");
        assert!(report.bytes_lost() < 2 * length as u64 + 500, "{i}: {} bytes", report.bytes_lost());

        // Items keep their numbers: a replay reads only those before the gap.
        let recording = Recording::open(&out).unwrap();
        assert_eq!(recording.wires["beat.wave"].messages.len() as u64, beat.before_damage);
        let replayed = replay(&out, &ReplayOptions::default(), &registry(), &RunOptions::default(), &()).unwrap();
        assert!(replayed.is_equal() && replayed.truncated.is_some(), "{i}: {:#?}", replayed.wires);
        let digests = digest(&out, &mut |_, _| {}).unwrap();
        assert!(digests.incomplete.is_none() && digests.partial.is_some(), "{i}: {digests:?}");
        let wire = digests.wires.iter().find(|wire| wire.wire == "beat.wave").unwrap();
        assert_eq!((wire.n_items, &wire.missing), (beat.n_items, &beat.missing), "{i}");

        // A second recovery changes nothing.
        let again = dir.path().join("again.mcap");
        saved(&out, &again).unwrap();
        assert_eq!(digest(&again, &mut |_, _| {}).unwrap().digest, digests.digest);
        assert_eq!(Recording::open(&again).unwrap().wires["beat.wave"].messages.len() as u64, beat.before_damage);
    }
}

#[test]
fn a_whole_recording_comes_out_whole() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), &[], 2);
    let out = dir.path().join("out.mcap");
    let report = saved(&path, &out).unwrap();
    assert!(report.is_whole(), "{report:?}");
    let [before, after] = [&path, &out].map(|path| digest(path, &mut |_, _| {}).unwrap());
    assert_eq!((before.digest, before.wires, None), (after.digest, after.wires, after.partial));
    assert!(replay(&out, &ReplayOptions::default(), &registry(), &RunOptions::default(), &()).unwrap().is_equal());
}

#[test]
fn nothing_is_overwritten_and_nothing_is_left_of_a_failure() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), &[], 1);
    let out = dir.path().join("out.mcap");
    fs::write(&out, "mine").unwrap();
    assert!(matches!(recover(&path, &out, &mut |_, _| {}), Err(RecoverError::Exists { .. })));
    assert_eq!(fs::read(&out).unwrap(), b"mine");
    assert!(matches!(recover(&path, &path, &mut |_, _| {}), Err(RecoverError::Exists { .. })));
    let text = dir.path().join("text.mcap");
    fs::write(&text, "this is no recording at all, whatever its name says").unwrap();
    let said = saved(&text, &out).unwrap_err().to_string();
    assert!(said.contains("no MCAP file") && !out.exists(), "{said}");
}

#[test]
fn a_damaged_magic_does_not_lose_the_rest() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), &[], 1);
    let mut bytes = fs::read(&path).unwrap();
    bytes[3] ^= 0xff;
    fs::write(&path, &bytes).unwrap();
    let out = dir.path().join("out.mcap");
    let report = saved(&path, &out).unwrap();
    assert_eq!((report.bytes_lost(), report.lost.as_slice()), (8, [].as_slice()));
}
