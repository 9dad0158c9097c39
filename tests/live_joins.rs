//! A realistic tracker and camera: jitter, offset, gaps, lost samples, duplicates, late and out-of-order items. Every pair is
//! compared with a model of ten lines, on any number of workers and in any order of events.

use crate::common::is_slow_run;
use osteoflow_engine::{Outcome, RunOptions, RunReport, run};
use osteoflow_geometry::{
    Pose,
    nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3},
};
use osteoflow_node::{
    Context, Describe, Emit, Inputs, Node, NodeError, Outputs, ParamError, Registry, Source,
    rand::{RngExt, SeedableRng},
    rand_chacha::ChaCha8Rng,
    schemars::JsonSchema,
    serde::Deserialize,
};
use osteoflow_payloads::Text;
use std::collections::BTreeMap;

const MS: i64 = 1_000_000;
/// The maximum delay that the live source guarantees.
const MAX_DELAY_NS: i64 = 15 * MS;
/// Longer gaps are not bridged.
const MAX_GAP_NS: i64 = 20 * MS;

/// A sample of the tracker or a frame of the camera; without a value if the marker was lost or the frame dropped.
#[derive(Clone, Copy)]
struct Sample {
    camera: bool,
    stamp_ns: i64,
    has_value: bool,
}

/// Samples of a tracker at 250 Hz and frames of a camera at 30 Hz, for four seconds.
const TRACKER_NS: i64 = 4 * MS;
const CAMERA_NS: i64 = 33_333_333;
const END_NS: i64 = 4_000 * MS;

/// The marker's true angle about a fixed axis; between two samples it is interpolated linearly.
fn angle_at(stamp_ns: i64) -> f64 {
    1.3 * (stamp_ns as f64 * 1e-9) + 0.4 * (7.0 * stamp_ns as f64 * 1e-9).sin()
}

fn axis() -> Unit<Vector3<f64>> {
    Unit::new_normalize(Vector3::new(0.3, -0.7, 0.5))
}

fn turned(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&axis(), angle)
}

fn pose_at(stamp_ns: i64) -> Pose {
    let t = Isometry3::from_parts(Translation3::new(stamp_ns as f64 * 1e-6, -200.0, 7.0), turned(angle_at(stamp_ns)));
    Pose::new("world", "camera_marker", t).at(stamp_ns)
}

/// The items of both devices, in the order in which they arrive.
fn arrivals(seed: u64) -> Vec<Sample> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut arrived = Vec::new();
    let mut tracker = 0;
    for i in 0..END_NS / TRACKER_NS {
        let stamp_ns = (i * TRACKER_NS + rng.random_range(-MS..MS)).max(tracker);
        tracker = stamp_ns;
        // Two gaps without items, one longer than may be bridged and one shorter.
        if (200..260).contains(&i) || (400..404).contains(&i) {
            continue;
        }
        let sample = Sample { camera: false, stamp_ns, has_value: i % 41 != 0 };
        let mut at_ns = stamp_ns + rng.random_range(0..3 * MS);
        // Out of order, and later than guaranteed.
        at_ns += if i % 23 == 0 { 9 * MS } else { 0 } + if i % 131 == 0 { 60 * MS } else { 0 };
        arrived.push((at_ns, sample));
        if i % 17 == 0 {
            arrived.push((at_ns, sample));
        }
    }
    for i in 0..END_NS / CAMERA_NS {
        // A clock that is 7.3 ms ahead, and a delay for reading out frames.
        let stamp_ns = i * CAMERA_NS + 7_300_000 + rng.random_range(-2 * MS..2 * MS);
        let at_ns = stamp_ns + rng.random_range(0..12 * MS) + if i % 19 == 0 { 40 * MS } else { 0 };
        arrived.push((at_ns, Sample { camera: true, stamp_ns, has_value: i % 13 != 5 }));
    }
    arrived.sort_by_key(|(at_ns, _)| *at_ns);
    arrived.into_iter().map(|(_, sample)| sample).collect()
}

/// The items on the two wires: a late item is an empty at the stamp up to which its wire was guaranteed to be complete.
fn wires(arrived: &[Sample]) -> Vec<Sample> {
    let (mut newest, mut floors) = (i64::MIN, BTreeMap::from([(false, i64::MIN), (true, i64::MIN)]));
    let mut out = Vec::new();
    for sample in arrived {
        newest = newest.max(sample.stamp_ns);
        let floor = floors.get_mut(&sample.camera).unwrap();
        let late = sample.stamp_ns < *floor;
        let stamp_ns = sample.stamp_ns.max(*floor);
        *floor = stamp_ns;
        out.push(Sample { stamp_ns, has_value: sample.has_value && !late, ..*sample });
        let promised = newest - MAX_DELAY_NS;
        floors.values_mut().for_each(|floor| *floor = promised.max(*floor));
    }
    out
}

