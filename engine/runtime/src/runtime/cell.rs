//! A node in a run: takes items from its inputs, fires, and sends the answers over its links.

mod contracts;
mod live;
mod output;
mod source_clock;

pub use output::emission_fault;
pub(crate) use {
    contracts::{Contracts, Silence},
    live::{NextRequest, Reply},
    output::Output,
};

use crate::{
    activity::{self, Doing, Name},
    channel::{Received, RecvEnd},
    histogram::Histogram,
    join::{Activation, Joiner, Step},
    outcome::discard,
    panics,
    plan::{FrameDifference, OnError, Plan, PortFrames},
    report::{Event, Failure, NodeStats, Warning},
    runtime::{CpuClock, Runtime},
    scheduler::{Stepped, Turn},
    tap::Failed,
};
use live::LiveCore;
use osteoflow_node::{AnyNode, AnySource, Body, Built, Context, Emission, Empty, NodeError, Slot, StampNs, View};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// A node and the state that only its own step touches.
pub(crate) struct Cell {
    pub(crate) index: usize,
    core: Core,
    context: Context,
    /// The node's name, for reports of its calls.
    name: Name,
    /// The node once it has ended; it is destroyed after the run, so that a crash in its destructor costs no results.
    retired: Option<Built>,
    pub(crate) inputs: Vec<Input>,
    pub(crate) outputs: Vec<Output>,
    /// It has taken items since it last notified blocked producers.
    has_taken: bool,
    /// The node's emissions, by output; silent between firings.
    emissions: Vec<Emission>,
    phase: Phase,
    /// Number of the next activation.
    item: u64,
    /// Stamp of the last activation, or of the last promise after it.
    stamp_ns: StampNs,
    skipped: u64,
    failed: u64,
    /// Activations to which no input brought a value, and why the last of them has none.
    unfed: (u64, Option<Arc<Empty>>),
    /// Durations of firings.
    took: Histogram,
    /// Processor time of its firings, where it is measured.
    cpu: Option<Duration>,
    /// When the first activation began.
    began: Option<Instant>,
    /// From then to its end.
    wall: Duration,
    /// Number of firings of this turn that are timed together, and the start of the first.
    together: Option<(u64, Instant)>,
    cheap: bool,
    /// What the graph asks of the time of its inputs and firings.
    pub(crate) contracts: Option<Box<Contracts>>,
}

/// Mean duration below which a firing is not worth handing to another worker, since that takes as long.
const CHEAP_NS: u64 = 10_000;
/// Number of firings after which the mean duration of a node is used.
const MIN_TIMED_FIRINGS: u64 = 4;

/// What the cell runs.
pub(crate) enum Core {
    Source(Box<dyn AnySource>),
    /// A live source, which runs on a thread of its own.
    Live(LiveCore),
    Node(Box<dyn AnyNode>, Joiner),
    /// Failed; the node has been dropped.
    Gone(Option<Joiner>),
}

impl Core {
    pub(crate) fn live(max_delay_ns: StampNs) -> Self {
        Self::Live(LiveCore::new(max_delay_ns))
    }

    /// The node and its joins.
    ///
    /// # Panics
    /// If it is a source, or has ended: only an open node is stepped.
    fn node(&mut self) -> (&mut dyn AnyNode, &mut Joiner) {
        match self {
            Self::Node(node, joiner) => (node.as_mut(), joiner),
            _ => unreachable!("only an open node is stepped"),
        }
    }
}

/// A completed firing.
#[derive(Clone, Copy)]
struct Firing {
    item: u64,
    stamp_ns: StampNs,
    /// Start and duration; `None` if it was timed together with others.
    timed: Option<(Instant, Duration)>,
}

/// A wired input.
pub(crate) struct Input {
    /// Index of its lane in the joins: of the port, or of one of several wires to a port.
    pub(crate) lane: usize,
    pub(crate) recv: RecvEnd,
}

