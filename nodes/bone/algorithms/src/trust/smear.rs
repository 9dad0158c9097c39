//! What the motion of markers while a scan was taken does to its registration: the scan is sheared, stretched and twisted.

use super::evidence::Registered;
use super::nuisance::{Axes, Effect};
use super::predict::SCAN_MOTION;
use super::{Limits, Predicted, Residual, Residuals, RuleParams, Where};
use crate::kabsch::centroid;
use crate::still_average::{MarkerMotion, TakeMotion};
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use osteoflow_verdict::{Answer, Reason};

/// Number of points of the scan that are examined.
const N_POINTS: usize = 2000;

/// Points farther from the surface are of something else, mm.
const REACH_MM: f64 = 3.0;

/// An effect of less than this share of a limit is not told.
const MATTERS: f64 = 0.1;

/// The motion while a scan was taken, and the error of the pose that it makes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Smear {
    /// Covariance of shift and turn about a point of the target's frame: an error of one standard deviation for a sweep along the scan, one
    /// across it, and one for a stamp that is not in its middle.
    pub(super) pose: (Matrix6<f64>, Point3<f64>),
    /// The largest effect of these.
    effect: Effect,
    /// The markers that moved.
    markers: Vec<String>,
    /// Motion of what is scanned in the camera over the time of the scan, mean over its points, mm.
    moved_mm: f64,
    duration_s: f64,
    /// Whether that time is assumed.
    is_assumed: bool,
}

impl Smear {
    /// `None` where the markers were at rest, where each point was carried by the poses at its own time, or where the surface has no normals.
    ///
    /// A point measured at a time `t` from the stamp is put wrong by `-v t`, where `v` is its velocity by the markers' motion. Which points were
    /// measured when is not known: the scan is swept along its long axis or across it. The registration answers to that field as any least squares
    /// of distances along the normals does.
    pub(super) fn new(
        take: &TakeMotion,
        registered: &Registered<'_>,
        place: &Where<'_>,
        rules: &RuleParams,
    ) -> Option<Self> {
        let Registered { target, source, t_target_source, .. } = *registered;
        let (assumed_s, time) = (rules.assumed_scan_s, take.time.as_ref());
        let duration_s = time.map_or(assumed_s, |time| time.duration_s);
        let near = Residuals::new(target, source.points(), t_target_source, REACH_MM, N_POINTS)?.near;
        let (points, normals): (Vec<_>, Vec<_>) = near.iter().map(|at| (at.point, at.normal)).unzip();
        let camera = source.viewpoint.map(|viewpoint| t_target_source * (viewpoint * Point3::origin()));
        let axes = Axes::new(&points, &normals, camera)?;
        let answer = Answering::new(&near)?;
        let of_phase = |(phase, markers): (usize, &Vec<MarkerMotion>)| {
            let moved: Vec<MarkerMotion> = markers.iter().map(|m| m.clone().carried(t_target_source)).collect();
            let for_s = if phase == 0 { duration_s } else { duration_s / 2.0 };
            let motion = |p: &Point3<f64>| -> Vector3<f64> {
                moved.iter().map(|m| m.displacement(p) * (for_s / m.span_s.max(1e-3))).sum()
            };
            let middle = match time.map(|time| time.middle_s) {
                Some(Some(middle_s)) => middle_s / duration_s.max(1e-9),
                _ => 0.5,
            };
            let swept = |way: Vector3<f64>| {
                let mut reach: Vec<f64> = points.iter().map(|p| (p - axes.centre).dot(&way)).collect();
                reach.sort_by(f64::total_cmp);
                let [first, last] =
                    [0.02, 0.98].map(|share| reach[((reach.len() - 1) as f64 * share).round() as usize]);
                let share =
                    move |p: &Point3<f64>| ((p - axes.centre).dot(&way) - first) / (last - first).max(1.0) - 0.5;
                answer.pose(&near, &|p| -motion(p) * share(p).clamp(-0.5, 0.5))
            };
            let poses = [swept(axes.along), swept(axes.sideways), answer.pose(&near, &|p| -motion(p) * middle)];
            let effect = |pose: &Vector6<f64>| Effect::new(place, &rules.limits, &|p| answer.error(pose, p));
            let effect = poses.iter().map(effect).reduce(Effect::larger).unwrap_or_default();
            let moved_mm = points.iter().map(|p| motion(p).norm()).sum::<f64>() / points.len().max(1) as f64;
            let covariance = poses.iter().map(|pose| pose * pose.transpose()).sum();
            let markers = moved.iter().map(|marker| marker.marker.clone()).collect();
            let pose = (covariance, answer.centre);
            Self { pose, effect, markers, moved_mm, duration_s, is_assumed: time.is_none() }
        };
        let phases = take.during.iter().enumerate().filter(|(_, markers)| !markers.is_empty());
        phases.map(of_phase).max_by(|a, b| a.effect.times.total_cmp(&b.effect.times))
    }

