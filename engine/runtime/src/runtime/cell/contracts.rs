//! Contracts of time: how old a value may be at a firing, how long a firing may take, how long a wire may be silent.
//!
//! What follows from the stamps alone is the same in every run. What follows from the clock is recorded as a reading of the
//! firing, or as an empty on the wire of a live source, so that a replay decides the same.

use super::{Cell, Core, Phase, source_clock::nanoseconds};
use crate::{
    histogram::Histogram,
    plan::{Contract, Deadline, Otherwise, OutputId, Plan, PlanInput},
    report::{ContractKind, ContractStats, Event, Failure, Warning},
    runtime::Runtime,
    scheduler::Turn,
};
use osteoflow_node::{Body, ClockReading, Emission, Empty, Item, Role, Slot, StampNs};
use std::{sync::Arc, time::Duration};

/// The contracts of a node's inputs and firings, and how they were kept.
pub(crate) struct Contracts {
    ages: Vec<Age>,
    deadline: Option<(Deadline, Kept)>,
    /// When the current firing began.
    began: Duration,
    /// Readings of the clock that broke a contract of the current activation.
    readings: Vec<ClockReading>,
}

/// The maximum age of an input's values.
struct Age {
    /// The place of the port among the inputs, and of its slot.
    port: usize,
    name: &'static str,
    /// Whether the node fires without a value.
    optional: bool,
    max_ns: StampNs,
    otherwise: Otherwise,
    /// The live sources that its wires come from.
    sources: Vec<usize>,
    kept: Kept,
}

/// How a contract was kept.
#[derive(Default)]
struct Kept {
    times: Histogram,
    n_broken: u64,
    /// The first activation or item that broke it.
    first: Option<u64>,
}

impl Kept {
    /// Counts a time; whether it is the first that breaks the contract.
    fn count(&mut self, ns: StampNs, is_broken: bool, item: u64) -> bool {
        self.times.count(1, ns.max(0).unsigned_abs());
        self.n_broken += u64::from(is_broken);
        is_broken && self.first.replace(self.first.unwrap_or(item)).is_none()
    }

    fn stats(&self, plan: &Plan, node: usize, on: String, kind: ContractKind, limit_ns: StampNs) -> ContractStats {
        let node = plan.nodes[node].name.to_string();
        let (n, spread) = (self.times.n(), self.times.spread());
        ContractStats { node, on, kind, limit_ns, n, n_broken: self.n_broken, first: self.first, spread }
    }
}

impl Contracts {
    /// `None` if the node has none, which is what a firing asks first.
    pub(crate) fn of(plan: &Plan, index: usize) -> Option<Box<Self>> {
        let node = &plan.nodes[index];
        let age = |(port, input): (usize, &PlanInput)| {
            let max_ns = input.contract.max_age_ns?;
            let is_live = |node: &usize| plan.nodes[*node].role == Role::LiveSource;
            let mut sources: Vec<_> = input
                .links
                .iter()
                .flat_map(|link| {
                    let upstream = plan.upstream(plan.links[*link].from.node);
                    (0..plan.nodes.len()).filter(move |node| upstream[*node]).filter(is_live)
                })
                .collect();
            sources.sort_unstable();
            sources.dedup();
            let (name, optional) = (input.port.name, input.port.optional);
            let (otherwise, kept) = (input.contract.otherwise, Kept::default());
            Some(Age { port, name, optional, max_ns, otherwise, sources, kept })
        };
        let ages: Vec<_> = node.inputs.iter().enumerate().filter_map(age).collect();
        let deadline = node.deadline.map(|deadline| (deadline, Kept::default()));
        (!ages.is_empty() || deadline.is_some())
            .then(|| Box::new(Self { ages, deadline, began: Duration::ZERO, readings: Vec::new() }))
    }

    /// The live sources whose answers are to be remembered.
    pub(crate) fn sources(&self) -> impl Iterator<Item = usize> + '_ {
        self.ages.iter().flat_map(|age| age.sources.iter().copied())
    }

    pub(crate) fn has_deadline(&self) -> bool {
        self.deadline.is_some()
    }
}

/// Age of what a port brings to a firing: of several items, of the oldest. A constant, with the stamp 0, has no time.
fn oldest(slot: &Slot) -> Option<&Item> {
    let items = slot.items().iter().filter(|item| item.stamp_ns != 0 && item.body.value().is_some());
    items.min_by_key(|item| item.stamp_ns)
}

