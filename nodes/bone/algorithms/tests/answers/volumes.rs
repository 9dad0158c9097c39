//! Surfaces of small volumes.

use super::text::{digest, golden, line, outcome, points};
use nalgebra::{Matrix4, Point3, Vector3};
use osteoflow_algorithms::ct_surface::{
    ComponentChoice, CtSurface, CtSurfaceParams, VolumeView, ct_surface, suggested_threshold,
};
use osteoflow_algorithms::iso_surface::{iso_surface, make_well_composed};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

const SIZE: [usize; 3] = [26, 22, 30];

/// HU of soft tissue around a hollow bone that the last layer cuts, a smaller one beside it and a crumb, with noise.
fn volume() -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let wall = |r: f64, outer: f64| ((outer - r) / 1.5).clamp(0.0, 1.0) * 1200.0;
    let [nx, ny, nz] = SIZE;
    (0..nx * ny * nz)
        .map(|i| {
            let at = Vector3::new((i % nx) as f64, (i / nx % ny) as f64, (i / nx / ny) as f64);
            let shaft = Vector3::new(at.x - 9.0 - 0.1 * at.z, at.y - 10.0, (8.0 - at.z).max(0.0)).norm();
            let inner = Vector3::new(at.x - 10.0, at.y - 10.0, (at.z - 16.0) / 1.5).norm();
            let beside = (at - Vector3::new(20.0, 15.0, 9.0)).norm();
            let crumb = (at - Vector3::new(4.0, 3.0, 24.0)).norm();
            let bone = (wall(shaft, 6.5) - wall(inner, 3.4)).max(wall(beside, 4.6)).max(wall(crumb, 2.4));
            (40.0 + bone + 60.0 * rng.random::<f64>()) as f32
        })
        .collect()
}

fn faces(faces: &[[u32; 3]]) -> impl std::fmt::Debug + use<> {
    let faces: Vec<[f64; 3]> = faces.iter().map(|face| face.map(f64::from)).collect();
    digest(faces.iter())
}

fn described(surface: &CtSurface) -> impl std::fmt::Debug + use<> {
    let count = |marks: &[bool]| {
        let at = marks.iter().enumerate().filter(|(_, m)| **m).map(|(k, _)| k % 97);
        (marks.iter().filter(|m| **m).count(), at.sum::<usize>())
    };
    let marks = (count(&surface.vertex_is_on_border), count(&surface.face_is_on_border));
    let parts = (surface.n_components, surface.components.clone(), surface.chosen.clone());
    let raised = (surface.n_raised, surface.n_filled, surface.filled_mm3);
    let closed = Mesh::new("ct", SurfaceOrigin::User, surface.vertices.clone(), surface.faces.clone());
    let shift = (surface.shift_mm_per_50, surface.shift_p95_mm_per_50);
    (
        points(&surface.vertices),
        faces(&surface.faces),
        marks,
        parts,
        raised,
        shift,
        closed.ok().map(|mesh| mesh.volume_mm3()),
    )
}

