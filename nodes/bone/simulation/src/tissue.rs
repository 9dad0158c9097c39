//! Lumps of soft tissue on the stripped bone: a surface of its own, which the camera sees instead of the bone.

use crate::bone::smoothstep;
use crate::draws::{Term, stream};
use crate::plan::section_centre;
use crate::waves::Waves;
use crate::{SimulationError, TissueParams};
use nalgebra::{Point3, Unit, Vector3};
use osteoflow_algorithms::{mesh_query::MeshQuery, mesh_topology::vertex_normals};
use osteoflow_geometry::{Anatomy, Mesh};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Length over which a lump rises from the bone, mm: steep, as a cut through muscle.
const EDGE_MM: f64 = 1.0;
/// Variation of a lump's outline and of its top, as a share of radius and thickness (one standard deviation), and the
/// wavelength of the top's bumps, mm. Assumed.
const OUTLINE_SHARE: f64 = 0.12;
const BUMP_SHARE: f64 = 0.15;
const BUMP_WAVELENGTH_MM: f64 = 8.0;
/// Edge of the mesh's triangles, mm.
const MESH_EDGE_MM: f64 = 0.7;
/// Number of places tried before the share is taken to be out of reach.
const MAX_PLACES: usize = 300;

/// Where lumps may be: the visible bone, in its frame.
pub(crate) struct Site<'a> {
    pub(crate) bone: &'a MeshQuery,
    pub(crate) anatomy: &'a Anatomy,
    /// The stripped stretch, along the bone from the malleolus tip, mm.
    pub(crate) stretch_mm: [f64; 2],
    pub(crate) towards_camera: Vector3<f64>,
    /// One point for each pixel that sees the bone.
    pub(crate) seen: &'a [Point3<f64>],
    /// Places that stay bare, so that the laser can show them.
    pub(crate) marks: &'a [Point3<f64>],
    /// Radius around a mark that stays bare, mm.
    pub(crate) clear_mm: f64,
}

/// The lumps' surface in the frame of the bone; `None` if the share is 0. Deterministic.
///
/// Lumps are placed until they cover the share of the seen points; the last is shrunk to it. They stand off the bone
/// along its normals.
pub(crate) fn tissue(params: &TissueParams, site: &Site<'_>, seed: u64) -> Result<Option<MeshQuery>, SimulationError> {
    if params.share <= 0.0 || site.seen.is_empty() {
        return Ok(None);
    }
    let lumps = Lumps::placed(params, site, params.seed.unwrap_or(seed))?;
    let Some(mesh) = lumps.mesh(site) else { return Ok(None) };
    Ok(Some(MeshQuery::new(&mesh?)))
}

struct Lump {
    centre: Point3<f64>,
    radius_mm: f64,
    thickness_mm: f64,
}

/// Thickness of the tissue, a field on the bone.
struct Lumps<'a> {
    params: &'a TissueParams,
    site: &'a Site<'a>,
    lumps: Vec<Lump>,
    outline: Waves,
    bumps: Waves,
}

impl<'a> Lumps<'a> {
    fn placed(params: &'a TissueParams, site: &'a Site<'a>, seed: u64) -> Result<Self, SimulationError> {
        let surface = |k| stream(seed, Term::TissueSurface, k);
        let [smallest, largest] = params.patch_mm;
        let mut lumps = Self {
            params,
            site,
            lumps: Vec::new(),
            outline: Waves::new(&mut surface(0), (smallest + largest) / 4.0),
            bumps: Waves::new(&mut surface(1), BUMP_WAVELENGTH_MM),
        };
        let rng = &mut stream(seed, Term::TissueLumps, 0);
        for _ in 0..MAX_PLACES {
            let Some(lump) = lumps.draw(rng) else { continue };
            let bare = lumps.covered();
            lumps.lumps.push(lump);
            let covered = lumps.covered();
            if covered >= params.share {
                lumps.shrink_last();
                return Ok(lumps);
            }
            // One on another, on a mark or out of sight.
            if covered <= bare {
                lumps.lumps.pop();
            }
        }
        let expected = "a share that can be covered without the marks; take a smaller one";
        Err(SimulationError::parameter("tissue.share", params.share, expected))
    }

