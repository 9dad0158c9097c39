//! Switches that several commands share: where to write, how many threads, whether to cache.

use crate::app::program;
use anyhow::Result;
use clap::Args;
use osteoflow_engine::store::Store;
use std::{num::NonZeroUsize, path::PathBuf, sync::Arc};

/// Output folder and number of threads of a run.
#[derive(Debug, Clone, Args)]
pub(crate) struct Leave {
    /// The folder to write the files into; refused if not empty.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,

    /// Write into a folder that is not empty, and replace the files of a run in it; other files stay.
    #[arg(long)]
    pub(crate) force: bool,

    /// Number of threads that run nodes; the results do not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    pub(crate) workers: Option<NonZeroUsize>,
}

/// Whether to cache answers between runs.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct Keep {
    /// Compute everything: neither load answers from the store nor save them there. The results are the same with and
    /// without it. OSTEOFLOW_CACHE names the store's folder, or is `off`; OSTEOFLOW_CACHE_MAX_MB limits its size (1 GiB).
    #[arg(long)]
    pub(crate) no_cache: bool,
}

impl Keep {
    /// Whether to cache answers.
    pub(crate) fn cache(&self) -> bool {
        !self.no_cache
    }

    /// The store that the environment names, unless caching is disabled.
    pub(crate) fn store(&self) -> Result<Option<Arc<Store>>> {
        Ok(program::store(self.cache())?)
    }
}
