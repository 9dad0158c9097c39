use super::*;
use crate::mesh_query::MeshQuery;
use crate::sample;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, Normal};

/// A closed tube along z, 240 mm long, of a radius by height and angle.
fn tube(radius: impl Fn(f64, f64) -> f64) -> Mesh {
    let (rings, around) = (241_u32, 96_u32);
    let at = |i: u32, j: u32| {
        let (z, turn) = (f64::from(i) - 120.0, f64::from(j) / f64::from(around) * std::f64::consts::TAU);
        let r = radius(z, turn);
        Point3::new(r * turn.cos(), r * turn.sin(), z)
    };
    let mut vertices: Vec<Point3<f64>> = (0..rings).flat_map(|i| (0..around).map(move |j| at(i, j))).collect();
    let index = |i: u32, j: u32| i * around + j % around;
    let mut faces = Vec::new();
    for i in 0..rings - 1 {
        for j in 0..around {
            faces.push([index(i, j), index(i, j + 1), index(i + 1, j)]);
            faces.push([index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)]);
        }
    }
    for (ring, z) in [(0, -120.0), (rings - 1, 120.0)] {
        let hub = vertices.len() as u32;
        vertices.push(Point3::new(0.0, 0.0, z));
        for j in 0..around {
            let (a, b) = (index(ring, j), index(ring, j + 1));
            faces.push(if ring > 0 { [hub, a, b] } else { [hub, b, a] });
        }
    }
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
}

/// The surface, a scan of its side towards +x between -40 and 40 mm with this noise, and the pose of the scan on it.
fn case(mesh: &Mesh, noise_mm: f64) -> (Target, Cloud, Isometry3<f64>) {
    let samples = sample::surface(mesh, 60_000, &mut ChaCha8Rng::seed_from_u64(1));
    let target = Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap();
    let target = target.with_mesh(MeshQuery::new(mesh));
    let seen = sample::surface(mesh, 60_000, &mut ChaCha8Rng::seed_from_u64(2));
    let truth =
        Isometry3::from_parts(Translation3::new(30.0, -20.0, 400.0), UnitQuaternion::from_euler_angles(0.4, 1.1, -0.3));
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let noise = Normal::new(0.0, noise_mm).unwrap();
    let side = seen.points.iter().zip(&seen.normals).filter(|(p, n)| p.z.abs() < 40.0 && n.x > 0.3);
    let points: Vec<Point3<f64>> =
        side.map(|(p, _)| truth.inverse() * (p + Vector3::x() * noise.sample(&mut rng))).collect();
    let camera = Isometry3::translation(200.0, 0.0, 0.0);
    (target, Cloud::new("scan", points).unwrap().seen_from(truth.inverse() * camera), truth)
}

/// The pose moved along z and about it, at the scan.
fn off(truth: &Isometry3<f64>, along_mm: f64, turn_deg: f64) -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, along_mm) * Isometry3::rotation(Vector3::z() * turn_deg.to_radians()) * truth
}

fn slid(case: &(Target, Cloud, Isometry3<f64>), start: &Isometry3<f64>) -> SlideFit {
    slide(&case.0, &case.1, start, &SlideParams::default()).unwrap()
}

fn axis_error_deg(report: &SlideReport) -> f64 {
    Vector3::from(report.axis).dot(&Vector3::z()).abs().min(1.0).acos().to_degrees()
}

/// RMS distance of the scan at two poses, mm.
fn apart_mm(case: &(Target, Cloud, Isometry3<f64>), a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    Scene::new(&case.0, &case.1).apart_mm(a, b)
}

