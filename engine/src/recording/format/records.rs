//! The metadata records of a recording.

use super::{Entries, FORMAT_VERSION, MetadataRecord, MetadataRecords};
use crate::{
    hash::Digest,
    plan::{PlanPlugin, Sources},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value as Json;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::RangeInclusive,
    path::PathBuf,
};

fn text(entries: &Entries, key: &str) -> Result<String, String> {
    entries.get(key).cloned().ok_or_else(|| format!("it lacks \"{key}\""))
}

fn number<T: std::str::FromStr>(entries: &Entries, key: &str) -> Result<T, String> {
    let text = text(entries, key)?;
    text.parse().map_err(|_| format!("its \"{key}\" is no number but \"{text}\""))
}

fn json<T: DeserializeOwned>(entries: &Entries, key: &str) -> Result<T, String> {
    serde_json::from_str(&text(entries, key)?).map_err(|error| format!("its \"{key}\" cannot be read: {error}"))
}

fn json_text<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("maps with text keys are JSON")
}

fn entries<const N: usize>(entries: [(&str, String); N]) -> Entries {
    entries.into_iter().map(|(key, value)| (key.into(), value)).collect()
}

/// The graph that ran, its seed and the version of the engine. Every recording begins with it.
#[derive(Debug, Clone, PartialEq)]
pub struct RunRecord {
    /// The graph as it ran, in the text of a graph file.
    pub graph: String,
    /// The graph file it came from.
    pub graph_file: PathBuf,
    /// The graph's name.
    pub name: String,
    /// The run's seed.
    pub seed: u64,
    /// How a replay gets the data of the sources.
    pub sources: Sources,
    /// The version of the program that wrote it.
    pub version: String,
    /// The parameters of each node that the user wrote, as `rules.most`, and not its kind.
    pub written: BTreeMap<String, BTreeSet<String>>,
    /// The nodes that were functions of the program that ran it, which no file holds.
    pub functions: Vec<String>,
}

impl MetadataRecord for RunRecord {
    const NAME: &'static str = "osteoflow";

    fn to_metadata(&self) -> Entries {
        let mut entries = entries([
            ("format_version", FORMAT_VERSION.to_string()),
            ("graph", self.graph.clone()),
            ("graph_file", self.graph_file.display().to_string()),
            ("name", self.name.clone()),
            ("seed", self.seed.to_string()),
            ("sources", self.sources.name().into()),
            ("version", self.version.clone()),
            ("written", json_text(&self.written)),
        ]);
        let functions = Some(&self.functions).filter(|functions| !functions.is_empty());
        entries.extend(functions.map(|functions| ("functions".to_owned(), json_text(functions))));
        entries
    }

    fn from_metadata(entries: &Entries) -> Result<Self, String> {
        let sources = text(entries, "sources").unwrap_or_default();
        Ok(Self {
            graph: text(entries, "graph")?,
            graph_file: text(entries, "graph_file")?.into(),
            name: text(entries, "name")?,
            seed: number(entries, "seed")?,
            sources: if sources == Sources::Hashes.name() { Sources::Hashes } else { Sources::Wires },
            version: text(entries, "version")?,
            written: json(entries, "written")?,
            functions: entries
                .contains_key("functions")
                .then(|| json(entries, "functions"))
                .transpose()?
                .unwrap_or_default(),
        })
    }
}

/// Name of the record of program and machine, as the command describes them.
pub(crate) const PROGRAM: &str = "osteoflow.program";
/// Name of the record of the SHA-256 of each input file by its path, or why there is none. At the front where sources are
/// identified by it, otherwise at the end.
pub(crate) const INPUT_HASHES: &str = "osteoflow.inputs";

/// The plugins of the graph, with the SHA-256 of their libraries.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct PluginRecords(pub(crate) Vec<PlanPlugin>);

impl MetadataRecord for PluginRecords {
    const NAME: &'static str = "osteoflow.plugins";

    fn to_metadata(&self) -> Entries {
        self.0.iter().map(|plugin| (plugin.path.to_string_lossy().into_owned(), json_text(plugin))).collect()
    }

    fn from_metadata(entries: &Entries) -> Result<Self, String> {
        entries.keys().map(|path| json(entries, path)).collect::<Result<_, _>>().map(Self)
    }
}

/// The text of plugins in an interpreted language and of their modules, by SHA-256.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct PluginTexts(pub(crate) BTreeMap<String, String>);

impl MetadataRecord for PluginTexts {
    const NAME: &'static str = "osteoflow.plugin_texts";

    fn to_metadata(&self) -> Entries {
        self.0.clone()
    }

