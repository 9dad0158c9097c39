//! The methods, in one table.

use clap::builder::PossibleValue;
use osteoflow_algorithms::icp;

/// A way to register.
pub(super) struct Method {
    /// The algorithm.
    pub(super) icp: icp::Method,
    /// The node that does the same: its parameters are the method's.
    pub(super) kind: &'static str,
    /// What it is for, for the help.
    about: &'static str,
    /// Whether the target's triangles are needed.
    pub(super) needs_mesh: bool,
    /// Whether the target's normals are needed.
    pub(super) needs_normals: bool,
}

pub(super) const DEFAULT: &str = "point_to_plane";

pub(super) const METHODS: [Method; 5] = [
    Method {
        icp: icp::Method::PointToPlane,
        kind: "icp.point_to_plane",
        about: "distances along the target's normals: slides freely, needs few steps; the one to begin with",
        needs_mesh: false,
        needs_normals: true,
    },
    Method {
        icp: icp::Method::PointToPoint,
        kind: "icp.point_to_point",
        about: "distances between points: for targets without normals, and to compare; held back along a bone",
        needs_mesh: false,
        needs_normals: false,
    },
    Method {
        icp: icp::Method::Symmetric,
        kind: "icp.symmetric",
        about: "distances along the normals of both sides: draws from farther away on curved bone",
        needs_mesh: false,
        needs_normals: true,
    },
    Method {
        icp: icp::Method::Generalized,
        kind: "icp.generalized",
        about: "distances weighed by the flatness of both sides (GICP), to compare with others",
        needs_mesh: false,
        needs_normals: true,
    },
    Method {
        icp: icp::Method::PointToMesh,
        kind: "icp.point_to_mesh",
        about: "distances to the target's triangles: no error of sampling, several times the cost; needs a surface",
        needs_mesh: true,
        needs_normals: false,
    },
];

impl Method {
    pub(super) fn possible_value(&self) -> PossibleValue {
        PossibleValue::new(self.icp.name()).help(self.about)
    }
}

/// The method of that name, which clap has looked at; else the default.
pub(super) fn named(name: &str) -> &'static Method {
    METHODS.iter().find(|method| method.icp.name() == name).unwrap_or(&METHODS[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_method_has_its_row_and_its_node() {
        for method in icp::Method::ALL {
            let row = named(method.name());
            assert_eq!((row.icp, row.kind), (method, format!("icp.{}", method.name()).as_str()));
        }
        assert_eq!(named(DEFAULT).icp.name(), DEFAULT);
    }
}
