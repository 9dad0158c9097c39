//! Cuts of the own bone, the fragment between them and the errors of both.

use super::text::{digest, golden, line, motion, outcome, points};
use super::{BONE, TARGET};
use nalgebra::{Isometry3, Point3, Rotation3, Unit, UnitQuaternion, Vector3};
use osteoflow_algorithms::axes::{principal_axes, towards};
use osteoflow_algorithms::fragment::{Fragment, between, fragment};
use osteoflow_algorithms::landmarks::{RecipeParams, RulerErrors, ThirdFrom, paper_recipe, ruled};
use osteoflow_algorithms::metrics::{self, CutDifferenceParams, PlannedFragment, cut_difference, error_at_points};
use osteoflow_algorithms::section;
use osteoflow_algorithms::trust::{Answer, Limits, Reason, Verdict, VerdictScoreParams, verdict_score};
use osteoflow_geometry::{Anatomy, Axes, Mesh, NamedPoint, Plane, PlanePlace, Planes};
use std::collections::HashMap;
use std::sync::LazyLock;

/// The own bone with its corners joined, which the file repeats for each face.
static CLOSED: LazyLock<Mesh> = LazyLock::new(|| {
    let (mut places, mut vertices) = (HashMap::new(), Vec::new());
    let mut place = |corner: &Point3<f64>| {
        *places.entry(corner.coords.map(f64::to_bits)).or_insert_with(|| {
            vertices.push(*corner);
            vertices.len() as u32 - 1
        })
    };
    let corners = BONE.mesh.vertices();
    let faces: Vec<[u32; 3]> = BONE.mesh.faces().iter().map(|face| face.map(|v| place(&corners[v as usize]))).collect();
    Mesh::new("ct", BONE.mesh.origin, vertices, faces).unwrap()
});

/// A plane across the bone at a height above its tip, tilted about the lateral direction.
fn plane(name: &str, height_mm: f64, tilt_deg: f64) -> Plane {
    let across = Rotation3::rotation_between(&Vector3::z(), &BONE.proximal).unwrap();
    let tilt = UnitQuaternion::from_axis_angle(&Unit::new_normalize(BONE.lateral), tilt_deg.to_radians());
    let at = BONE.tip + BONE.proximal * height_mm;
    Plane::new(name, Isometry3::from_parts(at.coords.into(), tilt * UnitQuaternion::from_rotation_matrix(&across)))
}

fn planes(planes: &[Plane]) -> Planes {
    Planes::new("ct", planes.to_vec())
}

fn axes() -> Axes {
    towards(&principal_axes(&BONE.mesh), &BONE.proximal)
}

fn slip() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.6, -0.4, 0.9), Vector3::new(0.004, 0.009, -0.012))
}

fn shape(f: &Fragment) -> impl std::fmt::Debug {
    let faces: Vec<[f64; 3]> = f.mesh.faces().iter().map(|face| face.map(f64::from)).collect();
    let kinds = format!("{:?}", f.face_kinds);
    let n_walls = kinds.matches("Wall").count();
    (points(f.mesh.vertices()), digest(faces.iter()), n_walls, points(&f.rim()), f.mesh.volume_mm3())
}

#[test]
fn the_fragment_between_two_cuts_is_the_piece_it_was() {
    let mut text = String::new();
    let far = Plane::new("far", Isometry3::translation(0.0, 0.0, 900.0));
    let unknown = Plane { name: "lost".into(), place: PlanePlace::Unknown("the guide was not seen".into()) };
    for (name, cuts) in [
        ("straight", [plane("upper", 160.0, 0.0), plane("lower", 135.0, 0.0)]),
        ("tilted", [plane("lower", 135.0, 25.0), plane("upper", 160.0, -15.0)]),
        ("crossed", [plane("lower", 150.0, 40.0), plane("upper", 152.0, -40.0)]),
        ("one plane twice", [plane("lower", 150.0, 0.0), plane("upper", 150.0, 0.0)]),
        ("the end", [plane("lower", 2.0, 0.0), plane("upper", 30.0, 5.0)]),
        ("far", [plane("lower", 150.0, 0.0), far]),
        ("unknown", [plane("lower", 150.0, 0.0), unknown]),
    ] {
        let halves = between(&CLOSED, &planes(&cuts));
        text += &outcome(name, &halves);
        let Ok(halves) = halves else { continue };
        let heights = halves.each_ref().map(|half| half.moved(&slip()).height_mm(&BONE.tip));
        text += &line("    heights of the tip", &heights);
        text += &outcome("    fragment", &fragment(&CLOSED, &halves).as_ref().map(shape));
        let moved = halves.map(|half| half.moved(&slip()));
        text += &outcome("    slipped", &fragment(&CLOSED, &moved).as_ref().map(shape));
    }
    let open = between(&BONE.mesh, &planes(&[plane("lower", 135.0, 0.0), plane("upper", 160.0, 0.0)])).unwrap();
    text += &outcome("open", &fragment(&BONE.mesh, &open).as_ref().map(shape));
    text += &outcome("one plane", &between(&CLOSED, &planes(&[plane("only", 150.0, 0.0)])));
    for (height, tilt, reach) in
        [(150.0, 0.0, None), (150.0, 50.0, None), (150.0, 50.0, Some(4.0)), (150.0, 0.0, Some(0.1)), (-5.0, 0.0, None)]
    {
        let t = *plane("", height, tilt).isometry().unwrap();
        text += &line(format!("section {height} {tilt} {reach:?}"), &section::middle(&BONE.mesh, &t, reach));
    }
    golden("fragment", &text);
}