impl Cell {
    /// Takes away values that are too old; why the activation is left out, if it is.
    pub(super) fn too_old(&mut self, item: u64, stamp_ns: StampNs, run: &Runtime<'_>) -> Option<Arc<Empty>> {
        let (Some(contracts), Core::Node(_, joiner)) = (&mut self.contracts, &mut self.core) else { return None };
        let recorded = run.recorded_readings(self.index, item);
        let mut left_out = None;
        for age in &mut contracts.ages {
            let Some(oldest) = oldest(&joiner.joined().slots[age.port]) else { continue };
            let by_stamp = stamp_ns.saturating_sub(oldest.stamp_ns);
            let by_arrival = match recorded {
                Some(readings) => readings.iter().find_map(|reading| match reading {
                    ClockReading::Stale { port, ns } if *port as usize == age.port => Some(*ns),
                    _ => None,
                }),
                None => run.age_by_arrival(&age.sources, oldest.stamp_ns),
            };
            let ns = by_arrival.map_or(by_stamp, |ns| ns.max(by_stamp));
            let is_broken = ns > age.max_ns;
            let is_first = age.kept.count(ns, is_broken, item);
            if !is_broken {
                continue;
            }
            let allowed = span(age.max_ns);
            let reason = if by_stamp > age.max_ns {
                format!(
                    "input \"{}\": its value is {} older than the firing, {allowed} allowed",
                    age.name,
                    span(by_stamp)
                )
            } else {
                contracts.readings.push(ClockReading::Stale { port: age.port as u32, ns });
                format!("input \"{}\": its value came {} ago, {allowed} allowed", age.name, span(ns))
            };
            if is_first && age.otherwise == Otherwise::Refuse {
                run.fail(Failure::of_contract(self.index, item, &reason));
            }
            let empty = Arc::new(Empty { node: self.context.node().to_owned(), reason });
            if !age.optional || age.otherwise == Otherwise::Drop {
                left_out.get_or_insert_with(|| empty.clone());
            }
            joiner.make_absent(age.port, age.name, empty);
        }
        if left_out.is_some() {
            joiner.leave_out();
            run.readings_to_taps(self.index, item, &std::mem::take(&mut contracts.readings));
        }
        left_out
    }

    /// The firing begins: its deadline counts from now.
    pub(super) fn begin_deadline(&mut self, run: &Runtime<'_>) {
        if let Some(contracts) = self.contracts.as_mut().filter(|contracts| contracts.has_deadline()) {
            contracts.began = run.now();
        }
    }

    /// Empties the answer of a firing that took too long.
    pub(super) fn keep_deadline(&mut self, item: u64, run: &Runtime<'_>) {
        let Some(contracts) = &mut self.contracts else { return };
        let Some((deadline, kept)) = &mut contracts.deadline else { return };
        let took = match run.recorded_readings(self.index, item) {
            Some(readings) => readings.iter().find_map(|reading| match reading {
                ClockReading::Late { ns } => Some(*ns),
                _ => None,
            }),
            None => Some(nanoseconds(run.now().saturating_sub(contracts.began))),
        };
        let took = took.unwrap_or(0);
        let is_late = took > deadline.ns;
        let is_first = kept.count(took, is_late, item);
        if !is_late {
            return;
        }
        contracts.readings.push(ClockReading::Late { ns: took });
        let reason = format!("the firing took {}, {} allowed", span(took), span(deadline.ns));
        if is_first && deadline.otherwise == Otherwise::Refuse {
            run.fail(Failure::of_contract(self.index, item, &reason));
        }
        let given = self.emissions.iter_mut().filter(|emission| matches!(emission, Emission::Value(_)));
        given.for_each(|emission| *emission = Emission::Empty(reason.clone()));
    }

    /// The readings of the clock that broke a contract of this firing.
    pub(super) fn take_broken(&mut self) -> Vec<ClockReading> {
        self.contracts.as_mut().map(|contracts| std::mem::take(&mut contracts.readings)).unwrap_or_default()
    }

    /// Interval at which it is looked whether a wire is silent, if a contract limits that: a quarter of what is allowed.
    pub(crate) fn look_every(&self) -> Option<Duration> {
        let allowed = self.outputs.iter().filter_map(|output| output.silence.as_ref()).map(|silence| silence.max_ns);
        let quarter = allowed.min()?.unsigned_abs() / 4;
        Some(Duration::from_nanos(quarter).max(Duration::from_millis(1)))
    }

    /// Says on the wires of a live source that they are silent, where a contract limits that.
    pub(crate) fn note_silence(&mut self, run: &Runtime<'_>, turn: &mut Turn<'_>) {
        let Core::Live(live) = &self.core else { return };
        // A source that waits for room is not silent.
        let Some(since) = live.asked_since().filter(|_| matches!(self.phase, Phase::Open)) else { return };
        if !self.has_room(run) {
            return;
        }
        let now = run.now();
        for output in &mut self.outputs {
            let Some(silence) = &output.silence else { continue };
            let Some((stamp_ns, limit_ns)) = silence.silent(now, since) else { continue };
            let stamp_ns = stamp_ns.max(output.floor);
            let Some(limit_ns) = limit_ns else {
                // Firings that other sources trigger do not wait for a silent one.
                output.promise(stamp_ns, run, turn);
                continue;
            };
            let reason = format!("nothing came for {}", span(limit_ns));
            let empty = Arc::new(Empty { node: self.context.node().to_owned(), reason: reason.clone() });
            let (node, item) = (self.context.node().to_owned(), output.n_items());
            let _ = output.send(stamp_ns, Body::Empty(empty), run, turn);
            let message = format!("{}: {reason}; what depends on it is unknown", run.plan.wire_name(output.id));
            run.event(&Event::Urgent(&Warning { node, item, message }));
        }
    }

