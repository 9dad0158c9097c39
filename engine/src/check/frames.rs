use super::{
    context::Check,
    inputs::{self, Input, fits},
    parsed_nodes::ParsedNode,
    wires::{self, OutputIndex},
};
use crate::{
    fault::{Fault, Span},
    graph::header::Header,
    names::nearest,
    plan::PortFrames,
};
use serde_json::Value as Json;

/// The frames of every output, by parsed node.
pub(super) type Frames = Vec<Vec<PortFrames>>;

/// Selects a frame of a port.
#[derive(Clone, Copy, PartialEq)]
enum Which {
    Frame,
    To,
    From,
}

impl Which {
    fn of(self, frames: &PortFrames) -> Option<&String> {
        match self {
            Self::Frame => frames.frame.as_ref(),
            Self::To => frames.to.as_ref(),
            Self::From => frames.from.as_ref(),
        }
    }
}

/// The fault of a frame that the graph uses but does not list.
pub(super) fn unknown(frame: &str, at: &Span, owner: &str, header: &Header) -> Option<Fault> {
    let (known, listed_at) = header.frames.as_ref()?;
    if known.iter().any(|name| name == frame) {
        return None;
    }
    let fault = Fault::new(format!("{owner}: there is no frame \"{frame}\"")).at(at, "unknown");
    let help = nearest::help(frame, known.iter().map(String::as_str));
    let list = nearest::list("frames of this graph", known.iter().map(String::as_str));
    let fault = if listed_at.source.order == at.source.order { fault } else { fault.also(listed_at, "the known ones") };
    Some(fault.help_if(help).note_if(list).or_help(format!("add \"{frame}\" to frames in [graph]")))
}

impl Check<'_> {
    /// Propagates frames along the wires and checks them against the ports' requirements.
    pub(super) fn frames(
        &mut self,
        parsed_nodes: &[ParsedNode<'_>],
        inputs: &[Vec<Input>],
        header: &Header,
        order: &[usize],
    ) -> Frames {
        let mut frames: Frames = vec![Vec::new(); parsed_nodes.len()];
        for &node in order {
            let parsed_node = &parsed_nodes[node];
            let mut at_fault = self.frame_params(parsed_node, header);
            let scope = Scope { parsed_node, inputs: &inputs[node], frames: &frames };
            let mut reported: Vec<(&str, &str)> = Vec::new();
            for input in inputs[node].iter().filter(|input| !input.port.unused) {
                for (fault, others) in scope.meet(input, parsed_nodes) {
                    at_fault = true;
                    // Two ports that refer to each other both mismatch; report only the first.
                    if !others.iter().any(|other| reported.contains(&(other, input.port.name))) {
                        self.faults.push(fault);
                    }
                    reported.extend(others.iter().map(|other| (input.port.name, *other)));
                }
            }
            // The outputs of a faulty node are not propagated, to avoid a fault at every node downstream.
            let outputs = parsed_node.outputs.iter().flatten().map(|output| {
                let frame = |given: &Option<String>, expr: Option<&str>| {
                    given.clone().or_else(|| scope.resolve(expr.filter(|_| !at_fault)?, 0))
                };
                PortFrames {
                    frame: frame(&output.given.frame, output.exprs.frame),
                    to: frame(&output.given.to, output.exprs.to),
                    from: frame(&output.given.from, output.exprs.from),
                }
            });
            let outputs = outputs.collect();
            frames[node] = outputs;
        }
        // The frames of a wire that closes a cycle were not known yet.
        for (node, parsed_node) in parsed_nodes.iter().enumerate() {
            let scope = Scope { parsed_node, inputs: &inputs[node], frames: &frames };
            let place = |node: usize| order.iter().position(|other| *other == node);
            let closes = |input: &&Input| input.producers().any(|from| place(from) >= place(node));
            let found = inputs[node].iter().filter(closes).flat_map(|input| scope.meet(input, parsed_nodes));
            self.faults.extend(found.map(|(fault, _)| fault));
        }
        frames
    }

    /// Checks that parameters that name a frame name a listed one; returns whether one does not.
    fn frame_params(&mut self, parsed_node: &ParsedNode<'_>, header: &Header) -> bool {
        let Some(kind) = parsed_node.kind else { return false };
        let before = self.faults.len();
        let ports = kind.description.inputs.iter().map(|port| port.frames);
        let outputs = parsed_node.outputs.iter().flatten().map(|output| output.exprs);
        let mut names: Vec<_> = ports
            .chain(outputs)
            .flat_map(|expr| [expr.frame, expr.to, expr.from])
            .filter_map(|expr| expr?.strip_prefix('$'))
            .collect();
        names.sort_unstable();
        names.dedup();
        for name in names {
            let Some(entry) = parsed_node.table.get(name) else { continue };
            let owner = format!("node \"{}\": {name}", parsed_node.name);
            // A resolved graph states defaults, which need not be listed where they are not stated.
            let default = kind.description.params.pointer(&format!("/properties/{name}/default"));
            let frame = entry.value.as_text().filter(|frame| default.and_then(Json::as_str) != Some(frame));
            self.faults.extend(frame.and_then(|frame| unknown(frame, &entry.value.at, &owner, header)));
        }
        self.faults.len() > before
    }
}