#[test]
fn a_slipped_cut_has_the_errors_it_had() {
    let plan = planes(&[plane("lower", 135.0, 10.0), plane("upper", 160.0, -15.0)]);
    let params = CutDifferenceParams { spacing_mm: 1.5, n_samples: 300 };
    let paper = Isometry3::new(Vector3::new(0.5, -0.5, 0.7), Vector3::new(0.0, 0.01, -0.01));
    let mut text = String::new();
    for measured in [Ok(paper), Err("no model of the cut bone".to_owned())] {
        text += &outcome("cut difference", &cut_difference(&CLOSED, &plan, &slip(), measured, &params));
    }
    let planned = PlannedFragment::new(&CLOSED, &plan, &params).unwrap();
    text += &line("planned", &(shape(planned.fragment()), planned.middle()));
    text += &outcome("executed", &planned.executed(&slip()).as_ref().map(shape));
    text += &outcome("beside the bone", &planned.against(&Isometry3::translation(0.0, 0.0, 400.0)));
    let achieved = plan.transformed("ct", &slip());
    for bone in [None, Some(&BONE.mesh)] {
        text += &outcome("cuts", &metrics::cuts(&plan, &achieved, &axes(), bone));
    }
    let lost = planes(&[plane("lower", 135.0, 10.0)]);
    text += &outcome("one cut", &metrics::cuts(&plan, &lost, &axes(), None));
    text += &outcome("unknown", &metrics::cuts(&plan, &plan.unknown("ct", 0, "not seen"), &axes(), None));
    text += &outcome("no plan", &metrics::cuts(&planes(&[]), &plan, &axes(), None));
    golden("cut_difference", &text);
}

fn named(names: &[&str], positions: &[[f64; 3]]) -> Vec<NamedPoint> {
    let point = |(name, at): (&&str, &[f64; 3])| NamedPoint::new(*name, Point3::from(*at));
    names.iter().zip(positions).map(point).collect()
}

#[test]
fn points_and_surfaces_have_the_errors_they_had() {
    let names = ["a_1", "a_2", "a_3", "a_4"];
    let target = named(&names, &[[1.0, 2.0, 3.0], [10.0, -4.0, 20.0], [-7.0, 5.0, 90.0], [2.0, 2.0, 40.0]]);
    let mut source = named(&names, &[[1.2, 2.1, 2.0], [10.3, -4.0, 20.6], [-7.1, 5.5, 90.2], [2.4, 1.8, 39.7]]);
    for (k, p) in source.iter_mut().enumerate() {
        p.stamp_ns = [5, 9, 3, 7][k];
    }
    let axes = axes();
    let mut text = line("axes", &(principal_axes(&BONE.mesh), &axes));
    text += &outcome("tre", &metrics::tre(&target, &source, &slip(), &axes));
    text += &outcome("tre of one", &metrics::tre(&target[..1], &source[..1], &slip(), &axes));
    text += &outcome("tre unpaired", &metrics::tre(&target, &source[1..], &slip(), &axes));
    text += &outcome("tre of none", &metrics::tre(&[], &source, &slip(), &axes));
    text += &outcome("fre", &metrics::fre(&target, &source, &slip()));
    text += &outcome("fre of none", &metrics::fre(&[], &[], &slip()));
    text += &outcome("fre unpaired", &metrics::fre(&target, &target[..1], &slip()));
    text += &outcome("laser spot", &metrics::laser_spot(&source[1..3], &target, &source, &slip(), &axes));
    text += &outcome("no mark", &metrics::laser_spot(&source[..2], &target, &source[1..], &slip(), &axes));
    text += &outcome("no spot", &metrics::laser_spot(&source[..2], &target[1..], &source, &slip(), &axes));
    text += &outcome("check points", &metrics::check_points(&source, &target, &slip(), Some(&slip())));
    text += &outcome("one check point", &metrics::check_points(&source[..1], &target[..1], &slip(), None));
    text += &outcome("no check point", &metrics::check_points(&[], &[], &slip(), None));
    text += &line("pose error", &metrics::pose_error(&slip(), &Point3::new(10.0, 20.0, -30.0)));
    text += &outcome("error at points", &error_at_points(&target, &source, &slip()).map(|t| motion(&t)));
    text += &outcome("at two points", &error_at_points(&target[..2], &source[..2], &slip()).map(|t| motion(&t)));
    let scan = BONE.scan(&BONE.camera(150.0), [130.0, 170.0], 2.0, &crate::common::USUAL, None, 3);
    for mm in [0.3, 1.0, 5.0] {
        text += &outcome(format!("surface {mm}"), &metrics::surface_residual(&TARGET, scan.points(), &slip(), mm));
    }
    text += &outcome("surface far", &metrics::surface_residual(&TARGET, &[Point3::origin()], &slip(), 1.0));
    text += &outcome("surface of none", &metrics::surface_residual(&TARGET, &[], &slip(), 1.0));
    let moved: Vec<Point3<f64>> = scan.points().iter().step_by(40).map(|p| slip() * p).collect();
    text += &line("signed distances", &metrics::signed_distances(&moved, &BONE.query));
    golden("metrics", &text);
}

