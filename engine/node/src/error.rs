use std::fmt;

/// Why a node gave no result. The engine adds file, line, node and item.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeError {
    /// What was expected, what was found, and a next step; lower case, no full stop.
    pub message: String,
}

impl NodeError {
    /// An error with this message.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into() }
    }
}

impl fmt::Display for NodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

/// Converts any error; the message includes its causes.
impl<E: std::error::Error> From<E> for NodeError {
    fn from(error: E) -> Self {
        let mut message = error.to_string();
        let mut cause = error.source();
        while let Some(error) = cause {
            let text = error.to_string();
            if !message.contains(&text) {
                message = format!("{message}: {text}");
            }
            cause = error.source();
        }
        Self { message }
    }
}

/// A parameter value with which no node can be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct ParamError {
    /// The parameter at fault, so that the engine can point at its line; empty if several are.
    pub parameter: String,
    /// What was expected, what was found, what to write instead.
    pub message: String,
}

impl ParamError {
    /// An error in `parameter`.
    pub fn new(parameter: impl Into<String>, message: impl Into<String>) -> Self {
        Self { parameter: parameter.into(), message: message.into() }
    }

    /// The message for the table of `node` in a graph.
    pub fn in_node(&self, node: &str) -> String {
        match self.parameter.as_str() {
            "" => format!("node \"{node}\": {}", self.message),
            parameter => format!("node \"{node}\": parameter \"{parameter}\": {}", self.message),
        }
    }

    /// The path of the parameter, then those of the tables that hold it, from the inside out.
    pub fn paths(&self) -> impl Iterator<Item = &str> {
        std::iter::successors(Some(self.parameter.as_str()), |path| path.rsplit_once('.').map(|(table, _)| table))
    }
}
