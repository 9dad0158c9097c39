//! Recordings compared with the truth: the shipped one, and the development recording if it exists.

use crate::common::case::{Case, GRAPH};
use crate::common::{Ran, data, isometry, json, point, run};
use osteoflow_formats::recording_write::{Stream, recording_bytes};
use osteoflow_geometry::{
    Pose,
    nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3},
};
use serde_json::json;
use std::path::{Path, PathBuf};

fn t_ct_world(ran: &Ran) -> Isometry3<f64> {
    isometry(&ran.results["poses"]["t_ct_world"]["matrix"])
}

/// Error norms at the assessment points, mm, of a registration against the true one.
fn errors_ct(case: &Case, t_ct_world: &Isometry3<f64>) -> Vec<Vector3<f64>> {
    let truth = case.t_world_ct().inverse();
    case.assessment().iter().map(|p| t_ct_world * p - truth * p).collect()
}

#[test]
fn every_assessment_point_is_within_the_bands_of_the_truth() {
    for case in Case::all("every_assessment_point_is_within_the_bands_of_the_truth") {
        let ran = case.run(&["--no-record"]);
        for error in errors_ct(&case, &t_ct_world(ran)) {
            let e = case.axes().tr_mul(&error);
            assert!(e.x.abs() < 0.6 && e.y.abs() < 0.6 && e.z.abs() < 1.5, "{}: {e:?}", case.recording.display());
        }
    }
}

#[test]
fn the_calibration_is_within_a_millimetre_and_a_fifth_of_a_degree() {
    for case in Case::all("the_calibration_is_within_a_millimetre_and_a_fifth_of_a_degree") {
        let ran = case.run(&["--no-record"]);
        let found = isometry(&ran.results["poses"]["t_camera_camera_marker"]["matrix"]);
        let off = isometry(&case.truth["C_T_Mc"]).inverse() * found;
        let (mm, degrees) = (off.translation.vector.norm(), off.rotation.angle().to_degrees());
        assert!(mm < 1.0 && degrees < 0.2, "{}: {mm} mm, {degrees} degrees", case.recording.display());
    }
}

#[test]
fn each_laser_point_is_within_a_millimetre_of_the_true_spot() {
    for case in Case::all("each_laser_point_is_within_a_millimetre_of_the_true_spot") {
        let ran = case.run(&["--no-record"]);
        let found = ran.results["laser_points"].as_array().unwrap();
        let spots = case.truth["laser_spots_W"].as_array().unwrap();
        assert_eq!(found.len(), spots.len());
        for (found, spot) in found.iter().zip(spots) {
            let off = (point(&found["position_mm"]) - point(spot)).norm();
            assert!(off < 1.0, "{}: {} is {off} mm off", case.recording.display(), found["name"]);
        }
    }
}

#[test]
fn planes_are_right_at_the_scan_and_after_the_motion() {
    for case in Case::all("planes_are_right_at_the_scan_and_after_the_motion") {
        let ran = case.run(&["--no-record", "--set", "verdict.rules.attitude_stated=true"]);
        for (key, truth) in [("planes_at_scan", "planes_W_scan"), ("planes", "planes_W_after_motion")] {
            let found = ran.results[key].as_array().unwrap();
            let true_planes = case.truth[truth].as_array().unwrap();
            assert_eq!(found.len(), true_planes.len());
            for (found, truth) in found.iter().zip(true_planes) {
                let (name, found, truth) = (&found["name"], isometry(&found["matrix"]), isometry(truth));
                let off = (found.translation.vector - truth.translation.vector).norm();
                let tilt = (found * Vector3::z()).angle(&(truth * Vector3::z())).to_degrees();
                assert!(off < 1.5 && tilt < 0.5, "{key} {name}: {off} mm, {tilt} degrees");
            }
        }
    }
}

fn mean_norm(errors: &[Vector3<f64>]) -> f64 {
    errors.iter().map(Vector3::norm).sum::<f64>() / errors.len() as f64
}

