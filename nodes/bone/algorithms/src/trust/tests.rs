mod hand_eye;
mod whole;
mod world;

use super::*;
use crate::mesh_query::MeshQuery;
use crate::sample;
use crate::sensor_noise::sensor_noise_mm;
use crate::shapes::shaft;
use crate::target::Target;
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Cloud, Mesh, NamedPoint, Plane, Planes, SurfaceOrigin};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};

const NOISE_MM: f64 = 0.05;

/// Compares with the golden text, or writes it with `UPDATE=1`.
pub(super) fn golden(name: &str, found: &str) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/trust/tests").join(name);
    let found = format!("{found}\n");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, &found).unwrap();
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap_or_default(), found, "{name}: see the diff after UPDATE=1");
}

fn target_of(mesh: &Mesh) -> Target {
    let samples = sample::surface(mesh, 60_000, &mut ChaCha8Rng::seed_from_u64(1));
    let target = Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap();
    target.with_mesh(MeshQuery::new(mesh))
}

/// The side of a mesh that a camera at x = 200 mm sees, between heights, with noise along the normals.
fn scan_of(mesh: &Mesh, heights: [f64; 2], seed: u64) -> Cloud {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let samples = sample::surface(mesh, 60_000, &mut rng);
    let camera = Point3::new(200.0, 0.0, (heights[0] + heights[1]) / 2.0);
    let seen = samples
        .points
        .iter()
        .zip(&samples.normals)
        .filter(|(p, n)| (heights[0]..heights[1]).contains(&p.z) && n.dot(&(camera - *p).normalize()) > 0.35);
    let points: Vec<Point3<f64>> = seen
        .map(|(p, n)| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            p + n * (NOISE_MM * noise)
        })
        .collect();
    let viewpoint = Isometry3::translation(camera.x, camera.y, camera.z);
    Cloud::new("scan", points).unwrap().seen_from(viewpoint)
}

fn flipped(mesh: &Mesh) -> Mesh {
    let vertices: Vec<Point3<f64>> = mesh.vertices().iter().map(|p| Point3::new(p.x, -p.y, p.z)).collect();
    let faces: Vec<[u32; 3]> = mesh.faces().iter().map(|&[a, b, c]| [a, c, b]).collect();
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
}

fn marks() -> Vec<NamedPoint> {
    let surface = MeshQuery::new(&shaft());
    [("P1", 30.0, 0.3), ("P2", 60.0, -0.6), ("P3", 55.0, 0.6)]
        .iter()
        .map(|&(name, z, turn): &(&str, f64, f64)| {
            let from = Point3::new(50.0 * turn.cos(), 50.0 * turn.sin(), z);
            let centre = Point3::new(0.0005 * z * z, 0.0, z);
            NamedPoint::new(name, surface.cast_ray(&from, &(centre - from)).unwrap().point)
        })
        .collect()
}

/// The verdict on a scan at a pose, with landmarks located where they are planned.
fn verdict(target: &Target, scan: &Cloud, pose: &Isometry3<f64>, located: &[NamedPoint]) -> Verdict {
    measured_by_stylus(target, scan, pose, located, None)
}

/// The same, with the mean error that a stylus measured.
fn measured_by_stylus(
    target: &Target,
    scan: &Cloud,
    pose: &Isometry3<f64>,
    located: &[NamedPoint],
    measured_tre_mm: Option<f64>,
) -> Verdict {
    let marks = marks();
    let case = Case { landmarks: &marks, located, assessment: &marks, measured_tre_mm, ..bare(target, scan, pose) };
    judge(&case, &EvidenceParams::default(), &RuleParams::default(), &PredictParams::default())
}

/// A registration with nothing beside it.
fn bare<'a>(target: &'a Target, source: &'a Cloud, t_target_source: &'a Isometry3<f64>) -> Case<'a> {
    Case::new(Registered { target, source, t_target_source, at: &[] })
}

fn rules(verdict: &Verdict) -> Vec<&str> {
    verdict.reasons.iter().map(|reason| reason.rule.as_str()).collect()
}

#[test]
fn a_right_registration_is_trusted_and_one_that_slid_turned_or_rests_short_is_not() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 2));
    let right = verdict(&target, &scan, &Isometry3::identity(), &marks());
    assert_eq!(right.answer, Answer::Trusted, "{:?}", right.reasons);
    assert!(!right.assumptions.is_empty() && right.sentence.contains("predicted"), "{}", right.sentence);
    for (wrong, what) in [
        (Isometry3::translation(0.0, 0.0, 10.0), "slid by 10 mm"),
        (Isometry3::rotation(Vector3::z() * 0.5), "turned by 29 degrees"),
        (Isometry3::translation(0.0, 0.0, 1.5), "rests 1.5 mm short"),
    ] {
        let verdict = verdict(&target, &scan, &wrong, &marks());
        assert_ne!(verdict.answer, Answer::Trusted, "{what}: {:?}", verdict.measured);
    }
}