enum Phase {
    /// The node fires.
    Open,
    /// The node has failed: once its outputs have room they get an empty that says why, and end.
    Failing(Arc<Empty>),
    /// The node has ended and discards what still arrives, so that no producer blocks.
    Draining,
    Done,
}

/// The frames of a payload that has one, or two as a pose.
fn frames_of(view: &View) -> impl Iterator<Item = Arc<str>> {
    let text = |field| view.shared_text(field).ok();
    let (to, from) = text("to").zip(text("from")).unzip();
    [text("frame"), to, from].into_iter().flatten()
}

impl Cell {
    pub(crate) fn new(index: usize, core: Core, context: Context, inputs: Vec<Input>, outputs: Vec<Output>) -> Self {
        Self {
            index,
            core,
            name: Name::of(context.node()),
            context,
            retired: None,
            inputs,
            has_taken: false,
            emissions: vec![Emission::Silent; outputs.len()],
            outputs,
            phase: Phase::Open,
            item: 0,
            stamp_ns: StampNs::MIN,
            skipped: 0,
            failed: 0,
            unfed: (0, None),
            took: Histogram::default(),
            cpu: None,
            began: None,
            wall: Duration::ZERO,
            together: None,
            cheap: false,
            contracts: None,
        }
    }

    pub(crate) fn is_done(&self) -> bool {
        matches!(self.phase, Phase::Done)
    }

    /// Fires until inputs, outputs or other nodes' turns stop it.
    pub(crate) fn step(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) -> Stepped {
        loop {
            let stepped = match (&self.phase, &self.core) {
                (Phase::Open, Core::Node(..)) => self.step_node(run, turn),
                (Phase::Open, _) => self.step_source(run, turn),
                (Phase::Failing(empty), _) => {
                    let empty = empty.clone();
                    self.step_failing(empty, run, turn)
                }
                (Phase::Draining, _) => {
                    self.pull(run);
                    if self.inputs.iter().all(|input| input.recv.ended) {
                        self.phase = Phase::Done;
                    }
                    Some(Stepped::Idle)
                }
                (Phase::Done, _) => Some(Stepped::Idle),
            };
            if let Some(stepped) = stepped {
                self.time_together(run, turn);
                self.notify_producers(run, turn);
                return stepped;
            }
        }
    }

    /// Notifies the producers that are blocked on its inputs.
    fn notify_producers(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        if !std::mem::take(&mut self.has_taken) {
            return;
        }
        turn.fence();
        for Input { recv, .. } in &self.inputs {
            if recv.unblocks(&run.links[recv.link]) {
                turn.wake(run.plan.links[recv.link].from.node);
            }
        }
    }

    /// Counts the firings of this turn that are timed together, each with an equal share.
    fn time_together(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        if let Some((n, began)) = self.together.take() {
            self.count(n, took_since(began, turn), run);
        }
    }

    /// Counts firings and updates whether the node is cheap.
    fn count(&mut self, n: u64, took: Duration, run: &Runtime<'_>) {
        self.took.count(n, took.as_nanos() as u64);
        if self.cheap {
            // Reading the clock of the processor's time would take as long as the firing, which does not wait.
            self.cpu = self.cpu.map(|cpu| cpu + took);
        }
        let n_fired = self.took.n();
        let cheap = n_fired >= MIN_TIMED_FIRINGS && self.took.sum_ns() / CHEAP_NS < n_fired;
        if cheap != self.cheap {
            self.cheap = cheap;
            run.note_cheap(self.index, cheap);
        }
    }

    /// Counts the processor time since a firing began.
    fn count_cpu(&mut self, clock: Option<(CpuClock, Duration)>) {
        if let Some((clock, began)) = clock {
            self.cpu = self.cpu.map(|cpu| cpu + clock().saturating_sub(began));
        }
    }

