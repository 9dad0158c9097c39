use super::{
    rewrite::{Layout, copy, rewrite},
    toy::{record, registry},
};
use osteoflow_engine::{
    recover::recover,
    validate::{ValidateReport, validate},
};
use std::{fs, path::Path};

const SMALL: Layout = Layout { chunk_bytes: Some(4096), compression: None, shuffle: None, crc: true };

fn of(path: &Path) -> ValidateReport {
    validate(path, &registry(), &mut |_, _| {}).unwrap()
}

fn messages(report: &ValidateReport) -> Vec<String> {
    report.findings.iter().map(ToString::to_string).collect()
}

/// Asserts that one of the findings contains `expected`.
fn assert_says(report: &ValidateReport, expected: &str) {
    let messages = messages(report);
    assert!(messages.iter().any(|s| s.contains(expected)), "\"{expected}\" is not among {messages:#?}");
}

#[test]
fn what_a_run_leaves_is_sound_and_so_is_it_in_another_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), &[], 4);
    let report = of(&path);
    assert!(report.is_recording && report.is_sound(), "{:#?}", messages(&report));
    assert_eq!(report.notes, [] as [String; 0]);
    let cut = report.wires.iter().find(|wire| wire.wire == "cut.short").unwrap();
    assert_eq!((cut.n_items, cut.n_values, cut.n_views), (40, 32, 32));
    let shuffled = dir.path().join("shuffled.mcap");
    copy(&path, &shuffled, &Layout { shuffle: Some(3), ..SMALL });
    let report = of(&shuffled);
    assert!(report.is_sound(), "{:#?}", messages(&report));
}

#[test]
fn everything_that_is_wrong_with_items_is_found_at_once_with_wire_and_item() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &[], 1);
    let path = dir.path().join("wrong.mcap");
    rewrite(&original, &path, &SMALL, |topic, header, data| match (topic, header.sequence) {
        ("/exact/beat.wave", 3) => false,
        ("/exact/beat.wave", 5) => {
            // The stamp is earlier than that of the item before it.
            data[8..16].copy_from_slice(&7_i64.to_le_bytes());
            header.log_time = 7;
            true
        }
        ("/exact/beat.wave", 6) => {
            header.log_time += 1;
            true
        }
        ("/exact/cut.short", 2) => {
            data.truncate(50);
            true
        }
        ("/exact/cut.short", 10) => {
            data[16] = 9;
            true
        }
        ("/exact/constant.wave", 0) => {
            header.log_time = 3;
            true
        }
        ("/view/cut.short", 1) => {
            data.truncate(3);
            true
        }
        _ => true,
    });
    let report = of(&path);
    assert_says(&report, "wire beat.wave, item 3: missing");
    assert_says(&report, "wire beat.wave, item 5: its stamp 7 is before");
    assert_says(&report, "wire beat.wave, item 6: its log time is 6001001, its stamp 6001000");
    assert_says(&report, "wire cut.short, item 2: the message holds");
    assert_says(&report, "wire cut.short, item 9: the number stands there twice");
    assert_says(&report, "wire cut.short, item 9: its message has sequence 10");
    assert_says(&report, "wire cut.short, item 1: its picture is no JSON");
    assert_says(&report, "wire constant.wave, item 0: it has no time of its own, and its log time 3");
    assert!(
        report.findings.iter().filter(|f| f.item.is_some()).all(|f| f.place.is_some() || f.what.starts_with("missing"))
    );
}

#[test]
fn every_bit_that_is_turned_over_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &["beat.n=6", "beat.rows=3"], 1);
    let path = dir.path().join("small.mcap");
    let bytes = fs::read(&original).unwrap();
    let mut unseen = Vec::new();
    for at in (0..bytes.len()).step_by(23) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        fs::write(&path, &damaged).unwrap();
        if let Ok(report) = validate(&path, &registry(), &mut |_, _| {})
            && report.is_sound()
        {
            unseen.push(at);
        }
    }
    assert_eq!(unseen, [] as [usize; 0], "of {} bytes", bytes.len());
}

#[test]
fn every_cut_is_found_and_what_is_recovered_is_sound_and_says_that_it_is_a_part() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &[], 1);
    let path = dir.path().join("chunked.mcap");
    copy(&original, &path, &SMALL);
    let bytes = fs::read(&path).unwrap();
    for i in 1..20 {
        let at = bytes.len() * i / 20;
        fs::write(&path, &bytes[..at]).unwrap();
        let report = of(&path);
        assert_says(&report, "the file was cut short");
        let out = dir.path().join(format!("{i}.mcap"));
        if recover(&path, &out, &mut |_, _| {}).is_ok() {
            let report = of(&out);
            assert!(report.is_sound(), "{at}: {:#?}", messages(&report));
            assert!(
                report.notes.iter().any(|note| note.contains("is a part of what was recorded")),
                "{:?}",
                report.notes
            );
        }
        // A changed bit is found too.
        let mut damaged = bytes.clone();
        damaged[at] ^= 4;
        fs::write(&path, &damaged).unwrap();
        assert!(!of(&path).is_sound(), "byte {at}");
        let out = dir.path().join(format!("{i}-middle.mcap"));
        recover(&path, &out, &mut |_, _| {}).unwrap();
        let report = of(&out);
        assert!(report.is_sound(), "{at}: {:#?}", messages(&report));
    }
}

