//! Clouds that take time, carried from the camera to the bone's marker.

use super::{TrackingParams, to_bone_marker, to_world};
use osteoflow_algorithms::point_times::PointTimeUnit;
use osteoflow_algorithms::still_average::{MarkerPath, TakeMotion};
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Cloud, Pose, StampNs};
use osteoflow_node::{Context, Function};

const SCAN_NS: StampNs = 1_750_000_011_000_000_000;

fn t_world_camera_marker(s: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(900.0 + 5.0 * s, 3.0 * s, 40.0), Vector3::new(0.3, 0.1 + 0.02 * s, -0.2))
}

fn t_world_bone_marker(s: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(1100.0, -4.0 * s, 30.0 + 2.0 * s), Vector3::new(-0.4, 0.2, 0.5 - 0.03 * s))
}

fn t_camera_camera_marker() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(12.0, -80.0, 45.0), Vector3::new(1.0, -0.5, 0.2))
}

/// The samples of a marker at 20 Hz, from and to these times after the scan's stamp.
fn path(of: fn(f64) -> Isometry3<f64>, from: i64, to: i64) -> MarkerPath {
    let sample = |k: i64| (SCAN_NS + k * 50_000_000, of(k as f64 / 20.0));
    MarkerPath::of(&(20 * from..=20 * to).map(sample).collect::<Vec<_>>())
}

/// Points of the bone, in its marker's frame, each with its time from the stamp.
fn points() -> Vec<(f64, Point3<f64>)> {
    let point = |k: i32| {
        let share = f64::from(k) / 20.0;
        (3.0 * share, Point3::new(100.0 * share, 5.0 * (9.0 * share).sin(), 200.0))
    };
    (0..=20).map(point).collect()
}

/// The cloud of the camera, with a column of times.
fn cloud(name: &str, unit_s: f64, since_ns: StampNs) -> Cloud {
    let t_marker_camera = t_camera_camera_marker().inverse();
    let seen = |(s, p): &(f64, Point3<f64>)| {
        let t_bone_camera = t_world_bone_marker(*s).inverse() * t_world_camera_marker(*s) * t_marker_camera;
        t_bone_camera.inverse() * p
    };
    let cloud = Cloud::new("camera", points().iter().map(seen).collect::<Vec<_>>()).unwrap().at(SCAN_NS);
    let times = points().iter().map(|(s, _)| (s + since_ns as f64 / 1e9) / unit_s).collect::<Vec<_>>();
    cloud.with_extra(name, times).unwrap()
}

/// The largest distance of the cloud, once it is in the bone marker's frame, from the points of the bone, and what was said on the way.
fn carried(
    cloud: Cloud,
    params: &to_world::Params,
    paths: [Option<MarkerPath>; 2],
) -> Result<(f64, TakeMotion, Vec<String>), String> {
    let mut ctx = Context::for_test("carried");
    ctx.begin(0, SCAN_NS);
    let [camera_path, bone_path] = paths;
    let at = |from: &str, t: Isometry3<f64>| Pose::new("world", from, t).at(SCAN_NS);
    let into_world = to_world::In {
        cloud,
        t_world_camera_marker: at("camera_marker", t_world_camera_marker(0.0)),
        motion: None,
        path: camera_path,
        calibration: Pose::new("camera", "camera_marker", t_camera_camera_marker()),
    };
    let in_world = to_world::ToWorld::process(params, into_world, &mut ctx).map_err(|error| error.to_string())?;
    let into_bone = to_bone_marker::In {
        cloud: in_world.cloud,
        t_world_bone_marker: Some(at("bone_marker", t_world_bone_marker(0.0))),
        motion: None,
        tracked: None,
        take_motion: Some(in_world.take_motion),
        path: bone_path,
    };
    let on_bone = to_bone_marker::ToBoneMarker::process(&TrackingParams::default(), into_bone, &mut ctx)
        .map_err(|error| error.to_string())?;
    let off = points().iter().zip(on_bone.cloud.points()).map(|((_, p), q)| (p - q).norm()).fold(0.0, f64::max);
    Ok((off, on_bone.take_motion, ctx.warnings().to_vec()))
}

