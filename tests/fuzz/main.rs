//! Hostile bytes for every reader: a bounded number of mutated files from fixed seeds (docs/security.md).
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

#[path = "../common/mod.rs"]
mod common;
mod targets;

use osteoflow_node::rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::{
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
};
use targets::{TARGETS, Target, read_as};

/// Longer files are cut, so that many are tried.
const MAX_SEED_BYTES: usize = 60_000;
/// Numbers that readers stumble over, as text.
const ABSURD: [&str; 8] = ["1e400", "-1", "nan", "99999999999999999999", "0", "1e-400", "4294967296", "\"\""];

/// Files of the repository that a target reads, with their endings.
fn seeds(target: &Target) -> Vec<(String, Vec<u8>)> {
    let mut folders: Vec<PathBuf> = ["tests/data", "graphs"].iter().map(|folder| common::root().join(folder)).collect();
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    let ending = |path: &Path| path.extension().unwrap_or_default().to_string_lossy().into_owned();
    let read = |path: &PathBuf| {
        let mut bytes = fs::read(path).unwrap();
        bytes.truncate(MAX_SEED_BYTES);
        (ending(path), bytes)
    };
    let mut seeds: Vec<_> =
        files.iter().filter(|path| target.endings.contains(&&*ending(path))).map(read).take(12).collect();
    let made: &[(&str, &str)] = match target.name {
        "surface_or_cloud" => &[
            ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n"),
            ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
            ("xyz", "0 0 0 0 0 1\n1 2 3 0 0 1\n"),
            (
                "ply",
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
            ),
            (
                "stl",
                "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
            ),
            (
                "pcd",
                "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n0 0 0\n1 2 3\n",
            ),
            (
                "vtk",
                "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 1 4\n3 0 1 2\n",
            ),
        ],
        "picked_points" => &[
            ("csv", "name,x,y,z\nP1,1,2,3\n"),
            ("pp", "<PickedPoints><point x=\"1\" y=\"2\" z=\"3\" name=\"P1\" active=\"1\"/></PickedPoints>"),
        ],
        "pose" => &[
            ("txt", "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n"),
            (
                "tfm",
                "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 5 6 7\nFixedParameters: 0 0 0\n",
            ),
        ],
        "region" => &[(
            "json",
            "{\"format\":\"osteoflow.region\",\"version\":1,\"frame\":\"camera\",\"keep\":[{\"box\":{\"center\":[0,0,0],\"size\":[1,1,1]}}]}",
        )],
        "volume" => &[(
            "nrrd",
            "NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: 2 2 2\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain domain\nendian: little\nencoding: raw\nspace origin: (0,0,0)\n\n0123456789abcdef",
        )],
        "openigtlink" => &[("bin", "\0\u{1}TRANSFORM\0\0\0StylusToReference\0\0\0")],
        _ => &[],
    };
    seeds.extend(made.iter().map(|(ending, text)| ((*ending).to_owned(), text.as_bytes().to_vec())));
    assert!(!seeds.is_empty(), "{} has no seed", target.name);
    seeds
}

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

#[test]
fn no_reader_panics_on_hostile_bytes() {
    let n_rounds = if common::is_slow_run() { 20_000 } else { 250 };
    for target in &TARGETS {
        let folder = tempfile::tempdir().unwrap();
        let seeds = seeds(target);
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
