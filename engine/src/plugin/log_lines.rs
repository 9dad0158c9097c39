//! Log lines of plugins.

use tracing::level_filters::LevelFilter;

/// The level that is logged: 0 (none) to 5 (trace).
pub(super) fn level() -> u32 {
    match LevelFilter::current() {
        LevelFilter::OFF => 0,
        LevelFilter::ERROR => 1,
        LevelFilter::WARN => 2,
        LevelFilter::INFO => 3,
        LevelFilter::DEBUG => 4,
        _ => 5,
    }
}

/// Logs a line.
pub(super) fn log(level: u32, target: &str, message: &str) {
    match level {
        1 => tracing::error!(target: "plugin", "{target}: {message}"),
        2 => tracing::warn!(target: "plugin", "{target}: {message}"),
        3 => tracing::info!(target: "plugin", "{target}: {message}"),
        4 => tracing::debug!(target: "plugin", "{target}: {message}"),
        _ => tracing::trace!(target: "plugin", "{target}: {message}"),
    }
}
