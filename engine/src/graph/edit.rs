use super::{
    merge::merge,
    tree::{Entry, Spanned, Table, Value},
};
use crate::fault::{Fault, Span};

/// A change to a list, given on the command line: `crop.half_mm[1]=20`, `record.wires+=["icp.*"]`.
pub(super) struct Edit {
    pub(super) steps: Vec<Step>,
    /// Whether the value is appended to the list.
    pub(super) append: bool,
    pub(super) value: Spanned,
    pub(super) key_at: Span,
}

/// One step of the path to a value.
pub(super) enum Step {
    Key(String, Span),
    Index(usize, Span),
}

impl Edit {
    /// The node that it changes.
    fn node(&self) -> Option<&str> {
        match self.steps.as_slice() {
            [Step::Key(node, _), Step::Key(name, _), ..] if node == "node" => Some(name),
            _ => None,
        }
    }

    /// The list as the command line names it.
    fn name(&self) -> String {
        let key = self.key_at.text();
        key.split('[').next().unwrap_or(key).to_owned()
    }

    /// Whether it changes a node inside a module, which is not read yet.
    pub(super) fn is_inside_a_module(&self, table: &Table) -> bool {
        let Some((module, _)) = self.node().and_then(|node| node.split_once('/')) else { return false };
        table.get("node").and_then(|nodes| nodes.value.as_table()).is_some_and(|nodes| nodes.get(module).is_some())
    }

    /// Whether it changes one of these nodes.
    pub(super) fn is_within(&self, nodes: &Table) -> bool {
        self.node().is_some_and(|node| nodes.get(node).is_some())
    }

    /// Makes the change.
    pub(super) fn apply(self, table: &mut Table) -> Result<(), Box<Fault>> {
        // Patterns are the only list that starts empty; the defaults of other lists are not in the graph.
        if let ([Step::Key(record, at), Step::Key(wires, _)], true) = (self.steps.as_slice(), self.append)
            && (record.as_str(), wires.as_str()) == ("record", "wires")
        {
            let empty = Spanned { value: Value::Array(Vec::new()), at: at.clone() };
            let wires = Table(vec![Entry { key: "wires".into(), key_at: at.clone(), value: empty }]);
            let wires = Spanned { value: Value::Table(wires), at: at.clone() };
            let mut over = Table(vec![Entry { key: "record".into(), key_at: at.clone(), value: wires }]);
            let there = table.get("record").and_then(|record| record.value.as_table()?.get("wires"));
            if there.is_none() {
                merge(table, std::mem::take(&mut over));
            }
        }
        self.apply_at(table, 0)
    }

    /// Makes the change in a table of nodes by name.
    pub(super) fn apply_to_nodes(self, nodes: &mut Table) -> Result<(), Box<Fault>> {
        self.apply_at(nodes, 1)
    }

    /// Makes the change in the table that the first steps lead to.
    fn apply_at(self, table: &mut Table, done: usize) -> Result<(), Box<Fault>> {
        let name = self.name();
        let Some((Step::Key(first, _), rest)) = self.steps.get(done..).and_then(<[Step]>::split_first) else {
            return Err(not_written(&name, &self.key_at));
        };
        let Some(entry) = table.get_mut(first) else { return Err(not_written(&name, &self.key_at)) };
        let slot = walk(&mut entry.value, rest, self.append, &name, &self.key_at)?;
        if !self.append {
            match (&mut slot.value, self.value.value) {
                (Value::Table(base), Value::Table(over)) => merge(base, over),
                (_, value) => *slot = Spanned { value, at: self.value.at },
            }
            return Ok(());
        }
        if let (Value::Text(_), "record.wires") = (&slot.value, name.as_str()) {
            slot.value = Value::Array(vec![slot.clone()]);
        }
        let is_input = matches!(&self.steps[..], [_, _, Step::Key(key, _), _] if key == "in");
        let slot = match &mut slot.value {
            Value::Table(table) if is_input && table.get("from").is_some() => {
                &mut table.get_mut("from").expect("it was there").value
            }
            _ => slot,
        };
        if let (Value::Text(_), true) = (&slot.value, is_input) {
            slot.value = Value::Array(vec![slot.clone()]);
        }
        let found = slot.found();
        let Value::Array(items) = &mut slot.value else { return Err(no_list(&name, &found, &self.key_at)) };
        // Faults of the list as a whole point at this setting.
        slot.at = self.value.at.clone();
        match self.value.value {
            Value::Array(more) => items.extend(more),
            _ => items.push(self.value),
        }
        Ok(())
    }

    /// The fault of a change inside a module that found nothing to change.
    pub(super) fn not_found(&self) -> Fault {
        *not_written(&self.name(), &self.key_at)
    }
}

fn walk<'t>(
    value: &'t mut Spanned,
    steps: &[Step],
    append: bool,
    name: &str,
    key_at: &Span,
) -> Result<&'t mut Spanned, Box<Fault>> {
    let Some((step, rest)) = steps.split_first() else { return Ok(value) };
    let found = value.found();
    match (step, &mut value.value) {
        (Step::Key(key, at), Value::Table(table)) => {
            if table.get(key).is_none() {
                // A new key of an item is fine; a list that is to be changed must be there.
                if append || rest.iter().any(|step| matches!(step, Step::Index(..))) {
                    return Err(not_written(name, key_at));
                }
                let value = Spanned { value: Value::Table(Table::default()), at: at.clone() };
                table.0.push(Entry { key: key.clone(), key_at: at.clone(), value });
            }
            match table.get_mut(key) {
                Some(entry) => walk(&mut entry.value, rest, append, name, key_at),
                None => Err(not_written(name, key_at)),
            }
        }
        (Step::Index(index, at), Value::Array(items)) => match items.len() {
            n if *index < n => walk(&mut items[*index], rest, append, name, key_at),
            n => {
                let holds = if n == 1 { "1 item".to_owned() } else { format!("{n} items") };
                let fault = Fault::new(format!("{name} holds {holds}, so there is no item {index}"));
                let last = n.checked_sub(1).map(|last| format!("items are numbered from 0; the last is [{last}]"));
                Err(Box::new(
                    fault.at(at, "no such item").help_if(last).help(format!("{name}+=VALUE puts one more at the end")),
                ))
            }
        },
        (Step::Index(..), _) => Err(no_list(name, &found, key_at)),
        (Step::Key(key, at), _) => {
            let fault = Fault::new(format!("{key} lies in {found}, which has no keys"));
            Err(Box::new(fault.at(at, "no table")))
        }
    }
}

fn no_list(name: &str, found: &str, at: &Span) -> Box<Fault> {
    Box::new(Fault::new(format!("{name} is {found}, not a list")).at(at, "a list is needed"))
}

fn not_written(name: &str, at: &Span) -> Box<Fault> {
    let fault = Fault::new(format!("{name} is not written in the graph, so no item of it can be changed"));
    let note = "a kind's default is no part of the graph file";
    Box::new(fault.at(at, "not there").note(note).help(format!("write the whole list: {name}=[..]")))
}