#[test]
fn icp_beats_the_coarse_fit() {
    for case in Case::all("icp_beats_the_coarse_fit") {
        // No step of ICP leaves the coarse fit as it is.
        let fine = mean_norm(&errors_ct(&case, &t_ct_world(case.run(&["--no-record"]))));
        let coarse = case.run(&["--set", r#"results."poses.coarse"="coarse.t_target_source""#]);
        let t_ct_bone_marker = isometry(&coarse.results["poses"]["coarse"]["matrix"]);
        let t_world_bone_marker = isometry(&case.truth["W_T_Mb_scan"]);
        let coarse = mean_norm(&errors_ct(&case, &(t_ct_bone_marker * t_world_bone_marker.inverse())));
        assert!(fine < 0.7 * coarse, "{}: {coarse} mm to {fine} mm", case.recording.display());
    }
}

/// A plan whose landmarks are all `mm` further along the bone, which a fit of landmarks alone cannot detect.
fn displaced(case: &Case, mm: f64, dir: &Path) -> PathBuf {
    let mut plan = json(&case.plan);
    let along = point(&plan["proximal"]).coords.normalize() * mm;
    for (_, landmark) in plan["landmarks"].as_object_mut().unwrap() {
        let moved = point(landmark) + along;
        *landmark = json!([moved.x, moved.y, moved.z]);
    }
    let path = dir.join("displaced.plan.json");
    std::fs::write(&path, plan.to_string()).unwrap();
    path
}

/// Distance of two registrations at the cuts, mm.
fn apart_at_cuts(case: &Case, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let planes = case.truth["planes_W_scan"].as_array().unwrap();
    let cuts = planes.iter().map(|plane| Point3::from(isometry(plane).translation.vector));
    cuts.map(|cut| (a * cut - b * cut).norm()).fold(0.0, f64::max)
}

#[test]
fn point_to_plane_forgets_a_shift_of_all_landmarks_along_the_bone() {
    for case in Case::all("point_to_plane_forgets_a_shift_of_all_landmarks_along_the_bone") {
        let dir = tempfile::tempdir().unwrap();
        let swap = ["--no-record", "--set", "icp.kind=icp.point_to_plane"];
        let straight = t_ct_world(case.run(&swap));
        let shifted = t_ct_world(&case.with_plan(&displaced(&case, 8.0, dir.path()), &swap));
        let apart = apart_at_cuts(&case, &straight, &shifted);
        assert!(apart < 0.3, "{}: {apart} mm apart at the cuts", case.recording.display());
    }
}

#[test]
fn point_to_point_reports_its_remaining_error_and_its_resolution() {
    for case in Case::all("point_to_point_reports_its_remaining_error_and_its_resolution") {
        let dir = tempfile::tempdir().unwrap();
        let swap = ["--no-record", "--set", "icp.kind=icp.point_to_point"];
        let (straight, shifted) = (case.run(&swap), &case.with_plan(&displaced(&case, 8.0, dir.path()), &swap));
        let result = |ran: &Ran, key: &str| ran.results["icp"][key].as_f64().unwrap_or_else(|| panic!("no {key}"));
        assert!(result(straight, "left_mm") >= 0.0 && result(shifted, "left_mm") >= 0.0);
        let (a, b) = (t_ct_world(straight), t_ct_world(shifted));
        let apart = case.assessment().iter().map(|p| (a * p - b * p).norm()).fold(0.0, f64::max);
        // Each converges within a standard deviation that it reports; three times that of their difference.
        let limit = 3.0 * result(straight, "resolution_mm").hypot(result(shifted, "resolution_mm"));
        assert!(apart < limit, "{}: {apart} mm apart, {limit} mm at most", case.recording.display());
    }
}

/// The poses of two markers over time, the second as the tracker's writer gives it.
fn tracked(written: impl Fn(&UnitQuaternion<f64>) -> Quaternion<f64>) -> Vec<u8> {
    let poses = |marker: &'static str| {
        (0..40).map(move |k: i32| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.7, 0.05 * f64::from(k)));
            let at = Vector3::new(100.0, -200.0, 1500.0 + f64::from(k));
            Pose::new("world", marker, Isometry3::from_parts(at.into(), turn))
                .at(1_750_000_000_000_000_000 + i64::from(k))
        })
    };
    let rounded = poses("bone_marker").map(|mut pose| {
        pose.isometry.rotation = UnitQuaternion::new_unchecked(written(&pose.isometry.rotation));
        pose
    });
    let streams = [
        ("/tracker/camera_marker", Stream::Transforms(poses("camera_marker").collect())),
        ("/tracker/bone_marker", Stream::Transforms(rounded.collect())),
    ];
    recording_bytes(&streams, &Default::default(), &[]).unwrap()
}

