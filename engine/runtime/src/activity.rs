//! Which node each thread is calling, so that a crash or a long firing can be reported by node and item.
//!
//! A thread that calls nodes has a record that lives as long as the process. Beginning and ending a call are a few relaxed
//! stores. The records may be read from any thread and from a signal handler: reading takes no lock and allocates nothing.

use std::{
    cell::Cell,
    collections::BTreeMap,
    sync::{
        Mutex, OnceLock, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

/// A name of a node or a file in the table of names, which is never freed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Name(u16);

/// Number of names that the table holds; later ones are shown as [`Name::UNKNOWN`].
const MAX_NAMES: usize = 4096;

static NAMES: [OnceLock<&'static str>; MAX_NAMES] = [const { OnceLock::new() }; MAX_NAMES];

impl Name {
    const NONE: Self = Self(0);
    const UNKNOWN: Self = Self(1);

    /// The name of `text`, entered into the table once.
    pub fn of(text: &str) -> Self {
        static KNOWN: Mutex<BTreeMap<&str, u16>> = Mutex::new(BTreeMap::new());
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(index) = known.get(text) {
            return Self(*index);
        }
        let index = known.len() + 2;
        if index >= MAX_NAMES {
            return Self::UNKNOWN;
        }
        let text: &'static str = String::leak(text.to_owned());
        known.insert(text, index as u16);
        let _ = NAMES[index].set(text);
        Self(index as u16)
    }

    fn text(self) -> Option<&'static str> {
        match self {
            Self::NONE => None,
            Self::UNKNOWN => Some("?"),
            Self(index) => NAMES.get(usize::from(index))?.get().copied(),
        }
    }
}

/// What a node is called for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doing {
    /// The node is built.
    Building = 1,
    /// The node handles an item.
    Firing = 2,
    /// A live source is asked for its next answer, and may wait for its device.
    Waiting = 3,
    /// The node is destroyed during the run.
    Destroying = 4,
    /// The node is destroyed after the files of the run have been written.
    Closing = 5,
}

impl Doing {
    fn of(code: u64) -> Option<Self> {
        [Self::Building, Self::Firing, Self::Waiting, Self::Destroying, Self::Closing]
            .into_iter()
            .find(|doing| *doing as u64 == code)
    }
}

/// A call of a node under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Call {
    /// The node.
    pub node: &'static str,
    /// The library whose function was called; `None` in a built-in node.
    pub library: Option<&'static str>,
    /// What it was called for.
    pub doing: Doing,
    /// Number of the item, while firing.
    pub item: u64,
    /// Number of the call on its thread.
    pub number: u64,
}

/// The call under way on a thread.
struct Record {
    in_use: AtomicBool,
    /// What, library and node, by 16 bits each; zero between calls.
    call: AtomicU64,
    item: AtomicU64,
    number: AtomicU64,
    next: OnceLock<&'static Record>,
}

/// The records of all threads, of which later ones may use those of threads that have ended.
static FIRST: OnceLock<&'static Record> = OnceLock::new();

thread_local! {
    /// Without a destructor, so that a signal handler may read it.
    static OWN: Cell<Option<&'static Record>> = const { Cell::new(None) };
    static LOAN: Cell<Option<Loan>> = const { Cell::new(None) };
}

/// Returns the record when its thread ends.
struct Loan(&'static Record);

impl Drop for Loan {
    fn drop(&mut self) {
        // In the middle of a call: the process ends by exit(), which still reads the record.
        if self.0.call.load(Ordering::Relaxed) != 0 {
            return;
        }
        OWN.set(None);
        self.0.in_use.store(false, Ordering::Release);
    }
}

impl Record {
    fn read(&self) -> Option<Call> {
        let call = self.call.load(Ordering::Relaxed);
        let name = |shift: u32| Name((call >> shift) as u16).text();
        Some(Call {
            node: name(0)?,
            library: name(16),
            doing: Doing::of(call >> 32)?,
            item: self.item.load(Ordering::Relaxed),
            number: self.number.load(Ordering::Relaxed),
        })
    }
}

fn records() -> impl Iterator<Item = &'static Record> {
    std::iter::successors(FIRST.get().copied(), |record| record.next.get().copied())
}

