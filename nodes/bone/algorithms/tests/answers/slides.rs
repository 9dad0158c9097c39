//! Slide profiles of scans on shafts of more and less shape.

use super::text::{golden, line, motion, outcome, vectors};
use super::{BONE, TARGET};
use crate::common::{CLEAN, USUAL, displaced};
use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::slide::{SlideFit, SlideParams, SlideProfile, slide};
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{Cloud, SurfaceOrigin};

fn described(name: &str, fit: &SlideFit) -> String {
    let report = &fit.report;
    let profile = |p: &SlideProfile| {
        let each: Vec<Vector3<f64>> = (0..p.offsets.len())
            .map(|k| Vector3::new(p.offsets[k], p.others[k], p.residual_mm[k] + 10.0 * p.excess_mm[k]))
            .collect();
        (vectors(&each), p.interval, p.is_undetermined)
    };
    let mut text = line(name, &motion(&fit.t_target_source));
    let moved = (report.moved_along_mm, report.moved_turn_rad, report.moved_mm);
    let sizes = (report.residual_mm, report.sigma_mm, report.noise_mm, report.n_cells);
    text += &line("    ", &(report.axis, report.middle_mm, report.radius_mm, moved, sizes));
    text += &line("    along", &profile(&report.along));
    text += &line("    around", &profile(&report.around));
    text += &line("    other", &(&report.runner_up, &report.modes, report.undetermined(), report.warnings(1.0, 0.02)));
    text
}

/// A shaft of slightly varying radius, as points with normals along their rays.
fn shaft(radius: impl Fn(f64, f64) -> f64) -> Target {
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for k in 0..12_000_u32 {
        let (z, turn) = (f64::from(k) * 0.014 - 84.0, f64::from(k) * 2.399_963);
        let out = Vector3::new(turn.cos(), turn.sin(), 0.0);
        let r = radius(z, turn);
        points.push(Point3::from(out * r + Vector3::z() * z));
        let (by_z, by_turn) = (radius(z + 1e-3, turn) - r, radius(z, turn + 1e-4) - r);
        normals.push((out - Vector3::z() * by_z / 1e-3 - out.cross(&-Vector3::z()) * by_turn / 1e-4 / r).normalize());
    }
    Target::new("ct", SurfaceOrigin::Exact, points, Some(normals.into())).unwrap()
}

/// A scan of the side towards +x, from its points, displaced alternately by the noise.
fn side(target: &Target, noise_mm: f64) -> Cloud {
    let seen = target.points().iter().zip(target.normals().unwrap()).enumerate();
    let seen = seen.filter(|(k, (p, n))| k % 4 == 1 && p.z.abs() < 25.0 && n.x > 0.3);
    let points: Vec<Point3<f64>> = seen.map(|(k, (p, n))| p + n * noise_mm * (k as f64 * 0.7).sin()).collect();
    Cloud::new("ct", points).unwrap().seen_from(Isometry3::translation(200.0, 0.0, 0.0))
}

#[test]
fn a_shaft_without_shape_is_as_open_as_it_was_and_one_with_shape_as_closed() {
    let params = SlideParams { along_mm: 12.0, around_deg: 40.0, ..SlideParams::default() };
    let mut text = String::new();
    type Radius = fn(f64, f64) -> f64;
    let radii: [(&str, Radius); 4] = [
        ("cylinder", |_, _| 7.0),
        ("prism", |_, turn| 7.0 + 0.6 * (3.0 * turn).cos()),
        ("cone", |z, _| 7.0 + 0.03 * z + 0.3 * (z / 6.0).sin()),
        ("bumps", |z, turn| 7.0 + 0.5 * (z / 5.0 + 2.0 * turn).sin() + 0.02 * z),
    ];
    for (name, radius) in radii {
        let target = shaft(radius);
        let scan = side(&target, 0.08);
        for (along_mm, turn_deg) in [(0.0, 0.0), (4.0, -9.0)] {
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), f64::to_radians(turn_deg));
            let start = Isometry3::from_parts(
                Vector3::new(0.0, 0.0, along_mm).into(),
                UnitQuaternion::from_rotation_matrix(&turn),
            );
            match slide(&target, &scan, &start, &params) {
                Ok(fit) => text += &described(&format!("{name} off {along_mm} mm {turn_deg} deg"), &fit),
                Err(error) => text += &format!("{name}: {error}\n"),
            }
        }
    }
    golden("slide_shafts", &text);
}

#[test]
fn a_scan_slid_along_the_own_bone_comes_back_to_where_it_did() {
    let scan = BONE.scan(&BONE.camera(150.0), [125.0, 175.0], 1.5, &USUAL, None, 91);
    let off = |mm: f64, rad: f64| {
        let turn = UnitQuaternion::from_scaled_axis(BONE.proximal * rad);
        let at = scan.points()[scan.len() / 2].coords;
        Isometry3::from_parts((at - turn * at + BONE.proximal * mm).into(), turn)
    };
    let params = SlideParams { along_mm: 15.0, around_deg: 30.0, ..SlideParams::default() };
    let mut text = String::new();
    for (mm, rad) in [(0.0, 0.0), (8.0, 0.2)] {
        text += &described(&format!("off {mm} mm {rad} rad"), &slide(&TARGET, &scan, &off(mm, rad), &params).unwrap());
    }
    let mut refused = |name: &str, target: &Target, scan: &Cloud, start: &Isometry3<f64>, params: &SlideParams| {
        text += &outcome(name, &slide(target, scan, start, params).map(|fit| fit.report.n_cells));
    };
    let here = Isometry3::identity();
    let bare = Target::new("ct", TARGET.origin, TARGET.points().to_vec(), None).unwrap();
    refused("no normals", &bare, &scan, &here, &params);
    refused("few", &TARGET, &scan.selected(&(0..199).collect::<Vec<_>>()), &here, &params);
    refused("far", &TARGET, &scan, &Isometry3::translation(0.0, 90.0, 0.0), &params);
    refused("beside", &TARGET, &scan, &displaced(&scan.points()[0], 25.0, 0.0, 2), &params);
    refused("not finite", &TARGET, &scan, &Isometry3::translation(f64::NAN, 0.0, 0.0), &params);
    for bad in [0.0, f64::NAN] {
        refused("along", &TARGET, &scan, &here, &SlideParams { along_mm: bad, ..params.clone() });
        refused("around", &TARGET, &scan, &here, &SlideParams { around_deg: bad, ..params.clone() });
        refused("noise", &TARGET, &scan, &here, &SlideParams { noise_mm: bad, ..params.clone() });
        refused("open", &TARGET, &scan, &here, &SlideParams { undetermined_mm: bad, ..params.clone() });
        refused("open turn", &TARGET, &scan, &here, &SlideParams { undetermined_deg: bad, ..params.clone() });
    }
    let short = BONE.scan(&BONE.camera(20.0), [15.0, 25.0], 0.7, &CLEAN, None, 92);
    text += &outcome("short", &slide(&TARGET, &short, &here, &params).map(|fit| described("", &fit)));
    golden("slide_bone", &text);
}
