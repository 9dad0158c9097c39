//! Options that several requests share, each stated once: as the command line takes it, and as a field.

use super::{error::UsageError, files::unless_data, plugins::Plugins, shipped};
use anyhow::Result;
use clap::{
    Args,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use osteoflow_engine::{
    check::{Checked, check},
    store::{Settings, Store},
};
use osteoflow_formats::Space;
use serde::Deserialize;
use std::{num::NonZeroUsize, path::PathBuf, sync::Arc};

/// The value of a key of a graph: a boolean, number, text, list or table.
pub type SettingValue = toml::Value;

/// A graph file and the changes that the command line makes to it.
#[derive(Debug, Clone, Args)]
pub struct GraphArgs {
    /// The graph file.
    pub graph: PathBuf,

    /// Change any key of the graph: NODE.PARAMETER=VALUE, NODE.kind=KIND, graph.seed=7; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,

    /// Plugins in addition to those of the graph.
    #[command(flatten)]
    pub plugins: Plugins,
}

impl GraphArgs {
    /// The checked graph; the error holds the faults.
    pub(crate) fn checked(&self) -> Result<Checked> {
        shipped::check_is_here(&self.graph)?;
        Ok(unless_data(&self.graph, check(&self.graph, &self.sets, self.plugins.kinds()?))?)
    }
}

/// Output folder and number of threads of a run.
#[derive(Debug, Clone, Args)]
pub struct Leave {
    /// The folder to write the files into; refused if not empty.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Write into a folder that is not empty, and replace the files of a run in it; other files stay.
    #[arg(long)]
    pub force: bool,

    /// Number of threads that run nodes; the results do not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    pub workers: Option<NonZeroUsize>,
}

/// Whether to cache answers between runs.
#[derive(Debug, Clone, Default, Args, Deserialize)]
#[serde(default)]
pub struct Keep {
    /// Compute everything, and keep nothing for later commands; the results are the same. The environment variable OSTEOFLOW_CACHE names the
    /// folder of kept results, or is `off`; OSTEOFLOW_CACHE_MAX_MB is its largest size (default 1 GiB).
    #[arg(long)]
    pub no_cache: bool,
}

impl Keep {
    /// The store that the environment names, unless caching is disabled.
    pub(crate) fn store(&self) -> Result<Option<Arc<Store>>, UsageError> {
        if self.no_cache {
            return Ok(None);
        }
        let settings = Settings::from_env().map_err(|error| UsageError(error.to_string()))?;
        Ok(settings.map(|settings| Arc::new(Store::open(settings))))
    }
}

/// Reads an anatomical space.
pub(crate) fn space() -> impl TypedValueParser<Value = Space> {
    let lps = "Left, posterior, superior: DICOM's, and that of STL and PLY files in 3D Slicer";
    let ras = "Right, anterior, superior: NIfTI's, and what 3D Slicer shows";
    PossibleValuesParser::new([PossibleValue::new("lps").help(lps), PossibleValue::new("ras").help(ras)])
        .map(|name| if name.eq_ignore_ascii_case("ras") { Space::Ras } else { Space::Lps })
}
