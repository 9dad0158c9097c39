//! The bone scanned again and again while it moves.

use super::{MOTION_S, Scene};
use crate::camera::DepthBias;
use crate::tracker::{Marker, Tracker};
use crate::{ScanStream, SimulationError, StreamParams};
use osteoflow_geometry::{Pose, StampNs};

/// Time for which the bone rests before its motion.
const REST_BEFORE_S: f64 = 1.0;
/// Number of the first cloud, beyond those of every procedure.
const FIRST_NUMBER: u64 = 1 << 20;
/// Place of the camera's marker, which is that of no other samples.
const PLACE: u64 = 1 << 12;

impl Scene<'_> {
    /// Scans from shortly before the bone's last motion on.
    pub(crate) fn stream(&self, params: &StreamParams) -> Result<ScanStream, SimulationError> {
        let tracker = Tracker {
            params: &self.params.tracker,
            seed: self.seed,
            start_ns: StampNs::from(self.params.motion.start_s) * 1_000_000_000,
        };
        let bias = DepthBias::new(&self.params.camera, self.seed);
        let spots = self.laser_spots()?;
        let seen = self.bone_view(super::SCAN_S, &bias, None)?;
        let wound = self.wound(&seen.into_iter().filter(|pixel| pixel.on_object).collect::<Vec<_>>(), &spots)?;
        let begin_s = self.motion_s - REST_BEFORE_S;
        // The bone takes as long for its motion as the stream has it move.
        let place_s = |s: f64| match s - REST_BEFORE_S {
            moving if moving <= 0.0 => begin_s,
            moving => self.motion_s + moving * MOTION_S / params.motion_s,
        };
        let mut stream = ScanStream::default();
        for number in 0..u64::from(params.n_scans) {
            let s = number as f64 / params.rate_hz;
            let place_s = place_s(s);
            let pixels = self.bone_view(place_s, &bias, wound.tissue.as_ref())?;
            let stamp_ns = tracker.stamp(begin_s + s);
            let mut scan = self.bone_scan(&pixels, None, &wound, place_s, &tracker, FIRST_NUMBER + number)?;
            scan.stamp_ns = stamp_ns;
            stream.scans.push(scan);
            let t_ct_world = self.bone_path.at(place_s).inverse();
            stream.t_ct_world.push(Pose::new(&self.bone.frame, "world", t_ct_world).at(stamp_ns));
        }
        let burst_s = self.params.tracker.burst_s;
        let end_s = begin_s + f64::from(params.n_scans) / params.rate_hz;
        let on_camera = |_| self.t_camera_camera_marker_knocked;
        let span = [(begin_s - burst_s, end_s + burst_s)];
        stream.camera_marker = tracker.samples(Marker::Camera, Some(PLACE), &self.camera, on_camera, &span);
        if self.params.tracker.none {
            stream.camera_marker.iter_mut().for_each(|pose| pose.isometry = nalgebra::Isometry3::identity());
        }
        Ok(stream)
    }
}
