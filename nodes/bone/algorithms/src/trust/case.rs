//! What a verdict is given on.

use super::convergence::Convergence;
use super::evidence::Registered;
use super::predict::Tracking;
use super::takes::Takes;
use crate::coarse::GlobalReport;
use crate::metrics::CheckReport;
use crate::slide::SlideReport;
use osteoflow_geometry::{NamedPoint, Planes};
use osteoflow_verdict::Reason;

/// A registration with everything that is known beside it. What is not known is empty or none.
#[derive(Debug, Clone)]
pub struct Case<'a> {
    /// The registered scan.
    pub registered: Registered<'a>,
    /// How the registration ended.
    pub icp: Option<&'a Convergence>,
    /// The planned landmarks.
    pub landmarks: &'a [NamedPoint],
    /// The landmarks as located.
    pub located: &'a [NamedPoint],
    /// The landmarks as located, carried by the registration; empty where they are in another frame than the scan.
    pub carried: &'a [NamedPoint],
    /// Whether the landmarks lie on the surface; fiducials such as screws, rings and skin markers do not.
    pub on_surface: bool,
    /// The planned assessment points.
    pub assessment: &'a [NamedPoint],
    /// Whether the assessment points lie on the surface; targets such as a tumour or a screw need not.
    pub assessment_on_surface: bool,
    /// The planned cuts; none where cuts are of no concern.
    pub planes: Option<&'a Planes>,
    /// Whether the camera was calibrated on its marker in the run: by a matrix that is given only what tests it is known.
    pub is_calibrated: bool,
    /// Where the markers were.
    pub tracking: Option<&'a Tracking>,
    /// Mean error measured with a stylus, mm.
    pub measured_tre_mm: Option<f64>,
    /// The slide profile about the registration.
    pub slide: Option<&'a SlideReport>,
    /// Readings of a check piece.
    pub check: &'a [CheckReport],
    /// How the markers moved while something was measured.
    pub takes: Takes<'a>,
    /// The registration by shape alone that it started from, if it did.
    pub start: Option<&'a GlobalReport>,
    /// Signs found elsewhere.
    pub reasons: &'a [Reason],
    /// What was taken for granted elsewhere and nothing in the run would contradict, of no stated size: listed first.
    pub untested: &'a [&'a str],
    /// What was taken for granted elsewhere, one sentence each.
    pub assumptions: &'a [&'a str],
}

impl<'a> Case<'a> {
    /// A registration with nothing beside it.
    pub fn new(registered: Registered<'a>) -> Self {
        Self {
            registered,
            icp: None,
            landmarks: &[],
            located: &[],
            carried: &[],
            on_surface: true,
            assessment: &[],
            assessment_on_surface: true,
            planes: None,
            is_calibrated: false,
            tracking: None,
            measured_tre_mm: None,
            slide: None,
            check: &[],
            takes: Takes::default(),
            start: None,
            reasons: &[],
            untested: &[],
            assumptions: &[],
        }
    }
}
