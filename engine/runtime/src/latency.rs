//! Latency from a source's answer to the end of a sink's firing, by the wall clock.
//!
//! A sink is a node whose outputs feed no node. A firing with stamp s is measured from the source's newest answer at or
//! before s, the last one that the firing can have waited for. Latency is a tap: it listens to firings and changes
//! nothing.

use crate::{
    histogram::{Histogram, Spread},
    plan::Plan,
    sync::locked,
    tap::Tap,
};
use osteoflow_node::{Role, StampNs};
use std::{collections::VecDeque, sync::Mutex, time::Duration};

/// Number of answers remembered per source; a sink that lags further behind is measured from the oldest of them.
const ANSWERS: usize = 1 << 16;

/// Latency from a source to a sink.
#[derive(Debug, Clone, PartialEq)]
pub struct LatencyStats {
    /// The source.
    pub source: String,
    /// The sink.
    pub sink: String,
    /// Number of firings of the sink.
    pub firings: u64,
    /// Distribution of the latencies.
    pub spread: Spread,
}

/// The newest answers of a source: their stamps and when they came, both ascending.
#[derive(Default)]
pub(crate) struct Answers(Mutex<VecDeque<(StampNs, Duration)>>);

impl Answers {
    pub(crate) fn note(&self, stamp_ns: StampNs, at: Duration) {
        let mut answers = locked(&self.0);
        // A late answer is no newer than the one before it.
        if answers.back().is_none_or(|(newest, _)| *newest <= stamp_ns) {
            if answers.len() == ANSWERS {
                answers.pop_front();
            }
            answers.push_back((stamp_ns, at));
        }
    }

    /// The newest answer at or before a stamp, or else the oldest that is remembered.
    pub(crate) fn before(&self, stamp_ns: StampNs) -> Option<(StampNs, Duration)> {
        let answers = locked(&self.0);
        let n_before = answers.partition_point(|(stamp, _)| *stamp <= stamp_ns);
        answers.get(n_before.saturating_sub(1)).copied()
    }
}

/// Tap that measures latencies.
pub struct Latency {
    /// Answers of each node that is a source.
    answers: Vec<Option<Answers>>,
    /// Sources upstream of each node that is a sink.
    sinks: Vec<Vec<(usize, Mutex<Histogram>)>>,
}

impl Latency {
    /// A tap for a run of the plan.
    pub fn new(plan: &Plan) -> Self {
        let answers = plan.nodes.iter().map(|node| (node.role != Role::Node).then(Answers::default)).collect();
        let is_sink = |index: usize| plan.nodes[index].outputs.iter().all(|output| output.links.is_empty());
        let sources = |index: usize| {
            let upstream = plan.upstream(index);
            (0..plan.nodes.len()).filter(move |node| upstream[*node] && plan.nodes[*node].role != Role::Node)
        };
        let of = |index: usize| match is_sink(index) && plan.nodes[index].role == Role::Node {
            true => sources(index).map(|source| (source, Mutex::default())).collect(),
            false => Vec::new(),
        };
        let sinks = (0..plan.nodes.len()).map(of).collect();
        Self { answers, sinks }
    }

    /// Every measured pair, in the order of the plan.
    pub fn stats(&self, plan: &Plan) -> Vec<LatencyStats> {
        let name = |node: usize| plan.nodes[node].name.to_string();
        let pairs = self.sinks.iter().enumerate().flat_map(|(sink, sources)| sources.iter().map(move |of| (sink, of)));
        let stats = pairs.map(|(sink, (source, times))| {
            let times = locked(times);
            LatencyStats { source: name(*source), sink: name(sink), firings: times.n(), spread: times.spread() }
        });
        stats.filter(|pair| pair.firings > 0).collect()
    }
}

impl Tap for Latency {
    fn times_firings(&self) -> bool {
        true
    }

    fn fired(&self, node: usize, _: u64, stamp_ns: StampNs, began: Duration, took: Duration) {
        let ended = began + took;
        if let Some(answers) = &self.answers[node] {
            answers.note(stamp_ns, ended);
        }
        for (source, times) in &self.sinks[node] {
            let Some((_, answered)) = self.answers[*source].as_ref().and_then(|answers| answers.before(stamp_ns))
            else {
                continue;
            };
            locked(times).count(1, ended.saturating_sub(answered).as_nanos() as u64);
        }
    }
}