#[test]
fn a_verdict_is_scored_as_it_was() {
    let names = ["M1", "M2"];
    let target = named(&names, &[[0.0, 0.0, 0.0], [10.0, 0.0, 50.0]]);
    let plan = planes(&[plane("lower", 135.0, 10.0), plane("upper", 160.0, -15.0)]);
    let mut text = String::new();
    for mm in [0.1, 1.5, 2.0] {
        let source = named(&names, &[[mm, 0.0, 0.0], [10.0, mm, 50.0]]);
        let tre = metrics::tre(&target, &source, &Isometry3::identity(), &axes()).unwrap();
        let shift = Isometry3::translation(0.0, 0.1, 0.2 * mm);
        let cuts = metrics::cuts(&plan, &plan.transformed("ct", &shift), &axes(), None).unwrap();
        for reasons in [
            vec![],
            vec![
                Reason::new("weak", Answer::Doubtful, "one", "two"),
                Reason::new("off", Answer::Refused, "three", "four"),
            ],
        ] {
            let verdict = Verdict::new(reasons, vec![], None, None, vec![]);
            for params in [
                VerdictScoreParams::default(),
                VerdictScoreParams { is_sound: false, ..VerdictScoreParams::default() },
                VerdictScoreParams {
                    limits: Limits { max_tre_mm: 9.0, max_offset_mm: 0.3, max_tilt_deg: 0.5 },
                    is_sound: true,
                },
            ] {
                text += &line(mm, &verdict_score(&verdict, &tre, &cuts, &[0.3, 0.5], &params));
            }
        }
    }
    golden("verdict_score", &text);
}

#[test]
fn landmarks_lie_where_they_did() {
    let anatomy = Anatomy {
        malleolus_tip: BONE.tip,
        proximal: Unit::new_normalize(BONE.proximal),
        lateral: Unit::new_normalize(BONE.lateral),
        posterior: Unit::new_normalize(BONE.posterior),
    };
    let mut text = String::new();
    let planned = paper_recipe(&BONE.query, &anatomy, &RecipeParams::default());
    text += &outcome("recipe", &planned);
    let high = RecipeParams { p1_from_tip_mm: 330.0, ..RecipeParams::default() };
    text += &outcome("above the bone", &paper_recipe(&BONE.query, &anatomy, &high));
    let skew = Anatomy { lateral: Unit::new_normalize(BONE.lateral + BONE.proximal), ..anatomy.clone() };
    text += &outcome("skew", &paper_recipe(&BONE.query, &skew, &RecipeParams::default()));
    for along in [
        Anatomy { lateral: anatomy.proximal, ..anatomy.clone() },
        Anatomy { posterior: anatomy.proximal, ..anatomy.clone() },
    ] {
        text += &outcome("along the bone", &paper_recipe(&BONE.query, &along, &RecipeParams::default()));
    }
    let planned = planned.unwrap();
    let usual = RulerErrors { first_mm: 2.0, second_mm: -1.0, third_mm: 0.5, across_mm: 1.5, ..RulerErrors::default() };
    for third_from in [ThirdFrom::First, ThirdFrom::Second] {
        for on_surface in [true, false] {
            let errors = RulerErrors { third_from, on_surface, ..usual.clone() };
            text += &outcome(
                format!("{third_from:?} {on_surface}"),
                &ruled(&BONE.query, &planned, &anatomy.proximal, &errors),
            );
        }
    }
    let far = RulerErrors { across_mm: 40.0, ..usual.clone() };
    text += &outcome("far across", &ruled(&BONE.query, &planned, &anatomy.proximal, &far));
    text += &outcome("two", &ruled(&BONE.query, &planned[..2], &anatomy.proximal, &usual));
    golden("landmarks", &text);
}
