//! A node under way: takes what its ports offer, fires, and puts the answers on its links.

use super::{
    Event, Failure, NodeStats, Warning, panics,
    runtime::Runtime,
    scheduler::{Stepped, Wake},
};
use crate::{
    channel::{LinkState, Received, RecvEnd, SendEnd},
    join::{Activation, Joiner, Step},
    plan::{OnError, OutputId, Plan},
    results::{Keep, Kept},
};
use osteoflow_node::{
    AnyNode, AnySource, Body, Built, Context, Emission, Empty, Item, NodeError, PortPayload, StampNs,
};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// A node and everything that only its own step touches.
pub(super) struct Cell {
    pub(super) index: usize,
    core: Core,
    context: Context,
    pub(super) inputs: Vec<Input>,
    pub(super) outputs: Vec<Output>,
    /// What the node answers, by output; silent between firings.
    emissions: Vec<Emission>,
    phase: Phase,
    /// The number of the next activation.
    item: u64,
    /// The stamp of the last activation, and what was promised since.
    stamp_ns: StampNs,
    skipped: u64,
    failed: u64,
    /// How long each firing took, ns.
    took: Vec<u64>,
    /// The same in all, ns.
    busy: u64,
    cheap: bool,
}

/// A node whose firings take no longer on average is not worth handing to another worker, which takes as long.
const CHEAP_NS: u64 = 10_000;
/// After so many firings a node's duration is known well enough.
const FIRINGS_TO_KNOW: u64 = 4;

/// What the cell runs.
pub(super) enum Core {
    Source(Box<dyn AnySource>),
    /// Its source is on a thread of its own.
    Live(LiveCore),
    Node(Box<dyn AnyNode>, Joiner),
    /// It has failed; what it was built of is gone.
    Gone(Option<Joiner>),
}

/// What the cell of a live source knows of it.
pub(super) struct LiveCore {
    /// No item comes later than so long after the newest.
    max_delay_ns: StampNs,
    /// The newest stamp of all outputs.
    newest_ns: StampNs,
    /// It is not asked, because an output has no room.
    waits: bool,
}

/// What a live source has answered.
pub(super) struct Answer {
    /// The number of the answer.
    pub(super) item: u64,
    stamp_ns: StampNs,
    emissions: Vec<Emission>,
    warnings: Vec<String>,
    began: Instant,
    took: u64,
    answered: Result<Result<bool, NodeError>, String>,
}

/// Whether a live source is asked for its next answer.
pub(super) enum Asked {
    Next {
        item: u64,
        stamp_ns: StampNs,
    },
    /// Its outputs lack room.
    WhenThereIsRoom,
    /// It has ended.
    Never,
}

impl Core {
    pub(super) fn live(max_delay_ns: StampNs) -> Self {
        Self::Live(LiveCore { max_delay_ns, newest_ns: StampNs::MIN, waits: false })
    }
}

impl Answer {
    /// Asks the source.
    pub(super) fn of(
        source: &mut dyn AnySource,
        context: &mut Context,
        n_ports: usize,
        item: u64,
        stamp_ns: StampNs,
    ) -> Self {
        context.begin(item, stamp_ns);
        let (mut emissions, mut took) = (vec![Emission::Silent; n_ports], Vec::new());
        let (began, answered) = timed(item, context, &mut took, |context| source.next(&mut emissions, context));
        let (stamp_ns, warnings, took) = (context.stamp_ns(), context.take_warnings(), took.pop().unwrap_or(0));
        Self { item, stamp_ns, emissions, warnings, began, took, answered }
    }
}

/// A wired input.
pub(super) struct Input {
    /// The port's index among the node's.
    pub(super) port: usize,
    pub(super) recv: RecvEnd,
}

/// An output and the links it feeds.
pub(super) struct Output {
    id: OutputId,
    payload: PortPayload,
    pub(super) links: Vec<SendEnd>,
    recorded: bool,
    keep: Keep,
    next_number: u64,
    /// Nothing may come before this stamp any more.
    floor: StampNs,
    kept: Kept,
    late: Late,
}

/// Items that a live source gave later than it had promised.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Late {
    /// How many.
    n_items: u64,
    /// How much too late the latest of them was.
    most_ns: StampNs,
}

enum Phase {
    /// It fires.
    Open,
    /// It has failed; when its outputs have room they get an empty with the reason, and end.
    Failing(Arc<Empty>),
    /// It fires no more, and takes what still comes so that nobody waits for it.
    Draining,
    Done,
}

