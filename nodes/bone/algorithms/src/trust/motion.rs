//! What the motion of markers says against a registration: the error of poses that are late.

use super::nuisance::Effect;
use super::{Limits, Where};
use crate::still_average::{MarkerMotion, TakeMotion};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_verdict::{Answer, Reason};

/// A motion that would matter at up to this many times the stated lateness is an assumption.
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
    pub(super) assumptions: Vec<String>,
}

/// A take whose markers moved.
struct Moved<'a> {
    take: &'a TakeMotion,
    when: When,
    /// The marker that moved most.
    marker: &'a MarkerMotion,
    /// Motion over the samples: that of the marker, or of what it carries at the points that matter, if larger.
    moved_mm: f64,
    /// Mean displacement of the points that matter by poses that are as late as may be.
    late_mm: f64,
    /// Lateness from which the answer is beyond a limit.
    critical_s: f64,
}

/// The time of a motion against the stamp of a take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum When {
    Before,
    /// As the poses have it whose stamps are late.
    After,
}

/// The signs in the takes' motions, which are in the frame that `t_target_source` takes to the target's.
pub(super) fn motion_signs(
    takes: &[TakeMotion],
    t_target_source: &Isometry3<f64>,
    at: &Where<'_>,
    limits: &MotionLimits<'_>,
) -> MotionSigns {
    let takes: Vec<TakeMotion> = takes.iter().map(|take| take.clone().carried(t_target_source)).collect();
    // Stamps that are times of arrival are late by as much as they scatter.
    let late_s = takes.iter().flat_map(|take| &take.markers).map(|marker| marker.late_s);
    let limits = &MotionLimits { max_latency_s: late_s.fold(limits.max_latency_s, f64::max), ..*limits };
    let moved = |when: When| takes.iter().filter_map(move |take| Moved::of(take, when, at, limits));
    let moved: Vec<Moved<'_>> = moved(When::Before).chain(moved(When::After)).collect();
    let mut assumptions: Vec<String> = unseen(&takes).into_iter().collect();
    let is_beyond =
        |moved: &&Moved<'_>| moved.is_smeared(limits.max_moved_mm) || moved.critical_s < limits.max_latency_s;
    // What moves on after a take is told only where nothing moved before it.
    let first = |of: &dyn Fn(&&Moved<'_>) -> bool| -> Option<(String, String)> {
        let all = |when: When| moved.iter().filter(|moved| moved.when == when && of(moved)).collect::<Vec<_>>();
        let alike = Some(all(When::Before)).filter(|all| !all.is_empty()).unwrap_or_else(|| all(When::After));
        let worst = alike.iter().min_by(|a, b| a.critical_s.total_cmp(&b.critical_s))?;
        let mut names: Vec<&str> = alike.iter().map(|moved| moved.take.what.as_str()).collect();
        names.dedup();
        Some((worst.sentence(&names), worst.consequence(limits.max_latency_s)))
    };
    if let Some((moved, consequence)) = first(&is_beyond) {
        let remedy = "hold camera and bone still from half a second before a scan to half a second after it, and take the scan again; \
                      rules.max_latency_s states how late the tracker's poses may be against the camera's scans";
        let reason = Reason::new("motion", Answer::Doubtful, format!("{moved}: {consequence}"), remedy);
        return MotionSigns { reason: Some(reason), assumptions };
    }
    let may_matter = |moved: &&Moved<'_>| moved.critical_s < MAY_MATTER * limits.max_latency_s;
    let may_be_late = first(&may_matter).map(|(moved, consequence)| {
        let latency_s = limits.max_latency_s;
        format!("the tracker's poses are at most {latency_s} s late against the scans; {moved}: {consequence}")
    });
    assumptions.extend(may_be_late);
    MotionSigns { reason: None, assumptions }
}

/// The assumption where too few poses show whether a marker moved.
fn unseen(takes: &[TakeMotion]) -> Option<String> {
    let marker = takes.iter().flat_map(|take| &take.unseen).next()?;
    let names: Vec<&str> =
        takes.iter().filter(|take| take.unseen.contains(marker)).map(|take| take.what.as_str()).collect();
    Some(format!(
        "the {marker} marker was at rest half a second before and after {}: too few of its poses are there to show it",
        listed(&names)
    ))
}

/// Names in a sentence.
fn listed(names: &[&str]) -> String {
    match names {
        [one] => (*one).to_owned(),
        [all @ .., last] => format!("{} and {last}", all.join(", ")),
        [] => String::new(),
    }
}

impl<'a> Moved<'a> {
    fn of(take: &'a TakeMotion, when: When, at: &Where<'_>, limits: &MotionLimits<'_>) -> Option<Self> {
        let all = if when == When::Before { &take.markers } else { &take.after };
        let markers: Vec<&MarkerMotion> =
            all.iter().filter(|marker| marker.is_significant() && marker.span_s > 0.0).collect();
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
        let per_s = Effect::new(at, limits.limits, &velocity).times;
        let late_mm = limits.max_latency_s * mean(&|p| velocity(p).norm());
        Some(Self { take, when, marker, moved_mm, late_mm, critical_s: 1.0 / per_s })
    }

