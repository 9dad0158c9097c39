//! Whether a field pays beside the searches that it replaces.

use crate::{bone, fastest, number};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::coarse::{GlobalParams, global};
use osteoflow_algorithms::field::{ClosestPointField, FieldParams};
use osteoflow_algorithms::icp::{self, IcpParams, IcpStep, Method, PairingKind};
use osteoflow_algorithms::sample::Samples;
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{Cloud, Mesh, SurfaceOrigin};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::ControlFlow;

fn target_of(samples: &Samples) -> Target {
    let normals = samples.normals.clone().into();
    Target::new("ct", SurfaceOrigin::User, samples.points.clone(), Some(normals)).expect("samples are a target")
}

/// Registrations of one scan onto one target from starts as far off as a three-point fit, with the preparation counted.
pub(crate) fn registrations(mesh: &Mesh, samples: &Samples) {
    let scan = bone::scan(mesh, 20_000);
    let centre = scan.iter().map(|p| p.coords).sum::<Vector3<f64>>() / scan.len() as f64;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut vector = |size: [f64; 3]| Vector3::from(size.map(|s| s * (2.0 * rng.random::<f64>() - 1.0)));
    let starts: Vec<Isometry3<f64>> = (0..number("STARTS", 200))
        .map(|_| {
            let off = Isometry3::new(vector([2.0, 2.0, 6.0]), vector([0.05, 0.05, 0.08]));
            Isometry3::from(centre) * off * Isometry3::from(-centre)
        })
        .collect();
    let (mut cached_s, mut cached_ends) = ((0.0, 0.0), Vec::new());
    println!("{} registrations of {} points:", starts.len(), scan.len());
    for (name, pairing, field_exact) in [
        ("cached", PairingKind::Cached, true),
        ("field", PairingKind::Field, true),
        ("field alone", PairingKind::Field, false),
    ] {
        let (prepared_s, target) = fastest(3, || {
            let target = target_of(samples);
            target.prepare();
            let of_points = || {
                ClosestPointField::of_points(&samples.points, &samples.normals, &FieldParams::default())
                    .expect("a bone")
            };
            if pairing == PairingKind::Field { target.with_field(of_points()) } else { target }
        });
        let params = IcpParams { pairing, field_exact, max_pair_distance_mm: 10.0, ..IcpParams::default() };
        let register = |start: &Isometry3<f64>| {
            let fit =
                icp::register(Method::PointToPlane, &target, &scan, start, &params, &mut |_| ControlFlow::Continue(()));
            fit.expect("the scan is near").t_target_source
        };
        let (aligned_s, ends) = fastest(2, || starts.iter().map(register).collect::<Vec<_>>());
        let each_s = aligned_s / starts.len() as f64;
        print!("    {name}: prepared in {:.1} ms, {:.2} ms each", prepared_s * 1e3, each_s * 1e3);
        if pairing == PairingKind::Cached {
            (cached_s, cached_ends) = ((prepared_s, each_s), ends);
            println!();
            continue;
        }
        let total = prepared_s + aligned_s;
        let cached_total = cached_s.0 + cached_s.1 * starts.len() as f64;
        let even = (prepared_s - cached_s.0) / (cached_s.1 - each_s);
        let apart = |(a, b): (&Isometry3<f64>, &Isometry3<f64>)| {
            scan.iter().map(|p| (a * p - b * p).norm_squared()).sum::<f64>() / scan.len() as f64
        };
        let apart = ends.iter().zip(&cached_ends).map(apart).fold(0.0, f64::max).sqrt();
        println!(
            "; {:.2} of the time of cached with the preparation, {:.2} without; pays from {even:.0} on; ends at most \
             {apart:.4} mm apart",
            total / cached_total,
            each_s / cached_s.1,
        );
    }
}

