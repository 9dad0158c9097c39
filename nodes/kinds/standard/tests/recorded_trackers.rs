//! Recorded trackers whose poses freeze, whose stamps run backwards, or whose frames several transforms join; and their logs.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

#[path = "../../../bone/formats/tests/layouts.rs"]
mod layouts;

use layouts::{Encoding, Layout, Order, recording_bytes};
use osteoflow_formats::recording_write::Stream;
use osteoflow_geometry::{Pose, StampNs, nalgebra::Isometry3};
use osteoflow_node::{
    Context, DeclaredPort, Emission, FilePath, NodeError, Outputs, Registry, Source, serde_json, serde_json::json,
};
use osteoflow_standard::acquire::{
    mcap::{Mcap, Params},
    poses::{self, Poses},
};

const STAMP: StampNs = 1_750_000_011_000_000_000;
const MS: StampNs = 1_000_000;

/// The items of a port and the warnings of its source, or its error.
type Played = Result<(Vec<(StampNs, Emission)>, Vec<String>), NodeError>;

/// Plays a source with one port of poses.
fn play<S: Source>(mut source: S, port: osteoflow_node::serde_json::Value) -> Played {
    let mut registry = Registry::default();
    osteoflow_payloads::register(&mut registry);
    let payload = registry.payload_type("geometry/Pose").unwrap();
    let declared = DeclaredPort { name: "bone".into(), payload, params: port };
    let mut ctx = Context::new("recording", 0, std::sync::Arc::default(), vec![declared].into());
    let mut items = Vec::new();
    while let Some(out) = source.next(&mut ctx)? {
        let mut emissions = vec![Emission::Silent];
        out.put(&mut emissions);
        items.push((ctx.stamp_ns(), emissions.remove(0)));
    }
    Ok((items, ctx.take_warnings()))
}

/// Plays a recording of these topics.
fn play_recording(streams: &[(&str, Stream)], port: osteoflow_node::serde_json::Value, order: Order) -> Played {
    play_layout(streams, port, &Layout { order, ..Layout::default() })
}

fn play_layout(streams: &[(&str, Stream)], port: osteoflow_node::serde_json::Value, layout: &Layout) -> Played {
    let bytes = recording_bytes(streams, &Default::default(), &[], layout);
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let params = Params { path: FilePath(file.path().into()), allow_truncated: false, frames: Default::default() };
    play(Mcap::new(params).unwrap(), port)
}

fn played(
    poses: Vec<Pose>,
    port: osteoflow_node::serde_json::Value,
    order: Order,
) -> (Vec<(StampNs, Emission)>, Vec<String>) {
    play_recording(&[("/tracker/bone", Stream::Transforms(poses))], port, order).unwrap()
}

fn pose(ms: StampNs, x: f64) -> Pose {
    Pose::new("world", "bone", Isometry3::translation(x, 0.0, 0.0)).at(STAMP + ms * MS)
}

