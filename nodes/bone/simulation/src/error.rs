use osteoflow_algorithms::{calibrate::PivotError, landmarks::LandmarkError};
use osteoflow_geometry::{CloudError, FrameError, ImageError, MeshError};

/// Errors of the simulation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// The plan has no anatomy.
    #[error(
        "the plan has no anatomy, but the camera's view is placed by it; give malleolus_tip, proximal, lateral and \
         posterior"
    )]
    NoAnatomy,
    /// The plan has too few points for the laser or the stylus.
    #[error("the plan has {found} {what}, but at least {needed} are needed to simulate a procedure")]
    TooFewPoints {
        /// `landmarks` or `assessment points`.
        what: &'static str,
        /// Number of points found.
        found: usize,
        /// Number of points needed.
        needed: usize,
    },
    /// The camera sees nothing of the surface.
    #[error("the camera sees nothing of the {what}; {hint}")]
    NothingVisible {
        /// `bone` or `phantom`.
        what: &'static str,
        /// What to check.
        hint: &'static str,
    },
    /// The bone has no section at the height of a landmark or plane.
    #[error("the bone has no section {height_mm} mm from the malleolus tip; is it shorter, or in metres?")]
    NoSection {
        /// The height along the bone, mm.
        height_mm: f64,
    },
    /// The camera does not see a laser spot.
    #[error("the laser spot on {name} is hidden from the camera; turn the view (camera.view_azimuth_deg) towards it")]
    SpotHidden {
        /// The landmark.
        name: String,
    },
    /// The labels to exchange are no marks of the laser.
    #[error(
        "laser.swap is {found:?}, but must be two or more different marks of the laser ({}), or empty",
        marks.join(", ")
    )]
    Swap {
        /// The names given.
        found: Vec<String>,
        /// The marks that the laser points at.
        marks: Vec<String>,
    },
    /// A planned point is not finite.
    #[error("planned point {name} is not finite")]
    NotFinite {
        /// The point.
        name: String,
    },
    /// A parameter is out of range.
    #[error("{name} is {value}, but must be {expected}")]
    Parameter {
        /// Its name, with its table.
        name: String,
        /// Its value, or "not finite".
        value: String,
        /// What it must be.
        expected: String,
    },
    /// The surface is open, so it has no inside.
    #[error(
        "{n_open_edges} edges of the bone's surface are open, so what is bone is not known; close its holes and export it \
         again"
    )]
    NotClosed {
        /// Number of edges not shared by two faces of consistent orientation.
        n_open_edges: usize,
    },
    /// The simulated CT shows no bone.
    #[error("the simulated CT shows no bone; is a voxel of {voxel_mm} mm too coarse for it?")]
    NoBoneInCt {
        /// The voxel's edge, mm.
        voxel_mm: f64,
    },
    /// The simulated CT would not fit into memory.
    #[error("the simulated CT would hold {n_voxels} voxels, at most {limit} are allowed; take larger voxels")]
    CtTooLarge {
        /// Number of voxels.
        n_voxels: u64,
        /// Maximum number.
        limit: u64,
    },
    /// The stylus' pivot calibration has no result.
    #[error(transparent)]
    Pivot(#[from] PivotError),
    /// The landmarks cannot be placed on this bone.
    #[error(transparent)]
    Landmarks(#[from] LandmarkError),
    /// Bone and plan are not in one frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A surface is not a valid mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Points are not a valid cloud.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// Pixels are not a valid image.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// A rule for a finite value: its name, the value, whether it holds, and the requirement.
pub(crate) type Rule = (&'static str, f64, bool, &'static str);

/// The first rule that does not hold, as an error.
pub(crate) fn check_rules(rules: impl IntoIterator<Item = Rule>) -> Result<(), SimulationError> {
    match rules.into_iter().find(|&(_, value, holds, _)| !(holds && value.is_finite())) {
        Some((name, value, _, expected)) => Err(SimulationError::Parameter {
            name: name.to_owned(),
            value: value.to_string(),
            expected: expected.to_owned(),
        }),
        None => Ok(()),
    }
}