/// The start by shape alone beside the field that it would need.
pub(crate) fn start_by_shape(mesh: &Mesh, samples: &Samples) {
    let target = target_of(samples);
    target.prepare();
    let scan = Cloud::new("camera", bone::scan(mesh, 20_000)).expect("a finite scan");
    let (global_s, _) = fastest(2, || global(&target, &scan, &GlobalParams::default()).expect("a long scan"));
    println!("coarse.global: {:.0} ms", global_s * 1e3);
    let judged: Vec<Point3<f64>> = scan.points().iter().step_by(scan.len() / 200).copied().collect();
    let every = samples.points.len().div_ceil(10_000);
    let thinned = Samples {
        points: samples.points.iter().step_by(every).copied().collect(),
        normals: samples.normals.iter().step_by(every).copied().collect(),
        faces: Vec::new(),
    };
    let rough = target_of(&thinned);
    let places: Vec<Point3<f64>> = (0..3000)
        .flat_map(|k| {
            let turn = Isometry3::rotation(Vector3::z() * (f64::from(k) * 0.13));
            let shift = Isometry3::translation(0.0, 0.0, f64::from(k % 60) * 5.0 - 150.0);
            judged.iter().map(move |p| shift * turn * p).collect::<Vec<_>>()
        })
        .collect();
    let (nearest_s, _) = fastest(2, || places.iter().filter_map(|p| rough.nearest(p, 6.0)).count());
    println!("    {} nearest points of its starts: {:.0} ms", places.len(), nearest_s * 1e3);
    let refined: Vec<Point3<f64>> = scan.points().iter().step_by(scan.len() / 600).copied().collect();
    let centre = refined.iter().map(|p| p.coords).sum::<Vector3<f64>>() / refined.len() as f64;
    let starts: Vec<Isometry3<f64>> = (0..60)
        .map(|k| {
            let share = f64::from(k) / 30.0 - 1.0;
            let off = Isometry3::new(Vector3::z() * (2.5 * share), Vector3::z() * (0.13 * (7.0 * share).sin()));
            Isometry3::from(centre) * off * Isometry3::from(-centre)
        })
        .collect();
    let refine = |target: &Target, reach_mm: f64, pairing: PairingKind| {
        let params = IcpParams {
            pairing,
            field_exact: false,
            max_pair_distance_mm: reach_mm,
            levels: Vec::new(),
            max_iterations: 40,
            stop_step_mm: 0.01,
            stop_step_rad: 1e-4,
            ..IcpParams::default()
        };
        let register = |start: &Isometry3<f64>| {
            let observer = &mut |_: &IcpStep| ControlFlow::Continue(());
            icp::register(Method::PointToPlane, target, &refined, start, &params, observer).is_ok()
        };
        fastest(3, || starts.iter().filter(|start| register(start)).count()).0
    };
    let (rough_s, fine_s) = (refine(&rough, 12.0, PairingKind::Cached), refine(&target, 2.0, PairingKind::Cached));
    println!("    60 refinements on the thinned surface: {:.0} ms, on all of it {:.0} ms", rough_s * 1e3, fine_s * 1e3);
    let coarse = FieldParams { fine_mm: 2.0, band_mm: 2.0, coarse_mm: 4.0, reach_mm: 8.0 };
    for (name, samples, params) in
        [("the field", samples, FieldParams::default()), ("a coarse field of the thinned surface", &thinned, coarse)]
    {
        let of_points = || ClosestPointField::of_points(&samples.points, &samples.normals, &params).expect("a bone");
        let (made_s, field) = fastest(2, of_points);
        let (found_s, _) = fastest(2, || places.iter().filter_map(|p| field.at(p)).count());
        let refined_s = refine(&rough.clone().with_field(field), 12.0, PairingKind::Field);
        println!(
            "    {name}: made in {:.0} ms, these look-ups {:.0} ms, these refinements {:.0} ms",
            made_s * 1e3,
            found_s * 1e3,
            refined_s * 1e3
        );
    }
}
