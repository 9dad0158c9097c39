//! The methods of `register`, in one table.

use super::{
    align::{Fit, NoFit},
    plugin::PluginMethod,
};
use clap::builder::PossibleValue;
use osteoflow_algorithms::{
    icp::{self, Halt, IcpParams, IcpStep, PairingKind, PublishedParams, StopReason},
    target::Target,
};
use osteoflow_geometry::{Cloud, nalgebra::Isometry3};
use serde_json::Value;
use std::{
    ops::ControlFlow,
    sync::{Arc, atomic::AtomicBool},
};

/// A registration method.
pub(super) struct Method {
    /// The variant of ICP; none for the plain one of the paper.
    variant: Option<icp::Method>,
    /// The kind of node with the same parameters.
    pub(super) kind: &'static str,
    /// One line for the help.
    about: &'static str,
    /// Parameters for `--stop fixed`, which take all steps on all points.
    pub(super) fixed: &'static [(&'static str, &'static str)],
    pub(super) needs_mesh: bool,
    pub(super) needs_normals: bool,
}

/// The parameters of a method.
#[derive(Debug, Clone)]
pub(super) enum MethodParams {
    Variant(icp::Method, IcpParams),
    Published(PublishedParams),
    Plugin(PluginMethod),
}

/// What a method of a plugin gets: normals, and the mesh if the target has one.
pub(super) const OF_PLUGIN: Method =
    Method { variant: None, kind: "", about: "", fixed: &[], needs_mesh: false, needs_normals: true };

const FIXED: &[(&str, &str)] =
    &[("stop_step_mm", "0.0"), ("stop_step_rad", "0.0"), ("stop_residual_mm", "0.0"), ("levels", "[]")];

pub(super) const DEFAULT: &str = "point_to_plane";

pub(super) const METHODS: [Method; 6] = [
    Method {
        variant: Some(icp::Method::PointToPlane),
        kind: "icp.point_to_plane",
        about: "distances along the target's normals: few steps; the first choice",
        fixed: FIXED,
        needs_mesh: false,
        needs_normals: true,
    },
    Method {
        variant: Some(icp::Method::PointToPoint),
        kind: "icp.point_to_point",
        about: "distances between points: for targets without normals; slow along a bone",
        fixed: FIXED,
        needs_mesh: false,
        needs_normals: false,
    },
    Method {
        variant: Some(icp::Method::Symmetric),
        kind: "icp.symmetric",
        about: "distances along the mean normal of both points: converges from farther away on curved bone",
        fixed: FIXED,
        needs_mesh: false,
        needs_normals: true,
    },
    Method {
        variant: Some(icp::Method::Generalized),
        kind: "icp.generalized",
        about: "Mahalanobis distances between planar Gaussians (GICP), for comparisons",
        fixed: FIXED,
        needs_mesh: false,
        needs_normals: true,
    },
    Method {
        variant: Some(icp::Method::PointToMesh),
        kind: "icp.point_to_mesh",
        about: "distances to the target's triangles: no sampling error, several times the cost; needs a surface",
        fixed: FIXED,
        needs_mesh: true,
        needs_normals: false,
    },
    Method {
        variant: None,
        kind: "icp.published",
        about: "plain point-to-point under a stop rule of the paper, which --set reading=.. names",
        fixed: &[("reading", "\"iterations\"")],
        needs_mesh: false,
        needs_normals: false,
    },
];

impl Method {
    fn name(&self) -> &'static str {
        self.variant.map_or("published", icp::Method::name)
    }

    pub(super) fn possible_value(&self) -> PossibleValue {
        PossibleValue::new(self.name()).help(self.about)
    }

    /// The parameters of the method's node, which must be complete.
    pub(super) fn params(&self, params: Value) -> serde_json::Result<MethodParams> {
        Ok(match self.variant {
            Some(variant) => MethodParams::Variant(variant, serde_json::from_value(params)?),
            None => MethodParams::Published(serde_json::from_value(params)?),
        })
    }
}

impl MethodParams {
    pub(super) fn register(
        &self,
        target: &Target,
        source: &Cloud,
        init: &Isometry3<f64>,
        observer: &mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
        cancelled: &Arc<AtomicBool>,
    ) -> Result<Fit, NoFit> {
        let fit = match self {
            Self::Variant(variant, params) => icp::register(*variant, target, source, init, params, observer),
            Self::Published(params) => icp::register_published(target, source, init, params, observer),
            Self::Plugin(plugin) => return plugin.register(target, source, init, cancelled),
        };
        match fit {
            Err(error) => Err(NoFit::Refused(error.to_string())),
            Ok(fit) if fit.report.stop_reason == StopReason::Cancelled => Err(NoFit::Cancelled),
            Ok(fit) => Ok(fit.into()),
        }
    }

    pub(super) fn pairing(&self) -> PairingKind {
        match self {
            Self::Variant(_, params) => params.pairing,
            Self::Published(_) | Self::Plugin(_) => PairingKind::Cached,
        }
    }

    /// Largest distance of a pair, mm, if the method states one.
    pub(super) fn max_pair_distance_mm(&self) -> Option<f64> {
        match self {
            Self::Variant(_, params) => Some(params.max_pair_distance_mm),
            Self::Published(params) => Some(params.max_pair_distance_mm),
            Self::Plugin(_) => None,
        }
    }

    pub(super) fn stop_after_ms(&self) -> f64 {
        match self {
            Self::Variant(_, params) => params.stop_after_ms,
            Self::Published(params) => params.stop_after_ms,
            Self::Plugin(_) => 0.0,
        }
    }
}

/// The method of this name, which clap has checked.
pub(super) fn named(name: &str) -> &'static Method {
    METHODS.iter().find(|method| method.name() == name).unwrap_or(&METHODS[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variant_has_a_row_and_every_row_is_named_after_its_node() {
        for variant in icp::Method::ALL {
            assert_eq!(named(variant.name()).variant, Some(variant));
        }
        for method in METHODS {
            assert_eq!(method.kind, format!("icp.{}", method.name()));
        }
        assert_eq!(named(DEFAULT).name(), DEFAULT);
    }
}
