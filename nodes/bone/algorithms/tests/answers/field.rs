//! Closest-point fields of the own bone.

use super::text::{golden, line, outcome};
use super::{BONE, TARGET};
use crate::common::displaced;
use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::field::{ClosestPointField, FieldColumns, FieldParams};

const COARSE: FieldParams = FieldParams { fine_mm: 1.5, band_mm: 3.0, coarse_mm: 5.0, reach_mm: 15.0 };

fn described(field: &ClosestPointField) -> String {
    let FieldColumns { head, index, nodes } = field.to_columns();
    let index: u64 = index.iter().enumerate().map(|(k, v)| (k as u64 % 97 + 1) * u64::from(v.wrapping_add(1))).sum();
    // Nodes without surface have 1e30.
    let held = || nodes.iter().enumerate().filter(|(_, v)| v.abs() < 1e6);
    let node: f64 = held().map(|(k, v)| (k as f64 % 97.0 + 1.0) * f64::from(*v)).sum();
    let mut text =
        line("columns", &(&*head, index, nodes.len(), held().count(), node / nodes.len() as f64, field.n_bytes()));
    text += &line("centre", &(field.centre(), field.params()));
    let vertices = BONE.mesh.vertices();
    for k in 0..90_usize {
        let mm = [0.0, 0.4, 1.7, 2.9, 4.5, 9.0, 14.0, 16.0, 40.0][k % 9];
        let at = vertices[k * 2671 % vertices.len()];
        text += &line(k, &field.at(&(displaced(&at, mm, 0.0, k as u64) * at)));
    }
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        for mm in [-1e6, -200.0, 200.0, 1e6] {
            text += &line(mm, &field.at(&(field.centre() + axis * mm)));
        }
    }
    text
}

#[test]
fn a_field_of_a_mesh_and_one_of_points_have_the_distances_they_had() {
    let of_mesh = ClosestPointField::of_mesh(&BONE.query, &COARSE).unwrap();
    golden("field_mesh", &described(&of_mesh));
    let (points, normals) = (TARGET.points(), TARGET.normals().unwrap());
    let every: Vec<usize> = (0..points.len()).step_by(2).collect();
    let points: Vec<Point3<f64>> = every.iter().map(|&i| points[i]).collect();
    let normals: Vec<Vector3<f64>> = every.iter().map(|&i| normals[i]).collect();
    golden("field_points", &described(&ClosestPointField::of_points(&points, &normals, &COARSE).unwrap()));
}

#[test]
fn what_makes_no_field_is_refused_with_the_reason() {
    let of_points = |points: &[Point3<f64>], normals: &[Vector3<f64>], params: &FieldParams| {
        ClosestPointField::of_points(points, normals, params).map(|field| field.n_bytes())
    };
    let sheet: Vec<Point3<f64>> = (0..400).map(|k| Point3::new(f64::from(k % 20), f64::from(k / 20), 0.0)).collect();
    let up = vec![Vector3::z(); 400];
    let mixed: Vec<Vector3<f64>> = (0..400).map(|k| if k % 2 == 0 { Vector3::z() } else { -Vector3::z() }).collect();
    let line: Vec<Point3<f64>> = (0..400).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect();
    let far: Vec<Point3<f64>> = sheet.iter().map(|p| p * 1e6).collect();
    let mut broken = sheet.clone();
    broken[3].z = f64::NAN;
    let mut none = up.clone();
    none[5] = Vector3::zeros();
    let mut text = String::new();
    for (name, points, normals) in [
        ("sheet", &sheet, &up),
        ("mixed", &sheet, &mixed),
        ("line", &line, &up),
        ("too large", &far, &up),
        ("not finite", &broken, &up),
        ("no normal", &sheet, &none),
        ("fewer normals", &sheet, &up[..7].to_vec()),
        ("empty", &vec![], &vec![]),
    ] {
        text += &outcome(name, &of_points(points, normals, &COARSE));
    }
    for params in [
        FieldParams { fine_mm: 0.04, ..COARSE },
        FieldParams { fine_mm: f64::NAN, ..COARSE },
        FieldParams { band_mm: 1.4, ..COARSE },
        FieldParams { coarse_mm: 1.4, ..COARSE },
        FieldParams { reach_mm: 4.9, ..COARSE },
        FieldParams { reach_mm: 5.0, ..COARSE },
        FieldParams { reach_mm: 1001.0, ..COARSE },
    ] {
        text += &outcome(format!("{params:?}"), &of_points(&sheet, &up, &params));
    }
    let good = ClosestPointField::of_points(&sheet, &up, &COARSE).unwrap().to_columns();
    let head = |k: usize, value: f64| {
        let mut head = good.head.to_vec();
        head[k] = value;
        FieldColumns { head: head.into(), ..good.clone() }
    };
    let index = |value: u32| {
        let mut index = good.index.to_vec();
        index[0] = value;
        FieldColumns { index: index.into(), ..good.clone() }
    };
    let mut infinite = good.nodes.to_vec();
    infinite[9] = f32::INFINITY;
    let damaged = [
        good.clone(),
        FieldColumns { head: good.head[1..].to_vec().into(), ..good.clone() },
        FieldColumns { index: good.index[1..].to_vec().into(), ..good.clone() },
        FieldColumns { nodes: good.nodes[1..].to_vec().into(), ..good.clone() },
        FieldColumns { nodes: infinite.into(), ..good.clone() },
        index(1_000_000),
        index(u32::MAX),
    ];
    let heads = (0..good.head.len()).flat_map(|k| [f64::NAN, -3.0, 1e30].map(|value| (k, value)));
    for (k, columns) in damaged.into_iter().enumerate() {
        text += &outcome(format!("columns {k}"), &ClosestPointField::from_columns(columns).map(|f| f.n_bytes()));
    }
    for (k, value) in heads {
        let field = ClosestPointField::from_columns(head(k, value)).map(|f| f.n_bytes());
        text += &outcome(format!("head {k}: {value}"), &field);
    }
    golden("field_refused", &text);
}
