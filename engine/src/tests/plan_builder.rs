//! Plans for the unit tests of the engine.
#![allow(clippy::unwrap_used)]

use crate::{
    check::pairs,
    plan::{
        Contract, Deadline, Link, Location, OnError, OutputId, Plan, PlanInput, PlanNode, PlanOutput, Policy, Require,
        ResultEntry,
    },
};
use osteoflow_node::{
    DeclaredPort, Join, OutputPorts, Payload, PortPayload, Source,
    serde_json::{Value as Json, json},
};
use osteoflow_toy::{Number, Script, registry};
use std::sync::Arc;

/// Builds a plan of toy nodes without a graph file.
pub(crate) struct PlanBuilder {
    plan: Plan,
}

impl PlanBuilder {
    pub(crate) fn new() -> Self {
        Self {
            plan: Plan {
                name: "toy".into(),
                seed: 7,
                path: "toy.toml".into(),
                nodes: Vec::new(),
                links: Vec::new(),
                record: Vec::new(),
                recording: Default::default(),
                results: Vec::new(),
                require: Require::default(),
                input_files: Vec::new(),
                plugins: Vec::new(),
                frames: Vec::new(),
                resolved: "[graph]\nname = \"toy\"\n".into(),
            },
        }
    }

    /// A script with ports `p0`, `p1` ...
    pub(crate) fn script(self, name: &str, n_ports: usize, calls: Json) -> Self {
        self.source(name, Script::KIND, n_ports, json!({ "calls": calls }))
    }

    /// A source whose ports `p0`, `p1` ... the graph declares.
    pub(crate) fn source(mut self, name: &str, kind: &str, n_ports: usize, params: Json) -> Self {
        let ty = registry().payload_type(Number::NAME).unwrap();
        let ports = (0..n_ports).map(|i| format!("p{i}"));
        let declared = ports.clone().map(|name| DeclaredPort { name, payload: ty, params: json!({}) });
        let outputs = ports.map(|name| PlanOutput {
            name,
            payload: PortPayload::Type(ty),
            frames: Default::default(),
            links: Vec::new(),
        });
        let (declared, outputs) = (declared.collect(), outputs.collect());
        self.push(name, kind, params, declared, outputs, Vec::new());
        self
    }

    /// A node; inputs are `port = "from.port"`, with a join of its own or the kind's.
    pub(crate) fn node(mut self, name: &str, kind: &str, params: Json, inputs: &[(&str, &str, Option<Join>)]) -> Self {
        let registry = registry();
        let description = &registry.kind(kind).unwrap().description;
        let OutputPorts::Fixed(ports) = &description.outputs else { panic!("{kind} declares its ports") };
        let outputs = ports.iter().map(|p| PlanOutput {
            name: p.name.into(),
            payload: p.payload,
            frames: Default::default(),
            links: Vec::new(),
        });
        let (outputs, to_node) = (outputs.collect(), self.plan.nodes.len());
        let mut plan_inputs = Vec::new();
        for (to_port, port) in description.inputs.iter().enumerate() {
            let mut port = port.clone();
            let mut links = Vec::new();
            for (_, from, join) in inputs.iter().filter(|(name, ..)| *name == port.name) {
                port.join = join.unwrap_or(port.join);
                let from = self.wire(from);
                links.push(self.plan.links.len());
                self.plan.nodes[from.node].outputs[from.port].links.push(self.plan.links.len());
                let policy = Policy::Block;
                self.plan.links.push(Link { from, to_node, to_port, capacity: 4, max_bytes: 1 << 20, policy });
            }
            plan_inputs.push(PlanInput { port, links, contract: Contract::default() });
        }
        self.push(name, kind, params, Arc::from([]), outputs, plan_inputs);
        self
    }

    /// Wires an input joined by `previous` to a node that is there by now, such as one downstream.
    pub(crate) fn previous(mut self, input: &str, from: &str) -> Self {
        let (node, port) = input.rsplit_once('.').unwrap();
        let (from, to_node) = (self.wire(from), self.plan.node(node).unwrap());
        let to_port = self.plan.nodes[to_node].inputs.iter().position(|input| input.port.name == port).unwrap();
        let link = self.plan.links.len();
        let input = &mut self.plan.nodes[to_node].inputs[to_port];
        (input.port.join, input.links) = (Join::Previous, vec![link]);
        self.plan.nodes[from.node].outputs[from.port].links.push(link);
        self.plan.links.push(Link { from, to_node, to_port, capacity: 4, max_bytes: 1 << 20, policy: Policy::Block });
        self
    }