/// Resolves the frame expressions of a node's ports.
struct Scope<'a, 'd> {
    parsed_node: &'a ParsedNode<'d>,
    inputs: &'a [Input],
    frames: &'a Frames,
}

impl Scope<'_, '_> {
    /// The frame that a port's expression refers to, as far as it is known.
    fn resolve(&self, expr: &str, depth: usize) -> Option<String> {
        if let Some(name) = expr.strip_prefix('@') {
            return Some(name.to_owned());
        }
        if let Some(parameter) = expr.strip_prefix('$') {
            return self.parsed_node.params.get(parameter).and_then(Json::as_str).map(str::to_owned);
        }
        let (port, which) = refers(expr);
        let input = self.inputs.iter().find(|input| input.port.name == port)?;
        self.found(input, which).or_else(|| {
            // The wired frame is unknown, but the port may declare it. Ports may refer to each other in a cycle; the
            // depth ends it.
            let exprs = input.port.frames;
            let expr = match which {
                Which::Frame => exprs.frame,
                Which::To => exprs.to,
                Which::From => exprs.from,
            };
            self.resolve(expr.filter(|_| depth < 8)?, depth + 1)
        })
    }

    /// The frame of the wire connected to an input.
    fn found(&self, input: &Input, which: Which) -> Option<String> {
        let (wire, _) = input.known_wires().next()?;
        which.of(self.wired(wire)?).cloned()
    }

    fn wired(&self, (node, port): OutputIndex) -> Option<&PortFrames> {
        self.frames[node].get(port)
    }

