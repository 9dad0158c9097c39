//! Time to read a million points, alone and with normals, from a PLY in memory: the shortest of 15 and the median.
//!
//! `cargo bench -p osteoflow-formats --bench read_ply`
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed bench, with its line")]

use osteoflow_formats::mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud};
use std::time::Instant;

const N_POINTS: usize = 1_000_000;

/// A million points as single-precision PLY, already in memory.
fn ply(with_normals: bool) -> Vec<u8> {
    let n_columns = if with_normals { 6 } else { 3 };
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {N_POINTS}\n").into_bytes();
    for name in &["x", "y", "z", "nx", "ny", "nz"][..n_columns] {
        bytes.extend(format!("property float {name}\n").bytes());
    }
    bytes.extend(b"end_header\n");
    for k in 0..N_POINTS {
        let angle = k as f32 * 1e-3;
        let row = [50.0 * angle.cos(), 50.0 * angle.sin(), k as f32 * 1e-4, angle.cos(), angle.sin(), 0.0];
        bytes.extend(row[..n_columns].iter().flat_map(|c| c.to_le_bytes()));
    }
    bytes
}

fn main() {
    for (with_normals, what) in [(false, "points"), (true, "points and normals")] {
        let bytes = ply(with_normals);
        let mut times_ms: Vec<f64> = (0..15).map(|_| read_ms(&bytes, with_normals)).collect();
        times_ms.sort_by(f64::total_cmp);
        println!("{what}: {:.1} ms shortest, {:.1} ms median of {}", times_ms[0], times_ms[7], times_ms.len());
    }
}

fn read_ms(bytes: &[u8], with_normals: bool) -> f64 {
    let began = Instant::now();
    let read = read_mesh_or_cloud("a.ply".as_ref(), bytes, 1.0, "camera").unwrap();
    let took_ms = began.elapsed().as_secs_f64() * 1e3;
    let MeshOrCloud::Cloud(read, notes) = read else { panic!("a mesh") };
    let n_normals = read.cloud.normals().map(<[_]>::len);
    assert_eq!((read.cloud.len(), n_normals), (N_POINTS, with_normals.then_some(N_POINTS)));
    assert_eq!(notes, [""; 0]);
    took_ms
}
