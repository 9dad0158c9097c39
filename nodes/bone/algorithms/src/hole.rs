//! Detection of a laser spot by the hole it leaves in a scan.
//!
//! The laser saturates the camera, so a disc around the spot is missing from the scan. It is found by comparison with a
//! full `reference` scan of the same surface; `cloud` is the scan with the laser on. Both are in one frame, each with
//! its own viewpoint, so the bone and the camera may have moved between them. [`boundary()`] needs no reference. [`rgb_spot()`]
//! finds the spot itself in a colour image.

mod blobs;
mod boundary;
mod cloud_difference;
mod depth_outliers;
mod footprint;
mod image;
mod params;
mod patch;
mod range_image;
mod report;
mod rgb_spot;
mod scene;
mod sight;
mod spot;

pub use boundary::boundary;
pub use cloud_difference::cloud_difference;
pub use params::HoleParams;
pub use range_image::range_image;
pub use report::{Hole, HoleReport};
pub use rgb_spot::{Mark, RgbSpotParams, rgb_spot};
