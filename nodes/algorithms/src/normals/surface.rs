//! Normals of a whole surface, seen from no camera: a plane through each point's neighbours, then one side for all.

use super::NormalError;
use crate::bvh::Aabb;
use crate::kabsch::{centroid, finite};
use crate::point_blocks::{BLOCK_LEN, PointBlocks};
use crate::union_find::UnionFind;
use nalgebra::{Matrix3, Point3, Vector3};
use parry3d_f64::glamx::Vec4;
use rayon::prelude::*;
use std::ops::Range;

/// Neighbours a plane is fitted to, the point included: as many as average facets and noise without rounding a bone off.
const NEIGHBOURS: usize = 20;

/// A radius serves points that lie together and have so many neighbours within it on average.
const TYPICAL: std::ops::RangeInclusive<f64> = 14.0..=30.0;

/// How often the radius is changed for that, by at most this factor of the area each time.
const TRIES: usize = 3;
const CHANGE: f64 = 4.0;

/// Points that follow each other along the curve share a search for neighbours: so many, within so many radii; and of these
/// eight, within fewer radii, share what may lie within the radius of one of them.
const TOGETHER: (usize, f64) = (24, 4.0);
const EIGHT: (usize, f64) = (8, 2.0);

/// A radius serves a point with no fewer and no more neighbours than these; else its own nearest are searched for.
const FEWEST: f32 = 9.0;
const MOST: f32 = 60.0;

/// Points on a line or in one place get more neighbours, up to the last of these.
const MORE: [usize; 3] = [NEIGHBOURS, 60, 180];

/// Points lie on a line where the squared area that their spread spans is below this share of the squared spread.
const LINE: f64 = 1e-9;

/// Single precision tells a plane where the same, squared, is above this.
const PLANE: f32 = 1e-6;

/// Steps to the smallest root of a cubic.
const STEPS_TO_ROOT: usize = 6;

/// Two points farther off each other's plane than this share of their distance are on two sides of something thin, and
/// say nothing about each other's side.
const ACROSS: f64 = 0.6;

/// Fewer points than these are too few to tell outside from inside by themselves.
const ALONE: u32 = 100;

/// Agreement of two normals is sorted into so many steps.
const STEPS: usize = 64;

/// Points whose planes are fitted at a time.
const CHUNK: usize = 512;

/// Unit normals of a surface that is known by points alone, outwards where that can be told.
///
/// Across the plane that fits a point's neighbours best, about twenty: those within a radius that holds twenty on average
/// of the points thereabouts. Sides are made to agree from point to point, the clearest pairs first; then each connected
/// part is turned so that its normals point away from its middle on the whole, as those of every closed
/// surface do. So a closed surface gets outward normals. An open one (a single view, a crop) gets normals that agree, but
/// on which side is a guess: a point-to-plane registration does not mind, a closest-point field does. A closed surface
/// within another, such as the wall of a marrow cavity, counts as a bone of its own. Sheets closer to each other than
/// twice the spacing of the points are one to this function.
///
/// `O(n log n)`; on all threads of the current pool, whose number changes nothing.
///
/// # Errors
/// [`NormalError::NotFinite`] for a point with NaN; [`NormalError::NoPlane`] for a point which with its 180 nearest lies
/// on a line or in one place, also where there are fewer than three points.
///
/// # Source
/// Hoppe et al. 1992, sections 3.2 and 3.3.
pub fn of_surface(points: &[Point3<f64>]) -> Result<Vec<Vector3<f64>>, NormalError> {
    if let Some(index) = points.iter().position(|p| !finite(p)) {
        return Err(NormalError::NotFinite { index });
    }
    let centre = centroid(points);
    with_side(points.iter().map(|p| p - centre).collect())
}

fn with_side(places: Vec<Vector3<f64>>) -> Result<Vec<Vector3<f64>>, NormalError> {
    let blocks = PointBlocks::new(&places);
    if let Some(once) = Once::of(&places, &blocks.order) {
        let normals = with_side(once.places.clone()).map_err(|error| once.told(error))?;
        return Ok(once.for_all(&normals));
    }
    let along = blocks.along(&places);
    let (planes, edges) = fitted(&blocks, &along, true);
    let mut fitted: Vec<Vector3<f64>> = Vec::with_capacity(places.len());
    for (normal, &index) in planes.into_iter().flatten().zip(&blocks.order) {
        fitted.push(normal.ok_or(NormalError::NoPlane { index: index as usize })?);
    }
    orient(&along, &mut fitted, edges.into_iter().flatten());
    let mut normals = places;
    for (normal, &index) in fitted.into_iter().zip(&blocks.order) {
        normals[index as usize] = normal;
    }
    Ok(normals)
}

