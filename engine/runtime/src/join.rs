//! Joins: decide which items make a node fire, as a state machine without threads or channels.
//!
//! The machine is offered items, progress and ends of its ports, in any order between ports, and answers activations.
//! Its answers depend only on the items and their stamps, never on when they were offered: where a later item could
//! still change the answer, it waits until progress, a later item or the end has ruled that out.

mod port;
#[cfg(test)]
mod tests;

pub(crate) use port::PortSpec;
use port::{Match, NodeEnd, Port, Ready};

use osteoflow_node::{Body, Empty, Item, Join, Joined, Slot, StampNs};
use std::sync::Arc;

/// Result of [`Joiner::step`].
#[derive(Debug)]
pub(crate) enum Step {
    /// More must be offered first.
    Wait,
    /// The node fires, or is skipped.
    Activate(Activation),
    /// No further activation follows; further offers are drained.
    Ended,
}

/// One activation.
#[derive(Debug)]
pub(crate) struct Activation {
    /// The largest of the triggers' stamps.
    pub stamp_ns: StampNs,
    /// Why the node is skipped, if it is; otherwise [`Joiner::joined`] holds what the ports bring.
    pub skip: Option<Arc<Empty>>,
}

/// A second value arrived at a port that takes a constant.
#[derive(Debug, PartialEq)]
pub(crate) struct SecondItem {
    /// The port.
    pub port: &'static str,
    /// The number of the item on its wire.
    pub number: u64,
}

/// The joins of one node.
pub(crate) struct Joiner {
    node: Arc<str>,
    ports: Vec<Port>,
    /// What the ports bring to the current activation.
    joined: Joined,
    /// Why optional ports bring nothing to the current activation.
    absent: Vec<(&'static str, Arc<Empty>)>,
    /// Stamp of the last activation; later ones are not before it.
    last_stamp: StampNs,
    fired: bool,
    ended: bool,
    stopped: bool,
    mode: Mode,
    /// Fast path for nodes whose ports are all wired, plain and `each`. Items go directly to the slots of the firing;
    /// where an item is empty or missing, all items move to the ports and the general rules apply.
    pub in_lock_step: bool,
    /// Whether a port joins by `previous`.
    pub takes_previous: bool,
    /// In lock step: number of slots without an item.
    n_vacant: usize,
    /// In lock step: the slots belong to an activation that has not been released.
    at_hand: bool,
}

/// What triggers the node.
#[derive(Clone, Copy)]
enum Mode {
    /// `each` and `collect`; `stamp` ports follow them.
    Step,
    /// Plain `stamp` ports; optional ones follow them.
    Stamp,
    /// Only optional `stamp` ports.
    AnyStamp,
    /// No trigger.
    Once,
}

/// Stamp on which the triggers agree.
enum Anchor {
    Wait,
    Ended,
    At(StampNs),
}

/// What a port brings to the current activation.
enum Choice {
    Slot(Slot),
    Empty(Arc<Empty>),
    Absent(String),
}

impl Joiner {
    pub(crate) fn new(node: Arc<str>, ports: Vec<PortSpec>) -> Self {
        let mut ports: Vec<_> = ports.into_iter().map(|spec| Port::new(&node, spec)).collect();
        for further in (1..ports.len()).filter(|port| ports[*port].spec.continues).collect::<Vec<_>>() {
            ports[further - 1..=further].iter_mut().for_each(|port| port.is_one_of_several = true);
        }
        let mode = if ports.iter().any(Port::is_step) {
            Mode::Step
        } else if ports.iter().any(|p| p.is_stamp() && !p.spec.optional) {
            Mode::Stamp
        } else if ports.iter().any(Port::is_stamp) {
            Mode::AnyStamp
        } else {
            Mode::Once
        };
        let in_lock_step = !ports.is_empty() && ports.iter().all(Port::is_plain_each);
        let n_vacant = if in_lock_step { ports.len() } else { 0 };
        Self {
            takes_previous: ports.iter().any(Port::is_previous),
            mode,
            node,
            ports,
            joined: Joined { slots: (0..n_vacant).map(|_| VACANT).collect(), is_spent: false },
            n_vacant,
            at_hand: false,
            absent: Vec::new(),
            last_stamp: StampNs::MIN,
            fired: false,
            ended: false,
            stopped: false,
            in_lock_step,
        }
    }

