//! Registration and hole detection on real bones seen by one camera.

use crate::common::{Bone, CLEAN, Noise, USUAL, apart, bones, displaced, own_bone};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::Refusal;
use osteoflow_algorithms::coarse::{GlobalParams, global};
use osteoflow_algorithms::hole::{self, Hole, HoleParams};
use osteoflow_algorithms::icp::{self, IcpFit, IcpParams, StopReason};
use osteoflow_algorithms::landmarks::{RecipeParams, paper_recipe};
use osteoflow_algorithms::section;
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{Anatomy, Cloud, NamedPoint};
use std::ops::ControlFlow;

const SHAFT: [f64; 2] = [70.0, 165.0];

fn shaft(bone: &Bone, noise: &Noise, seed: u64) -> Cloud {
    bone.scan(&bone.camera(117.0), SHAFT, 0.25, noise, None, seed)
}

fn middle(cloud: &Cloud) -> Point3<f64> {
    let sum: Vector3<f64> = cloud.points().iter().map(|p| p.coords).sum();
    Point3::from(sum / cloud.len() as f64)
}

fn point(target: &Target, source: &Cloud, init: &Isometry3<f64>, params: &IcpParams) -> IcpFit {
    icp::register(icp::Method::PointToPoint, target, source, init, params, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn plane(target: &Target, source: &Cloud, init: &Isometry3<f64>, params: &IcpParams) -> IcpFit {
    icp::register(icp::Method::PointToPlane, target, source, init, params, &mut |_| ControlFlow::Continue(())).unwrap()
}

/// Distance of a result from the truth, the identity.
fn error(fit: &IcpFit, source: &Cloud) -> f64 {
    apart(&fit.t_target_source, &Isometry3::identity(), source.points())
}

#[test]
fn point_to_plane_comes_back_from_displaced_starts() {
    for bone in bones("point_to_plane_comes_back_from_displaced_starts") {
        let (source, target) = (shaft(&bone, &USUAL, 1), bone.target(150_000));
        for seed in 0..8 {
            let init = displaced(&middle(&source), 4.0, 4_f64.to_radians(), seed);
            let fit = plane(&target, &source, &init, &IcpParams::default());
            let error = error(&fit, &source);
            assert!(fit.report.converged, "{} from start {seed}: {:?}", bone.name, fit.report);
            // Depth noise of 0.05 mm over 17,000 points, and the grain of the samples.
            assert!(error < 0.03, "{} from start {seed}: {error:.3} mm", bone.name);
        }
    }
}

#[test]
fn a_slide_of_8_mm_along_the_bone_comes_back() {
    for bone in bones("a_slide_of_8_mm_along_the_bone_comes_back") {
        let (source, target) = (shaft(&bone, &USUAL, 2), bone.target(150_000));
        for slide in [8.0, -8.0] {
            let init = Translation3::from(bone.proximal * slide).into();
            let by_plane = plane(&target, &source, &init, &IcpParams::default());
            assert!(error(&by_plane, &source) < 0.03, "{} by planes: {:.3} mm", bone.name, error(&by_plane, &source));
            let by_point = point(&target, &source, &init, &IcpParams::default());
            let (left, report) = (error(&by_point, &source), by_point.report);
            assert!(left < 1.0, "{} by points: {left:.3} mm left of {slide}, report {report:?}", bone.name);
            let resolution = report.resolution_mm.unwrap();
            assert!(report.converged && left < 4.0 * resolution, "{left:.3} mm left, resolution {resolution:.3} mm");
        }
    }
}

/// Start number `k`, turned about the bone at the scan's centroid and slid along it by up to 8 mm.
fn turned_start(bone: &Bone, source: &Cloud, k: i32, turn_deg: f64) -> Isometry3<f64> {
    let centre = middle(source).coords;
    let about = UnitQuaternion::from_scaled_axis(bone.proximal * turn_deg.to_radians());
    let slide = f64::from(k % 5 - 2) * 4.0;
    Translation3::from(centre + bone.proximal * slide) * about * Translation3::from(-centre)
}

/// Without the Gauss-Newton steps, the two calm steps or the plain steps at the end, starts end 1.6 mm off and more on
/// seeds 11 to 16, with them 0.9 mm, by which the limit was chosen; these seeds played no part in that.
#[test]
fn turned_starts_end_at_one_place_on_a_straight_stretch_of_the_own_bone() {
    let bone = own_bone();
    let target = bone.target(20_000);
    for seed in 21..25 {
        let source = bone.scan(&bone.camera(155.0), [120.0, 190.0], 0.5, &USUAL, None, seed);
        for start in 0..12 {
            let k = 2 * start + (start / 2 + seed as i32) % 2;
            let init = turned_start(&bone, &source, k, f64::from(k % 2 * 2 - 1) * (6.0 + 1.5 * f64::from(k)));
            let fit = point(&target, &source, &init, &IcpParams::default());
            let left = error(&fit, &source);
            assert!(left < 1.0, "seed {seed}, start {k}: {left:.2} mm off after {} steps", fit.report.iterations);
        }
    }
}

/// Few points at the start determine how far a scan is turned, but not how far it has slid: an extrapolated step along
/// the bone must not lead to another stationary point.
#[test]
fn a_turned_start_does_not_send_points_away_along_the_bone() {
    for bone in bones("a_turned_start_does_not_send_points_away_along_the_bone") {
        let (source, target) = (shaft(&bone, &USUAL, 3), bone.target(60_000));
        let error = |k| {
            let init = turned_start(&bone, &source, k, f64::from(k % 2 * 2 - 1) * (16.0 + f64::from(k)));
            error(&point(&target, &source, &init, &IcpParams::default()), &source)
        };
        let worst = (0..24).map(error).fold(0.0, f64::max);
        // Four times the resolution that the last samples have here, and some.
        assert!(worst < 2.0, "{}: {worst:.2} mm", bone.name);
    }
}

#[test]
fn a_crawl_is_not_called_converged_and_says_what_it_leaves() {
    let Some(bone) = bones("a_crawl_is_not_called_converged_and_says_what_it_leaves").into_iter().next() else {
        return;
    };
    let (source, target) = (shaft(&bone, &USUAL, 2), bone.target(150_000));
    let init = Translation3::from(bone.proximal * 8.0).into();
    let plain = IcpParams { acceleration: 0, max_iterations: 60, ..IcpParams::default() };
    let fit = point(&target, &source, &init, &plain);
    let left = error(&fit, &source);
    assert!(left > 5.0, "plain steps recover little of a slide, but only {left:.2} mm are left");
    assert!(!fit.report.converged && fit.report.stop_reason == StopReason::Iterations, "{:?}", fit.report);
    let remaining = fit.report.remaining_mm.unwrap();
    assert!(remaining > 20.0 * fit.report.step_mm, "{remaining} mm left after a step of {} mm", fit.report.step_mm);
    // "The residual changed by less than 0.01 mm", as the paper may be read.
    let loose = IcpParams { stop_residual_mm: 0.01, levels: Vec::new(), ..plain };
    let fit = point(&target, &source, &init, &loose);
    assert!(fit.report.stop_reason == StopReason::Residual && fit.report.iterations < 15, "{:?}", fit.report);
    assert!(!fit.report.converged && error(&fit, &source) > 5.0);
}

#[test]
fn the_result_does_not_depend_on_threads_nor_on_the_order_of_points() {
    let Some(bone) = bones("the_result_does_not_depend_on_threads_nor_on_the_order_of_points").into_iter().next()
    else {
        return;
    };
    let source = shaft(&bone, &USUAL, 3);
    let init = displaced(&middle(&source), 3.0, 0.05, 5);
    let run = |n_threads: usize, source: &Cloud| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let target = bone.target(60_000);
            let params = IcpParams { trim_fraction: 0.05, ..IcpParams::default() };
            (plane(&target, source, &init, &params), point(&target, source, &init, &params))
        })
    };
    let one = run(1, &source);
    assert_eq!(one, run(2, &source), "two threads");
    assert_eq!(one, run(8, &source), "eight threads");
    let backwards: Vec<usize> = (0..source.len()).rev().collect();
    assert_eq!(one, run(2, &source.selected(&backwards)), "the other way round");
}

