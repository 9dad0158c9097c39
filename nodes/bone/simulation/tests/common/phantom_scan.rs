//! Scans of a calibration phantom from any side, spoilt in any way.

use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::Mesh;
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, UnitSphere};

/// How a scan of the phantom is taken.
#[derive(Debug, Clone)]
pub(crate) struct PhantomShot {
    /// Direction from the phantom to the camera, in the phantom's frame, any length.
    pub(crate) view: [f64; 3],
    /// Distance from the camera to the phantom's origin, mm.
    pub(crate) distance_mm: f64,
    /// Standard deviation of depth at normal incidence, mm; it grows as 1 / cos(incidence).
    pub(crate) noise_mm: f64,
    /// RMS of a smooth error of depth, mm.
    pub(crate) bias_mm: f64,
    /// Its wavelength, mm.
    pub(crate) wavelength_mm: f64,
    /// RMS of an error of depth that is correlated over 3 to 5 mm, mm.
    pub(crate) rough_mm: f64,
    /// Share of the points beside an edge, where the depth jumps, that are up to 3 mm off along the sight.
    pub(crate) edge_outliers: f64,
    pub(crate) max_incidence_deg: f64,
    pub(crate) n_points: usize,
    /// Share of the points on a table and a clamp beside the phantom.
    pub(crate) table: f64,
    /// Keeps only a strip of the faces whose normal is this axis, so that they have about this share of the points.
    pub(crate) rare: Option<(usize, f64)>,
}

impl Default for PhantomShot {
    fn default() -> Self {
        Self {
            view: [1.0; 3],
            distance_mm: 230.0,
            noise_mm: 0.05,
            bias_mm: 0.05,
            wavelength_mm: 60.0,
            rough_mm: 0.0,
            edge_outliers: 0.0,
            max_incidence_deg: 72.0,
            n_points: if std::env::var_os("SLOW_TESTS").is_some() { 20_000 } else { 5000 },
            table: 0.0,
            rare: None,
        }
    }
}

/// A scan in the camera's frame, and the true pose.
pub(crate) struct PhantomScan {
    pub(crate) points: Vec<Point3<f64>>,
    pub(crate) t_camera_phantom: Isometry3<f64>,
    /// Share of the points by the axis of their face's normal.
    pub(crate) shares: [f64; 3],
}

fn direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let [x, y, z]: [f64; 3] = UnitSphere.sample(rng);
    Vector3::new(x, y, z)
}

/// A smooth field of unit RMS with this wavelength.
fn smooth(rng: &mut ChaCha8Rng, wavelength_mm: f64) -> impl Fn(&Point3<f64>) -> f64 + use<> {
    let waves: Vec<(Vector3<f64>, f64)> = (0..12)
        .map(|_| (direction(rng) * std::f64::consts::TAU / wavelength_mm, rng.random_range(0.0..std::f64::consts::TAU)))
        .collect();
    move |p| waves.iter().map(|(k, phase)| (k.dot(&p.coords) + phase).sin()).sum::<f64>() / 6_f64.sqrt()
}

