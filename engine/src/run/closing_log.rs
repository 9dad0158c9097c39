//! The last messages of a recording's log.

use super::{Answer, Outcome, Reason, Verdict, Warning};
use crate::{plan::Plan, record::LogEntry, recording::format::LogLevel};

/// What the recording's log says at the end: warnings that no firing gave, and how the run ended.
pub(super) fn closing_log(
    plan: &Plan,
    warnings: &[Warning],
    outcome: &Outcome,
    results: &serde_json::Value,
) -> Vec<LogEntry> {
    let entry = |node: &str, item, level, message| {
        let node = plan.node(node);
        LogEntry { node, item, stamp_ns: None, level, message }
    };
    let warning = |w: &Warning| entry(&w.node, w.item, LogLevel::Warning, w.message.clone());
    let mut log: Vec<_> = warnings.iter().map(warning).collect();
    let level = |answer| match answer {
        Answer::Trusted => LogLevel::Info,
        Answer::Doubtful => LogLevel::Warning,
        Answer::Refused => LogLevel::Error,
    };
    log.push(match outcome {
        Outcome::Complete => entry("", 0, LogLevel::Info, "the run is complete".into()),
        Outcome::Refused(refusal) => entry(
            &refusal.node,
            refusal.item.unwrap_or_default(),
            LogLevel::Error,
            format!("the run is refused: {}", refusal.reason),
        ),
        Outcome::Interrupted => entry("", 0, LogLevel::Error, "the run was interrupted before its end".into()),
    });
    if let Some(verdict) = Verdict::of(results) {
        log.push(entry("", 0, level(verdict.answer()), format!("verdict: {}", verdict.answer())));
        let reason = |r: &Reason| entry("", 0, level(r.answer), format!("{}: {r}", r.rule));
        log.extend(verdict.against().map(reason));
    }
    log
}
