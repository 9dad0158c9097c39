//! The surface of a bone in a CT: threshold, component, iso-surface.
//!
//! The surface lies where linear interpolation between voxels meets the threshold (surface nets, without smoothing). Where
//! the volume's border cuts the bone, a lid half a voxel beyond the last voxels closes the surface; its faces are marked, as
//! no bone ends there.
//!
//! ```
//! use nalgebra::{Matrix4, Vector3};
//! use osteoflow_algorithms::ct_surface::{CtSurfaceParams, VolumeView, ct_surface};
//! use osteoflow_algorithms::mesh_topology::open_edges;
//!
//! // A ball of 1000 HU and radius 8 mm, blurred over 2 mm, in voxels of 1 mm; the first voxel is at (-20, 0, 5).
//! let density = |k: usize| {
//!     let at = Vector3::new((k % 25) as f64, (k / 25 % 25) as f64, (k / 625) as f64) - Vector3::repeat(12.0);
//!     (1000.0 * ((8.0 - at.norm()) / 2.0 + 0.5).clamp(0.0, 1.0)) as f32
//! };
//! let voxels: Vec<f32> = (0..25 * 25 * 25).map(density).collect();
//! let t_lps_voxel = Matrix4::new_translation(&Vector3::new(-20.0, 0.0, 5.0));
//! let volume = VolumeView { size: [25; 3], voxels: &voxels, t_lps_voxel: &t_lps_voxel };
//! let surface = ct_surface(&volume, &CtSurfaceParams::at(500.0))?;
//! let mesh = surface.open_mesh("ct")?;
//! assert_eq!(open_edges(&mesh), 0);
//! let centre = nalgebra::Point3::new(-8.0, 12.0, 17.0);
//! assert!(mesh.vertices().iter().all(|v| ((v - centre).norm() - 8.0).abs() < 0.1));
//! // 50 HU are a tenth of a millimetre on this edge.
//! assert!((surface.shift_mm_per_50 - 0.1).abs() < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod regions;
#[cfg(test)]
mod tests;
mod threshold;

pub use threshold::suggested_threshold;

use crate::Refusal;
use crate::iso_surface::{compacted, iso_surface, make_well_composed};
use nalgebra::{Matrix3, Matrix4, Point3, Vector3};
use osteoflow_geometry::{Frame, Mesh, SurfaceOrigin};
use rayon::prelude::*;
use regions::{Neighbours, Region, regions};
use serde::{Deserialize, Serialize};

/// Layers of voxels around the component: the surface must not meet the border of what is searched.
const MARGIN: usize = 3;

/// Number of components that are listed.
pub const MAX_LISTED: usize = 20;

/// Voxels and where they are.
#[derive(Debug, Clone, Copy)]
pub struct VolumeView<'a> {
    /// Number of voxels along x (fastest), y and z.
    pub size: [usize; 3],
    /// Their values, `x × y × z`, finite.
    pub voxels: &'a [f32],
    /// From a voxel's index (its centre) to LPS, mm. Any affine map: oblique, anisotropic, sheared, left-handed.
    pub t_lps_voxel: &'a Matrix4<f64>,
}

/// Which of the connected components above the threshold is the bone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ComponentChoice {
    /// The component of this rank by number of voxels: 1 is the largest.
    Rank(usize),
    /// The component at a point, LPS, mm.
    Seed(Point3<f64>),
    /// The component with the voxel nearest to a point, LPS, mm.
    Nearest(Point3<f64>),
}

/// Parameters of [`ct_surface()`].
#[derive(Debug, Clone, PartialEq)]
pub struct CtSurfaceParams {
    /// Bone is above, in the volume's values.
    pub threshold: f64,
    /// The component that is the bone.
    pub component: ComponentChoice,
    /// Whether spaces enclosed by the bone, such as its marrow, count as bone, so that only the outer surface is left.
    pub fill_cavities: bool,
}

impl CtSurfaceParams {
    /// The largest component above `threshold`, with cavities filled: a camera sees only the outside.
    pub fn at(threshold: f64) -> Self {
        Self { threshold, component: ComponentChoice::Rank(1), fill_cavities: true }
    }
}