    /// The sign that the motion makes an error beyond the limits likely: where it is the largest part of the predicted one.
    pub(super) fn reason(&self, predicted: &Predicted, rules: &RuleParams) -> Option<Reason> {
        let of = |name: &str| predicted.terms.iter().find(|term| term.name == name).map_or(0.0, |term| term.tre_mm);
        let is_largest = predicted.terms.iter().all(|term| term.tre_mm <= of(SCAN_MOTION));
        let is_likely = predicted.beyond_limits > rules.max_beyond_limits && (is_largest || self.effect.times > 1.0);
        let remedy = "hold camera and bone still and take the scan again; or give each point its time (a column `t`) and wire `path` of \
                      transform.to_world and transform.to_bone_marker; duration_s of transform.to_world states how long a scan takes";
        is_likely.then(|| Reason::new("smeared", Answer::Doubtful, self.sentence(), remedy))
    }

    /// What is taken for granted where the motion would matter if it were larger, or the scan took longer.
    pub(super) fn assumption(&self, limits: &Limits) -> Option<String> {
        let critical_mm = self.moved_mm / self.effect.times;
        (self.effect.times >= MATTERS).then(|| {
            format!(
                "{}; a motion of {critical_mm:.1} mm over the scan would put it beyond the limits ({} mm, {} degrees)",
                self.sentence(),
                limits.max_tre_mm,
                limits.max_tilt_deg
            )
        })
    }

    fn sentence(&self) -> String {
        let Self { effect: Effect { mm, deg, .. }, moved_mm, duration_s, .. } = self;
        let (markers, s) = (self.markers.join(" and "), if self.markers.len() > 1 { "s" } else { "" });
        let over = match self.is_assumed {
            true => {
                format!("{duration_s:.1} s, which it is assumed to take (duration_s of transform.to_world states it)")
            }
            false => format!("the {duration_s:.1} s of the scan"),
        };
        format!(
            "the {markers} marker{s} moved the bone in the camera by {moved_mm:.1} mm over {over}: the scan is sheared or stretched by as much, \
             which puts the answer up to {mm:.1} mm and {deg:.1} degrees off"
        )
    }
}

/// How a registration answers to displacements of its scan.
struct Answering {
    inverse: Matrix6<f64>,
    centre: Point3<f64>,
}

impl Answering {
    fn new(near: &[Residual]) -> Option<Self> {
        let centre = centroid(&near.iter().map(|at| at.point).collect::<Vec<_>>());
        let h: Matrix6<f64> = near.iter().map(|at| row(at, &centre)).map(|row| row * row.transpose()).sum();
        Some(Self { inverse: h.cholesky()?.inverse(), centre })
    }

    /// The error of the pose, shift and turn about the centre, by displacements of the scan.
    fn pose(&self, near: &[Residual], displaced: &dyn Fn(&Point3<f64>) -> Vector3<f64>) -> Vector6<f64> {
        let b: Vector6<f64> = near.iter().map(|at| row(at, &self.centre) * at.normal.dot(&displaced(&at.point))).sum();
        -(self.inverse * b)
    }

    /// That error at a point, mm.
    fn error(&self, pose: &Vector6<f64>, p: &Point3<f64>) -> Vector3<f64> {
        pose.fixed_rows::<3>(0) + pose.fixed_rows::<3>(3).cross(&(p - self.centre))
    }
}

/// How far a point moves along its normal with shift and turn about a centre.
fn row(at: &Residual, centre: &Point3<f64>) -> Vector6<f64> {
    let (n, turn) = (at.normal, (at.point - centre).cross(&at.normal));
    Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z)
}
