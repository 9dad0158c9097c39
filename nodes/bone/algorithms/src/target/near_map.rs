//! Nearest samples of a surface by a map of voxels: approximate, in a few nanoseconds.

use super::Target;
use crate::bvh::Aabb;
use crate::kabsch::centroid;
use nalgebra::{Point3, Vector3};

/// Maximum edge of a voxel, mm: within a third of a bone's radius the nearest samples of its points differ little. Surfaces of less
/// than 100 mm have as many along their longest side.
const VOXEL_MM: f64 = 2.0;
const N_ALONG: f64 = 50.0;

/// Margin around the surface, voxels: starts lie within it.
const MARGIN: f64 = 4.0;

/// About as many samples are mapped: a fibula has one in a millimetre.
const N_MAPPED: usize = 20_000;

/// Maximum number of voxels; larger surfaces get larger ones.
const MAX_VOXELS: f64 = 2e6;

const NONE: u32 = u32::MAX;

/// For each voxel around a surface a sample near its centre.
pub(crate) struct NearMap {
    origin: Vector3<f64>,
    centre: Point3<f64>,
    voxel_mm: f64,
    size: [usize; 3],
    nearest: Vec<u32>,
    samples: Vec<Sample>,
}

/// A sample of the surface, about the map's centre.
#[derive(Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) point: Vector3<f64>,
    /// Unit normal; zero where unknown.
    pub(crate) normal: Vector3<f64>,
}

impl NearMap {
    pub(crate) fn new(target: &Target) -> Self {
        let samples = Self::samples_of(target, N_MAPPED);
        let Aabb { min, max } = Aabb::of(samples.iter().map(|s| &s.point));
        let voxel_mm = VOXEL_MM.min((max - min).max() / N_ALONG).max(f64::MIN_POSITIVE);
        Self::of(samples, centroid(target.points()), voxel_mm, MARGIN * voxel_mm)
    }

    /// About `n` samples of the target, evenly through their order.
    pub(crate) fn samples_of(target: &Target, n: usize) -> Vec<Sample> {
        let centre = centroid(target.points());
        let every = target.points().len().div_ceil(n).max(1);
        (0..target.points().len())
            .step_by(every)
            .map(|i| Sample {
                point: target.points()[i] - centre,
                normal: target.normals().map_or_else(Vector3::zeros, |normals| normals[i]),
            })
            .collect()
    }

    /// The map of these samples, which are about `centre`, with voxels of at least `voxel_mm`.
    pub(crate) fn of(samples: Vec<Sample>, centre: Point3<f64>, voxel_mm: f64, margin_mm: f64) -> Self {
        let Aabb { min, max } = Aabb::of(samples.iter().map(|s| &s.point));
        let extent = (max - min).add_scalar(2.0 * margin_mm);
        let voxel_mm = voxel_mm.max((extent.product() / MAX_VOXELS).cbrt());
        let size: [usize; 3] = std::array::from_fn(|k| (extent[k] / voxel_mm).ceil() as usize + 1);
        let origin = min.add_scalar(-margin_mm);
        let mut map = Self { origin, centre, voxel_mm, size, nearest: vec![NONE; size.iter().product()], samples };
        map.spread();
        map
    }

    /// Gives each voxel the nearest of the samples that its neighbours have, from the surface outward.
    ///
    /// Source: Danielsson 1980, without his proof that errors stay below a voxel, which does not matter here.
    fn spread(&mut self) {
        let [_, ny, nz] = self.size;
        // Of each voxel's middle from its sample.
        let mut squares = vec![f64::INFINITY; self.nearest.len()];
        // Voxels with their places along the three axes.
        let mut front: Vec<(usize, [usize; 3])> = Vec::new();
        for item in 0..self.samples.len() {
            let Some(voxel) = self.voxel(&self.samples[item].point) else { continue };
            let at = [voxel / (ny * nz), voxel / nz % ny, voxel % nz];
            if self.offer(&mut squares, voxel, at, item as u32) {
                front.push((voxel, at));
            }
        }
        while !front.is_empty() {
            let mut next = Vec::new();
            for (voxel, at) in front {
                let item = self.nearest[voxel];
                for (neighbour, at) in self.neighbours(at) {
                    if self.offer(&mut squares, neighbour, at, item) {
                        next.push((neighbour, at));
                    }
                }
            }
            front = next;
        }
    }

