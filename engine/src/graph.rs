//! A graph file as read: `extends` and `--set` merged into one tree, every value with the place it was written at.

mod edit;
mod extends;
pub(crate) mod grammar;
pub(crate) mod header;
mod interface;
mod merge;
mod modules;
mod parse;
pub(crate) mod plugins;
mod remove;
mod results;
mod set;
mod syntax;
pub(crate) mod take;
mod tree;
pub(crate) mod unit;

pub(crate) use {
    interface::{Inlet, Interface, Knob, Outlet},
    modules::{KIND as MODULE, Module, no_results},
    remove::Removed,
    set::{SetKey, keys_set, table_of},
    tree::{Entry, Spanned, Table, Value},
};

pub use set::Given;

use crate::{
    fault::{Fault, SourceText, Span},
    graph::plugins::NamedPlugin,
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// The merged tree of a graph, with nodes in the place of modules.
pub(crate) struct Graph {
    /// The top-level table.
    pub(crate) table: Table,
    /// The graph file itself.
    pub(crate) main: Arc<SourceText>,
    /// What was taken away by `remove`.
    pub(crate) removed: Removed,
    /// The modules that nodes have taken the place of.
    pub(crate) modules: Vec<Module>,
    /// What the file declares, if it is a module itself.
    pub(crate) interface: Option<Interface>,
    /// The files of the text: the graph file, what it extends and the modules it uses, whether they could be read or not.
    pub(crate) texts: Vec<PathBuf>,
    /// The plugins that these files name: of a file after those of what it extends, of modules last.
    pub(crate) plugins: Vec<NamedPlugin>,
}

impl Graph {
    /// The very beginning of the graph file, for faults about what is not there.
    pub(crate) fn start(&self) -> Span {
        Span::new(&self.main, 0..0)
    }
}

/// Reads the graph file at `path`, what it extends, the modules it uses, and the command line's settings.
pub(crate) fn load(path: &Path, sets: &[String], faults: &mut Vec<Fault>) -> Option<Graph> {
    match extends::read(path) {
        Ok(text) => Some(load_text(text, path, sets, faults)),
        Err(fault) => {
            faults.push(*fault);
            None
        }
    }
}

/// The same for a run of a sweep, whose settings stand in the graph file.
pub(crate) fn load_row(path: &Path, sets: &[String], row: &[String], faults: &mut Vec<Fault>) -> Option<Graph> {
    match extends::read(path) {
        Ok(text) => Some(load_with(text, path, &[set::Sets::command_line(sets), set::Sets::row(row, path)], faults)),
        Err(fault) => {
            faults.push(*fault);
            None
        }
    }
}

/// The same for a run of a sweep, from the text of its frozen graph; `sets` come after what the run set.
pub(crate) fn load_frozen(
    text: String,
    path: &Path,
    row: &[String],
    sets: &[String],
    faults: &mut Vec<Fault>,
) -> Graph {
    load_with(text, path, &[set::Sets::row(row, path), set::Sets::command_line(sets)], faults)
}

/// The same with the text of the graph file at hand.
pub(crate) fn load_text(text: String, path: &Path, sets: &[String], faults: &mut Vec<Fault>) -> Graph {
    load_with(text, path, &[set::Sets::command_line(sets)], faults)
}

fn load_with(text: String, path: &Path, sets: &[set::Sets<'_>], faults: &mut Vec<Fault>) -> Graph {
    let mut removed = Removed::default();
    let mut chain = extends::Chain::new(path, &mut removed, faults);
    let (main, mut table) = chain.load(text);
    let n_texts = chain.len();
    let mut texts = vec![path.into()];
    texts.append(&mut chain.texts);
    let mut plugins = std::mem::take(&mut chain.plugins);
    let edits = sets.iter().flat_map(|sets| set::apply(&mut table, sets, &mut removed, faults)).collect();
    let interface = interface::read(&mut table, faults);
    if let Some(interface) = &interface {
        modules::stand_alone(&mut table, interface, faults);
    }
    let within = modules::Flattener::new(path, n_texts, &mut removed, faults).flatten(&mut table, edits);
    texts.extend(within.texts);
    plugins.extend(within.plugins);
    Graph { table, main, removed, modules: within.modules, interface, texts, plugins }
}
