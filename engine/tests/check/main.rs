//! Every fault of a graph has its exact text; a good graph has its exact plan. `UPDATE=1` writes the texts anew.

#![allow(missing_docs)]

mod damage;
mod golden;
mod plans;
mod toy;
