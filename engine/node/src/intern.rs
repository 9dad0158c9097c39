//! Texts that live until the program ends.

use std::{
    collections::BTreeSet,
    sync::{Mutex, PoisonError},
};

static INTERNED: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());

/// The text with a static lifetime; equal texts share one copy.
pub(crate) fn intern(text: &str) -> &'static str {
    let mut interned = INTERNED.lock().unwrap_or_else(PoisonError::into_inner);
    match interned.get(text) {
        Some(text) => text,
        None => {
            let text: &'static str = String::leak(text.to_owned());
            interned.insert(text);
            text
        }
    }
}