    fn step_source(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) -> Option<Stepped> {
        if !self.has_room(run) {
            return Some(Stepped::Idle);
        }
        if run.cancelled() {
            run.note_interrupted();
            self.end(run, turn);
            return None;
        }
        self.call_source(run, turn);
        (!turn.goes_on(self.cheap)).then_some(Stepped::Fired)
    }

    fn step_node(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) -> Option<Stepped> {
        // In lock step the node needs room only once all its items are there; blocking on room earlier would wake it
        // for nothing. In a cycle the room may be made by what the node itself takes.
        let joiner = self.core.node().1;
        let (in_lock_step, takes_previous) = (joiner.in_lock_step, joiner.takes_previous);
        if !in_lock_step && !takes_previous && !self.has_room(run) {
            return Some(Stepped::Idle);
        }
        let pulled = self.pull(run);
        if run.is_halted() {
            self.end(run, turn);
            return None;
        }
        let may_fire = takes_previous || (in_lock_step && !self.core.node().1.lacks_item());
        if may_fire && !self.has_room(run) {
            return Some(Stepped::Idle);
        }
        let (_, joiner) = self.core.node();
        match joiner.step() {
            Step::Activate(activation) => {
                self.activate(activation, run, turn);
                (!turn.goes_on(self.cheap)).then_some(Stepped::Fired)
            }
            Step::Ended => {
                // The end is not an item and needs no room.
                self.end(run, turn);
                None
            }
            Step::Wait if pulled => None,
            Step::Wait => {
                let promised = joiner.progress_out();
                if promised > self.stamp_ns {
                    self.stamp_ns = promised;
                    self.outputs.iter_mut().for_each(|output| output.promise(promised, run, turn));
                }
                Some(Stepped::Idle)
            }
        }
    }

    fn step_failing(&mut self, empty: Arc<Empty>, run: &Runtime<'_>, turn: &mut Turn<'_>) -> Option<Stepped> {
        if !self.has_room(run) {
            return Some(Stepped::Idle);
        }
        self.send_empties(empty, run, turn);
        self.end(run, turn);
        None
    }

    fn has_room(&mut self, run: &Runtime<'_>) -> bool {
        let mut room = true;
        for output in &mut self.outputs {
            room &= output.has_room(&run.links);
        }
        room
    }

    /// Offers the joins what they can use; returns `true` if an item, progress or an end arrived.
    fn pull(&mut self, run: &Runtime<'_>) -> bool {
        let (Core::Node(_, joiner) | Core::Gone(Some(joiner))) = &mut self.core else { return false };
        let mut pulled = false;
        for Input { lane, recv } in &mut self.inputs {
            let state = &run.links[recv.link];
            while !recv.ended && joiner.wants(*lane) {
                match recv.receive(state) {
                    Received::Item(item) => {
                        self.has_taken = true;
                        if let Err(second) = joiner.offer(*lane, item) {
                            let wire = run.plan.wire_name(run.plan.links[recv.link].from);
                            let reason = format!(
                                "input \"{}\" takes one item for the whole run, but {wire} gives a second one; \
                                 join it by \"latest\", or wire a constant",
                                second.port
                            );
                            // The node goes on with the first item: the arrival time of the second is not
                            // deterministic.
                            self.failed += 1;
                            run.fail(Failure::error(self.index, second.number, reason));
                        }
                        pulled = true;
                    }
                    Received::Nothing(progress) => {
                        // A sampler may need more items once the triggers have advanced.
                        pulled |= joiner.progress(*lane, progress);
                        break;
                    }
                    Received::Ended => {
                        joiner.end(*lane);
                        pulled = true;
                    }
                }
            }
        }
        pulled
    }

    fn started(&mut self, run: &Runtime<'_>) {
        if self.item == 0 {
            self.began = Some(Instant::now());
            self.cpu = run.cpu_clock.map(|_| Duration::ZERO);
            run.event(&Event::Started { node: self.context.node() });
        }
    }

