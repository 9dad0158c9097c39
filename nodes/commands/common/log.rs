//! Log lines go to stderr, because stdout carries results only.

use super::{global::Global, terminal};
use tracing::level_filters::LevelFilter;

/// The environment variable that names a level: `off`, `error`, `warn`, `info`, `debug` or `trace`.
const LEVEL_VARIABLE: &str = "OSTEOFLOW_LOG";

/// Starts logging; the variable overrides the switches.
pub(crate) fn start(global: &Global) {
    let by_switch = match (global.quiet, global.verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0 | 1) => LevelFilter::WARN,
        (false, 2) => LevelFilter::INFO,
        (false, 3) => LevelFilter::DEBUG,
        (false, _) => LevelFilter::TRACE,
    };
    let named = std::env::var(LEVEL_VARIABLE).ok();
    let by_name = named.as_deref().map(str::parse::<LevelFilter>);
    tracing_subscriber::fmt()
        .with_max_level(by_name.clone().and_then(Result::ok).unwrap_or(by_switch))
        .with_writer(terminal::stderr)
        .with_ansi(global.colour_err())
        .without_time()
        .with_target(false)
        .try_init()
        // A program that calls this one has started its own.
        .unwrap_or_default();
    if let Some(Err(_)) = by_name {
        let level = named.unwrap_or_default();
        tracing::warn!("{LEVEL_VARIABLE}={level} is not a level; use off, error, warn, info, debug or trace");
    }
}
