use super::*;
use crate::joined::joined;
use crate::shapes::{cuboid, shaft};
use nalgebra::Point3;
use std::f64::consts::TAU;

/// A closed prism along z with a regular outline and the given number of rings; inside out if `hollow`.
pub(crate) fn prism(radius: f64, sides: u32, z: [f64; 2], rings: u32, hollow: bool) -> Mesh {
    let at = |i: u32, j: u32| {
        let turn = f64::from(j) / f64::from(sides) * TAU;
        let height = z[0] + (z[1] - z[0]) * f64::from(i) / f64::from(rings - 1);
        Point3::new(radius * turn.cos(), radius * turn.sin(), height)
    };
    let mut vertices: Vec<_> = (0..rings).flat_map(|i| (0..sides).map(move |j| at(i, j))).collect();
    let index = |i: u32, j: u32| i * sides + j % sides;
    let mut faces = Vec::new();
    for i in 0..rings - 1 {
        for j in 0..sides {
            faces.push([index(i, j), index(i, j + 1), index(i + 1, j)]);
            faces.push([index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)]);
        }
    }
    for (ring, end) in [(0, false), (rings - 1, true)] {
        let hub = vertices.len() as u32;
        vertices.push(Point3::new(0.0, 0.0, z[usize::from(end)]));
        for j in 0..sides {
            let (a, b) = (index(ring, j), index(ring, j + 1));
            faces.push(if end { [hub, a, b] } else { [hub, b, a] });
        }
    }
    if hollow {
        faces.iter_mut().for_each(|f| f.swap(1, 2));
    }
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
}

pub(crate) fn planes(places: [Isometry3<f64>; 2]) -> Planes {
    let [a, b] = places;
    Planes::new("ct", vec![Plane::new("plane_1", a), Plane::new("plane_2", b)])
}

fn cut(bone: &Mesh, places: [Isometry3<f64>; 2]) -> Result<Fragment, Refusal> {
    fragment(bone, &between(bone, &planes(places))?)
}

fn tilted(z: f64, lean: f64) -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, z) * Isometry3::rotation(Vector3::new(lean, 0.7 * lean, 0.0))
}

/// Every edge belongs to two faces that run along it in opposite directions, and the volume is as expected.
#[track_caller]
fn assert_closed(fragment: &Fragment, volume_mm3: f64) {
    assert_eq!(mesh_topology::open_edges(&fragment.mesh), 0, "open edges");
    let volume = fragment.mesh.volume_mm3();
    assert!(
        (volume - volume_mm3).abs() <= 1e-4,
        "{volume} mm³, {volume_mm3} mm³ expected: rounding of plane and edges"
    );
}

fn area(radius: f64, sides: u32) -> f64 {
    f64::from(sides) / 2.0 * radius * radius * (TAU / f64::from(sides)).sin()
}

#[test]
fn the_piece_of_a_prism_is_closed_and_as_large_as_its_section_times_its_length() {
    for (sides, rings) in [(3, 2), (7, 5), (60, 161), (200, 33)] {
        let bone = prism(8.0, sides, [0.0, 160.0], rings, false);
        // Cuts between rings, on rings, and leaning so that outlines pass from ring to ring.
        for (low, high, lean) in [(40.3, 74.3, 0.0), (40.0, 80.0, 0.0), (41.7, 90.0, 0.3), (40.0, 80.0, -0.25)] {
            let piece = cut(&bone, [tilted(low, lean), tilted(high, -lean)]).unwrap();
            assert_closed(&piece, area(8.0, sides) * (high - low));
            let caps = [0, 1].map(|k| piece.face_kinds.iter().filter(|p| **p == FaceKind::Cap(k)).count());
            // On a ring with level cuts, the cap is over the ring itself.
            assert!(caps.iter().all(|n| *n >= sides as usize - 2), "{caps:?} faces");
        }
    }
}

#[test]
fn flipped_normals_cut_the_same_piece() {
    let bone = shaft();
    let turn = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let (low, high) = (tilted(40.0, 0.2), tilted(74.0, -0.1));
    let piece = cut(&bone, [low, high]).unwrap();
    assert_closed(&piece, piece.mesh.volume_mm3());
    for places in [[low * turn, high], [low, high * turn], [low * turn, high * turn]] {
        assert!((cut(&bone, places).unwrap().mesh.volume_mm3() - piece.mesh.volume_mm3()).abs() < 1e-6);
    }
    assert!((cut(&bone, [high, low]).unwrap().mesh.volume_mm3() - piece.mesh.volume_mm3()).abs() < 1e-6);
}

