use super::{Choice, SecondItem, choice_of, empty_of, span, tolerance_of};
use osteoflow_node::{Body, Empty, Item, Join, Slot, StampNs, Value};
use std::{collections::VecDeque, sync::Arc};

/// Description of a port, as the joins need it.
#[derive(Debug, Clone)]
pub(crate) struct PortSpec {
    /// Its name.
    pub name: &'static str,
    /// How its items are chosen.
    pub join: Join,
    /// Whether the port is optional: the node accepts no value.
    pub optional: bool,
    /// Whether its items are drained.
    pub unused: bool,
    /// The wire that feeds it, `node.port`, if one does.
    pub wire: Option<String>,
    /// Whether it is a further wire of the port before it: its items go behind those of that wire.
    pub continues: bool,
}

/// Role of a port in its node's joins.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    Step,
    Stamp,
    Sampler,
    Once,
    Previous,
    /// Not wired, or drained.
    Nothing,
}

/// The state of a port.
pub(crate) struct Port {
    pub(crate) spec: PortSpec,
    role: Role,
    /// Waiting items; few, except where `collect` gathers.
    queue: VecDeque<Item>,
    /// `once`: the constant. `latest`, `interpolate`: the newest item not after the earliest possible stamp.
    pub(crate) kept: Option<Item>,
    /// No further item has an earlier stamp.
    pub(crate) progress: StampNs,
    /// The port has ended.
    pub(crate) ended: bool,
    pub(crate) n_received: u64,
    pub(crate) unmatched: u64,
    /// Windows: number of waiting items that were part of an earlier window; they are the first.
    n_seen: usize,
    /// Windows of items: number of items to come that lie between two windows.
    n_between: usize,
    /// Windows in time: the begin of the next.
    begin_ns: Option<StampNs>,
    /// Buffer reused for the next collection.
    spare: Vec<Item>,
    /// Whether several wires feed the node's port.
    pub(crate) is_one_of_several: bool,
    /// Why a port never brings a value, if it does not.
    nothing: Option<Arc<Empty>>,
}

/// Whether the node can still fire.
#[derive(Clone, Copy)]
pub(crate) enum NodeEnd {
    Open,
    Ended,
    Stopped,
}

/// Whether a port has its next item or collection.
pub(crate) enum Ready {
    At(StampNs),
    Waiting,
    Ended,
}

/// Result of matching a `stamp` port to a stamp.
pub(crate) enum Match {
    Wait,
    Head(StampNs),
    Nothing,
}

impl Port {
    pub(crate) fn new(node: &str, spec: PortSpec) -> Self {
        let role = match spec.join {
            _ if spec.wire.is_none() || spec.unused => Role::Nothing,
            Join::Each | Join::Collect { .. } | Join::CollectEvery { .. } | Join::CollectSpan { .. } => Role::Step,
            Join::Stamp { .. } => Role::Stamp,
            Join::Latest | Join::LatestAfter { .. } | Join::Interpolate { .. } => Role::Sampler,
            Join::Once => Role::Once,
            Join::Previous => Role::Previous,
        };
        let ended = spec.wire.is_none();
        let queue = VecDeque::new();
        let progress = StampNs::MIN;
        let reason = match (spec.unused, spec.optional) {
            (true, _) => Some("the node does not use it"),
            (false, true) => Some("nothing is wired to it"),
            (false, false) => None,
        };
        let nothing = reason.filter(|_| role == Role::Nothing);
        let nothing = nothing.map(|reason| Arc::new(Empty { node: node.into(), reason: reason.into() }));
        Self {
            spec,
            role,
            queue,
            kept: None,
            progress,
            ended,
            n_received: 0,
            unmatched: 0,
            n_seen: 0,
            n_between: 0,
            begin_ns: None,
            is_one_of_several: false,
            spare: Vec::new(),
            nothing,
        }
    }

    fn wired(&self) -> bool {
        self.role != Role::Nothing
    }

    /// Whether the port is wired, takes no empties, and joins by `each`.
    pub(crate) fn is_plain_each(&self) -> bool {
        self.role == Role::Step && self.spec.join == Join::Each && !self.spec.optional
    }

    /// Counts an item that goes directly to its slot.
    #[inline]
    pub(crate) fn note(&mut self, item: &Item) {
        self.n_received += 1;
        self.progress = self.progress.max(item.stamp_ns);
    }