/// A connected part of the voxels above the threshold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Component {
    /// Rank by number of voxels, from 1.
    pub rank: usize,
    /// Number of voxels.
    pub n_voxels: u64,
    /// Their volume, mm³.
    pub volume_mm3: f64,
    /// Lowest coordinates of its voxels' centres, or of the box of voxels around them if that is oblique, LPS, mm.
    pub min_mm: [f64; 3],
    /// Highest coordinates, LPS, mm.
    pub max_mm: [f64; 3],
    /// Mean of its voxels' centres, LPS, mm.
    pub centre_mm: [f64; 3],
    /// Whether the volume's border cuts it.
    pub is_cut_by_border: bool,
}

/// The surface of a bone in a CT.
#[derive(Debug, Clone, PartialEq)]
pub struct CtSurface {
    /// Vertices, LPS, mm.
    pub vertices: Vec<Point3<f64>>,
    /// Faces, counter-clockwise seen from outside; a closed surface.
    pub faces: Vec<[u32; 3]>,
    /// For each vertex whether a voxel beyond the volume's border placed it.
    pub vertex_is_on_border: Vec<bool>,
    /// For each face whether one of its vertices is on the border: the lid and the half voxel beside it, no bone.
    pub face_is_on_border: Vec<bool>,
    /// Number of components above the threshold.
    pub n_components: usize,
    /// The largest of them, at most [`MAX_LISTED`], by rank.
    pub components: Vec<Component>,
    /// The one taken.
    pub chosen: Component,
    /// Number of voxels raised above the threshold, as regions that touch only at an edge or a corner have no proper
    /// surface between them.
    pub n_raised: usize,
    /// Number of enclosed spaces that were filled.
    pub n_filled: usize,
    /// Their volume, mm³.
    pub filled_mm3: f64,
    /// How far the surface moves if the threshold moves by 50: the median over vertices of 50 by the gradient there, mm.
    /// Infinite without a gradient.
    pub shift_mm_per_50: f64,
    /// The 95th percentile of that, mm.
    pub shift_p95_mm_per_50: f64,
}

fn too_large() -> Refusal {
    Refusal::of("the volume is too large or too noisy at this threshold; crop it to the bone")
}

fn span(min: &[f64; 3], max: &[f64; 3]) -> String {
    let axis = |k: usize| format!("{} {:.1} to {:.1}", ["x", "y", "z"][k], min[k], max[k]);
    format!("{}, {}, {} mm", axis(0), axis(1), axis(2))
}

