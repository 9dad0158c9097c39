//! Panics of the plugin, caught where they would leave it.

use std::{
    cell::RefCell,
    panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook, take_hook},
    sync::Once,
};

thread_local! {
    /// The words and the place of this thread's latest panic within [`catch`].
    static LATEST: RefCell<Option<String>> = const { RefCell::new(None) };
    static WITHIN: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// What `f` answers, or `panicked at FILE:LINE: WORDS`.
pub(super) fn catch<T>(f: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    // The hook is the plugin's own, as its standard library is.
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| match WITHIN.get() {
            true => drop(LATEST.replace(Some(told(info)))),
            false => before(info),
        }));
    });
    let outside = WITHIN.replace(true);
    let result = catch_unwind(AssertUnwindSafe(f));
    WITHIN.set(outside);
    result.map_err(|payload| {
        // Dropping what was thrown may panic again.
        if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
            std::mem::forget(second);
        }
        LATEST.take().unwrap_or_else(|| "panicked".into())
    })
}

fn told(info: &PanicHookInfo<'_>) -> String {
    let payload = info.payload();
    let words = payload.downcast_ref::<&str>().copied();
    let words = words.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a message");
    match info.location() {
        Some(at) => format!("panicked at {}:{}: {words}", at.file(), at.line()),
        None => format!("panicked: {words}"),
    }
}
