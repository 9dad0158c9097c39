//! The signed distance of a triangle mesh.

use super::{Nearest, Node, SignedDistance};
use crate::bvh::{Aabb, Bvh};
use crate::morton;
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_geometry::Mesh;

/// Squared sine of a corner below which a face has no area.
const FLAT: f64 = 1e-20;

/// Distance below which the gradient is the pseudo-normal, as rounding decides the direction to the closest point, mm.
const ON_SURFACE_MM: f64 = 1e-7;

/// Cosine between the pseudo-normal of a rim and the direction to it, below which the sign is unknown.
const BESIDE_RIM: f64 = 0.5;

/// The part of a triangle with the closest point: 0 the face, 1 to 3 the edges from corners 0, 1, 2, 4 to 6 the corners 0, 1, 2.
type Feature = usize;

struct Triangle {
    corner: Vector3<f64>,
    to_b: Vector3<f64>,
    to_c: Vector3<f64>,
}

/// The faces of a mesh with an area, along a space-filling curve, with their pseudo-normals.
pub(super) struct Triangles {
    triangles: Vec<Triangle>,
    /// Pseudo-normals of the features of each triangle, not of unit length.
    normals: Vec<[Vector3<f64>; 7]>,
    /// A bit for each feature on the rim of an open surface.
    rims: Vec<u8>,
    boxes: Bvh,
    extent: Aabb,
}

impl Triangles {
    /// The faces in `axes` about `centre`.
    ///
    /// # Source
    /// Baerentzen and Aanaes 2005: the normal of an edge is the sum of its faces' normals, that of a vertex is weighted by the angles.
    pub(super) fn new(mesh: &Mesh, centre: &Point3<f64>, axes: &Matrix3<f64>) -> Self {
        let vertices: Vec<Vector3<f64>> = mesh.vertices().iter().map(|v| axes.tr_mul(&(v - centre))).collect();
        let welded = welded(&vertices);
        let faces: Vec<[u32; 3]> = mesh.faces().iter().map(|face| face.map(|v| welded[v as usize])).collect();
        let unit: Vec<Option<Vector3<f64>>> = faces.iter().map(|face| unit_normal(&vertices, face)).collect();

        let mut at_vertex = vec![(Vector3::zeros(), false); vertices.len()];
        for (face, unit) in faces.iter().zip(&unit) {
            let Some(unit) = unit else { continue };
            for k in 0..3 {
                let [a, b, c] = [0, 1, 2].map(|i| vertices[face[(k + i) % 3] as usize]);
                at_vertex[face[k] as usize].0 += unit * angle(&(b - a), &(c - a));
            }
        }
        let mut half_edges: Vec<(u64, u32, u32)> = Vec::with_capacity(3 * faces.len());
        for (face, number) in faces.iter().zip(0_u32..) {
            for k in 0..3 {
                let (from, to) = (face[k], face[(k + 1) % 3]);
                if from != to {
                    half_edges.push((u64::from(from.min(to)) << 32 | u64::from(from.max(to)), number, k as u32));
                }
            }
        }
        half_edges.sort_unstable();
        let mut at_edge = vec![[(Vector3::zeros(), false); 3]; faces.len()];
        for edge in half_edges.chunk_by(|a, b| a.0 == b.0) {
            let forward = edge.iter().filter(|&&(_, f, k)| {
                let face = faces[f as usize];
                face[k as usize] < face[(k as usize + 1) % 3]
            });
            // On a closed, consistently oriented surface each edge has as many half-edges in one direction as in the other.
            let rim = 2 * forward.count() != edge.len();
            let normal: Vector3<f64> = edge.iter().filter_map(|&(_, f, _)| unit[f as usize]).sum();
            for &(_, f, k) in edge {
                at_edge[f as usize][k as usize] = (normal, rim);
                if rim {
                    let face = faces[f as usize];
                    at_vertex[face[k as usize] as usize].1 = true;
                    at_vertex[face[(k as usize + 1) % 3] as usize].1 = true;
                }
            }
        }

        let kept: Vec<usize> = (0..faces.len()).filter(|&f| unit[f].is_some()).collect();
        let corners = |f: usize| faces[f].map(|v| vertices[v as usize]);
        let middles: Vec<Vector3<f64>> = kept.iter().map(|&f| corners(f).iter().sum::<Vector3<f64>>() / 3.0).collect();
        let order = morton::order_by_index(&middles);
        let mut made = Self {
            triangles: Vec::with_capacity(kept.len()),
            normals: Vec::with_capacity(kept.len()),
            rims: Vec::with_capacity(kept.len()),
            boxes: Bvh::new(&[]),
            extent: Aabb::of(&[]),
        };
        let mut extents = Vec::with_capacity(kept.len());
        for place in order {
            let f = kept[place as usize];
            let [a, b, c] = corners(f);
            extents.push(Aabb::of(&[a, b, c]));
            made.triangles.push(Triangle { corner: a, to_b: b - a, to_c: c - a });
            let (edges, ends) = (at_edge[f], faces[f].map(|v| at_vertex[v as usize]));
            let features =
                [(unit[f].unwrap_or_default(), false), edges[0], edges[1], edges[2], ends[0], ends[1], ends[2]];
            made.normals.push(features.map(|(normal, _)| normal));
            made.rims.push((0..7).filter(|&k| features[k].1).map(|k| 1 << k).sum());
        }
        made.boxes = Bvh::new(&extents);
        made.extent = Aabb::of(extents.iter().flat_map(|e| [&e.min, &e.max]));
        made
    }
}

