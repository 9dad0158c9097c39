//! What a hop costs on one worker in processor time, which other programs on the machine disturb less than a clock on
//! the wall. Prints nanoseconds per hop, the fastest of many runs.

#[allow(dead_code, reason = "the other benches use the rest")]
mod graph;

use graph::{chain, registry};
use osteoflow_engine::{
    plan::Plan,
    run::{RunOptions, run},
};
use rustix::time::{ClockId, clock_gettime};

const ITEMS: u64 = 20_000;
const HOPS: usize = 8;
const RUNS: usize = 60;

/// Processor time of this thread, ns.
fn thread_time() -> i64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

fn main() {
    let registry = registry();
    let fastest = |plan: &Plan| {
        let one = || {
            let began = thread_time();
            run(plan, &registry, &RunOptions::default(), &()).expect("the chain runs");
            thread_time() - began
        };
        (0..RUNS).map(|_| one()).min().expect("there are runs")
    };
    for (kind, what) in [("bench.relay", "handed on"), ("bench.next", "made anew")] {
        let plan = |n_relays| chain(&registry, "bench.count", ITEMS, kind, n_relays, 0);
        let (few, many) = (fastest(&plan(1)), fastest(&plan(1 + HOPS)));
        let per_hop = (many - few) as f64 / (ITEMS * HOPS as u64) as f64;
        println!("{what}: {per_hop:.1} ns per hop");
    }
}
