use nalgebra::Vector3;
use osteoflow_geometry::{ROUNDED_ROTATION, direction};

/// By how much the squared length of a unit normal in single precision differs from 1 at most, generously.
const ROUNDED_TO_SINGLE: f64 = 1e-6;

/// Normals of any length, scaled to length 1, and what was done to them, one sentence each; none if one has no direction.
///
/// A normal is a direction: scaling it moves nothing, so any length from 1e-6 on is taken. Lengths that rounding does not explain
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

#[cfg(test)]
mod tests {
    use super::*;

    fn scaled(lengths: &[f64]) -> (Option<Vec<f64>>, Vec<String>) {
        let along = Vector3::new(0.6, 0.0, -0.8);
        let (normals, notes) = unit_normals(lengths.iter().map(|length| along * *length).collect());
        let lengths = normals.map(|normals| {
            assert!(
                normals.iter().all(|n| (n.normalize() - along).norm() < 1e-15),
                "a direction stays: rounding alone"
            );
            normals.iter().map(|n| n.norm()).collect()
        });
        (lengths, notes)
    }

    #[test]
    fn normals_have_length_1_to_the_last_digit_and_only_what_rounding_does_not_explain_is_noted() {
        let rounded = 0.9 * ROUNDED_ROTATION;
        let (lengths, notes) = scaled(&[1.0, 1.0 + 4e-7, 1.0 - 4e-7, 1.0 + rounded, 1.0 - rounded]);
        // 4e-16: two roundings of a length of 1.
        assert!(lengths.as_ref().unwrap().iter().all(|length| (length - 1.0).abs() < 4e-16), "{lengths:?}");
        assert_eq!(notes, [""; 0]);
        let (lengths, notes) = scaled(&[1.0, 1.0 + 1.1 * ROUNDED_ROTATION, 0.25, 1e-3, 1.0]);
        assert!(lengths.as_ref().unwrap().iter().all(|length| (length - 1.0).abs() < 4e-16), "{lengths:?}");
        let longest = 1.0 + 1.1 * ROUNDED_ROTATION;
        let expected = format!("3 of 5 normals have lengths from 1.000e-3 to {longest:.3e} and were scaled to 1");
        assert_eq!(notes, [expected]);
    }

    #[test]
    fn a_normal_without_a_direction_takes_all_away() {
        let note =
            |n: usize| vec![format!("{n} of 4 normals are zero or not finite, so the cloud goes without normals")];
        assert_eq!(scaled(&[1.0, 0.0, 2.0, 1.0]), (None, note(1)));
        assert_eq!(scaled(&[f64::NAN, 0.0, f64::INFINITY, 1.0]), (None, note(3)));
        assert_eq!(scaled(&[]), (Some(vec![]), vec![]));
    }
}
