use super::{
    Quantity, Walker,
    shape::{Shape, shape},
};
use crate::graph::{Spanned, Value};
use serde_json::Value as Json;

impl<'a> Walker<'a> {
    /// The first branch that takes the value; else the faults of the branch that comes nearest.
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
            None => self.refuse(schema, value, what, "none of these"),
        }
    }

    /// Whether the value is of the branch's type, and for a table, whether its fixed words agree.
    fn may_take(&self, branch: &'a Json, value: &Spanned) -> bool {
        match (shape(self.root, branch), &value.value) {
            (Shape::Bool, Value::Bool(_)) | (Shape::Int(_), Value::Int(_)) => true,
            (Shape::Number(_), Value::Int(_) | Value::Float(_)) => true,
            (Shape::Text | Shape::Path | Shape::Words(_), Value::Text(_)) => true,
            (Shape::List { .. } | Shape::Tuple(_), Value::Array(_)) => true,
            (Shape::Table, Value::Table(table)) => {
                let schema = super::shape::resolve(self.root, branch);
                let properties = schema.get("properties").and_then(Json::as_object);
                let words = properties.into_iter().flatten();
                let mut fixed = words.filter_map(|(key, property)| Some((key, property.get("const")?.as_str()?)));
                fixed.all(|(key, word)| table.get(key).and_then(|entry| entry.value.as_text()) == Some(word))
            }
            (Shape::Union(_) | Shape::Any, _) => true,
            _ => false,
        }
    }
}
