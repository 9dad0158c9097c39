//! Recordings with payloads that are unknown to the program; the file has their schemas.

use super::{
    rewrite::{Layout, rewrite, rewrite_about},
    toy::{checked, record, registry},
};
use osteoflow_engine::{
    ReplayOptions, RunOptions,
    diff::{DiffOptions, diff},
    recording::digest::{DigestReport, digest},
    recover::recover,
    replay,
    replay::WirePart,
    validate::{ValidateReport, validate},
};
use osteoflow_node::{DynamicPayload, Registry};
use osteoflow_toy::{context::Declare, stream::Relay};
use std::{fs, path::Path};

const SAME: Layout = Layout { chunk_bytes: Some(4096), compression: None, shuffle: None, crc: true };

/// A graph that plays recorded waves and passes them on unchanged.
const ANOTHER: &str = r#"
[graph]
format = 1
name   = "another"

[node.beat]
kind = "ask.declare"
out  = { wave = { type = "toy/Wave", value = 0.0 } }

[node.again]
kind = "bench.relay"
in   = { value = "beat.wave" }

[record]
wires = ["*"]

[results]
"last" = "again.out"
"#;

/// A registry without the payload `toy/Wave`.
fn stranger() -> Registry {
    let mut registry = Registry::default();
    registry.source::<Declare>().function::<Relay>();
    registry
}

fn checked_by_stranger(path: &Path) -> ValidateReport {
    validate(path, &stranger(), &mut |_, _| {}).unwrap()
}

fn digest_of(path: &Path) -> DigestReport {
    digest(path, &mut |_, _| {}).unwrap()
}

#[test]
fn a_recording_of_an_unknown_payload_is_validated_digested_compared_recovered_and_played() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(&dir.path().join("run"), &[], 2);
    assert!(stranger().payload_type("toy/Wave").is_none());

    let report = checked_by_stranger(&path);
    assert!(report.is_sound(), "{:#?}", report.findings);
    // All items were checked against the schema, including those on the wire that accepts any payload.
    assert!(!report.notes.iter().any(|note| note.contains("unknown")), "{:?}", report.notes);

    let saved = dir.path().join("saved.mcap");
    assert!(recover(&path, &saved, &mut |_, _| {}).unwrap().is_whole());
    assert_eq!(digest_of(&saved).digest, digest_of(&path).digest);
    assert!(checked_by_stranger(&saved).is_sound());

    let graph = dir.path().join("another.toml");
    fs::write(&graph, ANOTHER).unwrap();
    let out = dir.path().join("again");
    let options = RunOptions { out_dir: Some(out.clone()), record: true, ..RunOptions::default() };
    let changes = ReplayOptions { graph: Some(graph), ..ReplayOptions::default() };
    let report = replay(&saved, &changes, &stranger(), &options, &()).unwrap();
    let beat = report.wires.iter().find(|wire| wire.wire == "beat.wave").unwrap();
    assert_eq!((beat.part, beat.n_replayed), (WirePart::Played, 40));
    let last = &report.run.results["last"];
    assert_eq!((&last["label"], last["samples_mm"].as_array().map(Vec::len)), (&"wave 39".into(), Some(50)));

    // The played items pass through bit for bit.
    let again = out.join("run.mcap");
    let of = |path: &Path, wire: &str| {
        digest_of(path).wires.into_iter().find(|found| found.wire == wire).unwrap().digest.unwrap()
    };
    assert_eq!(of(&again, "beat.wave"), of(&path, "beat.wave"));
    let only = DiffOptions { wires: vec!["beat.wave".into()], ..DiffOptions::default() };
    assert!(diff(&path, &again, &only, &mut |_, _| {}).unwrap().is_equal());
    assert!(checked_by_stranger(&again).is_sound());
    // A program that knows the payload reads them too.
    assert!(validate(&again, &registry(), &mut |_, _| {}).unwrap().is_sound());
    let recording = osteoflow_engine::Recording::open(&again).unwrap();
    let items = recording.items("beat.wave", &recording.registry(&stranger())).unwrap();
    let osteoflow_node::Body::Value(value) = &items[3].body else { panic!("a wave was recorded") };
    assert_eq!(value.get::<DynamicPayload>().unwrap().view().text("label"), Ok("wave 3"));
    assert!(recording.registry(&registry()).payload_type("toy/Wave") == registry().payload_type("toy/Wave"));
}

#[test]
fn an_exact_channel_tells_what_its_views_hold() {
    let dir = tempfile::tempdir().unwrap();
    let path = record(dir.path(), &["beat.n=2"], 1);
    let bytes = fs::read(path).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let channels: std::collections::BTreeMap<_, _> =
        messages.map(|m| (m.channel.topic.clone(), m.channel.metadata.get("schema").cloned())).collect();
    let expected = concat!(
        r#"[{"name":"label","field":"text"},{"name":"gain_mm","field":"float"},{"name":"json","field":"text"},"#,
        r#"{"name":"samples_mm","column":"f64","width":2}]"#
    );
    assert_eq!(channels["/exact/beat.wave"].as_deref(), Some(expected));
    assert_eq!(channels["/exact/pass.out"], None, "a wire that takes anything has no schema");
    assert_eq!(checked(&[]).plan.nodes.len(), 4);
}

#[test]
fn views_of_an_unknown_payload_that_do_not_fit_its_schema_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(&dir.path().join("run"), &["beat.n=3"], 1);
    let path = dir.path().join("wrong.mcap");
    rewrite(&original, &path, &SAME, |topic, header, data| {
        if (topic, header.sequence) == ("/exact/beat.wave", 1) {
            let at = data.windows(5).position(|bytes| bytes == b"label").unwrap();
            data[at] = b'L';
        }
        true
    });
    let said: Vec<_> = checked_by_stranger(&path).findings.iter().map(ToString::to_string).collect();
    assert_eq!(said.len(), 1, "{said:#?}");
    assert!(
        said[0].contains("wire beat.wave, item 1: it is no toy/Wave: the view has no text field \"label\""),
        "{said:?}"
    );
}

#[test]
fn a_schema_that_is_damaged_is_found_and_one_that_is_missing_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let original = record(&dir.path().join("run"), &["beat.n=3"], 1);
    let path = dir.path().join("other.mcap");
    rewrite_about(&original, &path, &SAME, |about| {
        about.entry("schema".into()).and_modify(|schema| *schema = schema.replace("\"float\"", "\"colour\""));
    });
    let report = checked_by_stranger(&path);
    let said: Vec<_> = report.findings.iter().map(ToString::to_string).collect();
    assert_eq!(said.len(), 1, "{said:#?}");
    assert!(said[0].starts_with("the schema of toy/Wave@3 is damaged: entry \"gain_mm\" is neither"), "{said:?}");

    rewrite_about(&original, &path, &SAME, |about| drop(about.remove("schema")));
    let report = checked_by_stranger(&path);
    assert!(report.is_sound(), "{:#?}", report.findings);
    let told = "payloads that are unknown here, so only their form was checked: toy/Wave@3";
    assert!(report.notes.iter().any(|note| note == told), "{:?}", report.notes);
}
