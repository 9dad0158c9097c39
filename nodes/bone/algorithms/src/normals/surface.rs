//! Normals of a whole surface without a viewpoint: a plane through each point's neighbours, then consistent signs.

use crate::Refusal;
use crate::bvh::Aabb;
use crate::kabsch::{centroid, finite};
use crate::point_blocks::{BLOCK_LEN, PointBlocks};
use crate::union_find::UnionFind;
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// Preferred number of neighbours, the point included: enough to average facets and noise without rounding a bone off.
const NEIGHBOURS: usize = 20;

/// Mean number of neighbours at which a radius is accepted for a run of points.
const ACCEPTED_MEAN: RangeInclusive<f64> = 14.0..=30.0;

/// Number of radii tried for a run, and the largest change of the area from one to the next.
const TRIES: usize = 3;
const MAX_CHANGE: f64 = 4.0;

/// Consecutive points that share a neighbour search: their maximum number, and the maximum width of their box in radii.
const RUN: (usize, f64) = (24, 4.0);
/// Consecutive points of a run that share the candidates within the radius of their box.
const GROUP: (usize, f64) = (8, 2.0);

/// Number of neighbours at which a point's plane is fitted to them; otherwise its nearest are searched for.
const SERVED: RangeInclusive<usize> = 9..=60;

/// Numbers of nearest points tried in turn where points lie nearly on a line or in one place.
const NEAREST: [usize; 3] = [NEIGHBOURS, 60, 180];

/// Points lie on a line if the sum of the principal minors of their scatter is below this share of its squared trace.
const LINE: f64 = 1e-9;
/// The limit for points within the radius, which have more nearest neighbours to fall back on.
const NEARLY_LINE: f64 = 1e-3;

/// Two points farther off each other's plane than this share of their distance lie on opposite sides of a thin part,
/// and say nothing about each other's sign.
const ACROSS: f64 = 0.6;

/// Components of fewer points are too small to tell outside from inside.
const MIN_COMPONENT: u32 = 100;

/// Number of steps in which the agreement of two normals is sorted.
const STEPS: usize = 64;

/// Number of points fitted at a time by one thread.
const CHUNK: usize = 512;

/// Unit normals of a surface that is known by points alone, outward where that can be told.
///
/// Each normal is that of the plane fitted to a point's neighbours: those within a radius that holds about twenty points
/// on average in the vicinity. Signs are made consistent from point to point along the clearest pairs first. Each
/// connected component is then flipped so that its normals point away from its centroid on the whole, as those of every
/// closed surface do. A closed surface thus gets outward normals. The normals of an open one (a single view, a crop) are
/// consistent, but their side is a guess, on which point-to-plane registration does not depend.
/// A closed surface within another, such as the wall of a marrow cavity, is a component of its own. Sheets closer to each
/// other than twice the point spacing are not told apart.
///
/// `O(n log n)`, on all threads of the current pool; their number does not change the result.
///
/// # Errors
/// [`Refusal`] for a point with NaN, and for one that lies with its 180 nearest on
/// a line or in one place, also where there are fewer than three points.
///
/// # Source
/// Hoppe et al. 1992, sections 3.2 and 3.3.
pub fn of_surface(points: &[Point3<f64>]) -> Result<Vec<Vector3<f64>>, Refusal> {
    if let Some(index) = points.iter().position(|p| !finite(p)) {
        return Err(Refusal::of(format!("point {index} is not finite; drop it before normals are estimated")));
    }
    let centre = centroid(points);
    with_side(points.iter().map(|p| p - centre).collect()).map_err(|index| {
        Refusal::of(format!(
            "point {index} and its nearest lie on a line or in one place, so there is no normal; is this a surface?"
        ))
    })
}

