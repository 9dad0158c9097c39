//! What a whole procedure leaves: calibration, scan, laser scans, stylus, and a motion of the bone afterwards.

use nalgebra::Point3;
use osteoflow_geometry::{Cloud, Image, Mesh, Planes, Points, Pose, Region, SurgicalPlan};

/// The contents of a recording of a procedure, and separately the truth.
///
/// Clouds are in frame `camera`, marker poses are `t_world_<marker>` in order of time, stylus points are in `world`;
/// all stamps are nanoseconds since the Unix epoch.
#[derive(Debug, Clone, PartialEq)]
pub struct Procedure {
    /// The plan, frame `ct`.
    pub plan: SurgicalPlan,
    /// The phantom's CAD, frame `phantom`.
    pub phantom: Mesh,
    /// One scan of the phantom.
    pub phantom_scan: Cloud,
    /// The full scan of the bone.
    pub scan: Cloud,
    /// The same view with the laser on each landmark in turn, labelled `P1`, `P2`, ...: a disc around the spot is
    /// missing. The assessment marks follow if requested. Exchanged labels are as in `laser.swap`.
    pub laser: Vec<Cloud>,
    /// A colour image at each of these scans, with its stamp and label, frame `camera`; empty unless `image.taken`.
    pub images: Vec<Image>,
    /// `t_world_camera_marker`, in bursts around each cloud.
    pub camera_marker: Vec<Pose>,
    /// `t_world_phantom_marker`, around the calibration only.
    pub phantom_marker: Vec<Pose>,
    /// `t_world_bone_marker`, around each scan, during all touches, and through the bone's last motion.
    pub bone_marker: Vec<Pose>,
    /// `t_phantom_phantom_marker` by CAD, without the error of the print; wrong by `phantom.marker_cad_wrong_mm` and
    /// `marker_cad_wrong_deg`.
    pub t_phantom_phantom_marker: Pose,
    /// Stylus points at the marks that the laser pointed at: the start of the baseline method.
    pub stylus_init: Points,
    /// Stylus points in the assessment holes, M1 to M5 in order.
    pub stylus_assessment: Points,
    /// Stylus points on the stripped surface, named `1`, `2`, ...: the cloud of the baseline method.
    pub stylus_palpation: Points,
    /// The holes of the check piece as read from its cloud, frame `camera`, and as given by localiser and CAD, frame
    /// `world`: first at the phantom's place (`calibration_1`, ..), then at the bone's (`working_1`, ..).
    pub check: Vec<(Points, Points)>,
    /// `t_world_stylus_marker` during the pivot calibration; empty without one.
    pub stylus_pivoting: Vec<Pose>,
    /// `t_world_stylus_marker` at each touch; empty without a pivot calibration.
    pub stylus_marker: Vec<Pose>,
    /// The user's region of interest, frame `camera`.
    pub region: Option<Region>,
    /// The truth, for scoring only.
    pub truth: Truth,
}

/// Scans of a bone that moves, from a second before its last motion on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScanStream {
    /// The clouds, frame `camera`.
    pub scans: Vec<Cloud>,
    /// `t_world_camera_marker`, from before the first scan to after the last.
    pub camera_marker: Vec<Pose>,
    /// The true pose `t_ct_world` at each scan, for scoring only.
    pub t_ct_world: Vec<Pose>,
}

/// The true poses and points, never an input of a registration.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The scanned surface, frame `ct`.
    pub bone: Mesh,
    /// Pose of the camera's marker on the camera at all scans of the bone, after a possible knock.
    pub t_camera_camera_marker: Pose,
    /// Pose of the camera's marker on the camera at the calibration.
    pub t_camera_camera_marker_at_calibration: Pose,
    /// Pose of the phantom's marker as printed.
    pub t_phantom_phantom_marker: Pose,
    /// Pose of the phantom in its scan.
    pub t_camera_phantom: Pose,
    /// Pose of the camera at the full scan.
    pub t_world_camera_at_scan: Pose,
    /// Pose of the bone at the full scan.
    pub t_world_ct_at_scan: Pose,
    /// Pose of the bone at each laser scan.
    pub t_world_ct_at_laser: Vec<Pose>,
    /// Pose of the bone during the touches.
    pub t_world_ct_at_touches: Pose,
    /// Pose of the bone at the end.
    pub t_world_ct_after_motion: Pose,
    /// Pose of the bone's marker at the full scan.
    pub t_world_bone_marker_at_scan: Pose,
    /// Pose of the bone's marker on the bone.
    pub t_ct_bone_marker: Pose,
    /// Pose of the bone's marker on the bone during the touches, after a possible slip, which may come before the laser
    /// scans.
    pub t_ct_bone_marker_at_touches: Pose,
    /// The marks aimed at by the laser, frame `ct`: the planned points with the ruler's error.
    pub laser_marks_ct: Points,
    /// The assessment marks, frame `ct`: the planned points with the ruler's error.
    pub assessment_ct: Points,
    /// The stylus' tip in its marker's frame, if its marker is tracked.
    pub stylus_tip: Option<Point3<f64>>,
    /// The laser spots, frame `ct`: the marks with the aiming error.
    pub laser_spots_ct: Points,
    /// The laser spots in `world`, each at its own scan.
    pub laser_spots_world: Points,
    /// The assessment holes during the touches, frame `world`.
    pub assessment_world: Points,
    /// The planned planes at the full scan, frame `world`.
    pub planes_world_at_scan: Planes,
    /// The planned planes at the end, frame `world`.
    pub planes_world_after_motion: Planes,
}
