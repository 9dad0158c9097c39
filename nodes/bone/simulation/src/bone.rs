//! The built-in bone: a right fibula as a formula, which needs no file and no licence.
//!
//! Its local frame is (medial, posterior, proximal), right-handed for a right leg, with z = 0 at the malleolus tip.
//! Each section is a rounded triangle around a slightly bowed centre line, with three ridges that wander along the
//! shaft and a seeded, smooth unevenness; malleolus and head are swellings that end in half ellipsoids.

use crate::draws::normal;
use crate::error::SimulationError;
use crate::ranges;
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use osteoflow_geometry::{Anatomy, Mesh, SurfaceOrigin};
use osteoflow_node_macros::params;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Shape and position of the built-in right fibula, and what makes another bone of it or of one of your own.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BoneParams {
    /// From malleolus tip to the top of the head. 350: the two measured fibulas of the development data have 336 to 360.
    #[param(350.0, 250.0..=450.0)]
    pub length_mm: f64,
    /// Scales every section. 1: a shaft 11 to 15 mm across, as in those two bones.
    #[param(1.0, 0.6..=1.6)]
    pub girth: f64,
    /// Seed of the unevenness: another bone of the same kind. Not the run's seed, as repeated procedures are on one bone.
    #[param(1)]
    pub shape_seed: u64,
    /// Standard deviation of the unevenness; 0 is the smooth formula. 0.35: assumed; the bone's weakest mode then lies between
    /// those of the two measured fibulas (docs/method/simulation.md).
    #[param(0.35, 0.0..=1.0)]
    pub unevenness_mm: f64,
    /// Length of the mesh's edges along the bone, and about that around it. 1: a segmented clinical CT.
    #[param(1.0, 0.3..=5.0)]
    pub edge_mm: f64,
    /// Centre of the bone in the CT frame. Far from the origin, as in every CT.
    #[param([-90.0, -85.0, -890.0])]
    pub centre_mm: [f64; 3],
    /// Whether the bone, or `bone_file`, is its mirror image in the same place, with anatomy and plan. false: off; true in plan
    /// and surface alone is the CT of the other leg.
    pub mirrored: bool,
    /// RMS displacement of the bone or `bone_file`, with anatomy and plan, by a smooth field of wavelengths from 40 to 120 mm.
    /// 0: off; 0.8 (assumed) with `mirrored` is the same person's other leg.
    #[param(0.0, 0.0..=3.0)]
    pub warp_mm: f64,
    /// Seed of that field. Not the run's seed, as repeated procedures are on one bone.
    #[param(1)]
    pub warp_seed: u64,
    /// Excess of the length along the CT's z, with anatomy and plan: slices read as farther apart than they are. This and what
    /// follows is for plan and surface, not for the recording, and for `bone_file`, too. 0: off; 4: slices of 0.625 mm read as
    /// 0.65 mm.
    #[param(0.0, -20.0..=20.0)]
    pub stretch_percent: f64,
    /// Excess of all lengths. 0: off; negative: the bone has grown since its CT, or the pixel size is wrong.
    #[param(0.0, -20.0..=20.0)]
    pub growth_percent: f64,
    /// Tilt of the gantry that was ignored when the slices were stacked: y is larger by tan(angle) times z. 0: off; 10 to 20 in
    /// CTs of the head.
    #[param(0.0, -45.0..=45.0)]
    pub gantry_deg: f64,
    /// Bend towards lateral: sagitta of the arc over 100 mm of a straight bone. 0: off.
    #[param(0.0, -20.0..=20.0)]
    pub bend_mm: f64,
    /// Twist about the long axis over 100 mm. 0: off.
    #[param(0.0, -30.0..=30.0)]
    pub twist_deg: f64,
    /// Displacement of the distal part towards lateral: a fracture, or a part that loosened since the CT. 0: off.
    #[param(0.0, -30.0..=30.0)]
    pub step_mm: f64,
    /// Rotation of the distal part about the posterior direction through the bone at the step. 0: off.
    #[param(0.0, -45.0..=45.0)]
    pub step_deg: f64,
    /// Place of the step along the bone, from the malleolus tip. 118: the middle of the default scan.
    #[param(118.0, 0.0..=450.0)]
    pub step_at_mm: f64,
}

impl BoneParams {
    /// The first parameter that differs from its default and has no effect on a bone of the user's own.
    pub fn of_built_in_only(&self) -> Option<&'static str> {
        let default = Self::default();
        [
            ("bone.length_mm", self.length_mm != default.length_mm),
            ("bone.girth", self.girth != default.girth),
            ("bone.shape_seed", self.shape_seed != default.shape_seed),
            ("bone.unevenness_mm", self.unevenness_mm != default.unevenness_mm),
            ("bone.edge_mm", self.edge_mm != default.edge_mm),
            ("bone.centre_mm", self.centre_mm != default.centre_mm),
        ]
        .into_iter()
        .find_map(|(name, is_set)| is_set.then_some(name))
    }

    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        ranges::check("bone", self)
    }
}