    /// Gives a voxel a sample if it is nearer than the one it has; returns whether it had none.
    #[inline]
    fn offer(&mut self, squares: &mut [f64], voxel: usize, at: [usize; 3], item: u32) -> bool {
        let square = (self.samples[item as usize].point - self.middle_at(at)).norm_squared();
        let is_new = self.nearest[voxel] == NONE;
        if is_new || square < squares[voxel] {
            (self.nearest[voxel], squares[voxel]) = (item, square);
        }
        is_new
    }

    fn middle(&self, voxel: usize) -> Vector3<f64> {
        let [_, ny, nz] = self.size;
        self.middle_at([voxel / (ny * nz), voxel / nz % ny, voxel % nz])
    }

    #[inline]
    fn middle_at(&self, at: [usize; 3]) -> Vector3<f64> {
        self.origin + Vector3::from(at.map(|k| k as f64)).add_scalar(0.5) * self.voxel_mm
    }

    /// The voxels across the faces of the one at a place, with their places.
    fn neighbours(&self, [x, y, z]: [usize; 3]) -> impl Iterator<Item = (usize, [usize; 3])> + use<> {
        let [nx, ny, nz] = self.size;
        // Before the first one is beyond the last.
        let (after, before) = (|k: usize| k + 1, |k: usize| k.wrapping_sub(1));
        let all = [
            [after(x), y, z],
            [before(x), y, z],
            [x, after(y), z],
            [x, before(y), z],
            [x, y, after(z)],
            [x, y, before(z)],
        ];
        let is_inside = move |[x, y, z]: &[usize; 3]| *x < nx && *y < ny && *z < nz;
        all.into_iter().filter(is_inside).map(move |[x, y, z]| ((x * ny + y) * nz + z, [x, y, z]))
    }

    #[inline]
    fn voxel(&self, point: &Vector3<f64>) -> Option<usize> {
        let at = (point - self.origin) / self.voxel_mm;
        // A negative number becomes 0 or more only above -1, within the margin.
        if !(at.x >= 0.0 && at.y >= 0.0 && at.z >= 0.0) {
            return None;
        }
        let [x, y, z] = [at.x as usize, at.y as usize, at.z as usize];
        let [nx, ny, nz] = self.size;
        (x < nx && y < ny && z < nz).then_some((x * ny + y) * nz + z)
    }

    /// A sample near `point`, which is about [`NearMap::centre`]; `None` beyond the margin.
    #[inline]
    pub(crate) fn near(&self, point: &Vector3<f64>) -> Option<&Sample> {
        self.samples.get(self.nearest[self.voxel(point)?] as usize)
    }

    /// The corner of the first voxel, about the centre, the edge of a voxel, mm, and their numbers.
    pub(crate) fn grid(&self) -> (Vector3<f64>, f64, [usize; 3]) {
        (self.origin, self.voxel_mm, self.size)
    }

    /// Distance of a voxel's middle from its sample, mm.
    pub(crate) fn distance_mm(&self, voxel: usize) -> f64 {
        self.samples.get(self.nearest[voxel] as usize).map_or(f64::INFINITY, |s| (s.point - self.middle(voxel)).norm())
    }

    /// The centre that all positions are about.
    pub(crate) fn centre(&self) -> &Point3<f64> {
        &self.centre
    }

