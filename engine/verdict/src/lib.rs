//! The words of a verdict on results, for the rules that give one and for the runs that carry it.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Answer of a verdict, or of one of its reasons; a greater one is worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Nothing speaks against the result.
    Trusted,
    /// Something speaks against the result, but does not exclude it.
    Doubtful,
    /// The result must not be used.
    Refused,
}

impl Answer {
    /// Every answer, the best first.
    pub const ALL: [Self; 3] = [Self::Trusted, Self::Doubtful, Self::Refused];

    /// `trusted`, `doubtful` or `refused`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
            Self::Refused => "refused",
        }
    }
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What one rule says about a result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reason {
    /// The rule, a name that does not change.
    pub rule: String,
    /// The best answer that it allows.
    pub answer: Answer,
    /// What is wrong, with numbers and the likely cause.
    pub reason: String,
    /// What to do about it; may be empty.
    pub remedy: String,
}

impl Reason {
    /// What a rule says.
    pub fn new(rule: &str, answer: Answer, reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { rule: rule.into(), answer, reason: reason.into(), remedy: remedy.into() }
    }

    /// The reason as the sentence of a verdict that `n_others` more reasons speak for.
    pub fn sentence(&self, n_others: usize) -> String {
        match n_others {
            0 => self.reason.clone(),
            1 => format!("{}, and 1 more reason", self.reason),
            n => format!("{}, and {n} more reasons", self.reason),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.reason)?;
        if self.remedy.is_empty() { Ok(()) } else { write!(f, "; {}", self.remedy) }
    }
}
