use super::*;
use crate::kabsch::kabsch;
use crate::mesh_query::MeshQuery;
use crate::sample;
use crate::shapes::{cuboid, shaft};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

fn target(mesh: &Mesh, n: usize) -> Target {
    let samples = sample::surface(mesh, n, &mut ChaCha8Rng::seed_from_u64(1));
    Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap()
}

fn source(mesh: &Mesh, n: usize) -> Vec<Point3<f64>> {
    sample::surface(mesh, n, &mut ChaCha8Rng::seed_from_u64(2)).points
}

fn start() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.8, -1.0, 1.5), Vector3::new(0.01, -0.02, 0.03))
}

fn go_on(_: &IcpStep) -> ControlFlow<Halt> {
    ControlFlow::Continue(())
}

fn off(fit: &IcpFit, truth: &Isometry3<f64>, source: &[Point3<f64>]) -> f64 {
    let squares: f64 = source.iter().map(|p| (fit.t_target_source * p - truth * p).norm_squared()).sum();
    (squares / source.len() as f64).sqrt()
}

#[test]
fn both_variants_find_the_motion_and_moving_the_source_multiplies_the_answer() {
    let (target, source) = (target(&shaft(), 40_000), source(&shaft(), 5000));
    let motion = Isometry3::new(Vector3::new(100.0, 200.0, -50.0), Vector3::new(0.5, 1.0, -0.3));
    let moved: Vec<_> = source.iter().map(|p| motion.inverse() * p).collect();
    let init = start() * motion;
    let params = IcpParams::default();
    // Samples half a millimetre apart limit planes by their noise, points by their resolution.
    let plane = register(Method::PointToPlane, &target, &moved, &init, &params, &mut go_on).unwrap();
    assert!(off(&plane, &motion, &moved) < 0.02 && plane.report.converged, "{:?}", plane.report);
    let point = register(Method::PointToPoint, &target, &moved, &init, &params, &mut go_on).unwrap();
    assert!(off(&point, &motion, &moved) < 0.2 && point.report.converged, "{:?}", point.report);
    for fit in [&plane, &point] {
        assert!(fit.report.observability.undetermined.is_empty());
        assert_eq!(fit.trace.steps.len(), fit.report.iterations as usize);
        assert!(fit.trace.steps.last().unwrap().rms_mm < fit.trace.steps[0].rms_mm);
    }
}

#[test]
fn point_to_point_needs_no_normals_and_point_to_plane_refuses_a_target_without() {
    let with = target(&shaft(), 40_000);
    let without = Target::new("ct", SurfaceOrigin::User, with.points().to_vec(), None).unwrap();
    let source = source(&shaft(), 5000);
    let fit = register(Method::PointToPoint, &without, &source, &start(), &IcpParams::default(), &mut go_on).unwrap();
    assert!(off(&fit, &Isometry3::identity(), &source) < 0.2 && fit.report.converged, "{:?}", fit.report);
    let refused = register(Method::PointToPlane, &without, &source, &start(), &IcpParams::default(), &mut go_on);
    assert_eq!(refused.unwrap_err(), IcpError::NoNormals);
}

#[test]
fn too_few_pairs_say_how_far_away_the_target_is() {
    let (target, source) = (target(&shaft(), 2000), source(&shaft(), 500));
    let far = Isometry3::translation(412.0, 0.0, 0.0);
    let error = register(Method::PointToPlane, &target, &source, &far, &IcpParams::default(), &mut go_on).unwrap_err();
    assert!(matches!(error, IcpError::TooFewPairs { n_pairs: 0, n_source: 500, .. }), "{error}");
    assert!(error.to_string().contains("is init right, and are both in mm?"), "{error}");
    let few = register(Method::PointToPoint, &target, &source[..5], &start(), &IcpParams::default(), &mut go_on);
    assert_eq!(few.unwrap_err(), IcpError::TooFewPoints { n_source: 5, min_pairs: 10 });
    let none: &[Point3<f64>] = &[];
    assert!(register(Method::PointToPoint, &target, none, &start(), &IcpParams::default(), &mut go_on).is_err());
    let mut wild = source.clone();
    wild[7].x = f64::INFINITY;
    let error =
        register(Method::PointToPoint, &target, &wild, &start(), &IcpParams::default(), &mut go_on).unwrap_err();
    assert!(error.to_string().contains("source point 7"), "{error}");
    let gate = IcpParams { max_pair_distance_mm: f64::NAN, ..IcpParams::default() };
    assert!(matches!(
        register(Method::PointToPoint, &target, &source, &start(), &gate, &mut go_on),
        Err(IcpError::Parameter { .. })
    ));
}

