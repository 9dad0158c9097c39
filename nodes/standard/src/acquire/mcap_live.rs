//! The kind `acquire.mcap_live`.

use super::{
    mcap::{Mcap, What},
    mcap_ports::PortParams,
    playback::Event,
};
use osteoflow_geometry::StampNs;
use osteoflow_node::{
    Context, Declared, Describe, FilePath, NodeError, ParamError, Source, rand::RngExt, schemars::JsonSchema,
    serde::Deserialize,
};
use std::time::{Duration, Instant};

/// A recording played at its own tempo, as if its devices sent it now: a live source for tests and rehearsals.
///
/// Streams, ports and stamps are those of `acquire.mcap`; an item comes when its stamp is due, or by `jitter_ms` later. As
/// with a device, what the graph does not take in time waits, or is dropped by the policy of its wire. Where nothing is
/// dropped and nothing is late, the results are those of `acquire.mcap`, bit for bit.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.mcap_live"
path = "recording.mcap"
rate = 2.0
out.scan          = { type = "geometry/Cloud", topic = "/camera/scan", frame = "camera" }
out.camera_marker = { type = "geometry/Pose", topic = "/tracker/camera_marker", to = "world", from = "camera_marker" }
"#)]
pub struct McapLive {
    mcap: Mcap,
    params: Params,
    tape: Option<Tape>,
}

/// Parameters of [`McapLive`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// The recording.
    pub path: FilePath,
    /// Whether the intact part of a damaged recording is used, and said so. false: a damaged recording is an error.
    #[serde(default)]
    pub allow_truncated: bool,
    /// How many times faster than recorded. 1: as recorded; more is overload, as from so much faster devices.
    #[serde(default = "one")]
    #[schemars(range(min = 0.001, max = 1e9))]
    pub rate: f64,
    /// How long an item takes to come, at most; drawn for each from the run's seed, each stream in its order. 0: streams
    /// come in step.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 60_000.0))]
    pub jitter_ms: f64,
    /// How far one stream may lie behind another; what comes later is late, and an empty in its place. 0: enough where
    /// there is no jitter. Each ms is one that joins wait for longer.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 60_000.0))]
    pub max_delay_ms: f64,
    /// After how long without anything it is reported as silent. 5 s: longer than any camera takes between two clouds.
    #[serde(default = "five")]
    #[schemars(range(min = 0.01, max = 86_400.0))]
    pub silent_after_s: f64,
}

fn one() -> f64 {
    1.0
}

fn five() -> f64 {
    osteoflow_node::SILENT_AFTER.as_secs_f64()
}

/// What is to come, and when by the clock of this machine.
struct Tape {
    began: Instant,
    /// The time on the tape that was due when it began.
    first_ns: StampNs,
    events: std::vec::IntoIter<(StampNs, Event<What>)>,
}

impl Source for McapLive {
    const KIND: &'static str = "acquire.mcap_live";
    const LIVE: bool = true;
    type Params = Params;
    type Outputs = Declared<PortParams>;

    fn new(params: Params) -> Result<Self, ParamError> {
        let mcap = Mcap::of(params.path.clone(), params.allow_truncated);
        Ok(Self { mcap, params, tape: None })
    }

    fn max_delay_ns(&self) -> StampNs {
        nanoseconds(self.params.max_delay_ms)
    }

    fn silent_after(&self) -> Duration {
        Duration::from_secs_f64(self.params.silent_after_s)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        if self.tape.is_none() {
            self.tape = Some(self.wind(ctx)?);
        }
        let Some(tape) = &mut self.tape else { return Ok(None) };
        let Some((at_ns, event)) = tape.events.next() else { return Ok(None) };
        let since_ns = at_ns.saturating_sub(tape.first_ns).max(0) as f64 / self.params.rate;
        let due = tape.began.checked_add(Duration::from_nanos(since_ns as u64));
        // A time beyond the clock's never comes.
        if !due.is_none_or(|due| ctx.wait_until(due)) {
            return Ok(None);
        }
        ctx.set_stamp_ns(event.stamp_ns);
        let port = event.port;
        Ok(Some(Declared::one(port, Mcap::emission(event, ctx)?)))
    }
}

impl McapLive {
    /// The tape begins when the recording has been read.
    fn wind(&self, ctx: &mut Context) -> Result<Tape, NodeError> {
        let events = self.mcap.playback(ctx)?;
        let mut rng = ctx.rng();
        let mut last_of_port = vec![StampNs::MIN; ctx.declared().len()];
        let jitter_ns = nanoseconds(self.params.jitter_ms);
        let mut events: Vec<_> = events
            .map(|event| {
                let delay_ns = if jitter_ns > 0 { rng.random_range(0..=jitter_ns) } else { 0 };
                let last_ns = &mut last_of_port[event.port];
                *last_ns = event.stamp_ns.saturating_add(delay_ns).max(*last_ns);
                (*last_ns, event)
            })
            .collect();
        // Stable: what comes at one time comes in the order of stamps.
        events.sort_by_key(|(at_ns, _)| *at_ns);
        // Constants have no time, and come at once.
        let first_ns = events.iter().map(|(at_ns, _)| *at_ns).find(|at_ns| *at_ns > 0).unwrap_or(0);
        Ok(Tape { began: Instant::now(), first_ns, events: events.into_iter() })
    }
}

fn nanoseconds(milliseconds: f64) -> StampNs {
    (milliseconds * 1e6).round() as StampNs
}