    /// Whether an item is missing without which no activation can follow, whatever else arrives first. May return
    /// `false` although one is missing.
    #[inline]
    pub(crate) fn lacks_item(&self) -> bool {
        self.n_vacant > 0
            && (0..self.ports.len()).any(|port| self.ports[port].wants() && is_vacant(&self.joined.slots[port]))
    }

    /// Whether the port could use one more item now.
    #[inline]
    pub(crate) fn wants(&self, port: usize) -> bool {
        self.ended || (self.ports[port].wants() && (!self.in_lock_step || is_vacant(&self.joined.slots[port])))
    }

    /// Gives the port its next item.
    ///
    /// # Errors
    /// [`SecondItem`] if the constant has already arrived; the item is dropped.
    #[inline]
    pub(crate) fn offer(&mut self, port: usize, item: Item) -> Result<(), SecondItem> {
        if self.in_lock_step && !self.ended {
            self.ports[port].note(&item);
            self.joined.slots[port] = Slot::Item(item);
            self.n_vacant -= 1;
            return Ok(());
        }
        let end = match (self.ended, self.stopped) {
            (_, true) => NodeEnd::Stopped,
            (true, false) => NodeEnd::Ended,
            (false, false) => NodeEnd::Open,
        };
        self.ports[port].offer(item, end)
    }

    /// Promises that no further item of the port is before `stamp_ns`; returns whether this is new.
    #[inline]
    pub(crate) fn progress(&mut self, port: usize, stamp_ns: StampNs) -> bool {
        let port = &mut self.ports[port];
        let news = stamp_ns > port.progress;
        port.progress = port.progress.max(stamp_ns);
        news
    }

    /// Marks the end of the port.
    pub(crate) fn end(&mut self, port: usize) {
        self.ports[port].ended = true;
    }

    /// Ends the node on the caller's decision: further offers are drained.
    pub(crate) fn stop(&mut self) {
        (self.ended, self.stopped) = (true, true);
    }

    /// What the ports bring to the current activation, until it is released.
    #[inline]
    pub(crate) fn joined(&self) -> &Joined {
        &self.joined
    }

    /// Mutable slots of the current activation, for the node that takes the items.
    #[inline]
    pub(crate) fn joined_mut(&mut self) -> &mut Joined {
        &mut self.joined
    }

    /// Why optional ports bring nothing to the current activation.
    #[inline]
    pub(crate) fn take_absent(&mut self) -> impl Iterator<Item = (&'static str, Arc<Empty>)> {
        self.absent.drain(..)
    }

    /// Why a wired port brings nothing, if no port brings a value.
    pub(crate) fn unfed(&self) -> Option<Arc<Empty>> {
        let is_value = |item: &Item| item.body.value().is_some();
        let is_fed = || {
            self.joined.slots.iter().any(|slot| match slot {
                Slot::Item(item) => is_value(item),
                Slot::Items(items) => items.iter().any(is_value),
                Slot::Absent(_) => false,
            })
        };
        let wired = |name: &str| self.ports.iter().any(|port| port.spec.name == name && port.spec.wire.is_some());
        (!self.absent.is_empty() && !is_fed())
            .then(|| self.absent.iter().rev().find(|(name, _)| wired(name)))?
            .map(|(_, empty)| empty.clone())
    }

    /// Takes a port's items out of the current activation, for this reason.
    pub(crate) fn make_absent(&mut self, port: usize, name: &'static str, empty: Arc<Empty>) {
        self.joined.slots[port] = Slot::Absent(empty.clone());
        self.absent.push((name, empty));
    }

    /// Releases the current activation, for which the node does not fire.
    pub(crate) fn leave_out(&mut self) {
        self.absent.clear();
        self.release();
    }

    /// Releases the current activation: drops its items.
    #[inline]
    pub(crate) fn release(&mut self) {
        if self.in_lock_step {
            self.joined.slots.iter_mut().for_each(|slot| *slot = VACANT);
            (self.n_vacant, self.at_hand) = (self.ports.len(), false);
            return;
        }
        self.clear_slots();
    }

