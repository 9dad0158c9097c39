//! From sums over pairs to a motion.

use super::acceleration::State;
use super::observability::{FREE_PER_MM, sorted_eigen};
use super::sums::Sums;
use crate::kabsch::from_covariance;
use nalgebra::{Matrix6, Point3, Vector6};

/// The motion to where the residual has its least if the surface is as the normals say: `-N⁺ Jᵀr` (Gauss-Newton), about
/// the source's centroid, all in mm.
///
/// For points, whose partners change as they slide, the residual bends along the surface no more than for planes,
/// although the plain step believes it does; so this is the way to go.
pub(super) fn newton(sums: &Sums) -> Vector6<f64> {
    least_step(&(sums.hold / sums.weight), &(sums.gradient / sums.weight))
}

/// The same with the diagonal of the normal matrix enlarged by `damping` (Levenberg-Marquardt).
pub(super) fn damped(sums: &Sums, damping: f64) -> Vector6<f64> {
    let mut hold = sums.hold / sums.weight;
    for k in 0..6 {
        hold[(k, k)] *= 1.0 + damping;
    }
    least_step(&hold, &(sums.gradient / sums.weight))
}

/// Where Kabsch's step on these pairs leads.
pub(super) fn kabsch(state: &State, sums: &Sums, lever_arm_mm: f64) -> State {
    let n = sums.weight;
    let (arm, offset) = (sums.arm / n, sums.offset / n);
    let covariance = sums.offset_arm - offset * arm.transpose() * n;
    let Some(turn) = from_covariance(&covariance, &Point3::from(offset), &Point3::from(arm)) else {
        // Points on a line: the smallest motion that does as well, without a turn about the line.
        return state.moved(&least_step(&(sums.grip / n), &(sums.gradient / n)), lever_arm_mm);
    };
    let mut rotation = turn.rotation * state.rotation;
    rotation.renormalize();
    State { rotation, centre: state.centre + turn.translation.vector }
}

/// The motion that the pairs hold least among those they hold, of length 1 mm.
pub(super) fn weakest(sums: &Sums) -> Option<Vector6<f64>> {
    let (values, vectors) = sorted_eigen(&(sums.hold / sums.weight));
    let k = (0..6).rfind(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM)?;
    Some(vectors.column(k).into_owned())
}

/// How far the noise of the residuals alone moves the least, mm, one standard deviation.
pub(super) fn grain_mm(sums: &Sums) -> f64 {
    let (values, _) = sorted_eigen(&(sums.hold / sums.weight));
    let loose: f64 = values.iter().filter(|v| **v >= FREE_PER_MM * FREE_PER_MM).map(|v| 1.0 / v).sum();
    sums.rms_mm() * (loose / sums.n as f64).sqrt()
}

/// How far from its least the residual of points can come to rest among the target's samples, mm: what a random offset of
/// the partners along the surface does to [`newton`], one standard deviation.
pub(super) fn resolution_mm(sums: &Sums) -> f64 {
    let (values, vectors) = sorted_eigen(&(sums.hold / sums.weight));
    let held = (0..6).filter(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM);
    held.map(|k| chance(sums, &vectors.column(k).into_owned(), values[k])).sum::<f64>().sqrt()
}

/// [`newton`] without what such an offset may have done to it: along each motion that the pairs hold more or less, the step
/// is shortened by `1 - variance / step²`, and not taken where it is no longer than chance would make it (the positive-part
/// rule of James & Stein 1961, motion by motion). Few pairs, or pairs with sparse samples, tell a turn but no slide.
pub(super) fn told(sums: &Sums) -> Vector6<f64> {
    let (values, vectors) = sorted_eigen(&(sums.hold / sums.weight));
    let gradient = sums.gradient / sums.weight;
    let held = (0..6).filter(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM);
    held.fold(Vector6::zeros(), |step, k| {
        let v: Vector6<f64> = vectors.column(k).into_owned();
        let way = v.dot(&gradient) / values[k];
        let share = 1.0 - chance(sums, &v, values[k]) / (way * way);
        if share > 0.0 { step - v * (way * share) } else { step }
    })
}

/// The variance, mm², that random offsets of the partners along the surface give to the step along a motion.
fn chance(sums: &Sums, motion: &Vector6<f64>, hold: f64) -> f64 {
    // Half of the squared offset along the surface falls on each of its two directions.
    let offset_square = (sums.point_squares - sums.plane_squares).max(0.0) / sums.weight / 2.0;
    let loose = (sums.grip - sums.hold) / sums.weight;
    (motion.dot(&(loose * motion)) * offset_square / (sums.n as f64 * hold * hold)).max(0.0)
}

/// `-H⁺ g`: the least of a quadratic model, leaving alone the motions that it leaves free.
fn least_step(hessian: &Matrix6<f64>, gradient: &Vector6<f64>) -> Vector6<f64> {
    let (values, vectors) = sorted_eigen(hessian);
    (0..6).filter(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM).fold(Vector6::zeros(), |step, k| {
        let v: Vector6<f64> = vectors.column(k).into_owned();
        step - v * (v.dot(gradient) / values[k])
    })
}