#[test]
fn nearly_ten_kilometres_from_the_origin_the_answer_is_the_same() {
    let test = "nearly_ten_kilometres_from_the_origin_the_answer_is_the_same";
    let Some(bone) = bones(test).into_iter().next() else { return };
    let source = shaft(&bone, &USUAL, 4);
    let target = bone.target(60_000);
    let init = displaced(&middle(&source), 3.0, 0.05, 6);
    let here = plane(&target, &source, &init, &IcpParams::default()).t_target_source;
    // 10 km are the limit of coordinates.
    for (far, tolerance) in [(1e4, 1e-6), (9.9e6, 1e-4)] {
        let away = Isometry3::translation(far, -far, far);
        let points: Vec<Point3<f64>> = target.points().iter().map(|p| away * p).collect();
        let moved = Target::new("ct", target.origin, points, target.normal_column().cloned()).unwrap();
        let source = source.transformed("ct", &away);
        let init = away * init * away.inverse();
        let there = plane(&moved, &source, &init, &IcpParams::default()).t_target_source;
        let expected = away * here * away.inverse();
        let off = apart(&there, &expected, source.points());
        // f64 holds 2e-9 mm at 10 km.
        assert!(off < tolerance, "{far} mm away: {off} mm");
    }
}

#[test]
fn the_recipe_finds_the_landmarks_of_the_development_plan() {
    let test = "the_recipe_finds_the_landmarks_of_the_development_plan";
    let Some(path) = crate::common::data(test, "recordings/procedure_dev.plan.json") else { return };
    let Some(bone) = bones(test).into_iter().next() else { return };
    let plan: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let anatomy = Anatomy {
        malleolus_tip: bone.tip,
        proximal: nalgebra::Unit::new_normalize(bone.proximal),
        lateral: nalgebra::Unit::new_normalize(bone.lateral),
        posterior: nalgebra::Unit::new_normalize(bone.posterior),
    };
    let result: Vec<NamedPoint> = paper_recipe(&bone.query, &anatomy, &RecipeParams::default()).unwrap();
    for landmark in result {
        let at = &plan["landmarks"][&*landmark.name];
        let planned = Point3::new(at[0].as_f64().unwrap(), at[1].as_f64().unwrap(), at[2].as_f64().unwrap());
        let off = landmark.position - planned;
        // Both lie on one face at one height; where the middle of the bone is taken to be differs across the face.
        assert!(off.dot(&bone.proximal).abs() < 0.01, "{}: {off:?}", landmark.name);
        assert!(off.norm() < 2.0, "{}: {:.2} mm", landmark.name, off.norm());
    }
}

