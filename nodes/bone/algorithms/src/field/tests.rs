use super::samples::Samples;
use super::triangles::Triangles;
use super::*;
use crate::sample;
use crate::shapes::{cuboid, shaft, together};
use nalgebra::Isometry3;
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn of_mesh(mesh: &Mesh) -> ClosestPointField {
    ClosestPointField::of_mesh(&MeshQuery::new(mesh), &FieldParams::default()).unwrap()
}

fn of_points(points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Result<ClosestPointField, FieldError> {
    ClosestPointField::of_points(points, normals, &FieldParams::default())
}

/// A sheet of 60 x 40 mm in z = 0, faces up.
fn sheet() -> Mesh {
    let vertices: Vec<_> =
        [(-30.0, -20.0), (30.0, -20.0), (30.0, 20.0), (-30.0, 20.0)].map(|(x, y)| Point3::new(x, y, 0.0)).to_vec();
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
}

/// `n` points of a ball, spread evenly, and their normals.
fn ball(n: u32, radius: f64) -> (Vec<Point3<f64>>, Vec<Vector3<f64>>) {
    let normals: Vec<Vector3<f64>> = (0..n)
        .map(|i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(n);
            let (turn, r) = (f64::from(i) * 2.399_963, (1.0 - z * z).sqrt());
            Vector3::new(r * turn.cos(), r * turn.sin(), z)
        })
        .collect();
    (normals.iter().map(|n| Point3::from(n * radius)).collect(), normals)
}

/// Positions within `reach` of points of a surface.
fn near(samples: &sample::Samples, reach: f64, seed: u64) -> Vec<Point3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let away = |p: &Point3<f64>, n: &Vector3<f64>, share: f64| p + n * (reach * (2.0 * share - 1.0));
    samples.points.iter().zip(&samples.normals).map(|(p, n)| away(p, n, rng.random())).collect()
}

fn drawn(mesh: &Mesh, n: usize, seed: u64) -> sample::Samples {
    sample::surface(mesh, n, &mut ChaCha8Rng::seed_from_u64(seed))
}

#[test]
fn above_a_sheet_distances_are_heights_and_beyond_its_rim_there_is_no_answer() {
    let drawn = drawn(&sheet(), 24_000, 1);
    for field in [of_mesh(&sheet()), of_points(&drawn.points, &drawn.normals).unwrap()] {
        for (x, y, z) in [(0.0, 0.0, 0.3), (12.3, -7.7, -2.2), (-20.0, 15.0, 2.9), (3.0, 3.0, 15.0), (3.0, 3.0, -19.0)]
        {
            let found = field.at(&Point3::new(x, y, z)).unwrap();
            assert!((found.distance_mm - z).abs() < 1e-5, "{} for {z} mm", found.distance_mm);
            assert!((found.normal - Vector3::z()).norm() < 1e-5, "{}", found.normal);
        }
        for beyond in [[32.0, 0.0, 0.2], [0.0, 22.5, -0.1], [40.0, 0.0, 2.0], [0.0, 0.0, 40.0], [f64::NAN, 0.0, 0.0]] {
            assert_eq!(field.at(&Point3::from(beyond)), None, "{beyond:?}");
        }
    }
}

#[test]
fn distances_around_a_ball_are_exact() {
    let (points, normals) = ball(30_000, 15.0);
    let field = of_points(&points, &normals).unwrap();
    let (directions, _) = ball(2_000, 1.0);
    for (k, direction) in directions.iter().enumerate() {
        let along = direction.coords;
        for (height, within_mm, within_rad) in
            [((k % 21) as f64 / 10.0 - 1.0, 5e-4, 5e-3), ((k % 61) as f64 / 10.0 - 3.0, 2e-3, 0.01), (15.0, 0.05, 0.05)]
        {
            let found = field.at(&Point3::from(along * (15.0 + height))).unwrap();
            let off = (found.distance_mm - height).abs();
            assert!(off < within_mm, "{off} mm off at {height} mm: of fourth order in 1 mm (or 4 mm) over 15 mm");
            assert!(found.normal.angle(&along) < within_rad, "{} rad", found.normal.angle(&along));
            assert!((found.normal.norm() - 1.0).abs() < 1e-6);
        }
    }
}

