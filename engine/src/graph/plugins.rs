use super::tree::{Table, Value};
use crate::{fault::Fault, plugin::Named};

/// What a file names under `plugins`, taken out of its table.
pub(super) fn take(table: &mut Table, faults: &mut Vec<Fault>) -> Vec<Named> {
    let Some(entry) = table.remove("plugins") else { return Vec::new() };
    let Value::Array(items) = &entry.value.value else {
        let message = format!("plugins takes a list of libraries, found {}", entry.value.found());
        let fault = Fault::new(message).at(&entry.value.at, "a list is needed");
        faults.push(fault.help("write plugins = [\"libmy_nodes.so\"]"));
        return Vec::new();
    };
    let named = items.iter().filter_map(|item| match item.as_text() {
        Some(text) => Some(Named { text: text.into(), dir: item.at.dir().into(), at: Some(item.at.clone()) }),
        None => {
            let fault = Fault::new(format!("a plugin is named by the path of its library, found {}", item.found()));
            faults.push(fault.at(&item.at, "a text is needed"));
            None
        }
    });
    named.collect()
}
