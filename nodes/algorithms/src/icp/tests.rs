use super::*;
use crate::field::{ClosestPointField, FieldParams};
use crate::mesh_query::MeshQuery;
use crate::sample;
use crate::shapes::{cuboid, shaft};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
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
    // Samples half a millimetre apart: planes are held to their grain, points to their resolution.
    let plane = point_to_plane(&target, &moved, &init, &params, &mut go_on).unwrap();
    assert!(off(&plane, &motion, &moved) < 0.02 && plane.report.converged, "{:?}", plane.report);
    let point = point_to_point(&target, &moved, &init, &params, &mut go_on).unwrap();
    assert!(off(&point, &motion, &moved) < 0.2 && point.report.converged, "{:?}", point.report);
    for fit in [&plane, &point] {
        assert!(fit.report.observability.undetermined.is_empty());
        assert_eq!(fit.trace.steps.len(), fit.report.iterations as usize);
        assert!(fit.trace.steps.last().unwrap().rms_mm < fit.trace.steps[0].rms_mm);
    }
}

#[test]
fn a_target_without_normals_serves_points_and_is_refused_for_planes() {
    let with = target(&shaft(), 40_000);
    let without = Target::new("ct", SurfaceOrigin::User, with.points().to_vec(), None).unwrap();
    let source = source(&shaft(), 5000);
    let fit = point_to_point(&without, &source, &start(), &IcpParams::default(), &mut go_on).unwrap();
    assert!(off(&fit, &Isometry3::identity(), &source) < 0.2 && fit.report.converged, "{:?}", fit.report);
    let refused = point_to_plane(&without, &source, &start(), &IcpParams::default(), &mut go_on);
    assert_eq!(refused.unwrap_err(), IcpError::NoNormals);
}

#[test]
fn too_few_pairs_say_how_far_away_the_target_is() {
    let (target, source) = (target(&shaft(), 2000), source(&shaft(), 500));
    let far = Isometry3::translation(412.0, 0.0, 0.0);
    let error = point_to_plane(&target, &source, &far, &IcpParams::default(), &mut go_on).unwrap_err();
    assert!(matches!(error, IcpError::TooFewPairs { n_pairs: 0, n_source: 500, .. }), "{error}");
    assert!(error.to_string().contains("is init right, and are both in mm?"), "{error}");
    let few = point_to_point(&target, &source[..5], &start(), &IcpParams::default(), &mut go_on);
    assert_eq!(few.unwrap_err(), IcpError::TooFewPoints { n_source: 5, min_pairs: 10 });
    let none: &[Point3<f64>] = &[];
    assert!(point_to_point(&target, none, &start(), &IcpParams::default(), &mut go_on).is_err());
    let mut wild = source.clone();
    wild[7].x = f64::INFINITY;
    let error = point_to_point(&target, &wild, &start(), &IcpParams::default(), &mut go_on).unwrap_err();
    assert!(error.to_string().contains("source point 7"), "{error}");
    let gate = IcpParams { max_pair_distance_mm: f64::NAN, ..IcpParams::default() };
    assert!(matches!(point_to_point(&target, &source, &start(), &gate, &mut go_on), Err(IcpError::Parameter { .. })));
}