    fn push(
        &mut self,
        name: &str,
        kind: &str,
        params: Json,
        declared: Arc<[DeclaredPort]>,
        outputs: Vec<PlanOutput>,
        inputs: Vec<PlanInput>,
    ) {
        let role = registry().kind(kind).unwrap().description.role;
        let location = Location { file: "toy.toml".into(), line: 10 + self.plan.nodes.len(), column: 1 };
        let (name, kind) = (Arc::from(name), kind.to_owned());
        self.plan.nodes.push(PlanNode {
            name,
            kind,
            role,
            location,
            plugin: None,
            params,
            param_places: Default::default(),
            files: Vec::new(),
            declared,
            inputs,
            outputs,
            on_error: OnError::Stop,
            place: Default::default(),
            deadline: None,
        });
    }

    pub(crate) fn wire(&self, name: &str) -> OutputId {
        let (node, port) = name.split_once('.').unwrap();
        let node = self.plan.node(node).unwrap();
        let port = self.plan.nodes[node].outputs.iter().position(|o| o.name == port).unwrap();
        OutputId { node, port }
    }

    /// Changes the link into the node's port.
    pub(crate) fn link(mut self, to: &str, change: impl Fn(&mut Link)) -> Self {
        let (node, port) = to.split_once('.').unwrap();
        let node = self.plan.node(node).unwrap();
        let input = self.plan.nodes[node].inputs.iter().find(|i| i.port.name == port).unwrap();
        change(&mut self.plan.links[input.links[0]]);
        self
    }

    /// Asks something of the time of an input's values.
    pub(crate) fn contract(mut self, to: &str, contract: Contract) -> Self {
        let (node, port) = to.split_once('.').unwrap();
        let node = self.plan.node(node).unwrap();
        self.plan.nodes[node].inputs.iter_mut().find(|i| i.port.name == port).unwrap().contract = contract;
        self
    }

    pub(crate) fn deadline(mut self, node: &str, deadline: Deadline) -> Self {
        let node = self.plan.node(node).unwrap();
        self.plan.nodes[node].deadline = Some(deadline);
        self
    }

    /// Declares the output of a source to be optional.
    pub(crate) fn optional(mut self, node: &str, port: usize) -> Self {
        let node = self.plan.node(node).unwrap();
        let mut declared = self.plan.nodes[node].declared.to_vec();
        declared[port].params = json!({ "optional": true });
        self.plan.nodes[node].declared = declared.into();
        self
    }

    pub(crate) fn skip_errors(mut self, node: &str) -> Self {
        self.plan.nodes.iter_mut().filter(|n| &*n.name == node).for_each(|n| n.on_error = OnError::Skip);
        self
    }

    pub(crate) fn record(mut self, wires: &[&str]) -> Self {
        self.plan.record = wires.iter().map(|w| self.wire(w)).collect();
        self
    }

    pub(crate) fn result(mut self, key: &str, wire: &str, all: bool, optional: bool) -> Self {
        let location = Location { file: "toy.toml".into(), line: 90, column: 1 };
        let from = self.wire(wire);
        self.plan.results.push(ResultEntry { key: key.into(), from, all, optional, location });
        self
    }

    /// Refuses doubtful results.
    pub(crate) fn require_trusted(mut self) -> Self {
        self.plan.require = Require::Trusted;
        self
    }

    /// The plan, with the tables of its nodes as the resolved graph.
    pub(crate) fn plan(mut self) -> Plan {
        for node in &self.plan.nodes {
            let declared = node
                .declared
                .iter()
                .map(|port| format!("out.{} = {{ type = \"{}\", calls = [] }}", port.name, port.payload.name));
            let lines: Vec<_> = declared.chain(pairs(&node.params)).collect();
            self.plan.resolved += &format!("\n[node.{}]\nkind = \"{}\"\n{}\n", node.name, node.kind, lines.join("\n"));
        }
        self.plan
    }
}
