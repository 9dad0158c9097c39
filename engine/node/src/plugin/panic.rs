//! Catches panics before they leave the plugin.

use std::{
    cell::RefCell,
    panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook, take_hook},
    sync::Once,
};

thread_local! {
    /// Message and location of the latest panic of this thread within [`catch`].
    static LATEST: RefCell<Option<String>> = const { RefCell::new(None) };
    static WITHIN: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// The result of `f`, or `panicked at FILE:LINE: MESSAGE`.
pub(super) fn catch<T>(f: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    // The hook belongs to the standard library of the plugin, not to that of the program.
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| match WITHIN.get() {
            true => drop(LATEST.replace(Some(describe(info)))),
            false => before(info),
        }));
    });
    let outside = WITHIN.replace(true);
    let result = catch_unwind(AssertUnwindSafe(f));
    WITHIN.set(outside);
    result.map_err(|payload| {
        // Dropping the payload may panic again.
        if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
            std::mem::forget(second);
        }
        LATEST.take().unwrap_or_else(|| "panicked".into())
    })
}

fn describe(info: &PanicHookInfo<'_>) -> String {
    let payload = info.payload();
    let message = payload.downcast_ref::<&str>().copied();
    let message =
        message.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a message");
    match info.location() {
        Some(at) => format!("panicked at {}:{}: {message}", at.file(), at.line()),
        None => format!("panicked: {message}"),
    }
}
