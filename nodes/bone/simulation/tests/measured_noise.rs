//! Scans and poses with the noise of real scanners and trackers, measured as theirs was.

use crate::common::shared::simulate;
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::nalgebra::{Point3, Vector3};
use osteoflow_simulation::ProcedureParams;

/// Upper ends of the distances, mm, between which residuals are compared, from 0.3 mm on.
const DISTANCES_MM: [f64; 6] = [0.8, 1.5, 3.0, 5.0, 8.0, 12.0];

/// Residuals of a scan at the truth.
struct Residuals {
    /// By the median of their sizes, mm.
    sd_mm: f64,
    /// Share beyond five of these.
    outliers: f64,
    /// Correlation at each of the distances, of those that are not.
    correlation: [f64; 6],
}

fn residuals(params: &ProcedureParams, seed: u64) -> Residuals {
    let procedure = simulate(params, seed);
    let truth = &procedure.truth;
    let t_ct_camera = truth.t_world_ct_at_scan.isometry.inverse() * truth.t_world_camera_at_scan.isometry;
    let surface = MeshQuery::new(&truth.bone);
    let mut at: Vec<(Point3<f64>, f64)> = procedure
        .scan
        .points()
        .iter()
        .map(|p| {
            let p = t_ct_camera * p;
            let near = surface.closest_point(&p).unwrap();
            (p, (p - near.point).dot(&near.normal))
        })
        .collect();
    let middle = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let median = middle(&mut at.iter().map(|(_, r)| *r).collect());
    at.iter_mut().for_each(|(_, r)| *r -= median);
    let sd_mm = 1.4826 * middle(&mut at.iter().map(|(_, r)| r.abs()).collect());
    let n = at.len() as f64;
    at.retain(|(_, r)| r.abs() < 5.0 * sd_mm);
    let outliers = 1.0 - at.len() as f64 / n;
    let variance = at.iter().map(|(_, r)| r * r).sum::<f64>() / at.len() as f64;
    let (mut sums, mut counts) = ([0.0; 6], [0.0; 6]);
    for (k, (p, r)) in at.iter().enumerate() {
        for (q, other) in &at[..k] {
            let apart = (p - q).norm();
            if let Some(bin) = DISTANCES_MM.iter().position(|end| apart < *end).filter(|_| apart > 0.3) {
                sums[bin] += r * other;
                counts[bin] += 1.0;
            }
        }
    }
    Residuals { sd_mm, outliers, correlation: std::array::from_fn(|bin| sums[bin] / counts[bin] / variance) }
}

#[test]
fn a_scans_residuals_are_correlated_over_millimetres_and_have_outliers_at_edges_as_those_of_real_scanners() {
    const SEEDS: u64 = 6;
    let mut params = ProcedureParams::default();
    // As far apart as the pixels of the laser scanner, and few enough to compare all with all.
    params.camera.n_points = 5000;
    let of: Vec<Residuals> = (0..SEEDS).map(|seed| residuals(&params, seed)).collect();
    let mean = |value: &dyn Fn(&Residuals) -> f64| of.iter().map(value).sum::<f64>() / SEEDS as f64;
    let (sd_mm, outliers) = (mean(&|r| r.sd_mm), mean(&|r| r.outliers));
    let correlation: [f64; 6] = std::array::from_fn(|bin| mean(&|r| r.correlation[bin]));
    println!("SD {sd_mm:.3} mm, beyond 5 SD {:.2} %, correlation {correlation:.2?}", 100.0 * outliers);
    // Four laser scans on the model merged from them: SD 0.087 to 0.098 mm, 1.0 to 2.1 % beyond 5 SD; each bin of theirs, and
    // 0.1 beyond, since a run has its own waves.
    assert!((0.08..0.11).contains(&sd_mm), "{sd_mm} mm");
    assert!((0.01..0.021).contains(&outliers), "{outliers} beyond 5 SD");
    let measured = [[0.7, 0.9], [0.7, 0.7], [0.5, 0.6], [0.4, 0.4], [0.3, 0.3], [0.13, 0.21]];
    for ([low, high], (found, end)) in measured.into_iter().zip(correlation.into_iter().zip(DISTANCES_MM)) {
        assert!((low - 0.1..high + 0.1).contains(&found), "{found} up to {end} mm, {low} to {high} of real scanners");
    }
    let white = {
        params.camera.surface_error_mm = 0.0;
        params.camera.edge_outliers = 0.0;
        params.camera.depth_bias_mm = 0.0;
        residuals(&params, 1)
    };
    assert!(white.correlation[2].abs() < 0.05 && white.outliers < 1e-3, "switched off, the noise is white");
}

#[test]
fn a_marker_at_rest_has_steps_correlated_noise_repeats_and_losses_in_a_row_as_real_ones() {
    let mut params = ProcedureParams::default();
    // A marker that is hidden now and then; the default loses each sample by itself.
    params.tracker.lost_run = 3.0;
    let (mut products, mut squares, mut n_repeats, mut n_lost, mut n_in_a_row, mut n) = (0.0, 0.0, 0, 0, 0, 0);
    for seed in 0..40 {
        let procedure = simulate(&ProcedureParams { camera: few_points(&params), ..params.clone() }, seed);
        let poses = &procedure.bone_marker;
        let period_ns = 50_000_000;
        // The touches: 18 s at rest.
        let from_ns = procedure.stylus_init.points[0].stamp_ns;
        let rest: Vec<_> = poses.iter().filter(|p| (0..18_000_000_000).contains(&(p.stamp_ns - from_ns))).collect();
        let at = |k: usize| rest[k].isometry.translation.vector;
        let mean = (0..rest.len()).map(at).sum::<Vector3<f64>>() / rest.len() as f64;
        for k in 1..rest.len() {
            let n_periods = (rest[k].stamp_ns - rest[k - 1].stamp_ns) / period_ns;
            n += n_periods;
            n_lost += n_periods - 1;
            n_in_a_row += (n_periods - 2).max(0);
            n_repeats += usize::from(rest[k].isometry == rest[k - 1].isometry);
            if n_periods == 1 {
                products += (at(k) - mean).dot(&(at(k - 1) - mean));
                squares += (at(k) - mean).norm_squared();
            }
            let steps = at(k) / params.tracker.step_mm;
            let off = (steps - steps.map(f64::round)).amax();
            assert!(off < 1e-6, "{} is no whole number of steps", at(k));
        }
    }
    let (lag1, repeats, lost) = (products / squares, n_repeats as f64 / n as f64, n_lost as f64 / n as f64);
    let in_a_row = n_in_a_row as f64 / n_lost as f64;
    println!("lag-1 {lag1:.2}, {repeats:.3} repeat, {lost:.3} lost, {in_a_row:.2} of these after another");
    // The drift of the localiser, 0.015 mm in these 18 s, adds 0.01.
    assert!((0.7..0.96).contains(&lag1), "{lag1}");
    assert!((repeats - params.tracker.repeats).abs() < 0.03, "{repeats} repeat the sample before");
    assert!((lost - params.tracker.lost).abs() < 0.01, "{lost} are lost");
    assert!((in_a_row - (1.0 - 1.0 / params.tracker.lost_run)).abs() < 0.1, "{in_a_row} of these after another");
}

fn few_points(params: &ProcedureParams) -> osteoflow_simulation::CameraParams {
    osteoflow_simulation::CameraParams { n_points: 500, ..params.camera.clone() }
}