    fn from_metadata(entries: &Entries) -> Result<Self, String> {
        match entries.iter().find(|(sha256, text)| Digest::of(text.as_bytes()).to_string() != **sha256) {
            Some((sha256, _)) => Err(format!("the text of {sha256} has another SHA-256")),
            None => Ok(Self(entries.clone())),
        }
    }
}

/// Names of further records of these two types, of the plugins that loaded more while their nodes fired.
pub(crate) const LATE_PLUGINS: &str = "osteoflow.late_plugins";
pub(crate) const LATE_PLUGIN_TEXTS: &str = "osteoflow.late_plugin_texts";

/// The plugins with what they had loaded in the end, and the text of their files.
///
/// # Errors
/// Which record cannot be read.
pub(crate) fn plugins(metadata: &MetadataRecords) -> Result<(Vec<PlanPlugin>, BTreeMap<String, String>), String> {
    let unread = |name: &str, error: String| format!("its metadata record \"{name}\": {error}");
    let of = |name| {
        let entries = metadata.entries(name).map(PluginRecords::from_metadata).transpose();
        entries.map(|records| records.unwrap_or_default().0).map_err(|error| unread(name, error))
    };
    let texts = |name| {
        let entries = metadata.entries(name).map(PluginTexts::from_metadata).transpose();
        entries.map(|texts| texts.unwrap_or_default().0).map_err(|error| unread(name, error))
    };
    let (mut plugins, mut all_texts) = (of(PluginRecords::NAME)?, texts(PluginTexts::NAME)?);
    for late in of(LATE_PLUGINS)? {
        if let Some(plugin) = plugins.iter_mut().find(|plugin| plugin.path == late.path) {
            *plugin = late;
        }
    }
    all_texts.extend(texts(LATE_PLUGIN_TEXTS)?);
    Ok((plugins, all_texts))
}

/// The number of items of a wire, and of values among them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct WireCount {
    pub(crate) items: u64,
    pub(crate) values: u64,
}

/// Number of items of each wire. Only a finished recording has it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct WireCounts(pub(crate) BTreeMap<String, WireCount>);

impl WireCounts {
    /// Parses the counts of a wire.
    pub(crate) fn parse(text: &str) -> Option<WireCount> {
        serde_json::from_str(text).ok()
    }
}

impl MetadataRecord for WireCounts {
    const NAME: &'static str = "osteoflow.wires";

    fn to_metadata(&self) -> Entries {
        self.0.iter().map(|(wire, count)| (wire.clone(), json_text(count))).collect()
    }

    fn from_metadata(entries: &Entries) -> Result<Self, String> {
        let count = |(wire, text): (&String, &String)| match Self::parse(text) {
            Some(count) => Ok((wire.clone(), count)),
            None => Err(format!("it says \"{text}\" of {wire}, which is no count")),
        };
        entries.iter().map(count).collect::<Result<_, _>>().map(Self)
    }
}

/// A node's failure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordedFailure {
    /// The node.
    pub node: String,
    /// Its activation, from 0.
    pub item: u64,
    /// The error's message.
    pub reason: String,
    /// Whether the node went on with the next item.
    pub skipped: bool,
}

/// How the run ended, and its results.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Outcome {
    /// `complete`, `refused` or `interrupted`.
    pub(crate) status: String,
    /// Content of `results.json`.
    pub(crate) results: Json,
    /// SHA-256 of the results where paths in `results` stand as they are shown.
    pub(crate) results_digest: Option<String>,
    /// Constants that the command put into `results.json`.
    pub(crate) fixed_results: serde_json::Map<String, Json>,
    /// The failures of nodes.
    pub(crate) failures: Vec<RecordedFailure>,
}

impl Outcome {
    /// Status of a run that the user stopped.
    pub(crate) const INTERRUPTED: &'static str = "interrupted";
    const RESULTS_DIGEST: &'static str = "results_sha256";
}

impl MetadataRecord for Outcome {
    const NAME: &'static str = "osteoflow.outcome";

    fn to_metadata(&self) -> Entries {
        let mut all = entries([
            ("status", self.status.clone()),
            ("results", self.results.to_string()),
            ("fixed_results", json_text(&self.fixed_results)),
            ("failures", json_text(&self.failures)),
        ]);
        all.extend(self.results_digest.clone().map(|digest| (Self::RESULTS_DIGEST.to_owned(), digest)));
        all
    }

    fn from_metadata(entries: &Entries) -> Result<Self, String> {
        Ok(Self {
            status: text(entries, "status")?,
            results: json(entries, "results")?,
            results_digest: entries.get(Self::RESULTS_DIGEST).cloned(),
            fixed_results: json(entries, "fixed_results")?,
            failures: json(entries, "failures")?,
        })
    }
}

