//! Starts of a scan of any shape: in any orientation, anywhere on the surface.

use super::descent::{Placed, Points, descended, distinct};
use crate::axes::directions;
use crate::downsample::thinned;
use crate::kabsch::centroid;
use crate::morton::order_by_index;
use crate::normals::without_side;
use crate::target::{NearMap, Sample, Target};
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Number of scan points, evenly through their order, of which some are taken.
const N_LOOKED_AT: usize = 100_000;

/// Number of scan points whose normals are estimated: their neighbourhoods are then as wide as the coarse steps need.
const N_PLANES: usize = 4000;
const N_PATCH_PLANES: usize = 600;

/// Number of samples of the surface.
const N_SAMPLES: usize = 20_000;

/// Number of points by which starts are compared, from the first comparison to the last.
const N_FIRST: usize = 16;
const N_SECOND: usize = 64;
const N_THIRD: usize = 128;

/// Number of scan points that are laid onto the surface, and of turns about their normals.
const N_ANCHORS: usize = 16;
const N_PATCH_ANCHORS: usize = 3;
const N_SPINS: usize = 24;

/// Number of directions, evenly over the sphere, that are tried for the normal of a scan that does not tell it, and every how many of
/// the surface's samples it is then laid on.
const N_DIRECTIONS: usize = 96;
const EVERY: usize = 4;

/// Maximum number of starts.
const MAX_STARTS: usize = 3_000_000;

/// Distance between samples of the surface that anchors are laid on, and the distance at which a point counts fully as off the
/// surface, as shares of the scan's radius.
const SPACING: f64 = 0.1;
const REACH: f64 = 0.15;

/// Voxels within that distance.
const VOXELS: f64 = 3.0;

/// Share of the starts that are compared by the second half of these points.
const SECOND_SHARE: f64 = 0.25;

/// Number of starts that are kept from step to step.
const KEPT: [usize; 4] = [20_000, 4000, 800, 200];

/// A scan about its centroid, thinned evenly in space, in an order of which any beginning is spread evenly.
pub(crate) struct Shape {
    points: Vec<Vector3<f64>>,
    /// Unit normals of either sign, towards the camera if it is known; zero where there is none. None of a scan of few points.
    normals: Option<Vec<Vector3<f64>>>,
    camera: Option<Vector3<f64>>,
    /// RMS distance of its points from the centroid, mm.
    pub(crate) radius_mm: f64,
}

impl Shape {
    pub(crate) fn new(points: &[Point3<f64>], middle: &Point3<f64>, camera: Option<Point3<f64>>) -> Self {
        Self::thinned(points, middle, camera, N_PLANES)
    }

    /// Of a patch, which needs fewer points.
    pub(super) fn of_patch(points: &[Point3<f64>], middle: &Point3<f64>, camera: Option<Point3<f64>>) -> Self {
        Self::thinned(points, middle, camera, N_PATCH_PLANES)
    }

    fn thinned(points: &[Point3<f64>], middle: &Point3<f64>, camera: Option<Point3<f64>>, n: usize) -> Self {
        let about: Vec<Vector3<f64>> = thinned(points, N_LOOKED_AT).iter().map(|p| p - middle).collect();
        let camera = camera.map(|camera| camera - middle);
        let points = spread(&about, n);
        let mut normals = without_side(&points);
        if let Some(camera) = camera {
            normals.iter_mut().zip(&points).filter(|(n, p)| n.dot(&(camera - *p)) < 0.0).for_each(|(n, _)| *n = -*n);
        }
        let radius_mm = radius_mm(&points);
        Self { points, normals: Some(normals), camera, radius_mm }
    }

    /// The shape without its normals: the planes through few points are none of a surface.
    pub(super) fn without_normals(self) -> Self {
        Self { normals: None, ..self }
    }

