//! Contracts of time: `max_age_ms`, `rate_hz` and `deadline_ms`, with what happens otherwise.

use super::{
    context::Check,
    feedback::{Rate, rate_of, rates},
    inputs::Input,
    order::Order,
    parsed_nodes::ParsedNode,
    wires,
};
use crate::{
    fault::Fault,
    graph::extract::Section,
    plan::{Contract, Deadline, Otherwise},
};
use osteoflow_node::{Join, Role};

impl Check<'_> {
    /// Reads what an input asks of the time of its values.
    pub(super) fn contract(&mut self, input: &mut Input, table: &Section<'_>, owner: &str, nodes: &[ParsedNode<'_>]) {
        let max_age_ns = self.above_zero(table, "max_age_ms");
        let rate_hz = table.positive("rate_hz", "items a second", &mut self.faults);
        let period_ns = rate_hz.map(|hz| (1e9 / hz).round() as i64);
        let otherwise = self.otherwise(table, &["max_age_ms", "rate_hz"]);
        if let Some(entry) = table.get("max_age_ms").filter(|_| input.port.join == Join::Once) {
            let fault = Fault::new(format!("{owner} takes a constant, which does not grow old"));
            let help = "take max_age_ms away, or join by \"latest\" what may come again";
            self.faults.push(fault.at(&entry.key_at, "joins by once").help(help));
        }
        let is_source = |node: usize| nodes[node].is_source();
        if let (Some(entry), Some(node)) = (table.get("rate_hz"), input.producers().find(|node| !is_source(*node))) {
            let fault = Fault::new(format!("{owner} expects a rate of \"{}\", which is no source", nodes[node].name));
            let help = "a node fires when its inputs come: write rate_hz at an input that a source feeds";
            self.faults.push(fault.at(&entry.key_at, "only of a source").help(help));
        }
        if let (Some(max_ns), Some(period_ns), Some(entry)) = (max_age_ns, period_ns, table.get("max_age_ms"))
            && max_ns <= period_ns
        {
            let period_ms = period_ns as f64 / 1e6;
            let fault = Fault::new(format!("{owner} can never keep max_age_ms: an item comes every {period_ms} ms"));
            let help = format!("allow more than {period_ms} ms, or have the device send more often");
            self.faults.push(fault.at(&entry.value.at, "shorter than a period of rate_hz").help(help));
        }
        input.contract = Contract { max_age_ns, period_ns, otherwise };
    }

    /// Reads how long a firing may take.
    pub(super) fn deadline(&mut self, table: &Section<'_>, node: &ParsedNode<'_>) -> Option<Deadline> {
        let (ns, otherwise) = (self.above_zero(table, "deadline_ms"), self.otherwise(table, &["deadline_ms"]));
        if let Some(entry) = table.get("deadline_ms").filter(|_| node.is_source()) {
            let fault = Fault::new(format!("node \"{}\" is a source, which has no deadline", node.name));
            let help = "write rate_hz, or max_age_ms, at the input that it feeds";
            self.faults.push(fault.at(&entry.key_at, "waits for its device").help(help));
        }
        Some(Deadline { ns: ns?, otherwise })
    }

    fn above_zero(&mut self, table: &Section<'_>, key: &str) -> Option<i64> {
        let ns = table.milliseconds(key, &mut self.faults);
        if let Some(entry) = table.get(key).filter(|_| ns == Some(0)) {
            let fault = Fault::new(format!("{} is no length of time", table.what(key)));
            self.faults.push(fault.at(&entry.value.at, "shorter than a nanosecond").help("write a longer one"));
        }
        ns.filter(|ns| *ns > 0)
    }

    fn otherwise(&mut self, table: &Section<'_>, with: &[&str]) -> Otherwise {
        if let Some(entry) = table.get("otherwise").filter(|_| with.iter().all(|key| table.get(key).is_none())) {
            let with = with.join(" or ");
            let fault = Fault::new(format!("{} is given without {with}", table.what("otherwise")));
            let fault = fault.at(&entry.key_at, "nothing that could be broken");
            self.faults.push(fault.help(format!("add {with}, or take it away")));
        }
        match table.word("otherwise", &mut self.faults) {
            Some("drop") => Otherwise::Drop,
            Some("refuse") => Otherwise::Refuse,
            _ => Otherwise::Unknown,
        }
    }

    /// Faults of inputs that pair a wire by number, on which a silence puts an empty, with wires that have none.
    pub(super) fn silences(&mut self, nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>], order: &Order) {
        let is_live = |node: usize| nodes[node].role() == Some(Role::LiveSource);
        let limited = inputs.iter().flatten().filter(|input| input.contract.silence_ns().is_some());
        let limited: Vec<_> = limited.flat_map(Input::known_wires).map(|(wire, _)| wire).collect();
        let limited: Vec<_> = limited.into_iter().filter(|wire| is_live(wire.0)).collect();
        if limited.is_empty() {
            return;
        }
        let rates = rates(nodes, inputs, order);
        for (node, inputs) in nodes.iter().zip(inputs) {
            let by_number =
                |input: &&Input| !input.port.unused && (input.port.join == Join::Each || input.port.join.collects());
            let wires =
                || inputs.iter().filter(by_number).flat_map(|input| input.known_wires().map(move |wire| (input, wire)));
            let rate = |wire| rate_of(wire, nodes, &rates);
            let silent =
                wires().find(|(_, (wire, _))| limited.iter().any(|limited| rate(*wire) == Rate::Items(*limited)));
            let Some((input, (wire, at))) = silent else { continue };
            let other = wires().find(|(_, (other, _))| rate(*other) != rate(wire) && rate(*other) != Rate::Unknown);
            let Some((other, (_, other_at))) = other else { continue };
            let message = format!(
                "node \"{}\" pairs its inputs \"{}\" and \"{}\" by number, and an empty that says that \"{}\" is silent \
                 would shift the pairs",
                node.name,
                input.port.name,
                other.port.name,
                wires::name(wire, nodes)
            );
            let fault = Fault::new(message).at(at, "may get an empty more").also(other_at, "gets none");
            self.faults.push(
                fault.help(
                    "join one of them by \"stamp\" or \"latest\", or take max_age_ms and rate_hz of the wire away",
                ),
            );
        }
    }
}