/// Unit normals of finite points about a centre nearby, on either side; zero where there is none.
///
/// As [`of_surface`], without what it does for their sides.
pub(crate) fn without_side(places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let blocks = PointBlocks::new(places);
    if let Some(once) = Once::of(places, &blocks.order) {
        return once.for_all(&without_side(&once.places));
    }
    let along = blocks.along(places);
    let mut normals = vec![Vector3::zeros(); places.len()];
    let (planes, _) = fitted(&blocks, &along, false);
    for (normal, &index) in planes.into_iter().flatten().zip(&blocks.order) {
        normals[index as usize] = normal.unwrap_or_default();
    }
    normals
}

/// Points of which many lie in one place, each place once: a thousand equal points are no neighbours that tell of a plane.
struct Once {
    places: Vec<Vector3<f64>>,
    /// Of each point, the number of its place.
    which: Vec<u32>,
}

impl Once {
    /// Without what equals the point before it along the curve; none where nothing does.
    fn of(places: &[Vector3<f64>], order: &[u32]) -> Option<Self> {
        let repeats = |pair: &[u32]| places[pair[0] as usize] == places[pair[1] as usize];
        if !order.windows(2).any(repeats) {
            return None;
        }
        let mut once = Self { places: Vec::new(), which: vec![0; places.len()] };
        for &i in order {
            let place = places[i as usize];
            if once.places.last() != Some(&place) {
                once.places.push(place);
            }
            once.which[i as usize] = once.places.len() as u32 - 1;
        }
        Some(once)
    }

    fn for_all(&self, normals: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        self.which.iter().map(|&place| normals[place as usize]).collect()
    }

    /// The error of a place as that of the first point there.
    fn told(&self, error: NormalError) -> NormalError {
        match error {
            NormalError::NoPlane { index } => {
                let first = self.which.iter().position(|&place| place as usize == index);
                NormalError::NoPlane { index: first.unwrap_or(index) }
            }
            error => error,
        }
    }
}

/// The planes of all points, chunk by chunk along the curve, and who is tied to whom if asked for.
fn fitted(blocks: &PointBlocks, along: &[Vector3<f64>], with_edges: bool) -> (Vec<Vec<Plane>>, Vec<Vec<Edge>>) {
    let n = along.len();
    (0..n.div_ceil(CHUNK))
        .into_par_iter()
        .map_init(
            || Work::new(blocks, along, with_edges),
            |work, chunk| work.chunk(chunk * CHUNK..((chunk + 1) * CHUNK).min(n)),
        )
        .unzip()
}

/// The normal of a point, where it has one.
type Plane = Option<Vector3<f64>>;

/// Two neighbours, by their numbers along the curve.
type Edge = (u32, u32);

/// What a chunk of points gives, and room for its work, which serves one chunk after another.
struct Work<'a> {
    blocks: &'a PointBlocks,
    /// The points along the curve.
    along: &'a [Vector3<f64>],
    with_edges: bool,
    normals: Vec<Plane>,
    edges: Vec<Edge>,
    /// What served the points before.
    radius: f64,
    nearest: Vec<(f32, u32)>,
    /// What lies around some points that are together, and of this what lies around eight of them.
    around: Around,
    near: Vec<Vec4>,
    numbers: Vec<u32>,
    n_near: usize,
}

/// Points about the first of some, side by side, four at a time, with the number of the first of the four along the curve.
#[derive(Default)]
struct Around {
    base: Vector3<f64>,
    fours: Vec<([Vec4; 3], u32)>,
}

/// Sums over the neighbours of four points, each about its own.
struct Moments {
    n: Vec4,
    sum: [Vec4; 3],
    /// xx, xy, xz, yy, yz, zz.
    squares: [Vec4; 6],
}

impl<'a> Work<'a> {
    fn new(blocks: &'a PointBlocks, along: &'a [Vector3<f64>], with_edges: bool) -> Self {
        let (normals, edges, nearest, around, near, numbers) = Default::default();
        let (radius, n_near) = (0.0, 0);
        Self { blocks, along, with_edges, normals, edges, radius, nearest, around, near, numbers, n_near }
    }

