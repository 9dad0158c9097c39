//! Clouds that take time, and the motions of bone and camera about them.

use crate::common::exact::without_errors;
use crate::common::shared::simulate;
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::still_average::MarkerPath;
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Cloud, Pose, StampNs};
use osteoflow_simulation::{Procedure, ProcedureParams};

/// An exact procedure with clouds of 2 s, in which bone and camera move.
fn swept(change: impl Fn(&mut ProcedureParams)) -> Procedure {
    let mut params = without_errors(ProcedureParams::default());
    (params.camera.scan_s, params.camera.point_times, params.camera.n_points) = (2.0, true, 3000);
    (params.motion.camera_speed_mm_s, params.motion.camera_speed_deg_s) = (3.0, 0.5);
    (params.motion.bone_speed_mm_s, params.motion.bone_speed_deg_s) = (2.0, 1.0);
    change(&mut params);
    simulate(&params, 5)
}

fn path(poses: &[Pose], about_ns: StampNs) -> MarkerPath {
    let near = poses.iter().filter(|pose| (pose.stamp_ns - about_ns).abs() < 2_000_000_000);
    MarkerPath::of(&near.map(|pose| (pose.stamp_ns, pose.isometry)).collect::<Vec<_>>())
}

/// The largest distance from the bone, mm, of a cloud whose points are carried by the markers' poses at these times from its stamp.
fn off_bone(procedure: &Procedure, cloud: &Cloud, surface: &MeshQuery, after_s: impl Fn(usize) -> f64) -> f64 {
    let truth = &procedure.truth;
    let [camera, bone] = [&procedure.camera_marker, &procedure.bone_marker].map(|poses| path(poses, cloud.stamp_ns));
    let t_marker_camera = truth.t_camera_camera_marker.isometry.inverse();
    let off = |(k, p): (usize, &Point3<f64>)| {
        let at = |path: &MarkerPath| path.at(cloud.stamp_ns, (after_s(k) * 1e9) as StampNs).unwrap();
        let t_ct_camera = truth.t_ct_bone_marker.isometry * at(&bone).inverse() * at(&camera) * t_marker_camera;
        surface.closest_point(&(t_ct_camera * p)).unwrap().distance_mm
    };
    cloud.points().iter().enumerate().map(off).fold(0.0, f64::max)
}

fn times(cloud: &Cloud) -> &[f64] {
    let (name, times) = &cloud.extras()[0];
    assert_eq!(&**name, "t");
    times
}

#[test]
fn each_point_is_measured_where_bone_and_camera_are_at_its_own_time() {
    let procedure = swept(|_| {});
    let surface = MeshQuery::new(&procedure.truth.bone);
    for cloud in procedure.laser.iter().chain([&procedure.scan]) {
        let at_own = off_bone(&procedure, cloud, &surface, |k| times(cloud)[k]);
        // Poses between samples at 20 Hz are on a chord.
        assert!(at_own < 2e-3, "{at_own} mm off the bone");
        let at_stamp = off_bone(&procedure, cloud, &surface, |_| 0.0);
        assert!(at_stamp > 0.5, "{at_stamp} mm: the cloud is not sheared");
        let mirrored = off_bone(&procedure, cloud, &surface, |k| -times(cloud)[k]);
        assert!(mirrored > 1.5 * at_stamp, "{mirrored} mm by times that run backwards, {at_stamp} mm by none");
    }
}