    /// A lump of random place and size on the side of the camera; `None` beside the bone.
    fn draw(&self, rng: &mut ChaCha8Rng) -> Option<Lump> {
        let Site { bone, anatomy, stretch_mm: [from, to], towards_camera, .. } = *self.site;
        let mut between = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
        let height_mm = between(from, to);
        let turn = between(-1.2, 1.2);
        let radius_mm = between(self.params.patch_mm[0], self.params.patch_mm[1]) / 2.0;
        let thickness_mm = between(self.params.thickness_mm[0], self.params.thickness_mm[1]);
        let around = anatomy.proximal.cross(&towards_camera);
        let out = Unit::try_new(towards_camera * turn.cos() + around * turn.sin(), 1e-6)?;
        // From outside, so that the wall of the marrow cavity is never hit.
        const OUTSIDE_MM: f64 = 60.0;
        let from = section_centre(bone.mesh(), anatomy, height_mm).ok()? + out.into_inner() * OUTSIDE_MM;
        let centre = bone.cast_ray(&from, &-out.into_inner())?.point;
        Some(Lump { centre, radius_mm, thickness_mm })
    }

    /// Thickness at a point of the bone, mm; 0 where it is bare.
    fn at(&self, point: &Point3<f64>) -> f64 {
        let reach = |lump: &Lump| (point - lump.centre).norm() < lump.radius_mm * (1.0 + 2.0 * OUTLINE_SHARE);
        let mut near = self.lumps.iter().filter(|lump| reach(lump)).peekable();
        if near.peek().is_none() {
            return 0.0;
        }
        let outline = 1.0 + self.outline.scaled(OUTLINE_SHARE, point).clamp(-2.0 * OUTLINE_SHARE, 2.0 * OUTLINE_SHARE);
        let bumps = 1.0 + self.bumps.scaled(BUMP_SHARE, point);
        let [thinnest, thickest] = self.params.thickness_mm;
        let thickness = |lump: &Lump| {
            let inside_mm = lump.radius_mm * outline - (point - lump.centre).norm();
            (lump.thickness_mm * bumps).clamp(thinnest, thickest) * smoothstep(inside_mm / EDGE_MM)
        };
        // Towards a mark it rises at 45 degrees at most, as the camera would not see the mark behind a wall.
        let from_mark = |mark: &Point3<f64>| (point - mark).norm() - self.site.clear_mm;
        let clear_mm = self.site.marks.iter().map(from_mark).fold(f64::MAX, f64::min);
        near.map(thickness).fold(0.0, f64::max).min(clear_mm.max(0.0))
    }

    /// The share of seen points that are covered by at least half the minimum thickness.
    fn covered(&self) -> f64 {
        let least_mm = self.params.thickness_mm[0] / 2.0;
        let n_covered = self.site.seen.iter().filter(|p| self.at(p) >= least_mm).count();
        n_covered as f64 / self.site.seen.len() as f64
    }

    /// Shrinks the last lump until the share is as requested.
    fn shrink_last(&mut self) {
        let Some(last) = self.lumps.len().checked_sub(1) else { return };
        let (mut low, mut high) = (0.0, self.lumps[last].radius_mm);
        for _ in 0..20 {
            let middle = (low + high) / 2.0;
            self.lumps[last].radius_mm = middle;
            if self.covered() < self.params.share { low = middle } else { high = middle }
        }
        self.lumps[last].radius_mm = high;
    }

    /// The surface of all lumps, open towards the bone; `None` if nothing of the bone is covered.
    fn mesh(&self, site: &Site<'_>) -> Option<Result<Mesh, SimulationError>> {
        let bone = site.bone.mesh();
        let normals = vertex_normals(bone.vertices(), bone.faces());
        let (mut vertices, mut faces) = (Vec::new(), Vec::new());
        for face in bone.faces() {
            let corners = face.map(|v| bone.vertices()[v as usize]);
            let [a, b, c] = corners;
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            let is_near = |lump: &Lump| {
                let reach_mm = lump.radius_mm * (1.0 + 2.0 * OUTLINE_SHARE) + longest;
                (a - lump.centre).norm() < reach_mm
            };
            if !self.lumps.iter().any(is_near) {
                continue;
            }
            let across = face.map(|v| normals[v as usize]);
            let n = (longest / MESH_EDGE_MM).ceil().max(1.0) as usize;
            self.refine(&corners, &across, n, &mut vertices, &mut faces);
        }
        (!faces.is_empty()).then(|| Ok(Mesh::new(&bone.frame, bone.origin, vertices, faces)?))
    }

