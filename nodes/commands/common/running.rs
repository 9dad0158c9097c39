//! Runs a plan on another thread, while the main thread shows progress and handles Ctrl-C.

use super::{
    busy::{Busy, LOOK},
    global::Global,
    progress::Progress,
};
use crate::app::program;
use anyhow::{Context, Result, anyhow};
use osteoflow_engine::{
    panics::{self, mark_helper_thread},
    run::{Event, Observer, RunOptions, files},
};
use std::{
    num::NonZeroUsize,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{RecvTimeoutError, SyncSender, sync_channel},
    },
    thread,
};

enum News<T> {
    Ended(Result<T>),
    SecondInterrupt,
}

/// Creates the pool of `workers` threads for parallel algorithms.
pub(crate) fn make_pool(workers: Option<NonZeroUsize>) -> Result<()> {
    program::check_workers(workers)?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(program::n_workers(workers));
    pool.start_handler(|_| mark_helper_thread()).build_global().context("no threads for the algorithms")
}

/// Options common to all runs, with [`make_pool`].
pub(crate) fn options(workers: Option<NonZeroUsize>, cancelled: &Arc<AtomicBool>) -> Result<RunOptions> {
    make_pool(workers)?;
    Ok(program::options(workers, cancelled))
}

/// Runs `work` on another thread until it ends; `None` if the user presses Ctrl-C twice.
///
/// The first Ctrl-C sets `cancelled`, which the engine and long algorithms check. After the second one this function returns
/// at once; the process then ends, and the thread with it.
pub(crate) fn watch<T: Send + 'static>(
    progress: Progress,
    cancelled: Arc<AtomicBool>,
    work: impl FnOnce(&Progress) -> Result<T> + Send + 'static,
) -> Result<Option<T>> {
    let progress = Arc::new(progress);
    let (sender, receiver) = sync_channel(2);
    let busy = Arc::new(Mutex::new(Busy::default()));
    listen(sender.clone(), cancelled, progress.clone(), busy.clone())?;
    let watched = progress.clone();
    let runner = thread::Builder::new().name("run".into()).spawn(move || {
        // The handler of Ctrl-C keeps a sender, so that a panic has to be sent as well: nothing else would end the wait.
        let outcome = panics::catch(|| work(&watched)).unwrap_or_else(|panic| {
            Err(anyhow!("the engine {panic}; this is a bug, please report it with the command and its files"))
        });
        let _ = sender.send(News::Ended(outcome));
    });
    runner.context("no thread for the run")?;
    let news = loop {
        match receiver.recv_timeout(LOOK) {
            Err(RecvTimeoutError::Timeout) => {
                let mut busy = busy.lock().unwrap_or_else(PoisonError::into_inner);
                busy.look();
                progress.busy(busy.longest());
            }
            news => break news,
        }
    };
    progress.end();
    match news {
        Ok(News::Ended(outcome)) => outcome.map(Some),
        Ok(News::SecondInterrupt) => Ok(None),
        Err(_) => Err(anyhow!("the engine stopped without a result, which is a bug; its message is above")),
    }
}

fn listen<T: Send + 'static>(
    sender: SyncSender<News<T>>,
    cancelled: Arc<AtomicBool>,
    progress: Arc<Progress>,
    busy: Arc<Mutex<Busy>>,
) -> Result<()> {
    let presses = AtomicUsize::new(0);
    on_interrupt(move || {
        if presses.fetch_add(1, Ordering::Relaxed) == 0 {
            cancelled.store(true, Ordering::Relaxed);
            let mut busy = busy.lock().unwrap_or_else(PoisonError::into_inner);
            busy.look();
            let waits_for = busy.longest().map(|longest| format!(" ({longest})")).unwrap_or_default();
            progress
                .println(&format!("stopping after the current work{waits_for}; press Ctrl-C again to leave at once"));
        } else {
            let _ = sender.try_send(News::SecondInterrupt);
        }
    })
}

/// What Ctrl-C does from now on.
pub(crate) fn on_interrupt(act: impl Fn() + Send + 'static) -> Result<()> {
    static ACT: Mutex<Option<Box<dyn Fn() + Send>>> = Mutex::new(None);
    let was_set = ACT.lock().unwrap_or_else(PoisonError::into_inner).replace(Box::new(act)).is_some();
    if was_set {
        return Ok(());
    }
    let handler = || {
        if let Some(act) = &*ACT.lock().unwrap_or_else(PoisonError::into_inner) {
            act();
        }
    };
    ctrlc::set_handler(handler).context("the handler of Ctrl-C cannot be installed")
}

/// Shows the progress of a run, and on stderr at once what is urgent of a live source.
pub(crate) struct WithUrgent<'a> {
    pub(crate) progress: &'a Progress,
    pub(crate) is_quiet: bool,
}

impl Observer for WithUrgent<'_> {
    fn event(&self, event: &Event<'_>) {
        if let (Event::Urgent(warning), false) = (event, self.is_quiet) {
            self.progress.println(&format!("node \"{}\": {}", warning.node, warning.message));
        }
        self.progress.event(event);
    }
}

/// Prints where the files of an aborted run are.
pub(crate) fn print_left_files(out_dir: &std::path::Path, global: &Global) {
    let dir = out_dir.display();
    let _ = global.say("left", format!("the files are in {dir}; the end of {} may be missing", files::RECORDING));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_the_work_or_of_a_pool_thread_ends_the_wait_with_its_message_and_place() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(|_| mark_helper_thread()).build();
        let pool = pool.expect("a pool");
        let work = move |_: &Progress| -> Result<()> { pool.install(|| panic!("no place at 1e45")) };
        let message = watch(Progress::hidden(), Arc::default(), work).map(|_| ()).expect_err("it panics").to_string();
        assert!(message.starts_with("the engine panicked at ") && message.contains("running.rs:"), "{message}");
        assert!(message.contains(": no place at 1e45; this is a bug"), "{message}");
    }

    #[test]
    fn absurd_numbers_of_workers_are_refused_before_a_thread_starts() {
        let message =
            options(NonZeroUsize::new(100_000), &Arc::default()).map(|_| ()).expect_err("too many").to_string();
        assert_eq!(message, "--workers 100000: at most 1024 threads are started");
    }
}
