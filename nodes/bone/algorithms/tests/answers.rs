//! Answers of the public functions as text, compared with golden files; `UPDATE=1 cargo test` rewrites them.
//!
//! A changed line is a changed result, which the commit explains in numbers. The inputs are the project's own bone and analytic shapes,
//! with noise from seeds. Numbers are printed to six digits, so the last bits of a machine's sines do not matter.

mod calibration;
mod clouds;
mod cuts;
mod fits;
mod holes;
mod search;
mod slides;
mod spots;
mod text;
mod volumes;

use crate::common::{Bone, own_bone};
use osteoflow_algorithms::target::Target;
use std::sync::LazyLock;

static BONE: LazyLock<Bone> = LazyLock::new(own_bone);
static TARGET: LazyLock<Target> = LazyLock::new(|| BONE.target(30_000).with_mesh(BONE.query.clone()));
