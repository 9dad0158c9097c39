//! Tracking by registration: whether a registration may be the start of the next.

use crate::icp::IcpReport;
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// When a registration counts as lost.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrackLimits {
    /// Maximum RMS residual of the inliers. 0.5: five times what a camera's noise of 0.05 mm leaves.
    #[param(0.5, 0.0..=100.0)]
    pub max_rms_mm: f64,
    /// Minimum share of the scan's points that are inliers. 0.5: the smaller half may be tissue.
    #[param(0.5, 0.0..=1.0)]
    pub min_pair_share: f64,
}

impl TrackLimits {
    /// Why the registration is lost; `None` if it is not.
    pub fn lost(&self, report: &IcpReport) -> Option<String> {
        let IcpReport { converged, iterations, rms_mm, pair_share, .. } = *report;
        // A comparison that holds for NaN too.
        let (fits, covers) = (rms_mm <= self.max_rms_mm, pair_share >= self.min_pair_share);
        match (converged, fits, covers) {
            (false, ..) => Some(format!("it had not converged after {iterations} iterations")),
            (_, false, _) => Some(format!("{rms_mm:.2} mm RMS remained, {} allowed", self.max_rms_mm)),
            (_, _, false) => {
                let (percent, needed) = (pair_share * 100.0, self.min_pair_share * 100.0);
                Some(format!("{percent:.0} % of the points had a partner, {needed:.0} % needed"))
            }
            _ => None,
        }
    }
}

/// Where a registration starts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrackStart {
    /// The pose of the scan before.
    Previous,
    /// The last pose that was not lost.
    LastGood,
    /// The start of the whole track.
    Start,
}

/// How the start of a scan was chosen.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrackReport {
    /// What it starts from.
    pub starts_from: TrackStart,
    /// Why the scan before counts as lost; `None` if it does not.
    pub lost: Option<String>,
    /// Number of scans lost in a row before this one.
    pub n_lost: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        icp::{self, Method},
        shapes,
        target::Target,
    };
    use nalgebra::Isometry3;
    use osteoflow_geometry::SurfaceOrigin;
    use std::ops::ControlFlow;

    #[test]
    fn a_registration_is_lost_if_it_has_not_converged_leaves_much_or_covers_little() {
        let points = shapes::shaft().vertices().to_vec();
        let target = Target::new("ct", SurfaceOrigin::Exact, points.clone(), None).unwrap();
        let mut go_on = |_: &icp::IcpStep| ControlFlow::Continue(());
        let start = Isometry3::identity();
        let fit =
            icp::register(Method::PointToPoint, &target, &points, &start, &Default::default(), &mut go_on).unwrap();
        let sound = fit.report;
        let limits = TrackLimits::default();
        let said = |report: IcpReport| limits.lost(&report).unwrap_or_else(|| "not lost".into());
        assert_eq!(said(sound.clone()), "not lost");
        let stopped = IcpReport { converged: false, iterations: 7, ..sound.clone() };
        assert_eq!(said(stopped), "it had not converged after 7 iterations");
        assert_eq!(said(IcpReport { rms_mm: 0.6, ..sound.clone() }), "0.60 mm RMS remained, 0.5 allowed");
        assert_eq!(said(IcpReport { rms_mm: f64::NAN, ..sound.clone() }), "NaN mm RMS remained, 0.5 allowed");
        let few = IcpReport { pair_share: 0.25, ..sound };
        assert_eq!(said(few), "25 % of the points had a partner, 50 % needed");
    }
}
