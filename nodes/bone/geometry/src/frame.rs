use serde::{Deserialize, Serialize};
use std::{fmt, sync::Arc};

/// The name of a coordinate frame, such as `world` or `camera_marker`; cheap to clone.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Frame(Arc<str>);

impl Frame {
    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The name, shared.
    pub fn shared(&self) -> Arc<str> {
        self.0.clone()
    }

    /// Checks that this frame is `other`.
    ///
    /// # Errors
    /// [`FrameError::Differ`], naming both frames and `what` is in them.
    pub fn expect(&self, other: &Frame, what: &'static str) -> Result<(), FrameError> {
        if self == other {
            return Ok(());
        }
        Err(FrameError::Differ { what, expected: other.clone(), found: self.clone() })
    }
}

impl From<&str> for Frame {
    fn from(name: &str) -> Self {
        Self(name.into())
    }
}

impl From<Arc<str>> for Frame {
    fn from(name: Arc<str>) -> Self {
        Self(name)
    }
}

impl From<String> for Frame {
    fn from(name: String) -> Self {
        Self(name.into())
    }
}

impl From<&Frame> for Frame {
    fn from(frame: &Frame) -> Self {
        frame.clone()
    }
}

impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Frames that do not meet.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// Two poses were composed whose inner frames differ.
    #[error(
        "t_{left_to}_{left_from} cannot be followed by t_{right_to}_{right_from}: {left_from} is not {right_to}; \
         wire a pose from {left_from}"
    )]
    Compose {
        /// `to` of the left pose.
        left_to: Frame,
        /// `from` of the left pose.
        left_from: Frame,
        /// `to` of the right pose.
        right_to: Frame,
        /// `from` of the right pose.
        right_from: Frame,
    },
    /// A pose is between other frames than needed.
    #[error("a pose {from} -> {to} is needed here, but this one maps {found_from} -> {found_to}")]
    Pose {
        /// The `to` that is needed.
        to: Frame,
        /// The `from` that is needed.
        from: Frame,
        /// The `to` of the pose.
        found_to: Frame,
        /// The `from` of the pose.
        found_from: Frame,
    },
    /// Data are in another frame than needed.
    #[error("{what} should be in {expected}, but is in {found}")]
    Differ {
        /// The data.
        what: &'static str,
        /// The frame that is needed.
        expected: Frame,
        /// The frame of the data.
        found: Frame,
    },
}