#[test]
fn an_open_surface_that_is_inside_out_is_told_from_a_wrong_start_and_a_camera_that_sees_nothing() {
    // A socket seen from within, wound towards the camera and away from it, and as a cloud.
    let (rings, around) = (40_u32, 80_u32);
    let place = |i: u32, j: u32| {
        let (tilt, turn) = (0.02 + f64::from(i) * 0.045, f64::from(j) / f64::from(around) * std::f64::consts::TAU);
        let radius = 25.0 + 1.2 * (3.0 * turn).sin() * tilt.sin().powi(2) + 0.5 * (5.0 * tilt).sin();
        Point3::from(Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), -tilt.cos()) * radius)
    };
    let index = |i: u32, j: u32| i * around + j % around;
    let vertices: Vec<Point3<f64>> = (0..rings * around).map(|k| place(k / around, k % around)).collect();
    let towards = (0..rings - 1).flat_map(|i| {
        (0..around).flat_map(move |j| {
            let [a, b, c, d] = [index(i, j), index(i, j + 1), index(i + 1, j), index(i + 1, j + 1)];
            [[a, b, c], [b, d, c]]
        })
    });
    let towards: Vec<[u32; 3]> = towards.map(|[a, b, c]| [a, c, b]).collect();
    let mesh = |faces: Vec<[u32; 3]>| Mesh::new("ct", SurfaceOrigin::Exact, vertices.clone(), faces).unwrap();
    let inwards: Vec<[u32; 3]> = towards.iter().map(|&[a, b, c]| [a, c, b]).collect();
    let (right, inside_out) = (mesh(towards), mesh(inwards));
    let camera = Point3::new(0.0, 0.0, 150.0);
    let up = right.area_vector(0).z > 0.0;
    let (right, inside_out) = if up { (right, inside_out) } else { (inside_out, right) };
    let points: Vec<Point3<f64>> = vertices.iter().filter(|p| p.z < -8.0).copied().collect();
    let run = |target: &Target, camera: Point3<f64>, start: &Isometry3<f64>| {
        let source = Source::seen_from(&points, camera);
        register(Method::PointToPlane, target, source, start, &IcpParams::default(), &mut go_on)
    };
    let start = Isometry3::translation(0.4, -0.3, 0.6);
    let with_mesh = |mesh: &Mesh| target(mesh, 20_000).with_mesh(MeshQuery::new(mesh));
    let is_right = |fit: IcpFit| off(&fit, &Isometry3::identity(), &points) < 0.2;
    assert!(is_right(run(&with_mesh(&right), camera, &start).unwrap()));
    // Normals of a cloud may have been estimated, so the scan decides.
    assert!(is_right(run(&target(&right, 20_000), camera, &start).unwrap()));
    assert!(is_right(run(&target(&inside_out, 20_000), camera, &start).unwrap()));
    let error = run(&with_mesh(&inside_out), camera, &start).unwrap_err();
    assert!(matches!(error, IcpError::TooFewFacing { n_source, n_any, .. } if n_source == n_any), "{error}");
    assert!(error.to_string().contains("Invert Faces Orientation"), "{error}");
    let far = run(&with_mesh(&inside_out), camera, &Isometry3::translation(400.0, 0.0, 0.0)).unwrap_err();
    assert!(matches!(far, IcpError::TooFewPairs { .. }), "{far}");
    // Within a closed surface nothing faces the camera.
    let closed = cuboid([-40.0; 3], [40.0; 3]);
    let error = run(&with_mesh(&closed), Point3::origin(), &Isometry3::identity()).unwrap_err();
    assert_eq!(error, IcpError::NothingFaces);
}

#[test]
fn undetermined_motions_of_a_plane_are_reported_and_stay_at_the_start() {
    let slab = target(&cuboid([0.0, 0.0, -30.0], [100.0, 100.0, 0.0]), 60_000);
    let on_top: Vec<_> =
        (0..2500).map(|k| Point3::new(30.0 + f64::from(k % 50), 30.0 + f64::from(k / 50), 0.0)).collect();
    let init = Isometry3::new(Vector3::new(3.0, -2.0, 0.8), Vector3::new(0.004, 0.006, 0.0));
    let fit = register(
        Method::PointToPlane,
        &slab,
        Source::seen_from(&on_top, Point3::new(50.0, 50.0, 300.0)),
        &init,
        &IcpParams::default(),
        &mut go_on,
    )
    .unwrap();
    let free = &fit.report.observability.undetermined;
    assert_eq!(free.len(), 3, "two shifts and a turn: {free:?}");
    assert!(free.iter().all(|d| d.translation[2].abs() < 0.1), "{free:?}");
    let middle = Point3::new(54.5, 54.5, 0.0);
    let (at, before) = (fit.t_target_source * middle, init * middle);
    assert!(at.z.abs() < 1e-3, "determined across the plane: {at}");
    assert!((at - before).xy().norm() < 0.05, "undetermined along it: {at} from {before}");
}

