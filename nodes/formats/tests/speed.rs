//! Time to read a large cloud; `cargo test --release -p osteoflow-formats --test speed -- --ignored --nocapture` prints it.
#![allow(clippy::unwrap_used)]

use osteoflow_formats::mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud};
use std::time::{Duration, Instant};

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

#[test]
#[ignore = "measures time"]
fn a_million_points_with_normals_are_read_in_a_few_hundredths_of_a_second() {
    let bytes = ply();
    let mut least = Duration::MAX;
    for _ in 0..15 {
        let began = Instant::now();
        let read = read_mesh_or_cloud("a.ply".as_ref(), &bytes, 1.0, "camera").unwrap();
        least = least.min(began.elapsed());
        let MeshOrCloud::Cloud(read, notes) = read else { panic!("a mesh") };
        assert_eq!((read.cloud.len(), read.cloud.normals().map(<[_]>::len)), (N_POINTS, Some(N_POINTS)));
        assert_eq!(notes, [""; 0]);
    }
    println!("{:.1} ms, the shortest of 15", least.as_secs_f64() * 1e3);
    assert!(least < Duration::from_millis(200), "{least:?}");
}
