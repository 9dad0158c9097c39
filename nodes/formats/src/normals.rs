use nalgebra::Vector3;
use osteoflow_geometry::{ROUNDED_ROTATION, direction};

/// By how much the squared length of a unit normal in single precision differs from 1 at most, generously.
const ROUNDED_TO_SINGLE: f64 = 1e-6;

/// Normals of any length, scaled to length 1, and what was done to them, one sentence each; none if one has no direction.
///
/// A normal is a direction: scaling it moves nothing, so any length but zero is taken. Lengths that rounding does not explain
/// are reported.
pub(crate) fn unit_normals(mut normals: Vec<Vector3<f64>>) -> (Option<Vec<Vector3<f64>>>, Vec<String>) {
    let (mut n_bad, mut n_scaled, mut shortest, mut longest) = (0, 0, f64::INFINITY, 0.0_f64);
    for normal in &mut normals {
        let excess = normal.norm_squared() - 1.0;
        // A NaN compares as false.
        if excess.abs() <= ROUNDED_TO_SINGLE {
            // 1 / sqrt(1 + excess) to 1e-18, without root and division.
            *normal *= 1.0 - excess * (0.5 - 0.375 * excess);
            continue;
        }
        let length = normal.norm();
        if (length - 1.0).abs() <= ROUNDED_ROTATION {
            *normal /= length;
            continue;
        }
        let Ok(unit) = direction(*normal) else {
            n_bad += 1;
            continue;
        };
        (shortest, longest) = (shortest.min(length), longest.max(length));
        n_scaled += 1;
        *normal = unit.into_inner();
    }
    let n = normals.len();
    if n_bad > 0 {
        let note = format!("{n_bad} of {n} normals are zero or not finite, so the cloud goes without normals");
        return (None, vec![note]);
    }
    let note = (n_scaled > 0).then(|| {
        format!("{n_scaled} of {n} normals have lengths from {shortest:.3e} to {longest:.3e} and were scaled to 1")
    });
    (Some(normals), note.into_iter().collect())
}
