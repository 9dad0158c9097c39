//! The side of a surface that its normals point to.

use super::Target;
use crate::mesh_query::MeshQuery;
use crate::mesh_topology::{open_edges_of, welded};
use nalgebra::Vector3;

/// About as many points tell the side of all.
const N_TOLD: usize = 5000;

/// Length of the mean normal from which a surface is open: a closed one has 0, a bone with an end cut off 0.02, a ball's half 0.5.
const OPEN: f64 = 0.15;

/// The same of a mesh whose volume tells that it is inside out, and the maximum share of its edges that are open or doubled.
const NEARLY_CLOSED: f64 = 0.02;
const OPEN_EDGES: f64 = 0.001;

/// Mean cosine between normals and directions from the centroid, below which the side of a cloud's normals is unknown. A ball has 1, a
/// bone thirty times as long as thick 0.05.
const OUTWARD_SHARE: f64 = 0.02;

/// The side of a surface that its normals point to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Side {
    /// Out of a closed surface, or one with ends cut off.
    Outward,
    /// Into a closed surface.
    Inward,
    /// That from which the faces of an open mesh turn counter-clockwise: outside, unless the file has it wrong.
    Stated,
    /// Of an open cloud, whose normals may have been estimated: either.
    Unknown,
}

/// Sums over some of the points.
struct Sums {
    normals: Vector3<f64>,
    /// Of products of places about the centroid and normals, and of their lengths.
    outward: f64,
    length: f64,
    n: f64,
}

impl Sums {
    fn new(target: &Target, normals: &[Vector3<f64>]) -> Self {
        let every = (normals.len() / N_TOLD).max(1);
        let mut sums = Self { normals: Vector3::zeros(), outward: 0.0, length: 0.0, n: 0.0 };
        for i in (0..normals.len()).step_by(every) {
            let (p, normal) = (target.index().local(i), &normals[i]);
            sums.normals += normal;
            sums.outward += p.dot(normal);
            sums.length += p.norm() * normal.norm();
            sums.n += normal.norm();
        }
        sums
    }

    fn mean_normal(&self) -> f64 {
        self.normals.norm() / self.n.max(f64::MIN_POSITIVE)
    }
}

impl Target {
    /// Whether the surface is open: there is no inside, where a scan must not be.
    pub(crate) fn is_open(&self) -> bool {
        self.normals().is_some_and(|normals| Sums::new(self, normals).mean_normal() > OPEN)
    }

    /// The side that its normals point to.
    pub(crate) fn side(&self) -> Side {
        let told = || self.normals().map_or(Side::Unknown, |normals| self.side_of(normals));
        *self.side.get_or_init(told)
    }

    fn side_of(&self, normals: &[Vector3<f64>]) -> Side {
        let sums = Sums::new(self, normals);
        let sign = |outward: f64| if outward < 0.0 { Side::Inward } else { Side::Outward };
        let is_told = sums.mean_normal() <= OPEN && sums.outward.abs() > OUTWARD_SHARE * sums.length;
        let Some(mesh) = self.mesh().map(MeshQuery::mesh) else {
            return if is_told { sign(sums.outward) } else { Side::Unknown };
        };
        if is_told && sums.outward > 0.0 {
            return Side::Outward;
        }
        // A bore is no inside-out shaft.
        let is_closed = || {
            let faces = welded(mesh);
            open_edges_of(&faces) as f64 <= OPEN_EDGES * 1.5 * faces.len() as f64
        };
        if sums.mean_normal() < NEARLY_CLOSED && is_closed() { sign(mesh.volume_mm3()) } else { Side::Stated }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, inside_out, shaft, soup};
    use osteoflow_geometry::{Mesh, SurfaceOrigin};
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    /// The sides of a mesh and of its samples as a cloud, and whether it is open; as it is, and inside out.
    fn sides(mesh: &Mesh) -> [(Side, Side, bool); 2] {
        [mesh, &inside_out(mesh, |_| true)].map(|mesh| {
            let samples = crate::sample::surface(mesh, 20_000, &mut ChaCha8Rng::seed_from_u64(1));
            let cloud = Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap();
            let target = cloud.clone().with_mesh(MeshQuery::new(mesh));
            (target.side(), cloud.side(), cloud.is_open())
        })
    }

    #[test]
    fn the_volume_tells_the_side_of_a_closed_surface_and_an_open_one_is_believed() {
        let closed = [(Side::Outward, Side::Outward, false), (Side::Inward, Side::Inward, false)];
        assert_eq!(sides(&cuboid([0.0; 3], [10.0, 20.0, 30.0])), closed);
        assert_eq!(sides(&soup(&shaft(), |_| true)), closed);
        // One side of it, and a stretch without ends.
        let open = [(Side::Stated, Side::Unknown, true); 2];
        assert_eq!(sides(&soup(&shaft(), |p| p.x > 2.0)), open);
        let tube = sides(&soup(&shaft(), |p| (10.0..110.0).contains(&p.z)));
        assert_eq!(tube, [(Side::Outward, Side::Outward, false), (Side::Stated, Side::Inward, false)]);
    }
}