    /// Puts a counted item back; the port has no other waiting item.
    pub(crate) fn put_back(&mut self, item: Item) {
        self.queue.push_back(item);
    }

    /// `each` and `collect` advance together.
    #[inline]
    pub(crate) fn is_step(&self) -> bool {
        self.role == Role::Step
    }

    #[inline]
    pub(crate) fn is_stamp(&self) -> bool {
        self.role == Role::Stamp
    }

    pub(crate) fn is_trigger(&self) -> bool {
        self.is_step() || self.is_stamp()
    }

    pub(crate) fn is_sampler(&self) -> bool {
        self.role == Role::Sampler
    }

    pub(crate) fn is_once(&self) -> bool {
        self.role == Role::Once
    }

    pub(crate) fn is_previous(&self) -> bool {
        self.role == Role::Previous
    }

    pub(crate) fn tolerance_ns(&self) -> StampNs {
        tolerance_of(self.spec.join)
    }

    #[inline]
    pub(crate) fn wants(&self) -> bool {
        if self.spec.unused {
            return true;
        }
        match self.spec.join {
            Join::Each | Join::Latest | Join::LatestAfter { .. } | Join::Interpolate { .. } | Join::Previous => {
                self.queue.is_empty()
            }
            Join::Stamp { .. } => self.queue.len() < 2,
            Join::Collect { n } => n.is_none_or(|n| self.queue.len() < n as usize),
            Join::CollectEvery { n, .. } => self.queue.len() < n as usize,
            Join::CollectSpan { .. } => self.n_in_window() == self.queue.len(),
            Join::Once => true,
        }
    }

    #[inline]
    pub(crate) fn offer(&mut self, item: Item, node: NodeEnd) -> Result<(), SecondItem> {
        self.note(&item);
        if self.is_once() {
            return match &self.kept {
                None => {
                    self.kept = Some(item);
                    Ok(())
                }
                // The producer failed after it had given the constant; its failure is reported elsewhere.
                Some(_) if matches!(item.body, Body::Empty(_)) => Ok(()),
                Some(_) => Err(SecondItem { port: self.spec.name, number: item.number }),
            };
        }
        match node {
            _ if self.n_between > 0 => self.n_between -= 1,
            NodeEnd::Open if self.wired() => {
                self.queue.push_back(item);
                self.settle_window();
            }
            NodeEnd::Ended if self.counts_unmatched() => self.unmatched += 1,
            _ => {}
        }
        Ok(())
    }

    /// Whether items that remain had no partner; some between two windows in time would have been left out anyhow.
    fn counts_unmatched(&self) -> bool {
        let has_gaps = matches!(self.spec.join, Join::CollectSpan { span_ns, step_ns } if step_ns > span_ns);
        self.is_trigger() && !has_gaps
    }

    /// The node has ended: waiting items had no partner.
    pub(crate) fn leave_unmatched(&mut self) {
        if self.counts_unmatched() {
            self.unmatched += (self.queue.len() - self.n_seen) as u64;
        }
        self.queue.clear();
        self.n_seen = 0;
    }

    /// Stamp of the next item.
    #[inline]
    pub(crate) fn head_stamp(&self) -> Option<StampNs> {
        self.queue.get(self.n_seen).map(|item| item.stamp_ns)
    }

    /// Earliest stamp of the port's next item or collection; a collection may end with the items it has.
    #[inline]
    pub(crate) fn bound(&self) -> StampNs {
        let decisive = match self.spec.join {
            Join::Collect { .. } => self.queue.back(),
            Join::CollectEvery { .. } | Join::CollectSpan { .. } => self.last_of_window(),
            _ => self.queue.front(),
        };
        decisive.map_or(self.progress, |item| item.stamp_ns)
    }

    /// The last item of the next window, if one of them is new.
    #[inline(never)]
    fn last_of_window(&self) -> Option<&Item> {
        let last = self.n_in_window().checked_sub(1)?;
        self.queue.get(last).filter(|_| last >= self.n_seen)
    }

    /// Number of waiting items of the next collection.
    fn n_in_window(&self) -> usize {
        match (self.spec.join, self.begin_ns) {
            (Join::CollectSpan { span_ns, .. }, Some(begin_ns)) => {
                let end_ns = begin_ns.saturating_add(span_ns);
                // At most the last item is behind the window.
                self.queue.len() - usize::from(self.queue.back().is_some_and(|item| item.stamp_ns >= end_ns))
            }
            _ => self.queue.len(),
        }
    }

