//! What may be wrong beside the pose: measured, bounded, or an assumption with its critical size.

use super::*;
use crate::icp::{self, IcpParams, Method};
use crate::still_average::{Carries, MarkerPath, TakeMotion, TakeTime};
use crate::trust::cut::{Displaced, planned_cuts};
use osteoflow_geometry::Planes;
use rand::RngExt;
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
        let estimate = stretch.estimate;
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
fn a_sound_scan_bounds_what_it_shows_and_leaves_the_rest_as_assumptions_with_sizes() {
    let (_, verdict) = judged(&shaft(), &scan_of(&shaft(), HEIGHTS, 32), &|p| *p);
    assert_eq!(verdict.answer, Answer::Trusted, "{:?}", verdict.reasons);
    for (name, state) in [
        ("stretch_along", NuisanceState::Bounded),
        ("growth", NuisanceState::Bounded),
        ("offset", NuisanceState::Bounded),
        ("shear", NuisanceState::Unseen),
        ("film_along", NuisanceState::Unseen),
        ("camera_scale", NuisanceState::Unseen),
        ("plan", NuisanceState::Unseen),
    ] {
        assert_eq!(nuisance(&verdict, name).state, state, "{name}");
    }
    // Each unseen cause is told once, with its critical size, beside what shows it.
    for unseen in verdict.nuisances.iter().filter(|n| n.state == NuisanceState::Unseen) {
        let digits = if unseen.critical < 1.0 { 2 } else { 1 };
        let size = format!("{:.digits$} {}", unseen.critical, unseen.unit);
        let is_told =
            |text: &String| ["more than ", "above "].iter().any(|word| text.contains(&format!("{word}{size}")));
        assert!(verdict.assumptions.iter().any(is_told), "{unseen:?}: {:?}", verdict.assumptions);
    }
}

#[test]
fn what_is_printed_of_a_cause_can_be_checked_from_what_is_printed() {
    let limits = Limits::default();
    let to = stretched(5.0);
    let scan = scan_of(&shaft(), HEIGHTS, 32);
    for verdict in [judged(&shaft(), &scan, &|p| *p).1, judged(&moved(&shaft(), &to), &scan, &to).1] {
        for n in verdict.nuisances.iter().filter(|n| n.state != NuisanceState::Measured) {
            // The effect is that of the largest size that is likely, which is measured from the estimate on and not from zero.
            let likely = (n.estimate.abs() + 1.645 * n.sd) / n.critical;
            let times = limits.times(n.effect_mm, n.effect_mm, n.effect_deg);
            assert!((times / likely - 1.0).abs() < 1e-6, "{n:?}");
            assert!((0.0..=1.0).contains(&n.chance) && n.sd <= 1.0001 * n.prior, "{n:?}");
        }
        let predicted = verdict.predicted.unwrap();
        let most = verdict.nuisances.iter().map(|n| n.chance).fold(0.0, f64::max);
        assert!(predicted.beyond_limits > 0.5 * most, "{} of all, {most} of one", predicted.beyond_limits);
    }
}

#[test]
fn a_scan_that_says_nothing_of_a_cause_leaves_its_prior() {
    let (_, verdict) = judged(&shaft(), &scan_of(&shaft(), [50.0, 61.0], 35), &|p| *p);
    for name in ["stretch_along", "growth", "shear", "film", "camera_scale", "plan"] {
        let n = nuisance(&verdict, name);
        assert!(n.sd > 0.9 * n.prior && n.estimate.abs() < 0.3 * n.prior && n.chance > 0.0, "{n:?}");
    }
    assert_ne!(verdict.answer, Answer::Trusted);
}

#[test]
fn a_large_deformation_is_told_however_harmless_it_is() {
    let to = stretched(9.0);
    let target = target_of(&moved(&shaft(), &to));
    let scan = scan_of(&shaft(), HEIGHTS, 37);
    let (pose, _) = judged(&moved(&shaft(), &to), &scan, &to);
    let (points, planes) = plan(&to);
    let case = Case { assessment: &points, planes: Some(&planes), ..bare(&target, &scan, &pose) };
    let wide = Limits { max_tre_mm: 20.0, max_offset_mm: 20.0, max_tilt_deg: 20.0 };
    let rules = RuleParams { limits: wide, ..RuleParams::default() };
    let verdict = judge(&case, &EvidenceParams::default(), &rules, &PredictParams::default());
    assert_eq!(verdict.answer, Answer::Trusted, "{:?}", verdict.reasons);
    let told = verdict.assumptions.iter().find(|text| text.contains("% too long along the bone")).unwrap();
    assert!(told.contains(", which the answer bears; "), "{told}");
}

