//! Reads a graph file: merges `extends` and `--set` into one tree that records where each value was written.

pub(crate) mod difference;
mod edit;
mod extends;
pub(crate) mod extract;
pub(crate) mod grammar;
pub(crate) mod header;
mod interface;
mod limits;
mod merge;
mod modules;
mod parse;
pub(crate) mod plugins;
mod remove;
mod results;
mod set;
mod syntax;
mod tree;
pub(crate) mod unit;
pub(crate) mod written;

pub(crate) use {
    extends::tidy,
    interface::{InputDecl, Interface, OutputDecl, ParamDecl},
    modules::{KIND as MODULE, Module, no_results},
    remove::Removed,
    set::{SetKey, Sets, keys_set, setting_value, table_of},
    tree::{Entry, Spanned, Table, Value},
};

pub use extends::Variant;
pub use set::CommandLineParam;

use crate::{
    fault::{Fault, SourceText, Span},
    graph::plugins::NamedPlugin,
};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// The merged tree of a graph, with modules replaced by their nodes.
pub(crate) struct Graph {
    /// The top-level table.
    pub(crate) table: Table,
    /// The graph file itself.
    pub(crate) main: Arc<SourceText>,
    /// The paths removed by `remove`.
    pub(crate) removed: Removed,
    /// The modules that were replaced by their nodes.
    pub(crate) modules: Vec<Module>,
    /// The interface that the file declares, if it is a module.
    pub(crate) interface: Option<Interface>,
    /// All files of the graph: the graph file, the files it extends and the modules it uses, whether or not they could
    /// be read.
    pub(crate) texts: Vec<PathBuf>,
    /// The plugins named by these files: those of a file follow those of the file it extends, those of modules come
    /// last.
    pub(crate) plugins: Vec<NamedPlugin>,
}

impl Graph {
    /// The folder of the graph file, as the file is shown.
    pub(crate) fn folder(&self) -> &Path {
        self.texts[0].parent().unwrap_or(Path::new(""))
    }

    /// The first byte of the graph file, for faults about something missing.
    pub(crate) fn start(&self) -> Span {
        Span::new(&self.main, 0..0)
    }
}

/// Reads the graph file at `path`, the files it extends, the modules it uses, and settings in their order.
pub(crate) fn load(path: &Path, sets: &[Sets<'_>], faults: &mut Vec<Fault>) -> Option<Graph> {
    match extends::read(path) {
        Ok(text) => Some(load_text(text, path, sets, faults)),
        Err(fault) => {
            faults.push(*fault);
            None
        }
    }
}

/// Reads a graph from the text of its graph file.
pub(crate) fn load_text(text: String, path: &Path, sets: &[Sets<'_>], faults: &mut Vec<Fault>) -> Graph {
    let mut removed = Removed::default();
    let mut chain = extends::Chain::new(&mut removed, faults);
    let (main, mut table) = chain.load(path, text);
    let edits = sets.iter().flat_map(|sets| set::apply(&mut table, sets, &mut chain)).collect();
    let n_texts = chain.len();
    let mut texts = vec![path.into()];
    texts.append(&mut chain.texts);
    let mut plugins = std::mem::take(&mut chain.plugins);
    let interface = interface::read(&mut table, faults);
    if let Some(interface) = &interface {
        modules::prepare_alone(&mut table, interface, faults);
    }
    let mut flattener = modules::Flattener::new(path, n_texts, &mut removed, faults);
    flattener.flatten(&mut table, edits);
    texts.extend(flattener.texts);
    plugins.extend(flattener.plugins);
    let modules = flattener.modules;
    Graph { table, main, removed, modules, interface, texts, plugins }
}
