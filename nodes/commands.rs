//! The command line: each subcommand is a file, and what several of them need is in [`common`].

mod check;
pub(crate) mod command_line;
pub(crate) mod common;
mod compare;
mod completions;
mod convert;
mod diff;
mod digest;
mod expand;
mod graph;
mod info;
mod inspect;
mod new;
mod record;
mod recover;
pub(crate) mod register;
mod replay;
mod report;
mod repro;
pub(crate) mod run;
mod runs;
mod schema;
pub(crate) mod simulate;
pub(crate) mod sweep;
mod validate;
mod view;
mod worker;
