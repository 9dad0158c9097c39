//! Cost and accuracy of estimated normals, beside those of a plane through the exact twenty nearest points of a kd-tree.
//!
//! Processor time, the fastest of some runs, on one thread.

mod bone;

use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_algorithms::nearest::Nearest;
use osteoflow_algorithms::normals;
use rustix::time::{ClockId, clock_gettime};

/// Processor time of the process, s.
fn processor_time() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn timed<T>(n: usize, mut run: impl FnMut() -> T) -> (f64, Option<T>) {
    (0..n).fold((f64::INFINITY, None), |(least, _), _| {
        let began = processor_time();
        let made = run();
        (least.min(processor_time() - began), Some(made))
    })
}

/// Normals of the planes through the twenty nearest points.
fn of_twenty_nearest(points: &[Point3<f64>]) -> Vec<Vector3<f64>> {
    let tree = Nearest::new(points);
    points
        .iter()
        .map(|point| {
            let near: Vec<_> = tree.nearest_n(point, 20).iter().map(|&(k, _)| points[k] - point).collect();
            let mean = near.iter().sum::<Vector3<f64>>() / near.len() as f64;
            let spread: Matrix3<f64> = near.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
            let eigen = spread.symmetric_eigen();
            eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned()
        })
        .collect()
}

/// Prints the angles between normals of either sign, degrees.
fn apart(what: &str, a: &[Vector3<f64>], b: &[Vector3<f64>]) {
    let mut angles: Vec<f64> = a.iter().zip(b).map(|(a, b)| a.angle(b).min((-a).angle(b)).to_degrees()).collect();
    angles.sort_by(f64::total_cmp);
    let rms = (angles.iter().map(|v| v * v).sum::<f64>() / angles.len() as f64).sqrt();
    println!(
        "  {what}: RMS {rms:.2}, median {:.2}, 99 % {:.2} degrees",
        angles[angles.len() / 2],
        angles[angles.len() * 99 / 100]
    );
}

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first pool");
    let bone = bone::bone();
    let samples = bone::samples(&bone, 150_000);
    for points in [&bone::scan(&bone, 20_000), &samples.points] {
        let (ours_s, _) = timed(5, || normals::of_surface(points).expect("a bone"));
        let (exact_s, _) = timed(3, || of_twenty_nearest(points));
        println!("{} points: {:.0} ms; of the twenty nearest {:.0} ms", points.len(), ours_s * 1e3, exact_s * 1e3);
    }
    let ours = normals::of_surface(&samples.points).expect("a bone");
    let exact = of_twenty_nearest(&samples.points);
    apart("from each other", &ours, &exact);
    apart("from the faces", &ours, &samples.normals);
    apart("twenty nearest from the faces", &exact, &samples.normals);
    let inwards = ours.iter().zip(&samples.normals).filter(|(a, b)| a.dot(b) < 0.0).count();
    println!("  {inwards} point inwards");
}