    fn clear_slots(&mut self) {
        let ports = self.ports.iter_mut().filter(|port| !port.spec.continues);
        for (slot, port) in self.joined.slots.drain(..).zip(ports) {
            if let Slot::Items(items) = slot {
                port.reuse(items);
            }
        }
        self.absent.clear();
    }

    /// Number of items of the port that were part of no activation because no partner came.
    pub(crate) fn unmatched(&self, port: usize) -> u64 {
        self.ports[port].unmatched
    }

    /// Earliest stamp of a further activation.
    pub(crate) fn progress_out(&self) -> StampNs {
        self.trigger_bound().max(self.last_stamp)
    }

    /// Earliest stamp of a further activation by the triggers alone. An optional port counts only with a waiting item,
    /// as it may end without another.
    fn trigger_bound(&self) -> StampNs {
        let open = || self.ports.iter().filter(|p| !p.finished());
        let bound = match self.mode {
            Mode::Step => {
                let sure = |p: &&Port| p.is_step() && (!p.spec.optional || p.head_stamp().is_some());
                let sure = open().filter(sure).map(Port::bound).max();
                sure.or_else(|| open().filter(|p| p.is_step()).map(Port::bound).min())
            }
            Mode::Stamp => open().filter(|p| p.is_stamp() && !p.spec.optional).map(Port::bound).max(),
            Mode::AnyStamp => open().filter(|p| p.is_stamp()).map(Port::bound).min(),
            Mode::Once => None,
        };
        bound.unwrap_or(StampNs::MIN)
    }

    /// Next activation, if the offers so far decide it.
    #[inline]
    pub(crate) fn step(&mut self) -> Step {
        if self.ended {
            return Step::Ended;
        }
        if !self.in_lock_step {
            return self.step_by_rules();
        }
        if self.at_hand {
            self.release();
        }
        if let Some(stamp_ns) = self.stamp_in_lock_step() {
            (self.last_stamp, self.fired, self.at_hand) = (stamp_ns, true, true);
            return Step::Activate(Activation { stamp_ns, skip: None });
        }
        self.leave_lock_step();
        let step = self.step_by_rules();
        // A skipped activation has been released, and its slots are vacant.
        self.at_hand = matches!(&step, Step::Activate(Activation { skip: None, .. }));
        if !self.at_hand {
            self.joined.slots.resize_with(self.ports.len(), || VACANT);
        }
        step
    }

    /// Stamp of the activation if every slot holds a value; otherwise the general rules apply.
    #[inline]
    fn stamp_in_lock_step(&self) -> Option<StampNs> {
        if self.n_vacant > 0 {
            return None;
        }
        self.joined.slots.iter().try_fold(self.last_stamp, |stamp_ns, slot| match slot {
            Slot::Item(Item { body: Body::Value(_), stamp_ns: at, .. }) => Some(stamp_ns.max(*at)),
            _ => None,
        })
    }

    /// Leaves the fast path permanently.
    #[cfg(test)]
    fn disable_lock_step(&mut self) {
        self.leave_lock_step();
        (self.in_lock_step, self.n_vacant) = (false, 0);
    }

    /// Moves the items from the slots to the ports, where the general rules look for them.
    fn leave_lock_step(&mut self) {
        for (slot, port) in self.joined.slots.drain(..).zip(&mut self.ports) {
            if let Slot::Item(item) = slot {
                port.put_back(item);
            }
        }
        self.n_vacant = self.ports.len();
    }

    fn step_by_rules(&mut self) -> Step {
        let bound = self.progress_out();
        self.ports.iter_mut().for_each(|port| port.advance(bound));
        match self.anchor() {
            Anchor::Wait => Step::Wait,
            Anchor::Ended => {
                self.ended = true;
                self.ports.iter_mut().for_each(Port::leave_unmatched);
                Step::Ended
            }
            Anchor::At(stamp_ns) => self.activate(stamp_ns).map_or(Step::Wait, Step::Activate),
        }
    }

    fn anchor(&mut self) -> Anchor {
        match self.mode {
            Mode::Step => self.anchor_in_step(),
            Mode::Stamp => self.anchor_by_stamp(),
            Mode::AnyStamp => self.anchor_by_any_stamp(),
            Mode::Once => self.anchor_once(),
        }
    }