#[test]
fn the_surface_of_a_volume_is_what_it_was() {
    let voxels = volume();
    let t = Matrix4::new(0.5, 0.0, 0.1, -20.0, 0.0, 0.6, 0.0, 7.0, 0.0, 0.05, 0.9, 100.0, 0.0, 0.0, 0.0, 1.0);
    let view = VolumeView { size: SIZE, voxels: &voxels, t_lps_voxel: &t };
    let place = |x: f64, y: f64, z: f64| t.transform_point(&Point3::new(x, y, z));
    let mut text = String::new();
    let mut cases = Vec::new();
    for threshold in [300.0, 520.0, 1000.0] {
        for fill_cavities in [true, false] {
            for component in [ComponentChoice::Rank(1), ComponentChoice::Rank(2)] {
                cases.push(CtSurfaceParams { threshold, component, fill_cavities });
            }
        }
    }
    for (component, threshold) in [
        (ComponentChoice::Rank(3), 300.0),
        (ComponentChoice::Rank(9), 300.0),
        (ComponentChoice::Rank(0), 300.0),
        (ComponentChoice::Rank(1), 5000.0),
        (ComponentChoice::Rank(1), -5000.0),
        (ComponentChoice::Rank(1), f64::NAN),
        (ComponentChoice::Seed(place(20.0, 15.0, 9.0)), 500.0),
        (ComponentChoice::Seed(place(4.4, 2.6, 24.4)), 300.0),
        (ComponentChoice::Seed(place(1.0, 19.0, 2.0)), 500.0),
        (ComponentChoice::Seed(place(25.4, 21.4, 29.4)), 500.0),
        (ComponentChoice::Seed(place(25.6, 21.4, 29.4)), 500.0),
        (ComponentChoice::Seed(place(-0.6, 0.0, 0.0)), 500.0),
    ] {
        cases.push(CtSurfaceParams { threshold, component, fill_cavities: true });
    }
    for params in &cases {
        let surface = ct_surface(&view, params);
        text += &outcome(format!("{params:?}"), &surface.as_ref().map(described));
        if let Ok(open) = surface.and_then(|surface| surface.open_mesh("ct")) {
            text += &line("    open", &(points(open.vertices()), faces(open.faces())));
        }
    }
    let refused = |size: [usize; 3], t: &Matrix4<f64>| {
        let n = voxels.len().min(size.iter().product());
        let view = VolumeView { size, voxels: &voxels[..n], t_lps_voxel: t };
        ct_surface(&view, &CtSurfaceParams::at(500.0)).map(|s| s.faces.len())
    };
    for size in [[26, 22, 31], [26, 22, 1], [1, 22, 30], [26, 1, 30], [26, 22, 2], [usize::MAX, 3, 3]] {
        text += &match size[0] {
            usize::MAX => outcome("overflow", &{
                let view = VolumeView { size, voxels: &voxels, t_lps_voxel: &t };
                ct_surface(&view, &CtSurfaceParams::at(500.0)).map(|s| s.faces.len())
            }),
            _ => outcome(format!("{size:?}"), &refused(size, &t)),
        };
    }
    text += &outcome("singular", &refused(SIZE, &Matrix4::zeros()));
    text += &outcome("not finite", &refused(SIZE, &(t * f64::INFINITY)));
    text += &outcome("mirrored", &refused(SIZE, &(t * Matrix4::new_nonuniform_scaling(&Vector3::new(-1.0, 1.0, 1.0)))));
    for is_hu in [true, false] {
        text += &line("threshold", &suggested_threshold(&view, is_hu));
        let constant = vec![100.0_f32; 27];
        let flat = VolumeView { size: [3; 3], voxels: &constant, t_lps_voxel: &t };
        text += &line("flat", &suggested_threshold(&flat, is_hu));
        let shifted: Vec<f32> = voxels.iter().map(|v| v * 2.0 - 400.0).collect();
        let shifted = VolumeView { size: SIZE, voxels: &shifted, t_lps_voxel: &t };
        text += &line("shifted", &suggested_threshold(&shifted, is_hu));
        for n in [49, 50] {
            let some: Vec<f32> =
                (0..1000).map(|k| if k < n { 900.0 + k as f32 } else { 50.0 + (k % 7) as f32 }).collect();
            let some = VolumeView { size: [10; 3], voxels: &some, t_lps_voxel: &t };
            text += &line(format!("{n} voxels of bone"), &suggested_threshold(&some, is_hu));
        }
    }
    golden("ct_surface", &text);
}

#[test]
fn the_level_of_noise_has_the_surface_it_had() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let mut text = String::new();
    for (size, level) in [([9, 7, 8], 0.5), ([9, 7, 8], 0.9), ([2, 2, 2], 0.5), ([12, 2, 5], 0.4), ([1, 5, 5], 0.5)] {
        let mut noise: Vec<f32> = (0..size.iter().product::<usize>()).map(|_| rng.random()).collect();
        for round in ["as it is", "well composed"] {
            let (vertices, found) = iso_surface(&noise, size, level, |at| Point3::from(at * 0.7));
            text += &line(format!("{size:?} {level} {round}"), &(points(&vertices), faces(&found)));
            let n_raised = make_well_composed(&mut noise, size, level);
            text += &line("    raised", &(n_raised, noise.iter().map(|v| f64::from(*v)).sum::<f64>()));
        }
    }
    golden("iso_surface", &text);
}