impl Output {
    pub(super) fn new(id: OutputId, payload: PortPayload, links: Vec<SendEnd>, recorded: bool, keep: Keep) -> Self {
        Self {
            id,
            payload,
            links,
            recorded,
            keep,
            next_number: 0,
            floor: StampNs::MIN,
            kept: Kept::default(),
            late: Late::default(),
        }
    }

    pub(super) fn into_kept(self) -> Kept {
        self.kept
    }

    fn has_room(&self, states: &[LinkState]) -> bool {
        let mut room = true;
        for send in &self.links {
            // To the last: every full link notes that its producer waits.
            room &= send.has_room(&states[send.link]);
        }
        room
    }

    /// # Errors
    /// The index of a link that was full and must not be.
    fn send(&mut self, stamp_ns: StampNs, body: Body, run: &Runtime<'_>, wake: &mut Wake<'_>) -> Result<(), usize> {
        let item = Item { number: self.next_number, stamp_ns, body };
        self.next_number += 1;
        self.floor = stamp_ns;
        if self.recorded {
            run.to_taps(self.id, &item);
        }
        self.kept.count(&item, self.keep);
        let Some((last, others)) = self.links.split_last_mut() else { return Ok(()) };
        let mut full = None;
        let mut put = |send: &mut SendEnd, item: Item| {
            let link = send.link;
            if send.send(item, &run.links[link], &mut |number| run.dropped(link, number)).is_err() {
                full = full.or(Some(link));
            }
            wake.node(run.plan.links[link].to_node);
        };
        others.iter_mut().for_each(|send| put(send, item.clone()));
        put(last, item);
        full.map_or(Ok(()), Err)
    }

    fn promise(&mut self, stamp_ns: StampNs, run: &Runtime<'_>, wake: &mut Wake<'_>) {
        if stamp_ns > self.floor {
            self.floor = stamp_ns;
            for send in self.links.iter().filter(|send| send.promise(&run.links[send.link], stamp_ns)) {
                wake.node(run.plan.links[send.link].to_node);
            }
        }
    }

    fn close(&mut self, run: &Runtime<'_>, wake: &mut Wake<'_>) {
        for send in &mut self.links {
            send.close(&run.links[send.link]);
            wake.node(run.plan.links[send.link].to_node);
        }
    }
}

impl Cell {
    pub(super) fn new(index: usize, core: Core, context: Context, inputs: Vec<Input>, outputs: Vec<Output>) -> Self {
        Self {
            index,
            core,
            context,
            inputs,
            emissions: vec![Emission::Silent; outputs.len()],
            outputs,
            phase: Phase::Open,
            item: 0,
            stamp_ns: StampNs::MIN,
            skipped: 0,
            failed: 0,
            took: Vec::new(),
            busy: 0,
            cheap: false,
        }
    }

    pub(super) fn is_done(&self) -> bool {
        matches!(self.phase, Phase::Done)
    }

    /// Fires once, if inputs and outputs allow it.
    pub(super) fn step(&mut self, run: &Runtime<'_>, wake: &mut Wake<'_>) -> Stepped {
        loop {
            match &self.phase {
                Phase::Done => return Stepped::Idle,
                Phase::Draining => {
                    self.pull(run, wake);
                    if self.inputs.iter().all(|input| input.recv.ended) {
                        self.phase = Phase::Done;
                    }
                    return Stepped::Idle;
                }
                _ if !self.has_room(run) => return Stepped::Idle,
                Phase::Failing(empty) => {
                    let empty = empty.clone();
                    self.send_empties(empty, run, wake);
                    self.end(run, wake);
                }
                Phase::Open if matches!(self.core, Core::Source(_)) => {
                    if run.cancelled() {
                        run.note_interrupted();
                        self.end(run, wake);
                    } else {
                        self.call_source(run, wake);
                        return Stepped::Fired;
                    }
                }
                Phase::Open => {
                    let pulled = self.pull(run, wake);
                    let Core::Node(_, joiner) = &mut self.core else { unreachable!("an open cell has its node") };
                    match joiner.step() {
                        Step::Activate(activation) => {
                            self.activate(activation, run, wake);
                            return Stepped::Fired;
                        }
                        Step::Ended => self.end(run, wake),
                        Step::Wait if pulled => {}
                        Step::Wait => {
                            let promised = joiner.progress_out();
                            if promised > self.stamp_ns {
                                self.stamp_ns = promised;
                                self.outputs.iter_mut().for_each(|output| output.promise(promised, run, wake));
                            }
                            return Stepped::Idle;
                        }
                    }
                }
            }
        }
    }