#[test]
fn what_a_plane_leaves_free_is_flagged_and_stays_where_the_start_said() {
    let slab = target(&cuboid([0.0, 0.0, -30.0], [100.0, 100.0, 0.0]), 60_000);
    let on_top: Vec<_> =
        (0..2500).map(|k| Point3::new(30.0 + f64::from(k % 50), 30.0 + f64::from(k / 50), 0.0)).collect();
    let init = Isometry3::new(Vector3::new(3.0, -2.0, 0.8), Vector3::new(0.004, 0.006, 0.0));
    let fit = point_to_plane(
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
    assert!(at.z.abs() < 1e-3, "held across the plane: {at}");
    assert!((at - before).xy().norm() < 0.05, "free along it: {at} from {before}");
}

#[test]
fn points_on_a_line_keep_the_turn_of_the_start() {
    let target = target(&cuboid([-5.0; 3], [5.0, 5.0, 105.0]), 40_000);
    let line: Vec<_> = (0..200).map(|k| Point3::new(5.0, 0.0, f64::from(k) / 2.0)).collect();
    let init = Isometry3::from_parts(Translation3::new(0.5, 0.0, 0.0), UnitQuaternion::identity());
    let params = IcpParams::default();
    let by_plane = point_to_plane(&target, &line, &init, &params, &mut go_on).unwrap();
    let by_point = point_to_point(&target, &line, &init, &params, &mut go_on).unwrap();
    for fit in [by_plane, by_point] {
        assert!(!fit.report.observability.undetermined.is_empty(), "{:?}", fit.report);
        assert!(fit.t_target_source.rotation.angle() < 0.1 && (fit.t_target_source * line[100]).x - 5.0 < 0.1);
    }
}

#[test]
fn trimming_leaves_out_what_does_not_belong() {
    let target = target(&shaft(), 40_000);
    let mut source = source(&shaft(), 4000);
    let n = source.len();
    // A film 2 mm off one side: tissue.
    source.extend((0..600).map(|k| Point3::new(11.0 + 0.0002 * f64::from(k), 0.0, 10.0 + f64::from(k) / 6.0)));
    let run = |trim_fraction| {
        let params = IcpParams { trim_fraction, gate_sigmas: 0.0, ..IcpParams::default() };
        point_to_plane(&target, &source, &start(), &params, &mut go_on).unwrap()
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
fn an_observer_breaks_off_and_the_report_says_so() {
    let (target, source) = (target(&shaft(), 5000), source(&shaft(), 1000));
    let mut seen = 0;
    let mut observer = |step: &IcpStep| {
        seen = step.iteration;
        if step.iteration == 2 { ControlFlow::Break(Halt::Cancelled) } else { ControlFlow::Continue(()) }
    };
    let fit = point_to_point(&target, &source, &start(), &IcpParams::default(), &mut observer).unwrap();
    assert_eq!((fit.report.stop_reason, fit.report.iterations, seen), (StopReason::Cancelled, 2, 2));
    assert!(!fit.report.converged);
    let one = IcpParams { max_iterations: 1, ..IcpParams::default() };
    let fit = point_to_point(&target, &source, &start(), &one, &mut go_on).unwrap();
    assert_eq!((fit.report.stop_reason, fit.report.converged), (StopReason::Iterations, false));
    assert!(fit.report.remaining_mm.unwrap() > 0.05, "{:?}", fit.report);
}

#[test]
fn a_report_survives_json_and_parameters_refuse_what_they_do_not_know() {
    let (target, source) = (target(&shaft(), 5000), source(&shaft(), 1000));
    let fit = point_to_plane(&target, &source, &start(), &IcpParams::default(), &mut go_on).unwrap();
    let text = serde_json::to_string(&fit.report).unwrap();
    assert!(text.contains(r#""stop_reason":"step""#) && !text.contains("null,\"observability\":null"), "{text}");
    let read: IcpReport = serde_json::from_str(&text).unwrap();
    assert_eq!(read.stop_reason, fit.report.stop_reason);
    assert_eq!(serde_json::from_str::<IcpParams>("{}").unwrap(), IcpParams::default());
    assert!(serde_json::from_str::<IcpParams>(r#"{"max_pair_distance": 3}"#).is_err());
}

/// Every variant, every way of pairing: the target with all that they need.
fn whole_target(mesh: &Mesh, n: usize) -> Target {
    let query = MeshQuery::new(mesh);
    let field = ClosestPointField::of_mesh(&query, &FieldParams::default()).unwrap();
    target(mesh, n).with_mesh(query).with_field(field)
}

#[test]
fn every_variant_finds_the_motion_by_every_pairing() {
    let (target, source) = (whole_target(&shaft(), 40_000), source(&shaft(), 5000));
    for method in Method::ALL {
        for pairing in [PairingKind::Cached, PairingKind::Tree, PairingKind::Field] {
            let params = IcpParams { pairing, ..IcpParams::default() };
            let fit = register(method, &target, &source, &start(), &params, &mut go_on).unwrap();
            let limit = if method == Method::PointToPoint { 0.2 } else { 0.02 };
            let error = off(&fit, &Isometry3::identity(), &source);
            assert!(error < limit && fit.report.converged, "{method:?} {pairing:?}: {error} mm, {:?}", fit.report);
        }
    }
}

#[test]
fn cached_pairs_are_those_of_the_tree_and_an_exact_pass_ends_the_field_there_too() {
    let (target, source) = (whole_target(&shaft(), 40_000), source(&shaft(), 5000));
    let run = |pairing, field_exact_steps| {
        let tight = IcpParams { stop_step_mm: 1e-9, stop_step_rad: 1e-12, ..IcpParams::default() };
        let loose = IcpParams { field_exact_steps, ..IcpParams::default() };
        let params = if pairing == PairingKind::Field { loose } else { tight };
        let params = IcpParams { pairing, levels: vec![], ..params };
        point_to_plane(&target, &source, &start(), &params, &mut go_on).unwrap()
    };
    let tree = run(PairingKind::Tree, 0);
    assert_eq!(run(PairingKind::Cached, 0).t_target_source, tree.t_target_source, "the same pairs, the same bits");
    let (alone, ended) = (run(PairingKind::Field, 0), run(PairingKind::Field, 3));
    let apart = |fit: &IcpFit| off(fit, &tree.t_target_source, &source);
    assert!(apart(&ended) < 1e-3 && apart(&ended) < apart(&alone), "{} and {}", apart(&ended), apart(&alone));
    assert!(alone.report.iterations < ended.report.iterations);
}

#[test]
fn what_a_variant_needs_of_the_target_is_named_where_it_is_missing() {
    let (target, source) = (target(&shaft(), 5000), source(&shaft(), 1000));
    let field = IcpParams { pairing: PairingKind::Field, ..IcpParams::default() };
    assert_eq!(point_to_plane(&target, &source, &start(), &field, &mut go_on).unwrap_err(), IcpError::NoField);
    let plain = IcpParams::default();
    assert_eq!(point_to_mesh(&target, &source, &start(), &plain, &mut go_on).unwrap_err(), IcpError::NoMesh);
    let published = IcpParams { published_reading: PublishedReading::Change001, ..plain };
    assert_eq!(symmetric(&target, &source, &start(), &published, &mut go_on).unwrap_err(), IcpError::NotPublished);
}
