//! How far a registration can be trusted: the evidence in its data, the predicted error, and a verdict.
//!
//! [`Evidence`] measures, [`predict`] propagates, [`judge`] decides. Nothing here moves the scan: a verdict never replaces the
//! registration that it judges.

mod assumptions;
mod attitude;
mod bound;
mod by_shape;
mod case;
mod chance;
mod checked;
mod contradiction;
mod contrary;
mod convergence;
mod cut;
mod evidence;
mod extent;
mod hand_eye;
mod inside;
mod judge;
mod landmarks;
mod limits;
mod misfit;
mod motion;
mod nuisance;
mod on_surface;
mod pattern;
mod planned;
mod predict;
mod predict_last;
mod residuals;
mod room;
mod rules;
mod score;
mod size;
mod slid;
mod smear;
mod spread;
mod stylus;
mod surface_error;
mod takes;
#[cfg(test)]
mod tests;
mod uncertainty;
mod verdict;

pub use bound::{PlanReport, Said, fingerprint, plan_binding};
pub use case::Case;
pub use contradiction::planes_contradict;
pub use contrary::{ShapeEvidence, mirrored};
pub use convergence::{Convergence, StopCause};
pub use cut::Cut;
pub use evidence::{Evidence, EvidenceParams, Examined, Registered, When};
pub use inside::Inside;
pub use judge::judge;
pub use landmarks::LandmarkErrors;
pub use limits::Limits;
pub use misfit::Misfit;
pub use nuisance::{Nuisance, NuisanceParams, NuisanceState};
pub use osteoflow_verdict::{Answer, Reason};
pub use pattern::Pattern;
pub use planned::{OrderEvidence, landmark_order, plan_faults, planes_lost};
pub use predict::{
    Component, Deformation, Interval, Levers, MarkerPoses, PredictParams, Predicted, PredictedPoint, PredictedSet,
    Term, Tracking, Where, predict,
};
pub use predict_last::{PredictedLast, PredictedLastCut};
pub use residuals::{Residual, Residuals};
pub use room::{room_note, room_span};
pub use rules::RuleParams;
pub use score::{IntervalScore, VerdictScore, VerdictScoreParams, verdict_score};
pub use size::span;
pub use spread::Spread;
pub use stylus::StylusErrors;
pub(crate) use surface_error::MEDIAN_SIGMAS;
pub use surface_error::SurfaceError;
pub use takes::Takes;
pub use verdict::Verdict;