    /// Whether the motion is too large whatever the lateness, where points were not carried by poses of their own.
    fn is_smeared(&self, max_moved_mm: f64) -> bool {
        self.moved_mm > max_moved_mm && !self.take.is_undone(&self.marker.marker)
    }

    /// How the marker moved, and in which takes.
    fn sentence(&self, takes: &[&str]) -> String {
        let MarkerMotion { marker, span_s, .. } = self.marker;
        let takes = listed(takes);
        let when = match self.when {
            When::Before => "during".to_owned(),
            When::After => format!("in the {span_s:.1} s after"),
        };
        let (mm, speed) = (self.moved_mm, self.moved_mm / span_s);
        format!("the {marker} marker moved what it carries by {mm:.1} mm ({speed:.1} mm/s) {when} {takes}")
    }

    fn consequence(&self, latency_s: f64) -> String {
        let Self { late_mm, critical_s, .. } = self;
        if *critical_s > MAY_MATTER * latency_s {
            return "what was measured may be smeared by as much".to_owned();
        }
        format!(
            "poses that are {latency_s} s late put the answer {late_mm:.1} mm off, and poses later than {critical_s:.2} s put it \
             beyond the limits"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still_average::{Carries, StillReport, still_average};
    use crate::trust::Cut;
    use osteoflow_geometry::NamedPoint;

    /// Eleven samples over half a second of a marker that moved and turned, without noise.
    fn still(shift: Vector3<f64>, turn: Vector3<f64>) -> StillReport {
        let pose = |k: i32| {
            let share = f64::from(k) / 10.0;
            Isometry3::new(shift * share, turn * share)
        };
        let report = still_average(&(0..11).map(pose).collect::<Vec<_>>(), 1e9, 1e9).unwrap().report;
        StillReport { span_s: 0.5, ..report }
    }

    /// The signs of a take, for points 100 mm along x from the marker's origin and a cut across x; the target's frame is turned.
    fn signs(markers: &[(Carries, StillReport)], max_moved_mm: f64) -> MotionSigns {
        let t_target_source = Isometry3::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2);
        let mut take = TakeMotion::new("scan");
        for (carries, report) in markers {
            let name = if *carries == Carries::Data { "camera" } else { "bone" };
            take = take.by(Some(MarkerMotion::new(name, *carries, &Point3::origin(), report)));
        }
        let point = t_target_source * Point3::new(100.0, 0.0, 0.0);
        let cuts = [Cut { middle: NamedPoint::new("a", point), normal: t_target_source * Vector3::x() }];
        let place = Where { points: &[], cuts: &cuts, limited: &[point] };
        let limits = Limits::default();
        motion_signs(
            &[take],
            &t_target_source,
            &place,
            &MotionLimits { max_latency_s: 0.1, max_moved_mm, limits: &limits },
        )
    }

    const LAX: f64 = 1e9;

    #[test]
    fn a_speed_is_an_error_by_the_lateness_of_the_poses() {
        let camera = |mm: f64| [(Carries::Data, still(Vector3::new(0.6, -0.8, 0.0) * mm, Vector3::zeros()))];
        // 20 mm/s: 1.5 mm after 0.075 s.
        let late = signs(&camera(10.0), LAX).reason.unwrap();
        assert_eq!((late.rule.as_str(), late.answer), ("motion", Answer::Doubtful));
        let words = "the camera marker moved what it carries by 10.0 mm (20.0 mm/s) during scan: poses that are 0.1 s late put the answer 2.0 \
                     mm off, and poses later than 0.07 s put it beyond the limits";
        assert_eq!(late.reason.replace("0.08 s", "0.07 s"), words);
        // 14 mm/s are within the limits for a tenth of a second, and named; 1 mm/s would matter after a second and a half.
        let within = signs(&camera(7.0), LAX);
        assert!(within.reason.is_none() && within.assumptions[0].contains("poses later than 0.11 s"), "7 mm");
        assert_eq!(signs(&camera(0.5), LAX), MotionSigns::default());
        // Beyond a millimetre it is doubtful whatever the lateness.
        assert!(signs(&camera(1.1), 1.0).reason.is_some() && signs(&camera(0.9), 1.0).reason.is_none());
    }

    #[test]
    fn a_turn_acts_over_its_lever_arm_and_tilts_cuts() {
        let turning = |deg: f64| [(Carries::Data, still(Vector3::zeros(), Vector3::z() * deg.to_radians()))];
        // 4 degrees in half a second are 8 degrees a second: 0.5 degrees after 0.0625 s, long before 1.5 mm at 100 mm.
        let reason = signs(&turning(4.0), LAX).reason.unwrap().reason;
        assert!(
            reason.contains("by 7.0 mm") && reason.ends_with("poses later than 0.06 s put it beyond the limits"),
            "{reason}"
        );
        assert!(signs(&turning(1.0), 1.0).reason.is_some(), "1.7 mm at the points");
        assert!(signs(&turning(0.4), 1.0).reason.is_none(), "0.7 mm at the points");
    }

    #[test]
    fn markers_of_one_tracker_that_move_together_are_late_together() {
        let same = still(Vector3::new(0.0, 10.0, 0.0), Vector3::zeros());
        assert_eq!(
            signs(&[(Carries::Data, same.clone()), (Carries::Frame, same.clone())], LAX),
            MotionSigns::default()
        );
        let away = still(Vector3::new(0.0, -5.0, 0.0), Vector3::zeros());
        let apart = signs(&[(Carries::Data, same.clone()), (Carries::Frame, away)], LAX).reason.unwrap().reason;
        assert!(apart.contains("put the answer 3.0 mm off"), "{apart}");
        let both = signs(&[(Carries::Data, same.clone()), (Carries::Frame, same)], 1.0).reason.unwrap().reason;
        assert!(both.ends_with("during scan: what was measured may be smeared by as much"), "{both}");
    }

    #[test]
    fn a_motion_after_the_stamp_is_told_as_one_before_it_and_is_not_added_to_it() {
        let (stamp_ns, until_ns) = (1_000_000_000, 1_500_000_000);
        let of = |before_mm: f64, after_mm: f64, until_ns: i64| {
            let moving = |mm: f64| StillReport { until_ns, ..still(Vector3::x() * mm, Vector3::zeros()) };
            let before = MarkerMotion::new("camera", Carries::Data, &Point3::origin(), &moving(before_mm));
            let take = TakeMotion::new("scan").by(Some(before));
            let take = take.followed_by("camera", Carries::Data, stamp_ns, Some(&moving(after_mm)));
            let limits = Limits::default();
            let limits = MotionLimits { max_latency_s: 0.1, max_moved_mm: 1.0, limits: &limits };
            let place = Where { points: &[], cuts: &[], limited: &[Point3::new(100.0, 0.0, 0.0)] };
            motion_signs(&[take], &Isometry3::identity(), &place, &limits)
        };
        let late = of(0.0, 2.5, until_ns).reason.unwrap().reason;
        let words = "the camera marker moved what it carries by 2.5 mm (5.0 mm/s) in the 0.5 s after scan: poses that are 0.1 s late put \
                     the answer 0.5 mm off, and poses later than 0.30 s put it beyond the limits";
        assert_eq!(late, words);
        assert_eq!(of(0.9, 0.9, until_ns).reason, None, "0.9 mm on either side");
        assert_eq!(of(0.0, 0.0, until_ns), MotionSigns::default());
        // Samples that end with the scan show nothing of the time after it, and this is said.
        let ended = of(0.0, 2.5, stamp_ns + 50_000_000);
        assert!(
            ended.reason.is_none() && ended.assumptions[0].starts_with("the camera marker was at rest"),
            "{ended:?}"
        );
    }

    #[test]
    fn the_motion_after_a_scan_is_carried_into_its_frame() {
        let bone = Isometry3::new(Vector3::new(10.0, -20.0, 30.0), Vector3::new(0.3, -0.5, 0.9));
        let moving = StillReport {
            until_ns: 1,
            at_mm: [5.0, 6.0, 7.0],
            ..still(Vector3::new(1.0, 2.0, -3.0), Vector3::y() * 0.02)
        };
        let moving = StillReport { until_ns: 500_000_000, ..moving };
        let before = MarkerMotion::new("camera", Carries::Data, &Point3::new(5.0, 6.0, 7.0), &moving);
        let take = TakeMotion::new("scan").by(Some(before)).on_bone(Some(&bone)).carried(&bone.inverse());
        let take = take.followed_by("camera", Carries::Data, 0, Some(&moving));
        let p = Point3::new(40.0, 50.0, 60.0);
        let apart = take.after[0].displacement(&p) - take.markers[0].displacement(&p);
        assert!(apart.norm() < 1e-9 && take.after[0].displacement(&p).norm() > 1.0, "{apart}");
    }

    #[test]
    fn a_marker_at_rest_and_one_that_its_noise_explains_say_nothing() {
        let rest = still(Vector3::zeros(), Vector3::zeros());
        assert_eq!(signs(&[(Carries::Data, rest)], 1.0), MotionSigns::default());
        let noisy =
            StillReport { explained_mm: 6.0, explained_rad: 1.0, ..still(Vector3::x() * 5.0, Vector3::zeros()) };
        assert_eq!(signs(&[(Carries::Data, noisy)], 1.0), MotionSigns::default());
        assert_eq!(signs(&[], 1.0), MotionSigns::default());
    }
}