/// The surface of one component of a volume above a threshold, in LPS, mm. Voxels that share a face, an edge or a corner
/// belong together. `O(voxels)`.
///
/// Vertices are placed by linear interpolation between voxels, with no smoothing. Only the box around the component is
/// searched for the surface; other components do not change it. Enclosed spaces are those that do not meet the border, or
/// meet it on one side or two opposite ones, as a marrow canal that is cut does.
///
/// # Errors
/// [`Refusal`] if nothing or all is above the threshold, the choice names no component, or the volume is no volume.
pub fn ct_surface(volume: &VolumeView<'_>, params: &CtSurfaceParams) -> Result<CtSurface, Refusal> {
    let VolumeView { size, voxels, t_lps_voxel } = *volume;
    let n = size.iter().try_fold(1usize, |n, s| n.checked_mul(*s));
    if n != Some(voxels.len()) {
        let ([nx, ny, nz], n) = (size, voxels.len());
        return Err(Refusal::of(format!("{n} voxels were given for {nx} x {ny} x {nz}")));
    }
    if size.iter().any(|s| *s < 2) {
        let [nx, ny, nz] = size;
        return Err(Refusal::of(format!(
            "the volume has {nx} x {ny} x {nz} voxels; a surface needs two or more along each axis: give the whole series"
        )));
    }
    if size.iter().any(|s| *s > 1 << 30) || size[1].checked_mul(size[2]).is_none_or(|n| n >= u32::MAX as usize) {
        return Err(too_large());
    }
    let linear: Matrix3<f64> = t_lps_voxel.fixed_view::<3, 3>(0, 0).into();
    let voxel_mm3 = linear.determinant().abs();
    let no_place = || Refusal::of("the matrix from voxels to millimetres is singular, or not finite");
    let inverse = linear.try_inverse().filter(|m| m.iter().all(|c| c.is_finite())).ok_or_else(no_place)?;
    if !t_lps_voxel.iter().all(|c| c.is_finite()) || voxel_mm3 == 0.0 {
        return Err(no_place());
    }
    let origin = Vector3::new(t_lps_voxel[(0, 3)], t_lps_voxel[(1, 3)], t_lps_voxel[(2, 3)]);
    let level = params.threshold as f32;

    let parts = regions(voxels, size, Neighbours::TwentySix, |v| v > level).ok_or_else(too_large)?;
    let extreme = |worse: fn(f32, f32) -> f32| f64::from(voxels.iter().copied().reduce(worse).unwrap_or_default());
    let threshold = params.threshold;
    if parts.regions.is_empty() {
        let highest = extreme(f32::max);
        return Err(Refusal::of(format!(
            "no voxel is above the threshold {threshold}; the highest value is {highest}: set a lower threshold"
        )));
    }
    if parts.regions[0].n_voxels == voxels.len() as u64 {
        let lowest = extreme(f32::min);
        return Err(Refusal::of(format!(
            "all voxels are above the threshold {threshold}; the lowest value is {lowest}: set a higher threshold"
        )));
    }
    let mut by_size: Vec<usize> = (0..parts.regions.len()).collect();
    // A stable sort: of equal ones, the one that comes first.
    by_size.sort_by_key(|r| std::cmp::Reverse(parts.regions[*r].n_voxels));
    let component = |place: usize| {
        let region = &parts.regions[by_size[place]];
        let (min_mm, max_mm) = bounds(region.low, region.high, &linear, &origin);
        let mean = Vector3::from(region.sums) / region.n_voxels as f64;
        Component {
            rank: place + 1,
            n_voxels: region.n_voxels,
            volume_mm3: region.n_voxels as f64 * voxel_mm3,
            min_mm,
            max_mm,
            centre_mm: (linear * mean + origin).into(),
            is_cut_by_border: (0..3).any(|k| region.low[k] == 0 || region.high[k] + 1 == size[k]),
        }
    };
    let place = match params.component {
        ComponentChoice::Rank(rank) if (1..=by_size.len()).contains(&rank) => rank - 1,
        ComponentChoice::Rank(rank) => {
            let n = by_size.len();
            return Err(Refusal::of(format!(
                "component {rank} was asked for, but {n} are above the threshold; take 1 to {n}"
            )));
        }
        ComponentChoice::Nearest(at) => {
            let voxel = |x: f64, run: &regions::Run| {
                let row = run.row as usize;
                linear * Vector3::new(x, (row % size[1]) as f64, (row / size[1]) as f64) + origin
            };
            let along = linear.column(0).into_owned();
            let distance = |run: &regions::Run| {
                let x = (at.coords - voxel(0.0, run)).dot(&along) / along.norm_squared();
                (voxel(x.clamp(f64::from(run.from), f64::from(run.to) - 1.0), run) - at.coords).norm_squared()
            };
            let nearest =
                (0..parts.runs.len()).min_by(|a, b| distance(&parts.runs[*a]).total_cmp(&distance(&parts.runs[*b])));
            let region = parts.labels[nearest.expect("there is a voxel above the threshold")] as usize;
            by_size.iter().position(|r| *r == region).expect("every region has its place")
        }
        ComponentChoice::Seed(seed) => {
            let at = inverse * (seed.coords - origin);
            let nearest: [f64; 3] = std::array::from_fn(|k| at[k].round());
            let place = format!("the seed ({:.1}, {:.1}, {:.1}) mm", seed.x, seed.y, seed.z);
            if !(0..3).all(|k| (0.0..size[k] as f64).contains(&nearest[k])) {
                let (min_mm, max_mm) = bounds([0; 3], size.map(|s| s - 1), &linear, &origin);
                let span = span(&min_mm, &max_mm);
                return Err(Refusal::of(format!("{place} is outside the volume, which spans {span}")));
            }
            let [x, y, z] = nearest.map(|c| c as usize);
            let row = (z * size[1] + y) as u32;
            // The last run that begins at or before the voxel.
            let after = parts.runs.partition_point(|run| (run.row, run.from) <= (row, x as u32));
            let run = after.checked_sub(1).filter(|r| parts.runs[*r].row == row && (x as u32) < parts.runs[*r].to);
            let Some(run) = run else {
                let value = f64::from(voxels[(z * size[1] + y) * size[0] + x]);
                return Err(Refusal::of(format!(
                    "the voxel at {place} is {value}, not above the threshold {threshold}; place the seed in the bone's cortex"
                )));
            };
            let region = parts.labels[run] as usize;
            by_size.iter().position(|r| *r == region).expect("every region has its place")
        }
    };

    let region = &parts.regions[by_size[place]];
    let mut crop = Crop::new(volume, region, level);
    for (run, _) in parts.runs.iter().zip(&parts.labels).filter(|(_, label)| **label as usize != by_size[place]) {
        crop.lower(run, size[1]);
    }
    let (n_filled, n_filled_voxels) =
        if params.fill_cavities { crop.fill_cavities(size).ok_or_else(too_large)? } else { (0, 0) };
    let n_raised = make_well_composed(&mut crop.voxels, crop.size, level);
    let (places, mut faces) = iso_surface(&crop.voxels, crop.size, level, Point3::from);
    if linear.determinant() < 0.0 {
        faces.par_iter_mut().for_each(|face| face.swap(1, 2));
    }
    let offset = Vector3::from(crop.first.map(|f| f as f64));
    // In pad cells, and only there, a vertex is beyond the centres of the outermost voxels.
    let is_beyond = |at: &Vector3<f64>| (0..3).any(|k| at[k] < 0.0 || at[k] > (size[k] - 1) as f64);
    let vertex_is_on_border: Vec<bool> = places.par_iter().map(|p| is_beyond(&(p.coords + offset))).collect();
    let face_is_on_border: Vec<bool> =
        faces.par_iter().map(|face| face.iter().any(|v| vertex_is_on_border[*v as usize])).collect();
    let vertices = places.par_iter().map(|p| Point3::from(linear * (p.coords + offset) + origin)).collect();

    // Gradients transform by the inverse's transpose.
    let to_mm = inverse.transpose();
    let mut shifts: Vec<f64> = places
        .par_iter()
        .zip(&vertex_is_on_border)
        .filter(|(_, is_on_border)| !**is_on_border)
        .map(|(p, _)| 50.0 / (to_mm * crop.gradient(&p.coords)).norm())
        .collect();
    shifts.sort_unstable_by(f64::total_cmp);
    let share = |share: f64| shifts.get((shifts.len() as f64 * share) as usize).copied();
    let only_border =
        || Refusal::of("all of the surface lies at the volume's border; is the threshold below the soft tissue?");
    let shift_mm_per_50 = share(0.5).ok_or_else(only_border)?;
    if face_is_on_border.iter().all(|on| *on) {
        return Err(only_border());
    }
    Ok(CtSurface {
        vertices,
        faces,
        vertex_is_on_border,
        face_is_on_border,
        n_components: by_size.len(),
        components: (0..by_size.len().min(MAX_LISTED)).map(component).collect(),
        chosen: component(place),
        n_raised,
        n_filled,
        filled_mm3: n_filled_voxels as f64 * voxel_mm3,
        shift_mm_per_50,
        shift_p95_mm_per_50: share(0.95).unwrap_or(shift_mm_per_50),
    })
}

