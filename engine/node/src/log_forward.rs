//! Hands `tracing` events on as lines: from a plugin to the program, or from one process to another.

use std::{
    fmt::{self, Write},
    sync::atomic::{AtomicU64, Ordering},
};
use tracing::{
    Event, Metadata, Subscriber,
    field::{Field, Visit},
    level_filters::LevelFilter,
    span,
    subscriber::Interest,
};

/// A subscriber that calls `send` with the level (1 error to 5 trace), target and text of each event.
pub struct LogForward<F> {
    level: LevelFilter,
    send: F,
    n_spans: AtomicU64,
}

impl<F> LogForward<F> {
    /// Events up to this level, from 0 (none) to 5 (trace).
    pub fn new(level: u32, send: F) -> Self {
        let level = LEVELS.get(level as usize).copied().unwrap_or(LevelFilter::TRACE);
        Self { level, send, n_spans: AtomicU64::new(1) }
    }
}

/// The levels by their codes.
const LEVELS: [LevelFilter; 6] = [
    LevelFilter::OFF,
    LevelFilter::ERROR,
    LevelFilter::WARN,
    LevelFilter::INFO,
    LevelFilter::DEBUG,
    LevelFilter::TRACE,
];

impl<F: Fn(u32, &str, &str) + Send + Sync + 'static> Subscriber for LogForward<F> {
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        if self.enabled(metadata) { Interest::always() } else { Interest::never() }
    }

    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.is_event() && *metadata.level() <= self.level
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(self.level)
    }

    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(self.n_spans.fetch_add(1, Ordering::Relaxed))
    }

    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut line = Line::default();
        event.record(&mut line);
        let metadata = event.metadata();
        let code = LEVELS.iter().position(|level| metadata.level() == level).unwrap_or_default();
        (self.send)(code as u32, metadata.target(), &(line.message + &line.rest));
    }

    fn enter(&self, _: &span::Id) {}

    fn exit(&self, _: &span::Id) {}
}

/// The message, followed by the other fields.
#[derive(Default)]
struct Line {
    message: String,
    rest: String,
}

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        // Writing to a string cannot fail.
        let _ = match field.name() {
            "message" => write!(self.message, "{value:?}"),
            name => write!(self.rest, " {name}={value:?}"),
        };
    }
}