/// # Errors
/// The index of the first point, along the curve, whose neighbours make no plane.
fn with_side(places: Vec<Vector3<f64>>) -> Result<Vec<Vector3<f64>>, usize> {
    let blocks = PointBlocks::new(&places);
    if let Some(distinct) = Distinct::of(&places, &blocks.order) {
        let normals = with_side(distinct.places.clone()).map_err(|place| distinct.in_input(place))?;
        return Ok(distinct.for_all(&normals));
    }
    let along = blocks.along(&places);
    let (fits, edges) = fit_all(&blocks, &along, true);
    let mut fitted: Vec<Vector3<f64>> = Vec::with_capacity(places.len());
    for (normal, &index) in fits.into_iter().flatten().zip(&blocks.order) {
        fitted.push(normal.ok_or(index as usize)?);
    }
    orient(&along, &mut fitted, edges.into_iter().flatten());
    let mut normals = places;
    for (normal, &index) in fitted.into_iter().zip(&blocks.order) {
        normals[index as usize] = normal;
    }
    Ok(normals)
}

/// Unit normals of finite points, which should be relative to a centre nearby, of either sign; zero where there is none.
pub(crate) fn without_side(places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let blocks = PointBlocks::new(places);
    if let Some(distinct) = Distinct::of(places, &blocks.order) {
        return distinct.for_all(&without_side(&distinct.places));
    }
    let along = blocks.along(places);
    let mut normals = vec![Vector3::zeros(); places.len()];
    let (fits, _) = fit_all(&blocks, &along, false);
    for (normal, &index) in fits.into_iter().flatten().zip(&blocks.order) {
        normals[index as usize] = normal.unwrap_or_default();
    }
    normals
}

/// Points without repetitions: a thousand equal points say nothing about a plane.
struct Distinct {
    places: Vec<Vector3<f64>>,
    /// For each point of the input its index among the distinct ones.
    which: Vec<u32>,
}

impl Distinct {
    /// Drops points equal to the one before along the curve; `None` if there are none.
    fn of(places: &[Vector3<f64>], order: &[u32]) -> Option<Self> {
        let repeats = |pair: &[u32]| places[pair[0] as usize] == places[pair[1] as usize];
        if !order.windows(2).any(repeats) {
            return None;
        }
        let mut distinct = Self { places: Vec::new(), which: vec![0; places.len()] };
        for &i in order {
            let place = places[i as usize];
            if distinct.places.last() != Some(&place) {
                distinct.places.push(place);
            }
            distinct.which[i as usize] = distinct.places.len() as u32 - 1;
        }
        Some(distinct)
    }

    fn for_all(&self, normals: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        self.which.iter().map(|&place| normals[place as usize]).collect()
    }

    /// The index of the first such point in the input.
    fn in_input(&self, place: usize) -> usize {
        self.which.iter().position(|&other| other as usize == place).unwrap_or(place)
    }
}

/// Normals of all points, and edges between neighbours if `with_edges`, by chunks along the curve.
fn fit_all(blocks: &PointBlocks, along: &[Vector3<f64>], with_edges: bool) -> (Vec<Vec<Normal>>, Vec<Vec<Edge>>) {
    let n = along.len();
    (0..n.div_ceil(CHUNK))
        .into_par_iter()
        .map_init(
            || Fitting::new(blocks, along, with_edges),
            |fitting, chunk| fitting.chunk(chunk * CHUNK..((chunk + 1) * CHUNK).min(n)),
        )
        .unzip()
}

/// The normal of a point, where its neighbours make a plane.
type Normal = Option<Vector3<f64>>;

/// Two neighbours, by their positions along the curve.
type Edge = (u32, u32);

/// Results for a chunk of points, with buffers that are reused from chunk to chunk.
struct Fitting<'a> {
    blocks: &'a PointBlocks,
    /// The points along the curve.
    along: &'a [Vector3<f64>],
    with_edges: bool,
    normals: Vec<Normal>,
    edges: Vec<Edge>,
    /// The radius accepted for the previous points, mm.
    radius: f64,
    nearest: Vec<(f32, u32)>,
    /// Candidates around a run of points, by position along the curve.
    around_run: Vec<u32>,
    /// Those of them that are around a group.
    around_group: Vec<(u32, Vector3<f64>)>,
}

