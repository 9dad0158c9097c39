//! Cost of a prepared target: computed, and loaded from the store. In processor time, which other programs on the machine
//! disturb less than wall time; the fastest of many runs; on one thread unless `THREADS` says otherwise. The store's files
//! are in the system's cache, as directly after writing.
//!
//! `OSTEOFLOW_BONE=fibula.stl cargo bench --bench prepared_target` measures on a bone (STL or PLY, mm), by default on the
//! built-in one; `POINTS=20000` sets the number of points, by default 150 000.

use osteoflow_algorithms::{mesh_query::MeshQuery, sample, target::Target};
use osteoflow_engine::store::{Key, Settings, Store};
use osteoflow_formats::mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud};
use osteoflow_geometry::Mesh;
use osteoflow_node::{Payload, Value};
use osteoflow_payloads::Table;
use osteoflow_simulation::bone::{BoneParams, fibula};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rustix::time::{ClockId, clock_gettime};
use std::path::Path;

const RUNS: usize = 20;

/// Processor time of the process, s.
fn processor_time() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Prints the shortest time of many runs and returns the result of the last.
fn shortest<T>(what: &str, mut run: impl FnMut() -> T) -> T {
    let mut least = f64::INFINITY;
    let mut made = None;
    for _ in 0..RUNS {
        drop(made.take());
        let began = processor_time();
        made = Some(run());
        least = least.min(processor_time() - began);
    }
    println!("{:>8.2} ms  {what}", least * 1e3);
    made.expect("it ran")
}

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{name}={text}: {e}")))
}

fn bone() -> Mesh {
    let Ok(file) = std::env::var("OSTEOFLOW_BONE") else { return fibula(&BoneParams::default()) };
    let bytes = std::fs::read(&file).unwrap_or_else(|e| panic!("{file}: {e}"));
    match read_mesh_or_cloud(Path::new(&file), &bytes, 1.0, "ct") {
        Ok(MeshOrCloud::Mesh(read)) => read.mesh,
        Ok(MeshOrCloud::Cloud(..)) => panic!("{file} holds no surface"),
        Err(error) => panic!("{error}"),
    }
}

fn drawn(mesh: &Mesh, n_points: usize) -> Target {
    let samples = sample::surface(mesh, n_points, &mut ChaCha8Rng::seed_from_u64(1));
    let target = Target::new(&mesh.frame, mesh.origin, samples.points, Some(samples.normals.into()));
    target.expect("a bone has points").with_mesh(MeshQuery::new(mesh))
}

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(number("THREADS", 1)).build_global().expect("the first pool");
    let (mesh, n_points) = (bone(), number("POINTS", 150_000));
    println!("{n_points} points of {} faces", mesh.faces().len());

    shortest("points and normals drawn", || drawn(&mesh, n_points));
    let target = shortest("prepared: drawn and laid out in cells", || {
        let target = drawn(&mesh, n_points);
        target.prepare();
        target
    });

    let dir = tempfile::tempdir().expect("a folder for the store");
    let store = Store::open(Settings::in_dir(dir.path()));
    shortest("key of the mesh", || Key::of("bench").value("mesh", &Value::new(mesh.clone())).done());
    let key = Key::of("bench").text("what", "target").done();
    shortest("target kept in the store", || store.save(&key, &target).expect("the store can be written"));
    shortest("    read from the store, bytes alone", || store.get(&key).expect("it was kept"));
    shortest("    read from the store", || store.load::<Target, Table>(&key).expect("it was kept"));
    let back = shortest("    read from the store and ready to register onto", || {
        let target: Target = store.load(&key).expect("it was kept");
        target.prepare();
        target
    });
    assert_eq!(back.to_view(), target.to_view(), "what is read is what was kept, to the bit");
    let n_bytes: usize = back.to_view().columns.iter().map(|column| column.bytes().len()).sum();
    println!("{:>8.2} MB in the store", n_bytes as f64 / 1e6);
}