    /// Windows in time: moves on to the first window with an item that was in none yet.
    fn settle_window(&mut self) {
        let Join::CollectSpan { span_ns, step_ns } = self.spec.join else { return };
        while let Some(at) = self.head_stamp() {
            let begin_ns = self.begin_ns.unwrap_or(at);
            // Number of whole steps after which the window ends behind the item.
            let late_ns = i128::from(at) - i128::from(begin_ns) - i128::from(span_ns);
            let n_steps = if late_ns < 0 { 0 } else { late_ns / i128::from(step_ns) + 1 };
            let begin_ns = i128::from(begin_ns) + n_steps * i128::from(step_ns);
            let begin_ns = StampNs::try_from(begin_ns).unwrap_or(StampNs::MAX);
            self.begin_ns = Some(begin_ns);
            while self.queue.front().is_some_and(|item| item.stamp_ns < begin_ns) {
                self.queue.pop_front();
                self.n_seen = self.n_seen.saturating_sub(1);
            }
            if self.head_stamp() == Some(at) {
                return;
            }
        }
    }

    /// Leaves the items of the collection that was taken, but for those of the next window.
    fn pass_window(&mut self) {
        let n_taken = self.n_in_window();
        let n_passed = match self.spec.join {
            Join::CollectEvery { n, step } if n_taken == n as usize => {
                self.n_between = (step as usize).saturating_sub(n_taken);
                n_taken.min(step as usize)
            }
            Join::CollectSpan { step_ns, .. } => {
                self.begin_ns = self.begin_ns.map(|begin_ns| begin_ns.saturating_add(step_ns));
                let begin_ns = self.begin_ns.unwrap_or(StampNs::MAX);
                self.queue.iter().take(n_taken).take_while(|item| item.stamp_ns < begin_ns).count()
            }
            _ => n_taken,
        };
        self.queue.drain(..n_passed);
        self.n_seen = n_taken - n_passed;
        self.settle_window();
    }

    /// Whether `collect` is complete.
    #[inline(never)]
    fn collected(&self) -> bool {
        match self.spec.join {
            Join::Collect { n: Some(n) } | Join::CollectEvery { n, .. } => self.queue.len() >= n as usize,
            Join::CollectSpan { span_ns, .. } => {
                let passed = |begin_ns: StampNs| self.progress >= begin_ns.saturating_add(span_ns);
                self.begin_ns.is_some_and(passed) || self.n_in_window() < self.queue.len()
            }
            _ => false,
        }
    }

    /// Whether the port has nothing left for any further activation.
    #[inline]
    pub(crate) fn finished(&self) -> bool {
        self.ended && self.queue.len() <= self.n_seen
    }

    /// Whether no further item comes at or before `stamp_ns`, apart from the waiting ones.
    pub(crate) fn passed(&self, stamp_ns: StampNs) -> bool {
        self.ended || self.progress > stamp_ns
    }

    /// The port's next item or collection.
    #[inline]
    pub(crate) fn ready(&self) -> Ready {
        if self.finished() {
            return Ready::Ended;
        }
        let complete = match self.spec.join {
            Join::Collect { .. } | Join::CollectEvery { .. } | Join::CollectSpan { .. } => {
                self.ended || self.collected()
            }
            _ => true,
        };
        match complete && self.queue.len() > self.n_seen {
            true => Ready::At(self.bound()),
            false => Ready::Waiting,
        }
    }

    /// Drops heads before `stamp_ns`, for which no partner can come.
    pub(crate) fn drop_before(&mut self, stamp_ns: StampNs) {
        while self.head_stamp().is_some_and(|at| at < stamp_ns) {
            self.queue.pop_front();
            self.unmatched += 1;
        }
    }

    /// Makes the newest item at or before `stamp_ns` the head; `false` if a newer one may still come.
    pub(crate) fn settle_up_to(&mut self, stamp_ns: StampNs) -> bool {
        while self.head_stamp().is_some_and(|at| at < stamp_ns) {
            match self.queue.get(1) {
                Some(next) if next.stamp_ns <= stamp_ns => {
                    self.queue.pop_front();
                    self.unmatched += 1;
                }
                Some(_) => return true,
                None => return self.passed(stamp_ns),
            }
        }
        true
    }

