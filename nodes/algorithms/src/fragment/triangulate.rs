//! Faces over the outlines of a cut, by clipping ears.
//!
//! Every vertex of an outline stays one, also where three lie on a line, so that what joins there stays closed; a general
//! triangulation crate drops such vertices.

/// A place in the plane of the cut, mm.
type Flat = [f64; 2];

/// Faces over `loops`, counter-clockwise where `flat` says so: outer loops run counter-clockwise, those around holes
/// clockwise.
pub(super) fn cap(loops: &[Vec<u32>], flat: &dyn Fn(u32) -> Flat) -> Vec<[u32; 3]> {
    let areas: Vec<f64> = loops.iter().map(|l| area(l, flat)).collect();
    let mut outer: Vec<(usize, Vec<usize>)> =
        (0..loops.len()).filter(|&l| areas[l] >= 0.0).map(|l| (l, Vec::new())).collect();
    let mut faces = Vec::new();
    for hole in (0..loops.len()).filter(|&l| areas[l] < 0.0) {
        let around = outer.iter_mut().filter(|(l, _)| contains(&loops[*l], &loops[hole], flat));
        match around.min_by(|(a, _), (b, _)| areas[*a].total_cmp(&areas[*b])) {
            Some((_, holes)) => holes.push(hole),
            // Of a bone that cuts through itself: turned over, it still closes what it bounds.
            None => {
                let turned: Vec<u32> = loops[hole].iter().rev().copied().collect();
                faces.extend(ears(turned, flat).into_iter().map(|[a, b, c]| [a, c, b]));
            }
        }
    }
    for (l, holes) in outer {
        let holes = holes.into_iter().map(|h| loops[h].clone()).collect();
        faces.extend(ears(bridged(loops[l].clone(), holes, flat), flat));
    }
    faces
}

/// Twice the signed area of a triangle.
fn turn(a: Flat, b: Flat, c: Flat) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn area(outline: &[u32], flat: &dyn Fn(u32) -> Flat) -> f64 {
    let Some(&first) = outline.first() else { return 0.0 };
    let start = flat(first);
    outline.windows(2).map(|w| turn(start, flat(w[0]), flat(w[1]))).sum::<f64>() / 2.0
}

/// Whether most vertices of `inner` lie inside `outer`: loops may touch at single vertices.
fn contains(outer: &[u32], inner: &[u32], flat: &dyn Fn(u32) -> Flat) -> bool {
    let corners: Vec<Flat> = outer.iter().map(|&v| flat(v)).collect();
    let is_inside = |p: Flat| {
        let mut inside = false;
        for (k, b) in corners.iter().enumerate() {
            let a = corners[(k + corners.len() - 1) % corners.len()];
            if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (b[0] - a[0]) * (p[1] - a[1]) / (b[1] - a[1]) {
                inside = !inside;
            }
        }
        inside
    };
    2 * inner.iter().filter(|v| is_inside(flat(**v))).count() > inner.len()
}

/// One outline that runs into each hole and back along the same way.
fn bridged(mut outer: Vec<u32>, mut holes: Vec<Vec<u32>>, flat: &dyn Fn(u32) -> Flat) -> Vec<u32> {
    // From the right, so that no hole still to come lies between a hole and what is already joined.
    let right = |hole: &Vec<u32>| hole.iter().map(|&v| flat(v)[0]).fold(f64::NEG_INFINITY, f64::max);
    holes.sort_by(|a, b| right(b).total_cmp(&right(a)));
    for mut hole in holes {
        let Some(from) = (0..hole.len()).max_by(|&a, &b| flat(hole[a])[0].total_cmp(&flat(hole[b])[0])) else {
            continue;
        };
        hole.rotate_left(from);
        let start = flat(hole[0]);
        let square = |k: usize| {
            let p = flat(outer[k]);
            (p[0] - start[0]).powi(2) + (p[1] - start[1]).powi(2)
        };
        let mut by_distance: Vec<usize> = (0..outer.len()).collect();
        by_distance.sort_by(|&a, &b| square(a).total_cmp(&square(b)));
        let seen = |k: &&usize| is_seen(&outer, **k, &hole, flat);
        let Some(&at) = by_distance.iter().find(seen).or(by_distance.first()) else { continue };
        let back = [hole[0], outer[at]];
        outer.splice(at + 1..at + 1, hole.into_iter().chain(back));
    }
    outer
}