#[test]
fn a_cube_has_flat_sides_and_edges_rounded_by_less_than_a_cell() {
    let mesh = cuboid([-10.0, -12.0, -15.0], [10.0, 12.0, 15.0]);
    let field = of_mesh(&mesh);
    let flat = field.at(&Point3::new(2.2, 3.3, 15.7)).unwrap();
    assert!((flat.distance_mm - 0.7).abs() < 1e-5 && (flat.normal - Vector3::z()).norm() < 1e-5);
    let inside = field.at(&Point3::new(8.5, 1.0, 2.0)).unwrap();
    assert!((inside.distance_mm + 1.5).abs() < 1e-5 && (inside.normal - Vector3::x()).norm() < 1e-5);
    let edge = field.at(&Point3::new(11.0, 13.0, 0.0)).unwrap();
    assert!((edge.distance_mm - 2.0_f64.sqrt()).abs() < 0.05, "{}", edge.distance_mm);
    let corner = field.at(&Point3::new(12.0, 14.0, 17.0)).unwrap();
    assert!((corner.distance_mm - 12.0_f64.sqrt()).abs() < 0.05, "{}", corner.distance_mm);
    assert!(corner.normal.angle(&Vector3::repeat(1.0)) < 0.1);
    for place in near(&drawn(&mesh, 3_000, 2), 1.0, 3) {
        let exact = MeshQuery::new(&mesh).closest_point(&place).unwrap().distance_mm;
        let found = field.at(&place).unwrap().distance_mm;
        assert!((found.abs() - exact).abs() < 0.3, "{found} for {exact} mm at {place}");
    }
}

#[test]
fn on_a_bone_field_and_mesh_agree_and_so_do_its_samples() {
    let mesh = shaft();
    let query = MeshQuery::new(&mesh);
    let dense = drawn(&mesh, 40_000, 1);
    for (field, rms_mm) in [(of_mesh(&mesh), 0.008), (of_points(&dense.points, &dense.normals).unwrap(), 0.01)] {
        let places: Vec<_> =
            near(&drawn(&mesh, 4_000, 5), 1.0, 6).into_iter().filter(|p| (3.0..117.0).contains(&p.z)).collect();
        let squares = places.iter().map(|place| {
            let exact = query.closest_point(place).unwrap().distance_mm;
            let found = field.at(place).unwrap().distance_mm;
            assert!(exact < 0.02 || (found < 0.0) == query.is_inside(place), "{found} mm at {place}");
            (found.abs() - exact).powi(2)
        });
        let rms = (squares.sum::<f64>() / places.len() as f64).sqrt();
        assert!(rms < rms_mm, "{rms} mm RMS; between facets that meet at 5 degrees, 1 mm is coarse");
    }
}

#[test]
fn the_normal_is_the_derivative_of_the_distance() {
    let field = of_mesh(&shaft());
    let step = 1e-3;
    let mut n_checked = 0;
    for place in near(&drawn(&shaft(), 500, 7), 2.0, 8) {
        let value = |axis: usize, sign: f64| {
            let mut at = place;
            at[axis] += sign * step;
            field.at(&at).unwrap().distance_mm
        };
        let slope = Vector3::from([0, 1, 2].map(|axis| (value(axis, 1.0) - value(axis, -1.0)) / (2.0 * step)));
        let normal = field.at(&place).unwrap().normal;
        // A step may cross into the next cell, where the derivative jumps.
        n_checked += usize::from((slope.normalize() - normal).norm() < 2e-3);
    }
    assert!(n_checked > 480, "{n_checked} of 500");
}

#[test]
fn the_coarse_grid_points_towards_the_surface_from_far_off() {
    let (field, query) = (of_mesh(&shaft()), MeshQuery::new(&shaft()));
    for place in near(&drawn(&shaft(), 500, 9), 0.0, 9) {
        let away = (place - field.centre()).xy().push(0.0).normalize();
        let far = place + away * 12.0;
        let Some(found) = field.at(&far) else { panic!("nothing at {far}") };
        let foot = far - found.normal * found.distance_mm;
        let exact = query.closest_point(&foot).unwrap().distance_mm;
        assert!(exact < 0.5, "{exact} mm from the surface after one step of {} mm", found.distance_mm);
    }
}

#[test]
fn the_answers_are_the_same_ten_kilometres_from_the_origin() {
    let mesh = shaft();
    let shift = Vector3::new(1e7, -1e7, 1e7);
    let far_mesh = mesh.transformed("ct", &Isometry3::from_parts(shift.into(), Default::default()));
    let dense = drawn(&mesh, 20_000, 1);
    let far_points: Vec<_> = dense.points.iter().map(|p| p + shift).collect();
    for (near_field, far_field) in [
        (of_mesh(&mesh), of_mesh(&far_mesh)),
        (of_points(&dense.points, &dense.normals).unwrap(), of_points(&far_points, &dense.normals).unwrap()),
    ] {
        assert!((far_field.centre() - near_field.centre() - shift).norm() < 1e-7);
        for place in near(&drawn(&mesh, 1_000, 3), 1.0, 4) {
            let here = near_field.view().at_local(&(place - near_field.centre())).unwrap();
            let there = far_field.view().at_local(&(place - near_field.centre())).unwrap();
            assert!((here.distance_mm - there.distance_mm).abs() < 1e-5, "{here:?} {there:?}");
        }
    }
}

