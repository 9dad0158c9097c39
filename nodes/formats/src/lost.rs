use osteoflow_geometry::{Frame, StampNs};

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
    /// What gave it away, such as `an all-zero quaternion`.
    pub reason: String,
}