impl<'a> Fitting<'a> {
    fn new(blocks: &'a PointBlocks, along: &'a [Vector3<f64>], with_edges: bool) -> Self {
        let (normals, edges, nearest, around_run, around_group) = Default::default();
        Self { blocks, along, with_edges, normals, edges, radius: 0.0, nearest, around_run, around_group }
    }

    /// Normals and edges of a chunk, beginning with the radius that suits its first point.
    fn chunk(&mut self, points: Range<usize>) -> (Vec<Normal>, Vec<Edge>) {
        self.blocks.nearest_n(&self.along[points.start], NEIGHBOURS, &mut self.nearest);
        self.radius = self.nearest.last().map_or(0.0, |(squared, _)| f64::from(squared.sqrt()));
        self.normals = Vec::with_capacity(points.len());
        self.edges = Vec::with_capacity(if self.with_edges { 3 * points.len() } else { 0 });
        let mut first = points.start;
        while first < points.end {
            first += self.fit_run(first..points.end);
        }
        (std::mem::take(&mut self.normals), std::mem::take(&mut self.edges))
    }

    /// Appends normals and edges of the first points that lie close together; returns their number.
    fn fit_run(&mut self, points: Range<usize>) -> usize {
        let (n_normals, n_edges) = (self.normals.len(), self.edges.len());
        for _ in 0..TRIES {
            let (run, bounds) = self.together(points.clone(), RUN);
            self.gather(&bounds);
            let (mut first, mut n_neighbours) = (points.start, 0);
            while first < run.end {
                let (group, bounds) = self.together(first..run.end, GROUP);
                n_neighbours += self.fit_group(group.clone(), &bounds);
                first = group.end;
            }
            let mean = n_neighbours as f64 / run.len() as f64;
            let change = (NEIGHBOURS as f64 / mean).clamp(1.0 / MAX_CHANGE, MAX_CHANGE).sqrt();
            if ACCEPTED_MEAN.contains(&mean) {
                // The next run has about the same density.
                self.radius *= change.sqrt().sqrt();
                return run.len();
            }
            self.radius *= change;
            self.normals.truncate(n_normals);
            self.edges.truncate(n_edges);
        }
        let (first, bounds) = self.together(points.start..points.start + 1, GROUP);
        self.gather(&bounds);
        self.fit_group(first, &bounds);
        1
    }

    /// The first of these points, limited in number and in the width of their box, with that box.
    fn together(&self, points: Range<usize>, (max_len, max_radii): (usize, f64)) -> (Range<usize>, Aabb) {
        let first = self.along[points.start];
        let mut bounds = Aabb { min: first, max: first };
        for k in points.start + 1..points.end.min(points.start + max_len) {
            let place = self.along[k];
            let wider = Aabb { min: bounds.min.inf(&place), max: bounds.max.sup(&place) };
            if (wider.max - wider.min).max() > max_radii * self.radius {
                return (points.start..k, bounds);
            }
            bounds = wider;
        }
        (points.start..points.end.min(points.start + max_len), bounds)
    }

    /// Gathers the blocks of points that may lie within the radius of a run's box.
    fn gather(&mut self, bounds: &Aabb) {
        let Self { blocks, along, radius, around_run, .. } = self;
        around_run.clear();
        blocks.bvh.within(bounds, *radius, |block| {
            let first = block * BLOCK_LEN;
            around_run.extend(first as u32..along.len().min(first + BLOCK_LEN) as u32);
        });
    }

