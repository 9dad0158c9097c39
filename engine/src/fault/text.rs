use crate::plan::Location;
use std::{
    fmt,
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

/// A text that a graph was read from: a file of its `extends` chain, or the command line.
pub struct SourceText {
    /// Its name in faults.
    pub name: PathBuf,
    /// The folder that its relative paths are relative to.
    pub dir: PathBuf,
    /// The text.
    pub text: String,
    /// Its position among the texts of the graph: the graph file, the files it extends, the modules, and last the
    /// command line.
    pub order: usize,
    /// Whether it is the command line.
    pub command_line: bool,
    /// Its position among the files that are merged one over the other into a graph or a module.
    pub merged: OnceLock<usize>,
    /// The use of the module, if it is the file of a module or extended by one.
    pub used: Option<Use>,
    /// Where its lines begin.
    pub line_starts: OnceLock<Vec<usize>>,
}

/// A use of a module.
pub struct Use {
    /// The full name of the node.
    pub node: String,
    /// Where the node begins.
    pub at: Span,
}

impl SourceText {
    /// Index of the line that has a byte, and where it begins.
    fn line(&self, offset: usize) -> (usize, usize) {
        let starts = self.line_starts.get_or_init(|| {
            let behind = self.text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at + 1);
            std::iter::once(0).chain(behind).collect()
        });
        let line = starts.partition_point(|start| *start <= offset) - 1;
        (line, starts[line])
    }

    /// The bytes of the lines of a range, with those around it, and the number of the first.
    pub(super) fn lines(&self, range: Range<usize>) -> (usize, Range<usize>) {
        let (line, start) = self.line(range.start.min(self.text.len()));
        let end =
            self.text[range.end.min(self.text.len())..].find('\n').map_or(self.text.len(), |at| range.end + at + 1);
        (line + 1, start..end)
    }

    /// Whether it has the settings of a run of a sweep.
    pub(crate) fn is_sweep(&self) -> bool {
        self.command_line && self.name.to_string_lossy().starts_with("[sweep]")
    }

    /// Whether its values replace those of another text.
    pub(crate) fn is_over(&self, other: &Self) -> bool {
        let module = |text: &Self| text.used.as_ref().map(|used| used.node.clone());
        match (self.command_line, other.command_line) {
            (true, other) => !other,
            (false, true) => false,
            (false, false) if module(self) == module(other) => self.merged.get() > other.merged.get(),
            (false, false) => self.order < other.order,
        }
    }
}

impl fmt::Debug for SourceText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.name.display())
    }
}

/// A range of bytes in a text.
#[derive(Debug, Clone)]
pub struct Span {
    /// The text.
    pub source: Arc<SourceText>,
    /// The bytes.
    pub range: Range<usize>,
}

impl Span {
    pub(crate) fn new(source: &Arc<SourceText>, range: Range<usize>) -> Self {
        Self { source: source.clone(), range }
    }

    /// The text in the range.
    pub fn text(&self) -> &str {
        self.source.text.get(self.range.clone()).unwrap_or_default()
    }

    /// Where it begins.
    pub fn location(&self) -> Location {
        let (line, column) = self.position(self.range.start);
        Location { file: self.source.name.clone(), line, column }
    }

    /// Line and column of its end, counted from 1; the column counts characters.
    pub fn end(&self) -> (usize, usize) {
        self.position(self.range.end)
    }

    fn position(&self, offset: usize) -> (usize, usize) {
        let text = &self.source.text;
        let offset = if text.is_char_boundary(offset) { offset } else { text.len() };
        let (line, start) = self.source.line(offset);
        (line + 1, text[start..offset].chars().count() + 1)
    }

    /// Sort key for the order in which faults are shown.
    pub(crate) fn key(&self) -> (usize, usize) {
        (self.source.order, self.range.start)
    }

    /// Whether both begin on the same line of the same text.
    fn same_line(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.source, &other.source) && self.location().line == other.location().line
    }

    /// Whether `other` begins inside it or on the same line.
    pub(crate) fn covers(&self, other: &Self) -> bool {
        let inside = Arc::ptr_eq(&self.source, &other.source) && self.range.contains(&other.range.start);
        inside || self.same_line(other)
    }

    /// The folder that relative paths written here are relative to.
    pub(crate) fn dir(&self) -> &Path {
        &self.source.dir
    }
}
