//! Cost of a hop on one worker in processor time, which other programs disturb less than wall time. Prints nanoseconds per
//! hop of the fastest of many runs.
//!
//! `hop_cpu once KIND NODES` runs the chain once, for a tool that counts instructions: the difference of two numbers of nodes is theirs.

#[path = "../tests/plugins/build.rs"]
mod build;
#[allow(dead_code, reason = "the other benches use the rest")]
mod graph;

use graph::chain;
use osteoflow_engine::{
    plugin::{Library, provide},
    run::{RunOptions, run},
};
use osteoflow_node::Registry;
use osteoflow_toy::stream::{registry, sources};
use rustix::time::{ClockId, clock_gettime};
use std::path::Path;

const ITEMS: u64 = 20_000;
const HOPS: usize = 8;
const RUNS: usize = 60;

/// Processor time of this thread, ns.
fn thread_time() -> i64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

/// Cost of a hop through nodes of this kind, ns.
fn per_hop(registry: &Registry, kind: &str) -> f64 {
    let fastest = |n_nodes| {
        let plan = chain(registry, "bench.count", ITEMS, kind, n_nodes, 0);
        let one = || {
            let began = thread_time();
            run(&plan, registry, &RunOptions::default(), &()).expect("the chain runs");
            thread_time() - began
        };
        (0..RUNS).map(|_| one()).min().expect("there are runs")
    };
    let (few, many) = (fastest(1), fastest(1 + HOPS));
    (many - few) as f64 / (ITEMS * HOPS as u64) as f64
}

/// The sources, with the nodes of a library.
fn loaded(library: &Path) -> Registry {
    let mut registry = sources();
    let library: &'static Library = Box::leak(Box::new(Library::load(library).expect("the library is a plugin")));
    provide(&mut registry, library.description(), &"0".into(), move || Ok(library)).expect("its kinds are new");
    registry
}

fn main() {
    let args: Vec<_> = std::env::args().skip(1).collect();
    if let ["once", kind, n_nodes] = args.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        let n_nodes = n_nodes.parse().expect("a number of nodes");
        let registry = registry();
        let plan = chain(&registry, "bench.count", ITEMS, kind, n_nodes, 0);
        run(&plan, &registry, &RunOptions::default(), &()).expect("the chain runs");
        return;
    }
    let c = Path::new(env!("CARGO_TARGET_TMPDIR")).join("librelay_timed.so");
    let mut plugins = vec![("Rust", loaded(&build::example("plugin_relay")))];
    if build::compile(Path::new("engine/tests/plugins/c/relay.c"), &c, &[]) {
        plugins.push(("C", loaded(&c)));
    }
    let built_in = registry();
    for (kind, what) in [("bench.relay", "passed on"), ("bench.next", "new payload")] {
        let built_in_ns = per_hop(&built_in, kind);
        println!("{what}: {built_in_ns:.1} ns per hop");
        for (language, registry) in &plugins {
            let plugin_ns = per_hop(registry, kind);
            println!("{what}, plugin in {language}: {plugin_ns:.1} ns per hop, {:.1} more", plugin_ns - built_in_ns);
        }
    }
}
