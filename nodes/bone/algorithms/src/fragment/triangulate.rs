//! Faces over the outlines of a cut: a constrained Delaunay triangulation.

use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation, mitigate_underflow};
use std::collections::HashMap;

/// Coordinates in the plane of the cut, mm.
type Flat = [f64; 2];

/// Faces over `loops`, counter-clockwise in the coordinates of `flat`: outer loops run counter-clockwise, those around
/// holes clockwise.
///
/// Every edge of a loop becomes the edge of one face, so the faces close the surface that the loops bound. Where loops
/// of a bone that cuts through itself cross, each is covered by itself, holes with faces that are turned over, so that the
/// surface is closed and its signed volume right. `O(n log n)`.
pub(super) fn cap(loops: &[Vec<u32>], flat: &dyn Fn(u32) -> Flat) -> Vec<[u32; 3]> {
    triangulate(loops, flat).unwrap_or_else(|| loops.iter().flat_map(|outline| alone(outline, flat)).collect())
}

/// Faces over one loop.
fn alone(outline: &[u32], flat: &dyn Fn(u32) -> Flat) -> Vec<[u32; 3]> {
    let reversed = || vec![outline.iter().rev().copied().collect()];
    triangulate(&[outline.to_vec()], flat)
        .or_else(|| Some(triangulate(&reversed(), flat)?.into_iter().map(|[a, b, c]| [a, c, b]).collect()))
        .unwrap_or_else(|| (2..outline.len()).map(|k| [outline[0], outline[k - 1], outline[k]]).collect())
}

/// A vertex of the triangulation.
struct Corner {
    at: Point2<f64>,
    vertex: u32,
}

impl HasPosition for Corner {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.at
    }
}

/// The faces inside loops; `None` unless every edge of a loop has a face on its left and none on its right, as where
/// loops cross, touch in more than vertices, or run the wrong way round.
#[allow(clippy::map_entry, reason = "an insertion may fail, and the number of corners is compared")]
fn triangulate(loops: &[Vec<u32>], flat: &dyn Fn(u32) -> Flat) -> Option<Vec<[u32; 3]>> {
    let mut cdt = ConstrainedDelaunayTriangulation::<Corner>::new();
    let mut corners = HashMap::new();
    for &vertex in loops.iter().flatten() {
        if !corners.contains_key(&vertex) {
            let [x, y] = flat(vertex);
            corners.insert(vertex, cdt.insert(Corner { at: mitigate_underflow(Point2::new(x, y)), vertex }).ok()?);
            // Two vertices in one place are one to the triangulation.
            (cdt.num_vertices() == corners.len()).then_some(())?;
        }
    }
    let edges =
        || loops.iter().flat_map(|l| l.iter().zip(l.iter().cycle().skip(1))).map(|(a, b)| (corners[a], corners[b]));
    for (k, (from, to)) in edges().enumerate() {
        cdt.try_add_constraint(from, to);
        (cdt.num_constraints() == k + 1).then_some(())?;
    }
    let rim: Vec<_> = edges().map(|(from, to)| cdt.get_edge_from_neighbors(from, to)).collect::<Option<_>>()?;
    let mut is_inside = vec![false; cdt.num_all_faces()];
    let mut faces = Vec::new();
    let mut stack: Vec<_> = rim.iter().map(|edge| edge.face()).collect();
    while let Some(face) = stack.pop() {
        let face = face.as_inner()?;
        if !std::mem::replace(&mut is_inside[face.fix().index()], true) {
            faces.push(face.vertices().map(|corner| corner.data().vertex));
            let across = face.adjacent_edges().into_iter().filter(|edge| !edge.is_constraint_edge());
            stack.extend(across.map(|edge| edge.rev().face()));
        }
    }
    rim.iter().all(|edge| !is_inside[edge.rev().face().fix().index()]).then_some(faces)
}

