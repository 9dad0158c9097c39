//! Whether the stamps of a log are in the unit in which they are read.

use nalgebra::Vector3;
use osteoflow_geometry::StampNs;

/// No tracker is faster: the fastest for motion capture give 2000 poses a second.
const FASTEST_S: f64 = 5e-4;
/// The interval from which on a thousandth of it is a tracker's (1 s), less what clocks and jitter take from it.
const SLOW_S: f64 = 0.95;
/// The interval of the fastest trackers for surgery (400 Hz), read in the next larger unit. Below it a tool at rest that is logged once a
/// second or two is likelier than a faster tracker, which at rest looks the same.
const SLOW_AT_REST_S: f64 = 2.5;
/// A tool at rest stays within this, mm: noise and what a fixed marker yields.
const REST_MM: f64 = 5.0;
/// Faster than a hand moves a tool, mm/s, and the noise of a position, mm, that comes to it.
const HAND_MM_S: f64 = 2000.0;
const NOISE_MM: f64 = 1.0;
/// Positions of a motion that is sampled densely are apart by less than this part of its extent; those of stations are not.
const DENSE: f64 = 0.2;
/// Number of steps faster than a hand up to which they may be outliers: one makes two.
const N_OUTLIERS: usize = 2;
/// Number of poses on each side of a change of the unit.
const N_BESIDE: usize = 5;

/// The stamps of one tool, and where it was seen when, mm, in the order of the file.
#[derive(Default)]
pub(super) struct Track {
    pub(super) stamps: Vec<StampNs>,
    pub(super) seen: Vec<(StampNs, Vector3<f64>)>,
}

impl Track {
    /// A sign that the stamps are in another unit, or have too few digits.
    pub(super) fn sign(&self) -> Option<String> {
        let steps: Vec<f64> = self.stamps.windows(2).map(|pair| pair[0].abs_diff(pair[1]) as f64 * 1e-9).collect();
        if steps.len() < 2 {
            return None;
        }
        self.change(&steps).or_else(|| {
            let step_s = median(&steps);
            if step_s > 0.0 && step_s < FASTEST_S {
                return Some(format!("its poses are {step_s:.1e} s apart, as of no tracker; is the unit of the stamps right?"));
            }
            let unit = [1e3, 1e6, 1e9].into_iter().find(|unit| step_s / unit < SLOW_S).unwrap_or(1e9);
            (step_s >= SLOW_S && !self.is_sparse(step_s, unit)).then(|| {
                format!(
                    "its poses are {step_s:.1} s apart, and {:.1} ms, as of a tracker, if the stamps are in a unit {unit} times smaller than \
                     the one they are read in; give their unit, or leave it so if they were taken that slowly",
                    step_s / unit * 1e3
                )
            })
        })
    }

    /// Whether the tool moved as if its poses were indeed so far apart: between stations, or logged now and then.
    fn is_sparse(&self, step_s: f64, unit: f64) -> bool {
        let moves = || self.seen.windows(2).map(|pair| (pair[0].0.abs_diff(pair[1].0), (pair[1].1 - pair[0].1).norm()));
        let n_fast = moves().filter(|(ns, mm)| *mm > HAND_MM_S * *ns as f64 * 1e-9 / unit + NOISE_MM).count();
        let ends = self.seen.iter().map(|(_, at)| (*at, *at)).reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1)));
        let extent_mm = ends.map_or(0.0, |(low, high)| (high - low).norm());
        let is_dense =
            median(&moves().map(|(_, mm)| mm).filter(|mm| *mm > 0.0).collect::<Vec<_>>()) < DENSE * extent_mm;
        n_fast > N_OUTLIERS || if extent_mm < REST_MM { step_s < SLOW_AT_REST_S } else { !is_dense }
    }

    /// A change of the unit within the file, at the largest step.
    fn change(&self, steps: &[f64]) -> Option<String> {
        let at = (0..steps.len()).max_by(|a, b| steps[*a].total_cmp(&steps[*b]))?;
        let (before, after) = (&steps[..at], &steps[at + 1..]);
        if before.len().min(after.len()) < N_BESIDE {
            return None;
        }
        let (before_s, after_s) = (median(before), median(after));
        let ratio = (after_s / before_s).log10().abs() / 3.0;
        // Within a quarter.
        let is_unit = ratio.is_finite() && ratio > 0.9 && (ratio - ratio.round()).abs() < 0.03;
        is_unit.then(|| {
            format!("its poses are {before_s:.3e} s apart up to {} ns and {after_s:.3e} s from then on; does the unit of the stamps change there?", self.stamps[at])
        })
    }
}