/// The expected angle for each frame, in order of stamps; `None` if there is none.
fn expected(wires: &[Sample]) -> Vec<(i64, Option<f64>)> {
    let tracker: Vec<_> = wires.iter().filter(|sample| !sample.camera).collect();
    let at = |frame: &Sample| {
        let after = tracker.partition_point(|sample| sample.stamp_ns <= frame.stamp_ns);
        let a = tracker.get(after.checked_sub(1)?).filter(|a| a.has_value)?;
        if a.stamp_ns == frame.stamp_ns {
            return Some(angle_at(a.stamp_ns));
        }
        let b = tracker.get(after).filter(|b| b.has_value && b.stamp_ns - a.stamp_ns <= MAX_GAP_NS)?;
        let share = (frame.stamp_ns - a.stamp_ns) as f64 / (b.stamp_ns - a.stamp_ns) as f64;
        Some(angle_at(a.stamp_ns) * (1.0 - share) + angle_at(b.stamp_ns) * share)
    };
    let frames = wires.iter().filter(|sample| sample.camera && sample.has_value);
    frames.map(|frame| (frame.stamp_ns, at(frame))).collect()
}

/// Both devices; live or not, as the graph names it.
#[derive(Describe)]
struct Devices<const LIVE: bool>(std::vec::IntoIter<Sample>);

#[derive(Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
struct Seed {
    /// Seed of the jitter.
    seed: u64,
}

#[derive(Outputs)]
struct DevicesOut {
    /// The marker.
    #[port(to = "world", from = "camera_marker")]
    marker: Emit<Pose>,
    /// The frames.
    frame: Emit<Text>,
}

impl<const LIVE: bool> Source for Devices<LIVE> {
    const KIND: &'static str = if LIVE { "test.devices_live" } else { "test.devices" };
    const LIVE: bool = LIVE;
    type Params = Seed;
    type Outputs = DevicesOut;

    fn new(params: Seed) -> Result<Self, ParamError> {
        let arrived = arrivals(params.seed);
        if LIVE {
            return Ok(Self(arrived.into_iter()));
        }
        // A source that is not live gives its streams in the order of their stamps.
        let mut sorted = wires(&arrived);
        sorted.sort_by_key(|sample| sample.stamp_ns);
        Ok(Self(sorted.into_iter()))
    }

    fn max_delay_ns(&self) -> i64 {
        MAX_DELAY_NS
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<DevicesOut>, NodeError> {
        let Some(sample) = self.0.next() else { return Ok(None) };
        ctx.set_stamp_ns(sample.stamp_ns);
        let lost = "nothing was seen".to_owned();
        Ok(Some(match (sample.camera, sample.has_value) {
            (false, true) => DevicesOut { marker: pose_at(sample.stamp_ns).into(), frame: Emit::Silent },
            (false, false) => DevicesOut { marker: Emit::Empty(lost), frame: Emit::Silent },
            (true, true) => DevicesOut { marker: Emit::Silent, frame: Text(sample.stamp_ns.to_string().into()).into() },
            (true, false) => DevicesOut { marker: Emit::Silent, frame: Emit::Empty(lost) },
        }))
    }
}

/// Outputs the pose that each frame was joined with.
#[derive(Describe)]
struct Pair;

#[derive(Inputs)]
struct PairIn {
    /// The frame.
    frame: Text,
    /// The marker at its time.
    #[port(join = "interpolate", max_gap_ms = 20.0)]
    marker: Option<Pose>,
}

#[derive(Outputs)]
struct PairOut {
    /// Stamp and quaternion.
    sample: Text,
}

impl Node for Pair {
    const KIND: &'static str = "test.pair";
    type Params = osteoflow_standard::NoParams;
    type Inputs = PairIn;
    type Outputs = PairOut;

    fn new(_: Self::Params) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: PairIn, ctx: &mut Context) -> Result<PairOut, NodeError> {
        let frame = i.frame.0;
        if *frame != *ctx.stamp_ns().to_string() {
            return Err(NodeError::new(format!("the frame of {frame} ns was fired at {} ns", ctx.stamp_ns())));
        }
        let sample = match i.marker.map(|pose| pose.isometry.rotation.coords) {
            Some(q) => format!("{frame} {:?} {:?} {:?} {:?}", q.x, q.y, q.z, q.w),
            None => format!("{frame} none"),
        };
        Ok(PairOut { sample: Text(sample.into()) })
    }
}

