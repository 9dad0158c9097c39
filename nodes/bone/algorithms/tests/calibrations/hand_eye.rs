//! The camera in its marker.

use super::{Draws, Expected, Outcome, Row, compare, mirrored, scaled, transposed, w_first};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::calibrate::{HandEyeMethod, hand_eye, hand_eye_late, hand_eye_pairs};

/// Poses of a station, 20 ms apart; stations are 2 s apart.
const N_EACH: usize = 3;

/// How a log is taken.
#[derive(Clone, Copy)]
struct Taken {
    n_stations: (usize, usize),
    tilt_deg: (f64, f64),
    /// Standard deviation of the errors that are the same at all poses of a station, in those of single poses.
    common: f64,
    is_one_axis: bool,
}

const TAKEN: Taken = Taken { n_stations: (12, 20), tilt_deg: (25.0, 40.0), common: 0.0, is_one_axis: false };

/// A camera in the hand before a board: `t_world_camera` of each station, and what both devices measured.
struct Camera {
    /// `t_camera_camera_marker`.
    truth: Isometry3<f64>,
    marker: Vec<Isometry3<f64>>,
    target: Vec<Isometry3<f64>>,
    draws: Draws,
}

impl Camera {
    fn new(seed: u64, taken: Taken) -> Self {
        let mut draws = Draws::new(seed);
        let truth = Translation3::from(draws.direction() * draws.within(50.0, 180.0)) * draws.turn_deg(20.0, 150.0);
        let place = draws.direction() * draws.within(700.0, 2000.0);
        let board = Translation3::from(place) * draws.turn_deg(0.0, 170.0);
        // The camera looks at the board's front or back, whichever way its axes were chosen.
        let facing = draws.turn_deg(0.0, 180.0);
        let (far, tilt) = (draws.within(220.0, 500.0), draws.within(taken.tilt_deg.0, taken.tilt_deg.1));
        let n = taken.n_stations.0 + draws.index(taken.n_stations.1 - taken.n_stations.0 + 1);
        let axis = draws.direction();
        let cameras: Vec<Isometry3<f64>> = (0..n)
            .map(|_| {
                let axis = if taken.is_one_axis { axis } else { draws.direction() };
                let turn = UnitQuaternion::from_scaled_axis(axis * draws.within(-tilt, tilt).to_radians());
                // The board in the camera's frame: in view.
                let seen =
                    Vector3::new(draws.within(-30.0, 30.0), draws.within(-30.0, 30.0), far + draws.within(-40.0, 40.0));
                board * (Translation3::from(seen) * (turn * facing)).inverse()
            })
            .collect();
        let (marker, target) =
            (cameras.iter().map(|c| c * truth).collect(), cameras.iter().map(|c| c.inverse() * board).collect());
        Self { truth, marker, target, draws }.measured(taken.common)
    }

    fn sound(seed: u64) -> Self {
        Self::new(seed, TAKEN)
    }

    /// A camera on a stand, and a board on the tracked hand.
    fn on_stand(seed: u64) -> Self {
        let mut draws = Draws::new(seed);
        let board = Translation3::from(draws.direction() * draws.within(30.0, 150.0)) * draws.turn_deg(20.0, 150.0);
        let camera = Translation3::from(draws.direction() * draws.within(600.0, 1800.0)) * draws.turn_deg(0.0, 180.0);
        let facing = draws.turn_deg(0.0, 180.0);
        let far = draws.within(300.0, 600.0);
        let targets: Vec<Isometry3<f64>> = (0..15)
            .map(|_| {
                let seen =
                    Vector3::new(draws.within(-40.0, 40.0), draws.within(-40.0, 40.0), far + draws.within(-60.0, 60.0));
                Translation3::from(seen) * (draws.turn_deg(10.0, 40.0) * facing)
            })
            .collect();
        let marker = targets.iter().map(|t| camera * t * board.inverse()).collect();
        Self { truth: Isometry3::identity(), marker, target: targets, draws }.measured(0.0)
    }

    /// Each station several times, with errors of both devices.
    fn measured(mut self, common: f64) -> Self {
        let noise = self.draws.within(0.5, 1.5);
        let mut times = |poses: &[Isometry3<f64>], mm: f64, deg: f64| -> Vec<Isometry3<f64>> {
            let mut all = Vec::new();
            for pose in poses {
                let of_station = self.draws.measured(pose, common * noise * mm, common * noise * deg);
                all.extend((0..N_EACH).map(|_| self.draws.measured(&of_station, noise * mm, noise * deg)));
            }
            all
        };
        (self.marker, self.target) = (times(&self.marker, 0.05, 0.02), times(&self.target, 0.1, 0.03));
        self
    }

    fn n_stations(&self) -> usize {
        self.marker.len() / N_EACH
    }