/// What a recording lacks that was recovered from a damaged file.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Recovered {
    /// Each damage, with the name of the file.
    pub(crate) damage: Vec<String>,
    pub(crate) bytes_lost: u64,
    /// Number of items of each wire before the first damage; later items may depend on lost ones.
    pub(crate) before_damage: BTreeMap<String, u64>,
    /// Missing numbers, by wire.
    pub(crate) missing: BTreeMap<String, Vec<RangeInclusive<u64>>>,
    /// Lost records of the run.
    pub(crate) lost: Vec<String>,
}

impl MetadataRecord for Recovered {
    const NAME: &'static str = "osteoflow.recovered";

    fn to_metadata(&self) -> Entries {
        let ranges = |ranges: &Vec<RangeInclusive<u64>>| ranges.iter().map(|r| (*r.start(), *r.end())).collect();
        let missing: BTreeMap<_, Vec<_>> = self.missing.iter().map(|(wire, missing)| (wire, ranges(missing))).collect();
        entries([
            ("damage", self.damage.join("\n")),
            ("bytes_lost", self.bytes_lost.to_string()),
            ("before_damage", json_text(&self.before_damage)),
            ("missing", json_text(&missing)),
            ("lost", self.lost.join("\n")),
        ])
    }

    fn from_metadata(entries: &Entries) -> Result<Self, String> {
        let lines = |key| text(entries, key).map(|text| text.lines().map(str::to_owned).collect());
        let missing: BTreeMap<String, Vec<(u64, u64)>> = json(entries, "missing")?;
        let ranges = |ranges: Vec<(u64, u64)>| ranges.into_iter().map(|(first, last)| first..=last).collect();
        Ok(Self {
            damage: lines("damage")?,
            bytes_lost: number(entries, "bytes_lost")?,
            before_damage: json(entries, "before_damage")?,
            missing: missing.into_iter().map(|(wire, missing)| (wire, ranges(missing))).collect(),
            lost: lines("lost")?,
        })
    }
}

/// A wire as described by the metadata of its exact channel.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct WireHeader {
    /// The node; empty where unknown, as in repro bundles.
    pub(crate) node: String,
    /// The output.
    pub(crate) port: String,
    /// The node's kind.
    pub(crate) kind: String,
    /// The payload's name.
    pub(crate) payload: String,
    /// The version of its view.
    pub(crate) version: u32,
    /// Whether its node is a source.
    pub(crate) source: bool,
    /// Units of fields and columns whose names do not contain them, as JSON.
    pub(crate) units: String,
    /// Schema of the payload's views, as JSON; `None` where the channel has none.
    pub(crate) schema: Option<String>,
}

impl WireHeader {
    /// The name of the channel's schema: `geometry/msg/CloudV1`, as ROS 2 names types, which strict readers of its schemas demand. A
    /// payload that cannot be named so keeps `payload@version`.
    pub(crate) fn schema_name(&self) -> String {
        let Self { payload, version, .. } = self;
        let is_package = |name: &str| {
            name.starts_with(|c: char| c.is_ascii_lowercase())
                && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
                && !name.contains("__")
                && !name.ends_with('_')
        };
        let is_name = |name: &str| {
            name.starts_with(|c: char| c.is_ascii_uppercase()) && name.chars().all(|c| c.is_ascii_alphanumeric())
        };
        match payload.split_once('/') {
            Some((package, name)) if is_package(package) && is_name(name) => format!("{package}/msg/{name}V{version}"),
            _ if payload == "any" => format!("osteoflow/msg/AnyV{version}"),
            _ => format!("{payload}@{version}"),
        }
    }

    pub(crate) fn to_metadata(&self) -> Entries {
        let mut all = entries([
            ("node", self.node.clone()),
            ("port", self.port.clone()),
            ("kind", self.kind.clone()),
            ("payload", self.payload.clone()),
            ("version", self.version.to_string()),
            ("units", self.units.clone()),
            ("source", self.source.to_string()),
        ]);
        all.retain(|_, text| !text.is_empty());
        all.extend(self.schema.iter().map(|schema| ("schema".into(), schema.clone())));
        all
    }

    /// Missing entries become empty: channels of repro bundles have fewer.
    pub(crate) fn from_metadata(entries: &Entries) -> Self {
        let text = |key: &str| entries.get(key).cloned().unwrap_or_default();
        Self {
            node: text("node"),
            port: text("port"),
            kind: text("kind"),
            payload: text("payload"),
            version: text("version").parse().unwrap_or(0),
            source: text("source") == "true",
            units: text("units"),
            schema: entries.get("schema").cloned(),
        }
    }
}