    /// Makes the item nearest to `anchor` the head, the earlier on a tie, and returns whether it is within the
    /// tolerance.
    pub(crate) fn match_at(&mut self, anchor: StampNs) -> Match {
        let tolerance = self.tolerance_ns();
        let (from, to) = (anchor.saturating_sub(tolerance), anchor.saturating_add(tolerance));
        loop {
            self.drop_before(from);
            let Some(at) = self.head_stamp() else {
                return if self.passed(to) { Match::Nothing } else { Match::Wait };
            };
            if at >= anchor {
                return if at <= to { Match::Head(at) } else { Match::Nothing };
            }
            let distance = anchor.saturating_sub(at);
            match self.queue.get(1).map(|next| next.stamp_ns.saturating_sub(anchor).saturating_abs()) {
                Some(next) if next < distance => {
                    self.queue.pop_front();
                    self.unmatched += 1;
                }
                Some(_) => return Match::Head(at),
                None if self.ended || self.progress >= anchor.saturating_add(distance) => return Match::Head(at),
                None => return Match::Wait,
            }
        }
    }

    /// Why the trigger brings no value, if it does not; `anchor` is given where the port is matched to the other
    /// triggers' stamp.
    pub(crate) fn trigger_gap(&self, anchor: Option<StampNs>) -> Option<Choice> {
        let choice = match (self.spec.join, self.queue.front()) {
            (join, Some(_)) if join.collects() => {
                let n_in_window = self.n_in_window();
                let empty = self.queue.iter().take(n_in_window).find_map(empty_of).filter(|_| !self.spec.optional);
                let n = match join {
                    Join::Collect { n } => n.map_or(0, |n| n as usize),
                    Join::CollectEvery { n, .. } => n as usize,
                    _ => 0,
                };
                match empty {
                    // An item may be missing because of an earlier failure.
                    Some(empty) => Choice::Empty(empty),
                    None if n_in_window >= n => return None,
                    None => {
                        let of = if self.is_one_of_several { format!(" of {}", self.wire()) } else { String::new() };
                        Choice::Absent(format!("{n_in_window} of {n} items{of} came before the end"))
                    }
                }
            }
            (Join::Stamp { tolerance_ns }, head) => {
                let near =
                    |item: &&Item| anchor.is_none_or(|a| a.abs_diff(item.stamp_ns) <= tolerance_ns.unsigned_abs());
                match head.filter(near) {
                    Some(item) => Choice::Empty(empty_of(item)?),
                    None => {
                        let within = span(tolerance_ns.into());
                        Choice::Absent(format!("no item of {} within {within} of the stamp", self.wire()))
                    }
                }
            }
            (_, Some(item)) => Choice::Empty(empty_of(item)?),
            (_, None) => Choice::Absent(self.nothing_left()),
        };
        Some(choice)
    }

    /// What the trigger brings; consumes its items.
    pub(crate) fn take_trigger(&mut self, anchor: Option<StampNs>) -> Choice {
        let gap = self.trigger_gap(anchor);
        if self.spec.join.collects() {
            let mut items = std::mem::take(&mut self.spare);
            match self.spec.join {
                Join::Collect { .. } => items.extend(self.queue.drain(..)),
                _ => {
                    items.extend(self.queue.iter().take(self.n_in_window()).cloned());
                    self.pass_window();
                }
            }
            return match gap {
                Some(gap) => {
                    self.reuse(items);
                    gap
                }
                None => Choice::Slot(Slot::Items(items)),
            };
        }
        match gap {
            Some(Choice::Absent(reason)) => Choice::Absent(reason),
            gap => {
                let item = self.queue.pop_front();
                gap.or(item.map(|item| Choice::Slot(Slot::Item(item)))).expect("a trigger without a gap has an item")
            }
        }
    }

    /// Whether the item of the firing before is there, or will never be.
    pub(crate) fn has_previous(&self) -> bool {
        self.ended || !self.queue.is_empty()
    }

    /// What the wire carried for the firing before; `fired` tells whether there was one.
    pub(crate) fn take_previous(&mut self, fired: bool) -> Choice {
        match fired.then(|| self.queue.pop_front()).flatten() {
            Some(item) => choice_of(item),
            None if fired => Choice::Absent(self.nothing_left()),
            None => Choice::Absent(format!("{} carries nothing before the first firing", self.wire())),
        }
    }

    /// Keeps the buffer of a used collection for the next.
    pub(crate) fn reuse(&mut self, mut items: Vec<Item>) {
        items.clear();
        self.spare = items;
    }

