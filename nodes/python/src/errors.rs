//! Errors as exceptions, with the words of the command.

use osteoflow::app::Error;
use pyo3::{create_exception, exceptions::PyException, prelude::*};
use std::{
    sync::{
        Arc, Once,
        atomic::{AtomicBool, Ordering},
        mpsc::{RecvTimeoutError, sync_channel},
    },
    time::Duration,
};

create_exception!(
    osteoflow._core,
    OsteoflowError,
    PyException,
    "A file could not be read or written, or there was an internal error."
);
create_exception!(
    osteoflow._core,
    UsageError,
    OsteoflowError,
    "The options or the graph have a fault; nothing was run."
);
create_exception!(
    osteoflow._core,
    Refused,
    OsteoflowError,
    "There is no result, for the reason that is the message; `report` holds what is known nevertheless, as a dict."
);

/// The time between two looks for a Ctrl-C.
const POLL: Duration = Duration::from_millis(50);

/// Whether threads were started, and whether this process was forked from one that had.
static STARTED: AtomicBool = AtomicBool::new(false);
static FORKED: AtomicBool = AtomicBool::new(false);

/// Called in the child of a fork.
#[pyfunction]
pub(crate) fn forked() {
    FORKED.store(STARTED.load(Ordering::Relaxed), Ordering::Relaxed);
}

/// Refuses to run a graph in a process that has lost the threads of the algorithms.
pub(crate) fn check_threads() -> PyResult<()> {
    if FORKED.load(Ordering::Relaxed) {
        let message = "this process was forked from one that had run a graph, and a fork loses its threads; start processes \
                       with multiprocessing.get_context(\"spawn\")";
        return Err(OsteoflowError::new_err(message));
    }
    STARTED.store(true, Ordering::Relaxed);
    Ok(())
}

/// The exception of an error.
pub(crate) fn exception(py: Python<'_>, error: Error) -> PyErr {
    match error {
        Error::Usage(text) => UsageError::new_err(text),
        Error::Failed(text) => OsteoflowError::new_err(text),
        Error::Interrupted => pyo3::exceptions::PyKeyboardInterrupt::new_err("interrupted"),
        Error::Refused(why, report) => {
            let error = Refused::new_err(why);
            let parsed = py.import("json").and_then(|json| json.call_method1("loads", (report.to_string(),)));
            match parsed.and_then(|report| error.value(py).setattr("report", report)) {
                Ok(()) => error,
                Err(other) => other,
            }
        }
    }
}

/// Does `work` on another thread without the GIL, until it ends. A Ctrl-C sets `cancelled`, and is raised once the work has ended.
pub(crate) fn watched<T: Send, E: Into<Error> + Send>(
    py: Python<'_>,
    cancelled: &Arc<AtomicBool>,
    work: impl FnOnce() -> Result<T, E> + Send,
) -> PyResult<T> {
    static LOG: Once = Once::new();
    LOG.call_once(osteoflow::start_log);
    let mut pressed = None;
    let ended = py.detach(|| {
        std::thread::scope(|scope| {
            let (sender, receiver) = sync_channel(1);
            let worker = scope.spawn(move || {
                let ended = work();
                let _ = sender.send(());
                ended
            });
            while let Err(RecvTimeoutError::Timeout) = receiver.recv_timeout(POLL) {
                if let Err(error) = Python::attach(|py| py.check_signals()) {
                    cancelled.store(true, Ordering::Relaxed);
                    pressed.get_or_insert(error);
                }
            }
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    });
    match pressed {
        Some(error) => Err(error),
        None => ended.map_err(|error| exception(py, error.into())),
    }
}
