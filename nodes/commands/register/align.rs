//! The registration, repeated and timed.

use super::{
    Params,
    files::moved_source,
    inputs::{Inputs, ms_since},
    judge::{Judge, Judged},
    landmarks::off_surface,
    method::Method,
    start::Started,
};
use crate::commands::common::{Format, Global};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use osteoflow_algorithms::{
    icp::{Halt, IcpFit, IcpReport, IcpStep},
    target::Target,
    trust,
};
use osteoflow_geometry::{Cloud, nalgebra::Isometry3};
use serde::Serialize;
use serde_json::Value;
use std::{
    io::IsTerminal,
    ops::ControlFlow,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// Delay before the progress line appears.
const DELAY: Duration = Duration::from_millis(400);
/// Shortest time between two updates of the progress line.
const REFRESH: Duration = Duration::from_millis(60);

/// The registrations to do.
pub(crate) struct Work {
    pub(super) method: &'static Method,
    pub(super) params: Params,
    pub(super) inputs: Arc<Inputs>,
    pub(super) repeat: u32,
    /// How to judge the pose, if it is judged.
    pub(super) judge: Option<Judge>,
    /// Whether the moved source is written.
    pub(super) moves_source: bool,
    pub(super) cancelled: Arc<AtomicBool>,
    pub(super) progress: ProgressLine,
}

/// How the registrations ended.
pub(crate) enum Ended {
    /// With a pose.
    Fit(Box<Aligned>),
    /// Without a pose, for this reason.
    Refused(String),
    /// By Ctrl-C.
    Interrupted,
}

/// What a method found.
pub(super) struct Fit {
    pub(super) t_target_source: Isometry3<f64>,
    pub(super) report: Report,
    /// The steps of a built-in method.
    pub(super) steps: Vec<IcpStep>,
}

/// The report of a method.
pub(super) enum Report {
    BuiltIn(Box<IcpReport>),
    Plugin {
        /// As in `results.json`, if the kind has a report.
        theirs: Option<Value>,
        warnings: Vec<String>,
    },
}

/// Why a method found no pose.
pub(super) enum NoFit {
    Refused(String),
    Cancelled,
}

impl From<IcpFit> for Fit {
    fn from(IcpFit { t_target_source, report, trace }: IcpFit) -> Self {
        Self { t_target_source, report: Report::BuiltIn(Box::new(report)), steps: trace.steps }
    }
}

impl Report {
    /// How the method ended, by its own report; nothing is known of one without a report.
    pub(super) fn ended(&self) -> trust::Ended {
        match self {
            Self::BuiltIn(report) => trust::Ended::from(&**report),
            Self::Plugin { theirs, .. } => {
                theirs.clone().and_then(|report| serde_json::from_value(report).ok()).unwrap_or_default()
            }
        }
    }
}

/// A fit and its timings.
pub(crate) struct Aligned {
    pub(super) fit: Fit,
    /// A doubt about the picked points.
    pub(super) doubt: Option<String>,
    /// The moved source with its residuals, if it is written.
    pub(super) moved: Option<Cloud>,
    pub(super) started: Started,
    pub(super) timings: Timings,
    /// Whether all repeats gave the same bits.
    pub(super) same_bits: bool,
    /// The verdict on the pose, if it was judged.
    pub(super) judged: Option<Judged>,
}

impl Aligned {
    /// Why the pose is not given, if it is not.
    pub(super) fn refusal(&self) -> Option<&str> {
        self.judged.as_ref()?.refusal.as_deref()
    }
}

/// Times of each repeat, ms.
#[derive(Debug, Default, Serialize)]
pub(super) struct Timings {
    pub(super) prep_target_ms: Vec<f64>,
    pub(super) prep_source_ms: Vec<f64>,
    pub(super) align_ms: Vec<f64>,
    /// Processor time of `align_ms`, all threads together.
    pub(super) cpu_ms: Vec<f64>,
}

impl Work {
    pub(crate) fn run(mut self) -> Ended {
        let mut timings = Timings::default();
        let mut first: Option<(Target, Fit)> = None;
        let mut same_bits = true;
        let mut started: Option<Started> = None;
        for n in 1..=self.repeat {
            let began = Instant::now();
            let target = match self.inputs.target.prepare(self.method, self.params.method.pairing()) {
                Ok(target) => target,
                Err(error) => return Ended::Refused(error.to_string()),
            };
            timings.prep_target_ms.push(ms_since(began));
            if n == 1 {
                self.inputs.target.store(&target);
            }
            // The methods sort the source and estimate its normals within align.
            timings.prep_source_ms.push(0.0);

            let source = self.inputs.source.cloud();
            let init = match &started {
                Some(started) => started.init,
                None => match self.inputs.start.find(&target, source) {
                    Ok(found) => started.insert(found).init,
                    Err(why) => return Ended::Refused(why),
                },
            };
            let (progress, cancelled) = (&mut self.progress, &self.cancelled);
            let limit_ms = self.params.method.stop_after_ms();
            let (began, cpu) = (Instant::now(), cpu_ms());
            let mut observer = |step: &IcpStep| {
                progress.update(n, step);
                if cancelled.load(Ordering::Relaxed) {
                    ControlFlow::Break(Halt::Cancelled)
                } else if limit_ms > 0.0 && ms_since(began) >= limit_ms {
                    ControlFlow::Break(Halt::Time)
                } else {
                    ControlFlow::Continue(())
                }
            };
            let fit = self.params.method.register(&target, source, &init, &mut observer, cancelled);
            timings.align_ms.push(ms_since(began));
            timings.cpu_ms.extend(cpu_ms().zip(cpu).map(|(after, before)| after - before));
            match fit {
                Err(NoFit::Refused(why)) => return Ended::Refused(why),
                Err(NoFit::Cancelled) => return Ended::Interrupted,
                Ok(fit) => {
                    same_bits &= first.as_ref().is_none_or(|(_, first)| first.t_target_source == fit.t_target_source);
                    first.get_or_insert((target, fit));
                }
            }
        }
        let (Some((target, fit)), Some(started)) = (first, started) else { return Ended::Interrupted };
        let doubt = off_surface(&target, self.inputs.start.landmarks().0);
        let judged = self.judge.map(|judge| judge.judge(&target, &self.inputs, &started, &fit));
        let moved = self.moves_source.then(|| moved_source(&target, self.inputs.source.cloud(), &fit.t_target_source));
        let moved = match moved.transpose() {
            Ok(moved) => moved,
            Err(error) => return Ended::Refused(error.to_string()),
        };
        Ended::Fit(Box::new(Aligned { fit, doubt, moved, started, timings, same_bits, judged }))
    }
}

/// Processor time of the process, ms; `None` if the platform does not measure it.
#[cfg(unix)]
fn cpu_ms() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6)
}