    /// How the contracts of the node, and of its wires, were kept.
    pub(crate) fn contract_stats(&self, plan: &Plan) -> Vec<ContractStats> {
        let mut all = Vec::new();
        if let Some(Contracts { ages, deadline, .. }) = self.contracts.as_deref() {
            let on = |age: &Age| format!("{}.{}", plan.nodes[self.index].name, age.name);
            all.extend(ages.iter().map(|a| a.kept.stats(plan, self.index, on(a), ContractKind::MaxAge, a.max_ns)));
            all.extend(deadline.iter().map(|(deadline, kept)| {
                let on = plan.nodes[self.index].name.to_string();
                kept.stats(plan, self.index, on, ContractKind::Deadline, deadline.ns)
            }));
        }
        let silences = self.outputs.iter().filter_map(|output| Some((output.id, output.silence.as_deref()?)));
        all.extend(silences.filter_map(|(id, silence)| {
            let (on, kind) = (plan.wire_name(id), ContractKind::Silence);
            Some(silence.kept.stats(plan, self.index, on, kind, silence.rate_ns?))
        }));
        all
    }
}

/// The longest silence of a wire that its consumers allow.
pub(crate) struct Silence {
    /// After which the wire is unknown: by a maximum age, or a rate.
    max_ns: StampNs,
    /// After which a rate is broken. A maximum age is broken by values, not by their absence.
    rate_ns: Option<StampNs>,
    /// After which the run is refused.
    refuse_ns: Option<StampNs>,
    /// Stamp of the last item that does not say that the wire is silent, and when it came.
    last: Option<(StampNs, Duration)>,
    /// The silence that an empty has said since.
    said_ns: StampNs,
    kept: Kept,
}

impl Silence {
    /// Of an output of a source, by the contracts of its consumers.
    pub(crate) fn of(plan: &Plan, id: OutputId) -> Option<Box<Self>> {
        let is_source = plan.nodes[id.node].role != Role::Node;
        let contracts = plan.consumers(id).map(|link| plan.nodes[link.to_node].inputs[link.to_port].contract);
        let contracts: Vec<_> = contracts.filter(|_| is_source).collect();
        let max_ns = contracts.iter().filter_map(Contract::silence_ns).min()?;
        let of_rates =
            |is: fn(&&Contract) -> bool| contracts.iter().filter(is).filter_map(Contract::rate_silence_ns).min();
        let rate_ns = of_rates(|_| true);
        let refuse_ns = of_rates(|contract| contract.otherwise == Otherwise::Refuse);
        Some(Box::new(Self { max_ns, rate_ns, refuse_ns, last: None, said_ns: 0, kept: Kept::default() }))
    }

    /// The next limit that no empty has said yet.
    fn next_limit(&self) -> Option<StampNs> {
        let limits = [Some(self.max_ns), self.rate_ns, self.refuse_ns].into_iter().flatten();
        limits.filter(|ns| *ns > self.said_ns).min()
    }

    /// Notes an item; the reason to refuse the run, if there is one. By stamps alone, so that a replay finds the same: an
    /// empty that comes when the silence has passed a limit says so, any other item ends it.
    #[cold]
    pub(super) fn note(&mut self, item: &Item, now: Duration) -> Option<String> {
        let gap_ns = self.last.map_or(0, |(ns, _)| item.stamp_ns.saturating_sub(ns));
        let passes = |limit: Option<StampNs>| limit.is_some_and(|ns| gap_ns >= ns && self.said_ns < ns);
        let (is_broken, is_refused) = (passes(self.rate_ns), passes(self.refuse_ns));
        let says_so = item.body.value().is_none() && passes(self.next_limit());
        self.kept.count(gap_ns, is_broken, item.number);
        (self.last, self.said_ns) = if says_so { (self.last, gap_ns) } else { (Some((item.stamp_ns, now)), 0) };
        is_refused.then(|| {
            // Once.
            self.refuse_ns = None;
            format!("nothing came for {}", span(gap_ns))
        })
    }

    /// The stamp of now on a wire that is silent for too long, and the limit that no empty has said yet.
    fn silent(&self, now: Duration, asked_since: Duration) -> Option<(StampNs, Option<StampNs>)> {
        let (stamp_ns, at) = self.last?;
        let silent_ns = nanoseconds(now.saturating_sub(at.max(asked_since)));
        let limit_ns = self.next_limit().filter(|ns| silent_ns >= *ns);
        let is_silent = limit_ns.is_some() || self.said_ns > 0;
        is_silent.then(|| (stamp_ns.saturating_add(limit_ns.unwrap_or(silent_ns)), limit_ns))
    }
}

fn span(ns: StampNs) -> String {
    crate::join::span(ns.into())
}