    /// The normals and edges of some points; begins with the radius that serves the first.
    fn chunk(&mut self, points: Range<usize>) -> (Vec<Plane>, Vec<Edge>) {
        self.blocks.nearest_n(&self.along[points.start], NEIGHBOURS, &mut self.nearest);
        self.radius = self.nearest.last().map_or(0.0, |(squared, _)| f64::from(squared.sqrt()));
        self.normals = Vec::with_capacity(points.len());
        self.edges = Vec::with_capacity(if self.with_edges { 3 * points.len() } else { 0 });
        let mut first = points.start;
        while first < points.end {
            first += self.fit(first..points.end);
        }
        (std::mem::take(&mut self.normals), std::mem::take(&mut self.edges))
    }

    /// Appends the normals of those of these points that lie together with the first, and to which neighbours they are
    /// tied if asked for; how many they are.
    fn fit(&mut self, points: Range<usize>) -> usize {
        let (n_normals, n_edges) = (self.normals.len(), self.edges.len());
        for _ in 0..TRIES {
            let (together, extent) = self.together(points.clone(), TOGETHER);
            self.gather(points.start, &extent);
            let (mut first, mut n_neighbours) = (points.start, 0.0);
            while first < together.end {
                let (eight, extent) = self.together(first..together.end, EIGHT);
                n_neighbours += self.planes(eight.clone(), &extent);
                first = eight.end;
            }
            let mean = n_neighbours / together.len() as f64;
            let wanted = (NEIGHBOURS as f64 / mean).clamp(1.0 / CHANGE, CHANGE).sqrt();
            if TYPICAL.contains(&mean) {
                // What comes next is much the same.
                self.radius *= wanted.sqrt().sqrt();
                return together.len();
            }
            self.radius *= wanted;
            self.normals.truncate(n_normals);
            self.edges.truncate(n_edges);
        }
        let extent = self.together(points.start..points.start + 1, EIGHT).1;
        self.gather(points.start, &extent);
        self.planes(points.start..points.start + 1, &extent);
        1
    }

    /// The longest run from the first of these points that is no longer than asked, nor wider than so many radii.
    fn together(&self, points: Range<usize>, (most, radii): (usize, f64)) -> (Range<usize>, Aabb) {
        let first = self.along[points.start];
        let mut extent = Aabb { min: first, max: first };
        for k in points.start + 1..points.end.min(points.start + most) {
            let place = self.along[k];
            let wider = Aabb { min: extent.min.inf(&place), max: extent.max.sup(&place) };
            if (wider.max - wider.min).max() > radii * self.radius {
                return (points.start..k, extent);
            }
            extent = wider;
        }
        (points.start..points.end.min(points.start + most), extent)
    }

    /// Gathers what lies within the radius of an extent, about a point.
    fn gather(&mut self, base: usize, extent: &Aabb) {
        let Self { blocks, along, radius, around: Around { base: at, fours }, .. } = self;
        *at = along[base];
        fours.clear();
        blocks.bvh.within(extent, *radius, |k| {
            let [x, y, z] = blocks.blocks[k].relative_to(at);
            let first = (k * BLOCK_LEN) as u32;
            fours.push(([x[0], y[0], z[0]], first));
            fours.push(([x[1], y[1], z[1]], first + 4));
        });
    }

    /// Appends the normals and edges of up to eight points from what was gathered; how many neighbours they have.
    fn planes(&mut self, eight: Range<usize>, extent: &Aabb) -> f64 {
        self.select(extent);
        let n = eight.len();
        let mut n_neighbours = 0.0;
        let places: [Vector3<f64>; EIGHT.0] = std::array::from_fn(|k| self.along[eight.start + k.min(n - 1)]);
        for (first, four) in (0..n).step_by(4).zip(places.chunks_exact(4)) {
            let lanes: [[f32; 4]; 3] =
                std::array::from_fn(|axis| std::array::from_fn(|k| (four[k][axis] - self.around.base[axis]) as f32));
            let lanes = lanes.map(Vec4::from_array);
            let moments = Moments::of(&lanes, &self.near[..self.n_near], self.radius);
            let some = (n - first).min(4);
            n_neighbours += moments.n.to_array()[..some].iter().map(|n| f64::from(*n)).sum::<f64>();
            for (k, normal) in moments.normals().into_iter().enumerate().take(some) {
                let normal = normal.or_else(|| self.of_nearest(&four[k]));
                self.normals.push(normal);
            }
        }
        if self.with_edges {
            for (k, place) in places.iter().enumerate().take(n) {
                let this = (eight.start + k) as u32;
                let follows = k > 0 && (places[k - 1] - place).norm() <= self.radius;
                if follows {
                    self.edges.push((this - 1, this));
                }
                // Two of eight are enough to tie them to those around.
                if !follows {
                    self.tie(this, place);
                }
            }
        }
        n_neighbours
    }