    fn has_room(&self, run: &Runtime<'_>) -> bool {
        let mut room = true;
        for output in &self.outputs {
            room &= output.has_room(&run.links);
        }
        room
    }

    /// Takes what the joins can use; `true` if an item, progress or an end came.
    fn pull(&mut self, run: &Runtime<'_>, wake: &mut Wake<'_>) -> bool {
        let (Core::Node(_, joiner) | Core::Gone(Some(joiner))) = &mut self.core else { return false };
        let mut pulled = false;
        for Input { port, recv } in &mut self.inputs {
            let state = &run.links[recv.link];
            while !recv.ended && joiner.wants(*port) {
                match recv.receive(state) {
                    Received::Item { item, unblocks } => {
                        if unblocks {
                            wake.node(run.plan.links[recv.link].from.node);
                        }
                        if let Err(second) = joiner.offer(*port, item) {
                            let wire = run.plan.wire_name(run.plan.links[recv.link].from);
                            let reason = format!(
                                "input \"{}\" takes one item for the whole run, but {wire} gives a second one; \
                                 join it by \"latest\", or wire a constant",
                                second.port
                            );
                            let (node, item) = (self.index, second.number);
                            // The node goes on with the first: when the second comes is a matter of chance.
                            self.failed += 1;
                            run.fail(Failure { node, item, reason, panicked: false, skipped: false });
                        }
                        pulled = true;
                    }
                    Received::Nothing(progress) => {
                        // A sampler may want more once the triggers have gone on.
                        pulled |= joiner.progress(*port, progress);
                        break;
                    }
                    Received::Ended => {
                        joiner.end(*port);
                        pulled = true;
                    }
                }
            }
        }
        pulled
    }

    fn started(&self, run: &Runtime<'_>) {
        if self.item == 0 {
            run.event(&Event::Started { node: self.context.node() });
        }
    }

    fn activate(&mut self, activation: Activation, run: &Runtime<'_>, wake: &mut Wake<'_>) {
        self.started(run);
        let (item, stamp_ns) = (self.item, activation.stamp_ns);
        self.item += 1;
        self.stamp_ns = stamp_ns;
        if let Some(empty) = activation.skip {
            self.skipped += 1;
            run.event(&Event::Skipped { node: self.context.node(), item, reason: &empty.reason });
            self.send_empties(empty, run, wake);
            return;
        }
        self.context.begin(item, stamp_ns);
        let Core::Node(node, joiner) = &mut self.core else { unreachable!("an open cell has its node") };
        joiner.take_absent().for_each(|(port, empty)| self.context.note_absent(port, empty));
        let (context, took, out) = (&mut self.context, &mut self.took, &mut self.emissions);
        let (began, answered) = timed(item, context, took, |context| node.fire(joiner.joined(), out, context));
        self.tell_taps(item, began, run);
        self.after(item, stamp_ns, answered, run, wake);
        if let Core::Node(_, joiner) = &mut self.core {
            joiner.release();
        }
    }

    fn call_source(&mut self, run: &Runtime<'_>, wake: &mut Wake<'_>) {
        self.started(run);
        let item = self.item;
        self.context.begin(item, known(self.stamp_ns));
        let Core::Source(source) = &mut self.core else { unreachable!("only a source is called") };
        let (context, took, out) = (&mut self.context, &mut self.took, &mut self.emissions);
        let (began, answered) = timed(item, context, took, |context| source.next(out, context));
        let stamp_ns = self.context.stamp_ns();
        if matches!(answered, Ok(Ok(false))) {
            // The look that found the end is no answer.
            self.took.pop();
            run.warn(self.index, item, self.context.take_warnings());
            return self.end(run, wake);
        }
        self.item += 1;
        self.tell_taps(item, began, run);
        self.after(item, stamp_ns, answered.map(|answer| answer.map(drop)), run, wake);
    }

    pub(super) fn is_live(&self) -> bool {
        matches!(self.core, Core::Live(_))
    }

    /// How many activations there were.
    pub(super) fn n_items(&self) -> u64 {
        self.item
    }

    /// Whether a live source waited for room; it does no more.
    pub(super) fn take_waits(&mut self) -> bool {
        match &mut self.core {
            Core::Live(live) => std::mem::take(&mut live.waits),
            _ => false,
        }
    }