    /// So many stations see a board that is turned, as the two attitudes of a flat one.
    fn flipped(seed: u64, n: usize) -> Self {
        let mut camera = Self::new(seed, Taken { n_stations: (15, 15), ..TAKEN });
        let flip = camera.draws.turn_deg(10.0, 40.0);
        let mut stations: Vec<usize> = (0..camera.n_stations()).collect();
        for _ in 0..n {
            let station = stations.swap_remove(camera.draws.index(stations.len()));
            camera.target[station * N_EACH..][..N_EACH].iter_mut().for_each(|t| *t *= flip);
        }
        camera
    }

    /// Poses from a station on, between 30 and 70 %, are changed.
    fn changed_after(seed: u64, target: bool) -> Self {
        let mut camera = Self::sound(seed);
        let by = Translation3::from(camera.draws.direction() * camera.draws.within(3.0, 20.0))
            * camera.draws.turn_deg(1.0, 5.0);
        let from = (camera.n_stations() as f64 * camera.draws.within(0.3, 0.7)).round() as usize * N_EACH;
        if target {
            let home = camera.marker[0] * camera.truth.inverse() * camera.target[0];
            let by = home * by * home.inverse();
            for k in from..camera.marker.len() {
                let t_world_camera = camera.marker[k] * camera.truth.inverse();
                camera.target[k] = t_world_camera.inverse() * by * t_world_camera * camera.target[k];
            }
        } else {
            camera.marker[from..].iter_mut().for_each(|m| *m *= by);
        }
        camera
    }

    fn written(
        mut self,
        marker: impl Fn(&Isometry3<f64>) -> Isometry3<f64>,
        target: impl Fn(&Isometry3<f64>) -> Isometry3<f64>,
    ) -> Self {
        self.marker.iter_mut().for_each(|t| *t = marker(t));
        self.target.iter_mut().for_each(|t| *t = target(t));
        self
    }

    fn outcome(&self) -> Outcome {
        let stamps: Vec<i64> = (0..self.marker.len() as i64).map(|k| k * 20_000_000).collect();
        match hand_eye(&self.marker, &self.target, HandEyeMethod::default()) {
            Err(refusal) => Outcome { error: None, said: vec![refusal.to_string()] },
            Ok(fit) => {
                let off = fit.t_marker_camera.inverse().translation.vector - self.truth.translation.vector;
                let said = fit.report.signs(&stamps).into_iter().map(|(rule, words)| format!("{rule}: {words}"));
                Outcome { error: Some((off.norm(), fit.report.error_90_mm)), said: said.collect() }
            }
        }
    }
}

