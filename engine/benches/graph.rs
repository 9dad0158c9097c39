//! Plans of nodes that do almost nothing: for the benches, and for the test that counts allocations.

use osteoflow_engine::plan::{
    Link, Location, OnError, OutputId, Plan, PlanInput, PlanNode, PlanOutput, Policy, PortFrames, RecordSettings,
    Require,
};
use osteoflow_node::{OutputPorts, Registry, serde_json};
use std::sync::Arc;

/// The default capacity of a wire.
pub(crate) const CAPACITY: usize = 4;

/// A plan of nodes, each with kind, parameters and the index of the node that feeds it.
pub(crate) fn plan(registry: &Registry, nodes: &[(&str, serde_json::Value, Option<usize>)]) -> Plan {
    let location = Location { file: "bench.toml".into(), line: 1, column: 1 };
    let mut links: Vec<Link> = Vec::new();
    let mut planned: Vec<PlanNode> = Vec::new();
    for (index, (kind, params, from)) in nodes.iter().enumerate() {
        let description = &registry.kind(kind).expect("the kind is registered").description;
        let OutputPorts::Fixed(outputs) = &description.outputs else { unreachable!("the ports are fixed") };
        let link = from.map(|from| {
            let link = links.len();
            planned[from].outputs[0].links.push(link);
            links.push(Link {
                from: OutputId { node: from, port: 0 },
                to_node: index,
                to_port: 0,
                capacity: CAPACITY,
                max_bytes: 1 << 30,
                policy: Policy::Block,
            });
            link
        });
        let inputs = description.inputs.iter().map(|port| PlanInput {
            port: port.clone(),
            links: link.into_iter().collect(),
            contract: Default::default(),
        });
        let outputs = outputs.iter().map(|port| PlanOutput {
            name: port.name.into(),
            payload: port.payload,
            frames: PortFrames::default(),
            links: Vec::new(),
        });
        planned.push(PlanNode {
            name: Arc::from(format!("n{index}")),
            kind: (*kind).into(),
            role: description.role,
            location: location.clone(),
            plugin: None,
            params: params.clone(),
            param_places: Default::default(),
            files: Vec::new(),
            declared: Arc::from([]),
            inputs: inputs.collect(),
            outputs: outputs.collect(),
            on_error: OnError::Stop,
            place: Default::default(),
            deadline: None,
        });
    }
    Plan {
        name: "bench".into(),
        seed: 1,
        path: "bench.toml".into(),
        nodes: planned,
        links,
        record: Vec::new(),
        results: Vec::new(),
        require: Require::default(),
        input_files: Vec::new(),
        plugins: Vec::new(),
        frames: Vec::new(),
        resolved: String::new(),
        recording: RecordSettings::default(),
    }
}

/// A plan of a source and `n_nodes` nodes in a row.
pub(crate) fn chain(registry: &Registry, source: &str, n_items: u64, node: &str, n_nodes: usize, spin_us: u64) -> Plan {
    let mut nodes = vec![(source, serde_json::json!({ "items": n_items }), None)];
    nodes.extend((0..n_nodes).map(|index| (node, serde_json::json!({ "spin_us": spin_us }), Some(index))));
    plan(registry, &nodes)
}
