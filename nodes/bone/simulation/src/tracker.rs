//! The localiser: true poses over time, and their samples.

use crate::bone::smoothstep;
use crate::draws::{Term, direction, normal3, small_motion, stream};
use crate::params::TrackerParams;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Pose, StampNs};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The pose of a rigid object over time: at rest between moves, but where it passes.
#[derive(Debug, Clone)]
pub(crate) struct Path {
    start: Isometry3<f64>,
    moves: Vec<Move>,
    passes: Option<Passes>,
    shake: Option<Shake>,
}

/// Moments at which an object is in its place, but at a constant velocity.
#[derive(Debug, Clone)]
pub(crate) struct Passes {
    pub(crate) mm_per_s: Vector3<f64>,
    pub(crate) rad_per_s: Vector3<f64>,
    /// Of the turn, in the object's frame.
    pub(crate) pivot: Point3<f64>,
    /// In order, four seconds apart.
    pub(crate) moments_s: Vec<f64>,
    /// Time for which the velocity is constant, before and after each moment: the object is back in its place 2 s from it.
    pub(crate) half_s: f64,
}

impl Passes {
    /// Time from rest to rest.
    const REACH_S: f64 = 2.0;

    /// The time for which it has moved from its place, negative before the moment.
    fn at(&self, s: f64) -> f64 {
        let near = self.moments_s.iter().min_by(|a, b| (**a - s).abs().total_cmp(&(**b - s).abs()));
        let off_s = near.map_or(0.0, |moment| s - moment);
        let back_s =
            (self.half_s * (Self::REACH_S - off_s.abs()) / (Self::REACH_S - self.half_s)).clamp(0.0, self.half_s);
        if off_s.abs() <= self.half_s { off_s } else { back_s * off_s.signum() }
    }

    fn applied(&self, s: f64, place: &Isometry3<f64>) -> Isometry3<f64> {
        let for_s = self.at(s);
        moved(place, self.mm_per_s * for_s, self.rad_per_s * for_s, &self.pivot)
    }
}

/// An object that swings about its place for a time.
#[derive(Debug, Clone)]
pub(crate) struct Shake {
    pub(crate) from_s: f64,
    pub(crate) to_s: f64,
    pub(crate) hz: f64,
    pub(crate) shift: Vector3<f64>,
    pub(crate) turn: Vector3<f64>,
    /// Of the turn, in the object's frame.
    pub(crate) pivot: Point3<f64>,
}

impl Shake {
    /// Time in which it begins and ends.
    const RAMP_S: f64 = 0.2;

    fn applied(&self, s: f64, place: &Isometry3<f64>) -> Isometry3<f64> {
        let grown = smoothstep((s - self.from_s) / Self::RAMP_S) * smoothstep((self.to_s - s) / Self::RAMP_S);
        let share = grown * (std::f64::consts::TAU * self.hz * (s - self.from_s)).sin();
        moved(place, self.shift * share, self.turn * share, &self.pivot)
    }
}

/// A pose shifted and turned in the world about a point of the object.
fn moved(at: &Isometry3<f64>, shift: Vector3<f64>, turn: Vector3<f64>, pivot: &Point3<f64>) -> Isometry3<f64> {
    let pivot = (at * pivot).coords;
    let turn = Translation3::from(pivot) * UnitQuaternion::from_scaled_axis(turn) * Translation3::from(-pivot);
    Translation3::from(shift) * turn * at
}

#[derive(Debug, Clone, Copy)]
struct Move {
    from_s: f64,
    to_s: f64,
    shift: Vector3<f64>,
    turn: Vector3<f64>,
    /// In the object's frame.
    pivot: Point3<f64>,
}

impl Path {
    pub(crate) fn resting(start: Isometry3<f64>) -> Self {
        Self { start, moves: Vec::new(), passes: None, shake: None }
    }

    /// Lets the object pass its place at some moments: between them it goes back.
    pub(crate) fn passing(&mut self, passes: Passes) {
        self.passes = Some(passes);
    }

    /// Lets the object shake.
    pub(crate) fn shaken(&mut self, shake: Shake) {
        self.shake = Some(shake);
    }

    /// Adds a move after all others: `shift` (mm) and `turn` (rotation vector), both in world, about `pivot` of the
    /// object.
    pub(crate) fn then(&mut self, from_s: f64, to_s: f64, shift: Vector3<f64>, turn: Vector3<f64>, pivot: Point3<f64>) {
        self.moves.push(Move { from_s, to_s, shift, turn, pivot });
    }

