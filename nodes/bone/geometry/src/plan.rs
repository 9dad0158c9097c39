use crate::{Axes, Planes, Points, Pose};
use nalgebra::{Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

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
    /// The surface that the plan was drawn on, if the plan is bound to it.
    pub surface: Option<SurfaceKey>,
}

impl SurgicalPlan {
    /// With the axes, the anatomy and the poses of markers of another plan, where this one has none.
    pub fn completed_by(self, other: Self) -> Self {
        Self {
            axes: self.axes.or(other.axes),
            anatomy: self.anatomy.or(other.anatomy),
            t_phantom_phantom_marker: self.t_phantom_phantom_marker.or(other.t_phantom_phantom_marker),
            t_camera_camera_marker_nominal: self
                .t_camera_camera_marker_nominal
                .or(other.t_camera_camera_marker_nominal),
            ..self
        }
    }
}

/// What identifies the surface that a plan was drawn on; each part that is there suffices alone.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SurfaceKey {
    /// SHA-256 of the surface file's bytes, 64 hexadecimal digits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// FrameOfReferenceUID of the CT, which all series of the same coordinates share.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_of_reference_uid: Option<String>,
    /// Points on the surface, spread over it, in the CT frame, mm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<[f64; 3]>,
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