#[test]
fn a_mirrored_surface_is_refused_and_the_mirror_named() {
    let scan = scan_of(&shaft(), [15.0, 105.0], 3);
    let image = target_of(&flipped(&shaft()));
    let pose = crate::coarse::global(&image, &scan, &Default::default()).unwrap().t_target_source;
    let verdict = verdict(&image, &scan, &pose, &[]);
    assert_eq!(verdict.answer, Answer::Refused, "{:?}", verdict.measured);
    assert!(rules(&verdict).contains(&"mirrored"), "{:?}", verdict.reasons);
}

#[test]
fn exchanged_landmarks_are_doubtful_even_where_the_pose_is_right() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 4));
    let mut located = marks();
    let names: Vec<_> = located.iter().map(|p| p.name.clone()).collect();
    (located[1].name, located[2].name) = (names[2].clone(), names[1].clone());
    let verdict = verdict(&target, &scan, &Isometry3::identity(), &located);
    assert_eq!((verdict.answer, rules(&verdict)), (Answer::Doubtful, vec!["landmark_order"]));
    assert!(verdict.sentence.contains("P1, P3, P2"), "{}", verdict.sentence);
}

#[test]
fn a_cylinder_leaves_a_motion_undetermined() {
    let side = |k: u32| f64::from(k) / 48.0 * std::f64::consts::TAU;
    let ring = |z: f64| (0..48).map(move |k| Point3::new(6.0 * side(k).cos(), 6.0 * side(k).sin(), z));
    let vertices: Vec<Point3<f64>> = (0..=120).flat_map(|i| ring(f64::from(i))).collect();
    let at = |i: u32, k: u32| i * 48 + k % 48;
    let faces: Vec<[u32; 3]> = (0..120)
        .flat_map(|i| {
            (0..48).flat_map(move |k| {
                [[at(i, k), at(i, k + 1), at(i + 1, k)], [at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)]]
            })
        })
        .collect();
    let cylinder = Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap();
    let (target, scan) = (target_of(&cylinder), scan_of(&cylinder, [15.0, 105.0], 5));
    let verdict = verdict(&target, &scan, &Isometry3::identity(), &[]);
    assert_ne!(verdict.answer, Answer::Trusted, "{:?}", verdict.measured);
    assert!(rules(&verdict).contains(&"spread"), "{:?}", verdict.reasons);
}

#[test]
fn tissue_outside_does_not_count_as_misfit_and_a_dent_inside_does() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 6));
    let surface = MeshQuery::new(&shaft());
    // Of uneven thickness, as tissue is: a band that is displaced as a whole is a part of the bone.
    let moved = |by_mm: f64| {
        let patch = |p: &Point3<f64>| {
            let closest = surface.closest_point(p).unwrap();
            let thickness = 1.0 + 0.5 * (1.3 * p.z + 0.7 * p.y).sin();
            if (40.0..60.0).contains(&p.z) { p + closest.normal * (by_mm * thickness) } else { *p }
        };
        let points: Vec<Point3<f64>> = scan.points().iter().map(patch).collect();
        let cloud = Cloud::new("scan", points).unwrap().seen_from(scan.viewpoint.unwrap());
        verdict(&target, &cloud, &Isometry3::identity(), &marks())
    };
    let tissue = moved(1.0);
    assert_eq!(tissue.answer, Answer::Trusted, "{:?} {:?}", tissue.reasons, tissue.measured);
    assert!(tissue.measured.unwrap().outside > 0.15);
    let dent = moved(-1.0);
    assert_ne!(dent.answer, Answer::Trusted, "{:?}", dent.measured);
}

