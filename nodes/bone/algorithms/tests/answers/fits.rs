//! Registrations of a scan of the own bone.

use super::text::{golden, line, motion, outcome, points};
use super::{BONE, TARGET};
use crate::common::{Noise, USUAL, displaced};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::coarse::{self, GlobalParams, global};
use osteoflow_algorithms::icp::{
    Halt, IcpError, IcpFit, IcpParams, Kernel, Method, PairingKind, PublishedParams, PublishedReading, Source,
    StepRule, register, register_published,
};
use osteoflow_algorithms::normals::{self, NormalParams};
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{Cloud, NamedPoint};
use std::fmt::Write;
use std::ops::ControlFlow;

/// A scan of the shaft of which a twentieth lies up to 4 mm outside.
fn scan(step_mm: f64) -> Cloud {
    let noise = Noise { depth_mm: 0.08, ..USUAL };
    let camera = BONE.camera(150.0);
    let scan = BONE.scan(&camera, [120.0, 180.0], step_mm, &noise, None, 11);
    let eye = camera.translation.vector;
    let soft = |(k, p): (usize, &Point3<f64>)| match k % 20 {
        0 => p + (eye - p.coords).normalize() * (k % 5) as f64,
        _ => *p,
    };
    let points: Vec<Point3<f64>> = scan.points().iter().enumerate().map(soft).collect();
    Cloud::new("ct", points).unwrap().seen_from(camera)
}

fn start(scan: &Cloud) -> Isometry3<f64> {
    displaced(&scan.points()[scan.len() / 2], 2.0, 0.06, 5)
}

fn go_on() -> impl FnMut(&osteoflow_algorithms::icp::IcpStep) -> ControlFlow<Halt> {
    |_| ControlFlow::Continue(())
}

/// The end of a registration, and its steps in short.
fn described(name: &str, fit: &Result<IcpFit, IcpError>) -> String {
    let fit = match fit {
        Ok(fit) => fit,
        Err(error) => return format!("{name}: {error}\n"),
    };
    let r = &fit.report;
    let mut text = line(name, &motion(&fit.t_target_source));
    text += &line("    end", &(r.stop_reason, &r.rules, r.iterations, r.n_pairs, r.rms_mm, r.point_rms_mm));
    text += &line("    left", &(r.step_mm, r.step_rad, r.remaining_mm, r.resolution_mm, r.left_mm));
    let mut steps = String::from("    steps");
    for step in &fit.trace.steps {
        let mark = if step.accelerated { "+" } else { "" };
        write!(steps, " {}/{}:{:.5}{mark}", step.n_pairs, step.every, step.rms_mm).unwrap();
    }
    text + &steps + "\n"
}

