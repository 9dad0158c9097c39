//! The switches of every command.

use super::terminal;
use clap::{ArgAction, Args, ColorChoice, ValueEnum};
use std::{
    fmt,
    io::{self, IsTerminal, Write},
};

/// The heading of these switches in the help.
const EVERY: &str = "In every command";

/// Switches of every command.
#[derive(Debug, Clone, Args)]
pub(crate) struct Global {
    /// Format of stdout: text for people (the default), or json: one JSON value and nothing else.
    #[arg(long, global = true, value_enum, default_value_t = Format::Text, value_name = "FORMAT", help_heading = EVERY,
          hide_default_value = true, hide_possible_values = true)]
    pub(crate) format: Format,

    /// Print only results and errors.
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = EVERY)]
    pub(crate) quiet: bool,

    /// Print more: tables of nodes and of what they sent; -vv and -vvv for programmers (or OSTEOFLOW_LOG=debug).
    #[arg(short, long, global = true, action = ArgAction::Count, help_heading = EVERY)]
    pub(crate) verbose: u8,

    /// Use colours: always, never, or on a terminal (auto, the default), unless the environment variable NO_COLOR is set.
    #[arg(long, global = true, value_enum, default_value_t = ColorChoice::Auto, value_name = "WHEN", help_heading = EVERY,
          hide_default_value = true, hide_possible_values = true)]
    pub(crate) color: ColorChoice,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    Text,
    Json,
}

impl Global {
    /// Whether to use colours on stderr.
    pub(crate) fn colour_err(&self) -> bool {
        is_coloured(self.color, std::io::stderr().is_terminal())
    }

    /// `text` in an ANSI style such as `1;31`, if colours are used on stdout.
    pub(crate) fn paint_out(&self, text: &str, style: &str) -> String {
        paint(is_coloured(self.color, std::io::stdout().is_terminal()), text, style)
    }

    /// Writes a line to stderr: a word for what it is, in its colour, and the rest.
    pub(crate) fn say(&self, word: &str, what: impl fmt::Display) -> io::Result<()> {
        let style = match word {
            "error" | "refused" | "incomplete" => "1;31",
            "note" | "page" | "stream" => "1",
            _ => "1;33",
        };
        writeln!(terminal::stderr(), "{}: {what}", paint(self.colour_err(), word, style))
    }
}

fn is_coloured(choice: ColorChoice, terminal: bool) -> bool {
    match choice {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        ColorChoice::Auto => terminal && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty()),
    }
}

fn paint(coloured: bool, text: &str, style: &str) -> String {
    if coloured { format!("\x1b[{style}m{text}\x1b[0m") } else { text.into() }
}
