use super::{
    rewrite::{Layout, copy, rewrite},
    toy::{checked, record, registry},
};
use mcap::Compression;
use osteoflow_engine::{ReplayOptions, RunOptions, recording::digest::DigestReport, recording::digest::digest, replay};
use std::{fs, path::Path};

fn of(path: &Path) -> DigestReport {
    digest(path, &mut |_, _| {}).unwrap()
}

#[test]
fn runs_of_one_graph_have_one_digest_on_one_worker_and_on_eight() {
    let dir = tempfile::tempdir().unwrap();
    let [one, eight, other] = [(1, "gain=1.0"), (8, "gain=1.0"), (2, "gain=2.0")].map(|(workers, gain)| {
        let out = dir.path().join(format!("{workers}"));
        of(&record(&out, &[&format!("cut.{gain}")], workers))
    });
    assert_eq!(one.incomplete, None);
    assert_eq!((one.digest, &one.wires), (eight.digest, &eight.wires));
    let differ: Vec<_> = one.wires.iter().zip(&other.wires).filter(|(a, b)| a.digest != b.digest).collect();
    let names: Vec<_> = differ.iter().map(|(a, _)| a.wire.as_str()).collect();
    assert_eq!(names, ["cut.short", "pass.out"], "the gain of cut changes what it gives and what follows");
    let cut = &one.wires[2];
    assert_eq!((cut.wire.as_str(), cut.n_items, cut.n_values), ("cut.short", 40, 32));
}

#[test]
fn order_chunks_compression_and_log_times_do_not_change_a_digest() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &[], 2);
    let expected = of(&original);
    let layouts = [
        (Some(1 << 10), Some(Compression::Lz4), Some(1)),
        (Some(1 << 22), None, Some(2)),
        (None, None, Some(3)),
        (Some(300), Some(Compression::Zstd), None),
    ];
    for (i, (chunk_bytes, compression, shuffle)) in layouts.into_iter().enumerate() {
        let path = dir.path().join(format!("{i}.mcap"));
        let layout = Layout { chunk_bytes, compression, shuffle, crc: true };
        rewrite(&original, &path, &layout, |_, header, _| {
            header.log_time += 17;
            true
        });
        let found = of(&path);
        assert_eq!((found.digest, &found.wires), (expected.digest, &expected.wires), "layout {i}");
    }
}

#[test]
fn a_recording_in_another_order_replays_and_so_does_a_wire_that_takes_anything() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &[], 2);
    let path = dir.path().join("shuffled.mcap");
    copy(&original, &path, &Layout { chunk_bytes: Some(4096), compression: None, shuffle: Some(9), crc: true });
    let report = replay(&path, &ReplayOptions::default(), &registry(), &RunOptions::default(), &()).unwrap();
    assert!(report.is_equal(), "{:#?}", report.wires);
    let recording = osteoflow_engine::Recording::open(&path).unwrap();
    let items = recording.items("pass.out", &registry()).unwrap();
    assert_eq!(items.len(), 40);
    assert_eq!(checked(&[]).plan.nodes.len(), 4);
}

#[test]
fn a_file_cut_short_is_digested_as_far_as_it_goes_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), &["beat.n=300", "beat.rows=500"], 1);
    let whole = of(&path);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let part = of(&path);
    assert!(part.incomplete.as_ref().is_some_and(|said| said.contains("cut short")), "{:?}", part.incomplete);
    assert!(part.wires[0].n_items > 20 && part.wires[0].n_items < 300, "{:?}", part.wires);
    assert_ne!(part.digest, whole.digest);
    fs::write(&path, &bytes[..2000]).unwrap();
    assert!(of(&path).incomplete.is_some(), "nothing but the graph is left, and nothing is missed");
}

#[test]
fn a_wire_with_two_items_of_one_number_has_no_digest() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(dir.path(), &[], 1);
    let path = dir.path().join("doubled.mcap");
    let layout = Layout { chunk_bytes: Some(4096), compression: None, shuffle: None, crc: true };
    rewrite(&original, &path, &layout, |topic, _, data| {
        if topic == "/exact/cut.short" && data[16] == 8 {
            data[16] = 7;
        }
        true
    });
    let report = of(&path);
    assert_eq!(report.digest, None);
    let said = report.incomplete.unwrap();
    assert!(said.contains("wire cut.short holds item 7 twice"), "{said}");
}