    /// `each` and `collect`: one item or collection of each port; an optional port that has ended no longer counts.
    fn anchor_in_step(&self) -> Anchor {
        let (mut waiting, mut stamp) = (false, None);
        for port in self.ports.iter().filter(|p| p.is_step()) {
            match port.ready() {
                Ready::At(at) => stamp = stamp.max(Some(at)),
                Ready::Ended if port.spec.optional => {}
                Ready::Ended => return Anchor::Ended,
                Ready::Waiting => waiting = true,
            }
        }
        match stamp {
            _ if waiting => Anchor::Wait,
            Some(stamp) => Anchor::At(stamp),
            None => Anchor::Ended,
        }
    }

    /// `stamp` alone: the heads of all plain ports are within their tolerances of the latest head.
    fn anchor_by_stamp(&mut self) -> Anchor {
        let required = |p: &&mut Port| p.is_stamp() && !p.spec.optional;
        loop {
            let bound = self.trigger_bound();
            let mut waiting = false;
            for port in self.ports.iter_mut().filter(required) {
                port.drop_before(bound.saturating_sub(port.tolerance_ns()));
                match port.ready() {
                    Ready::At(_) => {}
                    Ready::Ended => return Anchor::Ended,
                    Ready::Waiting => waiting = true,
                }
            }
            if waiting {
                return Anchor::Wait;
            }
            let latest = self.ports.iter_mut().filter(required).map(|p| p.bound()).max().unwrap_or(StampNs::MIN);
            if self.ports.iter_mut().filter(required).any(|p| p.bound() < latest.saturating_sub(p.tolerance_ns())) {
                continue;
            }
            // Where several items of a port are within the tolerance, the newest up to the stamp is the nearest.
            if self.ports.iter_mut().filter(required).all(|p| p.settle_up_to(latest)) {
                return Anchor::At(latest);
            }
            return Anchor::Wait;
        }
    }

    /// `stamp` with optional ports only: the earliest head, and every head within its tolerance of it.
    fn anchor_by_any_stamp(&self) -> Anchor {
        let stamps = self.ports.iter().filter(|p| p.is_stamp());
        let Some(earliest) = stamps.clone().filter_map(|p| p.head_stamp()).min() else {
            return if stamps.clone().all(Port::finished) { Anchor::Ended } else { Anchor::Wait };
        };
        if stamps.clone().all(|p| p.head_stamp().is_some() || p.passed(earliest)) {
            Anchor::At(earliest)
        } else {
            Anchor::Wait
        }
    }

    /// No trigger: the node fires once, when all constants have arrived.
    fn anchor_once(&self) -> Anchor {
        if self.fired {
            return Anchor::Ended;
        }
        let constants = self.ports.iter().filter(|p| p.is_once());
        if constants.clone().any(|p| p.kept.is_none() && !p.ended) {
            return Anchor::Wait;
        }
        let stamp = constants.filter_map(|p| p.kept.as_ref().map(|item| item.stamp_ns)).max();
        Anchor::At(stamp.unwrap_or(0))
    }