    fn activate(&mut self, activation: Activation, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        self.started(run);
        let (item, stamp_ns) = (self.item, activation.stamp_ns);
        self.item += 1;
        self.stamp_ns = stamp_ns;
        let skip = match activation.skip {
            None if self.contracts.is_some() => self.too_old(item, stamp_ns, run),
            skip => skip,
        };
        if let Some(empty) = skip {
            self.skipped += 1;
            self.unfed = (self.unfed.0 + 1, Some(empty.clone()));
            run.event(&Event::Skipped { node: self.context.node(), item });
            self.send_empties(empty, run, turn);
            return;
        }
        let began = self.begin(item, stamp_ns, run, turn);
        let (node, joiner) = self.core.node();
        if let Some(empty) = joiner.unfed() {
            self.unfed = (self.unfed.0 + 1, Some(empty));
        }
        joiner.take_absent().for_each(|(port, empty)| self.context.note_absent(port, empty));
        let (context, out) = (&mut self.context, &mut self.emissions);
        let answer_cache = run.answer_cache(self.index);
        let cpu_clock = run.cpu_clock.filter(|_| !self.cheap).map(|clock| (clock, clock()));
        let answered = call_node(self.name, Doing::Firing, item, context, |context| match answer_cache {
            Some(answer_cache) => answer_cache.fire(self.index, node, joiner.joined_mut(), out, context),
            None => node.fire(joiner.joined_mut(), out, context),
        });
        self.count_cpu(cpu_clock);
        let timed = began.map(|began| (began, took_since(began, turn)));
        self.after(Firing { item, stamp_ns, timed }, answered, run, turn);
        if let Core::Node(_, joiner) = &mut self.core {
            joiner.release();
        }
    }

    fn call_source(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        self.started(run);
        let item = self.item;
        let began = self.begin(item, stamp_or_zero(self.stamp_ns), run, turn);
        let Core::Source(source) = &mut self.core else { unreachable!("only a source is called") };
        let (context, out) = (&mut self.context, &mut self.emissions);
        let cpu_clock = run.cpu_clock.filter(|_| !self.cheap).map(|clock| (clock, clock()));
        let answered = call_node(self.name, Doing::Firing, item, context, |context| source.next(out, context));
        self.count_cpu(cpu_clock);
        let stamp_ns = self.context.stamp_ns();
        if matches!(answered, Ok(Ok(false))) {
            // The call that found the end is not an answer.
            if began.is_none() {
                self.together = self.together.map(|(n, began)| (n - 1, began)).filter(|(n, _)| *n > 0);
            }
            turn.clock = None;
            self.pass_warnings_on(item, run);
            return self.end(run, turn);
        }
        self.item += 1;
        let timed = began.map(|began| (began, took_since(began, turn)));
        self.after(Firing { item, stamp_ns, timed }, answered.map(|answer| answer.map(drop)), run, turn);
    }

    /// Number of activations.
    pub(crate) fn n_items(&self) -> u64 {
        self.item
    }

    /// Starts a firing and returns its start time. If the worker has done only bookkeeping since the last firing, that
    /// is the end of the last firing.
    ///
    /// A node that takes microseconds is timed together with the other firings of its turn, since reading the clock
    /// would take as long as a channel operation. A recording times each firing on its own.
    fn begin(&mut self, item: u64, stamp_ns: StampNs, run: &Runtime<'_>, turn: &mut Turn<'_>) -> Option<Instant> {
        self.context.begin(item, stamp_ns);
        if let Some(readings) = run.recorded_readings(self.index, item) {
            self.context.replay_readings(readings);
        }
        if !self.cheap {
            self.notify_producers(run, turn);
            turn.hand_over();
        }
        // A tap may have blocked on the disk.
        let clock = turn.clock.filter(|_| !run.times_firings());
        if self.contracts.is_some() {
            self.begin_deadline(run);
        }
        if !self.cheap || run.times_firings() {
            return Some(clock.unwrap_or_else(Instant::now));
        }
        match &mut self.together {
            Some((n, _)) => *n += 1,
            None => self.together = Some((1, clock.unwrap_or_else(Instant::now))),
        }
        None
    }

