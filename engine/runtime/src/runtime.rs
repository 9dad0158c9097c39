//! The runtime: builds the nodes of a plan, links them and steps them.

mod cell;
mod live;

pub use cell::{emission_fault, stamp_or_zero};

use crate::{
    activity::{self, Doing, Name},
    channel::{self, Limits, LinkState, RecvEnd, SendEnd},
    inject::{Injection, Planned},
    join::{Joiner, PortSpec},
    latency::Answers,
    messages::Messages,
    outcome::{Retired, RunOutcome},
    panics,
    plan::{OutputId, Plan, PlanInput, PlanNode, Policy},
    report::{
        BuildError, BuildFault, ContractStats, Enlargement, Event, Failure, LinkStats, Observer, Refusal, Warning,
    },
    scheduler::{Scheduler, Stepped, Turn, Work},
    sign::Sign,
    sync::locked,
    tap::{Failed, Replayed, Tap},
};
use cell::{Cell, Contracts, Core, Input, Output, Silence};
use live::{Live, LiveMessage, Mailbox};
use osteoflow_node::{
    AnyNode, BuildContext, Built, ClockReading, Context, Emission, Joined, NodeError, ParamError, Registry, Role,
    StampNs,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
    path::Path,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

/// How a plan is run.
#[derive(Debug, Clone)]
pub struct RunSettings<'a> {
    /// Number of threads that run nodes; with 1 all nodes run on the calling thread.
    pub workers: usize,
    /// Seed for random delays, spurious wake-ups and another order of nodes.
    pub shuffle: Option<u64>,
    /// Folder into which nodes may write.
    pub out_dir: Option<&'a Path>,
    /// Stop request, set from outside.
    pub cancelled: Arc<AtomicBool>,
    /// Injected failures.
    pub inject: &'a [Injection],
    /// Measures the processor time of firings; `None` measures none.
    pub cpu_clock: Option<CpuClock>,
    /// In a simulation: the time since the run began, ns, by which contracts of time are judged; `None`: this machine's.
    pub clock: Option<Arc<AtomicU64>>,
}

/// The processor time that the calling thread has used so far, with what others used for it.
pub type CpuClock = fn() -> Duration;

/// Answers of earlier firings, used instead of firing.
pub trait AnswerCache: Sync {
    /// Whether answers of the node are cached.
    fn caches(&self, node: usize) -> bool;

    /// Like [`AnyNode::fire`] of the node with this index, from the cache if possible.
    ///
    /// # Errors
    /// Those of the node.
    fn fire(
        &self,
        index: usize,
        node: &mut dyn AnyNode,
        joined: &mut Joined,
        out: &mut [Emission],
        context: &mut Context,
    ) -> Result<(), NodeError>;
}

/// A run in progress.
pub struct Runtime<'a> {
    pub(crate) plan: &'a Plan,
    registry: &'a Registry,
    observer: &'a dyn Observer,
    cancelled: Arc<AtomicBool>,
    /// Whether a stop request has changed what the run did.
    interrupted: AtomicBool,
    /// Whether a firing was discarded because it saw the stop request. No node fires any more: what follows from the
    /// missing item would be computed otherwise in a replay.
    halted: AtomicBool,
    n_workers: usize,
    shuffle: Option<u64>,
    pub(crate) cpu_clock: Option<CpuClock>,
    cells: Vec<Mutex<Cell>>,
    /// Nodes whose firings have taken microseconds so far.
    cheap: Vec<AtomicBool>,
    pub(crate) links: Vec<LinkState>,
    pub(crate) taps: Vec<&'a dyn Tap>,
    /// Whether any tap listens to firings.
    times_firings: bool,
    messages: Mutex<Messages>,
    /// Injected failures, by node.
    planned: Vec<Arc<Planned>>,
    answer_cache: Option<&'a dyn AnswerCache>,
    enlargements: Mutex<Vec<Enlargement>>,
    stall: Mutex<Option<Failure>>,
    /// The node that was being stepped when the engine itself panicked, plus 1.
    panicked: AtomicUsize,
    began: Instant,
    clock: Option<Arc<AtomicU64>>,
    /// The newest answers of live sources upstream of an input with a maximum age, and when they came.
    arrivals: Vec<Option<Answers>>,
    elapsed: Duration,
    readings: Option<BTreeMap<(usize, u64), Vec<ClockReading>>>,
    /// Recorded signs of nodes that are played.
    signs: Vec<Sign>,
    /// Live sources that have not started.
    sources: Mutex<Vec<Live>>,
    /// Number of live sources that are asked for their next answer.
    n_pending: AtomicUsize,
    pub(crate) mailbox: Mailbox,
}