    /// Activation at `anchor`; `None` if more must be offered first.
    fn activate(&mut self, anchor: StampNs) -> Option<Activation> {
        let anchored = self.stamps_are_anchored();
        let mut stamp_ns = anchor.max(self.last_stamp);
        for port in self.ports.iter_mut().filter(|p| anchored(p)) {
            match port.match_at(anchor) {
                Match::Wait => return None,
                Match::Head(at) => stamp_ns = stamp_ns.max(at),
                Match::Nothing => {}
            }
        }
        let anchor_of = |port: &Port| anchored(port).then_some(anchor);

        // The item of the firing before is taken even where the node is skipped, so that it never runs ahead in a cycle.
        if self.fired && self.ports.iter().any(|p| p.is_previous() && !p.has_previous()) {
            return None;
        }

        // The triggers decide first: where one brings no value, the other ports need not be waited for.
        let mut skip = None;
        for port in self.ports.iter().filter(|p| p.is_trigger()) {
            skip = skip.or_else(|| reason_to_skip(&self.node, port, &port.trigger_gap(anchor_of(port))?));
        }
        if skip.is_none() {
            let mut settled = true;
            for port in self.ports.iter_mut().filter(|p| p.is_sampler()) {
                settled &= port.settle_sample(stamp_ns);
            }
            settled &= !self.ports.iter().any(|p| p.is_once() && p.kept.is_none() && !p.ended);
            if !settled {
                return None;
            }
            for port in self.ports.iter().filter(|p| !p.is_trigger() && !p.is_previous()) {
                skip = skip.or_else(|| reason_to_skip(&self.node, port, &port.peek_constant(stamp_ns)));
            }
        }

        self.clear_slots();
        for port in &mut self.ports {
            let choice = match port.is_trigger() {
                true => port.take_trigger(anchored(port).then_some(anchor)),
                false if port.is_previous() => port.take_previous(self.fired),
                false if skip.is_some() => continue,
                false => port.peek_constant(stamp_ns),
            };
            let slot = match choice {
                Choice::Slot(slot) => slot,
                Choice::Empty(empty) => Slot::Absent(empty),
                Choice::Absent(reason) => Slot::Absent(Arc::new(Empty { node: self.node.to_string(), reason })),
            };
            let slot = match port.spec.continues.then(|| self.joined.slots.pop()).flatten() {
                Some(Slot::Items(mut before)) => match slot {
                    Slot::Items(mut items) => {
                        before.append(&mut items);
                        port.reuse(items);
                        Slot::Items(before)
                    }
                    absent => absent,
                },
                Some(absent) => absent,
                None => slot,
            };
            self.joined.slots.push(slot);
        }
        let ports = self.ports.iter().filter(|port| !port.spec.continues);
        for (slot, port) in self.joined.slots.iter().zip(ports) {
            let empty = match slot {
                Slot::Item(_) => None,
                Slot::Items(items) => items.iter().find_map(empty_of),
                Slot::Absent(empty) => Some(empty.clone()),
            };
            self.absent.extend(empty.map(|empty| (port.spec.name, empty)));
        }
        (self.last_stamp, self.fired) = (stamp_ns, true);
        if skip.is_some() {
            // Ports that were not asked have no slot, so their content has no meaning.
            self.release();
        }
        Some(Activation { stamp_ns, skip })
    }

    /// Selects the `stamp` ports that follow the anchor; the others determined it.
    fn stamps_are_anchored(&self) -> fn(&Port) -> bool {
        match self.mode {
            Mode::Stamp => |p| p.is_stamp() && p.spec.optional,
            _ => |p| p.is_stamp(),
        }
    }
}

/// Slot of a node in lock step without an item.
const VACANT: Slot = Slot::Items(Vec::new());

#[inline]
fn is_vacant(slot: &Slot) -> bool {
    matches!(slot, Slot::Items(_))
}

/// Why a plain port that brings no value skips the activation: the original empty, or what is absent and where.
fn reason_to_skip(node: &Arc<str>, port: &Port, choice: &Choice) -> Option<Arc<Empty>> {
    if port.spec.optional || port.spec.unused {
        return None;
    }
    match choice {
        Choice::Empty(empty) => Some(empty.clone()),
        Choice::Absent(reason) => {
            let reason = format!("input \"{}\": {reason}", port.spec.name);
            Some(Arc::new(Empty { node: node.to_string(), reason }))
        }
        Choice::Slot(_) => None,
    }
}

fn empty_of(item: &Item) -> Option<Arc<Empty>> {
    match &item.body {
        Body::Empty(empty) => Some(empty.clone()),
        Body::Value(_) => None,
    }
}

/// Slot of a single item: an empty becomes absent with its own reason.
fn choice_of(item: Item) -> Choice {
    match empty_of(&item) {
        Some(empty) => Choice::Empty(empty),
        None => Choice::Slot(Slot::Item(item)),
    }
}

/// Formats a duration: `2.05 s`, `0.2 s`, `12.5 ms` below a tenth of a second, `350 ns` below a microsecond.
pub(crate) fn span(ns: i128) -> String {
    let rounded = |value: f64| format!("{}", (value * 1e3).round() / 1e3);
    match ns {
        ..1_000 => format!("{ns} ns"),
        1_000..100_000_000 => format!("{} ms", rounded(ns as f64 / 1e6)),
        _ => format!("{} s", rounded(ns as f64 / 1e9)),
    }
}

/// Tolerance of a port's join rule.
fn tolerance_of(join: Join) -> StampNs {
    match join {
        Join::Stamp { tolerance_ns } => tolerance_ns,
        _ => 0,
    }
}