    /// Selects of what was gathered what lies within the radius of an extent.
    fn select(&mut self, extent: &Aabb) {
        let Self { around, near, numbers, n_near, radius, .. } = self;
        let side = |side: Vector3<f64>| (side - around.base).map(|c| Vec4::splat(c as f32)).data.0[0];
        let (min, max) = (side(extent.min), side(extent.max));
        let limit = Vec4::splat(squared(*radius));
        let most = 4 * around.fours.len();
        if near.len() < most {
            near.resize(most, Vec4::ZERO);
            numbers.resize(most, 0);
        }
        let (near, numbers) = (&mut near[..most], &mut numbers[..most]);
        let mut n = 0;
        for (four, first) in &around.fours {
            let [x, y, z] = four;
            let dx = (min[0] - *x).max(*x - max[0]).max(Vec4::ZERO);
            let dy = (min[1] - *y).max(*y - max[1]).max(Vec4::ZERO);
            let dz = (min[2] - *z).max(*z - max[2]).max(Vec4::ZERO);
            let within = (dx * dx + dy * dy + dz * dz).cmple(limit).bitmask();
            if within == 0 {
                continue;
            }
            // Each is written, and the next takes its place where it is not near: quicker than to ask.
            let (x, y, z) = (x.to_array(), y.to_array(), z.to_array());
            for k in 0..4 {
                (near[n], numbers[n]) = (Vec4::new(x[k], y[k], z[k], 0.0), first + k as u32);
                n += (within >> k & 1) as usize;
            }
        }
        *n_near = n;
    }

    /// The normal from the nearest of a point, as many as it takes.
    #[cold]
    fn of_nearest(&mut self, place: &Vector3<f64>) -> Option<Vector3<f64>> {
        MORE.into_iter().find_map(|n| {
            self.blocks.nearest_n(place, n, &mut self.nearest);
            let mut scatter = Scatter::default();
            for &(_, which) in &self.nearest {
                scatter.add(&(self.along[which as usize] - place));
            }
            scatter.normal()
        })
    }

    /// Ties a point to one of each block nearby, of those that come after a number.
    fn tie(&mut self, this: u32, place: &Vector3<f64>) {
        let place = (place - self.around.base).map(|c| c as f32);
        let place = Vec4::new(place.x, place.y, place.z, 0.0);
        let limit = squared(self.radius);
        let mut last = this / BLOCK_LEN as u32;
        for (near, &number) in self.near[..self.n_near].iter().zip(&self.numbers) {
            let block = number / BLOCK_LEN as u32;
            if block != last && (near - place).length_squared() <= limit {
                self.edges.push((this, number));
                last = block;
            }
        }
    }
}

/// The square of a radius, a little larger, so that a point that gave the radius lies within it.
fn squared(radius: f64) -> f32 {
    (radius * radius) as f32 * (1.0 + 1e-5)
}

impl Moments {
    /// Over those of `near` within the radius of each of four points.
    #[inline(always)]
    fn of(points: &[Vec4; 3], near: &[Vec4], radius: f64) -> Self {
        let limit = Vec4::splat(squared(radius));
        let (mut n, mut sum, mut squares) = (Vec4::ZERO, [Vec4::ZERO; 3], [Vec4::ZERO; 6]);
        for at in near {
            let [x, y, z] = [0, 1, 2].map(|axis| Vec4::splat(at[axis]) - points[axis]);
            let within = (x * x + y * y + z * z).cmple(limit);
            let [x, y, z] = [x, y, z].map(|c| Vec4::select(within, c, Vec4::ZERO));
            n += Vec4::select(within, Vec4::ONE, Vec4::ZERO);
            sum[0] += x;
            sum[1] += y;
            sum[2] += z;
            squares[0] += x * x;
            squares[1] += x * y;
            squares[2] += x * z;
            squares[3] += y * y;
            squares[4] += y * z;
            squares[5] += z * z;
        }
        Self { n, sum, squares }
    }

