use super::{
    Quantity, Walker,
    value_type::{ValueType, describe, doc, value_type},
};
use crate::{
    fault::{Fault, Span},
    graph::{Entry, Table, unit},
    names::nearest,
};
use serde_json::{Map, Value as Json};

/// The keys of a node's table that are no parameters.
const OF_NODE: [&str; 7] = ["kind", "in", "env", "on_error", "process", "pool", "stop_after_s"];

/// Extension of a struct's schema: parameters of earlier versions, each as `name: { default, warning }`. They are ignored; any value but
/// the default, which recordings spell out, with the warning.
const REMOVED: &str = "x-removed";

impl<'a> Walker<'a> {
    /// Reads a table by the schema of a struct or map, except for the keys in `skip`, and fills in defaults.
    pub(crate) fn table(
        &mut self,
        schema: &'a Json,
        table: &Table,
        at: &Span,
        prefix: &str,
        skip: &[&str],
    ) -> Option<Map<String, Json>> {
        let before = self.n_errors();
        let empty = Map::new();
        let properties = schema.get("properties").and_then(Json::as_object).unwrap_or(&empty);
        let more = schema.get("additionalProperties").filter(|more| **more != Json::Bool(false));
        let mut out = Map::new();
        for (name, property) in properties.iter().filter(|(name, _)| !skip.contains(&name.as_str())) {
            let value = match table.get(name) {
                Some(entry) => self.read_owned(schema, name, entry, prefix),
                None if is_required(schema, name, self.root, property) => {
                    // A parameter with a misspelt name is not reported as missing too.
                    if !table.keys().any(|key| properties.get(key).is_none() && is_meant(key, name, skip)) {
                        self.missing(property, at, name, prefix);
                    }
                    None
                }
                // A missing `Option` is left out: TOML has no null.
                None => property.get("default").filter(|default| !default.is_null()).cloned(),
            };
            out.extend(value.map(|value| (name.clone(), value)));
        }
        let known: Vec<_> = properties.keys().map(String::as_str).filter(|name| !skip.contains(name)).collect();
        let unknown = |entry: &&Entry| !known.contains(&entry.key.as_str()) && !skip.contains(&entry.key.as_str());
        for entry in table.0.iter().filter(unknown) {
            if let Some(removed) = schema.get(REMOVED).and_then(|removed| removed.get(&entry.key)) {
                self.removed(entry, removed, prefix);
                continue;
            }
            match more {
                Some(more) => {
                    let what = Quantity { name: format!("{prefix}{}", entry.key), doc: None };
                    let value = self.read(more, &entry.value, &what);
                    out.extend(value.map(|value| (entry.key.clone(), value)));
                }
                None => self.unknown(entry, &known, prefix, table),
            }
        }
        (self.n_errors() == before).then_some(out)
    }

    fn read_owned(&mut self, schema: &'a Json, name: &str, entry: &Entry, prefix: &str) -> Option<Json> {
        let property = schema.get("properties")?.get(name)?;
        let what = Quantity {
            name: format!("{prefix}{name}"),
            doc: self.describe_param(property, &format!("{prefix}{name}")),
        };
        self.read(property, &entry.value, &what)
    }

    /// Describes a parameter: `max_iterations: its doc (default 50)`.
    fn describe_param(&self, property: &Json, name: &str) -> Option<String> {
        let text = doc(property).or_else(|| doc(super::value_type::resolve(self.root, property)))?;
        let default = match property.get("default") {
            Some(default @ (Json::Bool(_) | Json::Number(_) | Json::String(_))) if default.as_str() != Some("") => {
                format!(" (default {default})")
            }
            _ => String::new(),
        };
        Some(format!("{name}: {}{default}", first_paragraph(text)))
    }

    fn missing(&mut self, property: &Json, at: &Span, name: &str, prefix: &str) {
        let takes = describe(self.root, property);
        let message = format!("{}: parameter \"{prefix}{name}\" is missing", self.owner);
        let example = match value_type(self.root, property) {
            ValueType::Path | ValueType::Text => "\"..\"",
            _ => "..",
        };
        let fault = Fault::new(message).at(at, format!("needs {name}, {takes}")).follows();
        let fault = fault.note_if(self.describe_param(property, &format!("{prefix}{name}")));
        self.faults.push(fault.help(format!("add {name} = {example}")));
    }