    /// Up to `n` points to lay on a surface, each with a direction to lay along its normal.
    fn anchors(&self, n: usize, signs: &[f64]) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let Some(normals) = &self.normals else {
            let nearest = self.points.iter().min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
            return nearest
                .into_iter()
                .flat_map(|p| directions(N_DIRECTIONS).map(|direction| (*p, direction)))
                .collect();
        };
        let told = self.points.iter().zip(normals).filter(|(_, normal)| **normal != Vector3::zeros()).take(n);
        told.flat_map(|(p, normal)| signs.iter().map(move |sign| (*p, normal * *sign))).collect()
    }

    fn first(&self, n: usize, camera: Option<Vector3<f64>>) -> Points {
        Points { points: self.points.iter().take(n).copied().collect(), camera }
    }
}

/// RMS distance of samples from the centre of their map, mm.
pub(super) fn radius_of(samples: &[Sample]) -> f64 {
    radius_mm(&samples.iter().map(|s| s.point).collect::<Vec<_>>())
}

/// RMS distance from the origin, mm.
fn radius_mm(points: &[Vector3<f64>]) -> f64 {
    (points.iter().map(Vector3::norm_squared).sum::<f64>() / points.len().max(1) as f64).sqrt()
}

/// About `n` of the points, one of each cell of a grid, in an order of which any beginning is spread evenly.
fn spread(points: &[Vector3<f64>], n: usize) -> Vec<Vector3<f64>> {
    let first = points.first().copied().unwrap_or_default();
    let (min, max) = points.iter().fold((first, first), |(a, b), p| (a.inf(p), b.sup(p)));
    let extent = (max - min).max().max(f64::MIN_POSITIVE);
    let cells = |cell_mm: f64| {
        let mut keyed: Vec<(u64, u32)> = points
            .iter()
            .zip(0..)
            .map(|(p, k)| {
                let at = (p - min) / cell_mm;
                ((at.x as u64) << 42 | (at.y as u64) << 21 | at.z as u64, k)
            })
            .collect();
        keyed.sort_unstable();
        keyed.dedup_by_key(|entry| entry.0);
        keyed
    };
    let mut cell_mm = extent / 40.0;
    let mut kept = cells(cell_mm);
    for _ in 0..4 {
        let share = kept.len() as f64 / n as f64;
        if (0.8..1.25).contains(&share) || (share < 1.0 && kept.len() == points.len()) {
            break;
        }
        cell_mm = (cell_mm * share.sqrt()).max(extent / 2e6);
        kept = cells(cell_mm);
    }
    let kept: Vec<Vector3<f64>> = kept.into_iter().map(|(_, k)| points[k as usize]).collect();
    let along = order_by_index(&kept);
    let bits = kept.len().next_power_of_two().trailing_zeros();
    let reversed = (0..1_usize << bits).map(|k| k.reverse_bits().checked_shr(usize::BITS - bits).unwrap_or(0));
    reversed.filter_map(|k| along.get(k)).map(|&k| kept[k as usize]).collect()
}

/// Two directions across a unit vector.
fn across(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let least = Vector3::ith(normal.iamin(), 1.0);
    let x = (least - normal * normal.dot(&least)).normalize();
    [x, normal.cross(&x)]
}

/// The squared distance from the surface about each voxel of a map, limited, as a number up to 255.
struct Field {
    origin: Vector3<f64>,
    voxels_per_mm: f64,
    size: [u32; 3],
    cost: Vec<u8>,
}

impl Field {
    fn new(map: &NearMap, reach_mm: f64) -> Self {
        let (origin, voxel_mm, size) = map.grid();
        let n: usize = size.iter().product();
        let cost = |voxel: usize| {
            let share = map.distance_mm(voxel) / reach_mm;
            (255.0 * (share * share).min(1.0)).round() as u8
        };
        Self { origin, voxels_per_mm: 1.0 / voxel_mm, size: size.map(|n| n as u32), cost: (0..n).map(cost).collect() }
    }

