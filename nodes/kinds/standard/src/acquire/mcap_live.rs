//! The kind `acquire.mcap_live`.

use super::{
    mcap::{self, EventBody, Mcap},
    playback::Event,
    topic_params::PortParams,
};
use osteoflow_geometry::StampNs;
use osteoflow_node::{
    Context, Declared, DeclaredPort, Describe, NodeError, ParamError, Source, params, rand::RngExt,
    schemars::JsonSchema, serde::Deserialize,
};
use std::time::{Duration, Instant};

/// A recording played in real time, as if its devices sent it now, for tests and rehearsals.
///
/// Streams, ports and stamps are those of `acquire.mcap`; an item arrives when its stamp is due, or up to `jitter_ms` later.
/// Items that the graph does not take in time wait, or are dropped by the policy of their wire, as with a device. If nothing is
/// dropped or late, the results are those of `acquire.mcap`, bit for bit.
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
    schedule: Option<Schedule>,
}

/// Parameters of [`McapLive`].
#[params(mcap)]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Those of `acquire.mcap`.
    #[serde(flatten)]
    pub mcap: mcap::Params,
    /// Playback speed relative to the recording. 1: as recorded; more: overload.
    #[param(1.0, 0.001..=1e9)]
    pub rate: f64,
    /// Maximum delay of an item, drawn for each from the run's seed; each stream stays in order. 0: none.
    #[param(0.0, 0.0..=60_000.0)]
    pub jitter_ms: f64,
    /// Maximum delay of one stream against another. A later item is replaced by an empty, and joins wait this much longer. 0:
    /// enough without jitter.
    #[param(0.0, 0.0..=60_000.0)]
    pub max_delay_ms: f64,
    /// Time without an item after which the source is reported as silent. 5: longer than any camera's interval.
    #[param(osteoflow_node::SILENT_AFTER.as_secs_f64(), 0.01..=86_400.0)]
    pub silent_after_s: f64,
}

/// The remaining events and their schedule by the clock of this machine.
struct Schedule {
    began: Instant,
    /// The stamp that is due at `began`.
    first_ns: StampNs,
    events: std::vec::IntoIter<(StampNs, Event<EventBody>)>,
}

impl Source for McapLive {
    const KIND: &'static str = "acquire.mcap_live";
    const LIVE: bool = true;
    type Params = Params;
    type Outputs = Declared<PortParams>;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { mcap: Mcap::new(params.mcap.clone())?, params, schedule: None })
    }

    fn check_ports(ports: &[DeclaredPort]) -> Result<(), ParamError> {
        Mcap::check_ports(ports)
    }

    fn is_timed(&self, port: &DeclaredPort) -> bool {
        self.mcap.is_timed(port)
    }

    fn max_delay_ns(&self) -> StampNs {
        nanoseconds(self.params.max_delay_ms)
    }

    fn silent_after(&self) -> Duration {
        Duration::from_secs_f64(self.params.silent_after_s)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        if self.schedule.is_none() {
            self.schedule = Some(self.schedule(ctx)?);
        }
        let Some(schedule) = &mut self.schedule else { return Ok(None) };
        let Some((at_ns, event)) = schedule.events.next() else { return Ok(None) };
        let since_ns = at_ns.saturating_sub(schedule.first_ns).max(0) as f64 / self.params.rate;
        let due = schedule.began.checked_add(Duration::from_nanos(since_ns as u64));
        // `None` is beyond the clock's range and never due.
        if !due.is_none_or(|due| ctx.wait_until(due)) {
            return Ok(None);
        }
        ctx.set_stamp_ns(event.stamp_ns);
        let port = event.port;
        Ok(Some(Declared::one(port, self.mcap.emission(event, ctx)?)))
    }
}

impl McapLive {
    /// Reads the recording; its schedule starts afterwards.
    fn schedule(&self, ctx: &mut Context) -> Result<Schedule, NodeError> {
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
        // The sort is stable, so equal times keep the order of stamps.
        events.sort_by_key(|(at_ns, _)| *at_ns);
        // Constants have no time and are due at once.
        let first_ns = events.iter().map(|(at_ns, _)| *at_ns).find(|at_ns| *at_ns > 0).unwrap_or(0);
        Ok(Schedule { began: Instant::now(), first_ns, events: events.into_iter() })
    }
}

fn nanoseconds(milliseconds: f64) -> StampNs {
    (milliseconds * 1e6).round() as StampNs
}
