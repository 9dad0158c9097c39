//! A camera ten times as fast as its consumer: with every policy the accounting balances, memory stays constant, and the run
//! ends. Two minutes each with `SLOW_TESTS`, or as many as `OVERLOAD_MINUTES` says; a second otherwise.

use osteoflow_engine::{Event, Observer, Outcome, RunOptions, RunReport, run};
use osteoflow_geometry::{Cloud, nalgebra::Point3};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Registry, Source, schemars::JsonSchema,
    serde::Deserialize,
};
use osteoflow_payloads::Flag;
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

/// A cloud of 24 kB.
const N_POINTS: usize = 1_000;
/// Ratio of the rates of the camera and its sink.
const OVERLOAD: u32 = 10;

/// Emits a cloud at each tick of the clock, whether or not anyone can take it.
#[derive(Describe)]
struct Camera {
    params: CameraParams,
    began: Option<Instant>,
    n_given: u32,
}

#[derive(Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
struct CameraParams {
    /// Number of clouds.
    n: u32,
    /// The time between two.
    period_us: u32,
}

#[derive(Outputs)]
struct CameraOut {
    /// The clouds.
    cloud: Cloud,
}

impl Source for Camera {
    const KIND: &'static str = "test.camera";
    const LIVE: bool = true;
    type Params = CameraParams;
    type Outputs = CameraOut;

    fn new(params: CameraParams) -> Result<Self, ParamError> {
        Ok(Self { params, began: None, n_given: 0 })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<CameraOut>, NodeError> {
        let began = *self.began.get_or_insert_with(Instant::now);
        let due = Duration::from_micros(self.params.period_us.into()) * self.n_given;
        if self.n_given == self.params.n || !ctx.wait_until(began + due) {
            return Ok(None);
        }
        self.n_given += 1;
        ctx.set_stamp_ns(i64::try_from(due.as_nanos()).unwrap() + 1);
        let points = vec![Point3::new(f64::from(self.n_given), 0.0, 0.0); N_POINTS];
        Ok(Some(CameraOut { cloud: Cloud::new("camera", points).unwrap() }))
    }
}

/// Takes a fixed time for each cloud.
#[derive(Describe)]
struct Slow(Duration);

#[derive(Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
struct SlowParams {
    /// The time for each cloud.
    busy_us: u32,
}

#[derive(Inputs)]
struct SlowIn {
    /// The cloud.
    cloud: Cloud,
}

#[derive(Outputs)]
struct SlowOut {
    /// Signals that a cloud is done.
    done: Flag,
}

impl Node for Slow {
    const KIND: &'static str = "test.slow";
    type Params = SlowParams;
    type Inputs = SlowIn;
    type Outputs = SlowOut;

    fn new(params: SlowParams) -> Result<Self, ParamError> {
        Ok(Self(Duration::from_micros(params.busy_us.into())))
    }

    fn process(&mut self, i: SlowIn, _: &mut Context) -> Result<SlowOut, NodeError> {
        std::thread::sleep(self.0);
        Ok(SlowOut { done: Flag(!i.cloud.is_empty()) })
    }
}

/// Resident memory of this process in bytes; 0 if the system does not report it.
fn resident() -> u64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    statm.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok()).unwrap_or(0) * 4096
}

/// Measures memory at every hundredth cloud, after the first tenth of the run.
struct Memory {
    from: u64,
    least: AtomicU64,
    most: AtomicU64,
}

impl Observer for Memory {
    fn event(&self, event: &Event<'_>) {
        if let Event::Fired { node: "camera", item, .. } = event
            && *item >= self.from
            && item % 100 == 0
        {
            let now = resident();
            self.least.fetch_min(now, Ordering::Relaxed);
            self.most.fetch_max(now, Ordering::Relaxed);
        }
    }
}

