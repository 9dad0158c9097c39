//! Samples of the markers during a procedure.

use super::{CALIBRATION_S, KNOCK_S, LASER_EVERY_S, SCAN_S, SLIP_BEFORE_LASER_S, Scene};
use crate::SlipsBefore;
use crate::tracker::{Marker, Tracker};
use nalgebra::Isometry3;
use osteoflow_geometry::Pose;

/// Samples of each marker, as `t_world_marker`.
pub(super) struct Markers {
    pub(super) camera_marker: Vec<Pose>,
    pub(super) phantom_marker: Vec<Pose>,
    pub(super) bone_marker: Vec<Pose>,
}

impl Markers {
    /// Without a localiser: the camera is the world, and no other marker is known.
    pub(super) fn untracked(mut self) -> Self {
        self.camera_marker.iter_mut().for_each(|pose| pose.isometry = Isometry3::identity());
        Self { camera_marker: self.camera_marker, phantom_marker: Vec::new(), bone_marker: Vec::new() }
    }
}

impl Scene<'_> {
    /// Samples whose stamps lie in bursts around the clouds: poses that are late are those of earlier times. Of the bone's marker also from the touches to the end.
    pub(super) fn markers(&self, tracker: &Tracker<'_>, n_laser: usize) -> Markers {
        let late_s = self.params.tracker.late_s;
        // Bursts stay apart.
        let burst_s = (self.params.tracker.burst_s + self.params.camera.scan_s / 2.0).min(1.9);
        let burst = |s: f64| (s - late_s - burst_s, s - late_s + burst_s);
        let scans: Vec<(f64, f64)> = (0..=n_laser).map(|k| burst(SCAN_S + k as f64 * LASER_EVERY_S)).collect();
        let calibration = [burst(CALIBRATION_S)];
        let camera_spans = [&calibration[..], &scans].concat();
        let scanned_s = scans.last().map_or(0.0, |(_, to_s)| *to_s);
        let touches = ((self.touches_s - 0.5).max(scanned_s + 1e-6), self.end_s());
        let bone_spans = [&scans[..], &[touches]].concat();
        let on_camera =
            |s: f64| if s < KNOCK_S { self.t_camera_camera_marker } else { self.t_camera_camera_marker_knocked };
        let on_phantom = |_| self.t_phantom_phantom_marker;
        let on_bone = |s: f64| self.t_ct_bone_marker_at(s);
        Markers {
            camera_marker: tracker.samples(Marker::Camera, None, &self.camera, on_camera, &camera_spans),
            phantom_marker: tracker.samples(Marker::Phantom, None, &self.phantom_path, on_phantom, &calibration),
            bone_marker: tracker.samples(Marker::Bone, None, &self.bone_path, on_bone, &bone_spans),
        }
    }

    fn t_ct_bone_marker_at(&self, s: f64) -> Isometry3<f64> {
        let slips_s = match self.params.motion.marker_slips_before {
            SlipsBefore::Touches => self.touches_s - 0.5,
            SlipsBefore::Laser => SLIP_BEFORE_LASER_S,
        };
        if s < slips_s { self.t_ct_bone_marker } else { self.t_ct_bone_marker_slipped }
    }
}