#[test]
fn of_a_file_of_another_program_the_container_is_checked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("other.mcap");
    let mut writer = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    let channel = writer.add_channel(0, "/chatter", "json", &Default::default()).unwrap();
    for sequence in 0..50 {
        let header = mcap::records::MessageHeader { channel_id: channel, sequence, log_time: 5, publish_time: 5 };
        writer.write_to_known_channel(&header, b"{}").unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let report = of(&path);
    assert!(report.is_sound() && !report.is_recording, "{:#?}", messages(&report));
    assert!(report.notes[0].contains("no recording of a run"), "{:?}", report.notes);
    assert_eq!(report.n_messages, 50);
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.len() - 60;
    bytes[at] ^= 1;
    fs::write(&path, bytes).unwrap();
    assert!(!of(&path).is_sound());
}

#[test]
fn habits_of_other_writers_are_notes_and_not_faults() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bag.mcap");
    let mut writer = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    let channel = writer.add_channel(0, "/chatter", "cdr", &Default::default()).unwrap();
    let header = mcap::records::MessageHeader { channel_id: channel, sequence: 1, log_time: 5, publish_time: 5 };
    writer.write_to_known_channel(&header, b"{}").unwrap();
    for version in ["1", "2"] {
        let metadata = [("serialized_metadata".to_owned(), version.to_owned())].into();
        writer.write_metadata(&mcap::records::Metadata { name: "rosbag2".into(), metadata }).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let report = of(&path);
    assert!(report.is_sound(), "{:#?}", messages(&report));
    let habit = report.notes.iter().find(|note| note.contains("a second metadata record \"rosbag2\"")).unwrap();
    assert!(habit.ends_with("a habit of its writer"), "{habit}");

    // In a recording of a run each record stands once.
    let run = record(dir.path(), &[], 1);
    let mut bytes = fs::read(&run).unwrap();
    // A record of metadata begins with its operation code and length, then its name.
    let name = b"\x09\0\0\0osteoflow";
    let mut names = (9..bytes.len() - 13).filter(|&at| bytes[at..].starts_with(name) && bytes[at - 9] == 0x0c);
    let start = names.next().unwrap() - 9;
    let length = u64::from_le_bytes(bytes[start + 1..start + 9].try_into().unwrap()) as usize;
    let again = bytes[start..start + 9 + length].to_vec();
    bytes.splice(start..start, again);
    fs::write(&run, bytes).unwrap();
    assert_says(&of(&run), "a second metadata record \"osteoflow\"");
}

#[test]
fn what_one_bad_chunk_takes_with_it_is_said_once() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &[], 1);
    let path = dir.path().join("chunked.mcap");
    copy(&original, &path, &Layout { crc: true, ..SMALL });
    let whole = of(&path);
    assert!(whole.is_sound() && whole.n_chunks > 3, "{} chunks", whole.n_chunks);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(&path, bytes).unwrap();
    let report = of(&path);
    let lost = messages(&report);
    assert_eq!((lost.len(), report.n_findings), (2, 2), "the damage and what it took: {lost:#?}");
    let (n_lost, n) = (whole.n_messages - report.n_messages, whole.n_messages);
    assert!(lost[1].contains(&format!("missing with the damage: {n_lost} of {n} messages, 1 of ")), "{lost:#?}");
    assert!(lost[1].contains("wires that lack items: "), "{lost:#?}");
}

#[test]
fn after_a_kill_the_item_that_a_log_time_comes_from_may_be_lost_but_no_other_log_time_is_taken() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &[], 1);
    let [whole, killed, recovered] = ["whole", "killed", "recovered"].map(|name| dir.path().join(name));
    for (has_time, n_items) in [(false, 1), (true, 2)] {
        rewrite(&original, &whole, &SMALL, |topic, header, _| match (topic, header.sequence) {
            ("/exact/constant.wave", 0) => {
                header.log_time = 5_000_000_000;
                true
            }
            ("/exact/beat.wave", 1) => has_time,
            _ => false,
        });
        let wrong = "wire constant.wave, item 0: it has no time of its own, and its log time 5000000000";
        assert_says(&of(&whole), wrong);
        let bytes = fs::read(&whole).unwrap();
        let name = b"osteoflow.wires";
        let counts = bytes.windows(name.len()).position(|window| window == name).unwrap();
        // Before the name is the head of its record: a byte, and two lengths.
        fs::write(&killed, &bytes[..counts - (1 + 8 + 4)]).unwrap();
        recover(&killed, &recovered, &mut |_, _| {}).unwrap();
        let report = of(&recovered);
        assert_eq!(report.wires.iter().map(|wire| wire.n_items).sum::<u64>(), n_items);
        if has_time {
            assert_says(&report, wrong);
        } else {
            assert!(report.is_sound(), "{:#?}", messages(&report));
        }
        fs::remove_file(&recovered).unwrap();
    }
}
