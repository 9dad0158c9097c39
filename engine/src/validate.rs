//! Checks a whole recording and lists everything that is wrong with it.

mod items;

pub use crate::recording::findings::Finding;
use crate::{
    check::check_recorded,
    plugin::Kinds,
    recording::{
        RecordingError,
        findings::Findings,
        format::{
            LATE_PLUGIN_TEXTS, LATE_PLUGINS, MetadataRecord, MetadataRecords, Outcome, PluginRecords, PluginTexts,
            Recovered, RunRecord, WireCounts,
        },
        run_record,
        scan::{Passed, pass},
    },
};
use items::Items;
use osteoflow_container::{End, Progress};
use std::path::Path;

/// A wire of the recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ValidatedWire {
    /// `node.port`.
    pub wire: String,
    /// `payload@version`.
    pub payload: String,
    /// Number of items on its exact channel.
    pub n_items: u64,
    /// Number of those items that are values.
    pub n_values: u64,
    /// Number of messages for viewers.
    pub n_views: u64,
}

/// Result of [`validate`].
#[derive(Debug)]
pub struct ValidateReport {
    /// Whether it is a recording of a run; if not, only the container was checked.
    pub is_recording: bool,
    /// Findings in the order of the file; of many of one kind, only the first are listed.
    pub findings: Vec<Finding>,
    /// Number of all findings, including those not listed.
    pub n_findings: u64,
    /// Information that is not an error.
    pub notes: Vec<String>,
    /// The wires, by name.
    pub wires: Vec<ValidatedWire>,
    /// Number of messages in the file.
    pub n_messages: u64,
    /// Number of chunks in the file.
    pub n_chunks: u64,
    /// Size of the file.
    pub n_bytes: u64,
}

impl ValidateReport {
    /// Whether there are no findings.
    pub fn is_sound(&self) -> bool {
        self.n_findings == 0
    }
}

/// Checks a file. For an MCAP file of another program, only the container is checked. Memory: one chunk and an index.
///
/// # Errors
/// [`RecordingError`] if the file cannot be read or is not an MCAP file.
pub fn validate(
    path: &Path,
    kinds: impl Into<Kinds>,
    progress: Progress<'_>,
) -> Result<ValidateReport, RecordingError> {
    let kinds: Kinds = kinds.into();
    let mut items = Items::new(kinds.registry());
    let Passed { reader, metadata, container, mut findings, end, .. } = pass(path, &mut items, progress)?;
    if let End::Truncated(damage) = &end {
        let what = format!("the file was cut short: {damage}; `osteoflow recover` saves what is before");
        findings.add("end", Finding::new(None, what));
    }
    let mut notes = Vec::new();
    if let End::Complete { trailing } = end
        && trailing > 0
    {
        notes.push(format!("{trailing} bytes follow the closing magic; they are not read"));
    }
    let (n_messages, n_chunks) = (container.n_messages(), container.n_chunks());
    let is_recording = metadata.has::<RunRecord>() || items.has_wires();
    let lost = container.finish(&mut findings);
    if is_recording {
        check_metadata(path, &metadata, &kinds.over(items.registry()), &mut findings, &mut notes);
        items.finish(&metadata, &mut findings, &mut notes);
    } else {
        notes.push("it is no recording of a run: only the container was checked".into());
        notes.extend(findings.take(&["habit"]).iter().map(|habit| format!("{habit}; a habit of its writer")));
    }
    if let Some(lost) = lost {
        findings.fold_losses(&lost);
    }
    Ok(ValidateReport {
        is_recording,
        n_findings: findings.n(),
        findings: findings.into_listed(),
        notes,
        wires: items.wires(),
        n_messages,
        n_chunks,
        n_bytes: reader.n_bytes(),
    })
}

/// Checks that the metadata records of the run are present and valid.
fn check_metadata(
    path: &Path,
    metadata: &MetadataRecords,
    kinds: &Kinds,
    findings: &mut Findings,
    notes: &mut Vec<String>,
) {
    let recovered = metadata.has::<Recovered>();
    let mut missing = |finding: String| match recovered {
        // The recovery has already listed what is missing.
        true => notes.push(finding),
        false => findings.add("metadata", Finding::new(None, finding)),
    };
    for (name, is_there, why) in [
        (RunRecord::NAME, metadata.has::<RunRecord>(), ""),
        (WireCounts::NAME, metadata.has::<WireCounts>(), "; the run did not finish it"),
        (Outcome::NAME, metadata.has::<Outcome>(), "; the run did not finish it"),
    ] {
        if !is_there {
            missing(format!("the metadata record \"{name}\" is missing{why}"));
        }
    }
    if metadata.has::<RunRecord>() {
        match run_record(path, metadata, None) {
            Err(error) => findings.add("metadata", Finding::new(None, error.to_string())),
            Ok(run) => {
                if let Err(error) = run.graph.parse::<toml::Table>() {
                    let what = format!("the recorded graph is no TOML: {}", error.message());
                    findings.add("metadata", Finding::new(None, what));
                } else if check_recorded(&run.graph, &run.graph_file, &[], kinds).is_err() {
                    notes.push("the recorded graph does not fit this program, so it cannot be replayed here".into());
                }
            }
        }
    }
    let mut unreadable = |name: &str, error: Option<String>| {
        if let Some(error) = error {
            findings.add("metadata", Finding::new(None, format!("the metadata record \"{name}\": {error}")));
        }
    };
    unreadable(Outcome::NAME, metadata.get::<Outcome>().and_then(Result::err));
    unreadable(PluginRecords::NAME, metadata.get::<PluginRecords>().and_then(Result::err));
    unreadable(PluginTexts::NAME, metadata.get::<PluginTexts>().and_then(Result::err));
    unreadable(LATE_PLUGINS, metadata.entries(LATE_PLUGINS).map(PluginRecords::from_metadata).and_then(Result::err));
    let texts = metadata.entries(LATE_PLUGIN_TEXTS).map(PluginTexts::from_metadata);
    unreadable(LATE_PLUGIN_TEXTS, texts.and_then(Result::err));
    unreadable(Recovered::NAME, metadata.get::<Recovered>().and_then(Result::err));
    if recovered {
        notes.push("it was recovered from a damaged file and is a part of what was recorded".into());
    }
}