/// How the refusal of a scan without a hole begins.
const NO_HOLE: &str = "no hole of ";

fn assert_refused(hole: Result<Hole, Refusal>, reason: &str) {
    let message = hole.unwrap_err().to_string();
    assert!(message.contains(reason), "{reason}: {message}");
}

type Detector = fn(&Cloud, &Cloud, &HoleParams) -> Result<Hole, Refusal>;

const DETECTORS: [(&str, Detector); 2] =
    [("cloud_difference", hole::cloud_difference), ("range_image", hole::range_image)];

/// Where landmarks lie: on the faces that the camera sees, clear of the silhouette.
fn spots(bone: &Bone) -> Vec<Point3<f64>> {
    let faces = [bone.lateral, bone.posterior, (bone.lateral + bone.posterior).normalize()];
    [85.0, 100.0, 117.0, 130.0, 150.0]
        .into_iter()
        .flat_map(|height| faces.map(|face| (height, face)))
        .map(|(height, face)| {
            let turn = Rotation3::rotation_between(&Vector3::z(), &bone.proximal).unwrap();
            let at = bone.tip + bone.proximal * height;
            let plane = Isometry3::from_parts(at.coords.into(), UnitQuaternion::from_rotation_matrix(&turn));
            let middle = section::middle(&bone.mesh, &plane, None).unwrap();
            bone.query.cast_ray(&(middle + face * 100.0), &-face).unwrap().point
        })
        .collect()
}

#[test]
fn the_centre_of_a_laser_hole_is_found_although_both_scans_are_spoilt() {
    for bone in bones("the_centre_of_a_laser_hole_is_found_although_both_scans_are_spoilt") {
        for (name, detect) in DETECTORS {
            let mut errors = Vec::new();
            for (k, spot) in spots(&bone).into_iter().enumerate() {
                let seed = 100 + 2 * k as u64;
                let camera = bone.camera(117.0);
                let reference = bone.scan(&camera, SHAFT, 0.22, &USUAL, None, seed);
                let moved = displaced(&Point3::from(camera.translation.vector), 5.0, 0.01, seed) * camera;
                let laser = bone.scan(&moved, SHAFT, 0.22, &USUAL, Some((spot, 2.0)), seed + 1);
                let hole = detect(&reference, &laser, &HoleParams::default())
                    .unwrap_or_else(|e| panic!("{} {name} spot {k}: {e}", bone.name));
                errors.push((hole.centre - spot).norm());
            }
            errors.sort_by(f64::total_cmp);
            let (median, max) = (errors[errors.len() / 2], errors[errors.len() - 1]);
            assert!(median < 0.15 && max < 0.8, "{} {name}: median {median:.3}, largest {max:.3} mm", bone.name);
        }
    }
}