#[test]
fn a_marrow_canal_stays_open_in_the_cut_faces_and_a_closed_cavity_is_kept() {
    let outside = prism(8.0, 40, [0.0, 160.0], 81, false);
    let canal = joined(&[&outside, &prism(3.5, 24, [-5.0, 165.0], 81, true)]);
    let places = [tilted(40.3, 0.3), tilted(74.3, -0.1)];
    assert_closed(&cut(&canal, places).unwrap(), (area(8.0, 40) - area(3.5, 24)) * 34.0);
    let cavity = joined(&[&outside, &prism(3.0, 12, [50.0, 60.0], 5, true)]);
    assert_closed(&cut(&cavity, places).unwrap(), area(8.0, 40) * 34.0 - area(3.0, 12) * 10.0);
}

#[test]
fn an_outline_with_bays_is_followed() {
    // A cross, and a star whose middle is no vertex's neighbour.
    let star = |k: u32| if k.is_multiple_of(2) { 9.0 } else { 2.5 };
    let mut bone = prism(1.0, 14, [0.0, 160.0], 33, false);
    let vertices: Vec<_> = bone
        .vertices()
        .iter()
        .enumerate()
        .map(
            |(i, p)| {
                if i < 14 * 33 { Point3::new(p.x * star(i as u32 % 14), p.y * star(i as u32 % 14), p.z) } else { *p }
            },
        )
        .collect();
    bone = Mesh::new("ct", SurfaceOrigin::Exact, vertices, bone.faces().to_vec()).unwrap();
    let section = 14.0 / 2.0 * 9.0 * 2.5 * (TAU / 14.0).sin();
    // 2 mm from ring to ring divide 5 mm evenly only at rings, so the rest runs through twisted faces: cut at rings.
    assert_closed(&cut(&bone, [tilted(40.0, 0.0), tilted(80.0, 0.0)]).unwrap(), section * 40.0);
    let leaning = cut(&bone, [tilted(40.0, 0.3), tilted(80.0, -0.2)]).unwrap();
    assert_closed(&leaning, section * 40.0);
}

#[test]
fn the_bone_at_the_planes_is_cut_of_two_in_one_file() {
    let other = prism(10.0, 30, [0.0, 160.0], 33, false).transformed("ct", &Isometry3::translation(80.0, 0.0, 0.0));
    let both = joined(&[&other, &prism(8.0, 30, [0.0, 160.0], 33, false)]);
    assert_closed(&cut(&both, [tilted(40.3, 0.1), tilted(74.3, -0.1)]).unwrap(), area(8.0, 30) * 34.0);
}

#[test]
fn moving_bone_and_planes_leaves_the_piece_unchanged() {
    let motion = Isometry3::new(Vector3::new(3e3, -2e3, 900.0), Vector3::new(0.4, -2.0, 1.0));
    let places = [tilted(40.0, 0.2), tilted(74.0, -0.1)];
    let here = cut(&shaft(), places).unwrap();
    let there = cut(&shaft().transformed("ct", &motion), places.map(|p| motion * p)).unwrap();
    assert!((here.mesh.volume_mm3() - there.mesh.volume_mm3()).abs() < 1e-5);
    assert_eq!(here.mesh.vertices().len(), there.mesh.vertices().len());
}

#[test]
fn planes_that_cannot_cut_are_refused() {
    let bone = cuboid([-5.0, -6.0, 0.0], [5.0, 6.0, 100.0]);
    let error = |places| cut(&bone, places).unwrap_err().to_string();
    assert!(error([tilted(40.0, 0.0), tilted(140.0, 0.0)]).starts_with("plane_2 does not cut the bone"));
    assert!(error([tilted(40.0, 0.0), tilted(40.0, 0.0)]).contains("in one place"));
    let one = Planes::new("ct", vec![Plane::new("plane_1", tilted(40.0, 0.0))]);
    assert!(between(&bone, &one).unwrap_err().to_string().contains("there are 1; give the plan two"));
    let lost = planes([tilted(40.0, 0.0), tilted(60.0, 0.0)]).unknown("ct", 0, "marker lost");
    assert!(between(&bone, &lost).unwrap_err().to_string().contains("marker lost"));
    let open = Mesh::new("ct", bone.origin, bone.vertices().to_vec(), bone.faces()[..11].to_vec()).unwrap();
    let error = cut(&open, [tilted(40.0, 0.1), tilted(60.0, 0.0)]).unwrap_err();
    assert!(error.to_string().contains("cuts it (2 loose ends)"), "{error}");
    // Cuts that a bad registration carries beyond the bone's end.
    let halves = between(&bone, &planes([tilted(40.0, 0.1), tilted(60.0, 0.0)])).unwrap();
    let gone = halves.map(|h| h.moved(&Isometry3::translation(0.0, 0.0, 300.0)));
    assert!(fragment(&bone, &gone).unwrap_err().to_string().contains("does not cut the bone within"));
}
