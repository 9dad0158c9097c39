//! Cost of a verdict with all that it runs, by the number of points of the scan.
//!
//! Processor time, the fastest of three runs, on one thread: of the residuals alone, with the registration by shape, and with
//! that of the mirror image. `OSTEOFLOW_BONE` and `OSTEOFLOW_SCAN` (an STL and an XYZ file, registered, mm) take the place of
//! the shaft.

#[path = "normals/bone.rs"]
mod bone;

use nalgebra::{Isometry3, Point3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{Case, EvidenceParams, PredictParams, Registered, RuleParams, Verdict, When, judge};
use osteoflow_geometry::{Cloud, SurfaceOrigin};
use rustix::time::{ClockId, clock_gettime};

/// Processor time of the process, s.
fn processor_time() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn read_xyz(path: &str) -> Vec<Point3<f64>> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{path}: {e}"));
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        (numbers.len() >= 3).then(|| Point3::new(numbers[0], numbers[1], numbers[2]))
    };
    text.lines().filter_map(row).collect()
}

fn verdict(target: &Target, scan: &Cloud, examine: &EvidenceParams) -> Verdict {
    let pose = Isometry3::identity();
    let case = Case::new(Registered { target, source: scan, t_target_source: &pose, at: &[] });
    judge(&case, examine, &RuleParams::default(), &PredictParams::default())
}

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first pool");
    let mesh = bone::bone();
    let samples = bone::samples(&mesh, 150_000);
    let scans = match std::env::var("OSTEOFLOW_SCAN") {
        Ok(path) => vec![read_xyz(&path)],
        Err(_) => [5000, 20_000, 40_000, 100_000].map(|n| bone::scan(&mesh, n)).to_vec(),
    };
    for points in scans {
        let scan = Cloud::new("scan", points).expect("a scan has points");
        let cost = |shape: bool, mirror: When| {
            let examine = EvidenceParams { shape, mirror };
            let once = |_| {
                // The target's index is built before, as for the registration; the map for the search by shape is not.
                let normals = samples.normals.clone();
                let target = Target::new("ct", SurfaceOrigin::User, samples.points.clone(), Some(normals.into()));
                let target = target.expect("samples of a bone").with_mesh(MeshQuery::new(&mesh));
                target.prepare();
                let began = processor_time();
                let verdict = verdict(&target, &scan, &examine);
                assert!(verdict.measured.is_some());
                processor_time() - began
            };
            (0..3).map(once).fold(f64::INFINITY, f64::min)
        };
        let [alone_s, shape_s, mirror_s] = [(false, When::Never), (true, When::Never), (true, When::Always)]
            .map(|(shape, mirror)| cost(shape, mirror));
        println!(
            "{} points: {:.0} ms; with the shape {:.0} ms, with its mirror image {:.0} ms",
            scan.len(),
            alone_s * 1e3,
            shape_s * 1e3,
            mirror_s * 1e3
        );
    }
}
