//! Cells of tables on pages and terminals.

use crate::format::number;
use serde_json::Value as Json;

/// A cell of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// A number.
    Number(f64),
    /// A word or a sentence.
    Word(String),
    /// Code.
    Code(String),
}

impl Cell {
    /// From a JSON value: numbers as numbers, lists and objects as text.
    pub(crate) fn of(value: &Json) -> Self {
        match value {
            Json::Null => Self::Word("\u{2013}".into()),
            // Nanoseconds since 1970 have more digits than a float.
            Json::Number(number) if number.as_i64().is_some_and(|n| n.unsigned_abs() > 1 << f64::MANTISSA_DIGITS) => {
                Self::Word(number.to_string())
            }
            Json::Number(number) => Self::Number(number.as_f64().unwrap_or(f64::NAN)),
            Json::String(text) => Self::Word(text.clone()),
            Json::Bool(true) => Self::Word("yes".into()),
            Json::Bool(false) => Self::Word("no".into()),
            Json::Array(items) if items.iter().all(Json::is_number) => {
                let items: Vec<_> = items.iter().map(|item| number(item.as_f64().unwrap_or(f64::NAN))).collect();
                Self::Word(items.join(", "))
            }
            other => Self::Code(other.to_string()),
        }
    }

    pub(crate) fn word(text: impl Into<String>) -> Self {
        Self::Word(text.into())
    }

    /// Plain text for terminals and text files.
    pub fn plain(&self) -> String {
        let text = match self {
            Self::Number(value) => number(*value),
            Self::Word(text) | Self::Code(text) => text.clone(),
        };
        text.replace('\u{2212}', "-").replace('\u{a0}', " ")
    }

    pub(crate) fn is_empty(&self) -> bool {
        matches!(self, Self::Word(text) if text.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_with_more_digits_than_a_float_are_text() {
        assert_eq!(Cell::of(&1_700_000_000_123_456_789_i64.into()).plain(), "1700000000123456789");
    }
}