    /// At a position in voxels from the corner. Less than one voxel before it counts as within the first, which is as far off as any.
    #[inline]
    fn cost(&self, at: &Vector3<f32>) -> u8 {
        let [x, y, z] = [at.x as i32 as u32, at.y as i32 as u32, at.z as i32 as u32];
        let [nx, ny, nz] = self.size;
        if x < nx && y < ny && z < nz { self.cost[((x * ny + y) * nz + z) as usize] } else { 255 }
    }
}

/// A start as numbers: anchor and sign, sample, spin.
#[derive(Clone, Copy)]
struct Start {
    side: u16,
    spin: u16,
    sample: u32,
}

/// An anchor with its tangent frame, and the scan's points in it.
struct Side {
    anchor: Vector3<f64>,
    frame: Rotation3<f64>,
    /// In the tangent frame, in voxels.
    points: Vec<Vector3<f32>>,
}

/// A surface prepared for laying shapes of one size on it.
pub(super) struct Ground {
    map: NearMap,
    field: Field,
    places: Vec<Sample>,
    has_sides: bool,
    reach_mm: f64,
}

/// How many of the starts of a shape are looked at.
#[derive(Clone, Copy)]
pub(super) struct Effort {
    max_starts: usize,
    min_anchors: usize,
    max_anchors: usize,
    kept: [usize; 4],
}

impl Effort {
    /// That of a whole scan.
    pub(super) const WHOLE: Self = Self { max_starts: MAX_STARTS, min_anchors: 3, max_anchors: N_ANCHORS, kept: KEPT };

    /// That of one of `n` patches: all of them get twice that of a whole scan.
    pub(super) fn of_patch(n: usize) -> Self {
        let share = |all: usize| (2 * all).div_ceil(n.max(1));
        Self { max_starts: share(MAX_STARTS), min_anchors: 1, max_anchors: N_PATCH_ANCHORS, kept: KEPT.map(share) }
    }
}

impl Ground {
    /// For shapes of this radius; a scan wider than the surface has more in it.
    pub(super) fn new(target: &Target, radius_mm: f64) -> Self {
        let centre = centroid(target.points());
        let mut samples = NearMap::samples_of(target, N_SAMPLES);
        let has_sides = target.normals().is_some();
        if !has_sides {
            let points: Vec<Vector3<f64>> = samples.iter().map(|s| s.point).collect();
            samples.iter_mut().zip(without_side(&points)).for_each(|(s, normal)| s.normal = normal);
        }
        let points: Vec<Vector3<f64>> = samples.iter().map(|s| s.point).collect();
        let size_mm = radius_mm.min(self::radius_mm(&points));
        let reach_mm = REACH * size_mm;
        let map = NearMap::of(samples, centre, reach_mm / VOXELS, reach_mm);
        let field = Field::new(&map, reach_mm);
        let places = places(map.samples(), SPACING * size_mm);
        Self { map, field, places, has_sides, reach_mm }
    }