#[test]
fn a_perfect_cylinder_is_undetermined_both_ways_and_its_axis_is_known() {
    let mesh = tube(|_, _| 7.0);
    let is_slow = std::env::var_os("SLOW_TESTS").is_some();
    for noise_mm in if is_slow { vec![0.0, 0.05, 0.15, 0.3] } else { vec![0.15] } {
        let case = case(&mesh, noise_mm);
        for (along_mm, turn_deg) in [(0.0, 0.0), (9.0, 20.0)] {
            let start = off(&case.2, along_mm, turn_deg);
            let fit = slid(&case, &start);
            let report = &fit.report;
            println!(
                "noise {noise_mm} mm: axis {:.2} degrees off, {} | {}",
                axis_error_deg(report),
                report.modes[0],
                report.modes[1]
            );
            assert!(!report.determined && report.along.is_undetermined && report.around.is_undetermined, "{report:?}");
            assert!(axis_error_deg(report) < 2.0, "axis {} degrees off", axis_error_deg(report));
            assert!(report.moved_along_mm.abs() < 1.0, "moved by {} mm without a reason", report.moved_along_mm);
            assert!(report.moved_turn_rad.abs() < 0.1, "turned by {} rad without a reason", report.moved_turn_rad);
            assert_eq!(report.warnings(1.5, 0.1).len(), 1, "{:?}", report.warnings(1.5, 0.1));
        }
    }
}

#[test]
fn a_surface_of_revolution_is_determined_along_and_not_around() {
    let case = case(&tube(|z, _| 7.0 + 0.6 * (z / 17.0).sin() + 0.01 * z), 0.05);
    let fit = slid(&case, &off(&case.2, 8.0, 0.0));
    let report = &fit.report;
    println!("{:?}", report.modes);
    assert!(!report.along.is_undetermined && report.around.is_undetermined && !report.determined, "{:?}", report.modes);
    assert!((report.moved_along_mm + 8.0).abs() < 0.1, "moved by {} mm, 8 asked", report.moved_along_mm);
    assert!(axis_error_deg(report) < 2.0);
}

#[test]
fn a_prism_is_determined_around_and_not_along() {
    let case = case(&tube(|_, turn| 7.0 + 0.7 * (3.0 * turn).cos() + 0.4 * turn.cos()), 0.05);
    let fit = slid(&case, &off(&case.2, 0.0, 15.0));
    let report = &fit.report;
    println!("{:?}", report.modes);
    assert!(report.along.is_undetermined && !report.around.is_undetermined, "{:?}", report.modes);
    assert!((report.moved_turn_rad.to_degrees() + 15.0).abs() < 1.0, "turned by {} rad", report.moved_turn_rad);
    assert!(report.moved_along_mm.abs() < 1.0, "moved by {} mm", report.moved_along_mm);
}

#[test]
fn a_twisted_prism_screws_with_its_own_pitch_and_hand() {
    for per_mm in [0.01, -0.02] {
        let section = move |z: f64, turn: f64| 7.0 + 0.7 * (3.0 * (turn - per_mm * z)).cos();
        let case = case(&tube(section), 0.05);
        let fit = slid(&case, &case.2);
        let mode = &fit.report.modes[0];
        println!("{mode}");
        let pitch = 1.0_f64.to_radians() / f64::abs(per_mm);
        let hand = if per_mm > 0.0 { "right" } else { "left" };
        assert!(mode.starts_with(&format!("screws along the bone, {pitch:.1} mm per degree, {hand}-handed")), "{mode}");
        assert!(fit.report.along.is_undetermined, "{mode}");
    }
}

/// A bone-like tube: tapered, with ridges that wander and bumps.
fn bone() -> Mesh {
    tube(|z, turn| {
        let ridges = 0.9 * (3.0 * (turn - 0.004 * z)).cos() + 0.5 * (turn + 0.01 * z).cos();
        6.5 + 0.008 * z + ridges + 0.3 * (z / 9.0).sin() + 0.2 * (z / 6.0 + 2.0 * turn).sin()
    })
}

