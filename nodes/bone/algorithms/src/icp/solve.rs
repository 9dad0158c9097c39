//! Steps from the normal equations.

use super::normal_equations::NormalEquations;
use super::observability::{FREE_PER_MM, sorted_eigen};
use super::state::State;
use crate::kabsch::from_covariance;
use nalgebra::{Matrix6, Point3, Vector6};

/// The Gauss-Newton step `-H⁺ b` about the source's centroid, mm.
///
/// For `point_to_point`, `H` is that along the target's normals: pairs change while points slide along the surface, so the
/// residual curves no more than for planes, although the plain step assumes fixed pairs.
pub(super) fn gauss_newton(equations: &NormalEquations) -> Vector6<f64> {
    solve(&(equations.h / equations.weight), &(equations.b / equations.weight))
}

/// The Levenberg-Marquardt step: [`gauss_newton`] with the diagonal of `H` enlarged by `damping`.
pub(super) fn levenberg_marquardt(equations: &NormalEquations, damping: f64) -> Vector6<f64> {
    let mut h = equations.h / equations.weight;
    for k in 0..6 {
        h[(k, k)] *= 1.0 + damping;
    }
    solve(&h, &(equations.b / equations.weight))
}

/// The state after Kabsch's motion for these pairs.
pub(super) fn kabsch(state: &State, equations: &NormalEquations, lever_arm_mm: f64) -> State {
    let n = equations.weight;
    let (source, target) = (equations.source_sum / n, equations.target_sum / n);
    let covariance = equations.cross_products - target * source.transpose() * n;
    let Some(motion) = from_covariance(&covariance, &Point3::from(target), &Point3::from(source)) else {
        // Points on a line: the smallest motion that does as well, without a turn about the line.
        return state.moved(&solve(&(equations.h_points / n), &(equations.b / n)), lever_arm_mm);
    };
    let mut rotation = motion.rotation * state.rotation;
    rotation.renormalize();
    State { rotation, centroid: state.centroid + motion.translation.vector }
}

/// The eigenvector of `H` with the smallest eigenvalue outside the nullspace, 1 mm long.
pub(super) fn weakest_motion(equations: &NormalEquations) -> Option<Vector6<f64>> {
    let (values, vectors) = sorted_eigen(&(equations.h / equations.weight));
    let k = (0..6).rfind(|&k| is_determined(values[k]))?;
    Some(vectors.column(k).into_owned())
}

/// Standard deviation of the minimum's position from the noise of the residuals, mm.
pub(super) fn sigma_mm(equations: &NormalEquations) -> f64 {
    let (values, _) = sorted_eigen(&(equations.h / equations.weight));
    let variance: f64 = values.iter().filter(|v| is_determined(**v)).map(|v| 1.0 / v).sum();
    equations.rms_mm() * (variance / equations.n_pairs as f64).sqrt()
}

/// How far from its minimum a point-to-point residual can become stationary among the target's samples, mm: the standard
/// deviation that random offsets of the target points along the surface give to [`gauss_newton`].
pub(super) fn resolution_mm(equations: &NormalEquations) -> f64 {
    let (values, vectors) = sorted_eigen(&(equations.h / equations.weight));
    let determined = (0..6).filter(|&k| is_determined(values[k]));
    determined.map(|k| sampling_variance(equations, &vectors.column(k).into_owned(), values[k])).sum::<f64>().sqrt()
}

/// [`gauss_newton`], shrunk along each eigenvector by `1 - variance / step²`, where the variance is that of the target's
/// sampling; zero where the variance exceeds the squared step. With few pairs or sparse samples only turns survive.
///
/// Source: James and Stein 1961, the positive-part rule for each eigenvector.
pub(super) fn shrunk_gauss_newton(equations: &NormalEquations) -> Vector6<f64> {
    let (values, vectors) = sorted_eigen(&(equations.h / equations.weight));
    let b = equations.b / equations.weight;
    let determined = (0..6).filter(|&k| is_determined(values[k]));
    determined.fold(Vector6::zeros(), |delta, k| {
        let v: Vector6<f64> = vectors.column(k).into_owned();
        let length = v.dot(&b) / values[k];
        let share = 1.0 - sampling_variance(equations, &v, values[k]) / (length * length);
        if share > 0.0 { delta - v * (length * share) } else { delta }
    })
}

/// Variance of the step along an eigenvector from random offsets of the target points along the surface, mm².
fn sampling_variance(equations: &NormalEquations, eigenvector: &Vector6<f64>, eigenvalue: f64) -> f64 {
    // Half of the squared offset along the surface falls on each of its two directions.
    let offset_square = (equations.point_squares - equations.plane_squares).max(0.0) / equations.weight / 2.0;
    let along_surface = (equations.h_points - equations.h) / equations.weight;
    let n_pairs = equations.n_pairs as f64;
    (eigenvector.dot(&(along_surface * eigenvector)) * offset_square / (n_pairs * eigenvalue * eigenvalue)).max(0.0)
}

/// `-H⁺ b`: zero along the nullspace.
fn solve(h: &Matrix6<f64>, b: &Vector6<f64>) -> Vector6<f64> {
    let (values, vectors) = sorted_eigen(h);
    (0..6).filter(|&k| is_determined(values[k])).fold(Vector6::zeros(), |delta, k| {
        let v: Vector6<f64> = vectors.column(k).into_owned();
        delta - v * (v.dot(b) / values[k])
    })
}

/// Whether an eigenvalue of `H / n` is outside the nullspace.
fn is_determined(eigenvalue: f64) -> bool {
    eigenvalue >= FREE_PER_MM * FREE_PER_MM
}