/// A node that is being stepped.
pub(crate) struct Stepping<'r> {
    panicked: &'r AtomicUsize,
    node: usize,
}

impl Drop for Stepping<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.panicked.store(self.node + 1, Ordering::Relaxed);
        }
    }
}

/// Maximum number of full and of empty links named in the message about a stuck graph.
const MAX_LINKS: usize = 8;

impl<'a> Runtime<'a> {
    /// Builds every node without running any.
    ///
    /// # Errors
    /// [`BuildError::Build`] with all nodes that cannot be built.
    pub fn build(
        plan: &'a Plan,
        registry: &'a Registry,
        settings: &RunSettings<'_>,
        answer_cache: Option<&'a dyn AnswerCache>,
        observer: &'a dyn Observer,
        mut replayed: Replayed,
    ) -> Result<Self, BuildError> {
        settings.inject.iter().try_for_each(|injection| injection.check(plan)).map_err(BuildError::Inject)?;
        let planned: Vec<_> = plan.nodes.iter().map(|node| Planned::of(&node.name, settings.inject)).collect();
        let mut bodies = Vec::with_capacity(plan.nodes.len());
        let mut faults = Vec::new();
        for (index, node) in plan.nodes.iter().enumerate() {
            let substitute = replayed.substitutes.remove(&index).map(Built::Source);
            let live = node.role == Role::LiveSource && substitute.is_none();
            match substitute.map_or_else(|| build(registry, node, plan.seed), Ok) {
                Ok(built) => bodies.push((planned[index].into_node(built), live)),
                Err(fault) => faults.push(fault),
            }
        }
        if !faults.is_empty() {
            return Err(BuildError::Build(faults));
        }

        let (mut links, mut sends, mut recvs) = (Vec::new(), Vec::new(), Vec::new());
        for (index, link) in plan.links.iter().enumerate() {
            let producer = &plan.nodes[link.from.node].name;
            let wire = plan.wire_name(link.from);
            let limits = Limits {
                capacity: link.capacity,
                max_bytes: link.max_bytes,
                policy: link.policy,
                recorded_drops: replayed.drops.as_mut().map(|drops| drops.remove(&index).unwrap_or_default()),
            };
            let (state, send, recv) = channel::link(index, limits, producer, &wire);
            links.push(state);
            sends.push(Some(send));
            recvs.push(Some(recv));
        }
        let out_dir: Option<Arc<Path>> = settings.out_dir.map(Arc::from);
        let mut cells = Vec::with_capacity(plan.nodes.len());
        let mut sources = Vec::new();
        for (index, (built, live)) in bodies.into_iter().enumerate() {
            let node = &plan.nodes[index];
            let context = || {
                Context::new(node.name.clone(), plan.seed, settings.cancelled.clone(), node.declared.clone())
                    .with_out_dir(out_dir.clone())
            };
            let core = match built {
                Built::Source(source) if live => {
                    let max_delay_ns = source.max_delay_ns().max(0);
                    sources.push(Live { node: index, source, context: context(), n_ports: node.outputs.len() });
                    Core::live(max_delay_ns)
                }
                Built::Source(source) => Core::Source(source),
                Built::Node(built) => Core::Node(built, joiner(plan, node)),
            };
            let inputs = lanes(node)
                .enumerate()
                .filter_map(|(lane, (_, link))| Some(Input { lane, recv: recvs[link?].take()? }));
            let outputs = node.outputs.iter().enumerate().map(|(port, output)| {
                let id = OutputId { node: index, port };
                let links = output.links.iter().filter_map(|link| sends[*link].take());
                Output::new(id, output.payload, links.collect(), Silence::of(plan, id))
            });
            let mut cell = Cell::new(index, core, context(), inputs.collect(), outputs.collect());
            cell.contracts = Contracts::of(plan, index);
            cells.push(Mutex::new(cell));
        }
        let arrivals = arrivals(&mut cells, &sources);
        Ok(Self {
            plan,
            registry,
            observer,
            cancelled: settings.cancelled.clone(),
            interrupted: AtomicBool::new(false),
            halted: AtomicBool::new(false),
            n_workers: settings.workers.max(1),
            shuffle: settings.shuffle,
            cpu_clock: settings.cpu_clock,
            cheap: cells.iter().map(|_| AtomicBool::new(false)).collect(),
            cells,
            links,
            taps: Vec::new(),
            times_firings: false,
            messages: Mutex::new(Messages::new(plan.nodes.len())),
            planned,
            answer_cache,
            enlargements: Mutex::default(),
            stall: Mutex::default(),
            panicked: AtomicUsize::new(0),
            began: Instant::now(),
            clock: settings.clock.clone(),
            arrivals,
            elapsed: Duration::ZERO,
            readings: replayed.readings,
            signs: replayed.signs,
            n_pending: AtomicUsize::new(sources.len()),
            mailbox: Mailbox::new(sources.len()),
            sources: Mutex::new(sources),
        })
    }