#[cfg(not(unix))]
fn cpu_ms() -> Option<f64> {
    None
}

/// Progress on a terminal; nothing elsewhere.
pub(super) struct ProgressLine {
    bar: Option<ProgressBar>,
    is_shown: bool,
    repeat: u32,
    began: Instant,
    last: Instant,
}

impl ProgressLine {
    pub(super) fn new(repeat: u32, global: &Global) -> Self {
        let is_shown = !global.quiet && global.format == Format::Text && std::io::stderr().is_terminal();
        Self { bar: None, is_shown, repeat, began: Instant::now(), last: Instant::now() }
    }

    fn update(&mut self, n: u32, step: &IcpStep) {
        if !self.is_shown || self.began.elapsed() < DELAY || self.last.elapsed() < REFRESH {
            return;
        }
        self.last = Instant::now();
        let bar = self.bar.get_or_insert_with(|| {
            let style = ProgressStyle::with_template("{spinner} {wide_msg}").expect("the template is fixed");
            ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()).with_style(style)
        });
        let (repeat, iteration, rms_mm) = (self.repeat, step.iteration, step.rms_mm);
        let which = if repeat > 1 { format!("{n} of {repeat}  ") } else { String::new() };
        bar.set_message(format!("{which}step {iteration}  {} pairs  RMS {rms_mm:.4} mm", step.n_pairs));
        bar.tick();
    }
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