    /// Appends normals and edges of a group; returns its total number of neighbours.
    fn fit_group(&mut self, group: Range<usize>, bounds: &Aabb) -> usize {
        let along = self.along;
        let limit = squared_limit(self.radius);
        let near = |&i: &u32| {
            let place = along[i as usize];
            let outside = (bounds.min - place).sup(&(place - bounds.max)).sup(&Vector3::zeros());
            (outside.norm_squared() <= limit).then_some((i, place))
        };
        self.around_group.clear();
        self.around_group.extend(self.around_run.iter().filter_map(near));
        let mut n_neighbours = 0;
        for k in group.clone() {
            let mut scatter = Scatter::default();
            for (_, place) in &self.around_group {
                let offset = place - along[k];
                if offset.norm_squared() <= limit {
                    scatter.add(&offset);
                }
            }
            n_neighbours += scatter.n;
            let normal = if SERVED.contains(&scatter.n) { scatter.normal(NEARLY_LINE) } else { None };
            let normal = normal.or_else(|| self.of_nearest(&along[k]));
            self.normals.push(normal);
        }
        if self.with_edges {
            for k in group.clone() {
                // A point next to the one before is tied to the surroundings through it.
                if k > group.start && (along[k - 1] - along[k]).norm() <= self.radius {
                    self.edges.push((k as u32 - 1, k as u32));
                } else {
                    self.tie(k as u32);
                }
            }
        }
        n_neighbours
    }

    /// The normal from the nearest neighbours of a point, as many as it takes.
    #[cold]
    fn of_nearest(&mut self, place: &Vector3<f64>) -> Normal {
        NEAREST.into_iter().find_map(|n| {
            self.blocks.nearest_n(place, n, &mut self.nearest);
            let mut scatter = Scatter::default();
            for &(_, which) in &self.nearest {
                scatter.add(&(self.along[which as usize] - place));
            }
            scatter.normal(LINE)
        })
    }

    /// Adds edges from a point to the first neighbour in each other block.
    fn tie(&mut self, k: u32) {
        let limit = squared_limit(self.radius);
        let mut last = k / BLOCK_LEN as u32;
        for &(i, place) in &self.around_group {
            let block = i / BLOCK_LEN as u32;
            if block != last && (place - self.along[k as usize]).norm_squared() <= limit {
                self.edges.push((k, i));
                last = block;
            }
        }
    }
}

/// The square of a radius, enlarged so that the point that determined the radius lies within it.
fn squared_limit(radius: f64) -> f64 {
    radius * radius * (1.0 + 1e-5)
}

/// Sums over the offsets of neighbours from a point.
#[derive(Default)]
struct Scatter {
    n: usize,
    sum: Vector3<f64>,
    squares: Matrix3<f64>,
}

impl Scatter {
    fn add(&mut self, offset: &Vector3<f64>) {
        self.n += 1;
        self.sum += offset;
        self.squares += offset * offset.transpose();
    }

    /// The direction of least variance; `None` for points on a line, by the given limit.
    fn normal(&self, line: f64) -> Normal {
        if self.n < 3 {
            return None;
        }
        let n = self.n as f64;
        least_direction(&((self.squares - self.sum * self.sum.transpose() / n) / n), line)
    }
}