impl CtSurface {
    /// The surface without the faces on the border: open where the volume's border cuts the bone, so that nothing is
    /// registered to, or judged by, a face that no bone has.
    ///
    /// # Errors
    /// [`Refusal`]; a vertex is not finite if coordinates overflow.
    pub fn open_mesh(&self, frame: impl Into<Frame>) -> Result<Mesh, Refusal> {
        let own = |&(_, on_border): &(&[u32; 3], &bool)| !on_border;
        let faces: Vec<[u32; 3]> =
            self.faces.iter().zip(&self.face_is_on_border).filter(own).map(|(f, _)| *f).collect();
        let (vertices, faces) = compacted(&self.vertices, faces);
        Mesh::new(frame, SurfaceOrigin::User, vertices, faces).map_err(Refusal::of)
    }

    /// Number of faces on the border.
    pub fn n_border_faces(&self) -> usize {
        self.face_is_on_border.iter().filter(|on| **on).count()
    }
}

/// The box around the voxels `low..=high`, LPS, mm.
fn bounds(low: [usize; 3], high: [usize; 3], linear: &Matrix3<f64>, origin: &Vector3<f64>) -> ([f64; 3], [f64; 3]) {
    let corners = (0..8).map(|c: usize| {
        let at: [f64; 3] = std::array::from_fn(|k| if c >> k & 1 == 0 { low[k] as f64 } else { high[k] as f64 });
        linear * Vector3::from(at) + origin
    });
    let start = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
    let (min, max) = corners.fold(start, |(min, max), p| (min.inf(&p), max.sup(&p)));
    (min.into(), max.into())
}