impl SignedDistance for Triangles {
    fn len(&self) -> usize {
        self.triangles.len()
    }

    fn extent(&self) -> Aabb {
        self.extent
    }

    fn nearest(&self, at: &Vector3<f64>, hint: Option<u32>) -> Nearest {
        let mut best = Nearest { square: f64::INFINITY, index: 0 };
        if let Some(index) = hint {
            best = Nearest { square: self.triangles[index as usize].closest(at).0.norm_squared(), index };
        }
        self.boxes.nearest(at, best.square, |index| {
            let square = self.triangles[index].closest(at).0.norm_squared();
            // Ties go to the first along the curve, whatever the hint.
            if square < best.square || (square == best.square && (index as u32) < best.index) {
                best = Nearest { square, index: index as u32 };
            }
            best.square
        });
        best
    }

    fn node(&self, at: &Vector3<f64>, nearest: &Nearest) -> Node {
        let index = nearest.index as usize;
        let (away, feature) = self.triangles[index].closest(at);
        let Some(normal) = self.normals[index][feature].try_normalize(1e-9) else { return Node::NONE };
        let (distance, height) = (away.norm(), away.dot(&normal));
        if distance < ON_SURFACE_MM {
            return Node::new(height, &normal);
        }
        if self.rims[index] >> feature & 1 == 1 && height.abs() < BESIDE_RIM * distance {
            return Node::NONE;
        }
        let signed = if height < 0.0 { -distance } else { distance };
        Node::new(signed, &(away / signed))
    }
}

impl Triangle {
    /// The vector from the closest point to `at`, and the feature with the closest point.
    ///
    /// # Source
    /// Ericson 2005, section 5.1.5.
    #[inline]
    fn closest(&self, at: &Vector3<f64>) -> (Vector3<f64>, Feature) {
        let (ab, ac) = (self.to_b, self.to_c);
        let ap = at - self.corner;
        let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            return (ap, 4);
        }
        let bp = ap - ab;
        let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
        if d3 >= 0.0 && d4 <= d3 {
            return (bp, 5);
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return (ap - ab * (d1 / (d1 - d3)), 1);
        }
        let cp = ap - ac;
        let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
        if d6 >= 0.0 && d5 <= d6 {
            return (cp, 6);
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return (ap - ac * (d2 / (d2 - d6)), 3);
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            return (bp - (ac - ab) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))), 2);
        }
        let share = 1.0 / (va + vb + vc);
        (ap - ab * (vb * share) - ac * (vc * share), 0)
    }
}

/// For each vertex the first one at its position: STL files repeat vertices.
fn welded(vertices: &[Vector3<f64>]) -> Vec<u32> {
    let mut order: Vec<u32> = (0_u32..).zip(vertices).map(|(i, _)| i).collect();
    let by_place = |i: u32, j: u32| {
        let (p, q) = (&vertices[i as usize], &vertices[j as usize]);
        p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z))
    };
    order.sort_unstable_by(|&i, &j| by_place(i, j).then(i.cmp(&j)));
    let mut first = vec![0; vertices.len()];
    for same in order.chunk_by(|&i, &j| by_place(i, j).is_eq()) {
        for &i in same {
            first[i as usize] = same[0];
        }
    }
    first
}

/// `None` for a face without area.
fn unit_normal(vertices: &[Vector3<f64>], face: &[u32; 3]) -> Option<Vector3<f64>> {
    let [a, b, c] = face.map(|v| vertices[v as usize]);
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(&ac);
    let sides = ab.norm_squared() * ac.norm_squared();
    (normal.norm_squared() > FLAT * sides).then(|| normal.normalize())
}

/// The angle between two directions, rad, to 1e-7, without a library's arc cosine, whose last digit depends on the machine.
///
/// # Source
/// Abramowitz and Stegun 1964, 4.4.46.
fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    const TERMS: [f64; 8] = [
        1.570_796_305_0,
        -0.214_598_801_6,
        0.088_978_987_4,
        -0.050_174_304_6,
        0.030_891_881_0,
        -0.017_088_125_6,
        0.006_670_090_1,
        -0.001_262_491_1,
    ];
    let lengths = (a.norm_squared() * b.norm_squared()).sqrt();
    if lengths == 0.0 {
        return 0.0;
    }
    let cosine = (a.dot(b) / lengths).clamp(-1.0, 1.0);
    let x = cosine.abs();
    let acute = (1.0 - x).sqrt() * TERMS.iter().rev().fold(0.0, |sum, term| sum * x + term);
    if cosine < 0.0 { std::f64::consts::PI - acute } else { acute }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_the_arc_cosine() {
        for k in 0..=100 {
            let turn = f64::from(k) / 100.0 * std::f64::consts::PI;
            let found = angle(&(Vector3::x() * 3.0), &Vector3::new(turn.cos(), turn.sin(), 0.0));
            assert!((found - turn).abs() < 1e-7, "{found} for {turn} rad");
        }
    }
}
