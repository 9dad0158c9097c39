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
use std::{collections::BTreeMap, path::Path};

/// What a run took: of each node, and between the items of each wire of a source.
#[derive(Debug, Default)]
pub struct Times {
    /// Duration of a firing, 99 of 100, and on average, ns, by node.
    firings: BTreeMap<String, (i64, f64)>,
    /// Gaps between items, 99 of 100, ns, by wire.
    periods: BTreeMap<String, i64>,
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
    pub parts: Vec<(String, i64)>,
}

impl Predicted {
    /// Whether the contract can be kept.
    pub fn is_kept(&self) -> bool {
        self.limit_ns.is_none_or(|limit_ns| self.ns.is_some_and(|ns| ns <= limit_ns))
    }
}

/// A sum of parts.
#[derive(Debug, Clone, Default)]
struct Sum {
    ns: i64,
    parts: Vec<(String, i64)>,
    /// Why there is no bound.
    unbounded: Option<String>,
}

impl Sum {
    fn and(mut self, what: impl Into<String>, ns: i64) -> Self {
        self.ns = self.ns.saturating_add(ns);
        if ns > 0 {
            self.parts.push((what.into(), ns));
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
            if let Some(name) = node["name"].as_str() {
                let mean_ns = number("busy_ms") * 1e6 / number("items").max(1.0);
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
            if let Some(gap) = gaps.get((gaps.len() * 99 / 100).min(gaps.len().saturating_sub(1))) {
                periods.insert(wire.clone(), *gap);
            }
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
            if let (Some(deadline), Some((ns, _))) = (node.deadline, self.firings.get(&*node.name)) {
                let sum = Sum::default().and(node.name.to_string(), *ns);
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
    parts.splice(..0, unbounded.map(|why| (why, 0)));
    let (contract, limit_ns) = limit.unzip();
    Predicted { on, contract, limit_ns, ns, parts }
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
                let period = |id: OutputId| {
                    let asked = plan
                        .consumers(id)
                        .filter_map(|link| plan.nodes[link.to_node].inputs[link.to_port].contract.period_ns);
                    times.periods.get(&plan.wire_name(id)).copied().or(asked.min())
                };
                ages.periods.push(plan.outputs(index).map(period).collect());
                ages.delays.push(Sum::default());
                continue;
            }
            let period = ages.firing_period(index);
            ages.periods.push(vec![period; node.outputs.len()]);
            let (ns, mean_ns) = times.firings.get(&*node.name).copied().unwrap_or_default();
            let mut delay = ages.before(index).and(node.name.to_string(), ns);
            if let Some(period) = period.filter(|period| mean_ns > *period as f64) {
                let (takes, comes) = (mean_ns / 1e6, period as f64 / 1e6);
                delay.unbounded =
                    Some(format!("{} takes {takes:.1} ms, and the next comes after {comes:.1} ms", node.name));
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
