//! What several subcommands need: their switches, the ends of runs, tables and messages.

pub(crate) mod busy;
pub(crate) mod crash;
pub(crate) mod exit;
pub(crate) mod global;
pub(crate) mod graph_args;
pub(crate) mod log;
pub(crate) mod log_args;
pub(crate) mod other_numbers;
pub(crate) mod plugins;
pub(crate) mod progress;
pub(crate) mod rerun;
pub(crate) mod result_table;
pub(crate) mod run_end;
pub(crate) mod run_path;
pub(crate) mod run_table;
pub(crate) mod running;
pub(crate) mod serve;
pub(crate) mod summary_table;
pub(crate) mod terminal;
pub(crate) mod text_table;
pub(crate) mod usage;
pub(crate) mod verdict_lines;

pub(crate) use exit::Exit;
pub(crate) use global::{Format, Global};
pub(crate) use log_args::LogArgs;
pub(crate) use terminal::print_json;
