//! Orders faults for display, and adds the places where modules are used.

use crate::fault::{Fault, Severity, Use};

/// Adds to each fault inside a module the place where the module is used; a fault seen in several uses is listed once.
pub(super) fn add_uses(faults: Vec<Fault>) -> Vec<Fault> {
    let mut out: Vec<Fault> = Vec::new();
    for mut fault in faults {
        let mut uses = Vec::new();
        let mut source = fault.at.as_ref().map(|(span, _)| span.source.clone());
        while let Some(used) = source.as_ref().and_then(|source| source.used.as_ref()) {
            uses.push((used.at.clone(), format!("used here as \"{}\"", used.node)));
            source = Some(used.at.source.clone());
        }
        let same = out.iter_mut().find(|other| !uses.is_empty() && is_same(other, &fault));
        match same {
            Some(other) => other.also.extend(uses.into_iter().take(1)),
            None => {
                fault.also.extend(uses);
                out.push(fault);
            }
        }
    }
    out
}

/// Whether both report the same problem at the same place, found in different uses of a module.
fn is_same(a: &Fault, b: &Fault) -> bool {
    let (Some((a_at, a_label)), Some((b_at, b_label))) = (&a.at, &b.at) else { return false };
    let (Some(a_use), Some(b_use)) = (&a_at.source.used, &b_at.source.used) else { return false };
    let bare = |text: &str, used: &Use| text.replace(&format!("\"{}/", used.node), "\"");
    a_at.source.name == b_at.source.name
        && a_at.range == b_at.range
        && a_label == b_label
        && a_use.node != b_use.node
        && bare(&a.message, a_use) == bare(&b.message, b_use)
}

/// Sorts faults by their place in the texts. After a syntax fault, possible consequences of it are left out. A warning that is
/// given at several places is listed once, with all of them.
pub(super) fn sorted(mut faults: Vec<Fault>) -> Vec<Fault> {
    let hidden: Vec<_> = faults.iter().filter_map(|fault| fault.hides.clone()).collect();
    let consequence = |fault: &Fault| match &fault.at {
        Some((span, _)) => fault.follows || hidden.iter().any(|hidden| hidden.covers(span)),
        None => false,
    };
    faults.retain(|fault| hidden.is_empty() || fault.hides.is_some() || !consequence(fault));
    faults.sort_by_key(|fault| fault.at.as_ref().map(|(span, _)| span.key()));
    let mut out: Vec<Fault> = Vec::new();
    for fault in faults {
        let is_same = |other: &&mut Fault| {
            [other.severity, fault.severity] == [Severity::Warning; 2] && other.message == fault.message
        };
        match out.iter_mut().find(is_same) {
            Some(other) => other.also.extend(fault.at),
            None => out.push(fault),
        }
    }
    out
}

#[cfg(test)]
mod tests;
