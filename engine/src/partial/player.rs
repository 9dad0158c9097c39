//! A source that plays a node's available items.

use osteoflow_node::{AnySource, Body, Context, Emission, Item, NodeError, StampNs};
use std::{
    collections::VecDeque,
    sync::{Arc, OnceLock},
    time::{Duration, Instant},
};

/// Gives its items in the order of their stamps. The order of wires at equal stamps does not matter: results depend on
/// items and stamps alone.
pub(crate) struct Player {
    /// Items of each port.
    pub(crate) ports: Vec<VecDeque<Item>>,
    /// The node's failure, at the stamp that its outputs had reached.
    pub(crate) failure: Option<Failing>,
    pub(crate) pace: Option<Arc<Pace>>,
}

/// A failure to play.
pub(crate) struct Failing {
    pub(crate) reason: String,
    pub(crate) stamp_ns: StampNs,
    /// The stamp that the outputs reached.
    pub(crate) promised: bool,
}

/// Clock that paces the items.
pub(crate) struct Pace {
    /// Seconds of the recording per second.
    pub(crate) rate: f64,
    /// First stamp of the recording.
    pub(crate) first_ns: StampNs,
    pub(crate) began: OnceLock<Instant>,
}

impl Pace {
    /// Waits until the stamp is due, or a stop is requested.
    fn wait(&self, stamp_ns: StampNs, ctx: &Context) {
        let began = *self.began.get_or_init(Instant::now);
        let after_s = stamp_ns.saturating_sub(self.first_ns).max(0) as f64 / 1e9 / self.rate;
        // A time that does not fit a `Duration` is never due.
        let then = Duration::try_from_secs_f64(after_s).ok().and_then(|after| began.checked_add(after));
        while !ctx.cancelled() {
            let left = then.map_or(POLL_INTERVAL, |then| then.saturating_duration_since(Instant::now()));
            if left.is_zero() {
                return;
            }
            std::thread::sleep(left.min(POLL_INTERVAL));
        }
    }
}

/// Interval at which a stop request is checked.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

impl AnySource for Player {
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError> {
        let heads = self.ports.iter().filter_map(|port| port.front());
        let Some(stamp_ns) = heads.map(|item| item.stamp_ns).min() else { return self.end(ctx) };
        if let Some(pace) = &self.pace {
            pace.wait(stamp_ns, ctx);
        }
        ctx.set_stamp_ns(stamp_ns);
        for (port, emission) in self.ports.iter_mut().zip(out) {
            if port.front().is_some_and(|item| item.stamp_ns == stamp_ns)
                && let Some(item) = port.pop_front()
            {
                *emission = match item.body {
                    Body::Value(value) => Emission::Value(value),
                    Body::Empty(empty) => Emission::PassedOn(empty),
                };
            }
        }
        Ok(true)
    }
}

impl Player {
    /// Ends, or fails as the node did.
    fn end(&mut self, ctx: &mut Context) -> Result<bool, NodeError> {
        match &mut self.failure {
            None => Ok(false),
            Some(failing) if failing.promised => Err(NodeError::new(failing.reason.clone())),
            Some(failing) => {
                failing.promised = true;
                ctx.set_stamp_ns(failing.stamp_ns);
                Ok(true)
            }
        }
    }
}
