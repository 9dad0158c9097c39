//! A stylus with a pivot calibration, whose marker is tracked at every touch.

use crate::SimulationError;
use crate::draws::{Term, normal, normal3, stream};
use crate::params::StylusParams;
use crate::tracker::{Marker, Tracker};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::calibrate;
use osteoflow_geometry::Pose;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// The true tip in the marker's frame, mm: the marker is on the handle.
pub(crate) const TIP: Point3<f64> = Point3::new(12.0, -4.0, 158.0);

/// Standard deviation of the tilt at a touch, per axis, and maximum spin in the calibration.
const TOUCH_TILT_RAD: f64 = 0.25;
const SPIN_RAD: f64 = PI / 3.0;

/// A calibrated stylus.
pub(crate) struct Stylus<'a> {
    tracker: &'a Tracker<'a>,
    attitude: ChaCha8Rng,
    noise: ChaCha8Rng,
    n_touches: u64,
    /// The tip by the calibration.
    tip: Point3<f64>,
    /// Poses of the marker while it was turned about its tip.
    pub(crate) pivoting: Vec<Pose>,
    /// Poses of the marker at the touches so far.
    pub(crate) touching: Vec<Pose>,
}

impl<'a> Stylus<'a> {
    /// Pivots the stylus about its tip at `pivot` (world) during `span`, seconds, and solves for the tip.
    pub(crate) fn calibrated(
        tracker: &'a Tracker<'a>,
        params: &StylusParams,
        pivot: &Point3<f64>,
        (from_s, to_s): (f64, f64),
    ) -> Result<Self, SimulationError> {
        let mut rng = stream(tracker.seed, Term::Pivoting, 0);
        let mut noise = stream(tracker.seed, Term::TrackerNoise, Marker::Stylus as u64);
        let upright = upright(&Vector3::z());
        let poses = (0..params.pivot_poses).map(|k| {
            let azimuth = TAU * rng.random::<f64>();
            let tilt = params.pivot_deg.to_radians() * rng.random::<f64>().sqrt();
            let spin = SPIN_RAD * (2.0 * rng.random::<f64>() - 1.0);
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt)
                * upright
                * UnitQuaternion::from_scaled_axis(Vector3::z() * spin);
            let at = pivot + normal3(&mut rng) * params.dimple_mm;
            let s = from_s + (to_s - from_s) * (k as f64 + 0.5) / params.pivot_poses as f64;
            tracker.sample(Marker::Stylus, &with_tip_at(&at, rotation), 0, s, &mut noise)
        });
        let pivoting: Vec<Pose> = poses.collect();
        let pivot_fit = calibrate::pivot(&pivoting.iter().map(|pose| pose.isometry).collect::<Vec<_>>())?;
        let attitude = stream(tracker.seed, Term::StylusAttitude, 0);
        Ok(Self { tracker, attitude, noise, n_touches: 0, tip: pivot_fit.tip.into(), pivoting, touching: Vec::new() })
    }

    /// The measured position of the tip that truly is at `at` (world, without the localiser's drift), held roughly
    /// along `from`, the direction from the tip to the hand.
    pub(crate) fn touch(&mut self, at: &Point3<f64>, from: &Vector3<f64>, s: f64) -> Point3<f64> {
        self.n_touches += 1;
        let tilt = UnitQuaternion::from_scaled_axis(normal3(&mut self.attitude) * TOUCH_TILT_RAD);
        let spin = UnitQuaternion::from_scaled_axis(Vector3::z() * (SPIN_RAD * normal(&mut self.attitude)));
        let truth = with_tip_at(at, tilt * upright(from) * spin);
        let pose = self.tracker.sample(Marker::Stylus, &truth, self.n_touches, s, &mut self.noise);
        let measured = pose.isometry * self.tip;
        self.touching.push(pose);
        measured
    }
}

/// The attitude in which the marker is in direction `from`, seen from the tip.
fn upright(from: &Vector3<f64>) -> UnitQuaternion<f64> {
    let half_turn = || UnitQuaternion::from_scaled_axis(Vector3::x() * PI);
    UnitQuaternion::rotation_between(&-TIP.coords, from).unwrap_or_else(half_turn)
}

fn with_tip_at(at: &Point3<f64>, rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
    Translation3::from(at - rotation * TIP) * rotation
}
