use serde::{Deserialize, Serialize};

/// A warning of a node. As text, across the plugin interface and in the store, a sign is `rule`, the character U+001F and the
/// message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", from = "String")]
pub struct NodeWarning {
    /// The rule that found a sign that an input is wrong; `None` if the warning is no such sign.
    pub rule: Option<String>,
    /// The message.
    pub message: String,
}

const SEPARATOR: char = '\u{1f}';

impl From<String> for NodeWarning {
    fn from(text: String) -> Self {
        let is_rule = |rule: &str| {
            let is_word = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_';
            (1..=64).contains(&rule.len()) && rule.bytes().all(is_word)
        };
        match text.split_once(SEPARATOR).filter(|(rule, _)| is_rule(rule)) {
            Some((rule, message)) => Self { rule: Some(rule.into()), message: message.into() },
            None => Self { rule: None, message: text },
        }
    }
}

impl From<NodeWarning> for String {
    fn from(NodeWarning { rule, message }: NodeWarning) -> Self {
        match rule {
            Some(rule) => format!("{rule}{SEPARATOR}{message}"),
            None => message,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sign_keeps_its_rule_as_text_and_a_warning_gets_none() {
        let check = |rule: Option<&str>, message: &str| {
            let warning = NodeWarning { rule: rule.map(str::to_owned), message: message.into() };
            assert_eq!(NodeWarning::from(String::from(warning.clone())), warning);
        };
        check(None, "the scan is small");
        check(None, "");
        check(None, "frame: the scan is in camera");
        check(Some("poses_inverted"), "the tip lies 844 mm off; invert them");
        check(Some("a"), "a message\u{1f}with the separator");
        check(None, "no word\u{1f}before the separator");
        check(None, "\u{1f}");
    }
}