#[test]
fn what_is_no_single_hole_is_refused_with_the_reason() {
    let Some(bone) = bones("what_is_no_single_hole_is_refused_with_the_reason").into_iter().next() else { return };
    let camera = bone.camera(117.0);
    let reference = bone.scan(&camera, SHAFT, 0.25, &CLEAN, None, 1);
    let params = HoleParams::default();
    let spots = spots(&bone);
    let one = bone.scan(&camera, SHAFT, 0.25, &CLEAN, Some((spots[4], 2.0)), 2);
    let keep = |p: &Point3<f64>| (p - spots[13]).norm() > 2.0;
    let two = one.selected(&(0..one.len()).filter(|&i| keep(&one.points()[i])).collect::<Vec<_>>());
    let none = bone.scan(&camera, SHAFT, 0.25, &CLEAN, None, 3);
    // The view ends in the middle of the reference: what is missing beyond is no hole.
    let half = bone.scan(&camera, [70.0, 117.0], 0.25, &CLEAN, None, 4);
    let apart = one.transformed("ct", &Isometry3::translation(2.0, 2.0, 0.0));
    let sparse = (bone.scan(&camera, SHAFT, 1.2, &CLEAN, None, 5), bone.scan(&camera, SHAFT, 1.2, &CLEAN, None, 6));
    let empty = Cloud::new("ct", Vec::new()).unwrap().seen_from(camera);
    for (name, detect) in DETECTORS {
        assert!(detect(&reference, &one, &params).is_ok(), "{name}");
        for (reference, scan, reason) in [
            (&reference, &two, "2 holes look alike"),
            (&reference, &none, NO_HOLE),
            (&reference, &half, NO_HOLE),
            (&reference, &apart, "mm (median) from the reference scan"),
            (&sparse.0, &sparse.1, "mm apart on the surface"),
            (&reference, &empty, "the laser scan has no points"),
        ] {
            assert_refused(detect(reference, scan, &params), reason);
        }
    }
    let blind = Cloud::new("ct", one.points().to_vec()).unwrap();
    assert!(hole::cloud_difference(&reference, &blind, &params).is_ok());
    assert_refused(hole::range_image(&reference, &blind, &params), "the laser scan has no viewpoint");
    assert!(hole::boundary(&one, &params).is_ok());
    assert_refused(hole::boundary(&two, &params), "2 holes look alike");
    assert_refused(hole::boundary(&none, &params), NO_HOLE);
    assert_refused(hole::boundary(&empty, &params), "the laser scan has no points");
    assert_refused(hole::boundary(&blind, &params), "the laser scan has no viewpoint");
}

#[test]
fn a_gap_in_one_scan_is_found_without_a_reference_where_scan_lies_all_around_it() {
    for bone in bones("a_gap_in_one_scan_is_found_without_a_reference_where_scan_lies_all_around_it") {
        let (mut errors, mut refused) = (Vec::new(), 0);
        for (k, spot) in spots(&bone).into_iter().enumerate() {
            let laser = bone.scan(&bone.camera(117.0), SHAFT, 0.22, &USUAL, Some((spot, 2.0)), 101 + 2 * k as u64);
            match hole::boundary(&laser, &HoleParams::default()) {
                Ok(hole) => errors.push((hole.centre - spot).norm()),
                // At the silhouette, which is open on one side.
                Err(error) if error.to_string().starts_with(NO_HOLE) => refused += 1,
                Err(error) => panic!("{} spot {k}: {error}", bone.name),
            }
        }
        errors.sort_by(f64::total_cmp);
        let (median, max) = (errors[errors.len() / 2], errors[errors.len() - 1]);
        assert!(refused <= 4, "{}: {refused} of 15 refused", bone.name);
        assert!(median < 0.5 && max < 1.0, "{}: median {median:.3}, largest {max:.3} mm", bone.name);
    }
}

#[test]
fn a_long_scan_finds_its_place_by_shape_alone_and_a_short_one_says_that_it_may_not() {
    for bone in bones("a_long_scan_finds_its_place_by_shape_alone_and_a_short_one_says_that_it_may_not") {
        let target = bone.target(150_000);
        for (heights, seed) in [([0.0, 125.0], 1), (SHAFT, 2), ([80.0, 120.0], 1)] {
            let scan = bone.scan(&bone.camera((heights[0] + heights[1]) / 2.0), heights, 0.3, &USUAL, None, seed);
            let away = displaced(&middle(&scan), 150.0, 2.5, seed + 40);
            let fit = global(&target, &scan.transformed("world", &away.inverse()), &GlobalParams::default()).unwrap();
            let off = apart(&(fit.t_target_source * away.inverse()), &Isometry3::identity(), scan.points());
            let clearness = fit.report.clearness;
            if heights[1] - heights[0] > 50.0 {
                assert!(off < 0.5 && clearness > 0.5, "{} {heights:?}: {off:.2} mm off, clear {clearness}", bone.name);
            } else {
                let right = off < 0.5;
                assert!(right || clearness < 0.3, "{} {heights:?}: {off:.2} mm off, clear {clearness}", bone.name);
            }
        }
        let few = shaft(&bone, &CLEAN, 1).selected(&[0, 1, 2]);
        let error = global(&target, &few, &GlobalParams::default());
        assert!(error.unwrap_err().to_string().starts_with("the scan has 3 points, 12 are needed"));
    }
}