#[test]
fn a_cloud_is_swept_in_the_direction_and_time_that_were_asked_for() {
    for (sweep_deg, way) in [(0.0_f64, Vector3::x()), (90.0, Vector3::y()), (180.0, -Vector3::x())] {
        let procedure = swept(|p| p.camera.sweep_deg = sweep_deg);
        let (cloud, times) = (&procedure.scan, times(&procedure.scan));
        let (first, last) = times.iter().fold((0.0_f64, 0.0_f64), |(a, b), t| (a.min(*t), b.max(*t)));
        assert!((-1.0..-0.8).contains(&first) && (0.8..=1.0).contains(&last), "from {first} s to {last} s");
        let seen = |k: usize| cloud.points()[k].coords.dot(&way) / cloud.points()[k].z;
        let mut order: Vec<usize> = (0..cloud.len()).collect();
        order.sort_by(|a, b| seen(*a).total_cmp(&seen(*b)));
        assert!(order.windows(2).all(|w| times[w[0]] <= times[w[1]] + 1e-9), "by {sweep_deg} degrees");
    }
}

#[test]
fn an_instant_has_no_times_and_is_not_sheared_by_motion() {
    let moving = swept(|p| p.camera.scan_s = 0.0);
    let still = swept(|p| (p.camera.scan_s, p.motion) = (0.0, Default::default()));
    assert_eq!(moving.scan.points(), still.scan.points());
    assert!(times(&moving.scan).iter().all(|t| *t == 0.0) && moving.phantom_scan.extras().is_empty());
    assert_ne!(moving.bone_marker, still.bone_marker);
    assert!(swept(|p| p.camera.point_times = false).scan.extras().is_empty());
}

#[test]
fn a_bone_that_is_carried_is_back_at_each_cloud_and_one_that_is_sawed_shakes_after_the_touches() {
    let params = |change: &dyn Fn(&mut ProcedureParams)| {
        let mut params = without_errors(ProcedureParams::default());
        params.tracker.burst_s = 1.9;
        change(&mut params);
        params
    };
    let plain = simulate(&params(&|_| {}), 3);
    let carried = simulate(&params(&|p| (p.motion.carry_mm, p.motion.carry_deg) = (200.0, 30.0)), 3);
    let speeds = |procedure: &Procedure| {
        let steps = procedure.bone_marker.windows(2).filter(|w| w[1].stamp_ns - w[0].stamp_ns < 60_000_000);
        let speed = |w: &[Pose]| 20.0 * (w[1].isometry.translation.vector - w[0].isometry.translation.vector).norm();
        steps.map(speed).fold(0.0, f64::max)
    };
    assert!(speeds(&plain) < 120.0, "{} mm/s", speeds(&plain));
    // 300 mm/s of the bone, and what the turn adds at its marker.
    assert!((280.0..500.0).contains(&speeds(&carried)), "{} mm/s", speeds(&carried));
    for (a, b) in carried.laser.iter().zip(&plain.laser) {
        let off = a.points().iter().zip(b.points()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{off} mm: the bone is not back");
    }
    let sawed = simulate(&params(&|p| (p.motion.saw_s, p.motion.saw_mm, p.motion.saw_deg) = (4.0, 1.5, 0.0)), 3);
    assert_eq!((&sawed.scan, &sawed.laser), (&plain.scan, &plain.laser));
    let last = |procedure: &Procedure| procedure.truth.t_world_ct_after_motion.isometry;
    let between: Isometry3<f64> = last(&sawed).inverse() * last(&plain);
    assert!(between.translation.vector.norm() < 1e-6, "the bone ends in the same place");
    let rest = sawed.truth.t_world_bone_marker_at_scan.isometry.translation.vector;
    let until_ns = sawed.bone_marker.last().unwrap().stamp_ns - 5_000_000_000;
    let before = sawed.bone_marker.iter().filter(|pose| pose.stamp_ns < until_ns);
    let off: Vec<f64> = before.map(|pose| (pose.isometry.translation.vector - rest).norm()).collect();
    let largest = off.iter().copied().fold(0.0, f64::max);
    // Four samples in each period see at least 1 / sqrt(2) of 1.5 mm.
    assert!((1.06..=1.5 + 1e-9).contains(&largest), "{largest} mm");
    let n_shaken = off.iter().filter(|off| **off > 0.1).count();
    assert!((60..=80).contains(&n_shaken), "{n_shaken} of the samples of 4 s at 20 Hz");
}
