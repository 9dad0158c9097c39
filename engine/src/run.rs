//! Runs a checked graph: options, events, report and the files written.

mod closing_log;
#[cfg(test)]
mod contract_tests;
#[cfg(test)]
mod feedback_tests;
pub mod files;
mod finished;
#[cfg(test)]
mod live_tests;
mod manifest;
mod nothing_came;
mod report;
mod results;
#[cfg(test)]
mod sign_tests;
#[cfg(test)]
mod tests;
pub mod verdict;
#[cfg(test)]
mod verdict_tests;

pub use crate::runtime::{
    BuildFault, Enlargement, Event, Injected, Injection, LatencyStats, LinkStats, NodeStats, Observer, Refusal, Sign,
    Spread, Warning,
};
pub use crate::{
    answer_cache::CachedAnswer,
    options::{GIVEN_NODES, ListenedChannel, Listener, RunOptions},
};
pub(crate) use finished::{Finished, WireItems};
pub(crate) use nothing_came::NOTHING_CAME;
pub use report::{Outcome, RunError, RunReport};
pub use verdict::{Answer, Reason, Verdict};

use crate::{
    answer_cache::StoredAnswers,
    cpu_time::CPU_CLOCK,
    durable,
    hash::files::Hashes,
    plan::{Plan, ResultEntry, Sources},
    record::{RecordError, Recorder},
    recording::RecordedFailure,
    repro::Saver,
    runtime::{AnswerCache, Failure, Latency, Replayed, RunSettings, Runtime, Tap},
    shown_paths::ShownPaths,
};
use closing_log::closing_log;
use finished::ItemKeeper;
use osteoflow_node::Registry;
use std::{path::Path, time::SystemTime};

/// Runs the graph to its end and writes the files that `options` ask for.
///
/// The report covers failed nodes, missing results and interruptions; `results.json` then holds the reason and no
/// results. If the verdict on the results does not suffice, it holds the verdict and those results that are reports.
///
/// # Errors
/// [`RunError`] if a node cannot be built from its parameters, or a file of the run cannot be written.
pub fn run(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<RunReport, RunError> {
    run_with(plan, registry, options, observer, Replayed::default(), None)
}

/// Like [`run()`], with recorded values of a replay and a further tap.
pub(crate) fn run_with(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
    replayed: Replayed,
    tap: Option<&dyn Tap>,
) -> Result<RunReport, RunError> {
    run_part(plan, registry, options, observer, replayed, tap, None)
}

/// The full run that a partial run belongs to.
pub(crate) struct FullRun<'a> {
    /// Plan of the full run, for results and manifest.
    pub(crate) plan: &'a Plan,
    /// Adds the items that were not computed to those of the partial run, which keeps every item of every wire.
    pub(crate) complete: &'a mut dyn FnMut(Finished) -> Finished,
    /// The entry `watch` of the manifest.
    pub(crate) about: Option<serde_json::Value>,
}

/// Like [`run_with`], for a plan that may be part of a larger one.
pub(crate) fn run_part(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
    replayed: Replayed,
    tap: Option<&dyn Tap>,
    whole: Option<FullRun<'_>>,
) -> Result<RunReport, RunError> {
    let began = SystemTime::now();
    let out_dir = options.out_dir.as_deref();
    let settings = RunSettings {
        workers: options.workers,
        shuffle: options.shuffle,
        out_dir,
        cancelled: options.cancelled.clone(),
        inject: &options.inject,
        cpu_clock: CPU_CLOCK.filter(|_| options.cpu_time),
        clock: options.clock.clone(),
    };
    let answers = StoredAnswers::new(plan, registry, options);
    let answer_cache = answers.as_ref().map(|answers| answers as &dyn AnswerCache);
    let mut runtime = Runtime::build(plan, registry, &settings, answer_cache, observer, replayed)?;
    if let Some(dir) = out_dir {
        let failed = |error| RunError::Files(format!("{}: {error}", dir.display()));
        std::fs::create_dir_all(dir).map_err(failed)?;
    }
    // Hashing the inputs takes as long as reading them; it runs in parallel, unless the recording begins with the
    // hashes.
    let mut hashes = out_dir.map(|_| Hashes::begin(&plan.input_files));
    let shown = ShownPaths::of(plan, options);
    let recorder = match out_dir.filter(|_| options.record) {
        Some(dir) => {
            let by_hash = plan.recording.sources == Sources::Hashes;
            let inputs = hashes.as_mut().filter(|_| by_hash).map(|hashes| hashes.done());
            Some(Recorder::create(&dir.join(files::RECORDING), plan, options, inputs, &shown)?)
        }
        None => None,
    };
    let keeper = ItemKeeper::new(plan, whole.is_some());
    let saver = Saver::new(plan, options);
    let latency = options.latency.then(|| Latency::new(plan));
    let mut taps: Vec<&dyn Tap> = vec![&keeper];
    taps.extend(recorder.iter().map(|recorder| recorder as &dyn Tap));
    taps.extend(latency.iter().map(|latency| latency as &dyn Tap));
    taps.extend(saver.iter().map(|saver| saver as &dyn Tap));
    taps.extend(tap);
    runtime.tap(&taps);
    runtime.run();
    let ended = runtime.into_outcome();
    drop(taps);
    let latencies = latency.map(|latency| latency.stats(plan)).unwrap_or_default();
    let mut finished = keeper.finish(ended, saver.map(Saver::finish).unwrap_or_default());
    // Destroyed when everything is written, also where that fails.
    let retired = std::mem::take(&mut finished.ended.retired);
    let recorded_plan = plan;
    let (plan, about) = match whole {
        Some(whole) => {
            finished = (whole.complete)(finished);
            (whole.plan, whole.about)
        }
        None => (plan, None),
    };
    let (outcome, mut results) = results::collect(plan, options, &mut finished, &shown);
    if recorder.is_some() {
        finished.ended.warnings.extend(paths_in_results(plan, &results, &shown));
    }
    let inputs = hashes.as_mut().map(|hashes| hashes.done()).unwrap_or_default();
    let recorded = recorder.map(|recorder| {
        let at_end = (plan.recording.sources != Sources::Hashes).then_some(inputs);
        let mut failures: Vec<_> = finished.ended.failures.iter().map(|failure| recorded(plan, failure)).collect();
        failures.iter_mut().for_each(|failure| failure.reason = shown.text(&failure.reason));
        let at_end = at_end.map(|inputs| shown.json(inputs.into()));
        let at_end = at_end.as_ref().and_then(|inputs| inputs.as_array().map(Vec::as_slice));
        let log = closing_log(recorded_plan, &finished.ended.warnings, &outcome, &results);
        recorder.finish(outcome.status(), &results, &failures, options, at_end, log)
    });
    if let (Some(Err(error)), Outcome::Interrupted) = (&recorded, &outcome) {
        // The user did not stop the run.
        results = results::not_recorded(options, &error.to_string());
        results::add_reasons(&mut results, &finished.ended.signs, &shown);
    }
    let mut report = report_of(plan, finished, outcome, results);
    report.latencies = latencies;
    report.cached_answers = answers.map(StoredAnswers::finish).unwrap_or_default();
    if let Some(dir) = out_dir {
        let times = (began, SystemTime::now());
        let mut manifest = manifest::manifest(plan, options, &report, recorded.as_ref(), inputs, times);
        if let Some(about) = about {
            manifest["watch"] = about;
        }
        let to_write = [(files::RESULTS, shown.json(report.results.clone())), (files::MANIFEST, shown.json(manifest))];
        write_files(dir, &to_write, recorded.as_ref().and_then(|recorded| recorded.as_ref().err()))?;
    }
    recorded.transpose()?;
    drop(retired);
    Ok(report)
}

