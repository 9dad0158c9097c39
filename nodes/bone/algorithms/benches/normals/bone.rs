//! The surface of the benches: a bone from a file, or an artificial shaft.

use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::sample;
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// The mesh of a binary STL file, mm, its vertices not welded.
pub(crate) fn read_stl(path: &str) -> Mesh {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{path}: {e}"));
    let number = |b: &[u8]| f64::from(f32::from_le_bytes(b.try_into().expect("four bytes")));
    let vertices: Vec<Point3<f64>> = bytes[84..]
        .chunks_exact(50)
        .flat_map(|face| face[12..48].chunks_exact(12).map(|v| Point3::from([0, 4, 8].map(|k| number(&v[k..k + 4])))))
        .collect();
    let faces: Vec<[u32; 3]> = (0..vertices.len() as u32 / 3).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    Mesh::new("ct", SurfaceOrigin::User, vertices, faces).expect("the file holds a mesh")
}

/// A bumpy shaft of 300 mm.
pub(crate) fn shaft() -> Mesh {
    let (rings, around) = (301_u32, 60_u32);
    let point = |i: u32, j: u32| {
        let (z, turn) = (f64::from(i), f64::from(j) / f64::from(around) * std::f64::consts::TAU);
        let radius = 6.0 + 0.9 * (3.0 * turn).cos() + 0.01 * z + 0.5 * (z / 9.0).sin();
        Point3::new(radius * turn.cos(), radius * turn.sin(), z)
    };
    let vertices: Vec<_> = (0..rings).flat_map(|i| (0..around).map(move |j| point(i, j))).collect();
    let index = |i: u32, j: u32| i * around + j % around;
    let faces: Vec<_> = (0..rings - 1)
        .flat_map(|i| (0..around).map(move |j| (i, j)))
        .flat_map(|(i, j)| {
            let (a, b, c, d) = (index(i, j), index(i, j + 1), index(i + 1, j), index(i + 1, j + 1));
            [[a, b, c], [b, d, c]]
        })
        .collect();
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).expect("a shaft is a mesh")
}

/// The binary STL file of `OSTEOFLOW_BONE`; else the shaft.
pub(crate) fn bone() -> Mesh {
    std::env::var("OSTEOFLOW_BONE").map_or_else(|_| shaft(), |path| read_stl(&path))
}

/// Points of the surface with normals.
pub(crate) fn samples(mesh: &Mesh, n: usize) -> sample::Samples {
    sample::surface(mesh, n, &mut ChaCha8Rng::seed_from_u64(1))
}

/// A scan of 125 mm of the bone from one side, with noise of 0.07 mm along the normal, along a space-filling curve.
pub(crate) fn scan(mesh: &Mesh, n: usize) -> Vec<Point3<f64>> {
    let all = samples(mesh, 8 * n);
    let noise = Normal::new(0.0, 0.07).expect("a deviation above zero");
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let low = mesh.vertices().iter().map(|v| v.z).fold(f64::INFINITY, f64::min);
    let mut points: Vec<Point3<f64>> = all
        .points
        .iter()
        .zip(&all.normals)
        .filter(|(p, n)| n.x > 0.1 && (40.0..165.0).contains(&(p.z - low)))
        .map(|(p, n)| p + n * noise.sample(&mut rng))
        .take(n)
        .collect();
    sort_along_curve(&mut points);
    points
}

pub(crate) fn sort_along_curve(points: &mut [Point3<f64>]) {
    let key = |p: &Point3<f64>| {
        let spread = |v: f64| (0..12).fold(0_u64, |k, b| k | ((v as u64) >> b & 1) << (3 * b));
        let q = (p.coords + Vector3::repeat(2000.0)) * 4.0;
        spread(q.x % 4096.0) | spread(q.y % 4096.0) << 1 | spread(q.z % 4096.0) << 2
    };
    points.sort_by_key(key);
}
