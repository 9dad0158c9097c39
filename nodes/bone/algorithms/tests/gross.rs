//! What is named first where scan and surface are of different bones, or one is mirrored.

use crate::common::{Bone, USUAL, bones, own_bone};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::coarse::{GlobalParams, global};
use osteoflow_algorithms::icp::{self, IcpParams, Method};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::sample;
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{self, Answer, Case, EvidenceParams, PredictParams, Registered, RuleParams, Verdict};
use osteoflow_geometry::{Cloud, Mesh, NamedPoint, SurfaceOrigin};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use std::ops::ControlFlow;

fn target_of(mesh: &Mesh) -> Target {
    let samples = sample::surface(mesh, 100_000, &mut ChaCha8Rng::seed_from_u64(1));
    let target = Target::new("ct", SurfaceOrigin::User, samples.points, Some(samples.normals.into())).unwrap();
    target.with_mesh(MeshQuery::new(mesh))
}

/// The mirror image of a surface.
fn mirrored(mesh: &Mesh) -> Mesh {
    let vertices: Vec<Point3<f64>> = mesh.vertices().iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect();
    let faces: Vec<[u32; 3]> = mesh.faces().iter().map(|&[a, b, c]| [a, c, b]).collect();
    Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap()
}

fn scan(bone: &Bone, heights_mm: [f64; 2], seed: u64) -> Cloud {
    bone.scan(&bone.camera((heights_mm[0] + heights_mm[1]) / 2.0), heights_mm, 0.5, &USUAL, None, seed)
}

/// The verdict on a scan registered by shape alone; `None` where nothing fits.
fn judged(target: &Target, scan: &Cloud) -> Option<Verdict> {
    let start = global(target, scan, &GlobalParams::default()).ok()?;
    let observer = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
    let fit =
        icp::register(Method::PointToPlane, target, scan, &start.t_target_source, &IcpParams::default(), observer);
    let t: Isometry3<f64> = fit.ok()?.t_target_source;
    let some = scan.points().iter().step_by(scan.len() / 10);
    let on = |p: &Point3<f64>| target.points()[target.nearest(&(t * p), f64::INFINITY).unwrap().0];
    let points: Vec<NamedPoint> = some.enumerate().map(|(k, p)| NamedPoint::new(format!("S{k}"), on(p))).collect();
    let case = Case {
        assessment: &points,
        start: Some(&start.report),
        ..Case::new(Registered { target, source: scan, t_target_source: &t, at: &[] })
    };
    Some(trust::judge(&case, &EvidenceParams::default(), &RuleParams::default(), &PredictParams::default()))
}

#[test]
fn a_gross_mistake_is_never_first_named_a_stretch_of_the_ct() {
    let mut all = bones("a_gross_mistake_is_never_first_named_a_stretch_of_the_ct");
    all.push(own_bone());
    let targets: Vec<[Target; 2]> =
        all.iter().map(|bone| [target_of(&bone.mesh), target_of(&mirrored(&bone.mesh))]).collect();
    let mut n_named = 0;
    for (k, bone) in all.iter().enumerate() {
        for heights_mm in [[70.0, 165.0], [10.0, 120.0], [100.0, 190.0]] {
            let scan = scan(bone, heights_mm, 3);
            for (j, other) in all.iter().enumerate() {
                for (is_mirrored, target) in targets[j].iter().enumerate() {
                    let what = format!("{} {heights_mm:?} on {} {is_mirrored}", bone.name, other.name);
                    let Some(verdict) = judged(target, &scan) else { continue };
                    let rules: Vec<&str> = verdict.reasons.iter().map(|reason| reason.rule.as_str()).collect();
                    if j == k && is_mirrored == 0 {
                        assert_eq!(verdict.answer, Answer::Trusted, "{what}: {rules:?}");
                        continue;
                    }
                    assert_ne!(verdict.answer, Answer::Trusted, "{what}");
                    // A cause beside the pose comes after the sign of a gross mistake.
                    let is_gross = |rule: &&str| ["mirrored", "another_bone", "inward_misfit", "shape"].contains(rule);
                    let gross = rules.iter().position(is_gross);
                    let is_cause = |rule: &&str| verdict.nuisances.iter().any(|nuisance| nuisance.name == **rule);
                    if let Some(cause) = rules.iter().position(is_cause) {
                        assert!(gross.is_some_and(|gross| gross < cause), "{what}: {rules:?}");
                        n_named += 1;
                    }
                }
            }
        }
    }
    assert!(all.len() == 1 || n_named > 5, "{n_named} causes were named beside gross mistakes");
}

/// A closed body of revolution, as a bottle: about z, its radius at 49 heights.
fn bottle() -> Mesh {
    let (rings, around) = (49_u32, 96_u32);
    let radius = |z: f64| 30.0 - 16.0 / (1.0 + (-(z - 72.0) / 6.0).exp());
    let point = |i: u32, j: u32| {
        let (z, turn) = (2.4 * f64::from(i), f64::from(j) / f64::from(around) * std::f64::consts::TAU);
        Point3::new(radius(z) * turn.cos(), radius(z) * turn.sin(), z)
    };
    let mut vertices: Vec<Point3<f64>> = (0..rings).flat_map(|i| (0..around).map(move |j| point(i, j))).collect();
    vertices.extend([Point3::origin(), Point3::new(0.0, 0.0, 2.4 * f64::from(rings - 1))]);
    let (bottom, top) = (rings * around, rings * around + 1);
    let mut faces = Vec::new();
    for j in 0..around {
        let next = (j + 1) % around;
        for i in 0..rings - 1 {
            let [a, b] = [j, next].map(|j| i * around + j);
            faces.extend([[a, b, a + around], [b, b + around, a + around]]);
        }
        let last = (rings - 1) * around;
        faces.extend([[bottom, next, j], [top, last + j, last + next]]);
    }
    Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap()
}

#[test]
fn a_body_that_turns_into_itself_is_never_trusted() {
    let mesh = bottle();
    let target = target_of(&mesh);
    let seen = sample::surface(&mesh, 20_000, &mut ChaCha8Rng::seed_from_u64(3));
    let towards = Vector3::new(0.8, 0.3, 0.52);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let t_scan = Isometry3::new(Vector3::new(90.0, -40.0, 300.0), Vector3::new(1.0, -0.5, 2.0));
    let side: Vec<Point3<f64>> = seen
        .points
        .iter()
        .zip(&seen.normals)
        .filter(|(_, normal)| normal.dot(&towards) > 0.25)
        .map(|(p, normal)| t_scan * (p + normal * (0.1 * (2.0 * rng.random::<f64>() - 1.0))))
        .collect();
    let part: Vec<Point3<f64>> = side.iter().filter(|p| (t_scan.inverse() * *p).z > 50.0).copied().collect();
    for (what, points) in [("a side", side), ("its neck", part)] {
        let verdict = judged(&target, &Cloud::new("scan", points).unwrap());
        let reasons: Vec<&str> = verdict.iter().flat_map(|v| &v.reasons).map(|reason| &*reason.rule).collect();
        assert!(verdict.as_ref().is_none_or(|verdict| verdict.answer != Answer::Trusted), "{what}: {reasons:?}");
    }
}
