//! Readers of damaged files return a result or an error. They neither panic nor loop forever, and allocate memory in
//! proportion to the size of the file.

use super::{
    rewrite::{Draw, Layout, copy},
    toy::{record, registry},
};
use mcap::Compression;
use osteoflow_engine::{
    Recording,
    diff::{DiffOptions, diff},
    recording::digest::digest,
    recover::recover,
    validate::validate,
};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Maximum size of the buffers of readers and writers, for any file. The largest are the search window after damage and
/// a chunk of the recovered file.
const BUFFERS_BYTES: u64 = 12 << 20;
/// Maximum ratio of decoded size to file size: a field of six bytes becomes a name and a value in memory.
const TIMES: u64 = 40;

const ABSURD: [u64; 9] = [0, 1, 0xffff, u32::MAX as u64, 1 << 30, (1 << 30) + 1, 1 << 40, i64::MAX as u64, u64::MAX];

/// A way to read a file: its name, and a function that returns whether it succeeded.
type Way<'a> = (&'static str, &'a dyn Fn(&Path) -> bool);

struct Bench {
    dir: tempfile::TempDir,
    whole: PathBuf,
    n_answers: u64,
}

impl Bench {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let whole = record(&dir.path().join("run"), &["beat.n=6", "beat.rows=3"], 1);
        Self { dir, whole, n_answers: 0 }
    }

    /// The same items in files of several layouts, which detect damage at different places.
    fn files(&self) -> Vec<Vec<u8>> {
        let layouts = [
            (Some(1500), Some(Compression::Zstd), true),
            (Some(1500), Some(Compression::Lz4), false),
            (Some(1500), None, false),
            (None, None, false),
        ];
        let mut files = vec![fs::read(&self.whole).unwrap()];
        for (chunk_bytes, compression, crc) in layouts {
            let path = self.dir.path().join("layout.mcap");
            copy(&self.whole, &path, &Layout { chunk_bytes, compression, shuffle: None, crc });
            files.push(fs::read(path).unwrap());
        }
        files
    }

    /// Reads a file in every way, and checks the memory and the recovered file.
    fn survives(&mut self, bytes: &[u8], what: &str) {
        let path = self.dir.path().join("damaged.mcap");
        fs::write(&path, bytes).unwrap();
        let n_bytes = bytes.len() as u64;
        let out = self.dir.path().join("out.mcap");
        let _ = fs::remove_file(&out);
        let ways: [Way<'_>; 5] = [
            ("open", &|path| Recording::open(path).is_ok()),
            ("digest", &|path| digest(path, &mut |_, _| {}).is_ok()),
            ("validate", &|path| validate(path, &registry(), &mut |_, _| {}).is_ok()),
            ("recover", &|path| recover(path, &out, &mut |_, _| {}).is_ok()),
            ("diff", &|path| diff(&self.whole, path, &DiffOptions::default(), &mut |_, _| {}).is_ok()),
        ];
        for (way, read) in ways {
            let mut ok = false;
            let asked = allocation_counter::measure(|| ok = read(&path));
            self.n_answers += u64::from(ok);
            let bound = BUFFERS_BYTES + TIMES * n_bytes;
            assert!(
                asked.bytes_max < bound,
                "{way} asked for {} bytes of a file of {n_bytes}: {what}",
                asked.bytes_max
            );
        }
        // The recovered file has an intact container.
        if out.exists() {
            let sound = validate(&out, &registry(), &mut |_, _| {}).unwrap();
            let container: Vec<_> = sound.findings.iter().filter(|finding| finding.wire.is_none()).collect();
            let told = |f: &&&osteoflow_engine::validate::Finding| f.place.is_some();
            assert!(!container.iter().any(|f| told(&f)), "recovered from {what}: {container:?}");
        }
    }
}

/// Number of rounds: `n`, or 50 times as many with `SLOW_TESTS`.
fn rounds(n: u64) -> u64 {
    if std::env::var_os("SLOW_TESTS").is_some() { n * 50 } else { n }
}

#[test]
fn absurd_lengths_in_every_record_ask_for_no_memory() {
    let mut bench = Bench::new();
    for (i, file) in bench.files().into_iter().enumerate() {
        // In every record, or every third: its length, and each field after it that can be a length.
        let (mut at, mut n_records) = (8, i as u64);
        let every = if rounds(1) == 1 { 3 } else { 1 };
        while at + 9 < file.len() {
            let length = u64::from_le_bytes(file[at + 1..at + 9].try_into().unwrap()) as usize;
            let fields: &[usize] = if n_records.is_multiple_of(every) { &[1, 9, 11, 17, 25, 37] } else { &[] };
            n_records += 1;
            for (field, absurd) in fields.iter().enumerate().map(|(k, field)| (field, ABSURD[(k + at) % ABSURD.len()]))
            {
                let mut damaged = file.clone();
                let place = (at + field).min(file.len() - 1);
                let n = (file.len() - place).min(8);
                damaged[place..place + n].copy_from_slice(&absurd.to_le_bytes()[..n]);
                bench.survives(&damaged, &format!("file {i}, {absurd:#x} at byte {place}"));
            }
            at += 9 + length;
        }
    }
}