/// The voxels around one component, with [`MARGIN`] layers on each side, also beyond the volume's border.
struct Crop {
    voxels: Vec<f32>,
    size: [usize; 3],
    /// The volume's index of its first voxel.
    first: [isize; 3],
    level: f32,
}

impl Crop {
    /// Beyond the border, voxels above the level are mirrored at it, so that the lid is half a voxel beyond their centres.
    fn new(volume: &VolumeView<'_>, region: &Region, level: f32) -> Self {
        let [nx, ny, nz] = volume.size;
        let first: [isize; 3] = region.low.map(|l| l as isize - MARGIN as isize);
        let size: [usize; 3] = std::array::from_fn(|k| region.high[k] - region.low[k] + 1 + 2 * MARGIN);
        let clamped = |k: usize, at: usize, n: usize| (first[k] + at as isize).clamp(0, n as isize - 1) as usize;
        let is_beyond = |k: usize, at: usize, n: usize| !(0..n as isize).contains(&(first[k] + at as isize));
        let mirrored = |v: f32| if v > level { 2.0 * level - v } else { v };
        let mut voxels = vec![0.0f32; size.iter().product()];
        voxels.par_chunks_mut(size[0] * size[1]).enumerate().for_each(|(z, layer)| {
            for (y, out) in layer.chunks_exact_mut(size[0]).enumerate() {
                let start = (clamped(2, z, nz) * ny + clamped(1, y, ny)) * nx;
                let row = &volume.voxels[start..start + nx];
                let from = (-first[0]).max(0) as usize;
                let to = ((nx as isize - first[0]).max(0) as usize).min(size[0]);
                let source = (first[0] + from as isize) as usize;
                out[from..to].copy_from_slice(&row[source..source + (to - from)]);
                out[..from].fill(mirrored(row[0]));
                out[to..].fill(mirrored(row[nx - 1]));
                if is_beyond(1, y, ny) || is_beyond(2, z, nz) {
                    out.iter_mut().for_each(|v| *v = mirrored(*v));
                }
            }
        });
        Self { voxels, size, first, level }
    }

    /// Lowers a run of another component, and its images beyond the border, below the level.
    ///
    /// It is no neighbour of the component, so its voxels place no vertex of the surface.
    fn lower(&mut self, run: &regions::Run, ny: usize) {
        let (y, z) =
            ((run.row as usize % ny) as isize - self.first[1], (run.row as usize / ny) as isize - self.first[2]);
        let [nx, ny, nz] = self.size;
        if !(0..ny as isize).contains(&y) || !(0..nz as isize).contains(&z) {
            return;
        }
        let range = |x: u32| (x as isize - self.first[0]).clamp(0, nx as isize) as usize;
        let row = (z as usize * ny + y as usize) * nx;
        let below = self.level - 1.0 - self.level.abs() * 1e-3;
        self.voxels[row + range(run.from)..row + range(run.to)].fill(below);
    }

