use crate::{Axes, Planes, Points, Pose};
use nalgebra::{Point3, Unit, Vector3};

/// The surgical plan on the CT, in the CT frame, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct SurgicalPlan {
    /// The landmarks P1..P3 that initialise the registration.
    pub landmarks: Points,
    /// The assessment points M1..M5, not used to fit.
    pub assessment: Points,
    /// The cutting planes.
    pub planes: Planes,
    /// The axes along which errors are resolved, if the plan has them.
    pub axes: Option<Axes>,
    /// The anatomy that landmarks are placed by, if the plan has it.
    pub anatomy: Option<Anatomy>,
    /// `t_phantom_phantom_marker`, known from the phantom's CAD, if the plan has it.
    pub t_phantom_phantom_marker: Option<Pose>,
    /// `t_camera_camera_marker` as designed, good to a few mm and degrees; the phantom's ICP starts there.
    pub t_camera_camera_marker_nominal: Option<Pose>,
}

/// Directions and a landmark of a fibula, in its CT frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Anatomy {
    /// The tip of the lateral malleolus, mm.
    pub malleolus_tip: Point3<f64>,
    /// Towards the knee, along the bone.
    pub proximal: Unit<Vector3<f64>>,
    /// Away from the body's middle.
    pub lateral: Unit<Vector3<f64>>,
    /// Towards the back.
    pub posterior: Unit<Vector3<f64>>,
}