#[test]
fn every_variant_and_every_parameter_of_an_icp_has_its_answer() {
    let scan = scan(0.8);
    let (scan, _) = normals::estimate(&scan, &NormalParams::default()).unwrap();
    let init = start(&scan);
    let blind = Cloud::new("ct", scan.points().to_vec()).unwrap();
    let mut text = String::new();
    for method in Method::ALL {
        let by = |params: &IcpParams| register(method, &TARGET, &scan, &init, params, &mut go_on());
        let usual = by(&IcpParams::default());
        text += &described(method.name(), &usual);
        text += &line("    report", &usual.unwrap().report);
        let blind = register(method, &TARGET, &blind, &init, &IcpParams::default(), &mut go_on());
        text += &described(&format!("{} blind", method.name()), &blind);
        let short = IcpParams { levels: vec![6], max_iterations: 60, ..IcpParams::default() };
        let cases = [
            ("huber", IcpParams { kernel: Kernel::Huber, ..short.clone() }),
            ("tukey", IcpParams { kernel: Kernel::Tukey, gate_sigmas: 0.0, ..short.clone() }),
            ("welsch", IcpParams { kernel: Kernel::Welsch, one_sided: Some(false), ..short.clone() }),
            ("one-sided", IcpParams { one_sided: Some(true), noise_mm: 0.02, ..short.clone() }),
            ("trim", IcpParams { trim_fraction: 0.2, gate_sigmas: 0.0, ..short.clone() }),
            ("incidence", IcpParams { incidence_weights: true, ..short.clone() }),
            ("reciprocal", IcpParams { reciprocal: true, ..short.clone() }),
            ("angle", IcpParams { max_normal_angle_deg: 20.0, ..short.clone() }),
            ("damped", IcpParams { step: StepRule::LevenbergMarquardt, ..short.clone() }),
            ("tree", IcpParams { pairing: PairingKind::Tree, levels: vec![], max_iterations: 4, ..short.clone() }),
            ("plain", IcpParams { acceleration: 0, levels: vec![], max_iterations: 15, ..short.clone() }),
            ("residual", IcpParams { stop_residual_mm: 0.01, stop_step_mm: 0.0, ..short.clone() }),
            ("loose", IcpParams { stop_step_mm: 0.3, stop_step_rad: 0.01, ..short.clone() }),
            ("short pairs", IcpParams { max_pair_distance_mm: 0.7, ..short.clone() }),
        ];
        for (name, params) in cases {
            text += &described(&format!("{} {name}", method.name()), &by(&params));
        }
    }
    golden("icp", &text);
}

#[test]
fn a_start_beside_the_bone_ends_where_it_did() {
    let scan = scan(1.0);
    let mut text = String::new();
    for (mm, rad, seed) in [(6.0, 0.2, 1), (8.0, 0.1, 2), (3.0, 0.4, 3)] {
        let init = displaced(&scan.points()[7], mm, rad, seed);
        for method in Method::ALL {
            let fit = register(method, &TARGET, &scan, &init, &IcpParams::default(), &mut go_on());
            text += &described(&format!("{} from {seed}", method.name()), &fit);
        }
    }
    golden("icp_far", &text);
}

#[test]
fn the_published_readings_stop_where_they_did() {
    let scan = scan(1.5);
    let mut text = String::new();
    for (reading, max_iterations) in [
        (PublishedReading::Change001, 500),
        (PublishedReading::Change1e5, 40),
        (PublishedReading::MeanChange1e5, 500),
        (PublishedReading::Iterations, 12),
    ] {
        let params =
            PublishedParams { reading, max_pair_distance_mm: 5.0, max_iterations, stop_after_ms: 0.0, min_pairs: 10 };
        let fit = register_published(&TARGET, &scan, &start(&scan), &params, &mut go_on());
        text += &described(&format!("{reading:?}"), &fit);
    }
    golden("icp_published", &text);
}

