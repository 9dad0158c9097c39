//! Registers the points of one file onto those of another, x y z in mm by line: `cargo run --example register_points TARGET SOURCE`.
use osteoflow_algorithms::{icp, normals, target::Target};
use osteoflow_geometry::{
    SurfaceOrigin,
    nalgebra::{Isometry3, Point3},
};
use std::{env, error::Error, fs, ops::ControlFlow};

fn points(path: &str) -> Result<Vec<Point3<f64>>, Box<dyn Error>> {
    let point = |line: &str| {
        let numbers: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [x, y, z] = numbers[..] else { return Err(format!("{path}: {line}: three numbers are expected").into()) };
        Ok(Point3::new(x, y, z))
    };
    fs::read_to_string(path)?.lines().map(point).collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let shipped = |name| format!("{}/examples/{name}.xyz", env!("CARGO_MANIFEST_DIR"));
    let file = |k, name| env::args().nth(k).unwrap_or_else(|| shipped(name));
    let (bone, scan) = (points(&file(1, "bone"))?, points(&file(2, "scan"))?);
    let normals = normals::of_surface(&bone)?;
    let target = Target::new("ct", SurfaceOrigin::Exact, bone, Some(normals.into()))?;
    let (method, start) = (icp::Method::PointToPlane, Isometry3::identity());
    let fit = icp::register(method, &target, &scan, &start, &Default::default(), &mut |step| {
        println!("{} RMS {:.3} mm", step.iteration, step.rms_mm);
        ControlFlow::Continue(())
    })?;
    assert!(fit.report.converged, "more iterations, or a start that is nearer");
    println!("{:.4}", fit.t_target_source.to_homogeneous());
    Ok(())
}
