use crate::{Frame, FrameError, StampNs};
use nalgebra::Isometry3;

/// `t_to_from`: the rigid motion that takes coordinates in `from` to coordinates in `to`, in mm, valid at `stamp_ns`.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// The frame that coordinates are taken to.
    pub to: Frame,
    /// The frame that coordinates are taken from.
    pub from: Frame,
    /// The time at which it is valid; 0 for a constant such as a CAD pose.
    pub stamp_ns: StampNs,
    /// The motion itself.
    pub isometry: Isometry3<f64>,
}

impl Pose {
    /// A pose without a time.
    pub fn new(to: impl Into<Frame>, from: impl Into<Frame>, isometry: Isometry3<f64>) -> Self {
        Self { to: to.into(), from: from.into(), stamp_ns: 0, isometry }
    }

    /// Sets the stamp.
    pub fn at(self, stamp_ns: StampNs) -> Self {
        Self { stamp_ns, ..self }
    }

    /// `t_from_to`, at the same time.
    pub fn inverse(&self) -> Self {
        Self {
            to: self.from.clone(),
            from: self.to.clone(),
            stamp_ns: self.stamp_ns,
            isometry: self.isometry.inverse(),
        }
    }

    /// `t_a_b * t_b_c = t_a_c`, valid at the later of both times.
    ///
    /// # Errors
    /// [`FrameError`] if the inner frames differ, naming all four.
    pub fn compose(&self, right: &Pose) -> Result<Pose, FrameError> {
        if self.from != right.to {
            let (inner, other) = (&self.from, &right.to);
            return Err(FrameError(format!(
                "t_{}_{inner} cannot be followed by t_{other}_{}: {inner} is not {other}; wire a pose from {inner}",
                self.to, right.from
            )));
        }
        Ok(Pose {
            to: self.to.clone(),
            from: right.from.clone(),
            stamp_ns: self.stamp_ns.max(right.stamp_ns),
            isometry: self.isometry * right.isometry,
        })
    }

    /// The motion, if this pose is `t_to_from`; a node checks the frames of a pose by this call.
    ///
    /// # Errors
    /// [`FrameError`] if it leads between other frames.
    pub fn expect(&self, to: &Frame, from: &Frame) -> Result<Isometry3<f64>, FrameError> {
        if self.to == *to && self.from == *from {
            return Ok(self.isometry);
        }
        Err(FrameError(format!("a pose {from} -> {to} is needed here, but this one maps {} -> {}", self.from, self.to)))
    }

    /// The pose between `a` (`s` = 0) and `b` (`s` = 1): linear in the origin of `from`, SLERP in the rotation.
    ///
    /// `None` if the frames differ, or if the rotations are half a turn apart, where SLERP is not unique.
    pub fn interpolate(a: &Pose, b: &Pose, s: f64) -> Option<Pose> {
        if a.to != b.to || a.from != b.from {
            return None;
        }
        let rotation = a.isometry.rotation.try_slerp(&b.isometry.rotation, s, 1e-12)?;
        let translation = a.isometry.translation.vector.lerp(&b.isometry.translation.vector, s);
        let stamp_ns = a.stamp_ns + ((b.stamp_ns - a.stamp_ns) as f64 * s).round() as StampNs;
        Some(Pose {
            to: a.to.clone(),
            from: a.from.clone(),
            stamp_ns,
            isometry: Isometry3::from_parts(translation.into(), rotation),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};
    use std::f64::consts::FRAC_PI_2;

    fn turn(angle: f64, x: f64) -> Isometry3<f64> {
        Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * angle)
    }

    #[test]
    fn composing_poses_that_do_not_meet_names_all_four_frames() {
        let left = Pose::new("world", "camera", turn(0.1, 0.0));
        let right = Pose::new("phantom", "ct", turn(0.1, 0.0));
        let message = left.compose(&right).unwrap_err().to_string();
        for frame in ["world", "camera", "phantom", "ct"] {
            assert!(message.contains(frame), "{message} does not name {frame}");
        }
    }

    #[test]
    fn a_pose_and_its_inverse_cancel() {
        let t = Pose::new("world", "camera", turn(0.7, 12.0));
        let same = t.compose(&t.inverse()).unwrap();
        assert_eq!((same.to.as_str(), same.from.as_str()), ("world", "world"));
        assert!((same.isometry * Point3::new(1.0, 2.0, 3.0) - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    }

    #[test]
    fn half_way_between_two_quarter_turns_is_an_eighth_turn() {
        let a = Pose::new("w", "m", turn(0.0, 0.0)).at(0);
        let b = Pose::new("w", "m", turn(FRAC_PI_2, 4.0)).at(100);
        let half = Pose::interpolate(&a, &b, 0.5).unwrap();
        assert!((half.isometry.rotation.angle() - FRAC_PI_2 / 2.0).abs() < 1e-12);
        assert_eq!(half.isometry.translation.x, 2.0);
        assert_eq!(half.stamp_ns, 50);
    }
}
