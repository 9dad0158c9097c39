//! Plays items at hand in the place of a node.

use osteoflow_node::{AnySource, Body, Context, Emission, Item, NodeError, StampNs};
use std::{
    collections::VecDeque,
    sync::{Arc, OnceLock},
    time::{Duration, Instant},
};

/// Gives its items in the order of their stamps. In which order wires of one stamp are given does not matter: what
/// is computed depends on items and stamps alone.
pub(crate) struct Player {
    /// The items of each port.
    pub(crate) ports: Vec<VecDeque<Item>>,
    /// Where the node failed: what it said, at the stamp that its outputs had come to.
    pub(crate) failure: Option<Failing>,
    pub(crate) pace: Option<Arc<Pace>>,
}

/// A failure that is played.
pub(crate) struct Failing {
    pub(crate) reason: String,
    pub(crate) stamp_ns: StampNs,
    /// The outputs have come to the stamp.
    pub(crate) promised: bool,
}

/// The clock by which items are given.
pub(crate) struct Pace {
    /// How many seconds of the recording go by in one.
    pub(crate) rate: f64,
    /// Where the recording begins.
    pub(crate) first_ns: StampNs,
    pub(crate) began: OnceLock<Instant>,
}

impl Pace {
    /// Waits until the stamp's time has come, or the user asks to stop.
    fn wait(&self, stamp_ns: StampNs, ctx: &Context) {
        let began = *self.began.get_or_init(Instant::now);
        let after_s = stamp_ns.saturating_sub(self.first_ns).max(0) as f64 / 1e9 / self.rate;
        // What lies beyond what can be told as a duration is waited for without end.
        let then = Duration::try_from_secs_f64(after_s).ok().and_then(|after| began.checked_add(after));
        while !ctx.cancelled() {
            let left = then.map_or(LOOK, |then| then.saturating_duration_since(Instant::now()));
            if left.is_zero() {
                return;
            }
            std::thread::sleep(left.min(LOOK));
        }
    }
}

/// Short enough for someone who waits for the replay to stop.
const LOOK: Duration = Duration::from_millis(50);

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
    /// The end, or the failure that the node had ended with.
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