#[test]
fn what_no_icp_can_start_from_is_refused_with_the_reason() {
    let scan = scan(2.0);
    let init = Isometry3::identity();
    let run = |target: &Target, source: Source<'_>, init: &Isometry3<f64>, method, params: &IcpParams| {
        register(method, target, source, init, params, &mut go_on()).map(|fit| fit.report.n_pairs)
    };
    let usual = IcpParams::default();
    let bare = Target::new("ct", TARGET.origin, TARGET.points().to_vec(), None).unwrap();
    let mut text = String::new();
    for method in Method::ALL {
        text += &outcome(method.name(), &run(&bare, Source::from(&scan), &init, method, &usual));
    }
    let by_plane = |source: Source<'_>, init: &Isometry3<f64>, params: &IcpParams| {
        run(&TARGET, source, init, Method::PointToPlane, params)
    };
    let far = Isometry3::translation(0.0, 300.0, 0.0);
    let (nine, ten) = (&scan.points()[..9], &scan.points()[..10]);
    text += &outcome("far", &by_plane(Source::from(&scan), &far, &usual));
    text += &outcome("nine points", &by_plane(Source::from(nine), &init, &usual));
    text += &outcome("ten points", &by_plane(Source::from(ten), &init, &usual));
    text +=
        &outcome("eleven pairs", &by_plane(Source::from(ten), &init, &IcpParams { min_pairs: 11, ..usual.clone() }));
    text += &outcome("normals", &by_plane(Source::from(&scan).with_normals(&[Vector3::x()]), &init, &usual));
    let mut broken = scan.points().to_vec();
    broken[3].y = f64::NAN;
    text += &outcome("point", &by_plane(Source::from(&broken), &init, &usual));
    text += &outcome("start", &by_plane(Source::from(&scan), &Isometry3::translation(0.0, f64::INFINITY, 0.0), &usual));
    text +=
        &outcome("camera", &by_plane(Source::seen_from(scan.points(), Point3::new(0.0, f64::NAN, 0.0)), &init, &usual));
    for bad in [-1.0, f64::NAN, f64::INFINITY, 0.0, 1.0] {
        for params in [
            IcpParams { max_pair_distance_mm: bad, ..usual.clone() },
            IcpParams { gate_sigmas: bad, ..usual.clone() },
            IcpParams { noise_mm: bad, ..usual.clone() },
            IcpParams { max_normal_angle_deg: bad, ..usual.clone() },
            IcpParams { stop_step_mm: bad, ..usual.clone() },
            IcpParams { stop_step_rad: bad, ..usual.clone() },
            IcpParams { stop_residual_mm: bad, ..usual.clone() },
            IcpParams { trim_fraction: bad, ..usual.clone() },
        ] {
            text += &outcome(bad, &by_plane(Source::from(&scan), &init, &params));
        }
    }
    golden("icp_refused", &text);
}

#[test]
fn a_scan_placed_by_its_shape_alone_comes_to_lie_where_it_did() {
    let mut text = String::new();
    let noise = Noise { n_patches: 0, ..USUAL };
    for (heights, params) in [
        ([0.0, 110.0], GlobalParams::default()),
        ([240.0, 349.0], GlobalParams { slide_mm: 14.0, n_turns: 9, n_refined: 20, n_registered: 3 }),
        ([150.0, 190.0], GlobalParams { slide_mm: 25.0, n_turns: 6, n_refined: 6, n_registered: 2 }),
    ] {
        let scan = BONE.scan(&BONE.camera((heights[0] + heights[1]) / 2.0), heights, 0.9, &noise, None, 3);
        let away = displaced(&scan.points()[0], 150.0, 2.5, 8);
        let seen = scan.transformed("world", &away.inverse());
        let blind = Cloud::new("world", seen.points().to_vec()).unwrap();
        for (name, cloud) in [("seen", &seen), ("blind", &blind)] {
            let fit = global(&TARGET, cloud, &params);
            let fit = fit.map(|fit| (motion(&(fit.t_target_source * away.inverse())), fit.report));
            text += &outcome(format!("{heights:?} {name}"), &fit);
        }
    }
    let wide = BONE.scan(&BONE.camera(100.0), [92.0, 100.0], 0.4, &noise, None, 3);
    text += &outcome("as wide as long", &global(&TARGET, &wide, &GlobalParams::default()));
    let few = wide.selected(&(0..199).collect::<Vec<_>>());
    text += &outcome("few", &global(&TARGET, &few, &GlobalParams::default()));
    golden("global", &text);
}

