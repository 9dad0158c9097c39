//! A simulated CT: the bone's surface after scanning and thresholding.

use crate::draws::{Term, stream};
use crate::error::{SimulationError, check_rules};
use crate::ranges;
use crate::waves::Waves;
use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::iso_surface::{iso_surface, make_well_composed};
use osteoflow_algorithms::mesh_topology::{largest_component, open_edges, vertex_normals};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use osteoflow_node_macros::params;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The scanner and the segmentation.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CtParams {
    /// Edge of the cubic voxels. 0.7: a clinical CT of the leg.
    #[param(0.7, 0.2..=3.0)]
    pub voxel_mm: f64,
    /// Standard deviation of the scanner's point spread. 0.5: assumed, 1.2 mm full width at half maximum.
    #[param(0.5, 0.0..=3.0)]
    pub blur_mm: f64,
    /// Standard deviation of a voxel's noise. 50: assumed, a low-dose bone protocol.
    #[param(50.0, 0.0..=500.0)]
    pub noise_hu: f64,
    /// Correlation length of the noise, as a standard deviation. 0.5: assumed, as the blur.
    #[param(0.5, 0.0..=3.0)]
    pub noise_correlation_mm: f64,
    /// Soft tissue around the bone. 50: muscle.
    #[param(50.0, -1000.0..=500.0)]
    pub tissue_hu: f64,
    /// Bone, filled, as only its outer surface is extracted. 1250: cortical bone.
    #[param(1250.0, 200.0..=3000.0)]
    pub bone_hu: f64,
    /// Threshold of the segmentation. 650: half-way, where blur moves a flat wall least; a lower one swells the bone.
    #[param(650.0, -500.0..=2500.0)]
    pub threshold_hu: f64,
    /// Number of smoothing steps (Taubin's, which do not shrink). 0: off; programs often take 10 to 20.
    #[param(0, 0..=1000)]
    pub smoothing: u32,
    /// RMS of smooth bumps along the surface's normals, as of cartilage or a segmentation by hand. 0: off.
    #[param(0.0, 0.0..=3.0)]
    pub bumps_mm: f64,
    /// Their wavelength. 20: assumed, a few along a scan.
    #[param(20.0, 2.0..=500.0)]
    pub bumps_wavelength_mm: f64,
    /// Distance by which the surface is moved outward along its normals: too low a threshold; negative: too high a one. The
    /// plan stays. 0: off.
    #[param(0.0, -3.0..=3.0)]
    pub offset_mm: f64,
    /// Seed of the grid's position, the noise and the bumps. None: the run's seed; a number keeps one CT in many procedures.
    pub scan_seed: Option<u64>,
}

impl CtParams {
    /// As [`crate::ProcedureParams::check`].
    ///
    /// # Errors
    /// [`SimulationError::Parameter`] of the first that is refused.
    pub fn check(&self) -> Result<(), SimulationError> {
        ranges::check("ct", self)?;
        check_rules([
            ("ct.bone_hu", self.bone_hu, self.bone_hu > self.tissue_hu, "above tissue_hu"),
            (
                "ct.threshold_hu",
                self.threshold_hu,
                self.tissue_hu < self.threshold_hu && self.threshold_hu < self.bone_hu,
                "between tissue_hu and bone_hu",
            ),
        ])
    }
}

/// A regular grid of voxels, x fastest.
#[derive(Debug, Clone, PartialEq)]
struct Grid {
    /// Centre of the first voxel, mm.
    origin: Point3<f64>,
    spacing_mm: f64,
    size: [usize; 3],
}

/// Maximum number of voxels: a whole leg at 0.3 mm; more is a mistake in the unit.
const MAX_VOXELS: u64 = 64_000_000;

