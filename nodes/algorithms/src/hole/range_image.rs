use super::scene::{Scene, median};
use super::spot::{Missing, find};
use super::{Hole, HoleError, HoleParams};
use crate::nearest::Nearest;
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Cloud;

/// Side of a cell in spacings of the scan's points in the image: a cell within the scan then nearly always has a point.
const CELL: f64 = 1.3;

/// More cells than this are not laid out; the image is then spoilt by points next to the camera.
const MAX_CELLS: f64 = 16e6;

/// The hole in the image grid of the camera that took the scan with the laser.
///
/// Both scans are projected into that image, `x / z` and `y / z`, in cells that follow the spacing of the scan's points
/// there. A camera samples its image evenly, however slanted the surface, so cells serve everywhere alike. A reference
/// point is missing where its cell and most of the cells around it that the reference fills are empty. What follows is
/// as in [`cloud_difference`](super::cloud_difference()).
///
/// # Errors
/// [`HoleError`]: no hole, more than one, too sparse to resolve it, scans that do not lie on each other, or a laser scan
/// without a viewpoint.
pub fn range_image(reference: &Cloud, cloud: &Cloud, params: &HoleParams) -> Result<Hole, HoleError> {
    let t_camera_cloud = cloud.viewpoint.ok_or(HoleError::NoViewpoint)?.inverse();
    let scene = Scene::new(reference, cloud, params)?;
    let missing = missing(&scene, &t_camera_cloud).ok_or(HoleError::NoViewpoint)?;
    find(&scene, &missing, params)
}

/// Which cells the points of one scan fall into.
struct Image {
    corner: [f64; 2],
    cell: f64,
    size: [usize; 2],
    filled: Vec<bool>,
}

impl Image {
    fn place(&self, seen: &Point3<f64>) -> Option<[usize; 2]> {
        let [x, y] = [0, 1].map(|k| (seen[k] - self.corner[k]) / self.cell);
        let inside = x >= 0.0 && y >= 0.0 && (x as usize) < self.size[0] && (y as usize) < self.size[1];
        inside.then_some([x as usize, y as usize])
    }

    fn with(&self, points: &[Option<Point3<f64>>]) -> Image {
        let mut filled = vec![false; self.size[0] * self.size[1]];
        for [x, y] in points.iter().flatten().filter_map(|p| self.place(p)) {
            filled[y * self.size[0] + x] = true;
        }
        Image { filled, ..*self }
    }

    fn is_filled(&self, [x, y]: [usize; 2]) -> bool {
        self.filled[y * self.size[0] + x]
    }
}

/// `None` where the scan does not lie before the camera.
fn missing(scene: &Scene<'_>, t_camera_cloud: &Isometry3<f64>) -> Option<Missing> {
    let image = |p: &Point3<f64>| {
        let seen = t_camera_cloud * p;
        (seen.z > 0.0).then(|| Point3::new(seen.x / seen.z, seen.y / seen.z, 0.0))
    };
    let of_cloud: Vec<_> = scene.cloud.iter().map(image).collect();
    let of_reference: Vec<_> = scene.reference.iter().map(image).collect();
    let flat: Vec<Point3<f64>> = of_cloud.iter().flatten().copied().collect();
    let first = *flat.first()?;
    let tree = Nearest::new(&flat);
    let near = |p: &Point3<f64>| tree.nearest_n(p, 5).last().map_or(0.0, |(_, square)| square.sqrt());
    let step = median(&mut flat.iter().step_by(flat.len().div_ceil(1000)).map(near).collect::<Vec<_>>());
    let (min, max) = flat.iter().fold((first, first), |(min, max), p| (min.inf(p), max.sup(p)));
    let cell = CELL * step;
    let extent = [0, 1].map(|k| ((max[k] - min[k]) / cell).floor() + 1.0);
    if step <= 0.0 || extent[0] * extent[1] > MAX_CELLS {
        return None;
    }
    let empty = Image { corner: [min.x, min.y], cell, size: extent.map(|e| e as usize), filled: Vec::new() };
    let (laser, full) = (empty.with(&of_cloud), empty.with(&of_reference));
    let is_missing = |i: &usize| {
        let Some(place) = of_reference[*i].and_then(|p| empty.place(&p)) else { return false };
        !laser.is_filled(place) && mostly_empty(&laser, &full, place)
    };
    let indices: Vec<usize> = (0..scene.reference.len()).filter(is_missing).collect();
    let margin_mm = indices.iter().map(|&i| scene.spacing_mm(i)).sum::<f64>() / indices.len().max(1) as f64 / 2.0;
    Some(Missing { indices, margin_mm })
}

/// Whether more than half of the cells here and around that the reference fills are empty in the scan with the laser.
fn mostly_empty(laser: &Image, full: &Image, [x, y]: [usize; 2]) -> bool {
    let (mut n_full, mut n_empty) = (0, 0);
    for row in y.saturating_sub(1)..(y + 2).min(full.size[1]) {
        for column in x.saturating_sub(1)..(x + 2).min(full.size[0]) {
            if full.is_filled([column, row]) {
                n_full += 1;
                n_empty += i32::from(!laser.is_filled([column, row]));
            }
        }
    }
    2 * n_empty > n_full
}