    #[cfg(test)]
    pub(crate) fn spare_capacity(&self) -> usize {
        self.spare.capacity()
    }

    /// Keeps the newest item not after `stamp_ns`, the earliest stamp that can still be asked for.
    pub(crate) fn advance(&mut self, stamp_ns: StampNs) {
        if self.is_sampler() {
            let last_ns = self.last_sampled(stamp_ns);
            while self.head_stamp().is_some_and(|at| at <= last_ns) {
                self.kept = self.queue.pop_front();
            }
        }
    }

    /// Stamp up to which a sampler takes items for a firing at `stamp_ns`.
    fn last_sampled(&self, stamp_ns: StampNs) -> StampNs {
        match self.spec.join {
            Join::LatestAfter { after_ns } => stamp_ns.saturating_add(after_ns),
            _ => stamp_ns,
        }
    }

    /// Advances a sampler to `stamp_ns`; `false` if its value there is not yet decided.
    pub(crate) fn settle_sample(&mut self, stamp_ns: StampNs) -> bool {
        self.advance(stamp_ns);
        let between = matches!(self.spec.join, Join::Interpolate { .. })
            && self.kept.as_ref().is_none_or(|kept| kept.stamp_ns < stamp_ns && matches!(kept.body, Body::Value(_)));
        // Also before the first item, the next one is waited for: the reason names its distance.
        let needs_next = between || self.kept.is_none();
        !self.queue.is_empty() || self.ended || (!needs_next && self.passed(self.last_sampled(stamp_ns)))
    }

    /// What a constant or a sampler brings at `stamp_ns`.
    pub(crate) fn peek_constant(&self, stamp_ns: StampNs) -> Choice {
        if !self.wired() {
            return match &self.nothing {
                Some(empty) => Choice::Empty(empty.clone()),
                None => Choice::Absent("nothing is wired to it".into()),
            };
        }
        match (&self.kept, self.spec.join) {
            (Some(item), Join::Once) => choice_of(item.clone()),
            (None, Join::Once) => Choice::Absent(format!("no item ever came on {}", self.wire())),
            (Some(item), Join::Interpolate { max_gap_ns }) if item.stamp_ns != stamp_ns => {
                self.between(item, max_gap_ns, stamp_ns)
            }
            (Some(item), _) => choice_of(item.clone()),
            (None, _) => Choice::Absent(match self.head_stamp() {
                Some(first) => {
                    let after = span(i128::from(first) - i128::from(stamp_ns));
                    format!("the first sample of {} is {after} after the stamp", self.wire())
                }
                None => format!("no item ever came on {}", self.wire()),
            }),
        }
    }

    fn between(&self, before: &Item, max_gap_ns: Option<i64>, stamp_ns: StampNs) -> Choice {
        let Body::Value(a) = &before.body else { return choice_of(before.clone()) };
        let Some(after) = self.queue.front() else {
            let since = span(i128::from(stamp_ns) - i128::from(before.stamp_ns));
            return Choice::Absent(format!("the last sample of {} is {since} before the stamp", self.wire()));
        };
        let Body::Value(b) = &after.body else { return choice_of(after.clone()) };
        let gap = i128::from(after.stamp_ns) - i128::from(before.stamp_ns);
        if let Some(max) = max_gap_ns.filter(|max| gap > i128::from(*max)) {
            let (gap, max) = (span(gap), span(max.into()));
            return Choice::Absent(format!("the nearest samples are {gap} apart around the stamp, {max} allowed"));
        }
        let share = (i128::from(stamp_ns) - i128::from(before.stamp_ns)) as f64 / gap as f64;
        match Value::interpolate(a, b, share) {
            Some(value) => Choice::Slot(Slot::Item(Item { number: before.number, stamp_ns, body: Body::Value(value) })),
            None => Choice::Absent(format!(
                "there is no value between the samples of {} around the stamp, {} apart: frames differ, or half a turn lies between",
                self.wire(),
                span(gap)
            )),
        }
    }

    fn wire(&self) -> &str {
        self.spec.wire.as_deref().unwrap_or("the wire")
    }

    fn nothing_left(&self) -> String {
        match self.n_received {
            0 => format!("no item ever came on {}", self.wire()),
            1 => format!("{} ended after 1 item", self.wire()),
            n => format!("{} ended after {n} items", self.wire()),
        }
    }
}