/// The bone's outer surface as a CT shows it: voxels, blur, noise, threshold, iso-surface (surface nets); only the
/// largest connected piece. In the frame of `bone`, origin [`SurfaceOrigin::SimulatedCt`].
///
/// The position of the grid is random (from `seed`), as in a scanner. Voxels hold the share of bone in them,
/// approximated by that of a plane at the surface's distance: exact for faces across an axis, off by a few hundredths
/// for slanted ones. `O(voxels)`; a fibula takes about a tenth of a second.
///
/// # Errors
/// [`SimulationError`] if the surface has open edges, the voxels do not suit the bone, or a parameter is out of range.
pub fn ct_surface(bone: &Mesh, params: &CtParams, seed: u64) -> Result<Mesh, SimulationError> {
    params.check()?;
    let seed = params.scan_seed.unwrap_or(seed);
    let rng = &mut stream(seed, Term::CtNoise, 0);
    match open_edges(bone) {
        0 => {}
        n_open_edges => return Err(SimulationError::not_closed(n_open_edges)),
    }
    let h = params.voxel_mm;
    let offset: [f64; 3] = std::array::from_fn(|_| rng.random());
    let noise_seed: u64 = rng.random();
    let margin = (3.0 * params.blur_mm / h).ceil() + 3.0;
    let first = bone.vertices()[0];
    let (min, max) = bone.vertices().iter().fold((first, first), |(min, max), v| (min.inf(v), max.sup(v)));
    let origin = min - Vector3::from(offset.map(|share| (margin + share) * h));
    let size: [usize; 3] = std::array::from_fn(|k| ((max[k] - origin[k]) / h + margin).ceil() as usize + 1);
    let n_voxels = size.iter().try_fold(1u64, |n, &s| n.checked_mul(s as u64)).unwrap_or(u64::MAX);
    if n_voxels > MAX_VOXELS {
        return Err(SimulationError::Unsuitable(format!(
            "the simulated CT would hold {n_voxels} voxels, at most {MAX_VOXELS} are allowed; take larger voxels"
        )));
    }
    let grid = Grid { origin, spacing_mm: h, size };

    let mut volume = share_of_bone(bone, &grid);
    blur(&mut volume, &grid, params.blur_mm / h);
    let contrast = params.bone_hu - params.tissue_hu;
    if params.noise_hu > 0.0 {
        let noise = noise(&grid, params.noise_correlation_mm / h, noise_seed);
        let scale = (params.noise_hu / contrast) as f32;
        volume.par_iter_mut().zip(noise.par_iter()).for_each(|(v, n)| *v += scale * n);
    }
    let level = ((params.threshold_hu - params.tissue_hu) / contrast) as f32;
    make_well_composed(&mut volume, size, level);
    let (vertices, faces) = iso_surface(&volume, size, level, |at| grid.origin + at * grid.spacing_mm);
    let (mut vertices, faces) = largest_component(vertices, &faces);
    if faces.is_empty() {
        return Err(SimulationError::Unsuitable(format!(
            "the simulated CT shows no bone; is a voxel of {h} mm too coarse for it?"
        )));
    }
    smooth(&mut vertices, &faces, params.smoothing);
    if params.bumps_mm > 0.0 || params.offset_mm != 0.0 {
        let waves = Waves::new(&mut stream(seed, Term::CtBumps, 0), params.bumps_wavelength_mm);
        let normals = vertex_normals(&vertices, &faces);
        for (vertex, normal) in vertices.iter_mut().zip(normals) {
            *vertex += normal * (params.offset_mm + waves.scaled(params.bumps_mm, vertex));
        }
    }
    Ok(Mesh::new(&bone.frame, SurfaceOrigin::SimulatedCt, vertices, faces)?)
}

/// Taubin smoothing: moves each vertex towards and away from the mean of its neighbours, `times` times.
///
/// # Source
/// Taubin 1995, "A signal processing approach to fair surface design", with uniform weights, 0.5 and -0.53.
fn smooth(vertices: &mut [Point3<f64>], faces: &[[u32; 3]], times: u32) {
    for step in [0.5, -0.53].repeat(times as usize) {
        // Each edge of a closed surface is in two faces, so each neighbour counts twice.
        let mut sums = vec![(Vector3::zeros(), 0.0); vertices.len()];
        for face in faces {
            let [a, b, c] = face.map(|v| vertices[v as usize].coords);
            for (v, others) in face.iter().zip([b + c, a + c, a + b]) {
                let sum = &mut sums[*v as usize];
                *sum = (sum.0 + others, sum.1 + 2.0);
            }
        }
        for (vertex, (sum, n)) in vertices.iter_mut().zip(sums) {
            *vertex += (sum / n - vertex.coords) * step;
        }
    }
}

/// Number of layers of voxels per task.
const SLAB: usize = 8;

