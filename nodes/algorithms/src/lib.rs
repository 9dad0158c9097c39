//! Surface registration as plain functions: Kabsch, ICP, hole detection, regions, metrics.

pub mod axes;
pub mod calibrate;
pub mod coarse;
pub mod downsample;
pub mod hole;
pub mod icp;
pub mod kabsch;
pub mod landmarks;
pub mod merge;
pub mod mesh_query;
pub mod metrics;
mod morton;
pub mod nearest;
pub mod normals;
pub mod roi;
pub mod sample;
pub mod section;
pub mod still_average;
pub mod target;