/// The surface of the built-in right fibula in frame `ct` (LPS, mm): closed, normals outward, proximal close to +z.
/// Neither deformed nor mirrored, which [`crate::Subject::built_in`] does.
///
/// The same parameters give the same bits. `O(n)` in the number of vertices, about 17,000 by default.
pub fn fibula(params: &BoneParams) -> Mesh {
    let shape = Formula::new(params);
    // Limits the memory.
    let edge_mm = params.edge_mm.max(0.1);
    let heights = shape.ring_heights(edge_mm);
    // Sections grow towards the ends; a mean radius gives edges of about the requested length.
    let n_around = (TAU * 7.0 * params.girth / edge_mm).round().max(12.0) as usize;
    let t_ct_local = t_ct_local(params);

    let mut vertices = Vec::with_capacity(heights.len() * n_around + 2);
    for &z in &heights {
        for k in 0..n_around {
            vertices.push(t_ct_local * shape.point(z, k as f64 * TAU / n_around as f64));
        }
    }
    let distal_pole = vertices.len() as u32;
    vertices.push(t_ct_local * shape.centre(0.0));
    vertices.push(t_ct_local * shape.centre(params.length_mm));

    let vertex = |ring: usize, k: usize| (ring * n_around + k % n_around) as u32;
    let mut faces = Vec::with_capacity(2 * heights.len() * n_around);
    for k in 0..n_around {
        faces.push([distal_pole, vertex(0, k + 1), vertex(0, k)]);
        for ring in 1..heights.len() {
            let [a, b] = [vertex(ring - 1, k), vertex(ring - 1, k + 1)];
            let [c, d] = [vertex(ring, k), vertex(ring, k + 1)];
            faces.push([a, b, d]);
            faces.push([a, d, c]);
        }
        faces.push([distal_pole + 1, vertex(heights.len() - 1, k), vertex(heights.len() - 1, k + 1)]);
    }
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).expect("rings of finite points make a mesh")
}

/// Directions and malleolus tip of the built-in fibula, in frame `ct`, as [`fibula`].
pub fn anatomy(params: &BoneParams) -> Anatomy {
    let t_ct_local = t_ct_local(params);
    Anatomy {
        malleolus_tip: t_ct_local * Formula::new(params).centre(0.0),
        proximal: Unit::new_normalize(t_ct_local * Vector3::z()),
        lateral: Unit::new_normalize(t_ct_local * -Vector3::x()),
        posterior: Unit::new_normalize(t_ct_local * Vector3::y()),
    }
}

/// Legs are not aligned with the table: about 2 degrees off, as in the measured bones.
fn t_ct_local(params: &BoneParams) -> Isometry3<f64> {
    let tilt = Isometry3::rotation(Vector3::new(-0.03, -0.02, 0.05));
    let middle = Isometry3::translation(0.0, 0.0, -params.length_mm / 2.0);
    Isometry3::translation(params.centre_mm[0], params.centre_mm[1], params.centre_mm[2]) * tilt * middle
}

/// Along the bone as a share of its length: mean radius, and the centre line medial and posterior of the tip, all mm at
/// 350 mm length. Round figures of our own, after the widths of anatomy books: shaft 11-15, malleolus and head 20-25.
const STATIONS: [[f64; 4]; 12] = [
    [0.00, 9.0, 0.0, 0.0],
    [0.03, 10.8, 1.0, -1.5],
    [0.06, 10.5, 2.5, -2.5],
    [0.10, 7.6, 4.5, -3.0],
    [0.15, 6.1, 6.0, -3.0],
    [0.30, 5.9, 8.0, -1.5],
    [0.50, 6.1, 10.0, 0.5],
    [0.70, 5.7, 9.5, 0.5],
    [0.85, 5.2, 7.0, -1.0],
    [0.90, 6.8, 5.0, -2.0],
    [0.95, 11.2, 3.0, -2.5],
    [1.00, 9.5, 2.0, -1.5],
];

/// Length of the half ellipsoid at each end, mm.
const CAP_MM: f64 = 14.0;

/// Angles of a ridge at the ends of the shaft (from medial towards posterior), its height in mm, and the period of its
/// height as a share of the length.
const RIDGES: [Ridge; 3] = [
    Ridge { distal: -1.75, proximal: -1.05, height_mm: 1.3, period: 0.45, phase: 0.4 },
    Ridge { distal: 0.35, proximal: 0.95, height_mm: 1.0, period: 0.33, phase: 2.1 },
    Ridge { distal: 2.35, proximal: 3.05, height_mm: 1.1, period: 0.27, phase: 4.0 },
];

