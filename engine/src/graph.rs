//! A graph file as read: `extends` and `--set` merged into one tree, every value with the place it was written at.

mod extends;
mod merge;
mod parse;
mod results;
mod set;
mod syntax;
mod tree;

pub(crate) use tree::{Entry, Spanned, Table, Value};

use crate::fault::{Fault, SourceText, Span};
use std::{path::Path, sync::Arc};

/// The merged tree of a graph.
pub(crate) struct Graph {
    /// The top-level table.
    pub(crate) table: Table,
    /// The graph file itself.
    pub(crate) main: Arc<SourceText>,
}

impl Graph {
    /// The very beginning of the graph file, for faults about what is not there.
    pub(crate) fn start(&self) -> Span {
        Span::new(&self.main, 0..0)
    }
}

/// Reads the graph file at `path`, what it extends, and the command line's settings.
pub(crate) fn load(path: &Path, sets: &[String], faults: &mut Vec<Fault>) -> Option<Graph> {
    match extends::read(path) {
        Ok(text) => Some(load_text(text, path, sets, faults)),
        Err(fault) => {
            faults.push(*fault);
            None
        }
    }
}

/// The same with the text of the graph file at hand.
pub(crate) fn load_text(text: String, path: &Path, sets: &[String], faults: &mut Vec<Fault>) -> Graph {
    let mut chain = extends::Chain::new(path, faults);
    let (main, mut table) = chain.load(text);
    let n_texts = chain.len();
    set::apply(&mut table, sets, n_texts, faults);
    Graph { table, main }
}