    fn removed(&mut self, entry: &Entry, removed: &Json, prefix: &str) {
        let value = self.any(&entry.value, &Quantity { name: format!("{prefix}{}", entry.key), doc: None });
        if let Some(warning) = removed["warning"].as_str().filter(|_| value.as_ref() != removed.get("default")) {
            self.faults.push(Fault::new(warning).at(&entry.key_at, "ignored").warning());
        }
    }

    fn unknown(&mut self, entry: &Entry, known: &[&str], prefix: &str, table: &Table) {
        let (owner, kind, key) = (&self.owner, self.kind, &entry.key);
        let inside = if prefix.is_empty() { String::new() } else { format!(" in {}", prefix.trim_end_matches('.')) };
        let fault = Fault::new(format!("{owner}: {kind} has no parameter \"{key}\"{inside}"));
        // Suggest only names that are not set already.
        let free = || known.iter().copied().filter(|name| table.get(name).is_none());
        let value = entry.value.as_number().filter(|v| v.is_finite());
        let fault = match unit::same_quantity(key, value, free()) {
            Some(other) => {
                let fault = fault.at(&entry.key_at, format!("it is given in {}", other.unit));
                match other.value {
                    Some(value) => fault.help(format!("write {} = {value:?}", other.name)),
                    None => fault.help(format!("write {}: the unit is part of the name", other.name)),
                }
            }
            None => {
                let near = nearest::help(key, free()).or_else(|| nearest::help(key, known.iter().copied()));
                // Keys of the node itself, which any kind has.
                let near = near.or_else(|| nearest::help(key, OF_NODE).filter(|_| prefix.is_empty()));
                let list = nearest::list("its parameters", known.iter().copied());
                let none = known.is_empty().then(|| "it has no parameters here".to_owned());
                fault.at(&entry.key_at, "unknown").help_if(near).note_if(list.or(none))
            }
        };
        self.faults.push(self.kind_elsewhere(fault, entry, prefix));
    }

    /// If a variant chose the kind and another file set the parameter, shows both places.
    fn kind_elsewhere(&self, mut fault: Fault, entry: &Entry, prefix: &str) -> Fault {
        let path = format!("{}.{prefix}{}", self.path, entry.key);
        fault.removes = (!entry.key_at.source.command_line).then(|| path.clone());
        match self.kind_at {
            Some(kind_at) if kind_at.source.is_over(&entry.key_at.source) => {
                let take_away = match (kind_at.source.command_line, kind_at.source.is_sweep()) {
                    (false, _) => format!("take it away where the kind is chosen: remove = [\"{path}\"]"),
                    (true, false) => format!("take it away, too: --set 'remove=[\"{path}\"]'"),
                    (true, true) => {
                        let node = self.path.trim_start_matches("node.");
                        format!(
                            "take it away with this kind, whose value of the factor is then a table: {{ {node}.kind = \"{}\", \
                             remove = [\"{path}\"] }}",
                            self.kind
                        )
                    }
                };
                fault.also(kind_at, "the kind is chosen here").or_help(take_away)
            }
            Some(kind_at) if kind_at.source.command_line && !entry.key_at.source.command_line => {
                fault.or_help(format!("take it away with the old kind: --set 'remove=[\"{path}\"]'"))
            }
            _ => fault,
        }
    }
}

fn is_meant(found: &str, name: &str, skip: &[&str]) -> bool {
    !skip.contains(&found)
        && (nearest::name(found, [name]).is_some() || unit::same_quantity(found, None, [name]).is_some())
}

/// Whether it must be given. A path with an empty default must.
fn is_required(schema: &Json, name: &str, root: &Json, property: &Json) -> bool {
    let listed = schema.get("required").and_then(Json::as_array);
    let listed = listed.is_some_and(|names| names.iter().any(|n| n.as_str() == Some(name)));
    let empty_path = matches!(value_type(root, property), ValueType::Path)
        && property.get("default") == Some(&Json::String(String::new()));
    listed || empty_path
}

/// The first paragraph of a doc comment on one line.
pub(in crate::check) fn first_paragraph(text: &str) -> String {
    let paragraph = text.split("\n\n").next().unwrap_or(text);
    paragraph.split_whitespace().collect::<Vec<_>>().join(" ")
}