struct Ridge {
    distal: f64,
    proximal: f64,
    height_mm: f64,
    period: f64,
    phase: f64,
}

/// Half width of a ridge, radians: about 2 mm on the shaft.
const RIDGE_WIDTH: f64 = 0.33;

struct Wave {
    amplitude_mm: f64,
    per_mm: f64,
    around: f64,
    phase: f64,
}

struct Formula {
    length_mm: f64,
    girth: f64,
    waves: Vec<Wave>,
}

impl Formula {
    fn new(params: &BoneParams) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(params.shape_seed);
        const N_WAVES: usize = 40;
        let waves = (0..N_WAVES)
            .map(|i| {
                // Muscle attachments and grooves: 12 to 80 mm long, up to a quarter of the way around.
                let wavelength_mm = 12.0 * (80.0f64 / 12.0).powf(rng.random::<f64>());
                Wave {
                    amplitude_mm: normal(&mut rng) * params.unevenness_mm * (2.0 / N_WAVES as f64).sqrt(),
                    per_mm: TAU / wavelength_mm,
                    around: (i % 4) as f64,
                    phase: TAU * rng.random::<f64>(),
                }
            })
            .collect();
        Self { length_mm: params.length_mm, girth: params.girth, waves }
    }

    /// Radius, medial and posterior offset at height `z`.
    fn station(&self, z: f64) -> [f64; 3] {
        let s = (z / self.length_mm).clamp(0.0, 1.0);
        let next = STATIONS.iter().position(|row| s <= row[0]).unwrap_or(STATIONS.len() - 1).max(1);
        let (a, b) = (&STATIONS[next - 1], &STATIONS[next]);
        let h = b[0] - a[0];
        let u = (s - a[0]) / h;
        std::array::from_fn(|k| {
            let column = k + 1;
            hermite(u, a[column], b[column], h * slope(next - 1, column), h * slope(next, column))
        })
    }

    /// 0 at both ends, 1 between, as an ellipse.
    fn cap(&self, z: f64) -> f64 {
        let inside = (z.min(self.length_mm - z) / CAP_MM).clamp(0.0, 1.0);
        (inside * (2.0 - inside)).sqrt()
    }

    fn centre(&self, z: f64) -> Point3<f64> {
        let [_, medial, posterior] = self.station(z);
        Point3::new(medial, posterior, z)
    }

    fn point(&self, z: f64, angle: f64) -> Point3<f64> {
        let [mean_radius, medial, posterior] = self.station(z);
        let s = z / self.length_mm;
        // Between the swellings the section is a rounded triangle that rotates by 40 degrees from ankle to knee.
        let shaft = smoothstep((s - 0.08) / 0.10) * smoothstep((0.93 - s) / 0.08);
        let turned = angle - 0.25 - 0.7 * (s - 0.5);
        let oval = 0.06 * (2.0 * (turned - 0.9)).cos() * (0.6 + 0.4 * (TAU * s / 0.6).sin());
        let triangle = 0.07 * shaft * (3.0 * turned).cos();
        let ridges: f64 = RIDGES
            .iter()
            .map(|ridge| {
                let at = ridge.distal + (ridge.proximal - ridge.distal) * s;
                let off = ((angle - at).sin().atan2((angle - at).cos())) / RIDGE_WIDTH;
                let height = ridge.height_mm * (0.65 + 0.35 * (TAU * s / ridge.period + ridge.phase).cos());
                shaft * height * (-0.5 * off * off).exp()
            })
            .sum();
        let uneven: f64 =
            self.waves.iter().map(|w| w.amplitude_mm * (w.per_mm * z + w.around * angle + w.phase).cos()).sum();
        let radius =
            self.girth * self.cap(z) * (mean_radius * (1.0 + oval + triangle) + ridges + uneven - 0.35 * shaft);
        Point3::new(medial + radius * angle.cos(), posterior + radius * angle.sin(), z)
    }

    /// Heights of the rings, about `edge_mm` apart along the surface, without the poles.
    fn ring_heights(&self, edge_mm: f64) -> Vec<f64> {
        const N: usize = 20_000;
        let outline = |i: usize| {
            let z = self.length_mm * (1.0 - (PI * i as f64 / N as f64).cos()) / 2.0;
            (z, self.girth * self.cap(z) * self.station(z)[0])
        };
        let step = |i: usize| {
            let ((z0, r0), (z1, r1)) = (outline(i), outline(i + 1));
            (z1 - z0).hypot(r1 - r0)
        };
        let total: f64 = (0..N).map(step).sum();
        let n_steps = (total / edge_mm).round().max(4.0);
        let spacing = total / n_steps;
        let mut heights = Vec::new();
        let mut travelled = 0.0;
        for i in 0..N {
            travelled += step(i);
            if travelled >= spacing * (heights.len() + 1) as f64 && ((heights.len() + 1) as f64) < n_steps - 0.5 {
                heights.push(outline(i + 1).0);
            }
        }
        heights
    }
}

