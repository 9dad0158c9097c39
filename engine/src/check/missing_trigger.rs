use super::{inputs::Input, parsed_nodes::ParsedNode};
use crate::fault::Fault;
use osteoflow_node::{Join, Role};

/// The fault of a node without a triggering input.
pub(super) fn fault(parsed_node: &ParsedNode<'_>, inputs: &[Input]) -> Option<Fault> {
    if parsed_node.role() != Some(Role::Node) {
        return None;
    }
    // Inputs whose table could not be read have a fault already.
    if inputs.is_empty() && parsed_node.kind.is_some_and(|kind| !kind.description.inputs.is_empty()) {
        return None;
    }
    let used: Vec<_> = inputs.iter().filter(|input| !input.wires.is_empty() && !input.port.unused).collect();
    let once = !used.is_empty() && used.iter().all(|input| input.port.join == Join::Once);
    if once || used.iter().any(|input| input.port.join.triggers()) {
        return None;
    }
    let fault = Fault::new(format!("node \"{}\" never fires: no input of it triggers", parsed_node.name));
    let fault = fault.at(parsed_node.inputs_at(), "none of these triggers");
    let joins: Vec<_> =
        used.iter().map(|input| format!("{} joins by {}", input.port.name, input.port.join.name())).collect();
    let note = (!joins.is_empty()).then(|| joins.join(", "));
    Some(fault.note_if(note).help("let one input join by each, stamp or collect").follows())
}
