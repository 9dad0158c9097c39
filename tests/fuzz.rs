//! Hostile bytes for every reader: a bounded number of mutated files from fixed seeds (docs/use/security.md).

#[cfg(unix)]
mod border;
mod seeds;
mod targets;

use crate::common::layouts;
use osteoflow_node::rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seeds::seeds;
use std::{
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::OnceLock,
};
use targets::{TARGETS, Target, read_as};

/// Numbers that readers stumble over, as text.
const ABSURD: [&str; 8] = ["1e400", "-1", "nan", "99999999999999999999", "0", "1e-400", "4294967296", "\"\""];

fn mutate(bytes: &mut Vec<u8>, other: &[u8], rng: &mut ChaCha8Rng) {
    for _ in 0..rng.random_range(1..5) {
        let n = bytes.len().max(1);
        let (at, length) = (rng.random_range(0..n), rng.random_range(1..40));
        let end = (at + length).min(bytes.len());
        match rng.random_range(0..9) {
            0 | 1 if at < bytes.len() => bytes[at] ^= 1 << rng.random_range(0..8),
            2 if at < bytes.len() => bytes[at] = [0, 0xff, 0x7f, 0x80, b'0', b'\n'][rng.random_range(0..6)],
            3 if at < end => drop(bytes.drain(at..end)),
            4 if at < end => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            5 => bytes.truncate(at),
            6 if !other.is_empty() => {
                let from = rng.random_range(0..other.len());
                let piece = other[from..(from + length).min(other.len())].to_vec();
                bytes.splice(at.min(bytes.len())..end.max(at.min(bytes.len())), piece);
            }
            7 => {
                // A number of the text.
                let Some(start) = bytes[at.min(bytes.len())..].iter().position(u8::is_ascii_digit).map(|k| k + at)
                else {
                    continue;
                };
                let n_digits = bytes[start..].iter().take_while(|byte| byte.is_ascii_digit()).count();
                let number = ABSURD[rng.random_range(0..ABSURD.len())];
                bytes.splice(start..start + n_digits, number.bytes());
            }
            8 if at + 8 <= bytes.len() => bytes[at..at + 8].copy_from_slice(&rng.next_u64().to_le_bytes()),
            _ => {}
        }
    }
}

/// The seeds of a target, made once.
fn seeds_of(target: &Target) -> &'static [(String, Vec<u8>)] {
    type Seeds = Vec<(String, Vec<u8>)>;
    static SEEDS: [OnceLock<Seeds>; TARGETS.len()] = [const { OnceLock::new() }; TARGETS.len()];
    let at = TARGETS.iter().position(|other| other.name == target.name).unwrap();
    SEEDS[at].get_or_init(|| seeds(target, crate::common::root()))
}

/// Otherwise a target would try its first refusal only.
#[test]
fn each_target_takes_what_is_sound() {
    let mut missing = Vec::new();
    for target in TARGETS {
        let folder = tempfile::tempdir().unwrap();
        let seeds = seeds_of(target);
        let taken = seeds.iter().filter(|(ending, bytes)| read_as(target, ending, bytes, folder.path()));
        let taken: Vec<_> = taken.map(|(ending, _)| &**ending).collect();
        println!("{}: {} of {} seeds are taken", target.name, taken.len(), seeds.len());
        for ending in target.endings.iter().filter(|ending| !taken.contains(ending)) {
            missing.push(format!("{}: no .{ending}", target.name));
        }
        if ["payload", "process", "openigtlink", "message"].contains(&target.name) && taken.len() < seeds.len() {
            missing.push(format!("{}: {} of {}", target.name, taken.len(), seeds.len()));
        }
    }
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn no_reader_panics_on_hostile_bytes() {
    let n_rounds = if crate::common::is_slow_run() { 20_000 } else { 100 };
    for target in TARGETS {
        let folder = tempfile::tempdir().unwrap();
        let seeds = seeds_of(target);
        let mut rng = ChaCha8Rng::seed_from_u64(22);
        for round in 0..n_rounds {
            let (ending, seed) = &seeds[rng.random_range(0..seeds.len())];
            let other = &seeds[rng.random_range(0..seeds.len())].1;
            let mut bytes = seed.clone();
            mutate(&mut bytes, other, &mut rng);
            let read = catch_unwind(AssertUnwindSafe(|| read_as(target, ending, &bytes, folder.path())));
            if read.is_err() {
                let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-{round}.{ending}", target.name));
                fs::write(&kept, &bytes).unwrap();
                panic!("{} panics in round {round}; the file is {}", target.name, kept.display());
            }
        }
    }
}