#[test]
fn bits_turned_over_bytes_overwritten_and_cuts_are_survived() {
    let mut bench = Bench::new();
    let files = bench.files();
    let mut draw = Draw(11);
    for round in 0..rounds(100) {
        let mut file = files[draw.below(files.len() as u64) as usize].clone();
        let n = file.len() as u64;
        for _ in 0..=draw.below(3) {
            let at = draw.below(n) as usize;
            match draw.below(5) {
                0 => file[at] ^= 1 << draw.below(8),
                1 => {
                    let absurd = ABSURD[draw.below(ABSURD.len() as u64) as usize].to_le_bytes();
                    let end = (at + 8).min(file.len());
                    file[at..end].copy_from_slice(&absurd[..end - at]);
                }
                2 => {
                    let end = (at + draw.below(300) as usize).min(file.len());
                    file[at..end].fill(draw.below(256) as u8);
                }
                3 => {
                    // A part of the file is duplicated.
                    let end = (at + draw.below(500) as usize).min(file.len());
                    let part = file[at..end].to_vec();
                    let to = draw.below(file.len() as u64) as usize;
                    file.splice(to..to, part);
                }
                _ => file.truncate(at.max(1)),
            }
            if file.len() < n as usize {
                break;
            }
        }
        bench.survives(&file, &format!("round {round}"));
    }
    assert!(bench.n_answers > 70, "{} answers: the damage leaves nothing to read", bench.n_answers);
}

#[test]
fn a_chunk_that_claims_what_it_does_not_hold_is_refused_without_room_for_it() {
    let mut bench = Bench::new();
    for compression in [Some(Compression::Zstd), Some(Compression::Lz4), None] {
        let path = bench.dir.path().join("chunks.mcap");
        copy(&bench.whole, &path, &Layout { chunk_bytes: Some(1 << 20), compression, shuffle: None, crc: false });
        let file = fs::read(&path).unwrap();
        let summary = mcap::Summary::read(&file).unwrap().unwrap();
        let at = summary.chunk_indexes[0].chunk_start_offset as usize;
        for absurd in ABSURD {
            let mut damaged = file.clone();
            // The size of the unpacked chunk.
            damaged[at + 25..at + 33].copy_from_slice(&absurd.to_le_bytes());
            bench.survives(&damaged, &format!("{compression:?} claims {absurd:#x}"));
            let path = bench.dir.path().join("damaged.mcap");
            let report = validate(&path, &registry(), &mut |_, _| {}).unwrap();
            assert!(!report.is_sound(), "{compression:?} claims {absurd:#x}, and nobody minds");
        }
    }
}

#[test]
fn what_is_read_of_a_large_file_is_held_a_chunk_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), &["beat.n=400", "beat.rows=8000", "record.views=false"], 2);
    let n_bytes = fs::metadata(&path).unwrap().len();
    assert!(n_bytes > 40 << 20, "only {n_bytes} bytes");
    let out = dir.path().join("out.mcap");
    let ways: [(&str, &dyn Fn()); 4] = [
        ("digest", &|| drop(digest(&path, &mut |_, _| {}).unwrap())),
        ("validate", &|| drop(validate(&path, &registry(), &mut |_, _| {}).unwrap())),
        ("recover", &|| drop(recover(&path, &out, &mut |_, _| {}).unwrap())),
        ("diff", &|| drop(diff(&path, &path, &DiffOptions::default(), &mut |_, _| {}).unwrap())),
    ];
    for (way, read) in ways {
        let asked = allocation_counter::measure(read);
        assert!(asked.bytes_max < BUFFERS_BYTES, "{way} holds {} of {n_bytes} bytes", asked.bytes_max);
    }
}

#[test]
fn no_command_answers_a_changed_bit_without_a_word() {
    let mut bench = Bench::new();
    let whole = fs::read(&bench.whole).unwrap();
    let (path, out) = (bench.dir.path().join("damaged.mcap"), bench.dir.path().join("out.mcap"));
    let mut draw = Draw(22);
    let mut n_unsound = 0;
    for _ in 0..rounds(700) {
        let mut bytes = whole.clone();
        let (at, bit) = (draw.below(bytes.len() as u64) as usize, draw.below(8));
        bytes[at] ^= 1 << bit;
        fs::write(&path, &bytes).unwrap();
        let is_sound = |path: &Path| validate(path, &registry(), &mut |_, _| {}).is_ok_and(|report| report.is_sound());
        if is_sound(&path) {
            continue;
        }
        n_unsound += 1;
        let what = format!("bit {bit} of byte {at} of {}", bytes.len());
        let digest = digest(&path, &mut |_, _| {});
        assert!(digest.is_err() || digest.is_ok_and(|report| report.incomplete.is_some()), "digest: {what}");
        let diff = diff(&bench.whole, &path, &DiffOptions::default(), &mut |_, _| {});
        assert!(diff.is_err() || diff.is_ok_and(|report| report.sides[1].incomplete.is_some()), "diff: {what}");
        let opened = Recording::open(&path);
        let says = |recording: Recording| recording.truncated.is_some() || recording.unsound.is_some();
        assert!(opened.is_err() || opened.is_ok_and(says), "open: {what}");
        let _ = fs::remove_file(&out);
        let recovered = recover(&path, &out, &mut |_, _| {});
        assert!(recovered.is_err() || recovered.is_ok_and(|report| !report.is_whole()), "recover: {what}");
    }
    assert_eq!(n_unsound, rounds(700), "a changed bit that nothing finds");
    bench.n_answers += n_unsound;
}