    /// What a live source has answered goes on its way.
    pub(super) fn answered(&mut self, answer: Answer, run: &Runtime<'_>, wake: &mut Wake<'_>) {
        self.started(run);
        answer.warnings.into_iter().for_each(|warning| self.context.warn(warning));
        if matches!(answer.answered, Ok(Ok(false))) {
            if run.cancelled() {
                // It ended because it was asked to.
                run.note_interrupted();
            }
            run.warn(self.index, answer.item, self.context.take_warnings());
            return self.end(run, wake);
        }
        self.item += 1;
        self.took.push(answer.took);
        self.emissions = answer.emissions;
        self.tell_taps(answer.item, answer.began, run);
        self.after(answer.item, answer.stamp_ns, answer.answered.map(|answer| answer.map(drop)), run, wake);
    }

    /// Whether a live source can be asked for its next answer; ends it where it is to end.
    pub(super) fn ask(&mut self, run: &Runtime<'_>, wake: &mut Wake<'_>) -> Asked {
        let Core::Live(_) = self.core else { return Asked::Never };
        if !self.has_room(run) {
            let Core::Live(live) = &mut self.core else { unreachable!("it was live a moment ago") };
            live.waits = true;
            return Asked::WhenThereIsRoom;
        }
        match &self.phase {
            Phase::Failing(empty) => {
                let empty = empty.clone();
                self.send_empties(empty, run, wake);
                self.end(run, wake);
                Asked::Never
            }
            Phase::Open if !run.cancelled() => Asked::Next { item: self.item, stamp_ns: known(self.stamp_ns) },
            _ => {
                self.interrupt(run, wake);
                Asked::Never
            }
        }
    }

    /// Ends a live source because of the wish to stop; `false` if it has failed and has still to say so.
    pub(super) fn interrupt(&mut self, run: &Runtime<'_>, wake: &mut Wake<'_>) -> bool {
        let ends = matches!(self.phase, Phase::Open);
        if ends {
            run.note_interrupted();
            self.end(run, wake);
        }
        ends
    }

    /// A live source cannot be asked.
    pub(super) fn fail_live(&mut self, reason: String, run: &Runtime<'_>) {
        self.fail(self.item, reason, false, false, run);
    }

    /// What a live source gives later than it has promised is an empty in its place, at the stamp up to which nothing was
    /// to come any more.
    fn empty_the_late(&mut self, stamp_ns: StampNs) {
        let Core::Live(live) = &mut self.core else { return };
        live.newest_ns = live.newest_ns.max(stamp_ns);
        for (output, emission) in self.outputs.iter_mut().zip(&mut self.emissions) {
            if stamp_ns >= output.floor || matches!(emission, Emission::Silent) {
                continue;
            }
            let late_ns = output.floor.saturating_sub(stamp_ns);
            output.late.n_items += 1;
            output.late.most_ns = output.late.most_ns.max(late_ns);
            if let Emission::Value(_) = emission {
                *emission = Emission::Empty(format!(
                    "it came {} after its wire had been promised to be complete; the source promises a delay of at most {}",
                    milliseconds(late_ns),
                    milliseconds(live.max_delay_ns)
                ));
            }
        }
    }

    fn tell_taps(&self, item: u64, began: Instant, run: &Runtime<'_>) {
        run.fired_to_taps(self.index, item, began, Duration::from_nanos(self.took.last().copied().unwrap_or(0)));
    }