    /// The faults of wires whose frames differ from those that the port requires, and the ports that the requirement refers
    /// to.
    fn meet(&self, input: &Input, parsed_nodes: &[ParsedNode<'_>]) -> Vec<(Fault, Vec<&'static str>)> {
        let wires = input.known_wires();
        wires.filter_map(|(wire, at)| self.wire_meets(input, wire, at, parsed_nodes)).collect()
    }

    fn wire_meets(
        &self,
        input: &Input,
        wire: OutputIndex,
        at: &Span,
        parsed_nodes: &[ParsedNode<'_>],
    ) -> Option<(Fault, Vec<&'static str>)> {
        let exprs = [
            (Which::Frame, input.port.frames.frame),
            (Which::To, input.port.frames.to),
            (Which::From, input.port.frames.from),
        ];
        let mut needed = PortFrames::default();
        let mut differ = Vec::new();
        for (which, expr) in exprs {
            let Some(expected) = expr.and_then(|expr| self.resolve(expr, 0)) else { continue };
            let slot = match which {
                Which::Frame => &mut needed.frame,
                Which::To => &mut needed.to,
                Which::From => &mut needed.from,
            };
            *slot = Some(expected.clone());
            if self.wired(wire).and_then(|frames| which.of(frames)).is_some_and(|found| *found != expected) {
                differ.extend(expr);
            }
        }
        if differ.is_empty() {
            return None;
        }
        let has = say(self.wired(wire)?);
        let (node, port) = (self.parsed_node.name, input.port.name);
        let message = format!(
            "node \"{node}\": frames do not meet: input \"{port}\" {}, but \"{}\" {has}",
            need(&needed),
            wires::name(wire, parsed_nodes)
        );
        let mut fault = Fault::new(message).at(at, has);
        for expr in &differ {
            fault = self.because(expr, fault);
        }
        let others = differ.iter().map(|expr| refers(expr).0).collect();
        Some((fault.help_if(self.others(input, &needed, wire, parsed_nodes)), others))
    }

    /// Adds the place that a required frame comes from.
    fn because(&self, expr: &str, fault: Fault) -> Fault {
        if let Some(parameter) = expr.strip_prefix('$') {
            let Some(frame) = self.resolve(expr, 0) else { return fault };
            return match self.parsed_node.table.get(parameter) {
                Some(entry) => fault.also(&entry.value.at, format!("{parameter} is {frame}")),
                None => fault.note(format!("{parameter} is {frame} by default")),
            };
        }
        let (port, _) = refers(expr);
        let input = self.inputs.iter().find(|input| input.port.name == port);
        let wired = input.and_then(|input| input.known_wires().next());
        let wired = wired.and_then(|(wire, at)| Some((at, self.wired(wire)?)));
        match wired {
            Some((at, frames)) => fault.also(at, say(frames)),
            None => fault,
        }
    }

    /// Lists outputs known to have the required frames.
    fn others(
        &self,
        input: &Input,
        needed: &PortFrames,
        wire: OutputIndex,
        parsed_nodes: &[ParsedNode<'_>],
    ) -> Option<String> {
        let agrees = |needed: &Option<String>, has: &Option<String>| needed.is_none() || needed == has;
        let mut wires = Vec::new();
        for (node, outputs) in self.frames.iter().enumerate() {
            for (port, has) in outputs.iter().enumerate().filter(|(port, _)| (node, *port) != wire) {
                let payload = inputs::output((node, port), parsed_nodes).and_then(|output| output.payload);
                let all =
                    agrees(&needed.frame, &has.frame) && agrees(&needed.to, &has.to) && agrees(&needed.from, &has.from);
                if all && payload.is_some_and(|gives| fits(&input.port.payload, &gives)) {
                    wires.push(format!("\"{}\"", wires::name((node, port), parsed_nodes)));
                }
            }
        }
        wires.truncate(5);
        (!wires.is_empty()).then(|| format!("wire {} instead", wires.join(" or ")))
    }
}

fn refers(expr: &str) -> (&str, Which) {
    match expr.rsplit_once('.') {
        Some((port, "to")) => (port, Which::To),
        Some((port, "from")) => (port, Which::From),
        Some((port, "frame")) => (port, Which::Frame),
        _ => (expr, Which::Frame),
    }
}

/// `is in ct`, `maps world -> ct`.
fn say(frames: &PortFrames) -> String {
    let name = |frame: &Option<String>| frame.clone().unwrap_or_else(|| "?".into());
    match frames {
        PortFrames { frame: Some(frame), .. } => format!("is in {frame}"),
        PortFrames { to, from, .. } => format!("maps {} -> {}", name(from), name(to)),
    }
}

fn need(frames: &PortFrames) -> String {
    match frames {
        PortFrames { frame: Some(frame), .. } => format!("should be in {frame}"),
        PortFrames { to, from, .. } => {
            let name = |frame: &Option<String>| frame.clone().unwrap_or_else(|| "?".into());
            format!("should map {} -> {}", name(from), name(to))
        }
    }
}