#[test]
fn threads_change_no_bit() {
    let dense = drawn(&shaft(), 20_000, 1);
    let fields = [1, 2, 8].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            [of_mesh(&shaft()), of_points(&dense.points, &dense.normals).unwrap()].map(|field| field.to_columns())
        })
    });
    assert!(fields[0] == fields[1] && fields[0] == fields[2]);
}

#[test]
fn the_nearest_is_found_whatever_the_hint() {
    let (mesh, dense) = (shaft(), drawn(&shaft(), 3_000, 1));
    let triangles = Triangles::new(&mesh, &Point3::origin(), &Matrix3::identity());
    let samples = Samples::new(&dense.points, &dense.normals, &Point3::origin(), &Matrix3::identity());
    let query = MeshQuery::new(&mesh);
    for (k, place) in near(&drawn(&mesh, 300, 5), 8.0, 6).into_iter().enumerate() {
        let brute = dense.points.iter().map(|p| (p - place).norm()).fold(f64::INFINITY, f64::min);
        let exact = query.closest_point(&place).unwrap().distance_mm;
        for hint in [None, Some(0), Some(k as u32 * 7 % 3000)] {
            let found = triangles.nearest(&place.coords, hint);
            assert!((found.square.sqrt() - exact).abs() < 1e-9);
            assert_eq!(found.index, triangles.nearest(&place.coords, None).index);
            let found = samples.nearest(&place.coords, hint);
            assert!((found.square.sqrt() - brute).abs() < 1e-5, "{} for {brute} mm", found.square.sqrt());
        }
    }
}

