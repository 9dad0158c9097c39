//! Cost of cutting a fragment out of a bone, by the number of edges in the outlines of its cuts.
//!
//! Processor time, the fastest of five runs, on a tube with a marrow canal.

use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::fragment::{between, fragment};
use osteoflow_geometry::{Mesh, Plane, Planes, SurfaceOrigin};
use rustix::time::{ClockId, clock_gettime};

/// Two bumpy walls along z, 100 mm long, each with `around` points per ring.
fn tube(around: u32) -> Mesh {
    const RINGS: u32 = 51;
    let wall = |inner: bool| {
        (0..RINGS).flat_map(move |i| (0..around).map(move |j| (i, j))).map(move |(i, j)| {
            let (z, turn) = (f64::from(i) * 2.0, f64::from(j) / f64::from(around) * std::f64::consts::TAU);
            let radius = if inner { 3.0 } else { 7.0 + 0.9 * (3.0 * turn).cos() + 0.3 * (17.0 * turn + z).sin() };
            Point3::new(radius * turn.cos(), radius * turn.sin(), z)
        })
    };
    let vertices: Vec<_> = wall(false).chain(wall(true)).collect();
    let faces = (0..2).flat_map(|inner| (0..RINGS - 1).flat_map(move |i| (0..around).map(move |j| (inner, i, j))));
    let faces: Vec<[u32; 3]> = faces
        .flat_map(|(inner, i, j)| {
            let at = |i: u32, j: u32| (inner * RINGS + i) * around + j % around;
            let (a, b, c, d) = (at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1));
            if inner == 0 { [[a, b, c], [b, d, c]] } else { [[a, c, b], [b, c, d]] }
        })
        .collect();
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).expect("a tube is a mesh")
}

/// Processor time of the process, s.
fn processor_time() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn main() {
    let plane = |z: f64, tilt: f64| Isometry3::new(Vector3::new(0.0, 0.0, z), Vector3::new(tilt, 0.7 * tilt, 0.0));
    let planes = Planes::new("ct", vec![Plane::new("a", plane(33.3, 0.2)), Plane::new("b", plane(67.1, -0.1))]);
    for around in [60, 240, 960] {
        let bone = tube(around);
        let cuts = between(&bone, &planes).expect("both planes cut the tube");
        let mut least_s = f64::INFINITY;
        let mut piece = fragment(&bone, &cuts).expect("the tube is closed at the cuts");
        for _ in 0..5 {
            let began = processor_time();
            piece = fragment(&bone, &cuts).expect("the tube is closed at the cuts");
            least_s = least_s.min(processor_time() - began);
        }
        let (n_faces, volume_mm3) = (piece.mesh.faces().len(), piece.mesh.volume_mm3());
        println!("{around} points per ring: {:.2} ms, {n_faces} faces, {volume_mm3:.9} mm3", least_s * 1e3);
    }
}