    /// Adds the listeners of the run.
    pub fn tap(&mut self, taps: &[&'a dyn Tap]) {
        self.taps = taps.to_vec();
        self.times_firings = taps.iter().any(|tap| tap.times_firings());
        for cell in &mut self.cells {
            let cell = cell.get_mut().unwrap_or_else(PoisonError::into_inner);
            cell.outputs.iter_mut().for_each(|output| output.listen(taps));
        }
    }

    /// Runs to the end. The outcome stays in the runtime; see [`Runtime::into_outcome`].
    ///
    /// # Panics
    /// If the engine itself, a tap or the observer panics on any thread; the message names the node that was being run. Panics
    /// of nodes are their failures.
    pub fn run(&mut self) {
        self.began = Instant::now();
        let sources = std::mem::take(&mut *locked(&self.sources));
        let scheduler = Scheduler::new(self.cells.len(), self.n_workers, self.shuffle);
        let ran = catch_unwind(AssertUnwindSafe(|| match sources.is_empty() {
            true => scheduler.run(self),
            false => live::run(self, &scheduler, sources),
        }));
        if let Err(payload) = ran {
            let message = panics::describe(payload);
            let node = self.panicked.load(Ordering::Relaxed).checked_sub(1);
            let node = node.map_or_else(String::new, |node| format!("node \"{}\": ", self.plan.nodes[node].name));
            resume_unwind(Box::new(format!("{node}{message}")));
        }
        self.elapsed = self.began.elapsed();
    }

    /// Outcome of the run.
    pub fn into_outcome(self) -> RunOutcome {
        let interrupted = self.interrupted.load(Ordering::Relaxed);
        let cells: Vec<Cell> =
            self.cells.into_iter().map(|cell| cell.into_inner().unwrap_or_else(PoisonError::into_inner)).collect();
        let messages = self.messages.into_inner().unwrap_or_else(PoisonError::into_inner);
        let (failures, mut warnings, mut signs) = messages.finish(self.plan);
        signs.extend(self.signs);
        if !interrupted {
            warnings.extend(self.planned.iter().enumerate().flat_map(|(node, planned)| {
                planned.missed().map(move |injection| (node, missed_injection(injection)))
            }));
        }
        let stall = self.stall.into_inner().unwrap_or_else(PoisonError::into_inner);
        warnings.extend(cells.iter().flat_map(|cell| cell.unmatched_warning(self.plan)));
        warnings.extend(cells.iter().flat_map(|cell| cell.late_warning(self.plan)));
        let links = (0..self.plan.links.len())
            .filter_map(|link| link_stats(self.plan, &cells, link, stall.is_some()))
            .collect::<Vec<_>>();
        let lossy = self.plan.links.iter().zip(&links).filter(|(link, _)| link.policy != Policy::Block);
        warnings.extend(lossy.filter(|(_, stats)| stats.dropped > 0).map(|(link, stats)| {
            let LinkStats { from, to, sent, dropped, .. } = stats;
            let items = if *sent == 1 { "item" } else { "items" };
            let message =
                format!("{from} -> {to} dropped {dropped} of its {sent} {items} by its policy {}", link.policy);
            let (node, item) = (link.from.node, cells[link.from.node].n_items());
            (node, Warning { node: self.plan.nodes[node].name.to_string(), item, message })
        }));
        let contracts: Vec<_> = cells.iter().flat_map(|cell| cell.contract_stats(self.plan)).collect();
        for broken in contracts.iter().filter_map(ContractStats::broken) {
            // In a replay, those of what is played are among the recorded signs.
            signs.extend(broken.sign().filter(|sign| !signs.contains(sign)).into_iter().collect::<Vec<_>>());
            warnings.extend(self.plan.node(&broken.node).map(|node| (node, broken)));
        }
        signs.sort_by_cached_key(|sign| self.plan.node(&sign.node));
        warnings.sort_by_key(|(node, warning)| (*node, warning.item));
        RunOutcome {
            interrupted,
            nodes: cells.iter().map(|cell| cell.stats(&self.plan.nodes[cell.index].name)).collect(),
            links,
            n_items: cells.iter().map(|cell| cell.outputs.iter().map(Output::n_items).collect()).collect(),
            n_values: cells.iter().map(|cell| cell.outputs.iter().map(|output| output.n_values).collect()).collect(),
            failures,
            stall,
            warnings: warnings.into_iter().map(|(_, warning)| warning).collect(),
            signs,
            contracts,
            enlargements: self.enlargements.into_inner().unwrap_or_else(PoisonError::into_inner),
            elapsed: self.elapsed,
            retired: Retired::new(cells.into_iter().map(Cell::into_retired)),
        }
    }

    /// The answer cache, if it keeps answers of the node.
    pub(crate) fn answer_cache(&self, node: usize) -> Option<&'a dyn AnswerCache> {
        self.answer_cache.filter(|answer_cache| answer_cache.caches(node))
    }

