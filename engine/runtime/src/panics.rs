//! Catches a node's panic and describes it as an error.
//!
//! Panics of nodes bypass the process's panic hook: message and location are stored and reported with the node's
//! failure. `rayon` carries a panic of a helper thread (a pool's, marked by [`mark_helper_thread`]) to the node's
//! thread without its location, which is looked up by the message. A second panic during unwinding, a stack overflow
//! and an abort cannot be caught in-process.

use std::{
    any::Any,
    cell::{Cell, RefCell},
    collections::VecDeque,
    panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook, take_hook},
    sync::{
        Mutex, Once, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

thread_local! {
    static IN_NODE: Cell<bool> = const { Cell::new(false) };
    static IS_HELPER: Cell<bool> = const { Cell::new(false) };
    static LATEST: RefCell<Option<Panic>> = const { RefCell::new(None) };
}

/// Panics of other threads that have not been claimed yet; bounded, the oldest are dropped.
static ELSEWHERE: Mutex<VecDeque<Panic>> = Mutex::new(VecDeque::new());
const MAX_ELSEWHERE: usize = 64;

/// Whether panics of nodes are also passed to the process's own hook, which can print a backtrace.
static SHOWN: AtomicBool = AtomicBool::new(false);

/// Message and location of a panic.
struct Panic {
    message: String,
    place: String,
}

/// Messages of the runtime before it aborts because a panic cannot be unwound.
const NO_UNWIND: [&str; 2] = ["panic in a destructor during cleanup", "panic in a function that cannot unwind"];

/// Marks this thread as a helper of nodes, such as a thread of the algorithms' pool: its panics are reported by the
/// node that waits for it, and are not printed.
pub fn mark_helper_thread() {
    IS_HELPER.set(true);
}

/// Also passes panics of nodes to the process's own hook from now on.
pub fn show() {
    SHOWN.store(true, Ordering::Relaxed);
}

/// Runs `f` and returns its result, or message and location of its panic.
///
/// The first call installs a hook that stores the location of a node's panic instead of printing it; other panics are
/// passed to the previous hook.
pub fn catch<T>(f: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| hook(info, &before)));
    });
    let outside = IN_NODE.replace(true);
    let result = catch_unwind(AssertUnwindSafe(f)).map_err(describe);
    IN_NODE.set(outside);
    result
}

fn hook(info: &PanicHookInfo<'_>, before: &dyn Fn(&PanicHookInfo<'_>)) {
    let message = message_of(info.payload());
    if NO_UNWIND.contains(&message) {
        // The process aborts here, so this is the last chance to report the first panic.
        if let Some(first) = LATEST.take() {
            tracing::error!("a node panicked at {}: {}", first.place, first.message);
        }
        return before(info);
    }
    let place = info.location().map(|at| format!("{}:{}", short(at.file()), at.line()));
    let panic = Panic { message: message.into(), place: place.unwrap_or_default() };
    if IN_NODE.get() {
        LATEST.replace(Some(panic));
    } else {
        let mut elsewhere = ELSEWHERE.lock().unwrap_or_else(PoisonError::into_inner);
        if elsewhere.len() == MAX_ELSEWHERE {
            elsewhere.pop_front();
        }
        elsewhere.push_back(panic);
    }
    if !(IN_NODE.get() || IS_HELPER.get()) || SHOWN.load(Ordering::Relaxed) {
        before(info);
    }
}

/// Describes a caught panic.
#[cold]
pub fn describe(payload: Box<dyn Any + Send>) -> String {
    let payload = match payload.downcast::<Described>() {
        Ok(described) => return described.0,
        Err(payload) => payload,
    };
    let message = message_of(&*payload).to_owned();
    let own = LATEST.take().filter(|panic| panic.message == message);
    // Dropping the payload may panic again, and the payload of that panic too.
    if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
        std::mem::forget(second);
    }
    let panic = own.or_else(|| {
        let mut elsewhere = ELSEWHERE.lock().unwrap_or_else(PoisonError::into_inner);
        let at = elsewhere.iter().rposition(|panic| panic.message == message)?;
        elsewhere.remove(at)
    });
    match panic.filter(|panic| !panic.place.is_empty()) {
        Some(panic) => format!("panicked at {}: {message}", panic.place),
        None => format!("panicked: {message}"),
    }
}

/// A panic caught and described by a plugin.
struct Described(String);

/// Resumes unwinding with the description of a plugin's panic, which cannot cross the C interface.
pub fn resume_described(message: String) -> ! {
    std::panic::resume_unwind(Box::new(Described(message)))
}

fn message_of(payload: &(dyn Any + Send)) -> &str {
    let text = payload.downcast_ref::<&str>().copied();
    text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a message")
}

/// The path from the crate's folder on, so that messages do not depend on where the machine keeps its sources.
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
    fn a_panic_is_described_with_message_and_location() {
        let message = catch(|| panic!("no {}", 42)).unwrap_err();
        assert!(message.starts_with("panicked at ") && message.ends_with(": no 42"), "{message}");
        assert!(message.contains("src/panics.rs:"), "{message}");
        assert_eq!(catch(|| 5), Ok(5));
    }

    #[test]
    fn a_location_outside_the_workspace_starts_at_its_crate() {
        assert_eq!(short("/home/x/.cargo/registry/src/index-1/kiddo-6.3.0/src/tree.rs"), "kiddo-6.3.0/src/tree.rs");
        assert_eq!(short("engine/src/panics.rs"), "engine/src/panics.rs");
    }

    #[test]
    fn a_panic_on_a_pool_thread_keeps_its_location() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(|_| mark_helper_thread()).build();
        let pool = pool.unwrap();
        let line = line!() + 1;
        let message = catch(|| pool.install(|| panic!("from the pool"))).unwrap_err();
        assert!(message.ends_with(&format!("src/panics.rs:{line}: from the pool")), "{message}");
    }

    #[test]
    fn a_panic_caught_inside_does_not_affect_the_next_location() {
        let message = catch(|| {
            let _ = std::panic::catch_unwind(|| panic!("the first"));
            std::panic::resume_unwind(Box::new("the second"))
        });
        assert_eq!(message, Err::<(), _>("panicked: the second".into()));
    }

    #[test]
    fn a_panic_without_a_message_is_described_by_its_location_even_if_its_payload_panics() {
        struct Spiteful;
        impl Drop for Spiteful {
            fn drop(&mut self) {
                panic!("while dropped");
            }
        }
        let message = catch(|| std::panic::panic_any(Spiteful)).unwrap_err();
        assert!(message.contains("src/panics.rs:") && message.ends_with(": without a message"), "{message}");
        let message = catch(|| drop(Spiteful)).unwrap_err();
        assert!(message.ends_with(": while dropped"), "{message}");
    }
}
