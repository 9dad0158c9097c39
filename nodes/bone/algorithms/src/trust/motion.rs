//! What the motion of markers says against a registration: the error of poses that are late.

use super::{Cut, Limits, Where};
use crate::still_average::{MarkerMotion, TakeMotion};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_verdict::{Answer, Reason};

/// A motion is told from so many times the stated lateness on at which it would matter.
const MAY_MATTER: f64 = 10.0;

/// Thresholds of the rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MotionLimits<'a> {
    /// By how much poses may be late.
    pub(super) max_latency_s: f64,
    /// Motion during a take that raises no doubt, mm.
    pub(super) max_moved_mm: f64,
    /// Limits of a right answer.
    pub(super) limits: &'a Limits,
}

/// What motion says against a registration, or what is taken for granted about it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct MotionSigns {
    pub(super) reason: Option<Reason>,
    pub(super) assumption: Option<String>,
}

/// A take whose markers moved.
struct Moved<'a> {
    take: &'a TakeMotion,
    /// The marker that moved most.
    marker: &'a MarkerMotion,
    /// Motion over the samples: that of the marker, or of what it carries at the points that matter, if larger.
    moved_mm: f64,
    /// Mean displacement of the points that matter by poses that are as late as may be.
    late_mm: f64,
    /// Lateness from which the answer is beyond a limit.
    critical_s: f64,
}

/// The signs in the takes' motions, which are in the frame that `t_target_source` takes to the target's.
pub(super) fn motion_signs(
    takes: &[TakeMotion],
    t_target_source: &Isometry3<f64>,
    at: &Where<'_>,
    limits: &MotionLimits<'_>,
) -> MotionSigns {
    let takes: Vec<TakeMotion> = takes.iter().map(|take| take.clone().carried(t_target_source)).collect();
    let moved: Vec<Moved<'_>> = takes.iter().filter_map(|take| Moved::of(take, at, limits)).collect();
    let is_beyond =
        |moved: &&Moved<'_>| moved.moved_mm > limits.max_moved_mm || moved.critical_s < limits.max_latency_s;
    let first = |of: &mut dyn Iterator<Item = &Moved<'_>>| -> Option<(String, String)> {
        let all: Vec<&Moved<'_>> = of.collect();
        let worst = all.iter().min_by(|a, b| a.critical_s.total_cmp(&b.critical_s))?;
        let mut names: Vec<&str> = all.iter().map(|moved| moved.take.what.as_str()).collect();
        names.dedup();
        Some((worst.sentence(&names), worst.consequence(limits.max_latency_s)))
    };
    if let Some((moved, consequence)) = first(&mut moved.iter().filter(is_beyond)) {
        let remedy = "hold camera and bone still while they are measured, and take the scan again; rules.max_latency_s states \
                      how late the tracker's poses may be against the camera's scans";
        let reason = Reason::new("motion", Answer::Doubtful, format!("{moved}: {consequence}"), remedy);
        return MotionSigns { reason: Some(reason), assumption: None };
    }
    let may_matter = |moved: &&Moved<'_>| moved.critical_s < MAY_MATTER * limits.max_latency_s;
    let assumption = first(&mut moved.iter().filter(may_matter)).map(|(moved, consequence)| {
        let latency_s = limits.max_latency_s;
        format!("the tracker's poses are at most {latency_s} s late against the scans; {moved}: {consequence}")
    });
    MotionSigns { reason: None, assumption }
}

impl<'a> Moved<'a> {
    fn of(take: &'a TakeMotion, at: &Where<'_>, limits: &MotionLimits<'_>) -> Option<Self> {
        let markers: Vec<&MarkerMotion> =
            take.markers.iter().filter(|marker| marker.is_significant() && marker.span_s > 0.0).collect();
        let n = at.limited.len().max(1) as f64;
        let mean = |of: &dyn Fn(&Point3<f64>) -> f64| at.limited.iter().map(of).sum::<f64>() / n;
        let size = |marker: &&MarkerMotion| {
            let own = if marker.shift_mm == [0.0; 3] { 0.0 } else { marker.moved_mm };
            own.max(mean(&|p| marker.displacement(p).norm()))
        };
        let (marker, moved_mm) =
            markers.iter().map(|marker| (*marker, size(marker))).max_by(|a, b| a.1.total_cmp(&b.1))?;
        // Poses of one tracker are late together, so motions of two markers add up with their signs.
        let velocity = |p: &Point3<f64>| -> Vector3<f64> { markers.iter().map(|m| m.displacement(p) / m.span_s).sum() };
        let spin: Vector3<f64> = markers.iter().map(|m| Vector3::from(m.turn_rad) / m.span_s).sum();
        let largest = |of: &dyn Fn(&Cut) -> f64| at.cuts.iter().map(of).fold(0.0, f64::max);
        let per_s = limits.limits.times(
            mean(&|p| velocity(p).norm()),
            largest(&|cut| velocity(&cut.middle.position).dot(&cut.normal).abs()),
            largest(&|cut| spin.cross(&cut.normal).norm().to_degrees()),
        );
        let late_mm = limits.max_latency_s * mean(&|p| velocity(p).norm());
        Some(Self { take, marker, moved_mm, late_mm, critical_s: 1.0 / per_s })
    }

    /// How the marker moved, and in which takes.
    fn sentence(&self, takes: &[&str]) -> String {
        let MarkerMotion { marker, span_s, .. } = self.marker;
        let takes = match takes {
            [one] => (*one).to_owned(),
            [all @ .., last] => format!("{} and {last}", all.join(", ")),
            [] => String::new(),
        };
        let (mm, speed) = (self.moved_mm, self.moved_mm / span_s);
        format!("the {marker} marker moved what it carries by {mm:.1} mm ({speed:.1} mm/s) during {takes}")
    }

    fn consequence(&self, latency_s: f64) -> String {
        let Self { late_mm, critical_s, .. } = self;
        format!(
            "poses that are {latency_s} s late put the answer {late_mm:.1} mm off, and poses later than {critical_s:.2} s put it \
             beyond the limits"
        )
    }
}