    /// The true pose, `s` seconds after the start.
    pub(crate) fn at(&self, s: f64) -> Isometry3<f64> {
        let place = self.moves.iter().fold(self.start, |at, m| {
            let share = m.share(s);
            moved(&at, m.shift * share, m.turn * share, &m.pivot)
        });
        let place = self.passes.as_ref().map_or(place, |passes| passes.applied(s, &place));
        self.shake.as_ref().map_or(place, |shake| shake.applied(s, &place))
    }

    /// The index of the resting place, and the share of the move to the next one.
    fn place(&self, s: f64) -> (u64, f64) {
        let done = self.moves.iter().take_while(|m| s >= m.to_s).count();
        (done as u64, self.moves.get(done).map_or(0.0, |m| m.share(s)))
    }
}

impl Move {
    fn share(&self, s: f64) -> f64 {
        smoothstep((s - self.from_s) / (self.to_s - self.from_s))
    }
}

/// The markers; the discriminant selects the random stream.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Marker {
    Camera = 0,
    Phantom = 1,
    Bone = 2,
    Check = 3,
    Stylus = 4,
}

impl Marker {
    fn frame(self) -> &'static str {
        match self {
            Self::Camera => "camera_marker",
            Self::Phantom => "phantom_marker",
            Self::Bone => "bone_marker",
            Self::Check => "check_marker",
            Self::Stylus => "stylus_marker",
        }
    }
}

/// The localiser of one run.
pub(crate) struct Tracker<'a> {
    pub(crate) params: &'a TrackerParams,
    pub(crate) seed: u64,
    pub(crate) start_ns: StampNs,
}

impl Tracker<'_> {
    /// The stamp `s` seconds after the start.
    pub(crate) fn stamp(&self, s: f64) -> StampNs {
        self.start_ns + (s * 1e9).round() as StampNs
    }

    /// Drift of the localiser's world since the start.
    pub(crate) fn drift(&self, s: f64) -> Vector3<f64> {
        let way = direction(&mut stream(self.seed, Term::TrackerDrift, 0));
        way * (self.params.drift_mm_per_min * s / 60.0)
    }

    /// Samples of `marker` as `t_world_marker`, during `spans` (seconds, disjoint and in order). The marker is at
    /// `t_object_marker` (a function of time) on an object that moves along `path`, or rests at its `place`-th place, with
    /// random streams of that place. Lost samples are absent.
    pub(crate) fn samples(
        &self,
        marker: Marker,
        place: Option<u64>,
        path: &Path,
        t_object_marker: impl Fn(f64) -> Isometry3<f64>,
        spans: &[(f64, f64)],
    ) -> Vec<Pose> {
        let item = place.map_or(marker as u64, |place| (marker as u64) << 16 | place);
        let placement = |s: f64| {
            let (place, share) = place.map_or_else(|| path.place(s), |place| (place, 0.0));
            self.placement(marker, place, share)
        };
        let [mut noise, mut loss, mut repeats] =
            [Term::TrackerNoise, Term::TrackerLoss, Term::TrackerRepeats].map(|term| stream(self.seed, term, item));
        let mut jitter = Jitter::default();
        let mut is_lost = false;
        let period_s = 1.0 / self.params.rate_hz;
        let mut samples = Vec::new();
        for &(from_s, to_s) in spans {
            // What the localiser gave between spans, when objects move, is not known here.
            let mut last: Option<Isometry3<f64>> = None;
            // The localiser's clock continues between spans and is not synchronous with the camera's.
            let first_tick = (from_s / period_s).ceil() as i64;
            let last_tick = (to_s / period_s).floor() as i64;
            for tick in first_tick..=last_tick {
                let s = (tick as f64 + PHASE) * period_s;
                let jitter = jitter.next(&mut noise, tick, self.params);
                let is_repeated = self.params.repeats > 0.0 && repeats.random::<f64>() < self.params.repeats;
                is_lost = loss.random::<f64>() < self.lost_after(is_lost);
                let truth = path.at(s) * t_object_marker(s);
                let seen = self.written(Translation3::from(self.drift(s)) * truth * placement(s) * jitter);
                // A lost sample is repeated as any other, so that losses change no other sample.
                let seen = last.filter(|_| is_repeated).unwrap_or(seen);
                last = Some(seen);
                if is_lost {
                    continue;
                }
                samples.push(Pose::new("world", marker.frame(), seen).at(self.stamp(s + self.params.late_s)));
            }
        }
        samples
    }

    /// The chance that a sample is lost, after one that was or was not.
    fn lost_after(&self, is_lost: bool) -> f64 {
        let TrackerParams { lost, lost_run, .. } = *self.params;
        match lost_run {
            run if run <= 1.0 => lost,
            run if is_lost => 1.0 - 1.0 / run,
            // So that the share of all samples is `lost`.
            run => (lost / (1.0 - lost) / run).min(1.0),
        }
    }

    /// A pose with the step of its coordinates.
    fn written(&self, mut pose: Isometry3<f64>) -> Isometry3<f64> {
        let step_mm = self.params.step_mm;
        if step_mm > 0.0 {
            pose.translation.vector.apply(|c| *c = (*c / step_mm).round() * step_mm);
        }
        pose
    }

    /// The constant error of a marker at rest, interpolated during a move between those of both places.
    fn placement(&self, marker: Marker, place: u64, share: f64) -> Isometry3<f64> {
        let (mut shift, mut turn) = self.placement_at(marker, place);
        if share > 0.0 {
            let (next_shift, next_turn) = self.placement_at(marker, place + 1);
            (shift, turn) = (shift.lerp(&next_shift, share), turn.lerp(&next_turn, share));
        }
        Isometry3::new(shift, turn)
    }

    /// Shift and rotation of a marker's constant error at one of its places.
    fn placement_at(&self, marker: Marker, place: u64) -> (Vector3<f64>, Vector3<f64>) {
        let mut rng = stream(self.seed, Term::TrackerPlacement, (marker as u64) << 16 | place);
        let shift = normal3(&mut rng) * self.params.placement_mm;
        (shift, normal3(&mut rng) * self.params.placement_deg.to_radians())
    }

    /// One sample of a marker that truly is at `t_world_marker`, at its `place`-th place; `noise` is the marker's
    /// stream.
    pub(crate) fn sample(
        &self,
        marker: Marker,
        t_world_marker: &Isometry3<f64>,
        place: u64,
        s: f64,
        noise: &mut ChaCha8Rng,
    ) -> Pose {
        let (shift, turn) = self.placement_at(marker, place);
        let jitter = small_motion(noise, self.params.noise_mm, self.params.noise_deg.to_radians());
        let seen = Translation3::from(self.drift(s)) * t_world_marker * Isometry3::new(shift, turn) * jitter;
        Pose::new("world", marker.frame(), self.written(seen)).at(self.stamp(s))
    }
}

