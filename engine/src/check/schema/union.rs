use super::{
    Quantity, Walker,
    value_type::{ValueType, value_type},
};
use crate::{
    fault::Fault,
    graph::{Spanned, Value},
    names::nearest,
};
use serde_json::Value as Json;

impl<'a> Walker<'a> {
    /// Reads the value by the first branch that accepts it; otherwise reports the faults of the closest branch.
    pub(super) fn union(
        &mut self,
        schema: &'a Json,
        branches: &[&'a Json],
        value: &Spanned,
        what: &Quantity,
    ) -> Option<Json> {
        let mut nearest: Option<(usize, Vec<_>)> = None;
        for branch in branches {
            if !self.may_take(branch, value) {
                continue;
            }
            let (n_faults, n_files) = (self.faults.len(), self.input_files.len());
            let read = self.read(branch, value, what);
            let faults = self.faults.split_off(n_faults);
            if faults.is_empty() {
                return read;
            }
            self.input_files.truncate(n_files);
            if nearest.as_ref().is_none_or(|(n, _)| faults.len() < *n) {
                nearest = Some((faults.len(), faults));
            }
        }
        match nearest {
            Some((_, faults)) => {
                self.faults.extend(faults);
                None
            }
            None => match self.tag(branches) {
                Some(tag) => self.wrong_tag(&tag, value, what),
                None => self.refuse(schema, value, what, "none of these"),
            },
        }
    }

    /// The key whose constant distinguishes the branches, and the constants.
    fn tag(&self, branches: &[&'a Json]) -> Option<(String, Vec<&'a str>)> {
        let words_of = |key: &str| -> Option<Vec<&'a str>> {
            let word = |branch: &&'a Json| {
                let schema = super::value_type::resolve(self.root, branch);
                schema.get("properties")?.get(key)?.get("const")?.as_str()
            };
            branches.iter().map(word).collect()
        };
        let first = super::value_type::resolve(self.root, branches.first()?);
        let mut keys = first.get("properties")?.as_object()?.keys();
        keys.find_map(|key| Some((key.clone(), words_of(key)?)))
    }

    fn wrong_tag(&mut self, (tag, words): &(String, Vec<&str>), value: &Spanned, what: &Quantity) -> Option<Json> {
        let list: Vec<_> = words.iter().map(|word| format!("\"{word}\"")).collect();
        let takes = format!("one of {}", list.join(", "));
        let Value::Table(table) = &value.value else {
            let fault = self.fault(what, &format!("a table with {tag}, {takes}"), value);
            self.faults.push(fault.at(&value.at, "no table"));
            return None;
        };
        let fault = match table.get(tag) {
            Some(entry) => {
                let inner = Quantity { name: format!("{}.{tag}", what.name), doc: what.doc.clone() };
                let found = entry.value.as_text().unwrap_or_default();
                let help = nearest::help(found, words.iter().copied());
                self.fault(&inner, &takes, &entry.value).at(&entry.value.at, "not one of them").help_if(help)
            }
            None => {
                let fault = Fault::new(format!("{}: {} does not say its {tag}", self.owner, what.name));
                let fault = fault.at(&value.at, format!("no {tag} here")).note_if(what.doc.clone());
                fault.help(format!("add {tag} = {}", list.join(" or "))).follows()
            }
        };
        self.faults.push(fault);
        None
    }

    /// Whether the value has the branch's type and, for a table, the branch's constants.
    fn may_take(&self, branch: &'a Json, value: &Spanned) -> bool {
        match (value_type(self.root, branch), &value.value) {
            (ValueType::Bool, Value::Bool(_)) | (ValueType::Int(_), Value::Int(_)) => true,
            (ValueType::Number(_), Value::Int(_) | Value::Float(_)) => true,
            (ValueType::Text | ValueType::Path | ValueType::Words(_), Value::Text(_)) => true,
            (ValueType::List { .. } | ValueType::Tuple(_), Value::Array(_)) => true,
            (ValueType::Table, Value::Table(table)) => {
                let schema = super::value_type::resolve(self.root, branch);
                let properties = schema.get("properties").and_then(Json::as_object);
                let words = properties.into_iter().flatten();
                let mut fixed = words.filter_map(|(key, property)| Some((key, property.get("const")?.as_str()?)));
                fixed.all(|(key, word)| table.get(key).and_then(|entry| entry.value.as_text()) == Some(word))
            }
            (ValueType::Union(_) | ValueType::Any, _) => true,
            _ => false,
        }
    }
}
