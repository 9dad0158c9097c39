//! Whole verdicts, and evidence whose numbers are known.

use super::*;
use crate::metrics::check_points;
use serde_json::Value;

/// Numbers to five digits: a registration settles to as many on any machine.
fn rounded(value: &mut Value) {
    match value {
        Value::Number(number) if number.is_f64() => {
            let x = number.as_f64().filter(|x| x.abs() > 1e-6).unwrap_or(0.0);
            *value = format!("{x:.4e}").parse::<f64>().unwrap().into();
        }
        Value::Array(all) => all.iter_mut().for_each(rounded),
        Value::Object(all) => all.values_mut().for_each(rounded),
        _ => {}
    }
}

fn text(verdict: &Verdict) -> String {
    let mut value = serde_json::to_value(verdict).unwrap();
    // Axes have an arbitrary sign.
    for key in ["points", "cuts"] {
        let points = value["predicted"].get_mut(key).and_then(Value::as_array_mut);
        points.into_iter().flatten().for_each(|point| drop(point.as_object_mut().unwrap().remove("directions")));
    }
    rounded(&mut value);
    serde_json::to_string_pretty(&value).unwrap()
}

#[test]
fn a_verdict_has_the_same_text_and_numbers_as_ever() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 21));
    let (landmarks, located) = (marks(), marks());
    let plane = |name: &str, x: f64, z: f64| Plane::new(name, Isometry3::translation(x, 0.0, z));
    let planes = Planes::new("ct", vec![plane("a", 0.0, 70.0), plane("b", 0.0, 90.0), plane("off", 900.0, 300.0)]);
    let tracking = Tracking {
        camera_marker: Point3::new(210.0, 0.0, 60.0),
        phantom_marker: Some(Point3::new(20.0, 30.0, 60.0)),
        phantom_fit: None,
    };
    // Rests short of where it fits, so that every quantity differs from zero.
    let pose = Isometry3::new(Vector3::new(0.1, -0.05, 2.2), Vector3::new(0.0, 0.002, 0.02));
    let case = Case {
        landmarks: &landmarks,
        located: &located,
        assessment: &landmarks,
        planes: Some(&planes),
        is_calibrated: true,
        tracking: Some(&tracking),
        ..bare(&target, &scan, &pose)
    };
    let always = EvidenceParams { mirror: When::Always, ..EvidenceParams::default() };
    let judged = |case: &Case<'_>| judge(case, &always, &RuleParams::default(), &PredictParams::default());
    golden("verdict.txt", &text(&judged(&case)));
    // Neither points nor cuts: the error at the scan's own points is judged, and not told.
    let alone = bare(&target, &scan, &pose);
    golden("verdict_of_a_scan_alone.txt", &text(&judged(&alone)));
}

#[test]
fn the_mirror_image_is_not_tried_without_a_sign_or_where_it_is_not_wanted() {
    let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 2));
    let slid = Isometry3::translation(0.0, 0.0, 10.0);
    let right = Isometry3::identity();
    let is_tried = |pose: &Isometry3<f64>, mirror: When| {
        let case = bare(&target, &scan, pose);
        let examine = EvidenceParams { mirror, ..EvidenceParams::default() };
        let verdict = judge(&case, &examine, &RuleParams::default(), &PredictParams::default());
        verdict.measured.unwrap().shape.unwrap().mirrored_support.is_some()
    };
    assert!(!is_tried(&right, When::IfRaised) && !is_tried(&slid, When::Never));
}

#[test]
fn what_is_taken_for_granted_depends_on_what_is_known() {
    // A surface without normals cannot be examined.
    let target = Target::new("ct", SurfaceOrigin::User, shaft().vertices().to_vec(), None).unwrap();
    let scan = Cloud::new("scan", vec![Point3::origin(); 3]).unwrap();
    let pose = Isometry3::identity();
    let tracking = Tracking { camera_marker: Point3::origin(), phantom_marker: None, phantom_fit: None };
    let piece = [NamedPoint::new("working_1", Point3::origin())];
    let check = [check_points(&piece, &piece, &pose, None).unwrap()];
    let bare = bare(&target, &scan, &pose);
    let first_words = |case: &Case<'_>| -> Vec<String> {
        let verdict = judge(case, &EvidenceParams::default(), &RuleParams::default(), &PredictParams::default());
        assert_eq!((verdict.predicted, verdict.measured), (None, None));
        verdict.assumptions.iter().map(|words| words.split(' ').take(3).collect::<Vec<_>>().join(" ")).collect()
    };
    let (plan, camera, ended) = ("no plan or", "the scan does", "the registration converged;");
    assert_eq!(first_words(&bare), ["the CT shows", plan, camera, ended, "no point on"]);
    let measured = Case { measured_tre_mm: Some(0.5), ..bare.clone() };
    assert_eq!(first_words(&measured), ["the CT shows", plan, camera, ended]);
    let planned = Case { assessment: &piece, assumptions: &["the threshold was suggested"], ..bare.clone() };
    assert_eq!(first_words(&planned), ["the CT shows", "the threshold was", camera, ended, "no point on"]);
    let converged = Convergence { converged: Some(true), ..Convergence::default() };
    let seen = scan.clone().seen_from(pose);
    let registered = Registered { source: &seen, ..bare.registered };
    assert_eq!(
        first_words(&Case { icp: Some(&converged), registered, ..bare.clone() }),
        ["the CT shows", plan, "no point on"]
    );
    let tracked = Case { tracking: Some(&tracking), measured_tre_mm: Some(0.5), icp: Some(&converged), ..bare };
    assert_eq!(first_words(&tracked), ["the camera marker", "the bone marker", "the CT shows", camera]);
    assert_eq!(first_words(&Case { check: &check, ..tracked }), ["the bone marker", "the CT shows", camera]);
}