    /// Starts of a shape that lie well on the surface after a few steps on a coarse map, best first, and the number of those tried.
    pub(super) fn laid(&self, shape: &Shape, effort: &Effort) -> (Vec<Placed>, usize) {
        let Self { map, field, reach_mm, .. } = self;
        let reach_mm = *reach_mm;
        let every = if shape.normals.is_some() { 1 } else { EVERY };
        let places: Vec<&Sample> = self.places.iter().step_by(every).collect();
        let camera = shape.camera.filter(|_| self.has_sides);
        let signs: &[f64] = if camera.is_some() { &[1.0] } else { &[1.0, -1.0] };
        let n_anchors = effort.max_starts / (places.len() * N_SPINS * signs.len()).max(1);
        let n_anchors = n_anchors.clamp(effort.min_anchors, effort.max_anchors);
        let first: Vec<&Vector3<f64>> = shape.points.iter().take(N_FIRST).collect();
        let sides: Vec<Side> = shape
            .anchors(n_anchors, signs)
            .into_iter()
            .map(|(anchor, normal)| {
                let [x, y] = across(&normal);
                let frame = Rotation3::from_basis_unchecked(&[x, y, normal]);
                let points =
                    first.iter().map(|p| (frame.inverse() * (*p - anchor) * field.voxels_per_mm).cast()).collect();
                Side { anchor, frame, points }
            })
            .collect();
        let n_tried = sides.len() * places.len() * N_SPINS;
        let spin = |k: usize| (k as f64 / N_SPINS as f64 * TAU).sin_cos();
        let spins: Vec<(f32, f32)> = (0..N_SPINS).map(|k| (spin(k).0 as f32, spin(k).1 as f32)).collect();
        // Of each anchor on each sample only the spins that are better than their neighbours, so that one place does not take all starts.
        let scored: Vec<Vec<(u16, Start)>> = sides
            .par_iter()
            .enumerate()
            .map(|(number, side)| {
                let mut costs = vec![[0_u16; N_SPINS]; places.len()];
                let half = side.points.len() / 2;
                let add = |place: &Sample, points: &[Vector3<f32>], sums: &mut [u16; N_SPINS], limit: u16| {
                    let [x, y] = across(&place.normal);
                    let (x, y, z) = (x.cast::<f32>(), y.cast::<f32>(), place.normal.cast::<f32>());
                    let at = ((place.point - field.origin) * field.voxels_per_mm).cast::<f32>();
                    for ((sin, cos), sum) in spins.iter().zip(sums).filter(|(_, sum)| **sum <= limit) {
                        let (u, v) = (x * *cos + y * *sin, y * *cos - x * *sin);
                        for p in points {
                            *sum += u16::from(field.cost(&(at + u * p.x + v * p.y + z * p.z)));
                        }
                    }
                };
                for (place, sums) in places.iter().copied().zip(&mut costs) {
                    add(place, &side.points[..half], sums, u16::MAX);
                }
                let limit = quantile(costs.as_flattened(), SECOND_SHARE);
                let mut best = Vec::with_capacity(places.len());
                for ((place, index), sums) in places.iter().copied().zip(0..).zip(&mut costs) {
                    let before = *sums;
                    add(place, &side.points[half..], sums, limit);
                    let cost = |k: usize| if before[k] <= limit { sums[k] } else { u16::MAX };
                    for k in (0..N_SPINS).filter(|&k| before[k] <= limit) {
                        let beside = [cost((k + N_SPINS - 1) % N_SPINS), cost((k + 1) % N_SPINS)];
                        if sums[k] < beside[0] && sums[k] <= beside[1] {
                            best.push((sums[k], Start { side: number as u16, spin: k as u16, sample: index }));
                        }
                    }
                }
                best
            })
            .collect();
        let scored = lowest(scored.concat(), effort.kept[0]);
        let starts: Vec<Placed> = scored
            .iter()
            .map(|start| {
                let (side, place) = (&sides[usize::from(start.side)], places[start.sample as usize]);
                let ([x, y], (sin, cos)) = (across(&place.normal), spin(usize::from(start.spin)));
                let to = Rotation3::from_basis_unchecked(&[x * cos + y * sin, y * cos - x * sin, place.normal]);
                let turn = to * side.frame.inverse();
                let shift = place.point - turn * side.anchor;
                Placed::from_parts(shift.into(), UnitQuaternion::from_rotation_matrix(&turn))
            })
            .collect();
        let starts = agreeing(map, shape, camera.is_some(), &starts, reach_mm, effort.kept[1]);
        let same_mm = 0.5 * reach_mm;
        let [second, third] = [N_SECOND, N_THIRD].map(|n| shape.first(n, camera));
        let ends = descended(map, &second, &starts, reach_mm, 4);
        let ends = distinct(ends, &third, 4, same_mm, effort.kept[2]);
        let ends = descended(map, &third, &ends, 0.6 * reach_mm, 5);
        (distinct(ends, &third, 4, 0.6 * same_mm, effort.kept[3]), n_tried)
    }
}

