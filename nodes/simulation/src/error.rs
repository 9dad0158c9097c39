use osteoflow_algorithms::{calibrate::PivotError, landmarks::LandmarkError};
use osteoflow_geometry::{CloudError, FrameError, MeshError};

/// Why a procedure could not be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// The plan does not say where the bone's ends and sides are.
    #[error(
        "the plan has no anatomy, but the camera's view is placed by it; give malleolus_tip, proximal, lateral and \
         posterior"
    )]
    NoAnatomy,
    /// The plan lacks points that the simulation points the laser or the stylus at.
    #[error("the plan has {found} {what}, but at least {needed} are needed to simulate a procedure")]
    TooFewPoints {
        /// `landmarks` or `assessment points`.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// The camera sees nothing of the surface.
    #[error("the camera sees nothing of the {what}; {hint}")]
    NothingVisible {
        /// `bone` or `phantom`.
        what: &'static str,
        /// What to look at.
        hint: &'static str,
    },
    /// A landmark or plane was to be placed where the bone has no section.
    #[error("the bone has no section {height_mm} mm from the malleolus tip; is it shorter, or in metres?")]
    NoSection {
        /// The height along the bone, mm.
        height_mm: f64,
    },
    /// The laser spot lies where the camera does not see it.
    #[error("the laser spot on {name} is hidden from the camera; turn the view (camera.view_azimuth_deg) towards it")]
    SpotHidden {
        /// The landmark.
        name: String,
    },
    /// A planned point is nowhere.
    #[error("planned point {name} is not finite")]
    NotFinite {
        /// The point.
        name: String,
    },
    /// A parameter that makes no sense.
    #[error("{name} is {value}, but must be {expected}")]
    Parameter {
        /// Its name, with its table.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
    /// The surface to be scanned in the CT has an inside and an outside nowhere.
    #[error(
        "{n_open_edges} edges of the bone's surface are open, so what is bone is not known; close its holes and export it \
         again"
    )]
    NotClosed {
        /// How many edges are not shared by two faces that turn alike.
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
        /// How many it would hold.
        n_voxels: u64,
        /// How many it may.
        limit: u64,
    },
    /// The stylus' pivot calibration has no result.
    #[error(transparent)]
    Pivot(#[from] PivotError),
    /// The landmarks have no place on this bone.
    #[error(transparent)]
    Landmarks(#[from] LandmarkError),
    /// Bone and plan do not lie in one frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A surface that is no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Points that make no cloud.
    #[error(transparent)]
    Cloud(#[from] CloudError),
}

/// A value that must be finite and fulfil something: its name, the value, whether it does, and what it must be.
pub(crate) type Rule = (&'static str, f64, bool, &'static str);

/// The first rule that does not hold, as an error.
pub(crate) fn hold(rules: impl IntoIterator<Item = Rule>) -> Result<(), SimulationError> {
    match rules.into_iter().find(|&(_, value, holds, _)| !(holds && value.is_finite())) {
        Some((name, value, _, expected)) => Err(SimulationError::Parameter { name, value, expected }),
        None => Ok(()),
    }
}
