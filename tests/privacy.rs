//! What a run leaves names neither a patient nor a folder.

use crate::common::{json, osteoflow};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// What stands in the tags of the series and in the name of its folder.
const SECRETS: [&str; 6] = ["DOE", "JOHN", "4711", "19610203", "ELSEWHERE", "LEFT LEG"];

/// One element, explicit little-endian.
fn element(out: &mut Vec<u8>, tag: u32, vr: &str, value: &[u8]) {
    let mut value = value.to_vec();
    if value.len() % 2 == 1 {
        value.push(if vr == "UI" { 0 } else { b' ' });
    }
    out.extend(((tag >> 16) as u16).to_le_bytes());
    out.extend((tag as u16).to_le_bytes());
    out.extend(vr.as_bytes());
    if vr == "OW" {
        out.extend([0, 0]);
        out.extend((value.len() as u32).to_le_bytes());
    } else {
        out.extend((value.len() as u16).to_le_bytes());
    }
    out.extend(value);
}

/// One layer of a rod of 10 mm, in a field of 32 x 32 pixels of 1 mm; further elements replace those of their tags.
pub(crate) fn layer(k: usize, more: &[(u32, &'static str, &str)]) -> Vec<u8> {
    let cells: Vec<u8> = (0..32 * 32_i32)
        .flat_map(|i| {
            let (x, y) = (f64::from(i % 32) - 15.5, f64::from(i / 32) - 15.5);
            // Linear across the surface, so that the threshold has one place.
            let hu = (600.0 + 400.0 * (5.0 - x.hypot(y))).clamp(-1000.0, 1500.0);
            (hu as i16).to_le_bytes()
        })
        .collect();
    let mut bytes = vec![0; 128];
    bytes.extend(b"DICM");
    element(&mut bytes, 0x0002_0010, "UI", b"1.2.840.10008.1.2.1");
    let short = |v: u16| v.to_le_bytes().to_vec();
    let mut elements = vec![
        (0x0008_0016, "UI", b"1.2.840.10008.5.1.4.1.1.2".to_vec()),
        (0x0008_0060, "CS", b"CT".to_vec()),
        (0x0008_0080, "LO", b"ST. ELSEWHERE".to_vec()),
        (0x0008_103e, "LO", b"DOE LEFT LEG".to_vec()),
        (0x0010_0010, "PN", b"DOE^JOHN".to_vec()),
        (0x0010_0020, "LO", b"ID-4711".to_vec()),
        (0x0010_0030, "DA", b"19610203".to_vec()),
        (0x0020_000e, "UI", b"1.2.3.4".to_vec()),
        (0x0020_0011, "IS", b"3".to_vec()),
        (0x0020_0032, "DS", format!("0\\0\\{k}").into_bytes()),
        (0x0020_0037, "DS", b"1\\0\\0\\0\\1\\0".to_vec()),
        (0x0028_0002, "US", short(1)),
        (0x0028_0004, "CS", b"MONOCHROME2".to_vec()),
        (0x0028_0010, "US", short(32)),
        (0x0028_0011, "US", short(32)),
        (0x0028_0030, "DS", b"1\\1".to_vec()),
        (0x0028_0100, "US", short(16)),
        (0x0028_0101, "US", short(16)),
        (0x0028_0102, "US", short(15)),
        (0x0028_0103, "US", short(1)),
        (0x0028_1052, "DS", b"0".to_vec()),
        (0x0028_1053, "DS", b"1".to_vec()),
        (0x0028_1054, "LO", b"HU".to_vec()),
        (0x7fe0_0010, "OW", cells),
    ];
    elements.retain(|(tag, ..)| more.iter().all(|(other, ..)| other != tag));
    elements.extend(more.iter().map(|(tag, vr, text)| (*tag, *vr, text.as_bytes().to_vec())));
    elements.sort_by_key(|(tag, ..)| *tag);
    elements.iter().for_each(|(tag, vr, value)| element(&mut bytes, *tag, vr, value));
    bytes
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// The text without long runs of base64, in which any three letters occur by chance: scripts of the views, packed.
fn without_packed(text: &str) -> String {
    let is_packed = |c: char| c.is_ascii_alphanumeric() || "+/=".contains(c);
    text.split_inclusive(|c| !is_packed(c)).filter(|run| run.len() < 1000).collect()
}

/// Runs a graph on the tagged series, and writes the report of the run.
fn run_on_series(dir: &Path, out: &Path, sets: &[&str]) -> String {
    let series = dir.join("DOE_JOHN_4711").join("ct");
    fs::create_dir_all(&series).unwrap();
    (0..30).for_each(|k| fs::write(series.join(format!("{k}.dcm")), layer(k, &[])).unwrap());
    let graph = dir.join("graphs").join("ct.toml");
    fs::create_dir_all(graph.parent().unwrap()).unwrap();
    fs::write(
        &graph,
        "[graph]\nformat = 1\nname = \"ct\"\nframes = [\"ct\"]\n[node.bone]\nkind = \"surface.ct\"\npath = \"nothing\"\n\
         threshold_hu = 600\n[record]\nwires = [\"bone.*\"]\n[results]\nct = \"bone.report\"\n",
    )
    .unwrap();
    let path = format!("bone.path={}", series.display());
    let mut command = osteoflow();
    // The folder of cached answers is named in the manifest, too.
    command.env("OSTEOFLOW_CACHE", dir.join("answers"));
    command.arg("run").arg(&graph).args(["--set", &path]).args(sets).arg("--out").arg(out);
    let run = command.output().unwrap();
    let stderr = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.success(), "{stderr}");
    let report = osteoflow().arg("report").arg(out).output().unwrap();
    assert!(report.status.success(), "{}", String::from_utf8_lossy(&report.stderr));
    stderr
}

#[test]
fn no_tag_of_a_patient_and_no_absolute_path_is_in_what_a_run_leaves() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let stderr = run_on_series(dir.path(), &out, &["--set", "record.compression=none"]);
    let secrets_in = |text: &str| SECRETS.iter().filter(|secret| text.contains(**secret)).copied().collect::<Vec<_>>();
    let folder = dir.path().to_str().unwrap().to_owned();
    let left = files(&out);
    assert!(left.len() >= 4, "{left:?}");
    for file in &left {
        let text = without_packed(&String::from_utf8_lossy(&fs::read(file).unwrap()).replace("<wbr>", ""));
        if let Some(secret) = secrets_in(&text).first() {
            let at = text.find(secret).unwrap();
            let near: String = text[..at].chars().rev().take(60).collect::<Vec<_>>().into_iter().rev().collect();
            panic!("{}: \"{secret}\" after \"{near}\"", file.display());
        }
        assert!(!text.contains(&folder), "{} names {folder}", file.display());
    }
    let tags: Vec<_> = ["ELSEWHERE", "LEFT LEG", "19610203"].into_iter().filter(|tag| stderr.contains(tag)).collect();
    assert_eq!(tags, [""; 0], "{stderr}");
    let manifest = json(&out.join("manifest.json"));
    assert_eq!(manifest["store"]["dir"], "answers", "the store was used, and is named without its folder");
    assert_eq!(manifest["inputs"].as_array().unwrap().len(), 30);
    assert_eq!(manifest["inputs"][0]["path"], "ct/0.dcm", "the file with its hash, without its folder");
    assert!(manifest["resolved_graph"].as_str().unwrap().contains("path = \"ct\""), "{}", manifest["resolved_graph"]);
    // The recording alone gives the same again.
    assert!(osteoflow().arg("replay").arg(&out).output().unwrap().status.success());
}

#[test]
fn a_recording_that_names_its_sources_by_hash_keeps_their_paths_since_they_are_read_again() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    run_on_series(dir.path(), &out, &["--set", "record.sources=hash"]);
    let inputs = json(&out.join("manifest.json"))["inputs"].clone();
    assert!(inputs[0]["path"].as_str().unwrap().starts_with(dir.path().to_str().unwrap()), "{}", inputs[0]);
    assert!(osteoflow().arg("replay").arg(&out).output().unwrap().status.success());
}