    /// Adds a face of the bone, divided into n² triangles and raised to the tissue's surface, where it is covered.
    fn refine(
        &self,
        corners: &[Point3<f64>; 3],
        normals: &[Vector3<f64>; 3],
        n: usize,
        vertices: &mut Vec<Point3<f64>>,
        faces: &mut Vec<[u32; 3]>,
    ) {
        let first = vertices.len() as u32;
        let mut thick = Vec::new();
        for i in 0..=n {
            for j in 0..=n - i {
                let [u, v] = [i, j].map(|k| k as f64 / n as f64);
                let mix = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>| a * (1.0 - u - v) + b * u + c * v;
                let on_bone = Point3::from(mix(corners[0].coords, corners[1].coords, corners[2].coords));
                let outward = mix(normals[0], normals[1], normals[2]).try_normalize(1e-6).unwrap_or_default();
                let thickness_mm = self.at(&on_bone);
                thick.push(thickness_mm > 0.0);
                vertices.push(on_bone + outward * thickness_mm);
            }
        }
        // Rows of n + 1, n, .. vertices.
        let index = |i: usize, j: usize| i * (n + 1) - i * i.saturating_sub(1) / 2 + j;
        let mut add = |triangle: [usize; 3]| {
            if triangle.iter().any(|&v| thick[v]) {
                faces.push(triangle.map(|v| first + v as u32));
            }
        };
        for i in 0..n {
            for j in 0..n - i {
                add([index(i, j), index(i + 1, j), index(i, j + 1)]);
                if i + j + 1 < n {
                    add([index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BoneParams, Subject};

    /// Points on the stripped bone that face the camera.
    fn seen(subject: &Subject, towards_camera: &Vector3<f64>) -> Vec<Point3<f64>> {
        let (bone, anatomy) = (subject.bone(), subject.plan.anatomy.as_ref().unwrap());
        let normals = vertex_normals(bone.vertices(), bone.faces());
        let height = |v: &Point3<f64>| (v - anatomy.malleolus_tip).dot(&anatomy.proximal);
        let is_seen =
            |v: &Point3<f64>, n: &Vector3<f64>| (70.0..165.0).contains(&height(v)) && n.dot(towards_camera) > 0.3;
        bone.vertices().iter().zip(&normals).filter(|(v, n)| is_seen(v, n)).map(|(v, _)| *v).collect()
    }

    #[test]
    fn lumps_cover_the_share_of_the_seen_bone_and_are_whole_and_of_their_size() {
        let subject = Subject::built_in(&BoneParams::default()).unwrap();
        let anatomy = subject.plan.anatomy.clone().unwrap();
        let towards_camera = (anatomy.lateral.into_inner() + *anatomy.posterior).normalize();
        let (seen, marks) = (seen(&subject, &towards_camera), subject.plan.landmarks.positions());
        let site = Site {
            bone: &subject.surface,
            anatomy: &anatomy,
            stretch_mm: [70.0, 165.0],
            towards_camera,
            seen: &seen,
            marks: &marks,
            clear_mm: 4.0,
        };
        for share in [0.05, 0.2, 0.4, 0.6] {
            for seed in 0..5 {
                let params = TissueParams { share, ..TissueParams::default() };
                let lumps = Lumps::placed(&params, &site, seed).unwrap();
                let covered = lumps.covered();
                assert!((covered - share).abs() < 0.01, "{covered} is covered, not {share}");
                let diameters: Vec<f64> = lumps.lumps.iter().map(|lump| 2.0 * lump.radius_mm).collect();
                let whole = &diameters[..diameters.len() - 1];
                assert!(whole.iter().all(|mm| (10.0..=25.0).contains(mm)), "{diameters:?} mm");
                let mesh = lumps.mesh(&site).unwrap().unwrap();
                let off = |v: &Point3<f64>| subject.surface.closest_point(v).unwrap().distance_mm;
                let most = mesh.vertices().iter().map(off).fold(0.0, f64::max);
                assert!((1.0..6.001).contains(&most), "up to {most} mm");
                // Walls overhang a little where the bone is concave.
                let inward = (0..mesh.faces().len()).filter(|&f| {
                    let middle = mesh.corners(f).iter().fold(Vector3::zeros(), |sum, c| sum + c.coords) / 3.0;
                    let on_bone = subject.surface.closest_point(&middle.into()).unwrap();
                    mesh.area_vector(f).dot(&on_bone.normal) < 0.0
                });
                let n_inward = inward.count();
                assert!(n_inward * 50 < mesh.faces().len(), "{n_inward} of {} faces point inward", mesh.faces().len());
            }
        }
    }

    #[test]
    fn no_share_is_no_tissue() {
        let subject = Subject::built_in(&BoneParams::default()).unwrap();
        let anatomy = subject.plan.anatomy.clone().unwrap();
        let site = Site {
            bone: &subject.surface,
            anatomy: &anatomy,
            stretch_mm: [70.0, 165.0],
            towards_camera: *anatomy.lateral,
            seen: &subject.plan.landmarks.positions(),
            marks: &[],
            clear_mm: 4.0,
        };
        assert!(tissue(&TissueParams::default(), &site, 1).unwrap().is_none());
    }
}