#[test]
fn cameras_are_right_or_told_or_refused_by_their_cause() {
    let same = |t: &Isometry3<f64>| *t;
    let inverse = |t: &Isometry3<f64>| t.inverse();
    let row = |kind, expected, log: &dyn Fn(u64) -> Camera| Row::of(kind, expected, |seed| log(seed).outcome());
    let taken = |taken: Taken| move |seed| Camera::new(seed, taken);
    let size = |seed: u64, sizes: &[f64]| sizes[Draws::new(seed ^ 0x5eed_0000).index(sizes.len())];
    let open: &[&str] = &["hand_eye_open", "about one axis alone", "no axis that can be told"];
    let rows = [
        row("sound", Expected::Sound, &Camera::sound),
        row("errors common to a station, as large again", Expected::Right, &taken(Taken { common: 1.0, ..TAKEN })),
        row("5 to 7 stations", Expected::Right, &taken(Taken { n_stations: (5, 7), tilt_deg: (35.0, 45.0), ..TAKEN })),
        row("3 stations", Expected::Cause(open), &taken(Taken { n_stations: (3, 3), ..TAKEN })),
        row("turned by 1 to 6 degrees", Expected::Cause(open), &taken(Taken { tilt_deg: (1.0, 6.0), ..TAKEN })),
        row("turned about one axis", Expected::Cause(open), &taken(Taken { is_one_axis: true, ..TAKEN })),
        row("board 1 to 10 % too large or small", Expected::Cause(&["size of the board"]), &|seed| {
            let scale = size(seed, &[0.9, 0.95, 0.97, 0.99, 1.01, 1.03, 1.05, 1.1]);
            Camera::sound(seed).written(same, |t| scaled(t, scale))
        }),
        row("target in metres or centimetres", Expected::Cause(&["in mm"]), &|seed| {
            let scale = size(seed, &[0.001, 0.1]);
            Camera::sound(seed).written(same, |t| scaled(t, scale))
        }),
        row("marker in metres", Expected::Cause(&["in mm"]), &|seed| {
            Camera::sound(seed).written(|t| scaled(t, 0.001), same)
        }),
        row("both 1 to 3 % too large", Expected::Unseen, &|seed| {
            let scale = size(seed, &[1.01, 1.02, 1.03]);
            Camera::sound(seed).written(|t| scaled(t, scale), |t| scaled(t, scale))
        }),
        row("marker's poses are inverses", Expected::Cause(&["poses of the marker are inverses"]), &|seed| {
            Camera::sound(seed).written(inverse, same)
        }),
        row("target's poses are inverses", Expected::Cause(&["poses of the target are inverses"]), &|seed| {
            Camera::sound(seed).written(same, inverse)
        }),
        row(
            "both are inverses",
            Expected::Cause(&["poses of the marker are inverses, and the poses of the target are inverses"]),
            &|seed| Camera::sound(seed).written(inverse, inverse),
        ),
        row("camera on a stand", Expected::Cause(&["camera is on a stand"]), &Camera::on_stand),
        row("camera on a stand, marker's inverses", Expected::Cause(&["camera is on a stand"]), &|seed| {
            Camera::on_stand(seed).written(inverse, same)
        }),
        row("camera on a stand, target's inverses", Expected::Cause(&["camera is on a stand"]), &|seed| {
            Camera::on_stand(seed).written(same, inverse)
        }),
        row("camera on a stand, both inverses", Expected::Cause(&["camera is on a stand"]), &|seed| {
            Camera::on_stand(seed).written(inverse, inverse)
        }),
        row("marker's quaternion w first", Expected::Cause(&["order w, x, y, z"]), &|seed| {
            Camera::sound(seed).written(w_first, same)
        }),
        row("target's quaternion w first", Expected::Cause(&["order w, x, y, z"]), &|seed| {
            Camera::sound(seed).written(same, w_first)
        }),
        row("both w first", Expected::Cause(&["order w, x, y, z"]), &|seed| {
            Camera::sound(seed).written(w_first, w_first)
        }),
        row("marker's rotations transposed", Expected::Cause(&["transposed"]), &|seed| {
            Camera::sound(seed).written(transposed, same)
        }),
        row("marker mirrored", Expected::Cause(&["mirrored"]), &|seed| Camera::sound(seed).written(mirrored, same)),
        row("target mirrored", Expected::Cause(&["mirrored"]), &|seed| Camera::sound(seed).written(same, mirrored)),
        row("paired with the station before", Expected::Cause(&["different times"]), &|seed| {
            let mut camera = Camera::sound(seed);
            camera.marker.rotate_left(N_EACH);
            camera
        }),
        row("target moved by 3 to 20 mm and 1 to 5 degrees", Expected::Cause(&["moved"]), &|seed| {
            Camera::changed_after(seed, true)
        }),
        row("marker knocked by as much", Expected::Cause(&["moved"]), &|seed| Camera::changed_after(seed, false)),
        row("1 of 15 stations flipped by 10 to 40 degrees", Expected::Cause(&["flipped"]), &|seed| {
            Camera::flipped(seed, 1)
        }),
        row("4 of 15", Expected::Cause(&["flipped"]), &|seed| Camera::flipped(seed, 4)),
        row("1 of 15, and a board 5 % too large", Expected::Cause(&["flipped"]), &|seed| {
            Camera::flipped(seed, 1).written(same, |t| scaled(t, 1.05))
        }),
        row("every 3rd pose turned", Expected::Cause(&["flipped"]), &|seed| {
            let mut camera = Camera::sound(seed);
            let flip = camera.draws.turn_deg(10.0, 40.0);
            camera.target.iter_mut().step_by(3).for_each(|t| *t *= flip);
            camera
        }),
    ];
    compare("hand-eye", &rows);
}

#[test]
fn a_log_of_another_clock_is_paired_by_the_difference_that_explains_it() {
    for seed in 0..6 {
        let camera = Camera::sound(seed);
        let stamp = |k: usize| (k / N_EACH) as i64 * 2_000_000_000 + (k % N_EACH) as i64 * 20_000_000;
        for late_s in [-3.0, -0.2, 0.1, 2.0, 4.0] {
            let late_ns = (late_s * 1e9) as i64;
            let marker: Vec<_> = camera.marker.iter().enumerate().map(|(k, t)| (stamp(k), *t)).collect();
            let target: Vec<_> =
                camera.target.iter().enumerate().map(|(k, t)| (stamp(k) + late_ns + 4_000_000, *t)).collect();
            let found_ns = hand_eye_late(&marker, &target, 25e6).unwrap();
            // A station is held for 40 ms, and poses within 25 ms are paired.
            assert!((found_ns - late_ns).abs() < 70_000_000, "seed {seed}, {late_s} s: {found_ns} ns");
            assert_eq!(hand_eye_pairs(&marker, &target, late_ns, 25e6).len(), marker.len());
            let right: Vec<_> = target.iter().map(|(ns, t)| (ns - late_ns, *t)).collect();
            assert_eq!(hand_eye_late(&marker, &right, 25e6), None, "clocks that are alike");
        }
    }
}
