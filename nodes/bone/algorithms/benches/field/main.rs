//! Cost and accuracy of closest-point fields, and whether they pay: for many registrations onto one target, and for the start
//! by shape alone. Times are processor time, the fastest of several runs, on one thread unless `THREADS` says otherwise.
//!
//! `OSTEOFLOW_BONE=fibula.stl cargo bench -p osteoflow-algorithms --bench field` measures on a bone (a binary STL file,
//! mm), by default on an artificial shaft. `POINTS=20000` sets the number of samples (150,000), `STARTS=50` that of
//! registrations (200).

mod bone;
mod pays;

use nalgebra::Vector3;
use osteoflow_algorithms::field::{ClosestPointField, FieldParams};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::Mesh;
use rustix::time::{ClockId, clock_gettime};

/// Processor time of the process, s.
fn processor_time() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// The least time of `n` runs, s, and the result of the last.
pub(crate) fn fastest<T>(n: usize, mut run: impl FnMut() -> T) -> (f64, T) {
    let mut timed = || {
        let began = processor_time();
        let made = run();
        (processor_time() - began, made)
    };
    let (mut least, mut made) = timed();
    for _ in 1..n {
        let (time, again) = timed();
        (least, made) = (least.min(time), again);
    }
    (least, made)
}

pub(crate) fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{name}={text}: {e}")))
}

/// Root mean square, 99th percentile and largest of absolute values.
fn spread(what: &str, values: impl Iterator<Item = f64>) {
    let mut values: Vec<f64> = values.map(f64::abs).collect();
    values.sort_by(f64::total_cmp);
    let Some(most) = values.last() else { return };
    let rms = (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    println!(
        "    {what}: RMS {rms:.4}, median {:.4}, 99 % {:.4}, most {most:.4}",
        values[values.len() / 2],
        values[values.len() * 99 / 100]
    );
}

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(number("THREADS", 1)).build_global().expect("the first pool");
    let mesh = bone::bone();
    let samples = bone::samples(&mesh, number("POINTS", 150_000));
    let query = MeshQuery::new(&mesh);
    println!("{} faces, {} samples", mesh.faces().len(), samples.points.len());

    for params in [FieldParams::default(), FieldParams { fine_mm: 0.5, ..FieldParams::default() }] {
        let (mesh_s, of_mesh) = fastest(3, || ClosestPointField::of_mesh(&query, &params).expect("a bone"));
        let (points_s, of_points) =
            fastest(3, || ClosestPointField::of_points(&samples.points, &samples.normals, &params).expect("a bone"));
        for (name, build_s, field) in [("mesh", mesh_s, &of_mesh), ("points", points_s, &of_points)] {
            let megabytes = field.n_bytes() as f64 / 1e6;
            let per_node = build_s * 1e9 / (field.n_bytes() as f64 / 16.0);
            println!(
                "of_{name}, {} mm: made in {:.0} ms ({per_node:.0} ns a node), {megabytes:.1} MB",
                params.fine_mm,
                build_s * 1e3
            );
            look_up(&mesh, field);
            for reach_mm in [1.0, params.band_mm] {
                accuracy(&mesh, &query, field, reach_mm);
            }
        }
    }
    closest_points(&mesh, &query);
    pays::registrations(&mesh, &samples);
    pays::start_by_shape(&mesh, &samples);
}

fn look_up(mesh: &Mesh, field: &ClosestPointField) {
    let scan = bone::scan(mesh, 20_000);
    let sum = |away: f64, one: &dyn Fn(&Vector3<f64>) -> f64| {
        let local: Vec<_> = scan.iter().map(|p| p - field.centre() + Vector3::x() * away).collect();
        let (time, _) = fastest(100, || local.iter().map(one).sum::<f64>());
        time * 1e9 / scan.len() as f64
    };
    let view = field.view();
    let near = sum(0.0, &|v| view.at_local(v).map_or(0.0, |s| s.distance_mm));
    let far = sum(10.0, &|v| view.at_local(v).map_or(0.0, |s| s.distance_mm));
    let columns = field.to_columns();
    let (load, _) = fastest(20, || ClosestPointField::from_columns(columns.clone()).expect("its own columns"));
    println!("    a look-up: {near:.1} ns, 10 mm off {far:.1} ns; loaded in {:.2} ms", load * 1e3);
}

/// Closest points of the mesh at the nodes of one cell layer, beside the field's own search.
fn closest_points(mesh: &Mesh, query: &MeshQuery) {
    let drawn = bone::samples(mesh, 20_000);
    let mut places: Vec<_> = drawn.points.iter().zip(&drawn.normals).map(|(p, n)| p + n * 1.5).collect();
    bone::sort_along_curve(&mut places);
    let (time, _) = fastest(5, || places.iter().filter_map(|p| query.closest_point(p)).count());
    println!("closest point of the mesh, neighbours one after the other: {:.0} ns", time * 1e9 / places.len() as f64);
}

/// Against the closest point on the mesh, at places up to `reach_mm` off the surface.
fn accuracy(mesh: &Mesh, query: &MeshQuery, field: &ClosestPointField, reach_mm: f64) {
    let drawn = bone::samples(mesh, 50_000);
    let mut errors = Vec::new();
    let (mut n_none, mut n_other_side) = (0, 0);
    for (k, (p, n)) in drawn.points.iter().zip(&drawn.normals).enumerate() {
        let height = reach_mm * (2.0 * (k as f64 * 0.618_034).fract() - 1.0);
        let place = p + n * height;
        let Some(exact) = query.closest_point(&place).filter(|c| c.distance_mm > 1e-3) else { continue };
        let Some(found) = field.at(&place) else {
            n_none += 1;
            continue;
        };
        let signed = exact.distance_mm.copysign(height);
        // A thin part: the way along the normal has left it on the other side.
        if found.distance_mm * height < -0.2 * height.abs() {
            n_other_side += 1;
            continue;
        }
        let normal = (place - exact.point) / signed;
        errors.push((found.distance_mm - signed, found.normal.angle(&normal).to_degrees()));
    }
    println!(
        "  within {reach_mm} mm of the surface ({} places, {n_none} without answer, {n_other_side} through a thin part):",
        errors.len()
    );
    spread("distance, mm", errors.iter().map(|e| e.0));
    spread("normal, degrees", errors.iter().map(|e| e.1));
}