    /// The directions of the least spread; `None` for too few or too many points and for points nearly on a line.
    ///
    /// As [`least_direction`], four at a time in single precision.
    #[inline(always)]
    fn normals(&self) -> [Option<Vector3<f64>>; 4] {
        let [x, y, z] = self.sum;
        let share = Vec4::ONE / self.n;
        let [xx, xy, xz, yy, yz, zz] = self.squares;
        let [a, b, c] = [xx - x * x * share, yy - y * y * share, zz - z * z * share];
        let [d, e, f] = [xy - x * y * share, xz - x * z * share, yz - y * z * share];
        let scale = Vec4::ONE / (a + b + c);
        let [a, b, c, d, e, f] = [a, b, c, d, e, f].map(|v| v * scale);
        let minors = a * b + a * c + b * c - d * d - e * e - f * f;
        let determinant = a * (b * c - f * f) - d * (d * c - e * f) + e * (d * f - e * b);
        let (one, two, three) = (Vec4::ONE, Vec4::splat(2.0), Vec4::splat(3.0));
        let mut root = Vec4::ZERO;
        for _ in 0..STEPS_TO_ROOT {
            let value = ((root - one) * root + minors) * root - determinant;
            let slope = (three * root - two) * root + minors;
            let next = root - value / slope;
            root = Vec4::select(slope.cmpgt(Vec4::ZERO) & next.cmpgt(root), next, root);
        }
        let [a, b, c] = [a - root, b - root, c - root];
        let crosses = [
            [d * f - e * b, e * d - a * f, a * b - d * d],
            [d * c - e * f, e * e - a * c, a * f - d * e],
            [b * c - f * f, f * e - d * c, d * f - b * e],
        ];
        let (longest, length) = crosses
            .map(|cross| (cross, cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]))
            .into_iter()
            .reduce(|(best, longest), (next, length)| {
                let longer = length.cmpgt(longest);
                let chosen = [0, 1, 2].map(|axis| Vec4::select(longer, next[axis], best[axis]));
                (chosen, Vec4::select(longer, length, longest))
            })
            .expect("there are three");
        let served =
            length.cmpgt(Vec4::splat(PLANE)) & self.n.cmpge(Vec4::splat(FEWEST)) & self.n.cmple(Vec4::splat(MOST));
        let (served, [x, y, z]) = (served.bitmask(), longest.map(|four| four.to_array()));
        [0, 1, 2, 3].map(|k| (served >> k & 1 == 1).then(|| Vector3::new(x[k], y[k], z[k]).map(f64::from).normalize()))
    }
}

/// Sums over neighbours about a point.
#[derive(Default)]
struct Scatter {
    n: f64,
    sum: Vector3<f64>,
    squares: Matrix3<f64>,
}

impl Scatter {
    fn add(&mut self, away: &Vector3<f64>) {
        self.n += 1.0;
        self.sum += away;
        self.squares += away * away.transpose();
    }

    /// The direction of the least spread; `None` for points on a line.
    fn normal(&self) -> Option<Vector3<f64>> {
        if self.n < 3.0 {
            return None;
        }
        let spread = (self.squares - self.sum * self.sum.transpose() / self.n) / self.n;
        least_direction(&spread)
    }
}

/// The eigenvector of the smallest eigenvalue of a matrix that has none below zero; `None` where the two smallest are zero.
///
/// Newton's method from zero climbs to the smallest root of the characteristic polynomial and never passes it; of a matrix
/// less its eigenvalue, all rows are across the eigenvector. A fifth of the time of a general solver, and no arc cosine,
/// whose last digit depends on the machine.
fn least_direction(matrix: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let scale = matrix.trace();
    if scale <= 0.0 {
        return None;
    }
    let m = matrix / scale;
    let (a, b, c) = (m[(0, 0)], m[(1, 1)], m[(2, 2)]);
    let (d, e, f) = (m[(0, 1)], m[(0, 2)], m[(1, 2)]);
    let minors = a * b + a * c + b * c - d * d - e * e - f * f;
    let determinant = a * (b * c - f * f) - d * (d * c - e * f) + e * (d * f - e * b);
    if minors <= LINE {
        return None;
    }
    let mut root = 0.0;
    for _ in 0..50 {
        // The trace is one.
        let value = ((root - 1.0) * root + minors) * root - determinant;
        let slope = (3.0 * root - 2.0) * root + minors;
        if slope <= 0.0 {
            break;
        }
        let next = root - value / slope;
        if next <= root {
            break;
        }
        root = next;
    }
    let rows = [Vector3::new(a - root, d, e), Vector3::new(d, b - root, f), Vector3::new(e, f, c - root)];
    [rows[0].cross(&rows[1]), rows[0].cross(&rows[2]), rows[1].cross(&rows[2])]
        .into_iter()
        .reduce(|best, next| if next.norm_squared() > best.norm_squared() { next } else { best })
        // Where two eigenvalues are nearly the same, no direction is better than another.
        .and_then(|longest| longest.try_normalize(1e-12))
}

