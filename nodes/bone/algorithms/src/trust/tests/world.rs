//! What may be wrong beside the pose: measured, bounded, or an assumption with its critical size.

use super::*;
use crate::icp::{self, IcpParams, Method};
use crate::trust::cut::{Displaced, planned_cuts};
use osteoflow_geometry::Planes;
use std::ops::ControlFlow;

const HEIGHTS: [f64; 2] = [15.0, 105.0];
const MIDDLE: f64 = 60.0;

fn moved(mesh: &Mesh, to: impl Fn(&Point3<f64>) -> Point3<f64>) -> Mesh {
    let vertices: Vec<Point3<f64>> = mesh.vertices().iter().map(to).collect();
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, mesh.faces().to_vec()).unwrap()
}

/// Three points on the bone and two cuts, as planned on the CT.
fn plan(to: &dyn Fn(&Point3<f64>) -> Point3<f64>) -> (Vec<NamedPoint>, Planes) {
    let points = marks().into_iter().map(|mark| NamedPoint { position: to(&mark.position), ..mark }).collect();
    let plane = |name: &str, z: f64, tilt: f64| {
        let middle = to(&Point3::new(0.0005 * z * z, 0.0, z));
        Plane::new(name, Isometry3::new(middle.coords, Vector3::x() * tilt))
    };
    (points, Planes::new("ct", vec![plane("a", 40.0, 0.3), plane("b", 80.0, -0.3)]))
}

/// The registration of a scan on a CT, and the verdict on it; the CT shows the bone at `to`.
fn judged(ct: &Mesh, scan: &Cloud, to: &dyn Fn(&Point3<f64>) -> Point3<f64>) -> (Isometry3<f64>, Verdict) {
    let target = target_of(ct);
    let observer = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
    let start = Isometry3::identity();
    let fit = icp::register(Method::PointToPlane, &target, scan, &start, &IcpParams::default(), observer).unwrap();
    let (points, planes) = plan(to);
    let case = Case { assessment: &points, planes: Some(&planes), ..bare(&target, scan, &fit.t_target_source) };
    let verdict = judge(&case, &EvidenceParams::default(), &RuleParams::default(), &PredictParams::default());
    (fit.t_target_source, verdict)
}

fn nuisance<'a>(verdict: &'a Verdict, name: &str) -> &'a Nuisance {
    verdict.nuisances.iter().find(|nuisance| nuisance.name == name).unwrap()
}

fn stretched(percent: f64) -> impl Fn(&Point3<f64>) -> Point3<f64> {
    move |p| Point3::new(p.x, p.y, MIDDLE + (p.z - MIDDLE) * (1.0 + percent / 100.0))
}

#[test]
fn a_ct_that_is_too_long_is_measured_and_one_percent_stays_trusted() {
    let scan = scan_of(&shaft(), HEIGHTS, 31);
    for percent in [-5.0, 5.0] {
        let to = stretched(percent);
        let (_, verdict) = judged(&moved(&shaft(), &to), &scan, &to);
        assert_eq!(rules(&verdict)[0], "stretch_along", "{:?}", verdict.reasons);
        let stretch = nuisance(&verdict, "stretch_along");
        assert_eq!(stretch.state, NuisanceState::Measured);
        let estimate = stretch.estimate.unwrap();
        assert!((estimate - percent).abs() < 1.0, "{estimate} % of {percent} %");
        let axis = Vector3::from(stretch.axis.unwrap());
        assert!(axis.z.abs() > 0.99, "{axis}");
        let word = if percent > 0.0 { "% too long along the bone" } else { "% too short along the bone" };
        assert!(verdict.reasons[0].reason.contains(word), "{}", verdict.reasons[0].reason);
    }
    let to = stretched(1.0);
    let (_, verdict) = judged(&moved(&shaft(), &to), &scan, &to);
    assert_eq!(verdict.answer, Answer::Trusted, "{:?}", verdict.reasons);
    let wider = nuisance(&verdict, "stretch_along");
    assert!(wider.state != NuisanceState::Measured && wider.effect_mm < 1.5, "{wider:?}");
}