#[test]
fn parts_inside_the_bone_that_a_robust_fit_leaves_out_are_told_with_their_share_and_depth() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 6));
    let surface = MeshQuery::new(&shaft());
    let sunk = |p: &Point3<f64>| {
        let on = surface.closest_point(p).unwrap();
        if (33.0..69.0).contains(&p.z) { p - on.normal * 1.0 } else { *p }
    };
    let points: Vec<Point3<f64>> = scan.points().iter().map(sunk).collect();
    let scan = Cloud::new("scan", points).unwrap();
    // The robust fit stays where the rest lies.
    let params = crate::icp::IcpParams::default();
    let observer = &mut |_: &crate::icp::IcpStep| std::ops::ControlFlow::Continue(());
    let method = crate::icp::Method::PointToPlane;
    let fit = crate::icp::register(method, &target, &scan, &Isometry3::identity(), &params, observer).unwrap();
    let verdict = verdict(&target, &scan, &fit.t_target_source, &marks());
    assert!(verdict.answer != Answer::Trusted && rules(&verdict).contains(&"inside"), "{:?}", verdict.reasons);
    let Inside { share, depth_mm } = verdict.measured.unwrap().inside_patches;
    assert!((share - 0.4).abs() < 0.08 && (depth_mm - 1.0).abs() < 0.1, "{share} of it {depth_mm} mm inside");
}

#[test]
fn a_pose_settled_with_some_of_many_points_is_that_of_all() {
    let target = target_of(&shaft());
    let points: Vec<Point3<f64>> =
        (20..26).flat_map(|seed| scan_of(&shaft(), [15.0, 105.0], seed).points().to_vec()).collect();
    let few = Cloud::new("scan", points.iter().step_by(points.len().div_ceil(10_000)).copied().collect::<Vec<_>>());
    let (all, few) = (Cloud::new("scan", points).unwrap(), few.unwrap());
    assert!(all.len() > 3 * few.len(), "{} points", all.len());
    let start = Isometry3::new(Vector3::new(0.1, -0.05, 1.5), Vector3::new(0.0, 0.002, 0.02));
    let unsettled = |scan: &Cloud| {
        let registered = Registered { target: &target, source: scan, t_target_source: &start, at: &[] };
        Evidence::examine(&registered, &EvidenceParams::default(), None).unwrap().evidence.unsettled_mm.unwrap()
    };
    let (of_all, of_few) = (unsettled(&all), unsettled(&few));
    // The same points are settled, and the distance is of other points of the scan.
    assert!((of_all - of_few).abs() < 0.02 && of_all > 1.0, "{of_all:.4} and {of_few:.4} mm");
    let params = crate::icp::IcpParams { max_pair_distance_mm: 2.0, ..crate::icp::IcpParams::default() };
    let observer = &mut |_: &crate::icp::IcpStep| std::ops::ControlFlow::Continue(());
    let method = crate::icp::Method::PointToPlane;
    let whole = crate::icp::register(method, &target, &all, &start, &params, observer).unwrap().t_target_source;
    let moved = |p: &Point3<f64>| (whole * start.inverse() * (start * p) - start * p).norm();
    let mean = all.points().iter().map(moved).sum::<f64>() / all.len() as f64;
    // A tenth of what the prediction knows better.
    assert!((of_all - mean).abs() < 0.03, "{of_all:.4} mm with some, {mean:.4} mm with all");
}

#[test]
fn the_noise_of_a_scan_is_found_without_the_surface() {
    for (seed, factor) in [(7, 1.0), (8, 4.0)] {
        let scan = scan_of(&shaft(), [15.0, 105.0], seed);
        let surface = MeshQuery::new(&shaft());
        let points: Vec<Point3<f64>> = scan
            .points()
            .iter()
            .map(|p| {
                let on = surface.closest_point(p).unwrap().point;
                on + (p - on) * factor
            })
            .collect();
        let noise = sensor_noise_mm(&points).unwrap();
        let expected = NOISE_MM * factor;
        assert!((noise / expected - 1.0).abs() < 0.15, "{noise:.3} mm, but {expected:.3} mm is there");
    }
    assert_eq!(sensor_noise_mm(&[Point3::origin(); 5]), None);
}

#[test]
fn a_scan_on_the_side_that_its_camera_cannot_see_is_refused() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 2));
    let behind = scan.clone().seen_from(Isometry3::translation(-200.0, 0.0, 60.0));
    let [seen, hidden] = [scan, behind].map(|scan| verdict(&target, &scan, &Isometry3::identity(), &marks()));
    assert!(!rules(&seen).contains(&"facing_away"), "{:?}", seen.reasons);
    assert!(rules(&hidden).contains(&"facing_away") && hidden.answer == Answer::Refused, "{:?}", hidden.reasons);
    let share = hidden.measured.unwrap().facing_away.unwrap();
    assert!(share > 0.9, "{share}");
}

#[test]
fn what_the_stylus_measures_is_judged_by_its_limit() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 2));
    let limit = RuleParams::default().max_measured_tre_mm;
    for (measured, expected) in [
        (0.5, Answer::Trusted),
        (limit, Answer::Doubtful),
        (1.01 * limit, Answer::Doubtful),
        (2.99 * limit, Answer::Doubtful),
        (3.01 * limit, Answer::Refused),
    ] {
        let verdict = measured_by_stylus(&target, &scan, &Isometry3::identity(), &marks(), Some(measured));
        assert_eq!(verdict.answer, expected, "{measured} mm: {:?}", verdict.reasons);
        assert_eq!(rules(&verdict).contains(&"stylus"), expected != Answer::Trusted, "{measured} mm");
    }
}

