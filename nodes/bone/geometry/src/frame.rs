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
    /// [`FrameError`], naming both frames and `what` is in them.
    pub fn expect(&self, other: &Frame, what: &str) -> Result<(), FrameError> {
        if self == other {
            return Ok(());
        }
        Err(FrameError(format!("{what} should be in {other}, but is in {self}")))
    }
}

impl<T: Into<Arc<str>>> From<T> for Frame {
    fn from(name: T) -> Self {
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

/// Frames that do not meet, each of them named.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct FrameError(pub(crate) String);
