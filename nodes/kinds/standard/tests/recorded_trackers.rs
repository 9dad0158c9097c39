//! Recorded trackers whose poses freeze, or whose stamps run backwards.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

#[path = "../../../bone/formats/tests/layouts.rs"]
mod layouts;

use layouts::{Layout, Order, recording_bytes};
use osteoflow_formats::recording_write::Stream;
use osteoflow_geometry::{Pose, StampNs, nalgebra::Isometry3};
use osteoflow_node::{Context, DeclaredPort, Emission, FilePath, Outputs, Registry, Source, serde_json::json};
use osteoflow_standard::acquire::mcap::{Mcap, Params};

const STAMP: StampNs = 1_750_000_011_000_000_000;
const MS: StampNs = 1_000_000;

/// The items of a port and the warnings of its source.
fn played(
    poses: Vec<Pose>,
    port: osteoflow_node::serde_json::Value,
    order: Order,
) -> (Vec<(StampNs, Emission)>, Vec<String>) {
    let layout = Layout { order, ..Layout::default() };
    let bytes = recording_bytes(&[("/tracker/bone", Stream::Transforms(poses))], &Default::default(), &[], &layout);
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let mut registry = Registry::default();
    osteoflow_payloads::register(&mut registry);
    let payload = registry.payload_type("geometry/Pose").unwrap();
    let declared = DeclaredPort { name: "bone".into(), payload, params: port };
    let mut ctx = Context::new("recording", 0, std::sync::Arc::default(), vec![declared].into());
    let params = Params { path: FilePath(file.path().into()), allow_truncated: false, frames: Default::default() };
    let mut source = Mcap::new(params).unwrap();
    let mut items = Vec::new();
    while let Some(out) = source.next(&mut ctx).unwrap() {
        let mut emissions = vec![Emission::Silent];
        out.put(&mut emissions);
        items.push((ctx.stamp_ns(), emissions.remove(0)));
    }
    (items, ctx.take_warnings())
}

fn pose(ms: StampNs, x: f64) -> Pose {
    Pose::new("world", "bone", Isometry3::translation(x, 0.0, 0.0)).at(STAMP + ms * MS)
}

#[test]
fn a_tracker_that_repeats_one_pose_is_lost_after_two_seconds_and_said_once() {
    let noisy = (0..20).map(|k| pose(50 * k, 100.0 + 0.01 * k as f64));
    let frozen = (20..80).map(|k| pose(50 * k, 100.0));
    let again = (80..90).map(|k| pose(50 * k, 100.0 + 0.01 * k as f64));
    let poses: Vec<Pose> = noisy.chain(frozen).chain(again).collect();
    let (items, warnings) = played(poses.clone(), json!({ "topic": "/tracker/bone" }), Order::Sensor);
    let lost: Vec<usize> = (0..items.len())
        .filter(|k| matches!(&items[*k].1, Emission::Empty(reason) if reason.contains("is frozen")))
        .collect();
    assert_eq!(lost, (60..80).collect::<Vec<_>>(), "from 2 s after the first until it changes");
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    let since = STAMP + 1000 * MS;
    let expected = format!(
        "topic /tracker/bone: t_world_bone is frozen: its pose has been the same to the last bit since {since} ns, though its \
         stamps go on to {} ns",
        since + 2000 * MS
    );
    assert!(warnings[0].starts_with(&expected), "{}", warnings[0]);
    let (items, warnings) = played(poses, json!({ "topic": "/tracker/bone", "frozen_after_ms": 0.0 }), Order::Sensor);
    assert!(items.iter().all(|(_, emission)| matches!(emission, Emission::Value(_))) && warnings.is_empty());
}

#[test]
fn stamps_that_run_backwards_are_reported_once_with_message_and_both_stamps() {
    let poses: Vec<Pose> = (0..20).map(|k| pose(50 * k, k as f64)).collect();
    let topic = json!({ "topic": "/tracker/bone" });
    let (_, warnings) = played(poses.clone(), topic.clone(), Order::Sensor);
    assert!(warnings.is_empty(), "{warnings:?}");
    // In another order on the way to the recorder, as log times say.
    let (items, warnings) = played(poses, topic, Order::Shuffled(7));
    assert!(items.is_sorted_by_key(|(stamp, _)| *stamp) && items.len() == 20, "they are played in their order");
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    let said = &warnings[0];
    assert!(said.starts_with("topic /tracker/bone: t_world_bone: stamps run backwards "), "{said}");
    let [former, later] = [" ns comes after ", ": "].map(|mark| said.split(mark).last().unwrap_or_default());
    let first = |text: &str| text.split(' ').next().unwrap_or_default().parse::<StampNs>().unwrap_or_default();
    assert!(said.contains("first at message ") && first(later) < first(former), "{said}");
}