#[test]
fn points_on_a_line_keep_the_turn_of_the_start() {
    let target = target(&cuboid([-5.0; 3], [5.0, 5.0, 105.0]), 40_000);
    let line: Vec<_> = (0..200).map(|k| Point3::new(5.0, 0.0, f64::from(k) / 2.0)).collect();
    let init = Isometry3::from_parts(Translation3::new(0.5, 0.0, 0.0), UnitQuaternion::identity());
    let params = IcpParams::default();
    let by_plane = register(Method::PointToPlane, &target, &line, &init, &params, &mut go_on).unwrap();
    let by_point = register(Method::PointToPoint, &target, &line, &init, &params, &mut go_on).unwrap();
    for fit in [by_plane, by_point] {
        assert!(!fit.report.observability.undetermined.is_empty(), "{:?}", fit.report);
        assert!(fit.t_target_source.rotation.angle() < 0.1 && (fit.t_target_source * line[100]).x - 5.0 < 0.1);
    }
}

#[test]
fn trimming_leaves_out_outliers() {
    let target = target(&shaft(), 40_000);
    let mut source = source(&shaft(), 4000);
    let n = source.len();
    // A film 2 mm off one side: tissue.
    source.extend((0..600).map(|k| Point3::new(11.0 + 0.0002 * f64::from(k), 0.0, 10.0 + f64::from(k) / 6.0)));
    let run = |trim_fraction| {
        let params = IcpParams { trim_fraction, gate_sigmas: 0.0, ..IcpParams::default() };
        register(Method::PointToPlane, &target, &source, &start(), &params, &mut go_on).unwrap()
    };
    let (kept, trimmed) = (run(0.0), run(0.2));
    let error = |fit: &IcpFit| off(fit, &Isometry3::identity(), &source[..n]);
    assert!(
        error(&trimmed) < 0.03 && error(&kept) > 2.0 * error(&trimmed),
        "{} against {}",
        error(&kept),
        error(&trimmed)
    );
    assert_eq!(trimmed.report.n_pairs, (0.8 * source.len() as f64).ceil() as usize);
}

#[test]
fn points_pair_alike_on_both_sides_of_the_surface_unless_told_otherwise() {
    let target = target(&shaft(), 40_000);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let noisy = source(&shaft(), 8000).into_iter().filter(|p| p.x > 2.0);
    let noisy: Vec<_> = noisy.map(|p| p + Vector3::x() * random.random_range(-0.15..0.15)).collect();
    let run = |one_sided| {
        let params = IcpParams { one_sided, ..IcpParams::default() };
        let source = Source::seen_from(&noisy, Point3::new(300.0, 0.0, 50.0));
        register(Method::PointToPoint, &target, source, &start(), &params, &mut go_on).unwrap()
    };
    // The report, too: what it says of the pose is measured along normals.
    assert_eq!(run(None), run(Some(false)));
    assert_ne!(run(None), run(Some(true)));
}

#[test]
fn an_observer_stops_the_registration_and_the_report_says_so() {
    let (target, source) = (target(&shaft(), 5000), source(&shaft(), 1000));
    let mut seen = 0;
    let mut observer = |step: &IcpStep| {
        seen = step.iteration;
        if step.iteration == 2 { ControlFlow::Break(Halt::Cancelled) } else { ControlFlow::Continue(()) }
    };
    let fit = register(Method::PointToPoint, &target, &source, &start(), &IcpParams::default(), &mut observer).unwrap();
    assert_eq!((fit.report.stop_reason, fit.report.iterations, seen), (StopReason::Cancelled, 2, 2));
    assert!(!fit.report.converged);
    let one = IcpParams { max_iterations: 1, ..IcpParams::default() };
    let fit = register(Method::PointToPoint, &target, &source, &start(), &one, &mut go_on).unwrap();
    assert_eq!((fit.report.stop_reason, fit.report.converged), (StopReason::Iterations, false));
    assert!(fit.report.remaining_mm.unwrap() > 0.05, "{:?}", fit.report);
}

