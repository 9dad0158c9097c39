use osteoflow_geometry::{Frame, RigidError, StampNs};

/// A pose that a tracker wrote although it did not see the marker: the place is unknown, not zero.
///
/// A stream turns it into an empty at `stamp_ns`, with this error's text as the reason.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("marker lost: t_{to}_{from} at {stamp_ns} ns has {reason}")]
pub struct LostPose {
    /// The frame that the pose would lead to.
    pub to: Frame,
    /// The frame that the pose would lead from.
    pub from: Frame,
    /// When the marker was not seen.
    pub stamp_ns: StampNs,
    /// The evidence, such as `an all-zero quaternion`.
    pub reason: String,
}

/// A transform in a message that gives no pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// The marker was not seen.
    #[error(transparent)]
    Lost(#[from] LostPose),
    /// The rotation is farther from one than rounding explains.
    #[error("t_{to}_{from} at {stamp_ns} ns is no rigid motion: {error}")]
    NotRigid {
        /// The frame that the pose would lead to.
        to: Frame,
        /// The frame that the pose would lead from.
        from: Frame,
        /// The transform's sensor time.
        stamp_ns: StampNs,
        /// The reason.
        error: RigidError,
    },
}