    fn pass_warnings_on(&mut self, item: u64, run: &Runtime<'_>) {
        if self.context.has_warnings() {
            run.warn(self.index, item, self.context.take_warnings());
        }
    }

    /// Completes a firing: passes on warnings and sends the answers, or handles the failure. The items of a failed
    /// firing are still in the joiner.
    fn after(
        &mut self,
        firing: Firing,
        answered: Result<Result<(), NodeError>, String>,
        run: &Runtime<'_>,
        turn: &mut Turn<'_>,
    ) {
        let Firing { item, stamp_ns, timed } = firing;
        if let Some((began, took)) = timed {
            self.count(1, took, run);
            run.fired_to_taps(self.index, item, stamp_ns, began, took);
        }
        if self.contracts.is_some() {
            if matches!(answered, Ok(Ok(()))) {
                self.keep_deadline(item, run);
            }
            let readings = [self.take_broken(), self.context.take_readings()].concat();
            run.readings_to_taps(self.index, item, &readings);
        } else if self.context.has_readings() {
            run.readings_to_taps(self.index, item, &self.context.take_readings());
        }
        self.pass_warnings_on(item, run);
        run.event(&Event::Fired { node: self.context.node(), item, stamp_ns });
        let is_node = matches!(self.core, Core::Node(..));
        if self.context.saw_stop() && (is_node || !matches!(answered, Ok(Ok(())))) {
            self.emissions.fill(Emission::Silent);
            if is_node {
                run.halt();
            }
            run.note_interrupted();
            return self.end(run, turn);
        }
        let answered = match answered {
            Ok(Ok(())) => {
                self.empty_late_items(stamp_ns);
                self.check(stamp_ns, run).map_err(|reason| (reason, false))
            }
            Ok(Err(error)) => Err((error.message, false)),
            Err(panic) => Err((panic, true)),
        };
        match answered {
            Ok(()) => {
                self.stamp_ns = self.stamp_ns.max(stamp_ns);
                if let Err(reason) = self.send_all(stamp_ns, run, turn) {
                    self.fail(Failure::error(self.index, item, reason), run);
                }
            }
            Err((reason, panicked)) => {
                let joined = match &self.core {
                    Core::Node(_, joiner) => Some(joiner.joined()),
                    _ => None,
                };
                run.failed_to_taps(Failed {
                    node: self.index,
                    item,
                    stamp_ns,
                    joined,
                    reason: &reason,
                    panicked,
                    injected: None,
                });
                // Emissions of a failed firing are discarded.
                self.emissions.fill(Emission::Silent);
                let skips = run.plan.nodes[self.index].on_error == OnError::Skip;
                let rebuilt = match (&self.core, skips) {
                    // A rebuilt source would start from the beginning.
                    (Core::Node(..), true) => Some(run.rebuild(self.index)),
                    _ => None,
                };
                let index = self.index;
                let failure = |reason| Failure { panicked, ..Failure::error(index, item, reason) };
                match rebuilt {
                    Some(Ok(Built::Node(node))) => {
                        self.fail(Failure { skipped: true, ..failure(reason.clone()) }, run);
                        if let Core::Node(old, _) = &mut self.core {
                            discard(self.name, Doing::Destroying, std::mem::replace(old, node));
                        }
                        let empty = self.empty(reason);
                        self.send_empties(empty, run, turn);
                    }
                    Some(Err(why)) => {
                        self.fail(failure(format!("{reason}; and it cannot be built anew: {why}")), run);
                    }
                    _ => self.fail(failure(reason), run),
                }
            }
        }
    }