    /// Rebuilds a node after it failed.
    pub(crate) fn rebuild(&self, node: usize) -> Result<Built, String> {
        let built =
            build(self.registry, &self.plan.nodes[node], self.plan.seed).map_err(|fault| fault.error.message)?;
        Ok(self.planned[node].into_node(built))
    }

    /// Notes the node if the engine panics before the guard is dropped.
    pub(crate) fn stepping(&self, node: usize) -> Stepping<'_> {
        Stepping { panicked: &self.panicked, node }
    }

    pub(crate) fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// Locks a node's cell, for the thread that serves live sources.
    pub(crate) fn cell(&self, node: usize) -> MutexGuard<'_, Cell> {
        locked(&self.cells[node])
    }

    /// Counts one live source less as pending; returns whether it was the last.
    pub(crate) fn no_longer_pending(&self) -> bool {
        self.n_pending.fetch_sub(1, Ordering::AcqRel) == 1
    }

    /// No live source can run.
    pub(crate) fn fail_live(&self, reason: &str, scheduler: &Scheduler) {
        for cell in self.cells.iter().filter(|cell| locked(cell).is_live()) {
            locked(cell).fail_live(reason.to_owned(), self);
            // Nothing waits on its links yet, so there is room for the reason.
            scheduler.outside(|turn| locked(cell).ask(self, turn));
            self.n_pending.fetch_sub(1, Ordering::AcqRel);
        }
    }

    pub(crate) fn note_cheap(&self, node: usize, cheap: bool) {
        self.cheap[node].store(cheap, Ordering::Relaxed);
    }

    pub(crate) fn note_interrupted(&self) {
        self.interrupted.store(true, Ordering::Relaxed);
    }

    /// Stops all nodes; call before the outputs of the halted node are closed.
    pub(crate) fn halt(&self) {
        self.note_interrupted();
        self.halted.store(true, Ordering::Release);
    }

    pub(crate) fn is_halted(&self) -> bool {
        self.halted.load(Ordering::Acquire)
    }

    pub(crate) fn event(&self, event: &Event<'_>) {
        self.observer.event(event);
    }

    /// Whether each firing is timed on its own.
    pub(crate) fn times_firings(&self) -> bool {
        self.times_firings
    }

    pub(crate) fn fired_to_taps(&self, node: usize, item: u64, stamp_ns: StampNs, began: Instant, took: Duration) {
        if self.times_firings {
            let began = began.saturating_duration_since(self.began);
            self.taps.iter().for_each(|tap| tap.fired(node, item, stamp_ns, began, took));
        }
    }

    /// The time since the run began, by which contracts of time are judged.
    pub(crate) fn now(&self) -> Duration {
        self.time_of(Instant::now())
    }

    fn time_of(&self, at: Instant) -> Duration {
        match &self.clock {
            Some(clock) => Duration::from_nanos(clock.load(Ordering::SeqCst)),
            None => at.saturating_duration_since(self.began),
        }
    }

    /// An answer of a live source came.
    pub(crate) fn note_arrival(&self, node: usize, stamp_ns: StampNs, at: Instant) {
        if let Some(answers) = &self.arrivals[node] {
            answers.note(stamp_ns, self.time_of(at));
        }
    }

    /// Time since the newest answer of these live sources came that is not after the stamp.
    pub(crate) fn age_by_arrival(&self, sources: &[usize], stamp_ns: StampNs) -> Option<StampNs> {
        let answers = sources.iter().filter_map(|source| self.arrivals[*source].as_ref()?.before(stamp_ns));
        let (_, at) = answers.max_by_key(|(newest_ns, _)| (*newest_ns <= stamp_ns, *newest_ns))?;
        StampNs::try_from(self.now().saturating_sub(at).as_nanos()).ok()
    }

    /// Clock readings recorded for a firing, in a replay.
    pub(crate) fn recorded_readings(&self, node: usize, item: u64) -> Option<&[ClockReading]> {
        let readings = self.readings.as_ref()?;
        Some(readings.get(&(node, item)).map_or(&[], Vec::as_slice))
    }

    pub(crate) fn readings_to_taps(&self, node: usize, item: u64, readings: &[ClockReading]) {
        if !readings.is_empty() {
            self.taps.iter().for_each(|tap| tap.live(node, item, readings));
        }
    }

    pub(crate) fn dropped(&self, link: usize, number: u64) {
        self.taps.iter().for_each(|tap| tap.dropped(link, number));
    }

    pub(crate) fn fail(&self, failure: Failure) {
        if self.cancelled() {
            // A long computation stopped because it was asked to.
            self.note_interrupted();
        }
        self.event(&Event::Failed(&refusal(self.plan, &failure)));
        locked(&self.messages).failure(failure);
    }

    /// Passes a failed firing to the taps, so that its items can be saved and it can be run again alone.
    #[cold]
    pub(crate) fn failed_to_taps(&self, mut failed: Failed<'_>) {
        // A computation that stopped because it was asked to has not failed.
        if self.cancelled() {
            return;
        }
        failed.injected = self.planned[failed.node].at(failed.item);
        let warnings: Vec<_> = self.taps.iter().filter_map(|tap| tap.failed(&failed)).collect();
        self.warn(failed.node, failed.item, warnings);
    }

    pub(crate) fn warn(&self, node: usize, item: u64, messages: Vec<String>) {
        for message in messages {
            self.taps.iter().for_each(|tap| tap.warned(node, item, &message));
            let warning = Warning { node: self.plan.nodes[node].name.to_string(), item, message };
            self.event(&Event::Warned(&warning));
            locked(&self.messages).warning(node, warning);
        }
    }

    /// Runs `look` on the sending end of a link.
    fn with_send<T>(&self, index: usize, look: impl FnOnce(&SendEnd) -> T) -> Option<T> {
        let from = self.plan.links[index].from;
        let cell = locked(&self.cells[from.node]);
        cell.outputs[from.port].links.iter().find(|send| send.link == index).map(look)
    }

    /// Enlarges the smallest full link on which a producer is blocked, and returns that producer.
    fn enlarge_smallest(&self) -> Option<usize> {
        // A node takes what it sends to itself before it asks for room.
        let is_own = |link: &usize| self.plan.links[*link].from.node == self.plan.links[*link].to_node;
        let n_links = 0..self.links.len();
        let waited_for = n_links.filter(|link| self.links[*link].is_blocked() && !is_own(link));
        let growing = waited_for.filter_map(|index| {
            let state = &self.links[index];
            let grows = |send: &SendEnd| {
                let limits = &send.limits;
                let grows = send.fill() >= limits.capacity && send.bytes(state) < limits.max_bytes;
                grows.then_some(limits.capacity)
            };
            Some((self.with_send(index, grows)??, index))
        });
        let (before, index) = growing.min()?;
        let after = before.saturating_mul(2);
        let link = &self.plan.links[index];
        let (mut producer, mut consumer) = (locked(&self.cells[link.from.node]), locked(&self.cells[link.to_node]));
        let send = producer.outputs[link.from.port].links.iter_mut().find(|send| send.link == index)?;
        let recv = consumer.inputs.iter_mut().find(|input| input.recv.link == index)?;
        channel::enlarge(send, &mut recv.recv, after);
        let (from, to) = self.plan.link_names(&self.plan.links[index]);
        locked(&self.enlargements).push(Enlargement { from, to, before, after });
        Some(link.from.node)
    }

    /// Records why the run is stuck: the full links, and the empty links that their consumers wait for.
    fn note_stall(&self) {
        let open: Vec<usize> = (0..self.cells.len()).filter(|node| !locked(&self.cells[*node]).is_done()).collect();
        let Some(first) = open.first() else { return };
        let (mut full, mut empty, mut stuck) = (Vec::new(), Vec::new(), BTreeSet::new());
        for (index, link) in self.plan.links.iter().enumerate() {
            let state = &self.links[index];
            let look = |send: &SendEnd| (send.is_full(state), send.fill(), send.bytes(state));
            let Some((is_full, n_items, n_bytes)) = self.with_send(index, look) else { continue };
            let (from, to) = self.plan.link_names(&self.plan.links[index]);
            if is_full && state.is_blocked() {
                full.push(format!("{from} -> {to} ({n_items} items, {n_bytes} bytes)"));
                stuck.insert(link.to_node);
            } else if open.contains(&link.to_node) && open.contains(&link.from.node) && n_items == 0 {
                empty.push((link.to_node, format!("{from} -> {to}")));
            }
        }
        // First the links whose consumers do not empty the full ones.
        empty.sort_by_key(|(to_node, _)| !stuck.contains(to_node));
        let empty = empty.into_iter().map(|(_, link)| link).collect();
        let list = |links: Vec<String>| match links.len() {
            0 => "none".into(),
            n if n <= MAX_LINKS => links.join(", "),
            n => format!("{} and {} more", links[..MAX_LINKS].join(", "), n - MAX_LINKS),
        };
        let reason = format!(
            "the graph is stuck: nothing can run; full: {}; empty: {}; give the full links a larger max_bytes",
            list(full),
            list(empty)
        );
        let failure = Failure::error(*first, 0, reason);
        self.event(&Event::Failed(&refusal(self.plan, &failure)));
        *locked(&self.stall) = Some(failure);
    }
}

