//! The tip of a stylus.

use super::{Draws, Expected, Outcome, Row, compare, mirrored, mirrored_place, scaled, transposed, w_first};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::calibrate::pivot;

/// A stylus that is turned about its tip in a divot, 50 poses a second.
struct Stylus {
    tip: Vector3<f64>,
    divot: Vector3<f64>,
    noise_mm: f64,
    noise_deg: f64,
    poses: Vec<Isometry3<f64>>,
    draws: Draws,
}

/// How a log is taken.
#[derive(Clone, Copy)]
struct Taken {
    n: (usize, usize),
    tilt_deg: (f64, f64),
    noise_mm: (f64, f64),
    /// Correlation of errors with those one pose before.
    lag1: f64,
}

const TAKEN: Taken = Taken { n: (120, 600), tilt_deg: (22.0, 45.0), noise_mm: (0.03, 0.25), lag1: 0.0 };

impl Stylus {
    fn new(seed: u64, taken: Taken, moved: impl Fn(f64) -> Vector3<f64>) -> Self {
        let mut draws = Draws::new(seed);
        let tip = draws.direction() * draws.within(70.0, 280.0);
        let mut divot = draws.direction() * draws.within(600.0, 2200.0);
        divot.z = divot.z.abs();
        let n = taken.n.0 + draws.index(taken.n.1 - taken.n.0 + 1);
        let tilt = draws.within(taken.tilt_deg.0, taken.tilt_deg.1).to_radians();
        let noise_mm = draws.within(taken.noise_mm.0, taken.noise_mm.1);
        let noise_deg = noise_mm * draws.within(0.1, 0.4);
        let upright = UnitQuaternion::rotation_between(&-tip, &Vector3::z()).unwrap();
        let (about, in_and_out) = (draws.within(40.0, 90.0), draws.within(25.0, 60.0));
        let (mut error, mut turn, keep) = (draws.normals(1.0), draws.normals(1.0), taken.lag1);
        let poses = (0..n)
            .map(|k| {
                let (angle, step) = (k as f64 / about * std::f64::consts::TAU, k as f64 / n as f64);
                let lean = tilt * (0.4 + 0.6 * (k as f64 / in_and_out).sin().abs());
                let lean = UnitQuaternion::from_scaled_axis(Vector3::new(angle.cos(), angle.sin(), 0.0) * lean);
                let spin = UnitQuaternion::from_scaled_axis(Vector3::z() * (0.6 * (k as f64 / 23.0).sin()));
                let rotation = lean * spin * upright;
                error = error * keep + draws.normals(1.0) * (1.0 - keep * keep).sqrt();
                turn = turn * keep + draws.normals(1.0) * (1.0 - keep * keep).sqrt();
                let at = divot + moved(step);
                let pose = Translation3::from(at - rotation * tip) * rotation;
                pose * Isometry3::new(error * noise_mm, turn * noise_deg.to_radians())
            })
            .collect();
        Self { tip, divot, noise_mm, noise_deg, poses, draws }
    }

    fn sound(seed: u64) -> Self {
        Self::new(seed, TAKEN, |_| Vector3::zeros())
    }

    /// Every so many poses one is turned by a size that is drawn for the log.
    fn flipped(seed: u64, every: usize) -> Self {
        let mut stylus = Self::sound(seed);
        let flip = stylus.draws.turn_deg(8.0, 40.0);
        stylus.poses.iter_mut().step_by(every).for_each(|pose| *pose *= flip);
        stylus
    }

    fn written(mut self, change: impl Fn(&Isometry3<f64>) -> Isometry3<f64>) -> Self {
        self.poses.iter_mut().for_each(|pose| *pose = change(pose));
        self
    }

    fn outcome(&self) -> Outcome {
        let stamps: Vec<i64> = (0..self.poses.len() as i64).map(|k| k * 20_000_000).collect();
        match pivot(&self.poses) {
            Err(refusal) => Outcome { error: None, said: vec![refusal.to_string()] },
            Ok(report) => Outcome {
                error: Some(((Vector3::from(report.tip) - self.tip).norm(), report.error_90_mm)),
                said: report.signs(&stamps).into_iter().map(|(rule, words)| format!("{rule}: {words}")).collect(),
            },
        }
    }
}

/// A drawn size for a log, apart from its other draws.
fn size(seed: u64, from: f64, to: f64) -> f64 {
    Draws::new(seed ^ 0x5eed_0000).within(from, to)
}

fn shift(seed: u64, from: f64, to: f64) -> Vector3<f64> {
    Draws::new(seed ^ 0xd1ff_0000).direction() * size(seed, from, to)
}

