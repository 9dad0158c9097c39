//! A node's panic, caught and told as its error.
//!
//! The process's panic hook is put aside for panics of nodes: their place and words are kept and told with the node's
//! failure. A panic on a thread that helps a node (a pool's, marked by [`mark_helper_thread`]) reaches the node's thread
//! without its place, as `rayon` carries it over; the place is kept for it by its words. A second panic while a first
//! unwinds, a stack overflow and an abort cannot be caught by any program in its own process.

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

/// Panics of other threads that nobody has asked for yet; the oldest make room.
static ELSEWHERE: Mutex<VecDeque<Panic>> = Mutex::new(VecDeque::new());
const MOST_ELSEWHERE: usize = 64;

/// Whether a node's panics are shown by the process's own hook as well, which can print a backtrace.
static SHOWN: AtomicBool = AtomicBool::new(false);

/// A panic's words and place.
struct Panic {
    message: String,
    place: String,
}

/// What the runtime says before it aborts because a panic cannot be unwound.
const NO_UNWIND: [&str; 2] = ["panic in a destructor during cleanup", "panic in a function that cannot unwind"];

/// Says that this thread works for nodes alone, as those of the pool for algorithms do: its panics are told by the node
/// that waits for it, and printed nowhere else.
pub fn mark_helper_thread() {
    IS_HELPER.set(true);
}

/// Lets the process's own hook show the panics of nodes as well, from now on.
pub(crate) fn show() {
    SHOWN.store(true, Ordering::Relaxed);
}

/// What `f` answers, or what it said when it panicked and where.
///
/// The first call puts a hook before the process's own, which keeps the place of a node's panic in the place of printing
/// it; all other panics go to the hook that was there.
pub(crate) fn catch<T>(f: impl FnOnce() -> T) -> Result<T, String> {
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
        // The process ends here; what had been kept would never be told.
        if let Some(first) = LATEST.take() {
            tracing::error!("a node panicked at {}: {}", first.place, first.message);
        }
        return before(info);
    }
    let place = info.location().map(|at| format!("{}:{}", short(at.file()), at.line()));
    let kept = Panic { message: message.into(), place: place.unwrap_or_default() };
    if IN_NODE.get() {
        LATEST.replace(Some(kept));
    } else {
        let mut elsewhere = ELSEWHERE.lock().unwrap_or_else(PoisonError::into_inner);
        if elsewhere.len() == MOST_ELSEWHERE {
            elsewhere.pop_front();
        }
        elsewhere.push_back(kept);
    }
    if !(IN_NODE.get() || IS_HELPER.get()) || SHOWN.load(Ordering::Relaxed) {
        before(info);
    }
}

/// A caught panic in words.
#[cold]
pub(crate) fn describe(payload: Box<dyn Any + Send>) -> String {
    let payload = match payload.downcast::<Described>() {
        Ok(described) => return described.0,
        Err(payload) => payload,
    };
    let message = message_of(&*payload).to_owned();
    let own = LATEST.take().filter(|kept| kept.message == message);
    // Dropping what was thrown may panic again, and so on.
    if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
        std::mem::forget(second);
    }
    let kept = own.or_else(|| {
        let mut elsewhere = ELSEWHERE.lock().unwrap_or_else(PoisonError::into_inner);
        let at = elsewhere.iter().rposition(|kept| kept.message == message)?;
        elsewhere.remove(at)
    });
    match kept.filter(|kept| !kept.place.is_empty()) {
        Some(kept) => format!("panicked at {}: {message}", kept.place),
        None => format!("panicked: {message}"),
    }
}

/// A panic that a plugin has caught and described.
struct Described(String);

/// Goes on unwinding in the place of a plugin, whose panic could not cross.
pub(crate) fn resume_described(said: String) -> ! {
    std::panic::resume_unwind(Box::new(Described(said)))
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
        assert!(said.contains("src/panics.rs:"), "{said}");
        assert_eq!(catch(|| 5), Ok(5));
    }

    #[test]
    fn a_place_outside_the_workspace_is_told_from_its_crate_on() {
        assert_eq!(short("/home/x/.cargo/registry/src/index-1/kiddo-6.3.0/src/tree.rs"), "kiddo-6.3.0/src/tree.rs");
        assert_eq!(short("engine/src/panics.rs"), "engine/src/panics.rs");
    }

    #[test]
    fn a_panic_on_a_thread_of_the_pool_keeps_its_place() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(|_| mark_helper_thread()).build();
        let pool = pool.unwrap();
        let line = line!() + 1;
        let said = catch(|| pool.install(|| panic!("from the pool"))).unwrap_err();
        assert!(said.ends_with(&format!("src/panics.rs:{line}: from the pool")), "{said}");
    }

    #[test]
    fn a_panic_that_was_caught_inside_lends_its_place_to_no_other() {
        let said = catch(|| {
            let _ = std::panic::catch_unwind(|| panic!("the first"));
            std::panic::resume_unwind(Box::new("the second"))
        });
        assert_eq!(said, Err::<(), _>("panicked: the second".into()));
    }

    #[test]
    fn a_panic_without_words_is_told_by_its_place_even_if_its_payload_panics_again() {
        struct Spiteful;
        impl Drop for Spiteful {
            fn drop(&mut self) {
                panic!("while dropped");
            }
        }
        let said = catch(|| std::panic::panic_any(Spiteful)).unwrap_err();
        assert!(said.contains("src/panics.rs:") && said.ends_with(": without a message"), "{said}");
        let said = catch(|| drop(Spiteful)).unwrap_err();
        assert!(said.ends_with(": while dropped"), "{said}");
    }
}
