//! A target of tests/fuzz under libFuzzer; `run` beside this file starts it.
//!
//! `OSTEOFLOW_FUZZ_TARGET` names the target. With `OSTEOFLOW_FUZZ_SEEDS` its seeds are written into that folder, and nothing is tried.
#![no_main]

#[path = "../border.rs"]
mod border;
#[path = "../../../nodes/bone/formats/tests/layouts.rs"]
mod layouts;
#[path = "../seeds.rs"]
mod seeds;
#[path = "../targets.rs"]
mod targets;

use libfuzzer_sys::{Corpus, fuzz_target};
use std::{env, fs, path::Path, process, sync::LazyLock};
use targets::{TARGETS, Target, read_as};
use tempfile::TempDir;

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = env::var("OSTEOFLOW_FUZZ_TARGET").unwrap_or_default();
    TARGETS.iter().find(|target| target.name == name).unwrap_or_else(|| {
        let names: Vec<_> = TARGETS.iter().map(|target| target.name).collect();
        eprintln!("OSTEOFLOW_FUZZ_TARGET is {name:?}, and should be one of {}", names.join(" "));
        process::exit(2)
    })
});

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder for temporary files"));

/// The first byte chooses the ending of the file.
fn try_bytes(bytes: &[u8]) -> Corpus {
    let Some((first, bytes)) = bytes.split_first() else { return Corpus::Reject };
    let ending = TARGET.endings[usize::from(*first) % TARGET.endings.len()];
    let _ = read_as(*TARGET, ending, bytes, FOLDER.path());
    Corpus::Keep
}

fn write_seeds(folder: &Path) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    for (index, (ending, bytes)) in seeds::seeds(*TARGET, &root).into_iter().enumerate() {
        let first = TARGET.endings.iter().position(|known| *known == ending).expect("an ending of the target");
        let bytes = [&[first as u8], &bytes[..]].concat();
        fs::write(folder.join(format!("seed-{index}")), bytes).expect("the folder can be written");
    }
}

fuzz_target!(
    init: {
        if let Some(folder) = env::var_os("OSTEOFLOW_FUZZ_SEEDS") {
            write_seeds(Path::new(&folder));
            process::exit(0);
        }
    },
    |bytes: &[u8]| -> Corpus { try_bytes(bytes) }
);
