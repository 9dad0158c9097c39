//! Forwards `tracing` events of the plugin to the program.
#![allow(unsafe_code, reason = "calls the functions of the program")]

use crate::abi;
use std::{
    fmt::{self, Write},
    sync::atomic::{AtomicU64, Ordering},
};
use tracing::{
    Event, Level, Metadata, Subscriber,
    field::{Field, Visit},
    level_filters::LevelFilter,
    span,
    subscriber::Interest,
};

/// [`abi::Plugin::start`]
pub(super) unsafe extern "C" fn start(host: *const abi::Host) {
    // SAFETY: the host table lives as long as the program.
    let Some(host) = (unsafe { host.as_ref::<'static>() }) else { return };
    // A subscriber that the plugin installed itself takes precedence.
    let _ = super::panic::catch(|| tracing::subscriber::set_global_default(Forward { host, spans: AtomicU64::new(1) }));
}

struct Forward {
    host: &'static abi::Host,
    spans: AtomicU64,
}

fn code(level: Level) -> u32 {
    match level {
        Level::ERROR => 1,
        Level::WARN => 2,
        Level::INFO => 3,
        Level::DEBUG => 4,
        Level::TRACE => 5,
    }
}

impl Subscriber for Forward {
    fn register_callsite(&self, metadata: &'static Metadata<'static>) -> Interest {
        if self.enabled(metadata) { Interest::always() } else { Interest::never() }
    }

    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        // SAFETY: a function of the host table; its result never changes.
        metadata.is_event() && code(*metadata.level()) <= unsafe { (self.host.log_level)() }
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        // SAFETY: as above.
        Some(match unsafe { (self.host.log_level)() } {
            0 => LevelFilter::OFF,
            1 => LevelFilter::ERROR,
            2 => LevelFilter::WARN,
            3 => LevelFilter::INFO,
            4 => LevelFilter::DEBUG,
            _ => LevelFilter::TRACE,
        })
    }

    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(self.spans.fetch_add(1, Ordering::Relaxed))
    }

    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut line = Line::default();
        event.record(&mut line);
        let metadata = event.metadata();
        let (target, line) = (abi::Text::of(metadata.target()), line.text());
        // SAFETY: as above; the texts are read before the call returns.
        unsafe { (self.host.log)(code(*metadata.level()), target, abi::Text::of(&line)) };
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

impl Line {
    fn text(self) -> String {
        self.message + &self.rest
    }
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
