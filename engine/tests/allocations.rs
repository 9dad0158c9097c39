//! A hop does not allocate once every node has fired a few times. These tests install a counting allocator, so they have
//! their own binary.

#[allow(dead_code, reason = "the benches use the rest")]
#[path = "../benches/graph.rs"]
mod graph;

use graph::chain;
use osteoflow_engine::run::{Event, Observer, RunOptions, run};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, Registry, Value, schemars, serde,
};
use osteoflow_toy::stream::{Megabyte, registry};
use std::sync::Mutex;

const NODES: usize = 10;

/// Number of allocations of a run with `n_items` items.
fn allocations(registry: &Registry, source: &str, node: &str, n_items: u64) -> u64 {
    let plan = chain(registry, source, n_items, node, NODES, 0);
    let counted = allocation_counter::measure(|| {
        run(&plan, registry, &RunOptions::default(), &()).expect("the chain runs");
    });
    counted.count_total
}

/// Allocations per item through the whole chain, in a long run.
fn allocations_per_item(source: &str, node: &str) -> f64 {
    let registry = registry();
    // The first run of a process initializes shared state, such as the panic hook.
    allocations(&registry, source, node, 1);
    let (few, many) = (1_000, 5_000);
    let more = allocations(&registry, source, node, many) - allocations(&registry, source, node, few);
    more as f64 / (many - few) as f64
}

#[test]
fn passing_on_a_megabyte_does_not_allocate() {
    assert_eq!(allocations_per_item("bench.frames", "bench.relay"), 0.0);
}

#[test]
fn making_a_payload_allocates_one_handle() {
    // One per node, and one for the number of the source.
    assert_eq!(allocations_per_item("bench.frames", "bench.look"), 10.0);
    assert_eq!(allocations_per_item("bench.count", "bench.next"), 11.0);
}

/// Addresses of the bytes that a sink received.
static SEEN: Mutex<Vec<usize>> = Mutex::new(Vec::new());

/// Records the address of the bytes.
#[derive(Describe)]
struct Sink;

#[derive(Inputs)]
struct SinkIn {
    /// The megabyte.
    megabyte: Megabyte,
}

#[derive(Outputs)]
struct SinkOut {
    /// The input.
    out: Value,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
struct NoParams {
    items: u64,
}

impl Node for Sink {
    const KIND: &'static str = "test.sink";
    type Params = NoParams;
    type Inputs = SinkIn;
    type Outputs = SinkOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: SinkIn, _: &mut Context) -> Result<SinkOut, NodeError> {
        SEEN.lock().expect("no test panics with it").push(i.megabyte.bytes().as_ptr() as usize);
        Ok(SinkOut { out: Value::new(i.megabyte) })
    }
}

/// Counts firings.
#[derive(Default)]
struct Fired(Mutex<u64>);

impl Observer for Fired {
    fn event(&self, event: &Event<'_>) {
        if let Event::Fired { .. } = event {
            *self.0.lock().expect("no test panics with it") += 1;
        }
    }
}

#[test]
fn a_megabyte_is_the_same_bytes_at_the_sink_as_at_the_source() {
    let mut registry = registry();
    registry.node::<Sink>();
    for workers in [1, 2, 8] {
        SEEN.lock().expect("no test panics with it").clear();
        // Half of the nodes pass on the value, half take the payload out and make a new value.
        let mut nodes = vec![("bench.frames", serde_json::json!({ "items": 50 }), None)];
        nodes.push(("test.sink", serde_json::json!({}), Some(0)));
        for index in 1..=NODES {
            let kind = if index % 2 == 0 { "bench.relay" } else { "bench.look" };
            nodes.push((kind, serde_json::json!({}), Some(if index == 1 { 0 } else { index })));
        }
        nodes.push(("test.sink", serde_json::json!({}), Some(NODES + 1)));
        let plan = graph::plan(&registry, &nodes);
        let fired = Fired::default();
        let options = RunOptions { workers, ..RunOptions::default() };
        run(&plan, &registry, &options, &fired).expect("the graph runs");
        let seen = SEEN.lock().expect("no test panics with it").clone();
        // 50 items each at the sink next to the source and at the one after ten nodes, all with the same bytes.
        assert_eq!(seen.len(), 100);
        assert!(seen.iter().all(|at| *at == seen[0]), "on {workers} workers");
        assert_eq!(*fired.0.lock().expect("no test panics with it"), 50 * (nodes.len() as u64));
    }
}