/// A warning for each result with a path: recorded results show it shortened, but the item cannot be changed.
fn paths_in_results(plan: &Plan, results: &serde_json::Value, shown: &ShownPaths) -> Vec<Warning> {
    let with_path = plan.results.iter().filter(|entry| {
        let value = entry.key.split('.').try_fold(results, |value, key| value.get(key));
        value.is_some_and(|value| shown.json(value.clone()) != *value)
    });
    let warning = |entry: &ResultEntry| Warning {
        node: plan.nodes[entry.from.node].name.to_string(),
        item: 0,
        message: format!(
            "the result \"{}\" holds the whole path of a file, and so does the recorded wire {}; let the node give the \
             file's name alone",
            entry.key,
            plan.wire_name(entry.from)
        ),
    };
    with_path.map(warning).collect()
}

fn recorded(plan: &Plan, failure: &Failure) -> RecordedFailure {
    let Failure { item, skipped, .. } = *failure;
    RecordedFailure { node: plan.nodes[failure.node].name.to_string(), item, reason: failure.reason.clone(), skipped }
}

fn report_of(plan: &Plan, finished: Finished, outcome: Outcome, results: serde_json::Value) -> RunReport {
    let Finished { ended, saved, .. } = finished;
    let mut warnings = ended.warnings;
    // A failure that does not refuse the run must still be reported.
    let refused = match &outcome {
        Outcome::Refused(refusal) => refusal.item.map(|item| (refusal.node.clone(), item)),
        _ => None,
    };
    warnings.extend(ended.failures.into_iter().filter_map(|failure| {
        let node = plan.nodes[failure.node].name.to_string();
        (refused != Some((node.clone(), failure.item))).then_some(Warning {
            node,
            item: failure.item,
            message: failure.reason,
        })
    }));
    RunReport {
        outcome,
        results,
        nodes: ended.nodes,
        links: ended.links,
        latencies: Vec::new(),
        contracts: ended.contracts,
        enlargements: ended.enlargements,
        warnings,
        elapsed: ended.elapsed,
        saved,
        cached_answers: Vec::new(),
    }
}

/// Writes the files that follow the recording. A reader that finds them finds the recording whole, as it is synced
/// first.
fn write_files(
    dir: &Path,
    to_write: &[(&'static str, serde_json::Value)],
    not_recorded: Option<&RecordError>,
) -> Result<(), RunError> {
    let write = |name: &str, value: &serde_json::Value| {
        let mut text = serde_json::to_string_pretty(value)?;
        text.push('\n');
        durable::write(dir.join(name), text.as_bytes())
    };
    let mut failed: Vec<(&'static str, std::io::Error)> =
        to_write.iter().filter_map(|(name, value)| Some((*name, write(name, value).err()?))).collect();
    if failed.is_empty() {
        return Ok(());
    }
    let mut missing: Vec<_> = failed.iter().map(|(name, _)| (*name).to_owned()).collect();
    if not_recorded.is_some() {
        missing.insert(0, format!("the end of {}", files::RECORDING));
    }
    let (name, error) = failed.swap_remove(0);
    let (path, missing) = (dir.join(name), missing.join(", "));
    Err(RunError::Files(format!("{}: {error}; the files of this run lack {missing}", path.display())))
}