fn registry() -> Registry {
    let mut registry = osteoflow_standard::registry();
    registry.source::<Devices<true>>().source::<Devices<false>>().node::<Pair>();
    registry
}

/// The stamp of a frame and the rotation that it was joined with.
type Met = (i64, Option<UnitQuaternion<f64>>);

fn pairs(kind: &str, seed: u64, workers: usize, shuffle: Option<u64>) -> (Vec<Met>, RunReport) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("joins.toml");
    let graph = format!(
        "[graph]\nformat = 1\nname = \"joins\"\n[node.devices]\nkind = \"{kind}\"\nseed = {seed}\n[node.pair]\n\
         kind = \"test.pair\"\nin = {{ frame = \"devices.frame\", marker = \"devices.marker\" }}\n[results]\n\
         pairs = {{ from = \"pair.sample\", all = true, optional = true }}\n"
    );
    std::fs::write(&path, graph).unwrap();
    let registry = registry();
    let plan = osteoflow_engine::check(&path, &[], &registry).unwrap().plan;
    let options = RunOptions { workers, shuffle, ..RunOptions::default() };
    let report = run(&plan, &registry, &options, &()).unwrap();
    assert_eq!(report.outcome, Outcome::Complete);
    let sample = report.results["pairs"].as_array().unwrap().iter().filter_map(|sample| sample.as_str());
    let parsed = sample.map(|sample| {
        let mut words = sample.split(' ');
        let stamp_ns: i64 = words.next().unwrap().parse().unwrap();
        let numbers: Vec<f64> = words.filter_map(|word| word.parse().ok()).collect();
        let q = <[f64; 4]>::try_from(numbers).ok();
        (stamp_ns, q.map(|q| UnitQuaternion::new_unchecked(Quaternion::new(q[3], q[0], q[1], q[2]))))
    });
    (parsed.collect(), report)
}

#[test]
fn no_frame_meets_a_wrong_pose_and_none_is_lost_under_any_schedule() {
    for seed in 0..if is_slow_run() { 4 } else { 1 } {
        let arrived = arrivals(seed);
        let wires = wires(&arrived);
        let n_late = |camera| {
            let both = arrived.iter().zip(&wires).filter(|(sample, _)| sample.camera == camera);
            both.filter(|(sample, wire)| sample.stamp_ns < wire.stamp_ns).count() as u64
        };
        assert!(n_late(true) > 3 && n_late(false) > 30, "late: {} frames, {} samples", n_late(true), n_late(false));
        let expected = expected(&wires);
        let n_met = expected.iter().filter(|(_, angle)| angle.is_some()).count();
        assert!(n_met > 40 && n_met + 5 < expected.len(), "{n_met} of {} frames meet a pose", expected.len());
        let schedules = [(8, None), (2, Some(2)), (1, None), (2, None), (1, Some(1)), (2, Some(3)), (8, Some(4))];
        let schedules = if is_slow_run() { &schedules[..] } else { &schedules[..2] };
        for (kind, live) in [("test.devices_live", true), ("test.devices", false)] {
            for &(workers, shuffle) in schedules {
                let case = format!("{kind}, seed {seed}, {workers} workers, shuffle {shuffle:?}");
                let (found, report) = pairs(kind, seed, workers, shuffle);
                assert_eq!(found.len(), expected.len(), "{case}");
                for ((found_ns, found), (stamp_ns, angle)) in found.iter().zip(&expected) {
                    assert_eq!((found_ns, found.is_some()), (stamp_ns, angle.is_some()), "{case}, at {stamp_ns} ns");
                    let (Some(found), Some(angle)) = (found, angle) else { continue };
                    let between = turned(*angle).inverse() * found;
                    let off_rad = 2.0 * between.imag().norm().asin();
                    assert!(off_rad < 1e-12, "{case}: {off_rad:e} rad off at {stamp_ns} ns");
                }
                for link in &report.links {
                    assert_eq!(link.sent, link.received + link.dropped, "{case}");
                    let late = if live { n_late(link.from == "devices.frame") } else { 0 };
                    assert_eq!(link.late, late, "{case}: {}", link.from);
                }
            }
        }
    }
}
