//! Surface registration as plain functions: Kabsch, ICP, hole detection, regions, metrics.
//!
//! Nothing here knows an engine, a node or a file: functions take nalgebra types in millimetres and radians, and can be
//! lifted out and used anywhere. The **source** moves onto the **target**; the answer is `t_target_source`. The order
//! of a registration of a bone:
//!
//! 1. [`calibrate`]: the camera's pose in its marker's frame, from one scan of a phantom.
//! 2. [`roi`], [`downsample`], [`normals`], [`merge`], [`still_average`]: from raw streams to one clean cloud.
//! 3. [`hole`]: the laser spots on the bone; [`landmarks`]: the planned marks; [`coarse`]: the fit of both.
//! 4. [`ct_surface`]: the bone's surface in a CT; [`sample`] and [`target`]: prepared; [`icp`]: the scan onto it.
//! 5. [`axes`] and [`metrics`]: the accuracy; [`fragment`]: the piece that the cuts take out.
//!
//! Results do not depend on the number of threads: sums run over chunks of fixed size in order, and ties go to the
//! lowest index. Work is spread over the current rayon pool.
//!
//! The points of one file onto those of another:
#![doc = concat!("```\n", include_str!("../examples/register_points.rs"), "```")]

/// The level of optimization with which this crate, which computes, is compiled: `3`, `s`, `0`.
pub const OPT_LEVEL: &str = env!("OSTEOFLOW_ALGORITHMS_OPT_LEVEL");

pub mod axes;
mod bvh;
pub mod calibrate;
pub mod coarse;
pub mod ct_surface;
#[cfg(test)]
#[path = "../tests/common/devices.rs"]
mod devices;
pub mod downsample;
pub mod fragment;
pub mod hole;
pub mod icp;
pub mod iso_surface;
#[cfg(test)]
#[path = "../tests/common/joined.rs"]
mod joined;
pub mod kabsch;
pub mod landmarks;
pub mod marker_stream;
mod median;
pub mod merge;
pub mod mesh_query;
pub mod mesh_topology;
pub mod metrics;
mod morton;
pub mod nearest;
pub mod normals;
pub mod parts;
pub mod perturb;
mod point_blocks;
mod point_grid;
pub mod point_times;
mod product;
mod refusal;
pub mod roi;
pub mod sample;
pub mod section;
pub mod sensor;
pub mod sensor_error;
mod sensor_noise;
#[cfg(test)]
#[path = "../tests/common/shapes.rs"]
mod shapes;
pub mod slide;
pub mod still_average;
pub mod tables;
pub mod target;
pub mod track;
pub mod trust;
mod union_find;

pub use refusal::Refusal;