/// Slope of a column of the stations per share of the length, by the rule of Fritsch and Carlson, so that the curve
/// through them does not overshoot.
fn slope(station: usize, column: usize) -> f64 {
    if station == 0 || station + 1 == STATIONS.len() {
        return 0.0;
    }
    let rise = |i: usize| (STATIONS[i + 1][column] - STATIONS[i][column]) / (STATIONS[i + 1][0] - STATIONS[i][0]);
    let (before, after) = (rise(station - 1), rise(station));
    if before * after <= 0.0 { 0.0 } else { 2.0 * before * after / (before + after) }
}

fn hermite(u: f64, a: f64, b: f64, slope_a: f64, slope_b: f64) -> f64 {
    let (u2, u3) = (u * u, u * u * u);
    (2.0 * u3 - 3.0 * u2 + 1.0) * a + (u3 - 2.0 * u2 + u) * slope_a + (3.0 * u2 - 2.0 * u3) * b + (u3 - u2) * slope_b
}

/// 0 below 0, 1 above 1, smooth in between.
pub(crate) fn smoothstep(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assert_closed_and_outward;

    #[test]
    fn the_bone_is_closed_with_normals_outward_and_of_a_fibulas_size() {
        for (shape_seed, edge_mm) in [(1, 1.0), (2, 1.0), (3, 2.5)] {
            let params = BoneParams { shape_seed, edge_mm, ..BoneParams::default() };
            let bone = fibula(&params);
            let volume = assert_closed_and_outward(&bone);
            // The two measured fibulas: 43,500 and 50,800 mm3.
            assert!((35_000.0..60_000.0).contains(&volume), "{volume} mm3");
            let axes = anatomy(&params);
            let heights = bone.vertices().iter().map(|v| (v - axes.malleolus_tip).dot(&axes.proximal));
            let (low, high) = heights.fold((f64::MAX, f64::MIN), |(lo, hi), h| (lo.min(h), hi.max(h)));
            assert!(low.abs() < 1e-9 && (high - 350.0).abs() < 1e-9, "from {low} to {high} mm");
        }
    }

    #[test]
    fn edges_have_about_the_requested_length() {
        let bone = fibula(&BoneParams::default());
        let mut lengths: Vec<f64> = (0..bone.faces().len())
            .flat_map(|f| {
                let [a, b, c] = bone.corners(f);
                [(b - a).norm(), (c - b).norm(), (a - c).norm()]
            })
            .collect();
        lengths.sort_by(f64::total_cmp);
        let median = lengths[lengths.len() / 2];
        assert!((0.7..1.4).contains(&median), "median {median} mm");
        assert!(*lengths.last().unwrap() < 3.0, "longest {} mm", lengths.last().unwrap());
    }

    #[test]
    fn widths_along_the_shaft_are_a_fibulas() {
        let params = BoneParams::default();
        let (bone, axes) = (fibula(&params), anatomy(&params));
        for height in (60..=280).step_by(20) {
            let across: Vec<f64> = bone
                .vertices()
                .iter()
                .filter(|v| ((*v - axes.malleolus_tip).dot(&axes.proximal) - f64::from(height)).abs() < 1.0)
                .map(|v| (v - axes.malleolus_tip).dot(&axes.lateral))
                .collect();
            let width =
                across.iter().copied().fold(f64::MIN, f64::max) - across.iter().copied().fold(f64::MAX, f64::min);
            assert!((9.0..16.5).contains(&width), "{width} mm across at {height} mm");
        }
    }

    #[test]
    fn another_shape_seed_is_another_bone_of_the_same_kind() {
        let one = fibula(&BoneParams::default());
        let other = fibula(&BoneParams { shape_seed: 2, ..BoneParams::default() });
        let apart: Vec<f64> =
            one.vertices().iter().zip(other.vertices()).map(|(a, b)| (a - b).norm_squared()).collect();
        let rms = (apart.iter().sum::<f64>() / apart.len() as f64).sqrt();
        assert!((0.1..1.0).contains(&rms), "{rms} mm apart");
        assert_eq!(one, fibula(&BoneParams::default()));
    }

    #[test]
    fn a_right_legs_axes_are_proximal_up_lateral_to_the_right_and_posterior_back_in_lps() {
        let axes = anatomy(&BoneParams::default());
        assert!(axes.proximal.z > 0.99 && axes.lateral.x < -0.99 && axes.posterior.y > 0.99);
        // Proximal, lateral, posterior turn left-handed on a right leg: lateral is the patient's right.
        assert!(axes.lateral.cross(&axes.posterior).dot(&axes.proximal) < -0.999);
    }
}
