//! Progress of reading a long file.

use super::global::{Format, Global};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    io::IsTerminal,
    path::Path,
    time::{Duration, Instant},
};

/// Files that are read faster show no progress.
const PATIENCE: Duration = Duration::from_millis(400);

/// A progress line on a terminal; nothing elsewhere.
pub(crate) struct Reading {
    bar: ProgressBar,
    what: String,
    began: Instant,
    drawn: bool,
    shown: bool,
}

impl Reading {
    /// Begins to show the progress of reading `file`.
    pub(crate) fn begin(doing: &str, file: &Path, global: &Global) -> Self {
        let shown = !global.quiet && global.format == Format::Text && std::io::stderr().is_terminal();
        let what = format!("{doing} {}", file.display());
        Self { bar: ProgressBar::hidden(), what, began: Instant::now(), drawn: false, shown }
    }

    /// Updates the progress, in bytes.
    pub(crate) fn at(&mut self, n_bytes: u64, of: u64) {
        if !self.shown || (!self.drawn && self.began.elapsed() < PATIENCE) {
            return;
        }
        if !self.drawn {
            self.drawn = true;
            let template = "{spinner} {bar:24} {bytes}/{total_bytes} {binary_bytes_per_sec}  {wide_msg}";
            let style = ProgressStyle::with_template(template).expect("the template is fixed");
            self.bar = ProgressBar::with_draw_target(Some(of), ProgressDrawTarget::stderr());
            self.bar.set_style(style.progress_chars("=> "));
            self.bar.set_message(self.what.clone());
        }
        self.bar.set_length(of);
        self.bar.set_position(n_bytes);
    }
}

impl Drop for Reading {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