/// Twice the signed area of a triangle.
#[cfg(test)]
fn turn(a: Flat, b: Flat, c: Flat) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(at: f64, half: f64, clockwise: bool) -> Vec<Flat> {
        let mut s = vec![[at - half, -half], [at + half, -half], [at + half, half], [at - half, half]];
        if clockwise {
            s.reverse();
        }
        s
    }

    fn area(faces: &[[u32; 3]], points: &[Flat]) -> f64 {
        faces.iter().map(|f| f.map(|v| points[v as usize])).map(|[a, b, c]| turn(a, b, c)).sum::<f64>() / 2.0
    }

    /// Every edge of a loop belongs to one more face that runs along it than against it, every other edge to as many.
    fn assert_closes(faces: &[[u32; 3]], loops: &[Vec<u32>]) {
        let mut balance = HashMap::new();
        let mut add =
            |a: u32, b: u32, n: i32| *balance.entry([a.min(b), a.max(b)]).or_insert(0) += if a < b { n } else { -n };
        faces.iter().for_each(|f| (0..3).for_each(|k| add(f[k], f[(k + 1) % 3], 1)));
        loops.iter().for_each(|l| (0..l.len()).for_each(|k| add(l[k], l[(k + 1) % l.len()], -1)));
        assert!(balance.values().all(|n| *n == 0), "{balance:?}");
    }

    fn covered(loops: &[Vec<u32>], points: &[Flat]) -> (Vec<[u32; 3]>, f64) {
        let flat = |v: u32| points[v as usize];
        let faces = cap(loops, &flat);
        let smallest = faces.iter().map(|f| turn(flat(f[0]), flat(f[1]), flat(f[2]))).fold(f64::INFINITY, f64::min);
        assert!(smallest >= 0.0, "no face is turned over: {smallest}");
        let area = faces.iter().map(|f| turn(flat(f[0]), flat(f[1]), flat(f[2]))).sum::<f64>() / 2.0;
        (faces, area)
    }

    #[test]
    fn a_bent_outline_with_vertices_on_a_line_is_covered_once() {
        // A U, with vertices along its straight sides.
        let u = [
            [0.0, 0.0],
            [2.0, 0.0],
            [4.0, 0.0],
            [6.0, 0.0],
            [6.0, 5.0],
            [5.0, 5.0],
            [5.0, 3.0],
            [5.0, 1.0],
            [1.0, 1.0],
            [1.0, 5.0],
            [0.0, 5.0],
            [0.0, 2.0],
        ];
        let (faces, area) = covered(&[(0..12).collect()], &u);
        assert_eq!(faces.len(), 10);
        assert!((area - 14.0).abs() < 1e-12, "{area}");
    }

    #[test]
    fn holes_stay_open_and_what_lies_in_them_is_covered() {
        let points =
            [square(0.0, 10.0, false), square(-5.0, 3.0, true), square(5.0, 3.0, true), square(5.0, 1.0, false)];
        let loops: Vec<Vec<u32>> = (0..4).map(|l| (4 * l..4 * l + 4).collect()).collect();
        let (faces, area) = covered(&loops, &points.concat());
        assert!((area - (400.0 - 36.0 - 36.0 + 4.0)).abs() < 1e-9, "{area}");
        assert_eq!(faces.len(), 4 + 2 * 4 + 2 * 2 - 2 + 2);
    }

    #[test]
    fn loops_that_touch_at_a_vertex_are_covered_once() {
        // A hole with a corner on the outer loop, and a second outer loop at another corner.
        let points = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [1.0, 2.0], [2.0, 1.0], [6.0, 4.0], [6.0, 6.0]];
        let loops = [vec![0, 1, 2, 3], vec![0, 4, 5], vec![2, 6, 7]];
        let (faces, area) = covered(&loops, &points);
        assert_closes(&faces, &loops);
        assert!((area - (16.0 - 1.5 + 2.0)).abs() < 1e-12, "{area}");
    }

    #[test]
    fn thin_outlines_and_nearly_collinear_points_keep_their_edges_and_their_area() {
        // A ring of 400 points on a circle, on a sliver, and on a line but for rounding.
        for height in [1.0, 1e-3, 1e-9] {
            let points: Vec<Flat> = (0..400)
                .map(|k| (f64::from(k) / 400.0 * std::f64::consts::TAU).sin_cos())
                .map(|(sin, cos)| [1e3 + 8.0 * cos, -7.0 + 8.0 * height * sin])
                .collect();
            let loops = [(0..400).collect::<Vec<u32>>()];
            let (faces, covered) = covered(&loops, &points);
            assert_closes(&faces, &loops);
            let truth = (1..399).map(|k| turn(points[0], points[k], points[k + 1])).sum::<f64>() / 2.0;
            assert!((covered - truth).abs() <= 1e-9 * truth + 1e-12, "{covered} of {truth} mm²");
        }
    }

    #[test]
    fn loops_that_cross_repeat_a_place_or_overlap_are_closed_with_their_signed_area() {
        let flat = |points: &[Flat], loops: &[Vec<u32>]| {
            let faces = cap(loops, &|v| points[v as usize]);
            assert_closes(&faces, loops);
            area(&faces, points)
        };
        let pair = |a: Vec<Flat>, b: Vec<Flat>| [a, b].concat();
        let both = [vec![0, 1, 2, 3], vec![4, 5, 6, 7]];
        // Two that cross, one within another that runs the same way round, a hole alone, a corner shared by two vertices.
        assert!((flat(&pair(square(0.0, 3.0, false), square(2.0, 2.0, false)), &both) - 52.0).abs() < 1e-9);
        assert!((flat(&pair(square(0.0, 3.0, false), square(0.0, 1.0, false)), &both) - 40.0).abs() < 1e-9);
        assert!((flat(&pair(square(0.0, 3.0, false), square(9.0, 1.0, true)), &both) - 32.0).abs() < 1e-9);
        assert!((flat(&pair(square(0.0, 3.0, false), square(6.0, 3.0, false)), &both) - 72.0).abs() < 1e-9);
        // A bow tie: no triangulation has its edges.
        assert!(flat(&[[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]], &[vec![0, 1, 2, 3]]).abs() < 1e-12);
    }
}
