use super::common::{Exit, terminal};
use anyhow::Result;
use clap::{Args, Command};
use clap_complete::Shell;
use std::io::Write;

/// Write a completion script for a shell to stdout.
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