#[test]
fn a_report_survives_json_and_unknown_parameters_are_refused() {
    let (target, source) = (target(&shaft(), 5000), source(&shaft(), 1000));
    let fit = register(Method::PointToPlane, &target, &source, &start(), &IcpParams::default(), &mut go_on).unwrap();
    let text = serde_json::to_string(&fit.report).unwrap();
    assert!(text.contains(r#""stop_reason":"step""#) && !text.contains("null,\"observability\":null"), "{text}");
    let read: IcpReport = serde_json::from_str(&text).unwrap();
    assert_eq!(read.stop_reason, fit.report.stop_reason);
    assert_eq!(serde_json::from_str::<IcpParams>("{}").unwrap(), IcpParams::default());
    assert!(serde_json::from_str::<IcpParams>(r#"{"max_pair_distance": 3}"#).is_err());
}

#[test]
fn the_inliers_of_a_report_reach_from_the_lowest_to_the_highest_point_that_fits() {
    let (target, mesh) = (whole_target(&shaft(), 40_000), MeshQuery::new(&shaft()));
    let drawn = sample::surface(&shaft(), 5000, &mut ChaCha8Rng::seed_from_u64(2));
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    // Noise of up to 0.1 mm, and one point in five 2 mm outside of the surface.
    let off_mm = |k: usize, noise: f64| if k.is_multiple_of(5) { 2.0 } else { 0.2 * (noise - 0.5) };
    let placed = drawn.points.iter().zip(&drawn.normals).enumerate();
    let source: Vec<_> = placed.map(|(k, (p, n))| p + n * off_mm(k, rng.random())).collect();
    for method in Method::ALL {
        let fit = register(method, &target, &source, &start(), &IcpParams::default(), &mut go_on).unwrap();
        let [inside, outside] = fit.report.inliers_mm.unwrap();
        assert!(inside == -outside && (0.09..0.6).contains(&outside), "{method:?}: {inside} to {outside} mm");
        let n =
            source.iter().filter(|p| mesh.closest_point(&(fit.t_target_source * *p)).unwrap().distance_mm <= outside);
        // At the edges of the shaft the plane of a sample is not the surface.
        let (n, n_pairs) = (n.count(), fit.report.n_pairs);
        let are_all = [n, n_pairs].iter().all(|n| (3990..=4010).contains(n));
        assert!(are_all, "{method:?}: {n} points, {n_pairs} pairs, {inside} to {outside} mm");
    }
    // With a camera tissue outside the bone counts less.
    let camera = Point3::new(400.0, 0.0, 50.0);
    let seen: Vec<_> =
        source.iter().zip(&drawn.normals).filter(|(p, n)| n.dot(&(camera - *p)) > 0.0).map(|(p, _)| *p).collect();
    let given = Source { points: &seen, normals: None, camera: Some(camera) };
    let fit = register(Method::PointToPlane, &target, given, &start(), &IcpParams::default(), &mut go_on).unwrap();
    let [inside, outside] = fit.report.inliers_mm.unwrap();
    assert!(inside < -0.09 && (0.05..0.2).contains(&outside), "{inside} to {outside} mm");
}

/// A target for every variant and every pairing.
fn whole_target(mesh: &Mesh, n: usize) -> Target {
    target(mesh, n).with_mesh(MeshQuery::new(mesh))
}

#[test]
fn every_variant_finds_the_motion_by_every_pairing() {
    let (target, source) = (whole_target(&shaft(), 40_000), source(&shaft(), 5000));
    for method in Method::ALL {
        for pairing in [PairingKind::Cached, PairingKind::Tree] {
            let params = IcpParams { pairing, ..IcpParams::default() };
            let fit = register(method, &target, &source, &start(), &params, &mut go_on).unwrap();
            let limit = if method == Method::PointToPoint { 0.2 } else { 0.02 };
            let error = off(&fit, &Isometry3::identity(), &source);
            assert!(error < limit && fit.report.converged, "{method:?} {pairing:?}: {error} mm, {:?}", fit.report);
        }
    }
}

#[test]
fn neighbour_lists_give_the_pairs_of_the_tree() {
    let (target, source) = (whole_target(&shaft(), 40_000), source(&shaft(), 2000));
    for max_pair_distance_mm in [20.0, 1.5] {
        let run = |pairing| {
            let levels = vec![];
            let plain =
                IcpParams { acceleration: 0, levels, max_iterations: 60, max_pair_distance_mm, ..IcpParams::default() };
            let params = IcpParams { pairing, ..plain };
            register(Method::PointToPoint, &target, &source, &start(), &params, &mut go_on).unwrap()
        };
        let (lists, tree) = (run(PairingKind::Cached), run(PairingKind::Tree));
        assert_eq!(lists.trace, tree.trace, "the same pairs, the same bits, within {max_pair_distance_mm} mm");
        assert!(lists.trace.steps.len() > 20, "{} steps", lists.trace.steps.len());
    }
}

#[test]
fn cached_pairs_are_those_of_the_tree() {
    let (target, source) = (whole_target(&shaft(), 40_000), source(&shaft(), 5000));
    let run = |pairing| {
        let tight = IcpParams { stop_step_mm: 1e-9, stop_step_rad: 1e-12, ..IcpParams::default() };
        let params = IcpParams { pairing, levels: vec![], ..tight };
        register(Method::PointToPlane, &target, &source, &start(), &params, &mut go_on).unwrap().t_target_source
    };
    assert_eq!(run(PairingKind::Cached), run(PairingKind::Tree), "the same pairs, the same bits");
}

#[test]
fn a_target_without_the_mesh_needed_is_refused() {
    let (target, source) = (target(&shaft(), 5000), source(&shaft(), 1000));
    let plain = IcpParams::default();
    assert_eq!(
        register(Method::PointToMesh, &target, &source, &start(), &plain, &mut go_on).unwrap_err(),
        IcpError::NoMesh
    );
}

/// Plain point-to-point by brute force, until `measure` of the distances changes by less than 1e-5 mm.
fn plain(
    target: &Target,
    source: &[Point3<f64>],
    init: &Isometry3<f64>,
    measure: fn(&[f64]) -> f64,
) -> (Isometry3<f64>, u32) {
    let nearest = |p: &Point3<f64>| {
        let square = |q: &&Point3<f64>| (*q - p).norm_squared();
        *target.points().iter().min_by(|a, b| square(a).total_cmp(&square(b))).unwrap()
    };
    let (mut t, mut last, mut steps) = (*init, f64::INFINITY, 0);
    loop {
        let moved: Vec<_> = source.iter().map(|p| t * p).collect();
        let partners: Vec<_> = moved.iter().map(nearest).collect();
        let now = measure(&moved.iter().zip(&partners).map(|(p, q)| (p - q).norm()).collect::<Vec<_>>());
        if (now - last).abs() < 1e-5 {
            return (t, steps);
        }
        t = kabsch(&partners, &moved).unwrap() * t;
        (last, steps) = (now, steps + 1);
    }
}

#[test]
fn a_published_reading_takes_the_steps_of_brute_force_under_that_rule() {
    let (target, source) = (target(&shaft(), 4000), source(&shaft(), 300));
    let mean = |d: &[f64]| d.iter().sum::<f64>() / d.len() as f64;
    let rms = |d: &[f64]| (d.iter().map(|x| x * x).sum::<f64>() / d.len() as f64).sqrt();
    let mut steps = Vec::new();
    for (reading, measure) in
        [(PublishedReading::MeanChange1e5, mean as fn(&[f64]) -> f64), (PublishedReading::Change1e5, rms)]
    {
        let params = serde_json::json!({ "reading": reading, "max_pair_distance_mm": 50.0 });
        let params: PublishedParams = serde_json::from_value(params).unwrap();
        let fit = register_published(&target, &source, &start(), &params, &mut go_on).unwrap();
        let (by_hand, n) = plain(&target, &source, &start(), measure);
        assert_eq!((fit.report.iterations, fit.report.stop_reason), (n, StopReason::Residual));
        assert!(off(&fit, &by_hand, &source) < 1e-9, "{} mm after {n} steps", off(&fit, &by_hand, &source));
        steps.push(n);
    }
    assert_ne!(steps[0], steps[1], "the two rules must differ here");
}

/// Every variant with every pairing, and its name.
fn variants() -> impl Iterator<Item = (Method, IcpParams, String)> {
    let pairings = [PairingKind::Cached, PairingKind::Tree];
    Method::ALL.into_iter().flat_map(move |method| {
        pairings.map(|pairing| {
            let params = IcpParams { pairing, ..IcpParams::default() };
            (method, params, format!("{} by {pairing:?}", method.name()))
        })
    })
}

#[test]
fn metres_and_kilometres_away_every_variant_gives_the_same_answer() {
    let (mesh, source) = (shaft(), source(&shaft(), 1200));
    let here = whole_target(&mesh, 20_000);
    // The farther is just within the limit of coordinates.
    for (far_mm, tolerance_mm) in [(1e4, 1e-6), (9.99e6, 1e-4)] {
        let away = Isometry3::translation(far_mm, -far_mm, far_mm);
        let moved: Vec<_> = source.iter().map(|p| away * p).collect();
        let query = MeshQuery::new(&mesh.transformed("ct", &away));
        let points: Vec<_> = here.points().iter().map(|p| away * p).collect();
        let there = Target::new("ct", SurfaceOrigin::Exact, points, here.normal_column().cloned()).unwrap();
        let there = there.with_mesh(query);
        for (method, params, name) in variants() {
            let expected = register(method, &here, &source, &start(), &params, &mut go_on).unwrap();
            let init = away * start() * away.inverse();
            let found = register(method, &there, &moved, &init, &params, &mut go_on).unwrap();
            let error = off(&found, &(away * expected.t_target_source * away.inverse()), &moved);
            assert!(error < tolerance_mm, "{name}, {far_mm} mm away: {error} mm");
        }
    }
}

#[test]
fn threads_change_no_bit_of_any_variant() {
    let (target, source) = (whole_target(&shaft(), 20_000), source(&shaft(), 3000));
    for (method, params, name) in variants() {
        let params = IcpParams { trim_fraction: 0.05, max_normal_angle_deg: 60.0, ..params };
        let [one, eight] = [1, 8].map(|n| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| register(method, &target, &source, &start(), &params, &mut go_on).unwrap())
        });
        assert_eq!(one, eight, "{name}");
    }
}

/// A closed surface of revolution about z through the circles `(radius, z)`, of flat faces a degree and a half wide.
fn revolved(circles: &[(f64, f64)]) -> Mesh {
    let (around, n) = (240_u32, circles.len() as u32);
    let (first, last) = (circles[0], circles[circles.len() - 1]);
    let mut vertices = vec![Point3::new(0.0, 0.0, first.1), Point3::new(0.0, 0.0, last.1)];
    vertices.extend(circles.iter().flat_map(|&(radius, z)| {
        (0..around).map(move |j| {
            let turn = f64::from(j) / f64::from(around) * std::f64::consts::TAU;
            Point3::new(radius * turn.cos(), radius * turn.sin(), z)
        })
    }));
    let index = |i: u32, j: u32| 2 + i * around + j % around;
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for j in 0..around {
        faces.push([0, index(0, j + 1), index(0, j)]);
        faces.push([1, index(n - 1, j), index(n - 1, j + 1)]);
        for i in 0..n - 1 {
            let [a, b, c, d] = [index(i, j), index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)];
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
}

fn ball(radius: f64) -> Mesh {
    let polar = |k: i32| f64::from(k) / 120.0 * std::f64::consts::PI;
    let circles: Vec<_> = (1..120).map(|k| (radius * polar(k).sin(), -radius * polar(k).cos())).collect();
    revolved(&circles)
}

#[test]
fn scans_that_leave_motions_undetermined_are_refused_or_reported() {
    let grid = |n: usize| (0..n * n).map(move |k| ((k % n) as f64 * 0.7, (k / n) as f64 * 0.7));
    let on_plane: Vec<_> = grid(40).map(|(x, y)| Point3::new(x - 14.0, y - 14.0, 10.0)).collect();
    let on_line: Vec<_> = (0..800).map(|k| Point3::new(0.0, f64::from(k) * 0.02 - 8.0, 10.0)).collect();
    let on_ball: Vec<_> =
        grid(40).map(|(x, y)| Vector3::new(x - 14.0, y - 14.0, 14.0).normalize() * 10.0).map(Point3::from).collect();
    let slab = whole_target(&cuboid([-40.0, -40.0, -10.0], [40.0, 40.0, 10.0]), 40_000);
    let round = whole_target(&ball(10.0), 40_000);
    let rod = whole_target(&revolved(&[(8.0, -60.0), (8.0, 60.0)]), 40_000);
    let on_rod: Vec<_> = grid(40)
        .map(|(x, y)| ((x - 14.0) / 10.0, y - 14.0))
        .map(|(turn, z)| Point3::new(8.0 * turn.cos(), 8.0 * turn.sin(), z))
        .collect();
    let in_one_place = vec![Point3::new(1.0, 2.0, 10.0); 800];
    let init = Isometry3::new(Vector3::new(0.3, -0.2, 0.4), Vector3::new(0.01, 0.02, -0.01));
    for (method, params, name) in variants() {
        // Undetermined: three motions along a plane, slide and spin of a rod, three turns of a ball, and all motions of a line or
        // a point but those across the surface.
        for (what, target, source, n_free) in [
            ("plane", &slab, &on_plane, 3),
            ("line", &slab, &on_line, 4),
            ("rod", &rod, &on_rod, 2),
            ("ball", &round, &on_ball, 3),
            ("one place", &slab, &in_one_place, 5),
        ] {
            match register(method, target, source, &init, &params, &mut go_on) {
                Ok(fit) => {
                    let free = &fit.report.observability.undetermined;
                    assert!(free.len() >= n_free, "{name}, {what}: {:?}", fit.report.observability.eigenvalues);
                    assert!(fit.t_target_source.to_homogeneous().iter().all(|c| c.is_finite()));
                    assert_ne!(fit.t_target_source, Isometry3::identity(), "{name}, {what}");
                }
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        }
        let two = register(method, &slab, &on_plane[..2], &init, &params, &mut go_on);
        assert_eq!(two.unwrap_err(), IcpError::TooFewPoints { n_source: 2, min_pairs: 10 }, "{name}");
        let none: &[Point3<f64>] = &[];
        let empty = register(method, &slab, none, &init, &params, &mut go_on);
        assert_eq!(empty.unwrap_err(), IcpError::TooFewPoints { n_source: 0, min_pairs: 10 }, "{name}");
        let mut wild = on_plane.clone();
        wild[7].y = f64::NAN;
        let wild = register(method, &slab, &wild, &init, &params, &mut go_on).unwrap_err();
        assert_eq!(wild, IcpError::NotFinite { what: "source point 7".into() }, "{name}");
    }
}

#[test]
fn starts_on_either_side_of_an_ill_conditioned_minimum_end_at_one_pose() {
    // A strip of the shaft: turn and slide are ill-conditioned, so steps shrink slowly.
    let mesh = shaft();
    let target = target(&mesh, 20_000);
    let drawn = sample::surface(&mesh, 20_000, &mut ChaCha8Rng::seed_from_u64(2));
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let seen = drawn.points.iter().zip(&drawn.normals).filter(|(p, n)| n.x > 0.6 && (30.0..90.0).contains(&p.z));
    let source: Vec<_> = seen.map(|(p, n)| p + n * (0.2 * (rng.random::<f64>() - 0.5))).collect();
    for method in [Method::PointToPlane, Method::Symmetric] {
        let [above, below] = [4.0, -4.0].map(|slide| {
            let init = Isometry3::new(Vector3::new(0.5, 0.3, slide), Vector3::new(0.01, 0.01, 0.02));
            register(method, &target, &source, &init, &IcpParams::default(), &mut go_on).unwrap()
        });
        let apart = off(&above, &below.t_target_source, &source);
        assert!(above.report.converged && below.report.converged, "{:?} {:?}", above.report, below.report);
        assert!(apart < 0.005, "{method:?}: {apart} mm apart after {} steps", above.report.iterations);
    }
}

#[test]
fn what_a_point_to_point_leaves_is_all_of_its_error_even_if_it_stopped_far_along_the_bone() {
    let (bone, source) = (shaft(), source(&shaft(), 5000));
    let with = target(&bone, 40_000);
    let without = Target::new("ct", SurfaceOrigin::User, with.points().to_vec(), None).unwrap();
    let start = Isometry3::translation(0.5, 0.0, 8.0);
    let params = PublishedParams {
        reading: PublishedReading::Iterations,
        max_pair_distance_mm: 5.0,
        max_iterations: 10,
        stop_after_ms: 0.0,
        min_pairs: 10,
    };
    for target in [&with, &without] {
        let fit = register_published(target, &source, &start, &params, &mut go_on).unwrap();
        let (error_mm, left_mm) = (off(&fit, &Isometry3::identity(), &source), fit.report.left_mm.unwrap());
        assert!(error_mm > 3.0, "{error_mm} mm; ten plain steps recover little of 8 mm");
        assert!(
            (left_mm - error_mm).abs() < 0.1,
            "{left_mm} mm reported, {error_mm} mm left; samples are 0.5 mm apart"
        );
    }
    let fit = register(Method::PointToPoint, &with, &source, &start, &IcpParams::default(), &mut go_on).unwrap();
    assert!(fit.report.left_mm.unwrap() < 0.2, "{:?}", fit.report);
}

/// A strip of the shaft with noise, seen from +x, and a start some millimetres and degrees off.
fn noisy_strip(seed: u64) -> (Vec<Point3<f64>>, Isometry3<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let drawn = sample::surface(&shaft(), 60_000, &mut rng);
    let seen = drawn.points.iter().zip(&drawn.normals).filter(|(p, n)| n.x > 0.2 && (20.0..95.0).contains(&p.z));
    let source = seen.map(|(p, n)| p + n * (0.24 * (rng.random::<f64>() - 0.5))).collect();
    let mut off = |size: f64| Vector3::from_fn(|_, _| size * (rng.random::<f64>() - 0.5));
    let (shift, turn) = (off(5.0), off(0.1));
    (source, Isometry3::new(shift, turn))
}

/// Number of full Gauss-Newton steps of point-to-plane from all points to their nearest samples, without weights, until one is
/// shorter than `stop_mm` (RMS movement of the points), and the pose there; none where pairs change in a cycle.
fn plain_gauss_newton(
    target: &Target,
    source: &[Point3<f64>],
    init: &Isometry3<f64>,
    stop_mm: f64,
) -> Option<(u32, Isometry3<f64>)> {
    let (normals, mut pose) = (target.normals().unwrap(), *init);
    for n in 1..100 {
        let moved: Vec<_> = source.iter().map(|p| pose * p).collect();
        let centre = moved.iter().map(|p| p.coords).sum::<Vector3<f64>>() / moved.len() as f64;
        let (mut h, mut b) = (nalgebra::Matrix6::<f64>::zeros(), nalgebra::Vector6::<f64>::zeros());
        for p in &moved {
            let Some((index, _)) = target.nearest(p, 5.0) else { continue };
            let (normal, turn) = (normals[index], (p.coords - centre).cross(&normals[index]));
            let row = nalgebra::Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z);
            h += row * row.transpose();
            b += row * normal.dot(&(p - target.points()[index]));
        }
        let step = -h.cholesky().unwrap().solve(&b);
        let (shift, turn) = (step.fixed_rows::<3>(0).into_owned(), step.fixed_rows::<3>(3).into_owned());
        let rotation = UnitQuaternion::from_scaled_axis(turn);
        let motion = Isometry3::from_parts((centre + shift - rotation * centre).into(), rotation);
        let squares: f64 = moved.iter().map(|p| (motion * p - p).norm_squared()).sum();
        pose = motion * pose;
        if (squares / moved.len() as f64).sqrt() < stop_mm {
            return Some((n, pose));
        }
    }
    None
}

#[test]
fn the_minimum_takes_at_most_two_steps_more_than_plain_gauss_newton() {
    let target = target(&shaft(), 100_000);
    let is_slow = std::env::var_os("SLOW_TESTS").is_some();
    for seed in 10..if is_slow { 20 } else { 13 } {
        let (source, init) = noisy_strip(seed);
        for stop_step_mm in [1e-3, 1e-6] {
            let Some((n_plain, plain)) = plain_gauss_newton(&target, &source, &init, stop_step_mm) else { continue };
            for pairing in [PairingKind::Cached, PairingKind::Tree] {
                let run = |levels| {
                    let stop_step_rad = stop_step_mm / 100.0;
                    let params = IcpParams { pairing, levels, stop_step_mm, stop_step_rad, ..IcpParams::default() };
                    register(Method::PointToPlane, &target, &source, &init, &params, &mut go_on).unwrap()
                };
                let (alone, with_levels) = (run(Vec::new()), run(IcpParams::default().levels));
                let on_all = with_levels.trace.steps.iter().filter(|step| step.every == 1).count() as u32;
                let what = format!("seed {seed}, {pairing:?}, {stop_step_mm} mm: {n_plain} plain steps");
                for (fit, n) in [(&alone, alone.report.iterations), (&with_levels, on_all)] {
                    let apart_mm = off(fit, &plain, &source);
                    assert!(n <= n_plain + 2, "{what}, {n} of ours");
                    assert!(apart_mm < 0.002, "{what}, {apart_mm} mm apart");
                }
            }
        }
    }
}

#[test]
fn a_tight_stop_ends_at_a_minimum_or_tells_the_size_of_the_cycle_in_which_pairs_change() {
    let target = target(&shaft(), 20_000);
    let mut reasons = Vec::new();
    for seed in [18, 20, 10, 11] {
        let (source, init) = noisy_strip(seed);
        let at = |stop_step_mm: f64| {
            let params = IcpParams { stop_step_mm, stop_step_rad: stop_step_mm / 100.0, ..IcpParams::default() };
            register(Method::PointToPlane, &target, &source, &init, &params, &mut go_on).unwrap()
        };
        let (tight, usual) = (at(1e-9), at(1e-3));
        let (report, n) = (&tight.report, tight.report.iterations);
        let apart_mm = off(&tight, &usual.t_target_source, &source);
        assert_eq!((usual.report.stop_reason, usual.report.converged), (StopReason::Step, true), "seed {seed}");
        assert!(apart_mm < 1e-3, "seed {seed}: {apart_mm} mm from the result of the usual stop");
        assert!(n <= 2 * usual.report.iterations, "seed {seed}: {n} steps, {} usually", usual.report.iterations);
        let (remaining_mm, reason) = (report.remaining_mm.unwrap(), report.stop_reason);
        assert_eq!((report.converged, remaining_mm <= 1e-9), (reason == StopReason::Step, reason == StopReason::Step));
        assert!(remaining_mm < 1e-3, "seed {seed}: cycles are shorter than the usual stop: {report:?}");
        // A step that searches all pairs goes no further than told, and not much less far.
        let step = |stop_mm| plain_gauss_newton(&target, &source, &tight.t_target_source, stop_mm).map(|(n, _)| n);
        assert_eq!(step(1.1 * remaining_mm + 1e-9), Some(1), "seed {seed}: {report:?}");
        assert_ne!(step(0.1 * remaining_mm - 1e-9), Some(1), "seed {seed}: {report:?}");
        reasons.push(reason);
    }
    use StopReason::{Stalled, Step};
    assert_eq!(reasons, [Stalled, Stalled, Step, Step]);
}
