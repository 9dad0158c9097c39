//! What a hop costs on one worker in processor time, which other programs on the machine disturb less than a clock on
//! the wall. Prints nanoseconds per hop, the fastest of many runs.

#[path = "../tests/plugins/build.rs"]
mod build;
#[allow(dead_code, reason = "the other benches use the rest")]
mod graph;

use graph::{chain, registry};
use osteoflow_engine::{
    plan::Plan,
    plugin::{Library, provide},
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
    let mut registry = registry();
    for path in build::c_library("relay").into_iter().chain([build::rust_library("plugin_relay")]) {
        let library: &'static Library = Box::leak(Box::new(Library::load(&path).expect("the library is a plugin")));
        provide(&mut registry, library.about(), &"0".into(), move || Ok(library)).expect("its kinds are new");
    }
    let fastest = |plan: &Plan| {
        let one = || {
            let began = thread_time();
            run(plan, &registry, &RunOptions::default(), &()).expect("the chain runs");
            thread_time() - began
        };
        (0..RUNS).map(|_| one()).min().expect("there are runs")
    };
    let plan = |kind: &str, n_nodes| chain(&registry, "bench.count", ITEMS, kind, n_nodes, 0);
    let per_hop = |kind: &str| {
        let (few, many) = (fastest(&plan(kind, 1)), fastest(&plan(kind, 1 + HOPS)));
        (many - few) as f64 / (ITEMS * HOPS as u64) as f64
    };
    for (node, what) in [("relay", "handed on"), ("next", "made anew")] {
        let built_in = per_hop(&format!("bench.{node}"));
        println!("{what}: {built_in:.1} ns per hop");
        for language in ["c", "rust"] {
            let kind = format!("{language}.{node}");
            if registry.kind(&kind).is_some() {
                let plugin = per_hop(&kind);
                println!("{what} by a plugin ({language}): {plugin:.1} ns per hop, {:.1} more", plugin - built_in);
            }
        }
    }
}
