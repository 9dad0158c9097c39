//! The truth of a procedure.

use super::{CALIBRATION_S, SCAN_S, Scene, laser_s};
use crate::tracker::Tracker;
use crate::{Truth, stylus};
use osteoflow_geometry::{NamedPoint, Points, Pose};

impl Scene<'_> {
    pub(super) fn truth(&self, tracker: &Tracker, spots: Points) -> Truth {
        let ct = &self.bone.frame;
        let is_tracked = !self.params.tracker.none && self.params.stylus.pivot_poses > 0;
        let bone_at = |s: f64| Pose::new("world", ct, self.bone_path.at(s)).at(tracker.stamp(s));
        let end_s = self.end_s();
        let in_world = spots.points.iter().enumerate().map(|(k, spot)| NamedPoint {
            stamp_ns: tracker.stamp(laser_s(k)),
            ..NamedPoint::new(spot.name.clone(), self.bone_path.at(laser_s(k)) * spot.position)
        });
        let planes_at = |s: f64| self.plan.planes.transformed("world", &self.bone_path.at(s)).at(tracker.stamp(s));
        Truth {
            bone: self.bone.clone(),
            t_camera_camera_marker: Pose::new("camera", "camera_marker", self.t_camera_camera_marker_knocked),
            t_camera_camera_marker_at_calibration: Pose::new("camera", "camera_marker", self.t_camera_camera_marker),
            t_phantom_phantom_marker: Pose::new("phantom", "phantom_marker", self.t_phantom_phantom_marker),
            t_camera_phantom: Pose::new(
                "camera",
                "phantom",
                self.camera.at(CALIBRATION_S).inverse() * self.phantom_path.at(CALIBRATION_S),
            )
            .at(tracker.stamp(CALIBRATION_S)),
            t_world_camera_at_scan: Pose::new("world", "camera", self.camera.at(SCAN_S)).at(tracker.stamp(SCAN_S)),
            t_world_ct_at_scan: bone_at(SCAN_S),
            t_world_ct_at_laser: (0..spots.points.len()).map(|k| bone_at(laser_s(k))).collect(),
            t_world_ct_at_touches: bone_at(self.touches_s),
            t_world_ct_after_motion: bone_at(end_s),
            t_world_bone_marker_at_scan: Pose::new(
                "world",
                "bone_marker",
                self.bone_path.at(SCAN_S) * self.t_ct_bone_marker,
            )
            .at(tracker.stamp(SCAN_S)),
            t_ct_bone_marker: Pose::new(ct, "bone_marker", self.t_ct_bone_marker),
            t_ct_bone_marker_at_touches: Pose::new(ct, "bone_marker", self.t_ct_bone_marker_slipped),
            laser_marks_ct: self.laser_marks.clone(),
            assessment_ct: self.assessment.clone(),
            stylus_tip: is_tracked.then_some(stylus::TIP),
            laser_spots_world: Points::new("world", in_world.collect::<Vec<_>>()),
            laser_spots_ct: spots,
            assessment_world: self.assessment.transformed("world", &self.bone_path.at(self.touches_s)),
            planes_world_at_scan: planes_at(SCAN_S),
            planes_world_after_motion: planes_at(end_s),
        }
    }
}