/// The eigenvector of the smallest eigenvalue of a positive semidefinite matrix; `None` where the two smallest are zero,
/// by the limit `line` on the sum of the principal minors.
///
/// Newton's method from zero converges to the smallest root of the characteristic polynomial from below; the rows of the
/// matrix minus its eigenvalue are orthogonal to the eigenvector. Takes a fifth of the time of a general solver, and needs
/// no arc cosine, whose last digit depends on the machine.
fn least_direction(matrix: &Matrix3<f64>, line: f64) -> Normal {
    let scale = matrix.trace();
    if scale <= 0.0 {
        return None;
    }
    let m = matrix / scale;
    let (a, b, c) = (m[(0, 0)], m[(1, 1)], m[(2, 2)]);
    let (d, e, f) = (m[(0, 1)], m[(0, 2)], m[(1, 2)]);
    let minors = a * b + a * c + b * c - d * d - e * e - f * f;
    let determinant = a * (b * c - f * f) - d * (d * c - e * f) + e * (d * f - e * b);
    if minors <= line {
        return None;
    }
    let mut root = 0.0;
    for _ in 0..50 {
        // Of the polynomial of a matrix with trace 1.
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
        // Where two eigenvalues are nearly equal, no direction is better than another.
        .and_then(|longest| longest.try_normalize(1e-12))
}

/// Flips normals so that neighbours agree, along the clearest pairs (a minimum spanning tree), then each component outward.
fn orient(along: &[Vector3<f64>], normals: &mut [Vector3<f64>], edges: impl Iterator<Item = Edge>) {
    let mut components = UnionFind::new(along.len());
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
            0 => components.join(i, j, agreement < 0.0),
            step => less_clear.push((step, (i, j))),
        }
    }
    less_clear.sort_by_key(|(step, _)| *step);
    for (_, (i, j)) in less_clear {
        components.join(i, j, normals[i as usize].dot(&normals[j as usize]) < 0.0);
    }
    // A small component, as at a corner, follows its neighbours across instead of guessing.
    across.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sizes = components.sizes();
    for (_, (i, j)) in across {
        let [a, b] = [i, j].map(|k| components.root(k).0 as usize);
        if a != b && sizes[a].min(sizes[b]) < MIN_COMPONENT {
            sizes[a.min(b)] = sizes[a] + sizes[b];
            components.join(i, j, normals[i as usize].dot(&normals[j as usize]) < 0.0);
        }
    }
    let (labels, n_components) = components.labels();
    let mut sums = vec![(0.0, Vector3::zeros()); n_components];
    for (place, (component, _)) in along.iter().zip(&labels) {
        let (n, sum) = &mut sums[*component as usize];
        *n += 1.0;
        *sum += place;
    }
    let mut outward = vec![0.0; n_components];
    for ((place, normal), &(component, flipped)) in along.iter().zip(normals.iter()).zip(&labels) {
        let (n, sum) = &sums[component as usize];
        let out = normal.dot(&(place - sum / *n));
        outward[component as usize] += if flipped { -out } else { out };
    }
    for (normal, &(component, flipped)) in normals.iter_mut().zip(&labels) {
        if flipped != (outward[component as usize] < 0.0) {
            *normal = -*normal;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plane_normal;
    use super::*;
    use crate::joined::joined;
    use crate::nearest::Nearest;
    use crate::sample;
    use crate::shapes::{cuboid, shaft};
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
    fn each_closed_surface_has_outward_normals() {
        let far = cuboid([100.0, 0.0, 0.0], [130.0, 10.0, 10.0]);
        for (mesh, n) in [(shaft(), 40_000), (joined(&[cuboid([0.0; 3], [20.0; 3]), far]), 20_000)] {
            let drawn = drawn(&mesh, n);
            let normals = of_surface(&drawn.points).unwrap();
            let off = normals.iter().zip(&drawn.normals).filter(|(a, b)| a.dot(b) < 0.3).count();
            assert!(off * 500 < n, "{off} of {n} normals turned away, more than at corners");
            assert!(normals.iter().all(|n| (n.norm() - 1.0).abs() < 1e-9));
        }
    }

    #[test]
    fn they_are_as_exact_as_those_of_the_twenty_nearest_points() {
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
    fn the_number_of_threads_changes_no_bit() {
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
                let direction = least_direction(&matrix, LINE).unwrap();
                assert!(direction.dot(&exact).abs() > 1.0 - 1e-9, "{direction} {exact} {values:?}");
            }
        }
        assert_eq!(least_direction(&Matrix3::zeros(), LINE), None);
        assert_eq!(least_direction(&Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, 4.0)), LINE), None);
    }

    #[test]
    fn points_without_a_plane_are_refused() {
        let line: Vec<_> = (0..300).map(|i| Point3::new(f64::from(i), 2.0 * f64::from(i), 1e6)).collect();
        for points in [&line[..], &line[..2], &line[..1], &[Point3::origin(); 500]] {
            assert!(
                of_surface(points).is_err_and(|error| error.to_string().contains("there is no normal")),
                "{} points",
                points.len()
            );
        }
        assert_eq!(of_surface(&[]), Ok(Vec::new()));
        let mut wild = line;
        wild[5].z = f64::INFINITY;
        assert!(of_surface(&wild).unwrap_err().to_string().starts_with("point 5 is not finite"));
    }
}