    /// The mapped samples.
    pub(crate) fn samples(&self) -> &[Sample] {
        &self.samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::SurfaceOrigin;

    fn map(points: Vec<Point3<f64>>, normals: Option<Vec<Vector3<f64>>>) -> NearMap {
        NearMap::new(&Target::new("ct", SurfaceOrigin::Exact, points, normals.map(Into::into)).unwrap())
    }

    #[test]
    fn each_voxel_has_a_sample_nearly_as_near_to_its_middle_as_the_nearest() {
        let samples: Vec<Sample> = (0..900_u32)
            .map(|k| {
                let (turn, z) = (f64::from(k) * 2.4, f64::from(k) * 0.05);
                let point = Vector3::new(6.0 * turn.cos() + 100.0, 9.0 * turn.sin(), z);
                Sample { point, normal: Vector3::zeros() }
            })
            .collect();
        let map = NearMap::of(samples, Point3::origin(), 2.0, 8.0);
        // 8 mm more on each side, in voxels of 2 mm, and one more.
        assert_eq!((map.size, map.voxel_mm), ([15, 18, 32], 2.0));
        let (mut worst, mut n_exact) = (0.0_f64, 0);
        for voxel in 0..map.nearest.len() {
            let middle = map.middle(voxel);
            assert_eq!(map.voxel(&middle), Some(voxel));
            let distance = |s: &Sample| (s.point - middle).norm();
            let least = map.samples.iter().map(distance).fold(f64::INFINITY, f64::min);
            let result = distance(map.near(&middle).unwrap());
            worst = worst.max(result - least);
            n_exact += usize::from(result == least);
        }
        // What a neighbour does not have is not offered; Danielsson's error is below a voxel.
        assert!(worst < 2.0, "{worst} mm");
        assert_eq!((n_exact, map.nearest.len()), (5030, 8640), "exact ones of all");
        let corner = map.origin + Vector3::from(map.size.map(|n| n as f64)) * 2.0;
        let inside = Vector3::repeat(1e-6);
        assert_eq!(map.voxel(&map.origin), Some(0));
        assert_eq!(map.voxel(&(corner - inside)), Some(map.nearest.len() - 1));
        for axis in 0..3 {
            let mut outside = [map.origin + inside, corner - inside];
            outside[0][axis] -= 0.5;
            outside[1][axis] += 0.5;
            assert!(outside.iter().all(|p| map.voxel(p).is_none() && map.near(p).is_none()), "axis {axis}");
        }
    }

    #[test]
    fn the_neighbours_of_a_voxel_are_those_across_its_six_faces() {
        let at = |x: f64, z: f64| Sample { point: Vector3::new(x, 0.0, z), normal: Vector3::zeros() };
        let map = NearMap::of(vec![at(0.0, 0.0), at(4.0, 8.0)], Point3::origin(), 2.0, 8.0);
        let [nx, ny, nz] = map.size;
        assert_eq!([nx, ny, nz], [11, 9, 13]);
        let at = |x: usize, y: usize, z: usize| (x * ny + y) * nz + z;
        let sorted = |voxel: usize| {
            let at = [voxel / (ny * nz), voxel / nz % ny, voxel % nz];
            let mut result: Vec<usize> = map.neighbours(at).map(|(voxel, _)| voxel).collect();
            result.sort_unstable();
            result
        };
        assert_eq!(sorted(at(5, 4, 6)), [at(4, 4, 6), at(5, 3, 6), at(5, 4, 5), at(5, 4, 7), at(5, 5, 6), at(6, 4, 6)]);
        assert_eq!(sorted(0), [at(0, 0, 1), at(0, 1, 0), at(1, 0, 0)]);
        assert_eq!(sorted(at(10, 8, 12)), [at(9, 8, 12), at(10, 7, 12), at(10, 8, 11)]);
    }

    #[test]
    fn many_samples_are_thinned_keep_their_normals_and_make_a_large_surface_coarse() {
        let points: Vec<Point3<f64>> = (0..40_001).map(|k| Point3::new(f64::from(k) * 0.01, 300.0, -50.0)).collect();
        let normals = (0..40_001).map(|k| Vector3::new(f64::from(k), 0.0, 1.0)).collect();
        let map = map(points.clone(), Some(normals));
        assert_eq!(map.samples().len(), 13_334, "every third");
        let third = map.samples()[1];
        assert_eq!(third.normal, Vector3::new(3.0, 0.0, 1.0));
        assert!((third.point + map.centre().coords - points[3].coords).norm() < 1e-9);
        // 200 by 200 by 400 mm are two million voxels of 2 mm; eight times the volume makes them twice as wide.
        let edge = |x: f64, y: f64, z: f64| {
            let corners = [Point3::origin(), Point3::new(x - 16.0, y - 16.0, z - 16.0)];
            self::map(corners.to_vec(), None).grid().1
        };
        assert_eq!((edge(30.0, 30.0, 400.0), edge(66.0, 20.0, 30.0)), (2.0, 1.0));
        assert!((edge(400.0, 400.0, 800.0) - 4.0).abs() < 1e-9);
    }
}
