//! The calibration phantom: a cube with blocks, without rotational symmetry; and the support of the camera's marker.

use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use std::collections::BTreeMap;

/// Boxes in mm, least corner then greatest; the blocks stand on three faces that meet in one corner, and each reaches
/// into the cube, so that their union is one closed surface.
const BOXES: [([f64; 3], [f64; 3]); 5] = [
    ([-28.0, -28.0, -28.0], [28.0, 28.0, 28.0]),
    ([20.0, -20.0, -6.0], [40.0, -4.0, 18.0]),
    ([-22.0, 20.0, -18.0], [2.0, 36.0, -6.0]),
    ([-16.0, -24.0, 20.0], [-6.0, 6.0, 44.0]),
    ([6.0, 8.0, 20.0], [22.0, 22.0, 34.0]),
];

/// The surface of the built-in calibration phantom in frame `phantom`, mm: a 56 mm cube about the origin with four
/// unequal blocks, closed, edges sharp.
pub fn mesh() -> Mesh {
    let cuts: [Vec<f64>; 3] = std::array::from_fn(|axis| {
        let mut cuts: Vec<f64> = BOXES.iter().flat_map(|(min, max)| [min[axis], max[axis]]).collect();
        cuts.sort_by(f64::total_cmp);
        cuts.dedup();
        cuts
    });
    // A cell between neighbouring cuts is entirely inside or outside each box.
    let filled = |cell: [isize; 3]| {
        let middle: [Option<f64>; 3] = std::array::from_fn(|k| {
            let i = usize::try_from(cell[k]).ok()?;
            Some((cuts[k].get(i)? + cuts[k].get(i + 1)?) / 2.0)
        });
        let [Some(x), Some(y), Some(z)] = middle else { return false };
        BOXES.iter().any(|(min, max)| [x, y, z].iter().zip(min.iter().zip(max)).all(|(c, (lo, hi))| lo < c && c < hi))
    };
    let mut vertices = Vec::new();
    let mut faces = Vec::new();
    let mut known = BTreeMap::new();
    let n = cuts.each_ref().map(|c| c.len() as isize - 1);
    for i in 0..n[0] {
        for j in 0..n[1] {
            for k in 0..n[2] {
                let cell = [i, j, k];
                if !filled(cell) {
                    continue;
                }
                for axis in 0..3 {
                    for step in [-1, 1] {
                        let mut beside = cell;
                        beside[axis] += step;
                        if filled(beside) {
                            continue;
                        }
                        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                        let mut ring = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[du, dv]| {
                            let mut corner = cell;
                            corner[axis] += isize::from(step == 1);
                            corner[u] += du;
                            corner[v] += dv;
                            *known.entry(corner).or_insert_with(|| {
                                vertices.push(Point3::from(std::array::from_fn(|a| cuts[a][corner[a] as usize])));
                                vertices.len() as u32 - 1
                            })
                        });
                        if step == -1 {
                            ring.reverse();
                        }
                        faces.push([ring[0], ring[1], ring[2]]);
                        faces.push([ring[0], ring[2], ring[3]]);
                    }
                }
            }
        }
    }
    Mesh::new("phantom", SurfaceOrigin::Exact, vertices, faces).expect("the boxes are not empty")
}

/// `t_phantom_phantom_marker` by design: the marker is on an arm beside the cube, out of the camera's view.
pub fn t_phantom_phantom_marker() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(-58.0, -44.0, 26.0), Vector3::new(0.35, -0.5, 0.8))
}

/// `t_camera_camera_marker` by design of the support: the marker is beside and behind the lens.
pub fn t_camera_camera_marker_nominal() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(36.0, -58.0, -21.0), Vector3::new(-0.4, 0.3, 1.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assert_closed_and_outward;

    #[test]
    fn the_phantom_is_closed_and_its_normals_point_outward() {
        let volume_mm3 = assert_closed_and_outward(&mesh());
        // The cube, and the part of each block outside of it.
        let expected = 56f64.powi(3) + 12.0 * 16.0 * 24.0 + 24.0 * 8.0 * 12.0 + 10.0 * 30.0 * 16.0 + 16.0 * 14.0 * 6.0;
        assert!((volume_mm3 - expected).abs() < 1e-6, "{volume_mm3} mm3, not {expected}");
    }

    #[test]
    fn the_phantom_has_no_rotational_symmetry() {
        // The 24 rotations of a cube: each but the identity must move some block's corner well off the surface.
        let phantom = mesh();
        let surface = osteoflow_algorithms::mesh_query::MeshQuery::new(&phantom);
        let mut n_turns = 0;
        for code in 0..64 {
            let [a, b, c] = [code % 4, code / 4 % 4, code / 16].map(|q| f64::from(q) * std::f64::consts::FRAC_PI_2);
            let turn = Isometry3::rotation(Vector3::x() * a)
                * Isometry3::rotation(Vector3::y() * b)
                * Isometry3::rotation(Vector3::z() * c);
            if turn.rotation.angle() < 1e-6 {
                continue;
            }
            n_turns += 1;
            let worst = phantom
                .vertices()
                .iter()
                .map(|v| {
                    let moved = turn * v;
                    surface.closest_point(&moved).unwrap().distance_mm
                })
                .fold(0.0, f64::max);
            assert!(worst > 5.0, "a turn by {a} {b} {c} rad leaves the phantom within {worst} mm of itself");
        }
        assert!(n_turns > 23);
    }
}
