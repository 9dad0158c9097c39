//! Fine registration of a scanned surface onto a prepared target.
//!
//! A variant of ICP is a `residual`. All share the correspondence search (`pairing`), the robust weights (`weights`), the
//! normal equations (`problem`), the steps (`solve`) and the convergence tests (`stop`). The loop of the variants along normals
//! is `gauss_newton`, that of point-to-point `point_to_point`; `levels` runs it on subsets of the source, then on all of it.
//! `published` is the loop in its plainest form, as the paper may have run it.

mod anderson;
mod error;
mod gauss_newton;
mod levels;
mod normal_equations;
mod observability;
mod pairing;
mod params;
mod point_to_point;
mod problem;
mod published;
mod report;
mod residual;
mod solve;
mod source;
mod state;
mod stop;
#[cfg(test)]
mod tests;
mod visible_surface;
mod weights;

pub use error::IcpError;
pub use observability::{Observability, WeakDirection};
pub use params::{IcpParams, Kernel, PairingKind, StepRule};
pub use published::{PublishedParams, PublishedReading, register_published};
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
    /// The distances between paired points. A Gauss-Newton step along the target's normals or an extrapolated one is taken if
    /// it lowers the cost, otherwise Kabsch's, which is the only one with `acceleration = 0`; the last steps are Kabsch's until
    /// the pairs stay. Source: Besl and McKay 1992; section 2.3 of the paper, whose stop rule "E < 0.01 mm" cannot be read as
    /// a sum or as a mean above the noise, so the remaining distance is estimated instead.
    PointToPoint,
    /// The distances along the target's normals. Points slide along the surface freely, so it needs few steps. Source: Chen and
    /// Medioni 1992; Low 2004 for the linearisation.
    PointToPlane,
    /// The distances along the mean of both points' normals. Exact if the surface is a sphere or a cylinder, so its steps are
    /// longer there. Source: Rusinkiewicz 2019.
    Symmetric,
    /// The Mahalanobis distances between planar Gaussians at both points (GICP). Source: Segal, Haehnel and Thrun 2009, with
    /// covariances from the normals (section III-B).
    Generalized,
    /// The distances to the closest points of the target's triangles, without the error of sampling the surface. Source:
    /// Besl and McKay 1992 for the closest points; Pottmann, Huang, Yang and Hu 2006 for the step.
    PointToMesh,
}

impl Method {
    /// All variants.
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
/// Each source point pairs with the nearest target point. If the variant needs normals of a source without them, they are
/// estimated from about 20 neighbours. `O(n log m)` a step. The result does not depend on the number of threads, nor (except
/// for rounding) on the order of the points.
///
/// # Errors
/// [`IcpError`]; [`IcpError::NoNormals`] or [`IcpError::NoMesh`] if the target has no normals or mesh and the variant needs
/// them. Reaching the iteration limit is a result, with `converged = false`.
pub fn register<'a>(
    method: Method,
    target: &Target,
    source: impl Into<Source<'a>>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    register_source(method, target, source.into(), init, params, observer)
}

// Not generic, so that the loops are compiled in this crate.
fn register_source(
    method: Method,
    target: &Target,
    source: Source<'_>,
    init: &Isometry3<f64>,
    params: &IcpParams,
    observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
) -> Result<IcpFit, IcpError> {
    match method {
        Method::PointToPoint => levels::by_points(target, source, init, params, observer, point_to_point::minimize),
        Method::PointToPlane => levels::by_planes::<residual::PointToPlane>(target, source, init, params, observer),
        Method::Symmetric => levels::by_planes::<residual::Symmetric>(target, source, init, params, observer),
        Method::Generalized => levels::by_planes::<residual::Generalized>(target, source, init, params, observer),
        Method::PointToMesh => levels::by_planes::<residual::PointToMesh>(target, source, init, params, observer),
    }
}