/// The record of this thread.
fn own() -> &'static Record {
    OWN.get().unwrap_or_else(lend)
}

#[cold]
fn lend() -> &'static Record {
    static LENDING: Mutex<()> = Mutex::new(());
    let _lending = LENDING.lock().unwrap_or_else(PoisonError::into_inner);
    let free = records().find(|record| !record.in_use.load(Ordering::Acquire));
    let record = free.unwrap_or_else(|| {
        let new: &'static Record = Box::leak(Box::new(Record {
            in_use: AtomicBool::new(true),
            call: AtomicU64::new(0),
            item: AtomicU64::new(0),
            number: AtomicU64::new(0),
            next: OnceLock::new(),
        }));
        let place = records().last().map_or(&FIRST, |last| &last.next);
        let _ = place.set(new);
        new
    });
    record.in_use.store(true, Ordering::Relaxed);
    OWN.set(Some(record));
    // A thread that is ending keeps the record.
    let _ = LOAN.try_with(|loan| loan.set(Some(Loan(record))));
    record
}

/// Ends a call when dropped; the one outside it, if any, is then under way again.
pub struct Under {
    record: &'static Record,
    before: u64,
}

impl Drop for Under {
    fn drop(&mut self) {
        self.record.call.store(self.before, Ordering::Relaxed);
    }
}

/// Begins a call of a node on this thread.
pub fn begin(node: Name, doing: Doing, item: u64) -> Under {
    let record = own();
    let before = record.call.load(Ordering::Relaxed);
    record.number.store(record.number.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    record.item.store(item, Ordering::Relaxed);
    record.call.store((doing as u64) << 32 | u64::from(node.0), Ordering::Relaxed);
    Under { record, before }
}

/// Notes that the call under way on this thread is in a function of `library`.
pub fn in_library(library: Name) -> Under {
    let record = own();
    let before = record.call.load(Ordering::Relaxed);
    record.call.store(before & !(0xffff << 16) | u64::from(library.0) << 16, Ordering::Relaxed);
    Under { record, before }
}

/// The call under way on this thread.
pub fn here() -> Option<Call> {
    OWN.get()?.read()
}

/// The calls under way on all threads, each with the number of its thread's record.
pub fn everywhere() -> impl Iterator<Item = (usize, Call)> {
    records().enumerate().filter_map(|(thread, record)| Some((thread, record.read()?)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_is_seen_on_its_thread_and_from_others_until_it_ends() {
        assert_eq!(here(), None);
        let call = begin(Name::of("outer"), Doing::Firing, 3);
        let inner = begin(Name::of("inner"), Doing::Destroying, 0);
        let library = in_library(Name::of("libinner.so"));
        let seen = here().expect("a call is under way");
        assert_eq!((seen.node, seen.library, seen.doing), ("inner", Some("libinner.so"), Doing::Destroying));
        let elsewhere = std::thread::spawn(|| (here(), everywhere().any(|(_, call)| call.node == "inner")));
        assert_eq!(elsewhere.join().expect("it only looks"), (None, true));
        drop((library, inner));
        assert_eq!(here().map(|call| (call.node, call.library, call.doing)), Some(("outer", None, Doing::Firing)));
        drop(call);
        assert_eq!(here(), None);
        assert!(!everywhere().any(|(_, call)| call.node == "inner"));
    }

    #[test]
    fn a_record_of_a_thread_that_has_ended_is_used_again() {
        for _ in 0..100 {
            let work = || drop(begin(Name::of("short"), Doing::Firing, 0));
            std::thread::spawn(work).join().expect("it ends");
        }
        assert!(records().count() < 50, "{} records", records().count());
    }
}