    /// Raises enclosed spaces above the level; returns their number and that of their voxels. `None` if there are too many.
    ///
    /// Outside is what reaches a side of the box that is not the volume's border, or two neighbouring sides of that border: a
    /// cut canal meets one side, or two opposite ones.
    fn fill_cavities(&mut self, volume_size: [usize; 3]) -> Option<(usize, u64)> {
        // The box within the volume: what is beyond the border would join a cut canal to the outside.
        let low: [usize; 3] = self.first.map(|f| (-f).max(0) as usize);
        let high: [usize; 3] =
            std::array::from_fn(|k| ((volume_size[k] as isize - self.first[k]) as usize).min(self.size[k]));
        let size: [usize; 3] = std::array::from_fn(|k| high[k] - low[k]);
        let [nx, ny, _] = self.size;
        let mut inner = vec![0.0f32; size.iter().product()];
        inner.par_chunks_mut(size[0] * size[1]).enumerate().for_each(|(z, layer)| {
            for (y, row) in layer.chunks_exact_mut(size[0]).enumerate() {
                let start = ((z + low[2]) * ny + y + low[1]) * nx + low[0];
                row.copy_from_slice(&self.voxels[start..start + size[0]]);
            }
        });
        let level = self.level;
        let parts = regions(&inner, size, Neighbours::Six, |v| v <= level)?;
        let is_cavity: Vec<bool> = parts
            .regions
            .iter()
            .map(|region| {
                let ends: [[bool; 2]; 3] = std::array::from_fn(|k| [region.low[k] == 0, region.high[k] + 1 == size[k]]);
                // Whether the box ends there because the volume does.
                let at_border: [[bool; 2]; 3] = std::array::from_fn(|k| {
                    [self.first[k] <= 0, self.first[k] + self.size[k] as isize >= volume_size[k] as isize]
                });
                let leaves = (0..3).any(|k| (0..2).any(|end| ends[k][end] && !at_border[k][end]));
                let n_axes = ends.iter().filter(|ends| ends[0] || ends[1]).count();
                !leaves && n_axes <= 1
            })
            .collect();
        let above = level + 1.0 + level.abs() * 1e-3;
        for (run, _) in parts.runs.iter().zip(&parts.labels).filter(|(_, label)| is_cavity[**label as usize]) {
            let (y, z) = (run.row as usize % size[1] + low[1], run.row as usize / size[1] + low[2]);
            let start = (z * ny + y) * nx + low[0];
            self.voxels[start + run.from as usize..start + run.to as usize].fill(above);
        }
        let filled = parts.regions.iter().zip(&is_cavity).filter(|(_, is)| **is);
        Some(filled.fold((0, 0), |(n, voxels), (region, _)| (n + 1, voxels + region.n_voxels)))
    }

    /// The gradient at a position in the box, per voxel: that of trilinear interpolation.
    fn gradient(&self, at: &Vector3<f64>) -> Vector3<f64> {
        let [nx, ny, _] = self.size;
        let cell: [usize; 3] = std::array::from_fn(|k| (at[k] as usize).min(self.size[k] - 2));
        let t: [f64; 3] = std::array::from_fn(|k| at[k] - cell[k] as f64);
        let mut gradient = Vector3::zeros();
        for c in 0..8usize {
            let corner: [usize; 3] = std::array::from_fn(|k| c >> k & 1);
            let index = ((cell[2] + corner[2]) * ny + cell[1] + corner[1]) * nx + cell[0] + corner[0];
            let value = f64::from(self.voxels[index]);
            for axis in 0..3 {
                let others: f64 =
                    (0..3).filter(|k| *k != axis).map(|k| if corner[k] == 1 { t[k] } else { 1.0 - t[k] }).product();
                gradient[axis] += if corner[axis] == 1 { value } else { -value } * others;
            }
        }
        gradient
    }
}
