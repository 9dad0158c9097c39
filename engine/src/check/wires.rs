//! What a text such as `crop.cloud` names.

use super::{drafts::Draft, nearest};
use crate::fault::{Fault, Span};

/// An output by the index of its node among the drafts, and its own among the node's outputs.
pub(super) type Wire = (usize, usize);

/// The output that the text names; `None` without a fault where its node is at fault already.
pub(super) fn find(text: &str, at: &Span, owner: &str, drafts: &[Draft<'_>], faults: &mut Vec<Fault>) -> Option<Wire> {
    let Some((node, port)) = text.rsplit_once('.') else {
        faults.push(no_dot(text, at, owner, drafts));
        return None;
    };
    let Some(index) = drafts.iter().position(|draft| draft.name == node) else {
        let (_, list) = nearest::hint(node, "nodes", drafts.iter().map(|draft| draft.name));
        let fault = Fault::new(format!("{owner} is wired to \"{text}\", but there is no node \"{node}\""));
        let fault = fault.at(at, "no such node").help_if(near_node(node, port, drafts));
        faults.push(fault.note_if(list).follows());
        return None;
    };
    let outputs = drafts[index].outputs.as_ref()?;
    let found = outputs.iter().position(|output| output.name == port);
    if found.is_none() {
        let names = || outputs.iter().map(|output| output.name.as_str());
        let kind = drafts[index].kind_name();
        let fault = Fault::new(format!("{owner} is wired to \"{text}\", but {kind} has no output \"{port}\""));
        let only = (outputs.len() == 1).then(|| format!("its one output is \"{node}.{}\"", outputs[0].name));
        let near = nearest::name(port, names()).map(|near| format!("did you mean \"{node}.{near}\"?"));
        let list = nearest::list(&format!("outputs of \"{node}\""), names());
        faults.push(fault.at(at, "no such output").help_if(near.or(only)).note_if(list).follows());
    }
    found.map(|port| (index, port))
}

fn near_node(node: &str, port: &str, drafts: &[Draft<'_>]) -> Option<String> {
    let near = nearest::name(node, drafts.iter().map(|draft| draft.name))?;
    let outputs = drafts.iter().find(|draft| draft.name == near)?.outputs.as_ref();
    let there = outputs.is_some_and(|outputs| outputs.iter().any(|output| output.name == port));
    Some(if there { format!("did you mean \"{near}.{port}\"?") } else { format!("did you mean node \"{near}\"?") })
}

fn no_dot(text: &str, at: &Span, owner: &str, drafts: &[Draft<'_>]) -> Fault {
    let fault = Fault::new(format!("{owner} takes a wire, which is written node.port, found {text:?}"));
    let fault = fault.at(at, "no dot here");
    let outputs = drafts.iter().find(|draft| draft.name == text).and_then(|draft| draft.outputs.as_ref());
    match outputs {
        Some(outputs) => {
            let wires: Vec<_> = outputs.iter().map(|output| format!("\"{text}.{}\"", output.name)).collect();
            fault.help(format!("write {}", wires.join(" or ")))
        }
        None => fault.help_if(nearest::help(text, drafts.iter().map(|draft| draft.name))),
    }
}

/// The name of a wire.
pub(super) fn name((node, port): Wire, drafts: &[Draft<'_>]) -> String {
    let port = drafts[node].outputs.as_ref().map_or("", |outputs| &outputs[port].name);
    format!("{}.{port}", drafts[node].name)
}