#[test]
fn a_fit_of_named_points_reports_what_it_did() {
    let named = |points: &[(&str, [f64; 3])]| -> Vec<NamedPoint> {
        points.iter().map(|(name, p)| NamedPoint::new(*name, Point3::from(*p))).collect()
    };
    let target = named(&[("A", [0.0, 1.0, 100.0]), ("B", [6.0, -6.0, 131.0]), ("C", [-5.0, 2.0, 124.0])]);
    let source = named(&[("C", [23.1, -4.0, 3.0]), ("A", [0.2, 1.0, 0.3]), ("B", [31.0, 3.0, -5.0])]);
    let swapped = named(&[("A", [23.1, -4.0, 3.0]), ("C", [0.2, 1.0, 0.3]), ("B", [31.0, 3.0, -5.0])]);
    let flat = named(&[("A", [0.0, 0.0, 0.0]), ("B", [10.0, 2.0, 0.0]), ("C", [20.0, 0.0, 0.0])]);
    let nearly = named(&[("A", [0.0, 0.0, 0.0]), ("B", [10.0, 2.2, 0.0]), ("C", [20.0, 0.0, 0.0])]);
    let twice = named(&[("A", [0.0; 3]), ("B", [1.0; 3]), ("A", [2.0; 3])]);
    let other = named(&[("A", [0.0; 3]), ("B", [1.0; 3]), ("D", [2.0; 3])]);
    let mut text = String::new();
    for (name, target, source) in [
        ("usual", &target, &source),
        ("swapped", &target, &swapped),
        ("flat source", &target, &flat),
        ("flat target", &flat, &source),
        ("nearly flat", &nearly, &nearly),
        ("twice in the source", &target, &twice),
        ("twice in the target", &twice, &source),
        ("another name", &target, &other),
        ("one more", &target, &[&*source, &other[2..]].concat()),
        ("one less", &target, &source[..2].to_vec()),
        ("two", &target[..2].to_vec(), &source[1..].to_vec()),
    ] {
        let fit = coarse::three_point(target, source).map(|fit| (motion(&fit.t_target_source), fit.report));
        text += &outcome(name, &fit);
    }
    text += &line("points of the target", &points(TARGET.points()));
    golden("coarse", &text);
}

#[test]
fn a_surface_that_leaves_motions_open_is_fitted_and_described_as_it_was() {
    type Shape = fn(f64, f64) -> (Vector3<f64>, Vector3<f64>);
    let shapes: [(&str, Shape); 4] = [
        ("plane", |u, v| (Vector3::new(60.0 * u, 40.0 * v, 0.0), Vector3::z())),
        ("cylinder", |u, v| {
            let out = Vector3::new((u * 3.0).cos(), (u * 3.0).sin(), 0.0);
            (out * 7.0 + Vector3::z() * 60.0 * v, out)
        }),
        ("ball", |u, v| {
            let (across, z) = ((1.0 - v * v).sqrt(), v);
            let out = Vector3::new(across * (u * 3.0).cos(), across * (u * 3.0).sin(), z);
            (out * 15.0, out)
        }),
        ("waves", |u, v| {
            let (x, y) = (50.0 * u, 50.0 * v);
            let normal = Vector3::new(-0.02 * (x / 10.0).cos(), 0.02 * (y / 8.0).sin(), 1.0).normalize();
            (Vector3::new(x, y, 0.2 * (x / 10.0).sin() + 0.16 * (y / 8.0).cos()), normal)
        }),
    ];
    let mut text = String::new();
    for (name, shape) in shapes {
        let at = |k: u32| shape(f64::from(k) * 0.618_034 % 1.0 - 0.5, f64::from(k) / 8000.0 - 0.5);
        let (points, normals): (Vec<Point3<f64>>, Vec<Vector3<f64>>) =
            (0..8000).map(at).map(|(p, n)| (Point3::from(p), n)).unzip();
        let target = Target::new("ct", TARGET.origin, points.clone(), Some(normals.into())).unwrap();
        let scan: Vec<Point3<f64>> = points.iter().skip(3).step_by(7).copied().collect();
        let init = displaced(&Point3::origin(), 0.8, 0.02, 77);
        for method in [Method::PointToPoint, Method::PointToPlane, Method::Symmetric, Method::Generalized] {
            let params = IcpParams { max_iterations: 40, ..IcpParams::default() };
            let fit = register(method, &target, &scan, &init, &params, &mut go_on());
            text += &described(&format!("{name} {}", method.name()), &fit);
            text += &line("    motions", &fit.unwrap().report.observability);
        }
    }
    golden("icp_open", &text);
}