    /// What follows a firing: warnings, the answers on their way, or the failure. The items of a firing that failed are
    /// still in the joiner.
    fn after(
        &mut self,
        item: u64,
        stamp_ns: StampNs,
        answered: Result<Result<(), NodeError>, String>,
        run: &Runtime<'_>,
        wake: &mut Wake<'_>,
    ) {
        run.warn(self.index, item, self.context.take_warnings());
        let took = self.took.last().copied().unwrap_or(0);
        self.busy += took;
        let n_fired = self.took.len() as u64;
        let cheap = n_fired >= FIRINGS_TO_KNOW && self.busy < CHEAP_NS * n_fired;
        if cheap != self.cheap {
            self.cheap = cheap;
            run.note_cheap(self.index, cheap);
        }
        let took = Duration::from_nanos(took);
        run.event(&Event::Fired { node: self.context.node(), item, stamp_ns, took });
        let answered = match answered {
            Ok(Ok(())) => {
                self.empty_the_late(stamp_ns);
                self.check(stamp_ns, run).map_err(|reason| (reason, false))
            }
            Ok(Err(error)) => Err((error.message, false)),
            Err(panic) => Err((panic, true)),
        };
        match answered {
            Ok(()) => {
                self.stamp_ns = self.stamp_ns.max(stamp_ns);
                if let Err(reason) = self.send_all(stamp_ns, run, wake) {
                    self.fail(item, reason, false, false, run);
                }
            }
            Err((reason, panicked)) => {
                // What it answered before it failed counts for nothing.
                self.emissions.fill(Emission::Silent);
                let skips = run.plan.nodes[self.index].on_error == OnError::Skip;
                let rebuilt = match (&self.core, skips) {
                    // A source built anew would begin again from its start.
                    (Core::Node(..), true) => Some(run.rebuild(self.index)),
                    _ => None,
                };
                match rebuilt {
                    Some(Ok(Built::Node(node))) => {
                        self.fail(item, reason.clone(), panicked, true, run);
                        if let Core::Node(old, _) = &mut self.core {
                            discard(std::mem::replace(old, node));
                        }
                        let empty = self.empty(reason);
                        self.send_empties(empty, run, wake);
                    }
                    Some(Err(why)) => {
                        let reason = format!("{reason}; and it cannot be built anew: {why}");
                        self.fail(item, reason, panicked, false, run);
                    }
                    _ => self.fail(item, reason, panicked, false, run),
                }
            }
        }
    }