#[test]
fn the_shares_and_quantiles_of_bands_above_a_plane_are_known() {
    let grid = |k: u32| Point3::new(f64::from(k / 20), f64::from(k % 20), 0.0);
    let points: Vec<Point3<f64>> = (0..320 * 20).map(grid).collect();
    let normals = vec![Vector3::z(); points.len()];
    let cloud = Target::new("ct", SurfaceOrigin::Exact, points, Some(normals.into())).unwrap();
    let corners = [[0.0, 0.0], [319.0, 0.0], [319.0, 19.0], [0.0, 19.0]].map(|[x, y]| Point3::new(x, y, 0.0));
    let mesh = Mesh::new("ct", SurfaceOrigin::Exact, corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let target = cloud.clone().with_mesh(MeshQuery::new(&mesh));
    // Bands of 49 points over samples of the plane, far enough apart that each has its own neighbours.
    let heights = [0.0, 0.0, -0.3, 0.3, 0.3, -4.6, -5.1, 2.3, 2.6];
    let band =
        |i: u32, z: f64| (0..49).map(move |k| Point3::new(f64::from(8 + 32 * i + k / 7), f64::from(4 + k % 7), z));
    let scan: Vec<Point3<f64>> = (0..).zip(heights).flat_map(|(i, z)| band(i, z)).collect();
    let examined_on = |target: &Target, camera: Option<Point3<f64>>| {
        let cloud = Cloud::new("scan", scan.clone()).unwrap();
        let cloud = camera.into_iter().fold(cloud, |cloud, p| cloud.seen_from(Isometry3::translation(p.x, p.y, p.z)));
        let pose = Isometry3::identity();
        let registered = Registered { target, source: &cloud, t_target_source: &pose, at: &[] };
        let params = EvidenceParams { shape: false, mirror: When::Never };
        Evidence::examine(&registered, &params, None).unwrap().evidence
    };
    let examined = |camera| examined_on(&target, camera);
    let evidence = examined(None);
    assert!(evidence.noise_mm < 1e-9, "a plane: {}", evidence.noise_mm);
    assert_eq!((evidence.median_mm, evidence.p90_mm), (0.3, Some(5.1)));
    // A quarter of the distances is at most 0.3 mm, so the robust standard deviation is 0.94 mm: -4.71 to 2.35 mm are on the
    // surface, and 0.3 mm is neither inside nor outside.
    assert_eq!(evidence.on_surface, 7.0 / 9.0);
    assert_eq!(evidence.inside, 2.0 / 9.0);
    assert!((evidence.outside - 2.0 / 9.0).abs() < 1e-12, "{}", evidence.outside);
    assert_eq!((evidence.facing_away, evidence.shape), (None, None));
    // A camera in the plane sees the points at and below it: the three of seven bands above have turned away.
    let camera = |z: f64| examined(Some(Point3::new(150.0, 8.0, z))).facing_away.unwrap();
    assert_eq!((camera(100.0), camera(-100.0)), (0.0, 1.0));
    assert_eq!(camera(0.0), 3.0 / 7.0);
    // Without faces the side of a sheet may have been guessed, and the smaller part counts.
    let of_cloud = |z: f64| examined_on(&cloud, Some(Point3::new(150.0, 8.0, z))).facing_away.unwrap();
    assert_eq!((of_cloud(100.0), of_cloud(-100.0), of_cloud(0.0)), (0.0, 0.0, 3.0 / 7.0));
    // An open surface has no inside.
    assert_eq!((evidence.misfit.inward_mm, evidence.inside_patches.share), (0.0, 0.0));
}

#[test]
fn the_points_that_matter_are_the_assessed_ones_or_else_about_fifty_of_the_scan() {
    let (target, pose) = (target_of(&shaft()), Isometry3::translation(1.0, 2.0, 3.0));
    let scan =
        Cloud::new("scan", (0..120_u8).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect::<Vec<_>>()).unwrap();
    let at = [Point3::new(9.0, 8.0, 7.0)];
    let registered = Registered { target: &target, source: &scan, t_target_source: &pose, at: &[] };
    let points = evidence::points_that_matter(&registered);
    assert_eq!((points.len(), points[1]), (60, Point3::new(3.0, 2.0, 3.0)));
    assert_eq!(evidence::points_that_matter(&Registered { at: &at, ..registered }), at);
    let few = Cloud::new("scan", vec![Point3::origin(); 3]).unwrap();
    assert_eq!(evidence::points_that_matter(&Registered { source: &few, ..registered }).len(), 3);
}