impl Work for Runtime<'_> {
    fn step(&self, node: usize, turn: &mut Turn<'_>) -> Stepped {
        let _stepping = self.stepping(node);
        let mut cell = locked(&self.cells[node]);
        if cell.is_live() {
            if cell.take_waits() {
                self.n_pending.fetch_add(1, Ordering::AcqRel);
                // The mailbox holds one such message per source, and a source is notified again only after it has
                // waited again.
                let _ = self.mailbox.tx.try_send(LiveMessage::Room(node));
            }
            return Stepped::Idle;
        }
        cell.step(self, turn)
    }

    fn is_pending(&self) -> bool {
        self.n_pending.load(Ordering::Acquire) > 0
    }

    fn is_cheap(&self, node: usize) -> bool {
        self.cheap[node].load(Ordering::Relaxed)
    }

    fn relieve(&self) -> Option<usize> {
        let producer = self.enlarge_smallest();
        if producer.is_none() {
            self.note_stall();
        }
        producer
    }
}

fn build(registry: &Registry, node: &PlanNode, seed: u64) -> Result<Built, BuildFault> {
    let fault = |error: ParamError| {
        // A parameter with its default is set nowhere.
        let place = error.paths().find_map(|path| node.param_places.get(path));
        BuildFault { node: node.name.to_string(), location: place.unwrap_or(&node.location).clone(), error }
    };
    let Some(kind) = registry.kind(&node.kind) else {
        return Err(fault(ParamError::new("", format!("there is no kind \"{}\" here", node.kind))));
    };
    let joins = node.inputs.iter().map(|input| input.port.join).collect();
    let build_context =
        BuildContext { node: node.name.clone(), seed, declared: node.declared.clone(), joins, place: node.place };
    let _under = activity::begin(Name::of(&node.name), Doing::Building, 0);
    match panics::catch(|| registry.build(kind, &node.params, &build_context)) {
        Ok(built) => built.map_err(fault),
        Err(panic) => Err(fault(ParamError::new("", panic))),
    }
}