/// The share of bone in each voxel: 1 inside, 0 outside, by the distance to the surface in voxels at the surface.
fn share_of_bone(bone: &Mesh, grid: &Grid) -> Vec<f32> {
    let [nx, ny, nz] = grid.size;
    let h = grid.spacing_mm;
    // In units of voxels from the first voxel's centre.
    let at: Vec<Vector3<f64>> = bone.vertices().iter().map(|v| (v - grid.origin) / h).collect();
    // Each slab gets the faces that come within a voxel of it.
    let mut faces_of: Vec<Vec<[u32; 3]>> = vec![Vec::new(); nz.div_ceil(SLAB)];
    for &face in bone.faces() {
        let z = face.map(|v| at[v as usize].z);
        let low = (z.iter().copied().fold(f64::MAX, f64::min) - 1.0).max(0.0) as usize / SLAB;
        let high =
            ((z.iter().copied().fold(f64::MIN, f64::max) + 1.0).max(0.0) as usize / SLAB).min(faces_of.len() - 1);
        for slab in &mut faces_of[low..=high] {
            slab.push(face);
        }
    }
    let mut volume = vec![0.0f32; nx * ny * nz];
    volume.par_chunks_mut(nx * ny * SLAB).zip(faces_of.par_iter()).enumerate().for_each(|(slab, (voxels, faces))| {
        let first = slab * SLAB;
        let layers = voxels.len() / (nx * ny);
        // Even-odd rule along rows in x through the voxels' centres.
        let mut crossings: Vec<(usize, f64)> = Vec::new();
        for face in faces {
            row_crossings(face, &at, [ny, first, layers], &mut crossings);
        }
        crossings.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        for pair in crossings.chunks_exact(2) {
            let (row, enter, leave) = (pair[0].0, pair[0].1, pair[1].1);
            let (from, to) = (enter.ceil().max(0.0) as usize, leave.ceil().max(0.0) as usize);
            voxels[row * nx..][from.min(nx)..to.min(nx)].fill(1.0);
        }
        let mut distance = vec![f32::MAX; voxels.len()];
        for face in faces {
            let corners = face.map(|v| at[v as usize]);
            let low = corners[0].inf(&corners[1]).inf(&corners[2]);
            let high = corners[0].sup(&corners[1]).sup(&corners[2]);
            let range = |k: usize, from: usize, n: usize| {
                let start = ((low[k] - 0.5).ceil().max(from as f64) as usize).max(from);
                start..((high[k] + 0.5).floor() + 1.0).max(0.0).min((from + n) as f64) as usize
            };
            for z in range(2, first, layers) {
                for y in range(1, 0, ny) {
                    for x in range(0, 0, nx) {
                        let centre = Vector3::new(x as f64, y as f64, z as f64);
                        let d = (centre - closest_on_triangle(&centre, &corners)).norm() as f32;
                        let here = &mut distance[((z - first) * ny + y) * nx + x];
                        *here = here.min(d);
                    }
                }
            }
        }
        for (voxel, d) in voxels.iter_mut().zip(distance) {
            if d < 0.5 {
                *voxel = if *voxel > 0.5 { 0.5 + d } else { 0.5 - d };
            }
        }
    });
    volume
}

/// Intersections of a face with the rows along x of layers `first..first + layers`, as (row within the slab, x).
///
/// Both faces at an edge use the same numbers, so a row neither slips between them nor meets both.
fn row_crossings(
    face: &[u32; 3],
    at: &[Vector3<f64>],
    [ny, first, layers]: [usize; 3],
    crossings: &mut Vec<(usize, f64)>,
) {
    let corners = face.map(|v| at[v as usize]);
    let [low_y, high_y, low_z, high_z] = corners.iter().fold([f64::MAX, f64::MIN, f64::MAX, f64::MIN], |b, c| {
        [b[0].min(c.y), b[1].max(c.y), b[2].min(c.z), b[3].max(c.z)]
    });
    let from_z = (low_z.ceil().max(first as f64) as usize).max(first);
    let to_z = (high_z.floor() + 1.0).clamp(first as f64, (first + layers) as f64) as usize;
    let (from_y, to_y) = (low_y.ceil().max(0.0) as usize, (high_y.floor() + 1.0).clamp(0.0, ny as f64) as usize);
    let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
    for z in from_z..to_z {
        for y in from_y..to_y {
            let (py, pz) = (y as f64, z as f64);
            let side = |k: usize| {
                let (mut a, mut b) = (face[k], face[(k + 1) % 3]);
                let turned = a > b;
                if turned {
                    (a, b) = (b, a);
                }
                let (a, b) = (at[a as usize], at[b as usize]);
                let cross = (b.y - a.y) * (pz - a.z) - (b.z - a.z) * (py - a.y);
                (cross >= 0.0) != turned
            };
            let sides = [side(0), side(1), side(2)];
            if (sides == [true; 3] || sides == [false; 3]) && normal.x != 0.0 {
                let x = corners[0].x - (normal.y * (py - corners[0].y) + normal.z * (pz - corners[0].z)) / normal.x;
                crossings.push(((z - first) * ny + y, x));
            }
        }
    }
}