#[test]
fn tips_are_right_or_told_or_refused_by_their_cause() {
    let row = |kind, expected, log: &dyn Fn(u64) -> Stylus| Row::of(kind, expected, |seed| log(seed).outcome());
    let taken = |taken: Taken| move |seed| Stylus::new(seed, taken, |_| Vector3::zeros());
    let fault = |change: fn(&Isometry3<f64>) -> Isometry3<f64>| move |seed| Stylus::sound(seed).written(change);
    let rows = [
        row("sound, white noise", Expected::Sound, &Stylus::sound),
        row(
            "sound, correlated noise (0.8 s)",
            Expected::Sound,
            &taken(Taken { lag1: 0.975, n: (300, 900), noise_mm: (0.03, 0.15), ..TAKEN }),
        ),
        row("sound, rounded to 0.1 mm", Expected::Sound, &|seed| {
            Stylus::sound(seed).written(|t| {
                Isometry3::from_parts((t.translation.vector * 10.0).map(|x| x.round() / 10.0).into(), t.rotation)
            })
        }),
        row("sound, 12 to 20 poses, turned far", Expected::Sound, &|seed| {
            let mut stylus = Stylus::new(
                seed,
                Taken { n: (600, 600), tilt_deg: (35.0, 45.0), noise_mm: (0.03, 0.1), ..TAKEN },
                |_| Vector3::zeros(),
            );
            let every = 600 / (12 + stylus.draws.index(9));
            stylus.poses = stylus.poses.into_iter().step_by(every).collect();
            stylus
        }),
        row("noise of 0.5 to 1 mm", Expected::Right, &taken(Taken { noise_mm: (0.5, 1.0), ..TAKEN })),
        row(
            "6 poses of a tenth of a second",
            Expected::Cause(&["leave the tip open", "pivot_open"]),
            &taken(Taken { n: (6, 6), ..TAKEN }),
        ),
        row(
            "tilted by 2 to 5 degrees",
            Expected::Cause(&["leave the tip open", "pivot_open"]),
            &taken(Taken { tilt_deg: (2.0, 5.0), ..TAKEN }),
        ),
        row("turned about one axis", Expected::Cause(&["leave the tip open", "pivot_open"]), &|seed| {
            let mut stylus = Stylus::sound(seed);
            let (tip, divot, axis) = (stylus.tip, stylus.divot, stylus.draws.direction());
            for k in 0..stylus.poses.len() {
                let turn = UnitQuaternion::from_scaled_axis(axis * 0.6 * (k as f64 / 20.0).sin());
                let pose = Translation3::from(divot - turn * tip) * turn;
                stylus.poses[k] = stylus.draws.measured(&pose, stylus.noise_mm, stylus.noise_deg);
            }
            stylus
        }),
        row("poses are inverses", Expected::Cause(&["inverses"]), &fault(Isometry3::inverse)),
        row("quaternion w first", Expected::Cause(&["order w, x, y, z"]), &fault(w_first)),
        row("rotations transposed", Expected::Cause(&["transposed"]), &fault(transposed)),
        row("y of the place mirrored", Expected::Cause(&["mirrored", "transposed"]), &fault(mirrored_place)),
        row("y of place and rotation mirrored", Expected::Unseen, &fault(mirrored)),
        row("metres", Expected::Cause(&["pivot_unit"]), &fault(|t| scaled(t, 0.001))),
        row("centimetres", Expected::Cause(&["pivot_unit"]), &fault(|t| scaled(t, 0.1))),
        row("lengths 1 to 3 % too large", Expected::Unseen, &|seed| {
            let scale = size(seed, 1.01, 1.03);
            Stylus::sound(seed).written(|t| scaled(t, scale))
        }),
        row("tip slips by 2 to 8 mm", Expected::Cause(&["slip"]), &|seed| {
            let by = shift(seed, 2.0, 8.0);
            Stylus::new(seed, TAKEN, |step| by * step)
        }),
        row("tip jumps by 2 to 12 mm after 30 to 70 %", Expected::Cause(&["slip", "agree on a tip"]), &|seed| {
            let (by, after) = (shift(seed, 2.0, 12.0), size(seed + 1, 0.3, 0.7));
            Stylus::new(seed, TAKEN, |step| if step > after { by } else { Vector3::zeros() })
        }),
        row("every 40th pose turned by 8 to 40 degrees", Expected::Cause(&["pivot_outliers"]), &|seed| {
            Stylus::flipped(seed, 40)
        }),
        row("every 10th", Expected::Cause(&["pivot_outliers"]), &|seed| Stylus::flipped(seed, 10)),
        row("every 3rd", Expected::Cause(&["pivot_outliers"]), &|seed| Stylus::flipped(seed, 3)),
    ];
    compare("pivot", &rows);
}
