//! Loads and runs plugins built for these tests: in C by the system compiler, in Rust as examples of this crate.

pub(crate) mod build;
#[path = "../benches/graph.rs"]
#[allow(dead_code, reason = "the benches use the rest")]
mod graph;

use graph::chain;
use osteoflow_engine::{
    plan::ResultEntry,
    plugin::{Library, provide},
    run::{Outcome, RunOptions, run},
};
use osteoflow_node::Registry;
use osteoflow_toy::stream::{registry, sources};
use std::path::Path;

/// The sources of [`osteoflow_toy::stream`], with the nodes of a library.
fn with_library(path: &Path) -> Registry {
    let mut registry = sources();
    let library: &'static Library = Box::leak(Box::new(Library::load(path).expect("the library is a plugin")));
    provide(&mut registry, library.description(), &"0".into(), move || Ok(library)).expect("its kinds are new");
    registry
}

/// Output of the last of three nodes in a row for the numbers 1 to 5.
fn last_number(registry: &Registry, kind: &str) -> serde_json::Value {
    let mut plan = chain(registry, "bench.count", 5, kind, 3, 0);
    plan.results = vec![ResultEntry {
        key: "numbers".into(),
        from: osteoflow_engine::plan::OutputId { node: 3, port: 0 },
        all: true,
        optional: false,
        location: plan.nodes[0].location.clone(),
    }];
    let report = run(&plan, registry, &RunOptions::default(), &()).expect("the chain runs");
    assert_eq!(report.outcome, Outcome::Complete, "{:?}", report.results);
    report.results["numbers"].clone()
}

fn assert_answers_as_built_in(library: &Path) {
    let (built_in, loaded) = (registry(), with_library(library));
    for kind in ["bench.next", "bench.relay"] {
        assert_eq!(last_number(&loaded, kind), last_number(&built_in, kind), "{kind}");
    }
}

#[test]
fn nodes_of_a_plugin_in_rust_answer_as_built_in_ones() {
    assert_answers_as_built_in(&build::example("plugin_relay"));
}

#[test]
fn nodes_of_a_plugin_in_c_answer_as_built_in_ones() {
    let library = Path::new(env!("CARGO_TARGET_TMPDIR")).join("librelay_tested.so");
    if build::compile(Path::new("engine/tests/plugins/c/relay.c"), &library, &[]) {
        assert_answers_as_built_in(&library);
    }
}
