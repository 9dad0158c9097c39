//! Fine registration of a scanned surface onto a prepared target.
//!
//! Five parts make a variant, each in a room of its own: what is minimised ([`residual`](self), one file for each),
//! which points pair (`pairing`), how much a pair counts (`weights`), how a step is solved (`step`), and when to stop
//! (`stop`). `run` takes them from coarse subsets of the source to all of it.

mod acceleration;
mod observability;
mod pairing;
mod params;
mod planes;
mod points;
mod problem;
mod report;
mod residual;
mod run;
mod source;
mod step;
mod stop;
mod sums;
mod surface;
#[cfg(test)]
mod tests;
mod weights;

pub use observability::{Observability, WeakDirection};
pub use params::{IcpParams, Kernel, PairingKind, PublishedReading, StepRule};
pub use report::{Halt, IcpFit, IcpReport, IcpStep, IcpTrace};
pub use source::Source;
pub use stop::{StopReason, StopRule};

use crate::target::Target;
use nalgebra::Isometry3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// A variant of ICP, named by its residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The distances between paired points. A step along the target's normals or an extrapolated one is taken where it
    /// lowers the residual, else Kabsch moves the source, as it always does with `acceleration = 0`; the last steps are
    /// Kabsch's until the pairs stay. Source: Besl and McKay 1992; section 2.3 of the paper, whose stop rule "E < 0.01 mm"
    /// cannot be read as a sum or as a mean above the noise, so ours estimates the way still to go.
    PointToPoint,
    /// The distances along the target's normals. Slides along the surface freely, so it needs few steps. Source: Chen and
    /// Medioni 1992; Low 2004 for the linearisation.
    PointToPlane,
    /// The distances along the mean of both points' normals. Exact where the surface is a sphere or a cylinder, so it takes
    /// longer steps there. Source: Rusinkiewicz 2019.
    Symmetric,
    /// The Mahalanobis distances between small planes at both points (GICP). Source: Segal, Haehnel and Thrun 2009, with
    /// covariances from the normals (section III-B).
    Generalized,
    /// The distances to the closest points of the target's triangles, free of the error of sampling the surface. Source:
    /// Besl and McKay 1992 for the closest points; Pottmann, Huang, Yang and Hu 2006 for the step.
    PointToMesh,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::PointToPoint, Self::PointToPlane, Self::Symmetric, Self::Generalized, Self::PointToMesh];

    /// Its name in graphs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::PointToPoint => "point_to_point",
            Self::PointToPlane => "point_to_plane",
            Self::Symmetric => "symmetric",
            Self::Generalized => "generalized",
            Self::PointToMesh => "point_to_mesh",
        }
    }
}

/// Registers `source` onto `target` by the variant `method`, from `init`.
///
/// Each source point pairs with the nearest target point, and steps about the source's centroid move the source. Normals of
/// the source, where the variant needs them, are estimated from about 20 neighbours where it has none. `O(n log m)` a step.
/// The result does not depend on the number of threads, nor (but for rounding) on the order of the points.
///
/// # Errors
/// [`IcpError`]; [`IcpError::NoNormals`] or [`IcpError::NoMesh`] where the target lacks what the variant needs. Reaching the
/// iteration limit is a result, with `converged = false`.
pub fn register<'a>(
    method: Method,
    target: &Target,
    source: impl Into<Source<'a>>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    let source = source.into();
    match method {
        Method::PointToPoint => run::points(target, source, init, params, observer),
        Method::PointToPlane => run::planes::<residual::PointToPlane>(target, source, init, params, observer),
        Method::Symmetric => run::planes::<residual::Symmetric>(target, source, init, params, observer),
        Method::Generalized => run::planes::<residual::Generalized>(target, source, init, params, observer),
        Method::PointToMesh => run::planes::<residual::PointToMesh>(target, source, init, params, observer),
    }
}

/// Why an ICP has no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IcpError {
    /// Too few source points lie near the target.
    #[error(
        "{n_pairs} of {n_source} source points lie within {max_pair_distance_mm} mm of the target, {min_pairs} are \
         needed; the nearest target point is {nearest_mm:.1} mm away: is init right, and are both in mm?"
    )]
    TooFewPairs {
        /// Pairs found.
        n_pairs: usize,
        /// Pairs needed.
        min_pairs: usize,
        /// Source points.
        n_source: usize,
        /// The limit.
        max_pair_distance_mm: f64,
        /// The distance of the source point that comes closest to the target.
        nearest_mm: f64,
    },
    /// There are not enough source points.
    #[error("{n_source} source points, {min_pairs} are needed; is the crop empty?")]
    TooFewPoints {
        /// Source points.
        n_source: usize,
        /// Needed.
        min_pairs: usize,
    },
    /// The variant needs normals that the target does not have.
    #[error("the target has no normals, which this variant needs; sample it from a mesh or estimate them")]
    NoNormals,
    /// The variant needs the mesh that the target's points were drawn from.
    #[error("the target has no triangles, which point_to_mesh needs; prepare it from a mesh")]
    NoMesh,
    /// The target was prepared without a closest-point field.
    #[error("the target has no closest-point field, which pairing = \"field\" needs; prepare it with field = true")]
    NoField,
    /// There is not one normal for each source point.
    #[error("the source has {n_normals} normals for {n_points} points")]
    SourceNormals {
        /// The number of points.
        n_points: usize,
        /// The number of normals.
        n_normals: usize,
    },
    /// A published reading was asked of another variant.
    #[error("published_reading is what the paper may have done, which is point_to_point; leave it out here")]
    NotPublished,
    /// A source point or the start is NaN or infinite.
    #[error("{what} is not finite; drop such points before the registration")]
    NotFinite {
        /// What is not finite.
        what: String,
    },
    /// A parameter has a value that cannot be used.
    #[error("{parameter} is {value}, but {expected}")]
    Parameter {
        /// Its name.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
}
