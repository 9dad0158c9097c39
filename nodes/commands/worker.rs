//! Commands that other commands run as processes of their own: they inspect a plugin, and serve a node of one.

use super::common::Exit;
use crate::app::registry;
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::plugin::{answer, serve};
use std::{io::Write, path::PathBuf};

/// Inspect a library and print its description; run by other commands as a separate process.
#[derive(Debug, Args)]
#[command(hide = true)]
pub(crate) struct PluginProbe {
    file: PathBuf,
}

impl PluginProbe {
    pub(crate) fn execute(&self) -> Result<Exit> {
        std::io::stdout().write_all(answer(&self.file).as_bytes())?;
        Ok(Exit::Done)
    }
}

/// Build a node and fire it when asked, over the connection on standard input; run by other commands as a separate process.
#[derive(Debug, Args)]
#[command(hide = true)]
pub(crate) struct Worker {}

impl Worker {
    pub(crate) fn execute(&self) -> Result<Exit> {
        serve(registry()).context("this command is run by others, for a node with process = true")?;
        Ok(Exit::Done)
    }
}