/// The upper median; 0 of nothing.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    /// Number of simulated streams of each kind.
    const N: u64 = 200;

    /// A hand's motion: three sines along each axis, up to 0.7 Hz, and the noise of a position.
    struct Hand {
        sines: Vec<[f64; 3]>,
        noise_mm: f64,
    }

    impl Hand {
        fn new(rng: &mut ChaCha8Rng) -> Self {
            let mut sine = || [rng.random_range(10.0..60.0), rng.random_range(0.15..0.7), rng.random_range(0.0..6.3)];
            Self { sines: (0..9).map(|_| sine()).collect(), noise_mm: 0.1 }
        }

        fn at(&self, t_s: f64, rng: &mut ChaCha8Rng) -> Vector3<f64> {
            Vector3::from_fn(|axis, _| {
                let of_axis = self.sines[3 * axis..3 * axis + 3].iter();
                let place: f64 =
                    of_axis.map(|[mm, hz, phase]| mm * (std::f64::consts::TAU * hz * t_s + phase).sin()).sum();
                place + rng.random_range(-1.7..1.7) * self.noise_mm
            })
        }
    }

    /// A stream of true times and places whose stamps are read `factor` times too large.
    fn track(samples: impl IntoIterator<Item = (f64, Vector3<f64>)>, factor: f64) -> Track {
        let mut track = Track::default();
        for (t_s, at) in samples {
            let stamp_ns = ((t_s + 12.5) * factor * 1e9).round() as StampNs;
            track.stamps.push(stamp_ns);
            track.seen.push((stamp_ns, at));
        }
        track
    }

    fn in_hand(rng: &mut ChaCha8Rng, rate_hz: f64, n: usize) -> Vec<(f64, Vector3<f64>)> {
        let hand = Hand::new(rng);
        let mut jitter = ChaCha8Rng::seed_from_u64(rng.random());
        (0..n)
            .map(|k| {
                let t_s = (k as f64 + jitter.random_range(-0.2..0.2)) / rate_hz;
                (t_s, hand.at(t_s, &mut jitter))
            })
            .collect()
    }

    fn at_rest(rng: &mut ChaCha8Rng, rate_hz: f64, n: usize) -> Vec<(f64, Vector3<f64>)> {
        let noise = |rng: &mut ChaCha8Rng| Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2));
        (0..n).map(|k| (k as f64 / rate_hz, Vector3::new(100.0, 50.0, -900.0) + noise(rng))).collect()
    }

    /// Stations at random in a room of 300 mm.
    fn stations(rng: &mut ChaCha8Rng, interval_s: std::ops::Range<f64>) -> Vec<(f64, Vector3<f64>)> {
        let (mut t_s, n) = (0.0, rng.random_range(10..40));
        let station = |_| {
            t_s += rng.random_range(interval_s.clone());
            (t_s, Vector3::from_fn(|_, _| rng.random_range(-150.0..150.0)))
        };
        (0..n).map(station).collect()
    }

    /// At rest, carried for 6 s by 200 mm, and at rest.
    fn carried(rng: &mut ChaCha8Rng, rate_hz: f64, n: usize) -> Vec<(f64, Vector3<f64>)> {
        let middle_s = n as f64 / rate_hz / 2.0;
        let way = |t_s: f64| Vector3::x() * 200.0 * ((t_s - middle_s) / 6.0 + 0.5).clamp(0.0, 1.0);
        at_rest(rng, rate_hz, n).into_iter().map(|(t_s, at)| (t_s, at + way(t_s))).collect()
    }

    /// Number of `N` simulated streams of a kind that are told.
    fn n_told(kind: impl Fn(&mut ChaCha8Rng) -> Track) -> u64 {
        // Seeds that played no part in choosing a limit.
        let told = (0..N).filter(|k| kind(&mut ChaCha8Rng::seed_from_u64(0x5ec1_0000 + k)).sign().is_some());
        told.count() as u64
    }

    #[test]
    fn streams_in_another_unit_are_told_and_sound_ones_are_not_stations_and_slow_logs_among_them() {
        let rate = |rng: &mut ChaCha8Rng| rng.random_range(10.0..400.0);
        let (ms, us) = (1e3, 1e6);
        let faulty: [(&str, u64); 9] = [
            (
                "in the hand, ms read as s",
                n_told(|rng| {
                    let hz = rate(rng);
                    track(in_hand(rng, hz, 300), ms)
                }),
            ),
            (
                "in the hand, us read as s",
                n_told(|rng| {
                    let hz = rate(rng);
                    track(in_hand(rng, hz, 300), us)
                }),
            ),
            (
                "in the hand, us read as ns",
                n_told(|rng| {
                    let hz = rate(rng);
                    track(in_hand(rng, hz, 300), 1e-3)
                }),
            ),
            ("in the hand, 12 poses at 60 Hz, ms read as s", n_told(|rng| track(in_hand(rng, 60.0, 12), ms))),
            ("1000 Hz in the hand, ms read as s", n_told(|rng| track(in_hand(rng, 1000.0, 3000), ms))),
            (
                "at rest, ms read as s",
                n_told(|rng| {
                    let hz = rate(rng);
                    track(at_rest(rng, hz, 300), ms)
                }),
            ),
            (
                "carried, ms read as s",
                n_told(|rng| {
                    let hz = rng.random_range(20.0..60.0);
                    track(carried(rng, hz, 900), ms)
                }),
            ),
            (
                "one spike in the hand, ms read as s",
                n_told(|rng| {
                    let mut samples = in_hand(rng, 30.0, 300);
                    samples[150].1.x += 5000.0;
                    track(samples, ms)
                }),
            ),
            (
                "ms from the middle on",
                n_told(|rng| {
                    let (hz, k) = (rate(rng), rng.random_range(10..290));
                    let samples = in_hand(rng, hz, 300);
                    let (mut track, more) = (track(samples[..k].to_vec(), 1.0), track(samples[k..].to_vec(), ms));
                    track.stamps.extend(more.stamps);
                    track.seen.extend(more.seen);
                    track
                }),
            ),
        ];
        let sound: [(&str, u64); 8] = [
            (
                "in the hand",
                n_told(|rng| {
                    let hz = rate(rng);
                    track(in_hand(rng, hz, 300), 1.0)
                }),
            ),
            (
                "at rest",
                n_told(|rng| {
                    let hz = rate(rng);
                    track(at_rest(rng, hz, 300), 1.0)
                }),
            ),
            (
                "in the hand with pauses",
                n_told(|rng| {
                    let mut samples = in_hand(rng, 50.0, 300);
                    for start in [60, 150, 220] {
                        let pause_s = rng.random_range(2.0..90.0);
                        samples[start..].iter_mut().for_each(|(t_s, _)| *t_s += pause_s);
                    }
                    track(samples, 1.0)
                }),
            ),
            ("stations by hand, 2 to 60 s", n_told(|rng| track(stations(rng, 2.0..60.0), 1.0))),
            ("stations by a timer, 1 s", n_told(|rng| track(stations(rng, 1.0..1.001), 1.0))),
            ("in the hand, logged once a second", n_told(|rng| track(in_hand(rng, 1.0, 120), 1.0))),
            ("at rest, logged once a second", n_told(|rng| track(at_rest(rng, 1.0, 600), 1.0))),
            ("carried, logged once a second", n_told(|rng| track(carried(rng, 1.0, 600), 1.0))),
        ];
        println!("told of {N} simulated streams each: {faulty:?}, sound {sound:?}");
        for (kind, n) in faulty {
            assert!(n * 100 >= N * 98, "{kind}: {n} of {N} are told");
        }
        for (kind, n) in sound {
            assert!(n * 100 <= N * 2, "{kind}: {n} of {N} are told");
        }
    }

    #[test]
    fn the_sentence_has_the_interval_and_what_it_would_be() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let sign = track(at_rest(&mut rng, 20.0, 40), 1e3).sign().unwrap();
        assert!(
            sign.starts_with(
                "its poses are 50.0 s apart, and 50.0 ms, as of a tracker, if the stamps are in a unit 1000 times"
            ),
            "{sign}"
        );
        assert_eq!(track(at_rest(&mut rng, 20.0, 2), 1e3).sign(), None, "two poses have one interval");
        // Whole seconds of 20 poses each are no milliseconds; what contradicts itself at one stamp is told by its reader.
        let whole = at_rest(&mut rng, 20.0, 400).into_iter().map(|(t_s, at)| (t_s.floor(), at));
        assert_eq!(track(whole, 1.0).sign(), None);
    }
}
