//! Changes of the keys of a graph.

use std::fmt;

/// The value of a key: a boolean, number, text, list or table.
pub type SettingValue = toml::Value;

/// Values by the paths of their keys, such as `icp.max_iterations`, in the order in which they are set.
#[derive(Debug, Clone, Default)]
pub struct Settings(Vec<String>);

impl Settings {
    /// Sets a key.
    pub fn set(&mut self, key: impl fmt::Display, value: &SettingValue) {
        self.0.push(format!("{key}={value}"));
    }

    /// Sets a key by a text, KEY=VALUE; the check of the graph reads it.
    pub fn set_text(&mut self, text: impl Into<String>) {
        self.0.push(text.into());
    }

    /// Each setting as `--set` takes it.
    pub fn texts(&self) -> &[String] {
        &self.0
    }
}

impl From<Vec<String>> for Settings {
    /// Settings of a command line, each KEY=VALUE.
    fn from(texts: Vec<String>) -> Self {
        Self(texts)
    }
}