    /// Checks that the emissions keep what every node promises.
    fn check(&self, stamp_ns: StampNs, run: &Runtime<'_>) -> Result<(), String> {
        let is_source = matches!(self.core, Core::Source(_) | Core::Live(_));
        for (output, emission) in self.outputs.iter().zip(&self.emissions) {
            // Late items of a live source are handled where they are sent.
            let floor = if self.is_live() { StampNs::MIN } else { output.floor };
            let planned = &run.plan.nodes[output.id.node].outputs[output.id.port];
            let fault = emission_fault(&output.payload, floor, emission, is_source, stamp_ns);
            if let Some(fault) = fault.or_else(|| self.frame_fault(&planned.frames, emission, run.plan)) {
                return Err(format!("output {} {fault}", planned.name));
            }
        }
        Ok(())
    }

    /// What is wrong with a frame that a plugin gives: the graph expects another, or lists its frames without it.
    fn frame_fault(&self, expected: &PortFrames, emission: &Emission, plan: &Plan) -> Option<String> {
        let Emission::Value(value) = emission else { return None };
        plan.nodes[self.index].plugin.as_ref()?;
        let view = value.to_view();
        if let Some(FrameDifference { key, found, expected }) = expected.difference(&view) {
            return Some(format!("has {key} \"{found}\", but the graph expects \"{expected}\"; give that frame"));
        }
        let came = |frame: &str| {
            let Core::Node(_, joiner) = &self.core else { return false };
            let mut values = joiner.joined().slots.iter().flat_map(Slot::items).filter_map(|item| item.body.value());
            values.any(|value| frames_of(&value.to_view()).any(|came| *came == *frame))
        };
        let planned = |frame: &str| plan.all_outputs().any(|id| plan.nodes[id.node].outputs[id.port].frames.has(frame));
        let unknown = |frame: &Arc<str>| !plan.frames.contains(&frame.to_string()) && !planned(frame) && !came(frame);
        let frame = frames_of(&view).find(unknown).filter(|_| !plan.frames.is_empty())?;
        let names = plan.frames.join(", ");
        Some(format!(
            "has frame \"{frame}\", but the graph's are {names}; give one of them, or add it to frames in [graph]"
        ))
    }

    fn send_all(&mut self, stamp_ns: StampNs, run: &Runtime<'_>, turn: &mut Turn<'_>) -> Result<(), String> {
        let mut full = Ok(());
        let mut silent = false;
        for port in 0..self.outputs.len() {
            let body = match std::mem::replace(&mut self.emissions[port], Emission::Silent) {
                Emission::Value(value) => Body::Value(value),
                Emission::Empty(reason) => Body::Empty(self.empty(reason)),
                Emission::PassedOn(empty) => Body::Empty(empty),
                Emission::Silent => {
                    silent = true;
                    continue;
                }
            };
            let output = &mut self.outputs[port];
            // Only the stamp of a late item is before the floor.
            full = full.and(output.send(stamp_ns.max(output.floor), body, run, turn));
        }
        if let Core::Live(live) = &self.core {
            let promised = live.newest_ns.saturating_sub(live.max_delay_ns);
            self.outputs.iter_mut().for_each(|output| output.promise(promised, run, turn));
        } else if silent {
            // Progress follows the items, so that it does not overtake items with the same stamp.
            self.outputs.iter_mut().for_each(|output| output.promise(stamp_ns, run, turn));
        }
        full.map_err(|link| {
            let link = &run.plan.links[link];
            let (from, to) = run.plan.link_names(link);
            format!(
                "the link {from} -> {to} is full at {} items or {} bytes, and its policy is to fail; let it hold more, or block",
                link.capacity, link.max_bytes
            )
        })
    }

    fn empty(&self, reason: String) -> Arc<Empty> {
        Arc::new(Empty { node: self.context.node().to_owned(), reason })
    }

    fn send_empties(&mut self, empty: Arc<Empty>, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        for output in &mut self.outputs {
            let stamp_ns = stamp_or_zero(self.stamp_ns.max(output.floor));
            // A link that fails when full has been reported already.
            let _ = output.send(stamp_ns, Body::Empty(empty.clone()), run, turn);
        }
    }