fn both() -> [Option<MarkerPath>; 2] {
    [Some(path(t_world_camera_marker, -1, 4)), Some(path(t_world_bone_marker, -1, 4))]
}

#[test]
fn points_of_their_own_times_are_carried_by_both_markers_poses_at_these_times() {
    let params = to_world::Params::default();
    for (name, unit_s, since_ns) in [
        ("t", 1.0, 0),
        ("offset_time", 1e-9, 0),
        ("t_ms", 1e-3, 0),
        ("timestamp", 1.0, SCAN_NS),
        ("stamp", 1e-9, SCAN_NS),
    ] {
        let (off, motion, _) = carried(cloud(name, unit_s, since_ns), &params, both()).unwrap();
        // Times since 1970 in f64 are exact to a quarter of a microsecond.
        assert!(off < 1e-3, "{off} mm off with times in \"{name}\"");
        let time = motion.time.unwrap();
        assert_eq!(time.undone, ["camera", "bone"]);
        let (duration_s, middle_s) = (time.duration_s, time.middle_s.unwrap());
        assert!((duration_s - 3.0).abs() < 1e-6 && (middle_s - 1.5).abs() < 1e-6, "{duration_s} s, {middle_s} s");
        assert!(motion.during.is_empty() && motion.unseen.is_empty());
    }
    let (off, motion, _) = carried(cloud("intensity", 1.0, 0), &params, both()).unwrap();
    assert!(off > 10.0, "{off} mm off without times");
    assert_eq!(motion.time, None);
    assert_eq!(motion.during[0].iter().map(|m| m.marker.as_str()).collect::<Vec<_>>(), ["camera", "bone"]);
    let ignored = to_world::Params { point_times: PointTimeUnit::Ignored, ..params.clone() };
    assert_eq!(carried(cloud("t", 1.0, 0), &ignored, both()).unwrap().0, off);
    let (_, motion, _) = carried(cloud("t", 1.0, 0), &params, [None, None]).unwrap();
    assert!(motion.time.is_some_and(|time| time.undone.is_empty() && (time.duration_s - 3.0).abs() < 1e-9));
}

#[test]
fn a_scan_beyond_the_poses_is_refused_with_its_cause_and_a_clock_of_its_own_is_told() {
    let params = to_world::Params::default();
    let late = carried(cloud("t", 1.0, 0), &params, [Some(path(t_world_camera_marker, -2, 1)), None]).unwrap_err();
    let said = "column \"t\" says that the points were measured 0.000 s to 3.000 s after the cloud's stamp, and where the camera marker was \
                then is not known: its poses are there from -2.00 s to 1.00 s after the cloud's stamp only; is the unit another one";
    assert!(late.starts_with(said), "{late}");
    // Milliseconds that are taken for seconds.
    let slow = to_world::Params { point_times: PointTimeUnit::S, ..params.clone() };
    assert!(carried(cloud("t", 0.1, 0), &slow, both()).unwrap_err().contains("30.000 s"));
    let (off, motion, said) = carried(cloud("gps_time", 1.0, 345_600_000_000_000), &params, both()).unwrap();
    assert!(off > 10.0 && motion.time.is_none() && said[0].contains("its clock is another one"), "{off} mm, {said:?}");
}

#[test]
fn the_stated_time_of_a_scan_is_where_its_stamp_is_said_to_be() {
    let of = |duration_s: Option<f64>, stamp_at: Option<to_world::StampAt>| {
        let params = to_world::Params { duration_s, stamp_at, ..to_world::Params::default() };
        let (_, motion, _) = carried(cloud("intensity", 1.0, 0), &params, both()).unwrap();
        motion.time.map(|time| (time.duration_s, time.middle_s))
    };
    use to_world::StampAt::{End, Middle, Start};
    assert_eq!(of(None, Some(Start)), None);
    assert_eq!(of(Some(0.8), None), Some((0.8, None)));
    assert_eq!(of(Some(0.8), Some(Start)), Some((0.8, Some(0.4))));
    assert_eq!(of(Some(0.8), Some(Middle)), Some((0.8, Some(0.0))));
    assert_eq!(of(Some(0.8), Some(End)), Some((0.8, Some(-0.4))));
}
