//! Nearest samples of a surface by a map of voxels: approximate, in a few nanoseconds.

use crate::target::Target;
use nalgebra::{Point3, Vector3};

/// Edge of a voxel, mm: within a third of a bone's radius the nearest samples of its points differ little.
const VOXEL_MM: f64 = 2.0;

/// Margin around the surface, mm: starts lie within it.
const MARGIN_MM: f64 = 8.0;

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
        let centre = target.index().centre;
        let every = target.points().len().div_ceil(N_MAPPED).max(1);
        let samples: Vec<Sample> = (0..target.points().len())
            .step_by(every)
            .map(|i| Sample {
                point: target.points()[i] - centre,
                normal: target.normals().map_or_else(Vector3::zeros, |normals| normals[i]),
            })
            .collect();
        let first = samples[0].point;
        let (min, max) = samples.iter().fold((first, first), |(a, b), s| (a.inf(&s.point), b.sup(&s.point)));
        let extent = (max - min).add_scalar(2.0 * MARGIN_MM);
        let voxel_mm = VOXEL_MM.max((extent.product() / MAX_VOXELS).cbrt());
        let size: [usize; 3] = std::array::from_fn(|k| (extent[k] / voxel_mm).ceil() as usize + 1);
        let origin = min.add_scalar(-MARGIN_MM);
        let mut map = Self { origin, centre, voxel_mm, size, nearest: vec![NONE; size.iter().product()], samples };
        map.spread();
        map
    }

    /// Gives each voxel the nearest of the samples that its neighbours have, from the surface outward.
    ///
    /// Source: Danielsson 1980, without his proof that errors stay below a voxel, which does not matter here.
    fn spread(&mut self) {
        let mut front: Vec<usize> = Vec::new();
        for item in 0..self.samples.len() {
            let Some(voxel) = self.voxel(&self.samples[item].point) else { continue };
            if self.nearest[voxel] == NONE {
                front.push(voxel);
            }
            self.offer(voxel, item as u32);
        }
        while !front.is_empty() {
            let mut next = Vec::new();
            for voxel in front {
                let item = self.nearest[voxel];
                for neighbour in self.neighbours(voxel) {
                    let is_new = self.nearest[neighbour] == NONE;
                    self.offer(neighbour, item);
                    if is_new {
                        next.push(neighbour);
                    }
                }
            }
            front = next;
        }
    }

    fn offer(&mut self, voxel: usize, item: u32) {
        let middle = self.middle(voxel);
        let square = |item: u32| (self.samples[item as usize].point - middle).norm_squared();
        let known = self.nearest[voxel];
        if known == NONE || square(item) < square(known) {
            self.nearest[voxel] = item;
        }
    }

    fn middle(&self, voxel: usize) -> Vector3<f64> {
        let [_, ny, nz] = self.size;
        let at = Vector3::new((voxel / (ny * nz)) as f64, (voxel / nz % ny) as f64, (voxel % nz) as f64);
        self.origin + at.add_scalar(0.5) * self.voxel_mm
    }

    fn neighbours(&self, voxel: usize) -> impl Iterator<Item = usize> + use<> {
        let [nx, ny, nz] = self.size.map(|n| n as isize);
        let (x, y, z) = (voxel as isize / (ny * nz), voxel as isize / nz % ny, voxel as isize % nz);
        let steps = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)];
        steps.into_iter().filter_map(move |(dx, dy, dz)| {
            let (x, y, z) = (x + dx, y + dy, z + dz);
            let inside = (0..nx).contains(&x) && (0..ny).contains(&y) && (0..nz).contains(&z);
            inside.then_some(((x * ny + y) * nz + z) as usize)
        })
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

    /// The centre that all positions are about.
    pub(crate) fn centre(&self) -> &Point3<f64> {
        &self.centre
    }

    /// The mapped samples.
    pub(crate) fn samples(&self) -> &[Sample] {
        &self.samples
    }
}