    fn fail(&mut self, failure: Failure, run: &Runtime<'_>) {
        self.failed += 1;
        if !failure.skipped {
            self.phase = Phase::Failing(self.empty(failure.reason.clone()));
        }
        run.fail(failure);
    }

    /// Ends the node: closes its outputs and drains its inputs.
    fn end(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        let failed = matches!(self.phase, Phase::Failing(_));
        self.outputs.iter_mut().for_each(|output| output.close(run, turn));
        run.event(&Event::Ended { node: self.context.node() });
        self.wall = self.began.map(|began| began.elapsed()).unwrap_or_default();
        self.core = match std::mem::replace(&mut self.core, Core::Gone(None)) {
            Core::Node(node, mut joiner) => {
                self.retired = Some(Built::Node(node));
                if failed {
                    joiner.stop();
                }
                Core::Gone(Some(joiner))
            }
            Core::Source(source) => {
                self.retired = Some(Built::Source(source));
                Core::Gone(None)
            }
            gone => gone,
        };
        self.phase = if self.inputs.is_empty() { Phase::Done } else { Phase::Draining };
    }

    /// The node, to be destroyed after the run.
    pub(crate) fn into_retired(self) -> (Name, Option<Built>) {
        let built = match self.core {
            Core::Node(node, _) => Some(Built::Node(node)),
            Core::Source(source) => Some(Built::Source(source)),
            Core::Live(_) | Core::Gone(_) => self.retired,
        };
        (self.name, built)
    }

    pub(crate) fn unmatched(&self, lane: usize) -> u64 {
        match &self.core {
            Core::Node(_, joiner) | Core::Gone(Some(joiner)) => joiner.unmatched(lane),
            _ => 0,
        }
    }

    /// Warnings about items that had no partner.
    pub(crate) fn unmatched_warning(&self, plan: &Plan) -> Vec<(usize, Warning)> {
        let unmatched = self.inputs.iter().filter_map(|Input { lane, recv }| {
            let (n, link) = (self.unmatched(*lane), &plan.links[recv.link]);
            let (name, wire) = (plan.nodes[self.index].inputs[link.to_port].port.name, plan.wire_name(link.from));
            let items = if n == 1 { "item" } else { "items" };
            (n > 0).then(|| format!("input \"{name}\": {n} {items} of {wire} found no partner to fire with"))
        });
        let warning = |message| Warning { node: self.context.node().to_owned(), item: self.item, message };
        unmatched.map(|message| (self.index, warning(message))).collect()
    }

    pub(crate) fn stats(&self, name: &str) -> NodeStats {
        let spread = self.took.spread();
        NodeStats {
            name: name.into(),
            items: self.item,
            skipped: self.skipped,
            failed: self.failed,
            unfed: self.unfed.0,
            last_empty: self.unfed.1.clone(),
            busy: Duration::from_nanos(self.took.sum_ns()),
            cpu: self.cpu,
            wall: self.wall,
            p50: spread.p50,
            p95: spread.p95,
            p99: spread.p99,
        }
    }
}

/// Stamp, or 0 where there is none yet.
pub fn stamp_or_zero(stamp_ns: StampNs) -> StampNs {
    if stamp_ns == StampNs::MIN { 0 } else { stamp_ns }
}

/// Time since a firing began; the end may be taken as the start of the next firing.
fn took_since(began: Instant, turn: &mut Turn<'_>) -> Duration {
    let ended = Instant::now();
    turn.clock = Some(ended);
    ended.saturating_duration_since(began)
}

/// Calls the node in its tracing span and catches a panic.
fn call_node<T>(
    name: Name,
    doing: Doing,
    item: u64,
    context: &mut Context,
    call: impl FnOnce(&mut Context) -> Result<T, NodeError>,
) -> Result<Result<T, NodeError>, String> {
    let _span = tracing::debug_span!("fire", node = context.node(), item).entered();
    let _under = activity::begin(name, doing, item);
    panics::catch(|| call(context))
}
