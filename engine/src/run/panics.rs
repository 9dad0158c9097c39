//! A node's panic, caught and told as its error.

use std::{
    any::Any,
    cell::{Cell, RefCell},
    panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook},
    sync::Once,
};

thread_local! {
    static IN_NODE: Cell<bool> = const { Cell::new(false) };
    static PLACE: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// What `f` answers, or what it said when it panicked and where.
///
/// The first call puts a hook before the process's own, which keeps the place of a node's panic in the place of printing
/// it; all other panics go to the hook that was there.
pub(crate) fn catch<T>(f: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| {
            if IN_NODE.get() {
                let place = info.location().map(|at| format!("{}:{}", short(at.file()), at.line()));
                PLACE.with(|cell| *cell.borrow_mut() = place);
            } else {
                before(info);
            }
        }));
    });
    let outside = IN_NODE.replace(true);
    let result = catch_unwind(AssertUnwindSafe(f));
    IN_NODE.set(outside);
    result.map_err(|payload| {
        let message = message_of(&*payload);
        match PLACE.with(RefCell::take) {
            Some(place) => format!("panicked at {place}: {message}"),
            None => format!("panicked: {message}"),
        }
    })
}

fn message_of(payload: &(dyn Any + Send)) -> &str {
    let text = payload.downcast_ref::<&str>().copied();
    text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a message")
}

/// The path from the crate's folder on: where the machine keeps its sources is no part of a result.
fn short(file: &str) -> String {
    let parts: Vec<&str> = file.split(['/', '\\']).collect();
    match parts.iter().rposition(|part| *part == "src") {
        Some(src) if std::path::Path::new(file).is_absolute() => parts[src.saturating_sub(1)..].join("/"),
        _ => parts.join("/"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_told_with_its_words_and_place() {
        let said = catch(|| panic!("no {}", 42)).unwrap_err();
        assert!(said.starts_with("panicked at ") && said.ends_with(": no 42"), "{said}");
        assert!(said.contains("run/panics.rs:"), "{said}");
        assert_eq!(catch(|| 5), Ok(5));
    }

    #[test]
    fn a_place_outside_the_workspace_is_told_from_its_crate_on() {
        assert_eq!(short("/home/x/.cargo/registry/src/index-1/kiddo-6.3.0/src/tree.rs"), "kiddo-6.3.0/src/tree.rs");
        assert_eq!(short("engine/src/run/panics.rs"), "engine/src/run/panics.rs");
    }
}
