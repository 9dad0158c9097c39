/// Errors of the metrics.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MetricsError {
    /// Nothing to measure.
    #[error("there is no {what}; nothing can be measured")]
    Empty {
        /// What is missing.
        what: &'static str,
    },
    /// A point has no counterpart of the same name.
    #[error("{name} is not among the {side} points ({found}); name both sets alike")]
    Unpaired {
        /// The name.
        name: String,
        /// Where it is missing.
        side: &'static str,
        /// The names found there.
        found: String,
    },
    /// Planes lie in different frames, or differ from the axes' or the bone's.
    #[error(transparent)]
    Frame(#[from] osteoflow_geometry::FrameError),
    /// No fragment can be cut out.
    #[error(transparent)]
    Fragment(#[from] crate::fragment::FragmentError),
    /// The points do not determine a motion.
    #[error(transparent)]
    Fit(#[from] crate::kabsch::FitError),
    /// A plane is unknown.
    #[error("plane {name} is unknown: {reason}")]
    UnknownPlane {
        /// The plane.
        name: String,
        /// Why.
        reason: String,
    },
    /// A number is NaN or infinite.
    #[error("{what} is not finite; look at where it comes from")]
    NotFinite {
        /// What is not finite.
        what: String,
    },
}
