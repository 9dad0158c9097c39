//! What the markers did while something was measured.

use crate::still_average::TakeMotion;
use osteoflow_geometry::Planes;

/// How the markers moved while something was measured, in the scan's frame.
#[derive(Debug, Clone, Copy, Default)]
pub struct Takes<'a> {
    /// At the scan.
    pub scan: Option<&'a TakeMotion>,
    /// At the landmarks.
    pub located: &'a [TakeMotion],
    /// At the touches of a stylus.
    pub touched: &'a [TakeMotion],
    /// The largest distance of a laser scan, on which a landmark was located, from the scan, mm.
    pub apart_mm: Option<f64>,
    /// The planes as last followed, in the world.
    pub last: Option<&'a Planes>,
}
