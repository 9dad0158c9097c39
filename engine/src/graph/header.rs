use super::{
    Table, Value,
    extract::{self, Section},
    grammar,
};
use crate::fault::{Fault, SourceText, Span};
use std::sync::Arc;

/// The version of the graph format that this crate reads.
pub(crate) const FORMAT: u64 = 1;

/// The contents of `[graph]`.
pub(crate) struct Header {
    pub(crate) name: String,
    pub(crate) seed: u64,
    /// The frames that the graph may name; any frame if `None`.
    pub(crate) frames: Option<(Vec<String>, Span)>,
    pub(crate) lossy: bool,
}

/// Reads the top level and `[graph]` of a graph file or a module.
pub(crate) fn read(table: &Table, main: &Arc<SourceText>, faults: &mut Vec<Fault>) -> Header {
    Section::new(table, &grammar::TOP, "a graph file", "", faults);
    let stem = main.name.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let mut header = Header { name: stem.unwrap_or_default(), seed: 0, frames: None, lossy: false };
    let Some(entry) = table.get("graph") else {
        let start = Span::new(main, 0..0);
        if table.0.is_empty() && main.text.trim().is_empty() {
            let fault = Fault::new("the graph file is empty").at(&start, "nothing here");
            faults
                .push(fault.help("was it saved? osteoflow new examples DIR writes graphs to begin from").hides(&start));
            return header;
        }
        let fault = Fault::new("the graph file does not say its format").at(&start, "no [graph] here");
        faults.push(fault.help("begin with a table [graph] that holds format = 1").follows());
        return header;
    };
    let Some(table) = extract::table(&entry.value, "graph", faults) else { return header };
    let table = Section::new(table, &grammar::GRAPH, "[graph]", "", faults);
    match table.get("format") {
        None => {
            let fault = Fault::new("the graph file does not say its format").at(&entry.key_at, "no format here");
            faults.push(fault.help("add format = 1").follows());
        }
        Some(format) => match format.value.value {
            Value::Int(found) if found == i128::from(FORMAT) => {}
            Value::Int(found) if found > i128::from(FORMAT) => {
                let fault =
                    Fault::new(format!("graph format {found} is newer than this program, which reads {FORMAT}"));
                faults.push(
                    fault.at(&format.value.at, "newer").help("use the program that wrote the file, or a newer one"),
                );
            }
            _ => {
                let takes = format!("format takes {FORMAT}");
                let fault = extract::refused(&format.value, takes, "no format that was ever written");
                faults.push(fault.help("write format = 1"));
            }
        },
    }
    if let Some(name) = table.text("name", faults) {
        header.name = name.into();
    }
    header.seed = table.whole("seed", u64::MAX, faults).unwrap_or(0);
    header.lossy = table.flag("lossy", faults);
    if let Some(frames) = table.get("frames") {
        let Value::Array(items) = &frames.value.value else {
            faults.push(extract::refused(&frames.value, "frames takes a list of names", "a list is needed"));
            return header;
        };
        let names = items.iter().filter_map(|item| extract::text(item, "a frame", faults)).map(str::to_owned);
        header.frames = Some((names.collect(), frames.value.at.clone()));
    }
    header
}