/// Whether the way from the hole's first vertex to vertex `k` of the outline crosses neither and leaves inwards.
fn is_seen(outer: &[u32], k: usize, hole: &[u32], flat: &dyn Fn(u32) -> Flat) -> bool {
    let (p, q) = (flat(hole[0]), flat(outer[k]));
    let (before, after) = (flat(outer[(k + outer.len() - 1) % outer.len()]), flat(outer[(k + 1) % outer.len()]));
    let inwards = if turn(before, q, after) >= 0.0 {
        turn(before, q, p) > 0.0 && turn(q, after, p) > 0.0
    } else {
        turn(before, q, p) > 0.0 || turn(q, after, p) > 0.0
    };
    let free = |outline: &[u32]| {
        (0..outline.len()).all(|i| {
            let (a, b) = (flat(outline[i]), flat(outline[(i + 1) % outline.len()]));
            if [a, b].contains(&p) || [a, b].contains(&q) {
                return true;
            }
            turn(p, q, a) * turn(p, q, b) > 0.0 || turn(a, b, p) * turn(a, b, q) > 0.0
        })
    };
    inwards && free(outer) && free(hole)
}

/// Triangles over one outline. What no ear can be cut from (an outline that crosses itself) still gets faces that use
/// every edge, so that the surface is closed and its signed volume right.
fn ears(outline: Vec<u32>, flat: &dyn Fn(u32) -> Flat) -> Vec<[u32; 3]> {
    let mut left: Vec<(u32, Flat)> = outline.into_iter().map(|v| (v, flat(v))).collect();
    let mut faces = Vec::with_capacity(left.len().saturating_sub(2));
    let mut at = 0;
    while left.len() > 3 {
        let n = left.len();
        let corner = |k: usize| [left[(k + n - 1) % n], left[k % n], left[(k + 1) % n]];
        let is_ear = |&k: &usize| {
            let [a, b, c] = corner(k).map(|(_, p)| p);
            turn(a, b, c) > 0.0
                && left.iter().all(|&(_, p)| {
                    [a, b, c].contains(&p) || turn(a, b, p) < 0.0 || turn(b, c, p) < 0.0 || turn(c, a, p) < 0.0
                })
        };
        // On from the last one, so that ears are cut all around and not as one fan.
        let found = (at..at + n).map(|k| k % n).find(is_ear);
        let flattest = || {
            let size = |k: usize| {
                let [a, b, c] = corner(k).map(|(_, p)| p);
                turn(a, b, c).abs()
            };
            (0..n).min_by(|&a, &b| size(a).total_cmp(&size(b))).unwrap_or(0)
        };
        let ear = found.unwrap_or_else(flattest);
        faces.push(corner(ear).map(|(v, _)| v));
        left.remove(ear);
        at = ear + 1;
    }
    if let [a, b, c] = left[..] {
        faces.push([a.0, b.0, c.0]);
    }
    faces
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let square = |at: f64, half: f64, turned: bool| {
            let mut s = vec![[at - half, -half], [at + half, -half], [at + half, half], [at - half, half]];
            if turned {
                s.reverse();
            }
            s
        };
        let points =
            [square(0.0, 10.0, false), square(-5.0, 3.0, true), square(5.0, 3.0, true), square(5.0, 1.0, false)];
        let loops: Vec<Vec<u32>> = (0..4).map(|l| (4 * l..4 * l + 4).collect()).collect();
        let (faces, area) = covered(&loops, &points.concat());
        assert!((area - (400.0 - 36.0 - 36.0 + 4.0)).abs() < 1e-9, "{area}");
        assert_eq!(faces.len(), 4 + 2 * 4 + 2 * 2 - 2 + 2);
    }
}
