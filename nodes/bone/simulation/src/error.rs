use osteoflow_algorithms::Refusal;
use osteoflow_geometry::{CloudError, FrameError, ImageError, MeshError};

/// Why there is no simulated procedure or CT.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// A parameter is out of its range, or does not fit another.
    #[error("{name} {message}")]
    Parameter {
        /// The parameter with its table, perhaps behind which of its values it is.
        name: String,
        /// What was found, and what it must be.
        message: String,
    },
    /// A parameter, the plan or the bone does not suit a simulation: what was expected, what was found, and a next step.
    #[error("{0}")]
    Unsuitable(String),
    /// The landmarks cannot be placed on this bone, or the stylus' pivot calibration has no result.
    #[error(transparent)]
    Refusal(#[from] Refusal),
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

impl SimulationError {
    pub(crate) fn no_anatomy() -> Self {
        let message = "the plan has no anatomy, but the camera's view is placed by it; give malleolus_tip, proximal, lateral \
                       and posterior";
        Self::Unsuitable(message.into())
    }

    pub(crate) fn nothing_visible(what: &str, hint: &str) -> Self {
        Self::Unsuitable(format!("the camera sees nothing of the {what}; {hint}"))
    }

    pub(crate) fn no_section(height_mm: f64) -> Self {
        Self::Unsuitable(format!(
            "the bone has no section {height_mm} mm from the malleolus tip; is it shorter, or in metres?"
        ))
    }

    pub(crate) fn not_closed(n_open_edges: usize) -> Self {
        Self::Unsuitable(format!(
            "{n_open_edges} edges of the bone's surface are open, so what is bone is not known; close its holes and export it \
             again"
        ))
    }

    /// A parameter with its table, its value or "not finite", and what it must be.
    pub(crate) fn parameter(name: &str, value: impl std::fmt::Display, expected: &str) -> Self {
        Self::Parameter { name: name.into(), message: format!("is {value}, but must be {expected}") }
    }
}

/// A rule for a finite value: its name, the value, whether it holds, and the requirement.
pub(crate) type Rule = (&'static str, f64, bool, &'static str);

/// The first rule that does not hold, as an error.
pub(crate) fn check_rules(rules: impl IntoIterator<Item = Rule>) -> Result<(), SimulationError> {
    match rules.into_iter().find(|&(_, value, holds, _)| !(holds && value.is_finite())) {
        Some((name, value, _, expected)) => Err(SimulationError::parameter(name, value, expected)),
        None => Ok(()),
    }
}
