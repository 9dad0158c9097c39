//! The methods, in one table.

use clap::builder::PossibleValue;
use osteoflow_algorithms::{
    icp::{self, IcpError, IcpFit, IcpParams, IcpStep, Source},
    target::Target,
};
use osteoflow_geometry::nalgebra::Isometry3;
use std::ops::ControlFlow;

/// A way to register.
pub(super) struct Method {
    /// As on the command line.
    pub(super) name: &'static str,
    /// The node that does the same: its parameters are the method's.
    pub(super) kind: &'static str,
    /// What it is for, for the help.
    about: &'static str,
    /// The algorithm.
    pub(super) register: Algorithm,
}

type Algorithm = fn(
    &Target,
    Source<'_>,
    &Isometry3<f64>,
    &IcpParams,
    &mut dyn FnMut(&IcpStep) -> ControlFlow<()>,
) -> Result<IcpFit, IcpError>;

pub(super) const DEFAULT: &str = "point_to_plane";

pub(super) const METHODS: [Method; 2] = [
    Method {
        name: DEFAULT,
        kind: "icp.point_to_plane",
        about: "distances along the target's normals: slides freely, needs few steps; the one to begin with",
        register: |target, source, init, params, observer| icp::point_to_plane(target, source, init, params, observer),
    },
    Method {
        name: "point_to_point",
        kind: "icp.point_to_point",
        about: "distances between points: for targets without normals, and to compare with others; held back along a bone",
        register: |target, source, init, params, observer| icp::point_to_point(target, source, init, params, observer),
    },
];

impl Method {
    pub(super) fn possible_value(&self) -> PossibleValue {
        PossibleValue::new(self.name).help(self.about)
    }
}

/// The method of that name, which clap has looked at; else the default.
pub(super) fn named(name: &str) -> &'static Method {
    METHODS.iter().find(|method| method.name == name).unwrap_or(&METHODS[0])
}