#[test]
fn a_plan_of_other_coordinates_is_refused_with_the_likely_cause() {
    // Away from the origin, as in every CT: near it a half turn about z changes little.
    let away = Isometry3::translation(80.0, 50.0, 0.0);
    let surface = MeshQuery::new(&shaft().transformed("ct", &away));
    let marks =
        || -> Vec<NamedPoint> { marks().iter().map(|p| NamedPoint::new(p.name.clone(), away * p.position)).collect() };
    assert_eq!(plan_faults(&surface, &marks(), None), []);
    let scaled = |scale: [f64; 3]| -> Vec<NamedPoint> {
        let of = |p: &NamedPoint| Point3::from(p.position.coords.component_mul(&Vector3::from(scale)));
        marks().iter().map(|p| NamedPoint::new(p.name.clone(), of(p))).collect()
    };
    for (scale, word) in [([0.001; 3], "metres"), ([1.0, 1.0, -1.0], "mirrored in z"), ([-1.0, -1.0, 1.0], "RAS")] {
        let faults = plan_faults(&surface, &scaled(scale), None);
        let [fault] = &faults[..] else { panic!("{faults:?}") };
        assert!(fault.reason.starts_with("3 of 3 planned points lie off the surface"), "{fault:?}");
        assert!(fault.reason.contains(word), "{fault:?}");
    }
    let plane = |name: &str, x: f64, z: f64, turned: bool| {
        let turn = if turned { Vector3::x() * std::f64::consts::PI } else { Vector3::zeros() };
        Plane::new(name, away * Isometry3::new(Vector3::new(x, 0.0, z), turn))
    };
    let faults = |planes: Vec<Plane>| plan_faults(&surface, &[], Some(&Planes::new("ct", planes)));
    assert_eq!(faults(vec![plane("a", 0.0, 70.0, false), plane("b", 0.0, 90.0, false)]), []);
    let told = |planes: Vec<Plane>, answer: Answer, words: &str| {
        let faults = faults(planes);
        assert!(
            matches!(&faults[..], [fault] if fault.answer == answer && fault.reason.starts_with(words)),
            "{faults:?}"
        );
    };
    told(vec![], Answer::Doubtful, "the plan has no cutting planes");
    told(
        vec![plane("a", 1000.0, 70.0, false)],
        Answer::Refused,
        "the planned plane a does not cut the bone, its origin is",
    );
    let turned = vec![plane("a", 0.0, 70.0, false), plane("b", 0.0, 90.0, true)];
    told(turned, Answer::Doubtful, "the normals of a and b do not both point from a to b");
}

#[test]
fn the_predicted_interval_holds_nine_tenths_of_the_errors_of_its_own_model() {
    use nalgebra::{Matrix6, Vector6};
    let sd = Vector6::new(0.1, 0.1, 0.3, 0.002, 0.002, 0.004);
    let covariance = Matrix6::from_diagonal(&sd.component_mul(&sd));
    let centre = Point3::new(0.0, 0.0, 60.0);
    let spread = Spread { covariance, centre, bias: Matrix6::zeros(), n_cells: 20 };
    let place = Where { points: &marks(), cuts: &[], limited: &[] };
    let set = predict(
        &spread,
        &Isometry3::identity(),
        None,
        None,
        &[],
        &place,
        &Limits::default(),
        &PredictParams::default(),
    )
    .assessment
    .unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let errors: Vec<f64> = (0..2000)
        .map(|_| {
            let x = Vector6::from_fn(|k, _| {
                let draw: f64 = StandardNormal.sample(&mut rng);
                sd[k] * draw
            });
            let (shift, turn) = (x.fixed_rows::<3>(0).into_owned(), x.fixed_rows::<3>(3).into_owned());
            let scale: f64 = StandardNormal.sample(&mut rng);
            let mean = marks().iter().map(|p| (shift + turn.cross(&(p.position - centre))).norm()).sum::<f64>() / 3.0;
            mean * (1.0 + 0.2 * scale).abs()
        })
        .collect();
    let held = errors.iter().filter(|e| (set.interval_mm[0]..set.interval_mm[1]).contains(e)).count();
    assert!((1760..=1840).contains(&held), "{held} of 2000 within {:?}", set.interval_mm);
}