impl PhantomShot {
    pub(crate) fn take(&self, phantom: &Mesh, seed: u64) -> PhantomScan {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let towards = Vector3::from(self.view).normalize();
        let look = UnitQuaternion::rotation_between(&towards, &-Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let spin = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(0.0..std::f64::consts::TAU));
        let aside = Vector3::new(rng.random_range(-6.0..6.0), rng.random_range(-6.0..6.0), self.distance_mm);
        let t_camera_phantom = Translation3::from(aside) * spin * look;
        let t_phantom_camera = t_camera_phantom.inverse();
        let query = MeshQuery::new(phantom);
        let eye = t_phantom_camera * Point3::origin();
        let radius = phantom.vertices().iter().map(|v| v.coords.norm()).fold(0.0, f64::max);
        let reach = radius / (self.distance_mm - radius) * 1.05;
        let (bias, gauss) = (smooth(&mut rng, self.wavelength_mm), Normal::new(0.0, 1.0).unwrap());
        let rough = smooth(&mut ChaCha8Rng::seed_from_u64(seed ^ 0x0707), 14.0);
        let edges = &mut ChaCha8Rng::seed_from_u64(seed ^ 0xed6e);
        let limit = self.max_incidence_deg.to_radians().cos();
        // A table of 0.9 cube widths behind the phantom, seen beside it, and a clamp that touches it.
        let table_normal = t_camera_phantom * -Vector3::z();
        let step = reach * 2.0 / 330.0;
        let (mut on, mut beside) = (Vec::new(), Vec::new());
        for i in -165..=165 {
            for j in -165..=165 {
                let ray = Vector3::new(f64::from(i) * step, f64::from(j) * step, 1.0).normalize();
                let noise: f64 = gauss.sample(&mut rng);
                let at = |mm: f64, cos: f64| {
                    let place = Point3::from(ray * mm);
                    place
                        + ray
                            * (self.noise_mm / cos * noise
                                + self.bias_mm * bias(&place)
                                + self.rough_mm * rough(&place))
                };
                match query.cast_ray(&eye, &(t_phantom_camera * ray)) {
                    Some(hit) => {
                        let cos = -(t_phantom_camera * ray).dot(&hit.normal);
                        let is_edge = |(di, dj): (i32, i32)| {
                            let beside =
                                Vector3::new(f64::from(i + di) * step, f64::from(j + dj) * step, 1.0).normalize();
                            let other = query.cast_ray(&eye, &(t_phantom_camera * beside));
                            other.is_none_or(|other| (other.distance_mm - hit.distance_mm).abs() > 3.0)
                        };
                        let is_out = self.edge_outliers > 0.0
                            && [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().any(is_edge)
                            && edges.random_range(0.0..1.0) < self.edge_outliers;
                        let out_mm = if is_out { edges.random_range(-3.0..3.0) } else { 0.0 };
                        if cos >= limit {
                            on.push((at(hit.distance_mm + out_mm, cos), hit.point, hit.normal.iamax()));
                        }
                    }
                    None if self.table > 0.0 => {
                        let plane = t_camera_phantom * Point3::new(0.0, 0.0, -31.0);
                        let mm = plane.coords.dot(&table_normal) / ray.dot(&table_normal);
                        if mm > 0.0 && (mm - self.distance_mm).abs() < 80.0 {
                            beside.push(at(mm, ray.dot(&table_normal).abs().max(0.1)));
                        }
                    }
                    None => {}
                }
            }
        }
        if let Some((axis, share)) = self.rare {
            let n_others = on.iter().filter(|p| p.2 != axis).count() as f64;
            // Those nearest to a line across the face.
            let along = (axis + 1) % 3;
            let mut rare: Vec<usize> = (0..on.len()).filter(|&i| on[i].2 == axis).collect();
            rare.sort_by(|&a, &b| on[a].1[along].abs().total_cmp(&on[b].1[along].abs()));
            let keep = (n_others * share / (1.0 - share)) as usize;
            let dropped: std::collections::BTreeSet<usize> = rare.into_iter().skip(keep).collect();
            on = on.into_iter().enumerate().filter(|(i, _)| !dropped.contains(i)).map(|(_, p)| p).collect();
        }
        let n_beside = (self.n_points as f64 * self.table) as usize;
        let thin = |rng: &mut ChaCha8Rng, n: usize, n_all: usize| -> Vec<usize> {
            let mut kept: Vec<usize> = (0..n_all).collect();
            while kept.len() > n {
                kept.swap_remove(rng.random_range(0..kept.len()));
            }
            kept
        };
        let kept = thin(&mut rng, self.n_points - n_beside, on.len());
        let shares = std::array::from_fn(|k| kept.iter().filter(|&&i| on[i].2 == k).count() as f64 / kept.len() as f64);
        let mut points: Vec<Point3<f64>> = kept.into_iter().map(|i| on[i].0).collect();
        let kept = thin(&mut rng, n_beside, beside.len());
        points.extend(kept.into_iter().map(|i| beside[i]));
        PhantomScan { points, t_camera_phantom, shares }
    }
}

/// A nominal pose of the phantom: the true one with the camera's marker mounted this far off, 71 mm from the camera.
pub(crate) fn nominal(t_camera_phantom: &Isometry3<f64>, mm: f64, deg: f64, seed: u64) -> Isometry3<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let marker = Translation3::new(36.0, -58.0, -21.0);
    let (shift, turn) = (direction(&mut rng) * mm, direction(&mut rng) * deg.to_radians());
    marker * Isometry3::new(shift, turn) * marker.inverse() * t_camera_phantom
}
