//! What all runs have from the program: its kinds, its notice, what the manifest says about it, and the store.

use super::{error::UsageError, host};
use osteoflow_engine::{
    run::{RunError, RunOptions},
    store,
};
use serde_json::json;
use std::{
    num::NonZeroUsize,
    sync::{Arc, atomic::AtomicBool},
    thread,
};

/// The notice on every result, on the terminal and in files.
pub(crate) const NOTICE: &str = "research use only, not for clinical use";

/// Most workers. The largest machines have some hundred cores, and each worker has a stack of 8 MiB.
const MAX_WORKERS: usize = 1024;

/// Refuses more than [`MAX_WORKERS`].
pub(crate) fn check_workers(workers: Option<NonZeroUsize>) -> Result<(), UsageError> {
    match workers.filter(|workers| workers.get() > MAX_WORKERS) {
        Some(workers) => Err(UsageError(format!("--workers {workers}: at most {MAX_WORKERS} threads are started"))),
        None => Ok(()),
    }
}

/// The built-in nodes and payloads.
pub(crate) fn registry() -> osteoflow_node::Registry {
    osteoflow_standard::registry()
}

/// Number of threads: by default the number of cores.
pub(crate) fn n_workers(workers: Option<NonZeroUsize>) -> usize {
    workers.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get)
}

/// Options common to all runs. The pool of threads for parallel algorithms is that of the process.
pub(crate) fn options(workers: Option<NonZeroUsize>, cancelled: &Arc<AtomicBool>) -> RunOptions {
    RunOptions {
        workers: n_workers(workers),
        fixed_results: vec![("notice".into(), NOTICE.into())],
        cancelled: cancelled.clone(),
        command: about_command(),
        ..RunOptions::default()
    }
}

/// The manifest's entries about program and machine; plugins, and all nodes off GNU/Linux, may compute by the processor's features.
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
        "opt_level": osteoflow_algorithms::OPT_LEVEL,
        "profile": if cfg!(debug_assertions) { "debug" } else { "release" },
        "arguments": host::arguments(),
        "os": std::env::consts::OS,
        "architecture": std::env::consts::ARCH,
        "cpu_features": store::cpu_features().into_iter().filter(|name| CPU_FEATURES.contains(name)).collect::<Vec<_>>(),
        "libraries": store::libraries(),
        "cpus": n_workers(None),
    })
}

/// The processor features that the manifest tells of: a repetition compares them.
const CPU_FEATURES: [&str; 4] = ["avx", "avx2", "fma", "avx512f"];

/// Converts an error: a node that cannot be built from its parameters is a fault of the graph.
pub(crate) fn run_error(error: RunError) -> anyhow::Error {
    match error {
        RunError::Build(_) | RunError::Inject(_) => UsageError(error.to_string()).into(),
        other => other.into(),
    }
}
