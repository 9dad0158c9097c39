//! Faults of a graph: place, what was expected, what was found, and a suggestion.

use crate::plan::Location;
use serde_json::{Value as Json, json};
use std::fmt;

mod render;
mod text;

pub use text::{SourceText, Span, Use};

/// Severity of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// The graph cannot run.
    Error,
    /// The graph runs, but probably not as intended.
    Warning,
}

/// Something wrong with a graph, at a place in a file or on the command line.
#[derive(Debug, Clone)]
pub struct Fault {
    /// Error or warning.
    pub severity: Severity,
    /// What is wrong; lower case, no full stop.
    pub message: String,
    /// The place, and the label at its caret; a file that cannot be read has none.
    pub at: Option<(Span, String)>,
    /// Related places, with labels.
    pub also: Vec<(Span, String)>,
    /// Additional information.
    pub notes: Vec<String>,
    /// Suggestions.
    pub help: Vec<String>,
    /// Path of a key, as `remove` takes it, without which the fault is gone.
    pub removes: Option<String>,
    /// Whether it may be only a consequence of a syntax fault elsewhere.
    pub(crate) follows: bool,
    /// The text that could not be read because of it; faults inside that text are unreliable.
    pub(crate) hides: Option<Span>,
}

impl Fault {
    /// An error of this message, without a place.
    pub fn new(message: impl Into<String>) -> Self {
        let severity = Severity::Error;
        let (at, also, notes, help) = (None, Vec::new(), Vec::new(), Vec::new());
        Self { severity, message: message.into(), at, also, notes, help, removes: None, follows: false, hides: None }
    }

    pub(crate) fn warning(mut self) -> Self {
        self.severity = Severity::Warning;
        self
    }

    pub(crate) fn at(mut self, span: &Span, label: impl Into<String>) -> Self {
        self.at = Some((span.clone(), label.into()));
        self
    }

    pub(crate) fn also(mut self, span: &Span, label: impl Into<String>) -> Self {
        self.also.push((span.clone(), label.into()));
        self
    }

    pub(crate) fn note(mut self, note: impl Into<String>) -> Self {
        self.notes.push(note.into());
        self
    }

    /// Adds a suggestion.
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help.push(help.into());
        self
    }

    pub(crate) fn help_if(mut self, help: Option<String>) -> Self {
        self.help.extend(help);
        self
    }

    pub(crate) fn note_if(mut self, note: Option<String>) -> Self {
        self.notes.extend(note);
        self
    }

    /// Adds a suggestion and a list, as [`nearest::hint`](crate::names::nearest::hint) gives them.
    pub(crate) fn hint(self, (help, list): (Option<String>, Option<String>)) -> Self {
        self.help_if(help).note_if(list)
    }

    /// Marks the fault as a possible consequence of a syntax fault.
    pub(crate) fn follows(mut self) -> Self {
        self.follows = true;
        self
    }

    /// Marks text that could not be read, so that other things may seem to be missing.
    pub(crate) fn hides(mut self, span: &Span) -> Self {
        self.hides = Some(span.clone());
        self
    }

    /// Adds an alternative: `or ..` if there is help already.
    pub(crate) fn or_help(self, help: impl std::fmt::Display) -> Self {
        let or = if self.help.is_empty() { "" } else { "or " };
        self.help(format!("{or}{help}"))
    }

    /// Its place in a file.
    pub fn location(&self) -> Option<Location> {
        self.at.as_ref().map(|(span, _)| span.location())
    }

    /// Renders the fault in the style of rustc: message, file, line and column, the line with a caret, and help; with
    /// colours for a terminal, or plain.
    pub fn render(&self, colour: bool) -> String {
        render::render(self, colour)
    }

    /// The fault as JSON: `severity`, `message`, `file`, `line`, `column`, `end_line`, `end_column`, `label`, `also`,
    /// `notes` and `help`.
    pub fn to_json(&self) -> Json {
        let place = |(span, label): &(Span, String)| {
            let (start, (end_line, end_column)) = (span.location(), span.end());
            json!({
                "file": start.file.display().to_string(), "line": start.line, "column": start.column,
                "end_line": end_line, "end_column": end_column, "label": label,
            })
        };
        let severity = if self.severity == Severity::Error { "error" } else { "warning" };
        let mut fault = json!({ "severity": severity, "message": self.message });
        if let Some(Json::Object(place)) = self.at.as_ref().map(place) {
            place.into_iter().for_each(|(key, value)| fault[key] = value);
        }
        fault["also"] = self.also.iter().map(place).collect();
        (fault["notes"], fault["help"]) = (json!(self.notes), json!(self.help));
        fault
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

/// All faults of a graph, in the order of the files; the command line comes last.
#[derive(Debug, Clone, Default)]
pub struct Faults(pub Vec<Fault>);

impl Faults {
    /// Renders all faults and their number in the style of rustc, with colours for a terminal or plain.
    pub fn render(&self, colour: bool) -> String {
        let mut text: Vec<_> = self.0.iter().map(|fault| fault.render(colour)).collect();
        text.push(self.summary());
        text.join("\n\n")
    }

    /// The number of faults: `3 errors, 1 warning`.
    pub fn summary(&self) -> String {
        let count = |severity| self.0.iter().filter(|f| f.severity == severity).count();
        let say = |n: usize, word: &str| format!("{n} {word}{}", if n == 1 { "" } else { "s" });
        match (count(Severity::Error), count(Severity::Warning)) {
            (errors, 0) => say(errors, "error"),
            (0, warnings) => say(warnings, "warning"),
            (errors, warnings) => format!("{}, {}", say(errors, "error"), say(warnings, "warning")),
        }
    }

    /// The faults as a list of [`Fault::to_json`].
    pub fn to_json(&self) -> Json {
        self.0.iter().map(Fault::to_json).collect()
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for Faults {}