/// The number that this share of the numbers is no larger than.
fn quantile(numbers: &[u16], share: f64) -> u16 {
    let mut counts = vec![0_usize; usize::from(u16::MAX) + 1];
    numbers.iter().for_each(|k| counts[usize::from(*k)] += 1);
    let wanted = (share * numbers.len() as f64) as usize;
    let mut sum = 0;
    let is_reached = |count: &usize| {
        sum += count;
        sum > wanted
    };
    counts.iter().position(is_reached).map_or(u16::MAX, |k| k as u16)
}

/// The starts with the lowest costs, in order of their numbers where costs are equal.
fn lowest(mut scored: Vec<(u16, Start)>, n: usize) -> Vec<Start> {
    scored.sort_by_key(|(cost, _)| *cost);
    scored.into_iter().take(n).map(|(_, start)| start).collect()
}

/// The starts at which most points lie on the surface with its normal, whatever its sign unless sides are known.
fn agreeing(map: &NearMap, shape: &Shape, has_sides: bool, starts: &[Placed], reach_mm: f64, n: usize) -> Vec<Placed> {
    let cost = |placed: &Placed| -> f64 {
        let one = |(k, p): (usize, &Vector3<f64>)| {
            let moved = placed.rotation * p + placed.translation.vector;
            let Some(sample) = map.near(&moved) else { return 1.0 };
            let share = (moved - sample.point).norm_squared() / (reach_mm * reach_mm);
            let Some(normals) = &shape.normals else { return share.min(1.0) };
            let cos = (placed.rotation * normals[k]).dot(&sample.normal);
            let cos = if has_sides { cos.max(0.0) } else { cos.abs() };
            (share + 1.0 - cos).min(1.0)
        };
        shape.points.iter().enumerate().take(N_SECOND).map(one).sum()
    };
    let mut scored: Vec<(f64, &Placed)> = starts.par_iter().map(|start| (cost(start), start)).collect();
    scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    scored.into_iter().take(n).map(|(_, start)| *start).collect()
}