#[test]
fn a_sound_scan_bounds_the_stretch_and_leaves_film_and_depth_as_assumptions_with_sizes() {
    let (_, verdict) = judged(&shaft(), &scan_of(&shaft(), HEIGHTS, 32), &|p| *p);
    assert_eq!(verdict.answer, Answer::Trusted, "{:?}", verdict.reasons);
    for (name, state) in [
        ("stretch_along", NuisanceState::Bounded),
        ("growth", NuisanceState::Bounded),
        ("offset", NuisanceState::Bounded),
        ("film_along", NuisanceState::Unseen),
        ("camera_depth", NuisanceState::Unseen),
        ("step", NuisanceState::Unseen),
    ] {
        assert_eq!(nuisance(&verdict, name).state, state, "{name}");
    }
    let film = verdict
        .assumptions
        .iter()
        .find(|text| text.starts_with("no film grows along the bone: one that grows by more"));
    assert!(film.is_some_and(|text| text.contains("would tilt a cut by 0.5 degrees")), "{:?}", verdict.assumptions);
    assert!(!verdict.assumptions.iter().any(|text| text.starts_with("the CT shows the bone at its true size")));
}

#[test]
fn a_cause_that_cannot_be_fitted_is_an_assumption_and_not_bounded() {
    // So short a scan has fewer cells than unknowns.
    let (_, verdict) = judged(&shaft(), &scan_of(&shaft(), [50.0, 61.0], 35), &|p| *p);
    let fitted: Vec<&Nuisance> =
        verdict.nuisances.iter().filter(|n| !n.name.starts_with("film") && n.name != "camera_depth").collect();
    assert!(fitted.iter().any(|n| n.estimate.is_none()), "{fitted:?}");
    for nuisance in fitted.iter().filter(|n| n.estimate.is_none()) {
        assert_eq!(nuisance.state, NuisanceState::Unseen, "{nuisance:?}");
    }
}

#[test]
fn a_scan_that_is_too_large_is_the_cameras_scale_or_a_growth() {
    let scan = scan_of(&shaft(), HEIGHTS, 33);
    let camera = scan.viewpoint.unwrap() * Point3::origin();
    let larger: Vec<Point3<f64>> = scan.points().iter().map(|p| camera + (p - camera) * 1.03).collect();
    let larger = Cloud::new("scan", larger).unwrap().seen_from(scan.viewpoint.unwrap());
    let (_, verdict) = judged(&shaft(), &larger, &|p| *p);
    let reason =
        verdict.reasons.iter().find(|reason| reason.rule == "camera_scale" || reason.rule == "growth").unwrap();
    assert!(reason.reason.contains("the camera measures "), "{}", reason.reason);
    let scale = nuisance(&verdict, "camera_scale");
    // Too long: what it measures has to shrink.
    assert!((scale.estimate.unwrap() + 3.0).abs() < 0.5, "{scale:?}");
    // 3 % of 200 mm, or less by what the bone's size shows.
    assert!((scale.effect_mm - 6.0).abs() < 1.0, "{scale:?}");
}

#[test]
fn a_part_that_is_displaced_across_the_bone_is_measured_with_its_place() {
    let scan = scan_of(&shaft(), HEIGHTS, 34);
    let step = |p: &Point3<f64>| if p.z > 75.0 { p + Vector3::new(0.9, 1.2, 0.0) } else { *p };
    let points: Vec<Point3<f64>> = scan.points().iter().map(step).collect();
    let scan = Cloud::new("scan", points).unwrap().seen_from(scan.viewpoint.unwrap());
    let (_, verdict) = judged(&shaft(), &scan, &|p| *p);
    assert!(rules(&verdict).contains(&"step"), "{:?}", verdict.reasons);
    let step = nuisance(&verdict, "step");
    assert!((step.estimate.unwrap() - 1.5).abs() < 0.3, "{step:?}");
    assert!((step.at.unwrap()[2] - 75.0).abs() < 8.0, "{step:?}");
}

/// The points of a scan, each elsewhere, seen by the same camera.
fn displaced(scan: &Cloud, to: impl Fn(&Point3<f64>) -> Point3<f64>) -> Cloud {
    let points: Vec<Point3<f64>> = scan.points().iter().map(to).collect();
    Cloud::new("scan", points).unwrap().seen_from(scan.viewpoint.unwrap())
}