/// The ports of a node, once for each link that feeds them; a port that is not wired has one lane without a link.
fn lanes(node: &PlanNode) -> impl Iterator<Item = (&PlanInput, Option<usize>)> {
    node.inputs.iter().flat_map(|input| {
        let unwired = input.links.is_empty().then_some((input, None));
        input.links.iter().map(move |link| (input, Some(*link))).chain(unwired)
    })
}

/// What is remembered of the live sources whose arrivals decide.
fn arrivals(cells: &mut [Mutex<Cell>], sources: &[Live]) -> Vec<Option<Answers>> {
    let mut decides = vec![false; cells.len()];
    for cell in cells.iter_mut().map(|cell| cell.get_mut().unwrap_or_else(PoisonError::into_inner)) {
        cell.contracts.iter().flat_map(|contracts| contracts.sources()).for_each(|source| decides[source] = true);
    }
    let live = |node: &usize| decides[*node] && sources.iter().any(|live| live.node == *node);
    (0..decides.len()).map(|node| live(&node).then(Answers::default)).collect()
}

fn joiner(plan: &Plan, node: &PlanNode) -> Joiner {
    let ports = lanes(node).map(|(input, link)| PortSpec {
        name: input.port.name,
        join: input.port.join,
        optional: input.port.optional,
        unused: input.port.unused,
        wire: link.map(|link| plan.wire_name(plan.links[link].from)),
        continues: link.is_some() && link != input.links.first().copied(),
    });
    Joiner::new(node.name.clone(), ports.collect())
}

