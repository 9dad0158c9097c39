//! Golden tests of `check`: the exact message of each fault, and the plans of valid graphs. `UPDATE=1` rewrites them.

mod build;
mod command_line_params;
mod damage;
mod frames;
mod golden;
mod inherited;
mod modules;
mod own_nodes;
mod plans;
mod producers;
mod starvation;
mod sweeps;
