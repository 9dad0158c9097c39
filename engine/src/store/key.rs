use super::payload;
use crate::hash::Digest;
use osteoflow_node::Value;
use sha2::{Digest as _, Sha256};
use std::fmt;

/// The key of an entry: a namespace, and the SHA-256 of all inputs that determine the entry's content.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Key {
    space: &'static str,
    digest: Digest,
}

impl Key {
    /// Starts a key in a namespace such as `answer`: lower-case letters and underscores.
    ///
    /// # Panics
    /// If the namespace has other characters, which is a bug of ours.
    pub fn of(space: &'static str) -> KeyBuilder {
        let plain = |c: u8| c.is_ascii_lowercase() || c == b'_';
        assert!(!space.is_empty() && space.bytes().all(plain), "\"{space}\" is no name for a space of keys");
        let mut hasher = Sha256::new();
        hasher.update(FORMAT);
        KeyBuilder { space, hasher }.text("space", space)
    }

    /// The digest.
    pub fn digest(&self) -> Digest {
        self.digest
    }
}

/// `space-0123abcd...`
impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.space, self.digest)
    }
}

/// Incremented when the hashing of parts changes, so that older entries no longer match.
const FORMAT: &[u8] = b"osteoflow key 1\n";

/// Builds a key from named parts; their order matters.
#[derive(Clone)]
pub struct KeyBuilder {
    space: &'static str,
    hasher: Sha256,
}

impl KeyBuilder {
    /// Adds named bytes.
    #[must_use]
    pub fn bytes(mut self, name: &str, bytes: &[u8]) -> Self {
        self.begin(name, bytes.len());
        self.hasher.update(bytes);
        self
    }

    /// Adds a named text.
    #[must_use]
    pub fn text(self, name: &str, text: &str) -> Self {
        self.bytes(name, text.as_bytes())
    }

    /// Adds a named number.
    #[must_use]
    pub fn number(self, name: &str, number: u64) -> Self {
        self.bytes(name, &number.to_le_bytes())
    }

    /// Adds named JSON, independent of the order of an object's keys.
    #[must_use]
    pub fn json(self, name: &str, json: &serde_json::Value) -> Self {
        let mut sorted = json.clone();
        sorted.sort_all_objects();
        self.text(name, &sorted.to_string())
    }

    /// Adds a named payload: its type, the version of its view, and the bits of its view.
    #[must_use]
    pub fn value(mut self, name: &str, value: &Value) -> Self {
        let message = payload::message(value);
        self.begin(name, message.len());
        message.slices().for_each(|slice| self.hasher.update(slice));
        self
    }

    /// Adds a digest computed elsewhere.
    #[must_use]
    pub fn digest(self, name: &str, digest: Digest) -> Self {
        self.bytes(name, &digest.0)
    }

    /// Finishes the key.
    pub fn done(self) -> Key {
        Key { space: self.space, digest: Digest(self.hasher.finalize().into()) }
    }

    /// Writes name and length before the bytes, so that different lists of parts cannot collide.
    fn begin(&mut self, name: &str, n_bytes: usize) {
        self.hasher.update((name.len() as u64).to_le_bytes());
        self.hasher.update(name);
        self.hasher.update((n_bytes as u64).to_le_bytes());
    }
}