/// The point of a triangle closest to `p`.
///
/// # Source
/// Ericson 2005, Real-Time Collision Detection, section 5.1.5: the regions of a triangle, one after the other.
fn closest_on_triangle(p: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]) -> Vector3<f64> {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    a + (ab * vb + ac * vc) / (va + vb + vc)
}

/// Gaussian noise of standard deviation 1, blurred over `sigma` voxels; every layer has its own random stream.
fn noise(grid: &Grid, sigma: f64, seed: u64) -> Vec<f32> {
    let [nx, ny, nz] = grid.size;
    let mut volume = vec![0.0f32; nx * ny * nz];
    volume.par_chunks_mut(nx * ny).enumerate().for_each(|(layer, voxels)| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(layer as u64);
        voxels.iter_mut().for_each(|v| *v = rng.sample(StandardNormal));
    });
    blur(&mut volume, grid, sigma);
    // Restores the standard deviation after the blur.
    let weights = kernel(sigma);
    let kept: f32 = weights.iter().map(|w| w * w).sum();
    let gain = kept.powf(-1.5);
    volume.par_iter_mut().for_each(|v| *v *= gain);
    volume
}

/// A Gaussian kernel of `sigma` voxels, truncated at three standard deviations, of sum 1.
fn kernel(sigma: f64) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil() as i64;
    if reach == 0 {
        return vec![1.0];
    }
    let weights: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|w| (w / sum) as f32).collect()
}

