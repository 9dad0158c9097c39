//! Poses that were read otherwise than they were written.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

pub(super) type Undo = fn(&Isometry3<f64>) -> Isometry3<f64>;

/// Another reading explains poses that it fits this many times better. Noise makes both fit alike.
pub(super) const FAR_BETTER: f64 = 5.0;
pub(super) const AS_WANTED: &str = "export them as x, y, z in mm and x, y, z, w of a right-handed frame";

/// What may have happened to the poses of a log, and what undoes it. Inverses are not among them: some calibrations hold for these, too.
pub(super) const MISREADINGS: [(&str, Undo); 6] = [
    ("have the quaternion in the order w, x, y, z", |t| with(t, |q| Quaternion::new(q.i, q.j, q.k, q.w), [1.0; 3])),
    ("have transposed rotations", |t| with(t, |q| q.conjugate(), [1.0; 3])),
    ("are mirrored", |t| with(t, |q| Quaternion::new(q.w, q.i, -q.j, -q.k), [-1.0, 1.0, 1.0])),
    ("have a mirrored x", |t| with(t, |q| q, [-1.0, 1.0, 1.0])),
    ("have a mirrored y", |t| with(t, |q| q, [1.0, -1.0, 1.0])),
    ("have a mirrored z", |t| with(t, |q| q, [1.0, 1.0, -1.0])),
];

fn with(t: &Isometry3<f64>, turn: fn(Quaternion<f64>) -> Quaternion<f64>, signs: [f64; 3]) -> Isometry3<f64> {
    let place = t.translation.vector.component_mul(&Vector3::from(signs));
    Isometry3::from_parts(Translation3::from(place), UnitQuaternion::from_quaternion(turn(t.rotation.into_inner())))
}