#[test]
fn a_slid_and_spun_start_comes_home_and_the_profile_is_lowest_there() {
    let case = case(&bone(), 0.05);
    let home = slid(&case, &case.2);
    assert!(apart_mm(&case, &home.t_target_source, &case.2) < 0.1);
    for (along_mm, turn_deg) in [(25.0, 0.0), (-25.0, 10.0), (12.0, -45.0), (0.0, 50.0)] {
        let fit = slid(&case, &off(&case.2, along_mm, turn_deg));
        let apart_mm = apart_mm(&case, &fit.t_target_source, &home.t_target_source);
        assert!(apart_mm < 0.005, "from {along_mm} mm and {turn_deg} degrees it ends {apart_mm} mm away");
        let report = &fit.report;
        assert!(report.determined, "{:?}", report.modes);
        assert!((report.moved_along_mm + along_mm).abs() < 1.0, "{} mm, {along_mm} asked", report.moved_along_mm);
        for profile in [&report.along, &report.around] {
            let lowest = profile.residual_mm.iter().copied().fold(f64::INFINITY, f64::min);
            let middle = profile.offsets.iter().position(|offset| *offset == 0.0).unwrap();
            assert!(profile.residual_mm[middle] < lowest + 0.002, "{} is above {lowest}", profile.residual_mm[middle]);
            let [low, high] = profile.interval;
            assert!(low < 0.0 && high > 0.0 && profile.offsets.is_sorted());
        }
    }
}

#[test]
fn the_change_of_the_residual_is_the_mean_of_both_ways() {
    let bone = bone();
    let case = case(&bone, 0.1);
    let report = slid(&case, &off(&case.2, 0.5, 1.0)).report;
    for (words, profile, one) in
        [(&report.modes[0], &report.along, 1.0), (&report.modes[1], &report.around, 1_f64.to_radians())]
    {
        // The samples of the profile next to an offset, on whichever side.
        let at = |offset: f64| {
            let k = profile.offsets.iter().position(|x| *x >= offset).unwrap().max(1);
            let share = (offset - profile.offsets[k - 1]) / (profile.offsets[k] - profile.offsets[k - 1]);
            profile.excess_mm[k - 1] * (1.0 - share) + profile.excess_mm[k] * share
        };
        let mean = format!("changes the residual by {:.3} mm", (at(one) + at(-one)) / 2.0);
        assert!(words.contains(&mean), "{words}; {mean}");
    }
}

#[test]
fn another_minimum_as_good_is_reported_as_such() {
    // Repeats every 20 mm.
    let case =
        case(&tube(|z, turn| 7.0 + 0.5 * (z * std::f64::consts::TAU / 20.0).sin() + 0.7 * (2.0 * turn).cos()), 0.05);
    let fit = slid(&case, &off(&case.2, 2.0, 0.0));
    let other = fit.report.runner_up.as_ref().expect("it repeats");
    println!("{}", other.words(fit.report.residual_mm));
    assert!((other.along_mm.abs() / 20.0 - (other.along_mm.abs() / 20.0).round()).abs() < 0.05, "{other:?}");
    assert!(!other.is_told_apart && other.excess_mm < 0.02, "{other:?}");
    assert!(
        fit.report.warnings(50.0, 1.0)[0].starts_with("the scan fits as well"),
        "{:?}",
        fit.report.warnings(50.0, 1.0)
    );
}

#[test]
fn wrong_input_is_refused_with_its_reason() {
    let (target, scan, truth) = case(&bone(), 0.05);
    let message = |target: &Target, scan: &Cloud, start: &Isometry3<f64>, params: &SlideParams| {
        slide(target, scan, start, params).unwrap_err().to_string()
    };
    let params = SlideParams::default();
    let far = message(&target, &scan, &off(&truth, 300.0, 0.0), &params);
    assert!(
        far.contains("scan points lie within 4 mm of the surface") && far.contains("is t_target_source right"),
        "{far}"
    );
    let few = Cloud::new("scan", scan.points()[..150].to_vec()).unwrap();
    assert!(message(&target, &few, &truth, &params).contains("the scan has 150 points, 200 are needed"));
    let bare = Target::new("ct", SurfaceOrigin::Exact, target.points().to_vec(), None).unwrap();
    assert!(message(&bare, &scan, &truth, &params).contains("the target has no normals"));
    let nan = Isometry3::translation(f64::NAN, 0.0, 0.0);
    assert!(message(&target, &scan, &nan, &params).contains("not finite"));
    let none = SlideParams { along_mm: 0.0, ..params };
    assert!(message(&target, &scan, &truth, &none).contains("along_mm is 0"));
}

#[test]
fn the_number_of_threads_does_not_change_the_result() {
    let case = case(&bone(), 0.05);
    let start = off(&case.2, 6.0, 10.0);
    let on = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| slid(&case, &start));
    assert_eq!(on(1), on(3));
}
