//! Time to read a million points with normals from a PLY in memory, the shortest of 15 and the median.
//!
//! `cargo bench -p osteoflow-formats --bench read_ply`
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed bench, with its line")]

use osteoflow_formats::mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud};
use std::time::Instant;

const N_POINTS: usize = 1_000_000;

/// A million points with normals as single-precision PLY, already in memory.
fn ply() -> Vec<u8> {
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {N_POINTS}\n").into_bytes();
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        bytes.extend(format!("property float {name}\n").bytes());
    }
    bytes.extend(b"end_header\n");
    for k in 0..N_POINTS {
        let angle = k as f32 * 1e-3;
        let row = [50.0 * angle.cos(), 50.0 * angle.sin(), k as f32 * 1e-4, angle.cos(), angle.sin(), 0.0];
        bytes.extend(row.iter().flat_map(|c| c.to_le_bytes()));
    }
    bytes
}

fn main() {
    let bytes = ply();
    let mut times_ms: Vec<f64> = (0..15)
        .map(|_| {
            let began = Instant::now();
            let read = read_mesh_or_cloud("a.ply".as_ref(), &bytes, 1.0, "camera").unwrap();
            let took_ms = began.elapsed().as_secs_f64() * 1e3;
            let MeshOrCloud::Cloud(read, notes) = read else { panic!("a mesh") };
            assert_eq!((read.cloud.len(), read.cloud.normals().map(<[_]>::len)), (N_POINTS, Some(N_POINTS)));
            assert_eq!(notes, [""; 0]);
            took_ms
        })
        .collect();
    times_ms.sort_by(f64::total_cmp);
    println!("{:.1} ms shortest, {:.1} ms median of {}", times_ms[0], times_ms[times_ms.len() / 2], times_ms.len());
}