#[test]
fn repeated_vertices_of_stl_files_are_one_vertex() {
    let mesh = shaft();
    let vertices: Vec<_> = (0..mesh.faces().len()).flat_map(|face| mesh.corners(face)).collect();
    let faces: Vec<[u32; 3]> = (0..mesh.faces().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let soup = Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap();
    assert_eq!(of_mesh(&mesh).to_columns(), of_mesh(&soup).to_columns());
}

#[test]
fn a_part_inside_out_has_the_opposite_sign_and_its_seam_no_answer() {
    let turned: Vec<[u32; 3]> = shaft().faces().iter().map(|&[a, b, c]| [a, c, b]).collect();
    let inside_out = Mesh::new("ct", SurfaceOrigin::User, shaft().vertices().to_vec(), turned).unwrap();
    let (field, opposite) = (of_mesh(&shaft()), of_mesh(&inside_out));
    let place = Point3::new(8.0, 0.5, 40.0);
    assert_eq!(field.at(&place).unwrap().distance_mm, -opposite.at(&place).unwrap().distance_mm);

    // Half of the sheet is turned over; the seam runs along its diagonal.
    let seam = Mesh::new("ct", SurfaceOrigin::User, sheet().vertices().to_vec(), vec![[0, 1, 2], [0, 3, 2]]).unwrap();
    let field = of_mesh(&seam);
    assert!((field.at(&Point3::new(15.0, -10.0, 1.0)).unwrap().distance_mm - 1.0).abs() < 1e-5);
    assert!((field.at(&Point3::new(-15.0, 10.0, 1.0)).unwrap().distance_mm + 1.0).abs() < 1e-5);
}

#[test]
fn separate_parts_are_one_field() {
    let field = of_mesh(&together(&cuboid([0.0; 3], [10.0; 3]), &cuboid([30.0, 0.0, 0.0], [40.0, 10.0, 10.0])));
    for (x, sign) in [(9.0, -1.0), (11.0, 1.0), (29.0, 1.0), (31.0, -1.0)] {
        let found = field.at(&Point3::new(x, 5.0, 5.0)).unwrap().distance_mm;
        assert!((found - sign).abs() < 1e-5, "{found} at {x}");
    }
}

#[test]
fn unusable_surfaces_and_parameters_are_refused() {
    let (points, normals) = ball(500, 5.0);
    assert!(matches!(of_points(&[], &[]), Err(FieldError::Empty)));
    assert!(matches!(of_points(&points[..1], &normals[..1]), Err(FieldError::Line { n_points: 1 })));
    let line: Vec<_> = (0..50).map(|i| Point3::new(f64::from(i), 2.0 * f64::from(i), 1e6)).collect();
    assert!(matches!(of_points(&line, &normals[..50]), Err(FieldError::Line { n_points: 50 })));
    assert!(matches!(of_points(&points, &normals[1..]), Err(FieldError::Normals { n_points: 500, n_normals: 499 })));
    let mut wild = points.clone();
    wild[7].y = f64::NAN;
    assert!(matches!(of_points(&wild, &normals), Err(FieldError::NotFinite { index: 7 })));
    let mut none = normals.clone();
    none[9] = Vector3::zeros();
    assert!(matches!(of_points(&points, &none), Err(FieldError::NotFinite { index: 9 })));
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let unoriented: Vec<_> = normals.iter().map(|n| if rng.random::<bool>() { *n } else { -n }).collect();
    assert!(matches!(of_points(&points, &unoriented), Err(FieldError::NotOriented { .. })));
    let mut astray = points.clone();
    (astray[3].x, astray[4].y) = (1e5, 1e5);
    assert!(matches!(of_points(&astray, &normals), Err(FieldError::TooLarge { .. })));
    let flat = Mesh::new("ct", SurfaceOrigin::Exact, vec![Point3::origin(); 3], vec![[0, 1, 2]]).unwrap();
    let refused = ClosestPointField::of_mesh(&MeshQuery::new(&flat), &FieldParams::default());
    assert!(matches!(refused, Err(FieldError::Empty)));
    for (name, params) in [
        ("fine_mm", FieldParams { fine_mm: f64::NAN, ..Default::default() }),
        ("band_mm", FieldParams { band_mm: 0.5, ..Default::default() }),
        ("coarse_mm", FieldParams { coarse_mm: 0.5, ..Default::default() }),
        ("reach_mm", FieldParams { reach_mm: 2.0, ..Default::default() }),
    ] {
        let refused = ClosestPointField::of_mesh(&MeshQuery::new(&sheet()), &params);
        assert!(matches!(refused, Err(FieldError::Parameter { name: found, .. }) if found == name), "{name}");
    }
}

#[test]
fn columns_are_shared_and_give_the_same_field() {
    let field = of_mesh(&cuboid([0.0; 3], [10.0, 12.0, 20.0]));
    let columns = field.to_columns();
    let again = ClosestPointField::from_columns(columns.clone()).unwrap();
    assert_eq!(again.to_columns(), columns);
    assert!(std::ptr::eq(&again.to_columns().nodes[0], &columns.nodes[0]), "nodes are not copied");
    assert_eq!(again.params(), field.params());
    for place in near(&drawn(&cuboid([0.0; 3], [10.0, 12.0, 20.0]), 200, 1), 2.0, 2) {
        assert_eq!(field.at(&place), again.at(&place));
    }
}

type Damage = dyn Fn(&mut Vec<f64>, &mut Vec<u32>, &mut Vec<f32>);

#[test]
fn damaged_columns_are_refused() {
    let field = of_mesh(&cuboid([0.0; 3], [10.0, 12.0, 20.0]));
    let damage = |what: &str, change: &Damage| {
        let columns = field.to_columns();
        let (mut head, mut index, mut nodes) = (columns.head.to_vec(), columns.index.to_vec(), columns.nodes.to_vec());
        change(&mut head, &mut index, &mut nodes);
        let columns = FieldColumns { head: head.into(), index: index.into(), nodes: nodes.into() };
        match ClosestPointField::from_columns(columns) {
            Err(FieldError::Damaged { what: damage }) => assert!(!damage.is_empty()),
            Err(other) => panic!("{what}: {other}"),
            Ok(_) => panic!("{what} was accepted"),
        }
    };
    damage("a short head", &|head, _, _| head.truncate(31));
    damage("another layout", &|head, _, _| head[0] = 7.0);
    damage("a centre that is not finite", &|head, _, _| head[2] = f64::NAN);
    damage("axes that are no rotation", &|head, _, _| head[5] = 3.0);
    damage("a parameter out of range", &|head, _, _| head[13] = -1.0);
    damage("another spacing", &|head, _, _| head[17] *= 2.0);
    damage("more blocks", &|head, _, _| head[21] = 1e9);
    damage("blocks whose number overflows", &|head, _, _| head[21] = 1e300);
    damage("more fine blocks than blocks", &|head, _, _| head[31] = 1e6);
    damage("fewer fine blocks", &|head, _, _| head[31] -= 1.0);
    damage("a short index", &|_, index, _| index.truncate(5));
    damage("an index beyond the nodes", &|_, index, _| index[3] = u32::MAX - 1);
    damage("half a block", &|_, _, nodes| nodes.truncate(nodes.len() - 4));
    damage("a block too few", &|_, _, nodes| nodes.truncate(nodes.len() - 500));
    damage("a node that is not finite", &|_, _, nodes| nodes[17] = f32::NAN);
    damage("a node that is infinite", &|_, _, nodes| nodes[18] = f32::NEG_INFINITY);
}
