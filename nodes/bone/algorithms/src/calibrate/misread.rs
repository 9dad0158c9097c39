//! Poses that were read otherwise than they were written.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// What may have happened to the poses of a log, and what undoes it.
pub(super) type Misreading = (&'static str, fn(&Isometry3<f64>) -> Isometry3<f64>);

/// Inverses are not among them: some calibrations hold for these, too.
pub(super) const MISREADINGS: [Misreading; 6] = [
    ("have the quaternion in the order w, x, y, z", |t| {
        let q = t.rotation.coords;
        turned(t, UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3])))
    }),
    ("have transposed rotations", |t| turned(t, t.rotation.inverse())),
    ("are mirrored", |t| {
        let q = t.rotation.coords;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], -q[1], -q[2]));
        Isometry3::from_parts(flipped(t, 0), rotation)
    }),
    ("have a mirrored x", |t| Isometry3::from_parts(flipped(t, 0), t.rotation)),
    ("have a mirrored y", |t| Isometry3::from_parts(flipped(t, 1), t.rotation)),
    ("have a mirrored z", |t| Isometry3::from_parts(flipped(t, 2), t.rotation)),
];

fn turned(t: &Isometry3<f64>, rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(t.translation, rotation)
}

fn flipped(t: &Isometry3<f64>, axis: usize) -> Translation3<f64> {
    let mut vector: Vector3<f64> = t.translation.vector;
    vector[axis] = -vector[axis];
    Translation3::from(vector)
}
