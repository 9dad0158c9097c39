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
//! ```
//! use nalgebra::{Isometry3, Point3, Vector3};
//! use osteoflow_algorithms::{icp, target::Target};
//! use osteoflow_geometry::SurfaceOrigin;
//! use std::ops::ControlFlow;
//!
//! // A bowl with its normals, and a scan of it from a camera in another pose.
//! let height = |x: f64, y: f64| 0.01 * x * x + 0.02 * y * y + 0.3 * (x / 5.0).sin() * (y / 7.0).cos();
//! let grid = || (0..10_000).map(|k| (f64::from(k % 100) * 0.4 - 20.0, f64::from(k / 100) * 0.4 - 20.0));
//! let slope = |x: f64, y: f64| (height(x + 1e-4, y) - height(x - 1e-4, y), height(x, y + 1e-4) - height(x, y - 1e-4));
//! let points: Vec<_> = grid().map(|(x, y)| Point3::new(x, y, height(x, y))).collect();
//! let normals: Vec<_> = grid()
//!     .map(|(x, y)| Vector3::new(-slope(x, y).0, -slope(x, y).1, 2e-4).normalize())
//!     .collect();
//! let target = Target::new("ct", SurfaceOrigin::Exact, points.clone(), Some(normals.into()))?;
//!
//! let t_ct_camera = Isometry3::new(Vector3::new(1.0, -0.5, 0.8), Vector3::new(0.02, 0.03, -0.02));
//! let scan: Vec<_> = points.iter().map(|p| t_ct_camera.inverse() * p).collect();
//! let (method, start) = (icp::Method::PointToPlane, Isometry3::identity());
//! let fit = icp::register(method, &target, &scan, &start, &Default::default(), &mut |step| {
//!     println!("{} RMS {:.3} mm", step.iteration, step.rms_mm);
//!     ControlFlow::Continue(())
//! })?;
//! assert!(fit.report.converged);
//! assert!((fit.t_target_source.translation.vector - t_ct_camera.translation.vector).norm() < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

/// The level of optimization with which this crate, which computes, is compiled: `3`, `s`, `0`.
pub const OPT_LEVEL: &str = env!("OSTEOFLOW_ALGORITHMS_OPT_LEVEL");

pub mod axes;
mod bvh;
pub mod calibrate;
pub mod coarse;
pub mod ct_surface;
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
mod refusal;
pub mod roi;
pub mod sample;
pub mod section;
mod sensor_noise;
#[cfg(test)]
#[path = "../tests/common/shapes.rs"]
mod shapes;
pub mod slide;
pub mod still_average;
pub mod target;
pub mod track;
pub mod trust;
mod union_find;

pub use refusal::Refusal;
