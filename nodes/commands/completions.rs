use super::common::{Exit, terminal};
use anyhow::Result;
use clap::{Args, Command};
use clap_complete::Shell;
use std::io::Write;

/// Print a script for completion by the Tab key: with it, your shell completes commands and options.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow completions bash > ~/.local/share/bash-completion/completions/osteoflow
  osteoflow completions zsh > ~/.zfunc/_osteoflow")]
pub(crate) struct Completions {
    /// The shell.
    shell: Shell,
}

impl Completions {
    pub(crate) fn execute(&self, mut command_line: Command) -> Result<Exit> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut command_line, "osteoflow", &mut script);
        terminal::stdout().write_all(&script)?;
        Ok(Exit::Done)
    }
}
