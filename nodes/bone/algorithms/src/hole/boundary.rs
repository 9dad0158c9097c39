use super::blobs::{areas, neighbours};
use super::depth_outliers::corrected;
use super::image::{Grid, seen};
use super::scene::{Scene, no_points, no_viewpoint};
use super::spot::{Missing, find};
use super::{Hole, HoleParams};
use crate::Refusal;
use crate::nearest::Nearest;
use nalgebra::{Isometry3, Matrix6, Point3, Vector6};
use osteoflow_geometry::Cloud;

/// A pixel is empty if the nearest point is farther than this many steps of a grid as dense as the scan: one pixel in a
/// hundred of a scan with randomly distributed points.
const EMPTY: f64 = 1.2;

/// Limit for pixels next to an empty one: half of the pixels of such a scan, so it must not connect a hole with the
/// background.
const OPEN: f64 = 0.6;

/// Number of pixels by which gaps are grown: the width that the stricter limit leaves at the rim.
const RIM: usize = 1;

/// Maximum radius of a gap, in spot radii: larger ones are background or shadow.
const MAX_GAP: f64 = 2.5;

/// Radius around the centre of a gap in which the surface is fitted, in spot radii...
const AROUND: f64 = 2.5;

/// ...and maximum difference in depth, in spot radii: beyond an edge lies another surface.
const DEPTH: f64 = 1.5;

/// Minimum number of points for a surface of six unknowns.
const MIN_AROUND: usize = 24;

/// The hole in one scan, without a reference: a gap in the camera's image that the scan encloses.
///
/// The scan is projected into its camera's image, where it is sampled evenly. An enclosed gap is filled with points as
/// dense as the scan's, on a quadratic surface fitted to the points around it; these replace the missing points of a
/// reference, and the search continues as in [`cloud_difference`](super::cloud_difference()). A spot at the silhouette
/// is not enclosed and not found, and any other loss as large as the spot is taken for it, so only a hole whose centre is
/// uncertain is of the second tier.
/// `O(n log n)`.
///
/// # Errors
/// [`Refusal`]: no hole, more than one, too sparse to resolve it, or a scan without a viewpoint.
///
/// # Source
/// Holes as closed loops of the boundary of a point set: Bendels, Schnabel and Klein 2006, whose angle criterion the
/// camera's image replaces.
pub fn boundary(cloud: &Cloud, params: &HoleParams) -> Result<Hole, Refusal> {
    let t_cloud_camera = cloud.viewpoint.ok_or_else(no_viewpoint)?;
    let points = corrected(cloud);
    let cloud = &Cloud::new(cloud.frame.clone(), points).map_err(|_| no_viewpoint())?.seen_from(t_cloud_camera);
    let fill = fill(cloud, &t_cloud_camera, params)?;
    let n_seen = cloud.len();
    let margin_mm = fill.margin_mm;
    let points: Vec<Point3<f64>> = cloud.points().iter().copied().chain(fill.points).collect();
    let indices = (n_seen..points.len()).collect();
    let reference = Cloud::new(cloud.frame.clone(), points).map_err(|_| no_viewpoint())?;
    find(&Scene::new(&reference, cloud, params)?, &Missing { indices, margin_mm, alone_is_enough: false }, params)
}

/// Points that fill the gaps.
struct Fill {
    points: Vec<Point3<f64>>,
    margin_mm: f64,
}