/// Turns normals so that neighbours agree, along the clearest pairs (a minimum spanning tree), then each part outwards.
fn orient(along: &[Vector3<f64>], normals: &mut [Vector3<f64>], edges: impl Iterator<Item = Edge>) {
    let mut parts = UnionFind::new(along.len());
    let mut less_clear: Vec<(u8, Edge)> = Vec::new();
    let mut across: Vec<(f64, Edge)> = Vec::new();
    for (i, j) in edges {
        let (n, m) = (&normals[i as usize], &normals[j as usize]);
        let between = along[j as usize] - along[i as usize];
        let off = n.dot(&between).abs().max(m.dot(&between).abs());
        if off * off > ACROSS * ACROSS * between.norm_squared() {
            across.push((off / between.norm(), (i, j)));
            continue;
        }
        let agreement = n.dot(m);
        match ((1.0 - agreement.abs()) * STEPS as f64) as u8 {
            0 => parts.join(i, j, agreement < 0.0),
            step => less_clear.push((step, (i, j))),
        }
    }
    less_clear.sort_by_key(|(step, _)| *step);
    for (_, (i, j)) in less_clear {
        parts.join(i, j, normals[i as usize].dot(&normals[j as usize]) < 0.0);
    }
    // A few points alone, as at a corner, had better follow those across than a guess.
    across.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sizes = parts.sizes();
    for (_, (i, j)) in across {
        let [a, b] = [i, j].map(|k| parts.root(k).0 as usize);
        if a != b && sizes[a].min(sizes[b]) < ALONE {
            sizes[a.min(b)] = sizes[a] + sizes[b];
            parts.join(i, j, normals[i as usize].dot(&normals[j as usize]) < 0.0);
        }
    }
    let (found, n_parts) = parts.labels();
    let mut sums = vec![(0.0, Vector3::zeros()); n_parts];
    for (place, (part, _)) in along.iter().zip(&found) {
        let (n, sum) = &mut sums[*part as usize];
        *n += 1.0;
        *sum += place;
    }
    let mut outwards = vec![0.0; n_parts];
    for ((place, normal), &(part, turned)) in along.iter().zip(normals.iter()).zip(&found) {
        let (n, sum) = &sums[part as usize];
        let out = normal.dot(&(place - sum / *n));
        outwards[part as usize] += if turned { -out } else { out };
    }
    for (normal, &(part, turned)) in normals.iter_mut().zip(&found) {
        if turned != (outwards[part as usize] < 0.0) {
            *normal = -*normal;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plane_normal;
    use super::*;
    use crate::nearest::Nearest;
    use crate::sample;
    use crate::shapes::{cuboid, shaft, together};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn drawn(mesh: &osteoflow_geometry::Mesh, n: usize) -> sample::Samples {
        sample::surface(mesh, n, &mut ChaCha8Rng::seed_from_u64(1))
    }

    #[test]
    fn a_sheet_has_one_normal() {
        let points: Vec<_> = (0..10_000)
            .map(|i| (f64::from(i % 100) * 0.37, f64::from(i / 100) * 0.41))
            .map(|(x, y)| Point3::new(x, y, 0.3 * x - 0.7 * y + 1e7))
            .collect();
        let normals = of_surface(&points).unwrap();
        let truth = Vector3::new(-0.3, 0.7, 1.0).normalize();
        let side = normals[0].dot(&truth).signum();
        let worst = normals.iter().map(|n| (n * side - truth).norm()).fold(0.0, f64::max);
        assert!(worst < 1e-5, "{worst} rad");
    }

    #[test]
    fn closed_surfaces_have_outward_normals_each_for_itself() {
        let far = cuboid([100.0, 0.0, 0.0], [130.0, 10.0, 10.0]);
        for (mesh, n) in [(shaft(), 40_000), (together(&cuboid([0.0; 3], [20.0; 3]), &far), 20_000)] {
            let drawn = drawn(&mesh, n);
            let normals = of_surface(&drawn.points).unwrap();
            let off = normals.iter().zip(&drawn.normals).filter(|(a, b)| a.dot(b) < 0.3).count();
            assert!(off * 500 < n, "{off} of {n} normals turned away, more than at corners");
            assert!(normals.iter().all(|n| (n.norm() - 1.0).abs() < 1e-9));
        }
    }

    #[test]
    fn they_are_those_of_the_twenty_nearest_within_the_draw_of_the_neighbours() {
        let drawn = drawn(&shaft(), 40_000);
        let normals = of_surface(&drawn.points).unwrap();
        let tree = Nearest::new(&drawn.points);
        let rms = |of: &dyn Fn(usize) -> f64| {
            ((0..40_000).step_by(37).map(|i| of(i).powi(2)).sum::<f64>() / (0..40_000).step_by(37).count() as f64)
                .sqrt()
        };
        let exact = |i: usize| {
            let near: Vec<_> = tree.nearest_n(&drawn.points[i], 20).iter().map(|&(k, _)| drawn.points[k]).collect();
            plane_normal(&near).unwrap()
        };
        let line = |angle: f64| angle.min(std::f64::consts::PI - angle);
        let between = rms(&|i| line(normals[i].angle(&exact(i))));
        let ours = rms(&|i| line(normals[i].angle(&drawn.normals[i])));
        let theirs = rms(&|i| line(exact(i).angle(&drawn.normals[i])));
        assert!(between < 0.03 && ours < 1.15 * theirs, "{between} rad apart, {ours} and {theirs} rad from the faces");
    }

    #[test]
    fn threads_change_no_bit() {
        let drawn = drawn(&shaft(), 10_000);
        let [one, eight] = [1, 8].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| of_surface(&drawn.points).unwrap())
        });
        assert_eq!(one, eight);
    }

    #[test]
    fn uneven_and_repeated_points_have_normals_too() {
        // Rows ten times as far apart as their points, dense in one corner, each point four times.
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut points: Vec<Point3<f64>> =
            (0..4000).map(|i| Point3::new(f64::from(i % 200) * 0.05, f64::from(i / 200) * 0.5, 0.0)).collect();
        points.extend((0..4000).map(|_| Point3::new(rng.random::<f64>() * 0.2, rng.random::<f64>() * 0.2, 0.0)));
        let points: Vec<_> = points.iter().flat_map(|p| [*p; 4]).collect();
        for normal in of_surface(&points).unwrap() {
            assert!(normal.z.abs() > 0.999, "{normal}");
        }
    }

    #[test]
    fn the_least_direction_is_that_of_a_general_solver() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..2000 {
            let root = Matrix3::from_fn(|_, _| rng.random::<f64>() - 0.5)
                * Matrix3::from_diagonal(&Vector3::new(1.0, 0.6, 0.05));
            let matrix = root * root.transpose();
            let eigen = matrix.symmetric_eigen();
            let exact = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
            let mut values: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
            values.sort_by(f64::total_cmp);
            if values[1] > 1e-4 * values[2] && values[1] > 1.1 * values[0] {
                let found = least_direction(&matrix).unwrap();
                assert!(found.dot(&exact).abs() > 1.0 - 1e-9, "{found} {exact} {values:?}");
            }
        }
        assert_eq!(least_direction(&Matrix3::zeros()), None);
        assert_eq!(least_direction(&Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, 4.0))), None);
    }

    #[test]
    fn what_has_no_plane_is_refused() {
        let line: Vec<_> = (0..300).map(|i| Point3::new(f64::from(i), 2.0 * f64::from(i), 1e6)).collect();
        for points in [&line[..], &line[..2], &line[..1], &[Point3::origin(); 500]] {
            assert!(matches!(of_surface(points), Err(NormalError::NoPlane { .. })), "{} points", points.len());
        }
        assert_eq!(of_surface(&[]), Ok(Vec::new()));
        let mut wild = line;
        wild[5].z = f64::INFINITY;
        assert_eq!(of_surface(&wild), Err(NormalError::NotFinite { index: 5 }));
    }
}
