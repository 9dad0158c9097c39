//! Rays, closest points and nearest samples of the own bone.

use super::text::{golden, line, motion, outcome};
use super::{BONE, TARGET};
use crate::common::displaced;
use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::mesh_topology::{largest_component, open_edges};
use osteoflow_algorithms::nearest::Nearest;
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::SurfaceOrigin;

/// Points on, in and far from the bone.
fn queries() -> impl Iterator<Item = Point3<f64>> {
    let vertices = BONE.mesh.vertices();
    (0..160).map(move |k: usize| {
        let mm = [0.0, 0.02, 0.7, 3.0, 11.0, 60.0, 400.0, 6.0][k % 8];
        let at = vertices[k * 1571 % vertices.len()];
        displaced(&at, mm, 0.0, k as u64) * at
    })
}

#[test]
fn a_mesh_answers_rays_and_closest_points_as_it_did() {
    let mut text = String::new();
    for (k, p) in queries().enumerate() {
        let closest = BONE.query.closest_point(&p);
        text += &line(k, &(closest, BONE.query.is_inside(&p)));
        let towards = BONE.mesh.vertices()[k * 911 % 200_000] - p;
        if towards.norm() > 1.0 {
            text += &line("    ray", &BONE.query.cast_ray(&p, &towards.normalize()));
        }
    }
    for axis in [Vector3::x(), -Vector3::x(), Vector3::y(), Vector3::z(), -Vector3::z()] {
        let from = Point3::from(BONE.mesh.vertices().iter().map(|v| v.coords).sum::<Vector3<f64>>())
            / BONE.mesh.vertices().len() as f64;
        text += &line("along an axis", &BONE.query.cast_ray(&(from - axis * 300.0), &axis));
        text += &line("away", &BONE.query.cast_ray(&(from - axis * 300.0), &-axis));
    }
    text += &line("open edges", &open_edges(&BONE.mesh));
    let third: Vec<[u32; 3]> = BONE.mesh.faces().iter().copied().filter(|f| f[0] % 1000 > 3).collect();
    let (vertices, faces) = largest_component(BONE.mesh.vertices().to_vec(), &third);
    text += &line("largest", &(vertices.len(), faces.len()));
    golden("mesh_query", &text);
}

#[test]
fn the_nearest_samples_are_what_they_were() {
    let tree = Nearest::new(TARGET.points());
    let thin = Target::new("ct", TARGET.origin, TARGET.points().iter().step_by(7).copied().collect::<Vec<_>>(), None);
    let thin = thin.unwrap();
    let again = Target::new("ct", TARGET.origin, TARGET.points().to_vec(), None).unwrap();
    let again = again.with_grid_columns(&TARGET.grid_columns()).unwrap();
    let mut text = String::new();
    for (k, p) in queries().enumerate() {
        let nearest = TARGET.nearest(&p, 12.0);
        assert_eq!(nearest, again.nearest(&p, 12.0), "the grid from its columns");
        text += &line(k, &(nearest, thin.nearest(&p, f64::INFINITY), tree.nearest(&p)));
        text += &line("    around", &(tree.nearest_n(&p, 3), tree.within(&p, 1.0).len()));
    }
    let columns = TARGET.grid_columns();
    let sums: [usize; 3] = [&columns.blocks, &columns.starts, &columns.items]
        .map(|c| c.iter().enumerate().map(|(k, v)| (k % 97 + 1) * *v as usize).sum());
    text += &line("columns", &(columns.cell_mm, columns.blocks.len(), columns.starts.len(), sums));
    text += &outcome("other points", &thin.with_grid_columns(&columns).map(|t| t.points().len()));
    text += &line("a motion", &motion(&displaced(&Point3::new(1.0, 2.0, 3.0), 2.0, 0.1, 3)));
    golden("nearest", &text);
}

#[test]
fn a_target_is_its_frame_origin_points_and_normals_and_is_refused_if_they_do_not_fit() {
    let points: Vec<Point3<f64>> = (0..5).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect();
    let up = vec![Vector3::z(); 5];
    let make = |frame: &str, origin, points: &[Point3<f64>], normals: Option<&[Vector3<f64>]>| {
        Target::new(frame, origin, points.to_vec(), normals.map(|n| n.to_vec().into()))
    };
    let usual = make("ct", SurfaceOrigin::Exact, &points, Some(&up)).unwrap();
    assert_eq!(format!("{usual:?}"), format!("Target(5 points in ct, {})", SurfaceOrigin::Exact));
    assert_eq!(usual, make("ct", SurfaceOrigin::Exact, &points, Some(&up)).unwrap());
    let down = vec![-Vector3::z(); 5];
    for other in [
        make("bone", SurfaceOrigin::Exact, &points, Some(&up)),
        make("ct", SurfaceOrigin::User, &points, Some(&up)),
        make("ct", SurfaceOrigin::Exact, &points[..4], Some(&up[..4])),
        make("ct", SurfaceOrigin::Exact, &points, Some(&down)),
        make("ct", SurfaceOrigin::Exact, &points, None),
    ] {
        assert_ne!(usual, other.unwrap());
    }
    assert!(usual.mesh().is_none() && TARGET.mesh().is_some());
    assert_eq!((usual.point_column().len(), usual.normal_column().map(|n| n.len())), (5, Some(5)));
    // The last whose distance is the limit counts; ties go to the lowest index.
    assert_eq!(usual.nearest(&Point3::new(4.0, 3.0, 0.0), 3.0), Some((4, 3.0)));
    assert_eq!(usual.nearest(&Point3::new(4.0, 3.0, 0.0), 2.999), None);
    assert_eq!(usual.nearest(&Point3::new(1.5, 0.0, 0.0), 3.0), Some((1, 0.5)));
    let mut text = String::new();
    for (name, at, normal) in [
        ("not finite", Point3::new(0.0, f64::NAN, 0.0), Vector3::z()),
        ("no normal", points[3], Vector3::new(0.0, 0.0, f64::INFINITY)),
        ("far", Point3::new(0.0, 0.0, 1e9), Vector3::z()),
    ] {
        let (mut points, mut normals) = (points.clone(), up.clone());
        (points[3], normals[3]) = (at, normal);
        text += &outcome(name, &make("ct", SurfaceOrigin::Exact, &points, Some(&normals)));
    }
    text += &outcome("fewer normals", &make("ct", SurfaceOrigin::Exact, &points, Some(&up[1..])));
    text += &outcome("empty", &make("ct", SurfaceOrigin::Exact, &[], None));
    golden("target", &text);
}