/// Samples with normals at about this distance from each other.
fn places(samples: &[Sample], spacing_mm: f64) -> Vec<Sample> {
    let mut seen = std::collections::BTreeSet::new();
    let key = |p: &Vector3<f64>| -> [i64; 3] { std::array::from_fn(|k| (p[k] / spacing_mm).floor() as i64) };
    let is_new = |s: &&Sample| s.normal != Vector3::zeros() && seen.insert(key(&s.point));
    samples.iter().filter(is_new).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::SurfaceOrigin;

    #[test]
    fn directions_are_even_over_the_sphere() {
        let all: Vec<Vector3<f64>> = directions(N_DIRECTIONS).collect();
        let nearest = |d: &Vector3<f64>| all.iter().map(|other| other.angle(d)).fold(f64::MAX, f64::min);
        let farthest = [[1.0, 0.0, 0.0], [0.3, -0.8, 0.5], [0.0, 0.0, -1.0], [-0.6, 0.6, -0.5]];
        let widest = farthest.iter().map(|d| nearest(&Vector3::from(*d))).fold(0.0, f64::max);
        assert!(all.len() == N_DIRECTIONS && widest < 0.3, "{widest} rad");
    }

    #[test]
    fn any_beginning_of_thinned_points_is_spread_over_all() {
        let grid: Vec<Vector3<f64>> =
            (0..40_000).map(|k| Vector3::new(f64::from(k % 200), f64::from(k / 200), 0.0)).collect();
        let kept = spread(&grid, 1000);
        assert!((800..1250).contains(&kept.len()), "{}", kept.len());
        let mean = kept.iter().take(16).sum::<Vector3<f64>>() / 16.0;
        assert!((mean - Vector3::new(99.5, 99.5, 0.0)).amax() < 25.0, "{mean}");
        let quadrants: std::collections::BTreeSet<_> =
            kept.iter().take(8).map(|p| (p.x < 100.0, p.y < 100.0)).collect();
        assert_eq!(quadrants.len(), 4);
        assert_eq!(spread(&grid[..1], 1000), grid[..1]);
        assert_eq!(spread(&grid[..3], 1000).len(), 3);
        assert_eq!(spread(&[Vector3::x(); 9], 1000), [Vector3::x()]);
    }

    #[test]
    fn a_quantile_is_the_least_number_with_that_share_below_or_at_it() {
        assert_eq!([0.0, 0.24, 0.25, 0.5, 0.99, 1.0].map(|q| quantile(&[7, 1, 5, 3], q)), [1, 1, 3, 5, 7, u16::MAX]);
    }

    #[test]
    fn a_field_has_the_square_of_the_distance_up_to_the_reach() {
        let samples = vec![Sample { point: Vector3::zeros(), normal: Vector3::z() }];
        let map = NearMap::of(samples, Point3::origin(), 1.0, 6.0);
        let field = Field::new(&map, 5.0);
        let at = |x: f64| {
            let (origin, voxel_mm, _) = map.grid();
            field.cost(&((Vector3::new(x, 0.0, 0.0) - origin) / voxel_mm).cast())
        };
        // Middles of voxels are half a voxel off along each axis.
        let expected = |x: f64| (255.0 * (x * x + 0.5) / 25.0).round() as u8;
        assert_eq!([at(0.2), at(3.2), at(4.2)], [expected(0.5), expected(3.5), expected(4.5)]);
        assert_eq!([at(5.2), at(-5.8), at(50.0), at(-50.0)], [255; 4]);
    }

    #[test]
    fn a_patch_of_a_bumpy_body_is_laid_where_it_is_from_each_anchor_and_either_side() {
        let on = |k: u32| {
            let (z, turn) = (1.0 - (f64::from(k) + 0.5) / 6000.0, 2.399_963 * f64::from(k));
            let way = Vector3::new((1.0 - z * z).sqrt() * turn.cos(), (1.0 - z * z).sqrt() * turn.sin(), z);
            let bumps = (5.0 * way.x + 1.0).sin() + (4.0 * way.y).sin() + (6.0 * way.z + way.x).sin();
            Point3::from(way.component_mul(&Vector3::new(40.0, 55.0, 35.0)) * (1.0 + 0.05 * bumps))
        };
        let points: Vec<Point3<f64>> = (0..12_000).map(on).collect();
        let normals = crate::normals::of_surface(&points).unwrap();
        let way = Vector3::new(1.0, 0.4, 0.3).normalize();
        let patch: Vec<Point3<f64>> = points.iter().filter(|p| p.coords.dot(&way) > 12.0).copied().collect();
        let middle = centroid(&patch);
        let moved = nalgebra::Isometry3::new(Vector3::new(300.0, -20.0, 90.0), Vector3::new(0.4, -2.0, 1.0));
        let scan: Vec<Point3<f64>> = patch.iter().map(|p| moved * p).collect();
        let camera = moved * (middle + way * 400.0);
        for normals in [Some(normals.into()), None] {
            let target = Target::new("ct", SurfaceOrigin::Exact, points.clone(), normals).unwrap();
            for camera in [None, Some(camera)] {
                let shape = Shape::new(&scan, &(moved * middle), camera);
                let ground = Ground::new(&target, shape.radius_mm);
                let (starts, n_tried) = ground.laid(&shape, &Effort::WHOLE);
                let best =
                    super::super::motion(target.index().near_map(&target), &(moved * middle), &starts[0]) * moved;
                let off = patch.iter().step_by(50).map(|p| (best * p - p).norm()).fold(0.0, f64::max);
                // A tenth of the patch's radius: what comes after is fine.
                assert!(off < 4.0 && n_tried > 100_000, "{off:.1} mm of {n_tried} starts, camera {camera:?}");
            }
        }
    }
}