/// Warning that an injected failure never happened.
fn missed_injection(injection: &Injection) -> Warning {
    let message = format!("{injection} was not injected: the node did not fire at item {}", injection.item);
    Warning { node: injection.node.clone(), item: injection.item, message }
}

fn link_stats(plan: &Plan, cells: &[Cell], index: usize, stuck: bool) -> Option<LinkStats> {
    let link = &plan.links[index];
    let send: &SendEnd = cells[link.from.node].outputs[link.from.port].links.iter().find(|s| s.link == index)?;
    let consumer = &cells[link.to_node];
    let input = consumer.inputs.iter().find(|input| input.recv.link == index)?;
    let recv: &RecvEnd = &input.recv;
    let (from, to) = plan.link_names(&plan.links[index]);
    Some(LinkStats {
        from,
        to,
        sent: send.sent,
        received: recv.received,
        // Items that still waited when a stuck graph was given up count as lost.
        dropped: if stuck { send.sent - recv.received } else { send.dropped },
        late: cells[link.from.node].outputs[link.from.port].n_late(),
        unmatched: consumer.unmatched(input.lane),
        highest_fill: send.highest_fill,
        capacity: send.limits.capacity,
    })
}

/// A failure with its node's name and position.
pub fn refusal(plan: &Plan, failure: &Failure) -> Refusal {
    let node = &plan.nodes[failure.node];
    Refusal {
        node: node.name.to_string(),
        kind: node.kind.clone(),
        item: Some(failure.item),
        location: node.location.clone(),
        reason: failure.reason.clone(),
        panicked: failure.panicked,
    }
}