#[test]
fn cuts_beyond_the_scan_take_the_bone_there_for_granted_with_their_distance() {
    let of = |heights: [f64; 2]| judged(&shaft(), &scan_of(&shaft(), heights, 32), &|p| *p).1;
    let (beside, beyond) = (of(HEIGHTS), of([15.0, 70.0]));
    let has = |verdict: &Verdict| verdict.nuisances.iter().any(|n| n.name == "beyond");
    assert!(!has(&beside) && has(&beyond));
    let told = beyond.assumptions.iter().find(|text| text.contains("beyond the scan, where cuts lie")).unwrap();
    let mm: f64 = told.split("also ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    // The cut at 80 mm, and the end of the scan at 70 mm but for the 2 % beyond what counts as its end.
    assert!((8.0..14.0).contains(&mm), "{told}");
    let upper = |verdict: &Verdict| verdict.predicted.as_ref().unwrap().cuts[1].interval_mm[1];
    assert!(upper(&beyond) > upper(&beside));
}

#[test]
fn maps_and_fields_of_no_name_are_told_as_their_families() {
    let scan = scan_of(&shaft(), HEIGHTS, 38);
    let is_told = |rules: &[&str], among: &[&str]| rules.first().is_some_and(|first| among.contains(first));
    // An oblique reformat with a spacing that is 8 % too large in one direction.
    let oblique = Vector3::new(0.5, 0.5, 1.0).normalize();
    let to = |p: &Point3<f64>| p + oblique * (0.08 * oblique.dot(&(p - Point3::new(0.0, 0.0, MIDDLE))));
    let (_, verdict) = judged(&moved(&shaft(), to), &scan, &to);
    assert!(is_told(&rules(&verdict), &["affine", "stretch_along", "shear"]), "{:?}", verdict.reasons);
    // 3 mm of bone that are taken out.
    let to = |p: &Point3<f64>| if p.z > 55.0 { p - Vector3::z() * 3.0 } else { *p };
    let (_, verdict) = judged(&moved(&shaft(), to), &scan, &to);
    assert!(is_told(&rules(&verdict), &["step", "stretch_along"]), "{:?}", verdict.reasons);
    // A threshold that drifts along the bone and differs around it.
    let surface = MeshQuery::new(&shaft());
    let drifting = displaced(&scan, |p| {
        let normal = surface.closest_point(p).unwrap().normal;
        p + normal * (1.2 * ((p.z - MIDDLE) / 15.0).sin() * normal.y)
    });
    let (_, verdict) = judged(&shaft(), &drifting, &|p| *p);
    assert_ne!(verdict.answer, Answer::Trusted, "{:?}", verdict.nuisances);
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
    assert!((scale.estimate + 3.0).abs() < 0.7, "within its standard deviation: {scale:?}");
    // That of 200 mm.
    assert!((scale.effect_mm + 2.0 * scale.estimate).abs() < 0.3, "{scale:?}");
}

#[test]
fn a_wounds_edge_beside_the_bone_is_no_deformation_of_it() {
    for (from, top_mm) in [(0.5, 1.0), (0.7, 1.0), (0.5, 8.0), (0.7, 8.0)] {
        let scan = scan_of(&shaft(), HEIGHTS, 41);
        let mut rng = ChaCha8Rng::seed_from_u64(41);
        // On one side tissue lies on the bone, most of it low.
        let risen = |p: &Point3<f64>| {
            let out = Vector3::new(p.x - 0.0005 * p.z * p.z, p.y, 0.0).normalize();
            let height_mm = top_mm * rng.random::<f64>().powi(2);
            if out.y > from { p + out * height_mm } else { *p }
        };
        let points: Vec<Point3<f64>> = scan.points().iter().map(risen).collect();
        let scan = Cloud::new("scan", points).unwrap().seen_from(scan.viewpoint.unwrap());
        let (_, verdict) = judged(&shaft(), &scan, &|p| *p);
        assert_eq!(verdict.answer, Answer::Trusted, "{from}, {top_mm} mm: {:?}", verdict.reasons);
    }
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
    assert!((step.estimate - 1.5).abs() < 0.3, "{step:?}");
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

/// How the camera's marker is, from the time of a scan.
type Pose = dyn Fn(f64) -> Isometry3<f64>;

/// A steady motion of the camera, about a marker 200 mm beside the bone.
fn steady(shift_mm_s: Vector3<f64>, turn_rad_s: Vector3<f64>) -> impl Fn(f64) -> Isometry3<f64> {
    let marker = nalgebra::Translation3::new(200.0, 0.0, MIDDLE);
    move |s| marker * Isometry3::new(shift_mm_s * s, turn_rad_s * s) * marker.inverse()
}

/// A take of a scan, with the poses of 2 s on either side of it.
fn take(camera: &Pose, time: Option<TakeTime>) -> TakeMotion {
    let marker = Isometry3::translation(200.0, 0.0, MIDDLE);
    let sample = |k: i64| (k * 50_000_000, camera(k as f64 / 20.0) * marker);
    let path = MarkerPath::of(&(-40..=40).map(sample).collect::<Vec<_>>());
    TakeMotion { time, ..TakeMotion::new("scan") }.during("camera", Carries::Data, 0, Some(&path))
}

fn of_2_s(middle_s: Option<f64>) -> TakeTime {
    TakeTime { duration_s: 2.0, middle_s, undone: Vec::new() }
}

/// The scan of a camera that moves, whose points are carried by its pose at the stamp; `at_s` has the time of a point.
fn smeared(scan: &Cloud, camera: &Pose, at_s: impl Fn(&Point3<f64>) -> f64) -> Cloud {
    displaced(scan, |p| camera(at_s(p)).inverse() * p)
}

/// The verdict on a registered scan with a take.
fn judged_take(scan: &Cloud, take: &TakeMotion) -> Verdict {
    let target = target_of(&shaft());
    let observer = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
    let start = Isometry3::identity();
    let fit = icp::register(Method::PointToPlane, &target, scan, &start, &IcpParams::default(), observer).unwrap();
    let (points, planes) = plan(&|p| *p);
    let takes = Takes { scan: Some(take), ..Takes::default() };
    let case = Case { assessment: &points, planes: Some(&planes), takes, ..bare(&target, scan, &fit.t_target_source) };
    judge(&case, &EvidenceParams::default(), &RuleParams::default(), &PredictParams::default())
}

/// The effect in the verdict's rule, for limits that any motion exceeds: (mm, degrees).
fn told(verdict: &Verdict) -> Option<(f64, f64)> {
    let reason = verdict.reasons.iter().find(|reason| reason.rule == "smeared")?;
    let text = reason.reason.split("puts the answer up to ").nth(1)?;
    let numbers: Vec<f64> = text.split(' ').filter_map(|word| word.parse().ok()).collect();
    Some((numbers[0], numbers[1]))
}

#[test]
fn the_effect_of_a_motion_is_that_of_a_refit_for_the_worst_way_to_sweep() {
    let scan = scan_of(&shaft(), HEIGHTS, 37);
    let (sound, _) = judged(&shaft(), &scan, &|p| *p);
    let share = |p: &Point3<f64>| (p.z - MIDDLE) / (HEIGHTS[1] - HEIGHTS[0]);
    let (width, nothing) = (24.0, Vector3::zeros());
    for (shift, turn) in [
        (Vector3::new(1.0, 0.0, 0.0), nothing),
        (Vector3::new(0.0, 1.0, 0.0), nothing),
        (Vector3::new(0.0, 0.0, 3.0), nothing),
        (nothing, Vector3::new(0.0, 0.0, 0.006)),
        (Vector3::new(0.5, -0.4, 1.0), Vector3::new(0.004, -0.003, 0.002)),
    ] {
        let camera = steady(shift, turn);
        let of = |middle_s: Option<f64>| {
            let rules = RuleParams { max_beyond_limits: 0.0, ..RuleParams::default() };
            let target = target_of(&shaft());
            let (points, planes) = plan(&|p| *p);
            let take = take(&camera, Some(of_2_s(middle_s)));
            let takes = Takes { scan: Some(&take), ..Takes::default() };
            let case = Case { assessment: &points, planes: Some(&planes), takes, ..bare(&target, &scan, &sound) };
            let verdict = judge(&case, &EvidenceParams::default(), &rules, &PredictParams::default());
            let (mm, deg) = told(&verdict).unwrap_or_else(|| panic!("{:?}", verdict.reasons));
            Limits::default().times(mm, mm, deg)
        };
        let off =
            |at_s: &dyn Fn(&Point3<f64>) -> f64| refitted(&shaft(), &smeared(&scan, &camera, at_s), &|p| *p, &sound);
        let along = [2.0, -2.0].map(|s| off(&|p| s * share(p)));
        let across = [2.0, -2.0].map(|s| off(&|p| s * (p.y / width).clamp(-0.5, 0.5)));
        let worst = along.into_iter().chain(across).fold(0.0, f64::max);
        let predicted = of(Some(0.0));
        println!("{shift:?} {turn:?}: {predicted:.2}, refitted {along:.2?} and {across:.2?}");
        assert!((0.7..1.6).contains(&(predicted / worst)), "{predicted:.2} times the limits, {worst:.2} refitted");
        // A stamp at the end is a motion of all points, which nothing undoes.
        let ended = off(&|_| -1.0);
        let predicted = of(Some(-1.0));
        assert!(predicted > 0.85 * ended.max(worst), "{predicted:.2} times, {ended:.2} of a stamp at the end");
        assert!(of(None) > 0.85 * ended.max(worst), "where it is not known, the worst");
    }
}

#[test]
fn a_slow_sweep_is_told_with_its_cause_and_one_with_points_of_their_own_times_is_not() {
    let scan = scan_of(&shaft(), HEIGHTS, 38);
    let camera = steady(Vector3::new(0.8, 0.6, 0.0), Vector3::zeros());
    let swept = smeared(&scan, &camera, |p| 2.0 * (p.z - MIDDLE) / (HEIGHTS[1] - HEIGHTS[0]));
    for time in [None, Some(of_2_s(None)), Some(of_2_s(Some(0.0)))] {
        let verdict = judged_take(&swept, &take(&camera, time.clone()));
        assert_eq!(rules(&verdict), ["smeared"], "{time:?}: {:?}", verdict.reasons);
        let text = &verdict.reasons[0].reason;
        assert!(text.starts_with("the camera marker moved the bone in the camera by 2.0 mm over "), "{text}");
        let said = if time.is_none() { "2.0 s, which it is assumed to take" } else { "the 2.0 s of the scan" };
        assert!(text.contains(said), "{text}");
        let terms = verdict.predicted.unwrap().terms;
        assert!(terms.iter().any(|term| term.name == "motion during the scan" && term.tre_mm > 0.3), "{terms:?}");
    }
    let undone = TakeTime { undone: vec!["camera".into()], ..of_2_s(Some(0.0)) };
    assert_eq!(judged_take(&scan, &take(&camera, Some(undone))).answer, Answer::Trusted);
    let instant = TakeTime { duration_s: 0.05, ..of_2_s(None) };
    assert_eq!(judged_take(&scan, &take(&camera, Some(instant))).answer, Answer::Trusted);
}

#[test]
fn a_motion_that_would_matter_if_it_were_larger_is_an_assumption_with_its_critical_size() {
    let scan = scan_of(&shaft(), HEIGHTS, 39);
    let camera = steady(Vector3::new(0.12, 0.09, 0.0), Vector3::zeros());
    let verdict = judged_take(&scan, &take(&camera, Some(of_2_s(Some(0.0)))));
    assert_eq!(verdict.answer, Answer::Trusted, "{:?}", verdict.reasons);
    let said = verdict.assumptions.iter().find(|text| text.starts_with("the camera marker moved the bone")).unwrap();
    let critical: f64 = said.split("a motion of ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    // 0.5 degrees over 90 mm are 0.8 mm, and the ends of the scan count more.
    assert!((0.6..1.1).contains(&critical), "{said}");
    let rest = judged_take(&scan, &take(&steady(Vector3::zeros(), Vector3::zeros()), None));
    let of_motion =
        |verdict: &Verdict| verdict.assumptions.iter().filter(|text| text.contains("in the camera")).count();
    assert_eq!((of_motion(&verdict), of_motion(&rest)), (1, 0));
    let without = judged_take(&scan, &TakeMotion::new("scan"));
    assert_eq!(rest, without, "markers at rest change nothing");
}

#[test]
fn a_bone_and_a_camera_that_are_carried_together_shear_nothing() {
    let scan = scan_of(&shaft(), HEIGHTS, 40);
    let camera = steady(Vector3::new(3.0, -4.0, 2.0), Vector3::new(0.01, 0.02, 0.01));
    let marker = Isometry3::translation(200.0, 0.0, MIDDLE);
    let path = |of: &dyn Fn(f64) -> Isometry3<f64>| {
        MarkerPath::of(&(-40..=40).map(|k| (k * 50_000_000, of(k as f64 / 20.0) * marker)).collect::<Vec<_>>())
    };
    let take = TakeMotion { time: Some(of_2_s(Some(0.0))), ..TakeMotion::new("scan") };
    let take = take.during("camera", Carries::Data, 0, Some(&path(&camera)));
    let alone = judged_take(&scan, &take);
    let together = judged_take(&scan, &take.during("bone", Carries::Frame, 0, Some(&path(&camera))));
    assert_eq!((rules(&alone), together.answer), (vec!["smeared"], Answer::Trusted));
    assert!(!together.assumptions.iter().any(|text| text.contains("bone in the camera")));
}

#[test]
fn a_camera_that_goes_and_comes_back_during_the_scan_is_told() {
    let scan = scan_of(&shaft(), HEIGHTS, 41);
    let there_and_back = |s: f64| Isometry3::translation(0.0, 2.0 * (1.0 - s.abs()), 0.0);
    let verdict = judged_take(&scan, &take(&there_and_back, Some(of_2_s(Some(0.0)))));
    assert_eq!(rules(&verdict), ["smeared"], "{:?}", verdict.reasons);
}