/// Runs a graph of nothing but such a recording.
fn run_tracked(dir: &Path, recording: &[u8]) -> Ran {
    std::fs::write(dir.join("tracked.mcap"), recording).unwrap();
    let port = |marker: &str| {
        format!(
            "out.{marker} = {{ type = \"geometry/Pose\", topic = \"/tracker/{marker}\", to = \"world\", from = \"{marker}\", motion.hand_mm_s = 0.0 }}\n"
        )
    };
    let graph = format!(
        "[graph]\nformat = 1\nframes = [\"world\", \"camera_marker\", \"bone_marker\"]\n[node.recording]\nkind = \"acquire.mcap\"\n\
         path = \"tracked.mcap\"\n{}{}[results]\ncamera_marker = \"recording.camera_marker\"\nbone_marker = \"recording.bone_marker\"\n",
        port("camera_marker"),
        port("bone_marker")
    );
    std::fs::write(dir.join("tracked.toml"), graph).unwrap();
    run(dir.join("tracked.toml").to_str().unwrap(), &["--no-record"])
}

#[test]
fn a_tracker_of_three_decimals_gives_rotations_and_one_warning_with_the_largest_correction() {
    let dir = tempfile::tempdir().unwrap();
    let three = |q: &UnitQuaternion<f64>| Quaternion::from(q.coords.map(|c| (c * 1e3).round() / 1e3));
    let ran = run_tracked(dir.path(), &tracked(three));
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let warnings: Vec<_> = ran.stderr.lines().filter(|line| line.contains("rotations are rounded")).collect();
    assert_eq!(warnings.len(), 1, "{}", ran.stderr);
    let (n, largest) = warnings[0].split_once("topic /tracker/bone_marker: ").unwrap().1.split_once(" of 40 ").unwrap();
    assert!(n.parse::<u32>().unwrap() > 30 && largest.ends_with(" mm at 1 m"), "{}", warnings[0]);
    let found = isometry(&ran.results["bone_marker"]["matrix"]);
    let exact = isometry(&ran.results["camera_marker"]["matrix"]);
    let off = found.rotation.angle_to(&exact.rotation);
    assert!(off > 1e-6 && off < 2.1e-3, "{off} rad: half a unit in each of four components");
    // In double precision nothing is reported.
    let sound = run_tracked(dir.path(), &tracked(|q| q.into_inner()));
    assert_eq!((sound.code, sound.stderr.contains("rounded")), (0, false), "{}", sound.stderr);
    assert_eq!(sound.results["bone_marker"]["matrix"], sound.results["camera_marker"]["matrix"]);
}

#[test]
fn a_rotation_that_rounding_does_not_explain_is_refused_by_topic_and_message() {
    let dir = tempfile::tempdir().unwrap();
    // Only the last of the forty turns by 1.95 about z.
    let scaled = |q: &UnitQuaternion<f64>| q.into_inner() * if q.scaled_axis().z > 1.94 { 1.002 } else { 1.0 };
    let ran = run_tracked(dir.path(), &tracked(scaled));
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let said = "port \"bone_marker\": topic /tracker/bone_marker, message 40 of 40: t_world_bone_marker at 1750000000000000039 \
                ns is no rigid motion: the quaternion has length 1.002";
    assert!(ran.stderr.contains(said) && ran.stderr.contains("node \"recording\""), "{}", ran.stderr);
}

#[test]
fn damaged_recordings_are_refused_by_name_and_what_is_intact_is_used_only_when_asked_for() {
    let test = "damaged_recordings_are_refused_by_name_and_what_is_intact_is_used_only_when_asked_for";
    for (file, words) in [
        ("bad_empty", "is empty"),
        ("bad_wrong_magic", "89 4D 43 41 50"),
        ("bad_truncated_60pct", "allow_truncated = true"),
    ] {
        let Some(path) = data(test, &format!("mcap/{file}.mcap")) else { return };
        let set = format!("recording.path={}", path.display());
        let ran = run(GRAPH, &["--set", &set]);
        assert_eq!(ran.code, 3, "{file}: {}", ran.stderr);
        assert!(ran.stderr.contains(words) && ran.stderr.contains("node \"recording\""), "{}", ran.stderr);
        assert!(ran.results["refused"]["reason"].as_str().unwrap().contains(words), "{}", ran.results);
        assert!(ran.results.get("poses").is_none(), "{}", ran.results);
    }
    let Some(path) = data(test, "mcap/bad_truncated_60pct.mcap") else { return };
    let set = format!("recording.path={}", path.display());
    let ran = run(GRAPH, &["--set", &set, "--set", "recording.allow_truncated=true"]);
    assert_eq!(ran.code, 3);
    // The warnings list what was used and what the cut removed.
    assert!(ran.stderr.contains("are used") && ran.stderr.contains("/camera/laser_p3"), "{}", ran.stderr);
}