/// How many times the limits the answer is off, against that of the sound registration, once a scan is registered anew on a CT that shows
/// the bone at `to`.
fn refitted(ct: &Mesh, scan: &Cloud, to: &dyn Fn(&Point3<f64>) -> Point3<f64>, sound: &Isometry3<f64>) -> f64 {
    let (pose, _) = judged(ct, scan, to);
    let error = |p: &Point3<f64>| pose.inverse() * to(p) - sound.inverse() * p;
    let (points, planes) = plan(&|p| *p);
    let tre_mm = points.iter().map(|p| error(&p.position).norm()).sum::<f64>() / points.len() as f64;
    let cuts = planned_cuts(&target_of(&shaft()), Some(&planes));
    let off: Vec<_> = cuts.iter().map(|cut| cut.displaced_by(&error)).collect();
    let most = |of: fn(&Displaced) -> f64| off.iter().map(of).fold(0.0, f64::max);
    Limits::default().times(tre_mm, most(|cut| cut.offset_mm), most(|cut| cut.slope.to_degrees()))
}

#[test]
fn the_critical_size_of_each_cause_is_that_at_which_a_refit_is_wrong() {
    let scan = scan_of(&shaft(), HEIGHTS, 36);
    let (sound, verdict) = judged(&shaft(), &scan, &|p| *p);
    let camera = scan.viewpoint.unwrap() * Point3::origin();
    let middle = Point3::from(scan.points().iter().map(|p| p.coords).sum::<Vector3<f64>>() / scan.len() as f64);
    let surface = MeshQuery::new(&shaft());
    let of_ct = |to: &dyn Fn(&Point3<f64>) -> Point3<f64>| refitted(&moved(&shaft(), to), &scan, to, &sound);
    let of_scan = |to: &dyn Fn(&Point3<f64>) -> Point3<f64>| refitted(&shaft(), &displaced(&scan, to), &|p| *p, &sound);
    let times = |name: &str, size: f64| match name {
        "stretch_along" => of_ct(&|p| Point3::new(p.x, p.y, middle.z + (p.z - middle.z) * (1.0 + size / 100.0))),
        "growth" => of_ct(&|p| middle + (p - middle) * (1.0 + size / 100.0)),
        "shear" => of_ct(&|p| Point3::new(p.x, p.y, p.z + size.to_radians() * (p.y - middle.y))),
        "camera_scale" => of_scan(&|p| camera + (p - camera) * (1.0 + size / 100.0)),
        "camera_depth" => {
            let view = (middle - camera).normalize();
            of_scan(&|p| p + view * (view.dot(&(p - camera)) * size / 100.0))
        }
        // A surface that is drawn outside of the bone is a scan inside of it.
        "offset" => of_scan(&|p| p - surface.closest_point(p).unwrap().normal * size),
        _ => unreachable!("{name}"),
    };
    for name in ["stretch_along", "growth", "shear", "camera_scale", "camera_depth", "offset"] {
        let critical = nuisance(&verdict, name).critical;
        let [more, less] = [critical, -critical].map(|size| times(name, size));
        println!("{name}: critical {critical:.2}: {more:.2} and {less:.2} times the limits");
        for ratio in [more, less] {
            assert!(
                (1.0 / 1.5..1.5).contains(&ratio),
                "{name}: at its critical size of {critical:.2} the refit is wrong {ratio:.2} times"
            );
        }
    }
}

#[test]
fn the_critical_size_of_a_growing_film_is_that_at_which_a_refit_is_wrong() {
    let scan = scan_of(&shaft(), HEIGHTS, 35);
    let (sound, verdict) = judged(&shaft(), &scan, &|p| *p);
    let film = nuisance(&verdict, "film_along");
    let (camera, surface) = (scan.viewpoint.unwrap() * Point3::origin(), MeshQuery::new(&shaft()));
    let times = |end_mm: f64| {
        let grown = |p: &Point3<f64>| {
            let closest = surface.closest_point(p).unwrap();
            let facing = closest.normal.dot(&(camera - p).normalize()).max(0.0);
            p + closest.normal * (end_mm * facing * (p.z - HEIGHTS[0]) / (HEIGHTS[1] - HEIGHTS[0]))
        };
        refitted(&shaft(), &displaced(&scan, grown), &|p| *p, &sound)
    };
    // Its ends are at 98 % of the scan, and whichever end it grows towards.
    let ratio = times(film.critical);
    assert!(
        (1.0 / 1.3..1.3).contains(&ratio),
        "at its critical size of {:.2} mm the refit is wrong {ratio:.2} times",
        film.critical
    );
}
