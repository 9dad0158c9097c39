//! How old values will be at a firing: predicted from a graph and the times of a run of it.
//!
//! A value's age at a firing has three parts: what the nodes before it take, what the firing waits for because of its other inputs,
//! and how far the value's stamp is behind the firing's. Each part is what 99 of 100 firings, or items, of the run stayed below,
//! so their sum is an estimate from above. It holds for a graph that keeps up and whose items come in the rhythm of the run; what
//! is computed once is left out.

use crate::{
    plan::{OutputId, Plan, PlanInput},
    recording::{Recording, RecordingError, codec},
    run::files,
};
use osteoflow_node::{Join, Role};
use serde_json::Value as Json;
use std::{collections::BTreeMap, fmt, path::Path};

/// What a run took: of each node, and between the items of each wire of a source.
#[derive(Debug, Default)]
pub struct Times {
    /// Duration of a firing, 99 of 100, and on average, ns, by node; none of one that never fired.
    firings: BTreeMap<String, (i64, f64)>,
    /// Gaps between items, 99 of 100, ns, by recorded wire; none where there was but one item.
    periods: BTreeMap<String, Option<i64>>,
}

/// An age or a duration as it will be.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    /// What it is about: an input or a result.
    pub on: String,
    /// The key of the contract that limits it, `max_age_ms` or `deadline_ms`, with where it is set as a path in the node's table;
    /// none for a result.
    pub contract: Option<(usize, String, &'static str)>,
    /// What the contract allows.
    pub limit_ns: Option<i64>,
    /// The prediction; none where it grows without bound, for which `parts` says why.
    pub ns: Option<i64>,
    /// What it is made of, the longest first.
    pub parts: Vec<(Part, i64)>,
}

/// A part of an age.
#[derive(Debug, Clone, PartialEq)]
pub enum Part {
    /// A firing of this node.
    Firing(String),
    /// What is waited for, or how far a stamp is behind.
    Wait(String),
    /// Why there is no bound.
    Unbounded(String),
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Firing(text) | Self::Wait(text) | Self::Unbounded(text) => f.write_str(text),
        }
    }
}

impl Predicted {
    /// Whether the contract can be kept.
    pub fn is_kept(&self) -> bool {
        self.limit_ns.is_none_or(|limit_ns| self.ns.is_some_and(|ns| ns <= limit_ns))
    }

    /// The part that breaks it: the slowest node if the firings alone take too long, else the longest part.
    pub fn breaks(&self) -> Option<&Part> {
        let firings = self.parts.iter().filter(|(part, _)| matches!(part, Part::Firing(_)));
        let take_too_long = firings.clone().map(|(_, ns)| ns).sum::<i64>() > self.limit_ns.unwrap_or(i64::MAX);
        let slowest = firings.max_by_key(|(_, ns)| *ns).filter(|_| take_too_long && self.ns.is_some());
        slowest.or(self.parts.first()).map(|(part, _)| part)
    }
}

/// A sum of parts.
#[derive(Debug, Clone, Default)]
struct Sum {
    ns: i64,
    parts: Vec<(Part, i64)>,
    /// Why there is no bound.
    unbounded: Option<String>,
}

impl Sum {
    fn and(self, wait: impl Into<String>, ns: i64) -> Self {
        self.with(Part::Wait(wait.into()), ns)
    }

    fn with(mut self, part: Part, ns: i64) -> Self {
        self.ns = self.ns.saturating_add(ns);
        if ns > 0 {
            self.parts.push((part, ns));
        }
        self
    }
}