fn fill(cloud: &Cloud, t_cloud_camera: &Isometry3<f64>, params: &HoleParams) -> Result<Fill, Refusal> {
    let t_camera_cloud = t_cloud_camera.inverse();
    let in_camera: Vec<Point3<f64>> = cloud.points().iter().map(|p| t_camera_cloud * p).filter(|p| p.z > 0.0).collect();
    let flat: Vec<Point3<f64>> = in_camera.iter().filter_map(seen).collect();
    if flat.is_empty() {
        return Err(no_points("laser"));
    }
    let grid = Grid::over(&flat).ok_or_else(no_viewpoint)?;
    let tree = Nearest::new(&flat);
    // As dense as the scan.
    let step = grid.cell * (grid.n_filled() as f64 / flat.len() as f64).sqrt();
    let mut depths: Vec<f64> = in_camera.iter().map(|p| p.z).collect();
    let depth = crate::median::median(&mut depths);
    let radius = params.spot_radius_mm / depth;
    let empty =
        Empty::over(&grid, step, |place| tree.nearest(place).map_or(f64::INFINITY, |(_, square)| square.sqrt() / step));
    let mut points = Vec::new();
    for places in empty.gaps(std::f64::consts::PI * (MAX_GAP * radius / step).powi(2)) {
        let middle = crate::kabsch::centroid(&places);
        let around: Vec<Point3<f64>> =
            tree.within(&middle, AROUND * radius).into_iter().map(|(i, _)| in_camera[i]).collect();
        let Some(surface) = Surface::through(&around, &middle, radius, params.spot_radius_mm) else { continue };
        points.extend(places.iter().map(|place| {
            let z = surface.depth(place);
            t_cloud_camera * Point3::new(place.x * z, place.y * z, z)
        }));
    }
    Ok(Fill { points, margin_mm: OPEN * step * depth })
}

/// A regular grid of pixels, with the distance of each to the nearest point, in steps.
struct Empty {
    corner: [f64; 2],
    step: f64,
    size: [usize; 2],
    distance: Vec<f64>,
}

impl Empty {
    fn over(grid: &Grid, step: f64, distance: impl Fn(&Point3<f64>) -> f64) -> Self {
        let size = [0, 1].map(|k| (grid.size[k] as f64 * grid.cell / step).ceil() as usize + 1);
        let mut empty = Self { corner: grid.corner, step, size, distance: Vec::new() };
        empty.distance = (0..size[0] * size[1]).map(|i| distance(&empty.place(i))).collect();
        empty
    }

    fn place(&self, i: usize) -> Point3<f64> {
        let [x, y] = [i % self.size[0], i / self.size[0]].map(|k| k as f64 * self.step);
        Point3::new(self.corner[0] + x, self.corner[1] + y, 0.0)
    }

    /// The pixels of each connected gap that the scan encloses, if there are at most `most`.
    fn gaps(&self, most: f64) -> Vec<Vec<Point3<f64>>> {
        let is_enclosed = |gap: &Vec<usize>| gap.iter().all(|&i| neighbours(i, self.size).count() == 4);
        let mut gaps = areas(self.distance.iter().map(|d| *d > EMPTY).collect(), self.size);
        gaps.retain(|gap| gap.len() as f64 <= most && is_enclosed(gap));
        for gap in &mut gaps {
            for _ in 0..RIM {
                let beside = gap.iter().flat_map(|&i| neighbours(i, self.size));
                let rim: Vec<usize> = beside.filter(|&i| self.distance[i] > OPEN).collect();
                gap.extend(rim);
                gap.sort_unstable();
                gap.dedup();
            }
        }
        gaps.into_iter().map(|gap| gap.into_iter().map(|i| self.place(i)).collect()).collect()
    }
}

/// A quadratic fit of the depth around a point of the image.
struct Surface {
    middle: Point3<f64>,
    unit: f64,
    depth: Vector6<f64>,
}

impl Surface {
    fn through(around: &[Point3<f64>], middle: &Point3<f64>, radius: f64, radius_mm: f64) -> Option<Self> {
        let mut depths: Vec<f64> = around.iter().map(|p| p.z).collect();
        let usual = crate::median::median(&mut depths);
        let near: Vec<&Point3<f64>> = around.iter().filter(|p| (p.z - usual).abs() <= DEPTH * radius_mm).collect();
        if near.len() < MIN_AROUND {
            return None;
        }
        let mut surface = Self { middle: *middle, unit: radius, depth: Vector6::zeros() };
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for point in near {
            let row = surface.monomials(&seen(point)?);
            normal += row * row.transpose();
            right += row * point.z;
        }
        surface.depth = (normal + Matrix6::identity() * 1e-6).cholesky()?.solve(&right);
        Some(surface)
    }

    fn monomials(&self, at: &Point3<f64>) -> Vector6<f64> {
        let [x, y] = [0, 1].map(|k| (at[k] - self.middle[k]) / self.unit);
        Vector6::new(1.0, x, y, x * x, x * y, y * y)
    }

    fn depth(&self, at: &Point3<f64>) -> f64 {
        self.depth.dot(&self.monomials(at))
    }
}