    /// Whether the emissions keep what every node promises.
    fn check(&self, stamp_ns: StampNs, run: &Runtime<'_>) -> Result<(), String> {
        for (output, emission) in self.outputs.iter().zip(&self.emissions) {
            let port = || format!("output {}", run.plan.nodes[output.id.node].outputs[output.id.port].name);
            match (emission, &output.payload) {
                (Emission::Silent, _) if !matches!(self.core, Core::Source(_) | Core::Live(_)) => {
                    return Err(format!("{} stayed silent, which only a source may", port()));
                }
                (Emission::Silent, _) => {}
                (Emission::Value(value), PortPayload::Type(ty)) if value.ty() != *ty => {
                    return Err(format!("{} gave {:?}, {ty:?} expected", port(), value.ty()));
                }
                _ if stamp_ns < output.floor && !self.is_live() => {
                    let said = "stamps never decrease along a wire";
                    return Err(format!("{} gave stamp {stamp_ns} ns after {} ns; {said}", port(), output.floor));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn send_all(&mut self, stamp_ns: StampNs, run: &Runtime<'_>, wake: &mut Wake<'_>) -> Result<(), String> {
        let mut full = Ok(());
        let mut silent = false;
        for port in 0..self.outputs.len() {
            let body = match std::mem::replace(&mut self.emissions[port], Emission::Silent) {
                Emission::Value(value) => Body::Value(value),
                Emission::Empty(reason) => Body::Empty(self.empty(reason)),
                Emission::Silent => {
                    silent = true;
                    continue;
                }
            };
            let output = &mut self.outputs[port];
            // Only a late item's stamp lies before the floor.
            full = full.and(output.send(stamp_ns.max(output.floor), body, run, wake));
        }
        if let Core::Live(live) = &self.core {
            let promised = live.newest_ns.saturating_sub(live.max_delay_ns);
            self.outputs.iter_mut().for_each(|output| output.promise(promised, run, wake));
        } else if silent {
            // After the items: nothing at this stamp is overtaken by its progress.
            self.outputs.iter_mut().for_each(|output| output.promise(stamp_ns, run, wake));
        }
        full.map_err(|link| {
            let link = &run.plan.links[link];
            let to = &run.plan.nodes[link.to_node];
            format!(
                "the link {} -> {}.{} is full at {} items or {} bytes, and its policy is to fail; let it hold more, or block",
                run.plan.wire_name(link.from),
                to.name,
                to.inputs[link.to_port].port.name,
                link.capacity,
                link.max_bytes
            )
        })
    }

    fn empty(&self, reason: String) -> Arc<Empty> {
        Arc::new(Empty { node: self.context.node().to_owned(), reason })
    }

    fn send_empties(&mut self, empty: Arc<Empty>, run: &Runtime<'_>, wake: &mut Wake<'_>) {
        for output in &mut self.outputs {
            let stamp_ns = known(self.stamp_ns.max(output.floor));
            // A link that fails when full has been told of already.
            let _ = output.send(stamp_ns, Body::Empty(empty.clone()), run, wake);
        }
    }

    fn fail(&mut self, item: u64, reason: String, panicked: bool, skipped: bool, run: &Runtime<'_>) {
        self.failed += 1;
        if !skipped {
            self.phase = Phase::Failing(self.empty(reason.clone()));
        }
        run.fail(Failure { node: self.index, item, reason, panicked, skipped });
    }

    /// No firing follows: the outputs end, the inputs are drained.
    fn end(&mut self, run: &Runtime<'_>, wake: &mut Wake<'_>) {
        let failed = matches!(self.phase, Phase::Failing(_));
        self.outputs.iter_mut().for_each(|output| output.close(run, wake));
        run.event(&Event::Ended { node: self.context.node() });
        self.core = match std::mem::replace(&mut self.core, Core::Gone(None)) {
            Core::Node(node, mut joiner) => {
                discard(node);
                if failed {
                    joiner.stop();
                }
                Core::Gone(Some(joiner))
            }
            Core::Source(source) => {
                discard(source);
                Core::Gone(None)
            }
            gone => gone,
        };
        self.phase = if self.inputs.is_empty() { Phase::Done } else { Phase::Draining };
    }

    pub(super) fn unmatched(&self, port: usize) -> u64 {
        match &self.core {
            Core::Node(_, joiner) | Core::Gone(Some(joiner)) => joiner.unmatched(port),
            _ => 0,
        }
    }

    /// Says so where items had no partner.
    pub(super) fn unmatched_warning(&self, plan: &Plan) -> Vec<(usize, Warning)> {
        let ports = plan.nodes[self.index].inputs.iter().enumerate();
        let unmatched = ports.filter_map(|(port, input)| {
            let (n, wire) = (self.unmatched(port), plan.links[input.link?].from);
            let (name, wire) = (input.port.name, plan.wire_name(wire));
            let items = if n == 1 { "item" } else { "items" };
            (n > 0).then(|| format!("input \"{name}\": {n} {items} of {wire} found no partner to fire with"))
        });
        let warning = |message| Warning { node: self.context.node().to_owned(), item: self.item, message };
        unmatched.map(|message| (self.index, warning(message))).collect()
    }

    /// Says so where items came later than promised.
    pub(super) fn late_warning(&self, plan: &Plan) -> Vec<(usize, Warning)> {
        let late = self.outputs.iter().filter(|output| output.late.n_items > 0);
        let message = |output: &Output| {
            let Late { n_items, most_ns } = output.late;
            let items = if n_items == 1 { "item" } else { "items" };
            let (wire, most) = (plan.wire_name(output.id), milliseconds(most_ns));
            format!("{wire}: {n_items} {items} came late, by up to {most} more than promised, and are empties")
        };
        let warning = |message| Warning { node: self.context.node().to_owned(), item: self.item, message };
        late.map(|output| (self.index, warning(message(output)))).collect()
    }

    pub(super) fn stats(&self, name: &str) -> NodeStats {
        let mut took = self.took.clone();
        took.sort_unstable();
        // The smallest duration that so many in 100 firings do not exceed.
        let percentile = |share: usize| {
            let rank = (took.len() * share).div_ceil(100).saturating_sub(1);
            Duration::from_nanos(took.get(rank).copied().unwrap_or(0))
        };
        NodeStats {
            name: name.into(),
            items: self.item,
            skipped: self.skipped,
            failed: self.failed,
            busy: Duration::from_nanos(self.busy),
            p50: percentile(50),
            p95: percentile(95),
            p99: percentile(99),
        }
    }
}

fn milliseconds(ns: StampNs) -> String {
    format!("{} ms", ns as f64 / 1e6)
}

/// The stamp of what has none yet is 0.
fn known(stamp_ns: StampNs) -> StampNs {
    if stamp_ns == StampNs::MIN { 0 } else { stamp_ns }
}

/// Calls the node in its span, times it and catches its panic.
fn timed<T>(
    item: u64,
    context: &mut Context,
    took: &mut Vec<u64>,
    call: impl FnOnce(&mut Context) -> Result<T, NodeError>,
) -> (Instant, Result<Result<T, NodeError>, String>) {
    let _span = tracing::debug_span!("fire", node = context.node(), item).entered();
    let began = Instant::now();
    let answered = panics::catch(|| call(context));
    took.push(began.elapsed().as_nanos() as u64);
    (began, answered)
}

/// Drops what the node was built of; a panic there changes nothing any more.
pub(super) fn discard<T>(built: T) {
    if let Err(panic) = panics::catch(move || drop(built)) {
        tracing::warn!("a node that had ended {panic}");
    }
}