impl Times {
    /// The times of a run, from its folder.
    ///
    /// # Errors
    /// The reason, if it has no manifest or no recording that can be read.
    pub fn of_run(folder: &Path) -> Result<Self, String> {
        let path = folder.join(files::MANIFEST);
        let text =
            std::fs::read_to_string(&path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
        let manifest: Json = serde_json::from_str(&text)
            .map_err(|error| format!("{} is no manifest of a run: {error}", path.display()))?;
        let mut firings = BTreeMap::new();
        for node in manifest["nodes"].as_array().into_iter().flatten() {
            let number = |key: &str| node[key].as_f64().unwrap_or(0.0);
            let n_firings = number("items") - number("skipped");
            if let Some(name) = node["name"].as_str().filter(|_| n_firings > 0.0) {
                let mean_ns = number("busy_ms") * 1e6 / n_firings;
                firings.insert(name.to_owned(), ((number("p99_ms") * 1e6) as i64, mean_ns));
            }
        }
        if firings.is_empty() {
            return Err(format!("{} has no times of nodes", path.display()));
        }
        let recording =
            Recording::open(&folder.join(files::RECORDING)).map_err(|error: RecordingError| error.to_string())?;
        let mut periods = BTreeMap::new();
        for (wire, recorded) in &recording.wires {
            let mut stamps: Vec<i64> = recorded
                .messages
                .iter()
                .filter_map(|bytes| Some(codec::head(bytes)?.stamp_ns))
                .filter(|ns| *ns != 0)
                .collect();
            stamps.dedup();
            let mut gaps: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
            gaps.sort_unstable();
            let gap = gaps.get((gaps.len() * 99 / 100).min(gaps.len().saturating_sub(1)));
            periods.insert(wire.clone(), gap.copied());
        }
        Ok(Self { firings, periods })
    }

    /// The ages at inputs with a contract and at the results, and the durations with a deadline.
    pub fn predict(&self, plan: &Plan) -> Vec<Predicted> {
        let ages = Ages::of(plan, self);
        let mut all = Vec::new();
        for (index, node) in plan.nodes.iter().enumerate() {
            for input in &node.inputs {
                let (Some(limit_ns), false) = (input.contract.max_age_ns, input.links.is_empty()) else { continue };
                let on = format!("{}.{}", node.name, input.port.name);
                let contract = (index, format!("in.{}.max_age_ms", input.port.name), "max_age_ms");
                all.push(predicted(on, ages.at(index, input), Some((contract, limit_ns))));
            }
            if let Some(deadline) = node.deadline {
                let sum = match self.firings.get(&*node.name) {
                    Some((ns, _)) => Sum::default().with(Part::Firing(node.name.to_string()), *ns),
                    None => {
                        Sum { unbounded: Some(format!("the run has no firing of {}", node.name)), ..Sum::default() }
                    }
                };
                let contract = (index, "deadline_ms".to_owned(), "deadline_ms");
                all.push(predicted(node.name.to_string(), sum, Some((contract, deadline.ns))));
            }
        }
        let results = plan.results.iter().filter(|entry| ages.period(entry.from).is_some());
        all.extend(
            results.map(|entry| predicted(format!("result {}", entry.key), ages.delay(entry.from).clone(), None)),
        );
        all
    }
}

fn predicted(on: String, sum: Sum, limit: Option<((usize, String, &'static str), i64)>) -> Predicted {
    let Sum { ns, mut parts, unbounded } = sum;
    parts.sort_by_key(|(_, ns)| std::cmp::Reverse(*ns));
    let ns = if unbounded.is_none() { Some(ns) } else { None };
    parts.splice(..0, unbounded.map(|why| (Part::Unbounded(why), 0)));
    let (contract, limit_ns) = limit.unzip();
    Predicted { on, contract, limit_ns, ns, parts }
}

/// Time between two items of an output of a source, and why it is not known where something takes them.
fn source(plan: &Plan, times: &Times, id: OutputId) -> (Option<i64>, Option<String>) {
    let wire = plan.wire_name(id);
    let contracts = plan.consumers(id).map(|link| plan.nodes[link.to_node].inputs[link.to_port].contract);
    let expected = contracts.filter_map(|contract| contract.period_ns).min();
    match times.periods.get(&wire) {
        Some(period) => (period.or(expected), None),
        None if expected.is_some() || plan.consumers(id).next().is_none() => (expected, None),
        // As if it came all the time, so that what it leads to says so.
        None => (Some(0), Some(format!("the run recorded no item of {wire}"))),
    }
}

/// The rhythm and the delay of every node.
struct Ages<'a> {
    plan: &'a Plan,
    /// Time between two items of each node's outputs; none where there is but one.
    periods: Vec<Vec<Option<i64>>>,
    /// From the coming of the newest item that made a firing's stamp to its answer.
    delays: Vec<Sum>,
}

impl<'a> Ages<'a> {
    fn of(plan: &'a Plan, times: &Times) -> Self {
        let mut ages = Self { plan, periods: Vec::new(), delays: Vec::new() };
        for (index, node) in plan.nodes.iter().enumerate() {
            if node.role != Role::Node {
                let (periods, unknown): (Vec<_>, Vec<_>) =
                    plan.outputs(index).map(|id| source(plan, times, id)).unzip();
                ages.periods.push(periods);
                ages.delays.push(Sum { unbounded: unknown.into_iter().flatten().next(), ..Sum::default() });
                continue;
            }
            let period = ages.firing_period(index);
            ages.periods.push(vec![period; node.outputs.len()]);
            let mut delay = ages.before(index);
            match times.firings.get(&*node.name) {
                Some((ns, mean_ns)) => {
                    delay = delay.with(Part::Firing(node.name.to_string()), *ns);
                    if let Some(period) = period.filter(|period| *mean_ns > *period as f64) {
                        let (takes, comes) = (mean_ns / 1e6, period as f64 / 1e6);
                        let why = format!("{} takes {takes:.1} ms, and the next comes after {comes:.1} ms", node.name);
                        delay.unbounded.get_or_insert(why);
                    }
                }
                None => drop(delay.unbounded.get_or_insert_with(|| format!("the run has no firing of {}", node.name))),
            }
            ages.delays.push(delay);
        }
        ages
    }

    fn period(&self, id: OutputId) -> Option<i64> {
        *self.periods.get(id.node)?.get(id.port)?
    }

    /// Of a link that leads back, nothing is known yet, and nothing is waited for.
    fn delay(&self, id: OutputId) -> &Sum {
        const NONE: &Sum = &Sum { ns: 0, parts: Vec::new(), unbounded: None };
        self.delays.get(id.node).unwrap_or(NONE)
    }

    fn wires(&self, input: &PlanInput) -> impl Iterator<Item = OutputId> {
        input.links.iter().map(|link| self.plan.links[*link].from)
    }

    /// Time between two firings: that of the slowest trigger.
    fn firing_period(&self, index: usize) -> Option<i64> {
        let triggers = self.plan.nodes[index].inputs.iter().filter(|input| input.port.join.triggers());
        let period = |input: &PlanInput| {
            let period = self.wires(input).filter_map(|wire| self.period(wire)).max()?;
            match input.port.join {
                Join::Collect { n: None } => None,
                Join::Collect { n: Some(n) } | Join::CollectEvery { step: n, .. } => {
                    Some(period.saturating_mul(n.into()))
                }
                Join::CollectSpan { step_ns, .. } => Some(step_ns),
                _ => Some(period),
            }
        };
        triggers.filter_map(period).max()
    }

    /// From the coming of the newest item to the firing: the longest way through its inputs.
    fn before(&self, index: usize) -> Sum {
        let inputs = self.plan.nodes[index].inputs.iter().filter(|input| !input.port.unused);
        let ways = inputs.flat_map(|input| self.wires(input).filter_map(move |wire| self.way(input, wire)));
        ways.max_by_key(|way| (way.unbounded.is_some(), way.ns)).unwrap_or_default()
    }

    /// What a firing waits for at one of its wires; nothing for what comes once.
    fn way(&self, input: &PlanInput, wire: OutputId) -> Option<Sum> {
        self.period(wire)?;
        let delay = self.delay(wire).clone();
        match input.port.join {
            Join::Once | Join::Previous => None,
            // Whether a newer one comes is known with the next item of its source.
            Join::Latest | Join::LatestAfter { .. } | Join::Interpolate { .. } => {
                let after_ns = if let Join::LatestAfter { after_ns } = input.port.join { after_ns } else { 0 };
                let sources = self.plan.upstream(wire.node);
                let sources =
                    (0..sources.len()).filter(|node| sources[*node] && self.plan.nodes[*node].role != Role::Node);
                let next = sources.filter_map(|node| self.periods.get(node)?.iter().flatten().min()).max();
                let from = self.plan.wire_name(wire);
                Some(
                    delay.and(
                        format!("waits for the next of {from}"),
                        next.copied().unwrap_or(0).saturating_add(after_ns),
                    ),
                )
            }
            _ => Some(delay),
        }
    }

    /// Age at a firing of what an input brings.
    fn at(&self, index: usize, input: &PlanInput) -> Sum {
        let mut sum = self.before(index);
        let Some((wire, period)) =
            self.wires(input).filter_map(|wire| Some((wire, self.period(wire)?))).max_by_key(|(_, p)| *p)
        else {
            sum.unbounded = Some("it comes once, and grows as old as the run is long".into());
            return sum;
        };
        let from = self.plan.wire_name(wire);
        match input.port.join {
            Join::Latest | Join::LatestAfter { .. } => sum.and(format!("the newest of {from} is from before"), period),
            Join::Previous => sum.and("from the firing before", self.firing_period(index).unwrap_or(0)),
            Join::Stamp { tolerance_ns } => sum.and(format!("tolerance of {from}"), tolerance_ns),
            Join::Collect { n: Some(n) } | Join::CollectEvery { n, .. } => {
                sum.and(format!("the first of {n} items of {from}"), period.saturating_mul(i64::from(n) - 1))
            }
            Join::CollectSpan { span_ns, .. } => sum.and(format!("the window of {from}"), span_ns),
            _ => sum,
        }
    }
}
