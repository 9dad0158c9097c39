//! Runs a plan beside the main thread, which shows progress and listens for Ctrl-C.

use super::{Global, UsageError, progress::Progress};
use anyhow::{Context, Result, anyhow};
use osteoflow_engine::{
    panics::mark_helper_thread,
    run::{RunError, RunOptions, files},
};
use serde_json::json;
use std::{
    num::NonZeroUsize,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{SyncSender, sync_channel},
    },
    thread,
};

/// What became of it.
pub(crate) enum Ran<T> {
    /// It came to its end, if only an ordered stop.
    Ended(T),
    /// The user did not wait for that.
    Left,
}

enum News<T> {
    Ended(Result<T>),
    SecondInterrupt,
}

/// Options common to all runs, and the pool of `workers` threads for what is parallel inside a node.
pub(crate) fn options(workers: Option<NonZeroUsize>, cancelled: &Arc<AtomicBool>) -> Result<RunOptions> {
    let workers = workers.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(workers).start_handler(|_| mark_helper_thread());
    pool.build_global().context("no threads for the algorithms")?;
    Ok(RunOptions {
        workers,
        fixed_results: vec![("notice".into(), super::result_table::NOTICE.into())],
        cancelled: cancelled.clone(),
        command: about_command(),
        ..RunOptions::default()
    })
}

/// What the manifest says of the program and the machine; determinism is promised for equal features.
pub(crate) fn about_command() -> serde_json::Value {
    let revision = env!("OSTEOFLOW_BUILD_GIT_REVISION");
    json!({
        "name": "osteoflow",
        "version": env!("CARGO_PKG_VERSION"),
        "git_revision": if revision.is_empty() { serde_json::Value::Null } else { revision.into() },
        "compiler": env!("OSTEOFLOW_BUILD_COMPILER"),
        "target": env!("OSTEOFLOW_BUILD_TARGET"),
        "target_features": env!("OSTEOFLOW_BUILD_TARGET_FEATURES"),
        "rustflags": env!("OSTEOFLOW_BUILD_RUSTFLAGS"),
        "opt_level": env!("OSTEOFLOW_BUILD_OPT_LEVEL"),
        "profile": if cfg!(debug_assertions) { "debug" } else { "release" },
        "arguments": std::env::args_os().skip(1).map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>(),
        "os": std::env::consts::OS,
        "architecture": std::env::consts::ARCH,
        "cpu_features": cpu_features(),
        "cpus": thread::available_parallelism().map_or(1, NonZeroUsize::get),
    })
}

#[cfg(target_arch = "x86_64")]
fn cpu_features() -> Vec<&'static str> {
    let known = [
        ("avx", is_x86_feature_detected!("avx")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
        ("avx512f", is_x86_feature_detected!("avx512f")),
    ];
    known.into_iter().filter_map(|(name, has)| has.then_some(name)).collect()
}

#[cfg(not(target_arch = "x86_64"))]
fn cpu_features() -> Vec<&'static str> {
    Vec::new()
}

/// Lets `work` run on a thread of its own until it ends or the user presses Ctrl-C twice.
///
/// The first Ctrl-C sets `cancelled`, which the engine and long algorithms look at. After the second one the caller
/// returns at once; the process then ends, and the thread with it.
pub(crate) fn watch<T: Send + 'static>(
    progress: Progress,
    cancelled: Arc<AtomicBool>,
    work: impl FnOnce(&Progress) -> Result<T> + Send + 'static,
) -> Result<Ran<T>> {
    let progress = Arc::new(progress);
    let (tell, news) = sync_channel(2);
    listen(tell.clone(), cancelled, progress.clone())?;
    let watched = progress.clone();
    let runner = thread::Builder::new().name("run".into()).spawn(move || {
        let ended = work(&watched);
        let _ = tell.send(News::Ended(ended));
    });
    runner.context("no thread for the run")?;
    let news = news.recv();
    progress.end();
    match news {
        Ok(News::Ended(answer)) => Ok(Ran::Ended(answer?)),
        Ok(News::SecondInterrupt) => Ok(Ran::Left),
        Err(_) => Err(anyhow!("the engine stopped without an answer, which is a bug of ours; its message is above")),
    }
}

fn listen<T: Send + 'static>(
    tell: SyncSender<News<T>>,
    cancelled: Arc<AtomicBool>,
    progress: Arc<Progress>,
) -> Result<()> {
    let presses = AtomicUsize::new(0);
    ctrlc::set_handler(move || {
        if presses.fetch_add(1, Ordering::Relaxed) == 0 {
            cancelled.store(true, Ordering::Relaxed);
            progress.say("stopping in order; once more leaves at once");
        } else {
            let _ = tell.try_send(News::SecondInterrupt);
        }
    })
    .context("Ctrl-C cannot be listened for")
}

/// A node that cannot be built from its parameters is a fault of the graph, whatever else is one of the machine.
pub(crate) fn told(error: RunError) -> anyhow::Error {
    match error {
        RunError::Build(_) | RunError::Inject(_) => UsageError(error.to_string()).into(),
        other => other.into(),
    }
}

/// What to tell whoever did not wait.
pub(crate) fn say_left(out_dir: &std::path::Path, global: &Global) {
    use std::io::Write;
    let (word, dir) = (global.paint_err("left", "1;33"), out_dir.display());
    let said = format!("{word}: what was written is in {dir}; {} may lack its end", files::RECORDING);
    let _ = writeln!(std::io::stderr(), "{said}");
}