#[test]
fn a_tracker_that_repeats_one_pose_is_lost_after_two_seconds_and_said_once() {
    let noisy = (0..20).map(|k| pose(50 * k, 100.0 + 0.01 * k as f64));
    // Where the motion before leads.
    let frozen = (20..80).map(|k| pose(50 * k, 100.2));
    let again = (80..90).map(|k| pose(50 * k, 100.0 + 0.01 * k as f64));
    let poses: Vec<Pose> = noisy.chain(frozen).chain(again).collect();
    let (items, warnings) = played(poses.clone(), json!({ "topic": "/tracker/bone" }), Order::Sensor);
    let lost: Vec<usize> = (0..items.len())
        .filter(|k| matches!(&items[*k].1, Emission::Empty(reason) if reason.contains("is frozen")))
        .collect();
    assert_eq!(lost, (21..80).collect::<Vec<_>>(), "all that repeat the first, as it was the same for 2 s");
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
    let poses: Vec<Pose> = (0..20).map(|k| pose(50 * k, 100.0 + k as f64)).collect();
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

/// The pose of an item, if it is no empty.
fn pose_of(emission: &Emission) -> Option<Pose> {
    match emission {
        Emission::Value(value) => value.get::<Pose>().cloned(),
        _ => None,
    }
}

/// map -> base at 20 Hz with one lost sample, base -> camera once, on `/tf_static`.
fn base_and_camera() -> [(&'static str, Stream); 2] {
    let turn = |k: StampNs| Isometry3::new([k as f64, 0.0, 100.0].into(), [0.0, 0.0, 0.01 * k as f64].into());
    let base = (0..9).map(|k| Pose::new("map", "base", turn(k)).at(STAMP + 50 * k * MS)).collect();
    let camera = Pose::new("base", "camera", Isometry3::new([0.0, 30.0, 0.0].into(), [1.0, 0.0, 0.0].into()))
        .at(STAMP + 70 * MS);
    [("/tf", Stream::Transforms(base)), ("/tf_static", Stream::Transforms(vec![camera]))]
}

#[test]
fn frames_that_two_transforms_join_are_joined_by_the_tree_of_tf_and_tf_static_and_told() {
    let port = |parent: &str, child: &str| json!({ "topic": "/tf", "parent": parent, "child": child });
    let (items, warnings) = play_recording(&base_and_camera(), port("map", "camera"), Order::Sensor).unwrap();
    assert_eq!(items.len(), 9);
    let camera = Isometry3::new([0.0, 30.0, 0.0].into(), [1.0, 0.0, 0.0].into());
    for (k, (stamp, emission)) in items.iter().enumerate() {
        let base = Isometry3::new([k as f64, 0.0, 100.0].into(), [0.0, 0.0, 0.01 * k as f64].into());
        let found = pose_of(emission).unwrap();
        assert_eq!((found.to.as_str(), found.from.as_str(), *stamp), ("map", "camera", STAMP + 50 * k as StampNs * MS));
        let off = (found.isometry.to_homogeneous() - (base * camera).to_homogeneous()).amax();
        assert!(off < 1e-4, "{off} at {k}: metres in single precision");
    }
    assert!(warnings.iter().any(|note| note.contains("t_map_camera is t_map_base * t_base_camera")), "{warnings:?}");
    let (items, warnings) = play_recording(&base_and_camera(), port("base", "map"), Order::Sensor).unwrap();
    let found = pose_of(&items[3].1).unwrap();
    let base = Isometry3::new([3.0, 0.0, 100.0].into(), [0.0, 0.0, 0.03].into());
    assert!((found.isometry.to_homogeneous() - base.inverse().to_homogeneous()).amax() < 1e-4);
    assert!(warnings.iter().any(|note| note.contains("t_base_map is the inverse of t_map_base")), "{warnings:?}");
    let Err(error) = play_recording(&base_and_camera(), port("map", "lens"), Order::Sensor) else { panic!("no way") };
    assert!(
        error.message.contains("/tf has no transform lens -> map, but base -> map; set child and parent"),
        "{error}"
    );
    // A second parent of a frame on the way.
    let odom = Pose::new("odom", "base", Isometry3::identity()).at(STAMP);
    let streams = [&base_and_camera()[..], &[("/tf/more", Stream::Transforms(vec![odom]))]].concat();
    let port = json!({ "topics": ["/tf", "/tf_static", "/tf/more"], "parent": "map", "child": "camera" });
    let Err(error) = play_recording(&streams, port, Order::Sensor) else { panic!("two parents") };
    assert!(error.message.contains("frame \"base\" has the parents \"map\" and \"odom\""), "{error}");
}

/// `t_parent_child`, the same at all times, from `ms` on.
fn mount(parent: &str, child: &str, y: f64, ms: StampNs) -> Pose {
    Pose::new(parent, child, Isometry3::new([0.0, y, 0.0].into(), [0.5, 0.0, 0.0].into())).at(STAMP + ms * MS)
}

/// map -> base at 20 Hz, and static transforms.
fn with_static(map: &str, poses: Vec<Pose>) -> [(&'static str, Stream); 2] {
    let turn = |k: StampNs| Isometry3::new([k as f64, 0.0, 100.0].into(), [0.0, 0.0, 0.01 * k as f64].into());
    let base = (0..9).map(|k| Pose::new(map, "base", turn(k)).at(STAMP + 50 * k * MS)).collect();
    [("/tf", Stream::Transforms(base)), ("/tf_static", Stream::Transforms(poses))]
}

/// The largest difference of the items from `t_map_base` and what `mounted` gives at their stamp; each item must be a pose.
fn worst_off(items: &[(StampNs, Emission)], mounted: impl Fn(StampNs) -> Isometry3<f64>) -> f64 {
    let off = |(stamp_ns, item): &(StampNs, Emission)| {
        let k = (stamp_ns - STAMP) as f64 / (50 * MS) as f64;
        let base = Isometry3::new([k, 0.0, 100.0].into(), [0.0, 0.0, 0.01 * k].into());
        let found = pose_of(item).unwrap_or_else(|| panic!("{item:?}")).isometry;
        (found.to_homogeneous() - (base * mounted(*stamp_ns)).to_homogeneous()).amax()
    };
    items.iter().map(off).fold(0.0, f64::max)
}

#[test]
fn static_transforms_without_a_stamp_hold_beside_a_moving_tf_in_chains_of_several_and_in_every_encoding() {
    let statics = vec![mount("base", "arm", 30.0, 250), mount("arm", "camera", 12.0, 250)];
    let port = json!({ "topic": "/tf", "parent": "map", "child": "camera" });
    let cdr = Encoding::Cdr { big_endian: false };
    for encoding in [Encoding::Protobuf, Encoding::Json, cdr, Encoding::Cdr { big_endian: true }] {
        for (transforms_per_message, unstamped) in [(1, "/tf_static"), (2, "/tf_static"), (2, "none")] {
            let unstamped = vec![unstamped.to_owned()];
            let layout = Layout { encoding, transforms_per_message, unstamped, ..Layout::default() };
            let (items, warnings) = play_layout(&with_static("map", statics.clone()), port.clone(), &layout).unwrap();
            let mounted = mount("", "", 30.0, 0).isometry * mount("", "", 12.0, 0).isometry;
            let off = worst_off(&items, |_| mounted);
            assert!(items.len() == 9 && off < 1e-4, "{encoding:?}: {} poses, {off} mm off", items.len());
            assert_eq!(warnings.len(), 1, "the product alone is told: {warnings:?}");
        }
    }
}

#[test]
fn a_static_transform_that_changes_is_told_once_with_its_size_and_the_other_holds_from_then_on() {
    let mounts = [(30.0, -100), (30.0, 0), (42.0, 120), (30.0, 220)].map(|(y, ms)| mount("base", "camera", y, ms));
    let port = json!({ "topic": "/tf", "parent": "map", "child": "camera" });
    let (items, warnings) = play_recording(&with_static("map", mounts.into()), port, Order::Sensor).unwrap();
    let changed = STAMP + 120 * MS..STAMP + 220 * MS;
    let off = worst_off(&items, |ns| mount("", "", if changed.contains(&ns) { 42.0 } else { 30.0 }, 0).isometry);
    assert!(items.len() == 9 && off < 1e-4, "{} poses, {off} mm off", items.len());
    let told: Vec<_> = warnings.iter().filter(|warning| warning.contains("though it is static")).collect();
    let [told] = &told[..] else { panic!("{warnings:?}") };
    let expected = format!("t_base_camera changes at {} ns by 12.00 mm and 0.00 degrees", STAMP + 120 * MS);
    assert!(told.contains(&expected), "{told}");
}

#[test]
fn a_transform_that_is_static_and_moves_is_told_and_taken_as_it_moves() {
    let streams = with_static("map", vec![mount("map", "base", 500.0, 0), mount("base", "camera", 30.0, 0)]);
    let port = json!({ "topic": "/tf", "parent": "map", "child": "camera" });
    let (items, warnings) = play_recording(&streams, port, Order::Sensor).unwrap();
    let off = worst_off(&items, |_| mount("", "", 30.0, 0).isometry);
    assert!(items.len() == 9 && off < 1e-4, "{} poses, {off} mm off", items.len());
    assert!(warnings.iter().any(|told| told.contains("t_map_base is static on one topic and moves")), "{warnings:?}");
}

#[test]
fn frames_that_differ_by_a_leading_slash_are_one_and_told_in_a_chain_and_alone() {
    for (map, base, asked) in [("map", "/base", "map"), ("/map", "/base", "map"), ("/map", "base", "/map")] {
        let streams = with_static(map, vec![mount(base, "/camera", 30.0, 0)]);
        let port = json!({ "topic": "/tf", "parent": asked, "child": "camera" });
        let (items, warnings) = play_recording(&streams, port, Order::Sensor).unwrap();
        let off = worst_off(&items, |_| mount("", "", 30.0, 0).isometry);
        assert!(items.len() == 9 && off < 1e-4, "{map} {base}: {} poses, {off} mm off", items.len());
        let pose = pose_of(&items[0].1).unwrap();
        assert_eq!((pose.to.as_str(), pose.from.as_str()), ("map", "camera"));
        let is_told = warnings.iter().any(|told| told.contains("\"base\" and \"/base\" differ by the slash alone"));
        assert_eq!(is_told, base == "/base", "{warnings:?}");
    }
    // Half of the poses of one marker by each name.
    let by = |k: StampNs| if k % 2 == 0 { "bone" } else { "/bone" };
    let poses = (0..20).map(|k| Pose { from: by(k).into(), ..pose(50 * k, 100.0 + 0.01 * k as f64) }).collect();
    let (items, warnings) = played(poses, json!({ "topic": "/tracker/bone", "child": "/bone" }), Order::Sensor);
    assert_eq!((items.len(), warnings.len()), (20, 1), "{warnings:?}");
}

#[test]
fn frames_that_differ_by_case_are_two_and_told_or_refused_with_both_names() {
    let by = |k: StampNs| if k % 2 == 0 { "bone" } else { "Bone" };
    let poses = (0..20).map(|k| Pose { from: by(k).into(), ..pose(50 * k, 0.01 * k as f64) }).collect();
    let (items, warnings) = played(poses, json!({ "topic": "/tracker/bone", "child": "bone" }), Order::Sensor);
    assert_eq!(items.len(), 10, "those of the other name are left out");
    assert!(warnings.iter().any(|told| told.contains("frames \"bone\" and \"Bone\" differ by case")), "{warnings:?}");
    let streams = with_static("map", vec![mount("Base", "camera", 30.0, 0)]);
    let port = json!({ "topic": "/tf", "parent": "map", "child": "camera" });
    let Err(error) = play_recording(&streams, port, Order::Sensor) else { panic!("no way") };
    assert!(error.message.contains("/tf has no transform camera -> map, but base -> map"), "{error}");
}

/// Plays a log.
fn play_log(text: &str, params: serde_json::Value, port: serde_json::Value) -> Played {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    let mut params: poses::Params = serde_json::from_value(params).unwrap();
    params.path = FilePath(file.path().into());
    let name = file.path().display().to_string();
    play(Poses::new(params).unwrap(), port).map_err(|error| NodeError::new(error.message.replace(&name, "LOG")))
}

#[test]
fn a_damaged_stamp_in_a_log_is_no_silence_of_its_tool_or_of_another() {
    let text: String = (0..40)
        .map(|k| {
            let s = if k == 20 { "4292000000.0".into() } else { format!("1750000000.{:03}", 25 * k) };
            format!("{s} {} 0 1 0 0 0 1\n", f64::from(k) * 0.001)
        })
        .collect();
    let params = json!({ "path": "", "parent": "world", "child": "bone" });
    let (items, warnings) = play_log(&text, params, json!({ "lost_after_ms": 500.0 })).unwrap();
    assert_eq!(items.iter().filter(|(_, emission)| pose_of(emission).is_some()).count(), 39, "{warnings:?}");
    assert_eq!(items.len(), 39, "no empty at the end: {:?}", items.last());
    assert!(
        warnings.iter().any(|said| said.contains("t_world_bone: 1 pose is left out, the stamp 4292000000000000000 ns"))
    );
}

/// A sequence of PLUS: the stylus on a reference, the reference in the tracker, which is not seen in frame 2.
fn sequence() -> String {
    let mut text = "ObjectType = Image\nNDims = 3\nDimSize = 0 0 5\n".to_owned();
    for k in 0..5 {
        let (status, frame) = (if k == 2 { "INVALID" } else { "OK" }, format!("Seq_Frame{k:04}_"));
        text += &format!("{frame}ReferenceToTrackerTransform = 0 -1 0 {k} 1 0 0 20 0 0 1 30 0 0 0 1\n");
        text += &format!("{frame}ReferenceToTrackerTransformStatus = {status}\n");
        text += &format!("{frame}StylusToReferenceTransform = 1 0 0 5 0 1 0 {k} 0 0 1 7 0 0 0 1\n");
        text += &format!(
            "{frame}StylusToReferenceTransformStatus = OK\n{frame}Timestamp = {:.2}\n",
            10.0 + 0.05 * f64::from(k)
        );
    }
    text + "ElementDataFile = LOCAL\n"
}

#[test]
fn a_log_gives_its_poses_and_a_lost_tool_is_an_empty_with_the_reason_never_the_last_pose() {
    let params = json!({ "path": "", "frames": { "Tracker": "world" }, "stamp_offset_s": 100.0 });
    let (items, warnings) =
        play_log(&sequence(), params, json!({ "parent": "Tracker", "child": "Reference" })).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    let stamps: Vec<StampNs> = items.iter().map(|(stamp, _)| *stamp / MS).collect();
    assert_eq!(stamps, [110_000, 110_050, 110_100, 110_150, 110_200], "with the offset");
    let poses: Vec<Option<f64>> =
        items.iter().map(|(_, item)| pose_of(item).map(|pose| pose.isometry.translation.x)).collect();
    assert_eq!(poses, [Some(0.0), Some(1.0), None, Some(3.0), Some(4.0)]);
    assert!(
        matches!(&items[2].1, Emission::Empty(reason) if reason.contains("the status INVALID")),
        "{:?}",
        items[2].1
    );
    let first = pose_of(&items[0].1).unwrap();
    assert_eq!((first.to.as_str(), first.from.as_str()), ("world", "Reference"));
}

#[test]
fn a_log_joins_its_tools_by_their_tree_and_a_lost_one_on_the_way_is_lost() {
    let (items, warnings) =
        play_log(&sequence(), json!({ "path": "" }), json!({ "parent": "Tracker", "child": "Stylus" })).unwrap();
    let note = "LOG: port \"bone\": t_Tracker_Stylus is t_Tracker_Reference * t_Reference_Stylus, as tf takes it";
    assert!(warnings.iter().any(|found| found.ends_with(&note[3..])), "{warnings:?}");
    // A quarter turn: x = k - k, y = 20 + 5.
    let places: Vec<_> = items
        .iter()
        .map(|(_, item)| pose_of(item).map(|pose| <[f64; 3]>::from(pose.isometry.translation.vector)))
        .collect();
    let seen = |k: usize| (k != 2).then_some([0.0, 25.0, 37.0]);
    for (k, place) in places.iter().enumerate() {
        let off = place.zip(seen(k)).map_or(0.0, |(a, b)| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max));
        assert!(place.is_some() == seen(k).is_some() && off < 1e-12, "{places:?}");
    }
    let Emission::Empty(reason) = &items[2].1 else { panic!("{:?}", items[2].1) };
    assert!(reason.contains("t_Tracker_Reference has no pose") && reason.contains("the status INVALID"), "{reason}");
}

#[test]
fn a_port_that_fits_several_transforms_or_none_and_frames_that_no_pose_has_are_refused_by_name() {
    for (params, port, expected) in [
        (
            json!({ "path": "" }),
            json!({}),
            "any -> any: several fit Stylus -> Reference, Reference -> Tracker; set child and parent",
        ),
        (
            json!({ "path": "" }),
            json!({ "child": "Probe" }),
            "Probe -> any: there are Stylus -> Reference, Reference -> Tracker",
        ),
        (json!({ "path": "" }), json!({ "parent": "ct", "child": "Stylus" }), "no transforms lead from Stylus to ct"),
        (
            json!({ "path": "", "frames": { "tracker": "world" } }),
            json!({ "parent": "Tracker", "child": "Reference" }),
            "LOG: frames names \"tracker\", but no pose that a port reads is in it",
        ),
        (
            json!({ "path": "", "format": "tum" }),
            json!({}),
            "LOG: frames: a TUM trajectory names no frames; give parent and child",
        ),
    ] {
        let Err(error) = play_log(&sequence(), params, port) else { panic!("{expected}") };
        assert!(error.message.contains(expected) && error.message.contains("LOG"), "{error}\n{expected}");
    }
}