/// Runs the camera into one slow sink; returns the report and the growth of memory in bytes.
fn overload(policy: &str, n: u32, period_us: u32) -> (RunReport, u64) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("overload.toml");
    let busy_us = period_us * OVERLOAD;
    let graph = format!(
        "[graph]\nformat = 1\nname = \"overload\"\n[node.camera]\nkind = \"test.camera\"\nn = {n}\n\
         period_us = {period_us}\n[node.sink]\nkind = \"test.slow\"\nbusy_us = {busy_us}\n\
         in.cloud = {{ from = \"camera.cloud\", {policy} }}\n[results]\ndone = {{ from = \"sink.done\", optional = {} }}\n",
        // If the last cloud is dropped, there is no last output; a run that must fail must say so.
        !policy.contains("fail")
    );
    std::fs::write(&path, graph).unwrap();
    let mut registry: Registry = osteoflow_standard::registry();
    registry.source::<Camera>().node::<Slow>();
    let plan = osteoflow_engine::check(&path, &[], &registry).unwrap().plan;
    let memory = Memory { from: u64::from(n) / 10, least: AtomicU64::new(u64::MAX), most: AtomicU64::new(0) };
    let cancelled = Arc::new(AtomicBool::new(false));
    let options = RunOptions { workers: 2, cancelled, ..RunOptions::default() };
    let report = run(&plan, &registry, &options, &memory).unwrap();
    let (least, most) = (memory.least.into_inner(), memory.most.into_inner());
    (report, most.saturating_sub(least))
}

#[test]
fn under_tenfold_overload_every_cloud_is_accounted_for_and_memory_is_flat() {
    // 1 kHz for minutes, or as fast as possible for a second. Nothing below depends on the rate.
    let minutes = std::env::var("OVERLOAD_MINUTES").ok().map(|minutes| minutes.parse::<u32>().unwrap());
    let minutes = minutes.or(std::env::var_os("SLOW_TESTS").map(|_| 2));
    let (n, period_us) = minutes.map_or((2_000, 200), |minutes| (minutes * 60_000, 1_000));
    let policies = [
        "policy = \"drop_old\"",
        "policy = \"drop_new\"",
        "policy = \"sample\", every = 10",
        "policy = \"drop_old\", capacity = 1000000, max_bytes = \"1 MiB\"",
        "policy = \"block\"",
        "policy = \"fail\"",
    ];
    let all = std::thread::scope(|scope| {
        // Blocking slows the camera down to the sink, so it emits a tenth in the same time.
        let n_of = |policy: &str| if policy.contains("block") { n / OVERLOAD } else { n };
        let runs = policies
            .map(|policy| scope.spawn(move || (policy, n_of(policy), overload(policy, n_of(policy), period_us))));
        runs.map(|run| run.join().unwrap())
    });
    for (policy, n, (report, grown)) in all {
        let link = &report.links[0];
        println!(
            "{policy}: sent {}, received {}, dropped {}, highest fill {}, memory +{} kB, {:.1} s",
            link.sent,
            link.received,
            link.dropped,
            link.highest_fill,
            grown / 1000,
            report.elapsed.as_secs_f64()
        );
        assert_eq!(link.sent, link.received + link.dropped, "{policy}");
        if policy.contains("fail") {
            let Outcome::Refused(refusal) = &report.outcome else { panic!("{policy}: {:?}", report.outcome) };
            assert!(refusal.reason.contains("its policy is to fail"), "{}", refusal.reason);
            continue;
        }
        assert_eq!((&report.outcome, link.sent), (&Outcome::Complete, u64::from(n)), "{policy}");
        if policy.contains("block") {
            assert_eq!(link.dropped, 0, "{policy}");
        }
        let warned = report.warnings.iter().any(|warning| warning.message.contains(" dropped "));
        assert_eq!(warned, link.dropped > 0, "{policy}: {:?}", report.warnings);
        // The sink receives every cloud, or an empty instead.
        assert_eq!(report.nodes[1].items, u64::from(n), "{policy}");
        // All runs share the process; the dropped clouds would be 48 MB in the shortest of them.
        assert!(grown < 24_000_000, "{policy}: memory grew by {grown} bytes");
    }
}