/// Blurs along x, y and z in turn, with 0 beyond the border.
fn blur(volume: &mut Vec<f32>, grid: &Grid, sigma: f64) {
    let weights = kernel(sigma);
    let reach = weights.len() / 2;
    if reach == 0 {
        return;
    }
    let [nx, ny, nz] = grid.size;
    let source = std::mem::take(volume);
    // Along x and y within each layer.
    let mut flat = vec![0.0f32; source.len()];
    flat.par_chunks_mut(nx * ny).zip(source.par_chunks(nx * ny)).for_each(|(out, layer)| {
        let mut along_x = vec![0.0f32; nx * ny];
        let mut padded = vec![0.0f32; nx + 2 * reach];
        for (row_out, row) in along_x.chunks_exact_mut(nx).zip(layer.chunks_exact(nx)) {
            padded[reach..reach + nx].copy_from_slice(row);
            for (k, w) in weights.iter().enumerate() {
                row_out.iter_mut().zip(&padded[k..]).for_each(|(o, v)| *o += w * v);
            }
        }
        for y in 0..ny {
            for (k, w) in weights.iter().enumerate() {
                let Some(from) = (y + k).checked_sub(reach).filter(|&from| from < ny) else { continue };
                let (row_out, row) = (&mut out[y * nx..(y + 1) * nx], &along_x[from * nx..(from + 1) * nx]);
                row_out.iter_mut().zip(row).for_each(|(o, v)| *o += w * v);
            }
        }
    });
    let mut blurred = source;
    blurred.par_chunks_mut(nx * ny).enumerate().for_each(|(z, out)| {
        out.fill(0.0);
        for (k, w) in weights.iter().enumerate() {
            let Some(from) = (z + k).checked_sub(reach).filter(|&from| from < nz) else { continue };
            out.iter_mut().zip(&flat[from * nx * ny..(from + 1) * nx * ny]).for_each(|(o, v)| *o += w * v);
        }
    });
    *volume = blurred;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assert_closed_and_outward;
    use crate::bone::{BoneParams, fibula};
    use nalgebra::Point3;
    use osteoflow_algorithms::mesh_query::MeshQuery;

    /// Signed distances of the CT's vertices from the bone, positive outside, mm.
    fn off_surface(bone: &Mesh, ct: &Mesh) -> Vec<f64> {
        let surface = MeshQuery::new(bone);
        ct.vertices()
            .iter()
            .map(|v| {
                let on = surface.closest_point(v).unwrap();
                on.distance_mm * (v - on.point).dot(&on.normal).signum()
            })
            .collect()
    }

    fn mean_and_rms(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        (values.iter().sum::<f64>() / n, (values.iter().map(|v| v * v).sum::<f64>() / n).sqrt())
    }

    #[test]
    fn the_ct_surface_is_closed_and_near_the_bone_but_not_on_it() {
        let bone = fibula(&BoneParams::default());
        let ct = ct_surface(&bone, &CtParams::default(), 1).unwrap();
        assert_closed_and_outward(&ct);
        assert_eq!((ct.origin, &ct.frame), (SurfaceOrigin::SimulatedCt, &bone.frame));
        let off = off_surface(&bone, &ct);
        let (mean, rms) = mean_and_rms(&off);
        println!("mean {mean:.3} mm, RMS {rms:.3} mm off the bone");
        // Blur of 0.5 mm moves a wall of radius 6 mm inward by sigma^2 / 2R = 0.02 mm, ridges more.
        assert!((-0.08..0.0).contains(&mean), "mean {mean} mm");
        assert!((0.02..0.12).contains(&rms), "RMS {rms} mm");
        let worst = off.iter().fold(0.0f64, |w, d| w.max(d.abs()));
        assert!(worst < 0.6, "worst {worst} mm");
    }

    #[test]
    fn without_blur_and_noise_only_the_voxels_remain() {
        let bone = fibula(&BoneParams::default());
        let params = CtParams { voxel_mm: 0.3, blur_mm: 0.0, noise_hu: 0.0, ..CtParams::default() };
        let ct = ct_surface(&bone, &params, 1).unwrap();
        let (mean, rms) = mean_and_rms(&off_surface(&bone, &ct));
        assert!(mean.abs() < 0.01 && rms < 0.02, "mean {mean} mm, RMS {rms} mm with voxels of 0.3 mm");
    }

    #[test]
    fn a_lower_threshold_swells_the_bone_according_to_the_blur() {
        let bone = fibula(&BoneParams::default());
        let at = |threshold_hu: f64| {
            let params = CtParams { blur_mm: 0.8, noise_hu: 0.0, threshold_hu, ..CtParams::default() };
            mean_and_rms(&off_surface(&bone, &ct_surface(&bone, &params, 1).unwrap())).0
        };
        // 290 HU is 20 % of the way: a flat edge blurred by 0.8 mm, and by the voxel's own 0.7 / sqrt(12), passes it
        // 0.8416 standard deviations outside.
        let expected = 0.8416 * 0.8f64.hypot(0.7 / 12f64.sqrt());
        let swelling = at(290.0) - at(650.0);
        assert!((swelling - expected).abs() < 0.05, "{swelling} mm, not {expected} mm");
    }

    #[test]
    fn noise_has_the_requested_strength_and_the_position_of_the_grid_is_random() {
        let grid = Grid { origin: Point3::origin(), spacing_mm: 0.7, size: [60, 60, 60] };
        for sigma in [0.0, 0.7, 1.5] {
            let volume = noise(&grid, sigma, 3);
            // Away from the border, where fewer voxels are averaged.
            let inner: Vec<f64> = (10..50)
                .flat_map(|z| (10..50).flat_map(move |y| (10..50).map(move |x| (z * 60 + y) * 60 + x)))
                .map(|i| f64::from(volume[i]))
                .collect();
            let (_, rms) = mean_and_rms(&inner);
            assert!((rms - 1.0).abs() < 0.06, "{rms} for sigma {sigma}");
        }
        let bone = fibula(&BoneParams { edge_mm: 2.0, ..BoneParams::default() });
        let [one, again, other] = [1, 1, 2].map(|seed| ct_surface(&bone, &CtParams::default(), seed).unwrap());
        assert_eq!(one, again);
        assert_ne!(one, other);
    }

    #[test]
    fn bones_and_parameters_without_a_ct_are_refused_with_the_reason() {
        let bone = fibula(&BoneParams { edge_mm: 3.0, ..BoneParams::default() });
        let open = Mesh::new("ct", SurfaceOrigin::User, bone.vertices().to_vec(), bone.faces()[1..].to_vec()).unwrap();
        let refused = |bone: &Mesh, params: &CtParams, reason: &str| {
            let error = ct_surface(bone, params, 1).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        };
        refused(&open, &CtParams::default(), "3 edges of the bone's surface are open");
        let large = fibula(&BoneParams { edge_mm: 3.0, length_mm: 450.0, girth: 1.6, ..BoneParams::default() });
        let fine = CtParams { voxel_mm: 0.2, ..CtParams::default() };
        refused(&large, &fine, "voxels, at most");
        let blurred =
            CtParams { voxel_mm: 3.0, blur_mm: 3.0, noise_hu: 0.0, threshold_hu: 1249.9, ..CtParams::default() };
        refused(&bone, &blurred, "the simulated CT shows no bone");
        let absurd = CtParams { threshold_hu: 5000.0, ..CtParams::default() };
        refused(&bone, &absurd, "ct.threshold_hu is 5000, but must be");
    }
}