/// The noise of one marker from sample to sample: each the last one times a correlation, and something new.
#[derive(Default)]
struct Jitter {
    /// Shift and rotation, in standard deviations.
    last: (Vector3<f64>, Vector3<f64>),
    tick: Option<i64>,
}

impl Jitter {
    fn next(&mut self, rng: &mut ChaCha8Rng, tick: i64, params: &TrackerParams) -> Isometry3<f64> {
        let fresh = (normal3(rng), normal3(rng));
        let n_since = self.tick.map_or(f64::INFINITY, |last| (tick - last) as f64);
        let kept = params.noise_lag1.powf(n_since);
        let of_fresh = (1.0 - kept * kept).sqrt();
        self.last = (self.last.0 * kept + fresh.0 * of_fresh, self.last.1 * kept + fresh.1 * of_fresh);
        self.tick = Some(tick);
        Isometry3::new(self.last.0 * params.noise_mm, self.last.1 * params.noise_deg.to_radians())
    }
}

/// Phase of the samples within the period, so that no sample has the stamp of a cloud.
const PHASE: f64 = 0.37;

#[cfg(test)]
mod tests {
    use super::*;

    fn tracker(params: &TrackerParams, seed: u64) -> Tracker<'_> {
        Tracker { params, seed, start_ns: 1_750_000_000_000_000_000 }
    }

    fn quiet() -> TrackerParams {
        TrackerParams {
            lost: 0.0,
            placement_mm: 0.0,
            placement_deg: 0.0,
            noise_mm: 0.0,
            noise_deg: 0.0,
            noise_lag1: 0.0,
            step_mm: 0.0,
            repeats: 0.0,
            lost_run: 0.0,
            drift_mm_per_min: 0.0,
            ..TrackerParams::default()
        }
    }

    #[test]
    fn a_path_rests_before_and_after_its_move_and_turns_about_the_pivot() {
        let mut path = Path::resting(Isometry3::translation(1.0, 2.0, 3.0));
        let pivot = Point3::new(10.0, 0.0, 0.0);
        path.then(2.0, 4.0, Vector3::new(0.0, 0.0, 5.0), Vector3::z() * 0.4, pivot);
        assert_eq!(path.at(1.9), path.at(0.0));
        assert_eq!(path.at(4.0), path.at(9.0));
        let moved = path.at(9.0) * pivot - path.at(0.0) * pivot;
        assert!((moved - Vector3::new(0.0, 0.0, 5.0)).norm() < 1e-12, "the pivot only shifts, not by {moved}");
        assert!((path.at(9.0).rotation.angle() - 0.4).abs() < 1e-12);
    }

    #[test]
    fn white_noise_and_lost_samples_are_as_large_as_requested() {
        let params = TrackerParams { noise_mm: 0.03, noise_deg: 0.0115, lost: 0.03, ..quiet() };
        let rest = Path::resting(Isometry3::translation(100.0, 0.0, 0.0));
        let samples =
            tracker(&params, 5).samples(Marker::Bone, None, &rest, |_| Isometry3::identity(), &[(0.0, 500.0)]);
        let lost = 1.0 - samples.len() as f64 / 10_000.0;
        // Four standard errors of a share of 0.03 over 10,000.
        assert!((lost - 0.03).abs() < 0.007, "{lost} of the samples are lost");
        let n = samples.len() as f64;
        let off = samples.iter().map(|p| p.isometry.translation.vector - Vector3::new(100.0, 0.0, 0.0));
        let spread = (off.map(|d| d.norm_squared()).sum::<f64>() / (3.0 * n)).sqrt();
        assert!((spread - 0.03).abs() < 0.001, "{spread} mm per axis");
        let turns = samples.iter().map(|p| p.isometry.rotation.angle().powi(2)).sum::<f64>();
        let spread_deg = (turns / (3.0 * n)).sqrt().to_degrees();
        assert!((spread_deg - 0.0115).abs() < 0.0004, "{spread_deg} degrees about each axis");
    }

    #[test]
    fn the_error_of_a_placement_is_constant_until_the_next_move() {
        let params = TrackerParams { placement_mm: 0.06, placement_deg: 0.023, ..quiet() };
        let (mut square_mm, mut square_deg) = (0.0, 0.0);
        const RUNS: u64 = 400;
        for seed in 0..RUNS {
            let mut path = Path::resting(Isometry3::identity());
            path.then(1.0, 2.0, Vector3::x(), Vector3::zeros(), Point3::origin());
            let samples = tracker(&params, seed).samples(
                Marker::Bone,
                None,
                &path,
                |_| Isometry3::identity(),
                &[(0.0, 0.9), (2.1, 3.0)],
            );
            let (before, after): (Vec<&Pose>, Vec<&Pose>) =
                samples.iter().partition(|p| p.stamp_ns < 1_750_000_001_500_000_000);
            assert!(before.iter().all(|p| p.isometry == before[0].isometry));
            assert!(after.iter().all(|p| p.isometry == after[0].isometry));
            let shift = after[0].isometry.translation.vector - Vector3::x();
            assert_ne!(before[0].isometry.translation.vector, shift);
            square_mm += shift.norm_squared() / 3.0;
            square_deg += after[0].isometry.rotation.angle().to_degrees().powi(2) / 3.0;
        }
        let (mm, deg) = ((square_mm / RUNS as f64).sqrt(), (square_deg / RUNS as f64).sqrt());
        // Three standard errors over 1,200 draws are 6 %.
        assert!((mm - 0.06).abs() < 0.004 && (deg - 0.023).abs() < 0.0015, "{mm} mm, {deg} degrees");
    }

    #[test]
    fn a_repeated_sample_is_never_of_the_place_before_a_pause() {
        let params = TrackerParams { repeats: 0.9, ..quiet() };
        let mut path = Path::resting(Isometry3::identity());
        path.then(1.0, 2.0, Vector3::x(), Vector3::zeros(), Point3::origin());
        for seed in 0..20 {
            let samples = tracker(&params, seed).samples(
                Marker::Bone,
                None,
                &path,
                |_| Isometry3::identity(),
                &[(0.0, 0.9), (2.1, 3.0)],
            );
            let after = samples.iter().filter(|p| p.stamp_ns > 1_750_000_002_000_000_000);
            assert!(after.map(|p| p.isometry.translation.vector).all(|at| at == Vector3::x()), "seed {seed}");
        }
    }

    #[test]
    fn stamps_rise_and_never_meet_a_whole_second() {
        let samples = tracker(&quiet(), 1).samples(
            Marker::Camera,
            None,
            &Path::resting(Isometry3::identity()),
            |_| Isometry3::identity(),
            &[(0.4, 1.6), (10.4, 11.6)],
        );
        assert!(samples.windows(2).all(|w| w[0].stamp_ns < w[1].stamp_ns));
        assert!(samples.iter().all(|p| p.stamp_ns % 1_000_000_000 != 0));
    }
}
