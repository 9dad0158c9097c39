//! The structured-light camera: rays through a grid of pixels onto one surface, and what goes wrong with each.

use crate::draws::{Term, direction, normal, stream};
use crate::params::CameraParams;
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Cloud, CloudError, StampNs};
use rand::RngExt;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// One pixel that sees the surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pixel {
    /// Unit direction of its ray, camera frame.
    pub(crate) ray: Vector3<f64>,
    /// True distance along the ray, mm.
    pub(crate) distance_mm: f64,
    /// Cosine of the angle between ray and surface normal.
    pub(crate) cos_incidence: f64,
    /// Outward unit normal of the surface, in its own frame.
    pub(crate) normal: Vector3<f64>,
    /// Whether it is the object that is seen, not what lies around it.
    pub(crate) on_object: bool,
}

impl Pixel {
    /// Where the surface truly is, camera frame.
    pub(crate) fn point(&self) -> Point3<f64> {
        Point3::from(self.ray * self.distance_mm)
    }
}

/// The stretch of an object that can be seen; the rest is covered by soft tissue.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stretch {
    pub(crate) from: Point3<f64>,
    pub(crate) along: Vector3<f64>,
    pub(crate) min_mm: f64,
    pub(crate) max_mm: f64,
}

impl Stretch {
    fn holds(&self, point: &Point3<f64>) -> bool {
        let height = (point - self.from).dot(&self.along);
        self.min_mm <= height && height <= self.max_mm
    }
}

/// More pixels than points, so that dropout, patches and the laser's hole leave enough; the surplus goes at random.
const SURPLUS: f64 = 1.12;

/// What stands before the camera, all in one frame.
#[derive(Clone, Copy)]
pub(crate) struct Sight<'a> {
    pub(crate) object: &'a MeshQuery,
    /// The part of the object that is not covered; all of it where absent.
    pub(crate) stretch: Option<&'a Stretch>,
    /// What lies around it and may hide it.
    pub(crate) around: Option<&'a MeshQuery>,
}

/// Pixels of the grid that see the object within its stretch or what lies around it, in rows, not more aslant than the
/// limit. Geometry alone: no draw enters, so every scan of one view has the same pixels.
///
/// `t_object_camera` leads into the surfaces' frame. The grid is as fine as `n_points` needs.
pub(crate) fn view(sight: &Sight<'_>, t_object_camera: &Isometry3<f64>, params: &CameraParams) -> Vec<Pixel> {
    let Sight { object, stretch, around } = *sight;
    let t_camera_object = t_object_camera.inverse();
    let outline = around.unwrap_or(object).mesh().vertices();
    let stretch_seen = if around.is_some() { None } else { stretch };
    let seen = outline.iter().filter(|p| stretch_seen.is_none_or(|s| s.holds(p))).map(|p| t_camera_object * p);
    let window = seen.filter(|p| p.z > 1.0).map(|p| [p.x / p.z, p.y / p.z]).fold(None, |window, [x, y]| {
        let [x0, x1, y0, y1] = window.unwrap_or([x, x, y, y]);
        Some([x.min(x0), x.max(x1), y.min(y0), y.max(y1)])
    });
    let Some(window) = window else { return Vec::new() };
    let cast = |step: f64| -> Vec<Pixel> {
        // Whole steps from the optical axis; a coarse mesh may bulge a little beyond its vertices within the stretch.
        let [x0, x1, y0, y1] = window;
        let [first, last] = [x0 / step - 8.0, x1 / step + 8.0].map(|c| c.round() as i64);
        let [top, bottom] = [y0 / step - 8.0, y1 / step + 8.0].map(|c| c.round() as i64);
        let rows: Vec<Vec<Pixel>> = (top..=bottom)
            .into_par_iter()
            .map(|row| {
                (first..=last)
                    .filter_map(|column| {
                        let ray = Vector3::new(column as f64 * step, row as f64 * step, 1.0).normalize();
                        let (origin, along) = (Point3::from(t_object_camera.translation.vector), t_object_camera * ray);
                        let before = around.and_then(|a| a.cast_ray(&origin, &along));
                        let behind = object.cast_ray(&origin, &along);
                        let on_object = match (&before, &behind) {
                            (Some(before), Some(behind)) => behind.distance_mm <= before.distance_mm,
                            (before, _) => before.is_none(),
                        };
                        let hit = if on_object { behind? } else { before? };
                        let cos_incidence = -along.dot(&hit.normal);
                        let good = cos_incidence >= params.max_incidence_deg.to_radians().cos()
                            && (!on_object || stretch.is_none_or(|s| s.holds(&hit.point)));
                        good.then_some(Pixel {
                            ray,
                            distance_mm: hit.distance_mm,
                            cos_incidence,
                            normal: hit.normal,
                            on_object,
                        })
                    })
                    .collect()
            })
            .collect();
        rows.into_iter().flatten().collect()
    };
    // A coarse grid measures the visible solid angle, from which the real grid's step follows.
    let extent = (window[1] - window[0]).max(window[3] - window[2]);
    let probe = extent / 160.0;
    let solid_angle = cast(probe).len() as f64 * probe * probe;
    if solid_angle == 0.0 {
        return Vec::new();
    }
    cast((solid_angle / (params.n_points as f64 * SURPLUS)).sqrt())
}

/// The smooth error of depth that the camera's own calibration leaves, mm: a function of where a point lies in the
/// camera's frame, the same for every cloud of a run.
pub(crate) struct DepthBias {
    waves: Vec<(Vector3<f64>, f64)>,
    amplitude_mm: f64,
}

impl DepthBias {
    pub(crate) fn new(params: &CameraParams, seed: u64) -> Self {
        const N_WAVES: usize = 24;
        let mut rng = stream(params.bias_seed.unwrap_or(seed), Term::DepthBias, 0);
        let waves = (0..N_WAVES)
            .map(|_| {
                let wavelength_mm = params.depth_bias_wavelength_mm * 2f64.powf(2.0 * rng.random::<f64>() - 1.0);
                (direction(&mut rng) * (TAU / wavelength_mm), TAU * rng.random::<f64>())
            })
            .collect();
        Self { waves, amplitude_mm: params.depth_bias_mm * (2.0 / N_WAVES as f64).sqrt() }
    }

    fn at(&self, point: &Point3<f64>) -> f64 {
        if self.amplitude_mm == 0.0 {
            return 0.0;
        }
        self.amplitude_mm * self.waves.iter().map(|(k, phase)| (k.dot(&point.coords) + phase).cos()).sum::<f64>()
    }
}

/// A laser spot's hole: what lies within `radius_mm` of `spot` (camera frame) is not measured.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hole {
    pub(crate) spot: Point3<f64>,
    pub(crate) radius_mm: f64,
}

/// A cloud of the view, taken with fresh noise: `scan` numbers the clouds of a run, and with it their draws.
///
/// Each draw belongs to a pixel (noise, dropout, thinning) or to a patch, whether it is used or not, so that switching a
/// term off changes nothing else. At most `n_points` points, in the order of the pixels, frame `camera`.
pub(crate) fn scan(
    pixels: &[Pixel],
    bias: &DepthBias,
    hole: Option<Hole>,
    stamp_ns: StampNs,
    params: &CameraParams,
    seed: u64,
    scan: u64,
) -> Result<Cloud, CloudError> {
    let mut patch_rng = stream(seed, Term::Patches, scan);
    let patches: Vec<Point3<f64>> = (0..params.n_patches)
        .map(|_| patch_rng.random_range(0..pixels.len().max(1)))
        .filter_map(|pixel| Some(pixels.get(pixel)?.point()))
        .collect();
    let (mut noise, mut dropout) = (stream(seed, Term::DepthNoise, scan), stream(seed, Term::Dropout, scan));
    let mut thinning = stream(seed, Term::Thinning, scan);
    let within = |p: &Point3<f64>, centre: &Point3<f64>, radius_mm: f64| (p - centre).norm() < radius_mm;

    let mut kept: Vec<(u64, Point3<f64>)> = Vec::with_capacity(pixels.len());
    for pixel in pixels {
        let (noise, drop, key) = (normal(&mut noise), dropout.random::<f64>(), thinning.random::<u64>());
        let truth = pixel.point();
        if drop < params.dropout
            || patches.iter().any(|centre| within(&truth, centre, params.patch_radius_mm))
            || hole.is_some_and(|hole| within(&truth, &hole.spot, hole.radius_mm))
        {
            continue;
        }
        let spread = params.depth_noise_mm * pixel.cos_incidence.powf(-params.depth_noise_growth);
        kept.push((key, Point3::from(pixel.ray * (pixel.distance_mm + spread * noise + bias.at(&truth)))));
    }
    if kept.len() > params.n_points {
        let mut keys: Vec<u64> = kept.iter().map(|(key, _)| *key).collect();
        // Equal keys are as good as impossible; truncation keeps the lower index if they come.
        let (_, &mut limit, _) = keys.select_nth_unstable(params.n_points - 1);
        kept.retain(|(key, _)| *key <= limit);
        kept.truncate(params.n_points);
    }
    let points: Vec<Point3<f64>> = kept.into_iter().map(|(_, point)| point).collect();
    Ok(Cloud::new("camera", points)?.at(stamp_ns).seen_from(Isometry3::identity()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::{Mesh, SurfaceOrigin};

    /// A square wall of 100 mm, 200 mm before the camera, its normal towards it.
    fn wall(params: &CameraParams) -> Vec<Pixel> {
        let corners = [[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]];
        let vertices: Vec<Point3<f64>> = corners.iter().map(|[x, y]| Point3::new(*x, *y, 200.0)).collect();
        let faces = vec![[0, 2, 1], [0, 3, 2]];
        let wall = Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap();
        let sight = Sight { object: &MeshQuery::new(&wall), stretch: None, around: None };
        view(&sight, &Isometry3::identity(), params)
    }

    fn quiet() -> CameraParams {
        CameraParams { depth_noise_mm: 0.0, dropout: 0.0, n_patches: 0, depth_bias_mm: 0.0, ..CameraParams::default() }
    }

    /// The cloud of all pixels that are left, before the surplus goes.
    fn left(pixels: &[Pixel], params: &CameraParams, seed: u64) -> Cloud {
        let all = CameraParams { n_points: pixels.len(), ..params.clone() };
        scan(pixels, &DepthBias::new(params, seed), None, 1, &all, seed, 1).unwrap()
    }

    #[test]
    fn the_grid_is_as_fine_as_the_points_need_and_the_surplus_goes() {
        let params = quiet();
        let pixels = wall(&params);
        let share = pixels.len() as f64 / 20_000.0;
        assert!((1.08..1.16).contains(&share), "{share} pixels for each point");
        let cloud = scan(&pixels, &DepthBias::new(&params, 1), None, 1, &params, 1, 1).unwrap();
        assert_eq!(cloud.len(), 20_000);
        assert!(cloud.points().iter().all(|p| (p.z - 200.0).abs() < 1e-9));
        assert_eq!(cloud.viewpoint, Some(Isometry3::identity()));
    }

    #[test]
    fn dropout_takes_its_share() {
        let params = CameraParams { dropout: 0.3, ..quiet() };
        let pixels = wall(&params);
        let kept = left(&pixels, &params, 1).len() as f64 / pixels.len() as f64;
        // Four standard errors over 22,000 pixels.
        assert!((kept - 0.7).abs() < 0.013, "{kept} are kept");
    }

    #[test]
    fn patches_take_discs_of_their_radius_anew_in_every_scan() {
        let params = CameraParams { n_patches: 3, patch_radius_mm: 4.0, ..quiet() };
        let pixels = wall(&params);
        let lost = |seed: u64| pixels.len() - left(&pixels, &params, seed).len();
        let mean = (0..60).map(lost).sum::<usize>() as f64 / 60.0 / pixels.len() as f64;
        // Three discs in a wall of 100 x 100 mm; some overlap or reach over its edge.
        let discs = 3.0 * std::f64::consts::PI * 16.0 / 10_000.0;
        assert!((0.85 * discs..1.001 * discs).contains(&mean), "{mean} of the wall is lost, discs are {discs}");
        assert_ne!(left(&pixels, &params, 1), left(&pixels, &params, 2));
    }

    #[test]
    fn what_is_seen_too_aslant_gives_no_point() {
        // From its middle, the wall's edges are seen at up to 19.5 degrees.
        let limit_deg = 10.0;
        let pixels = wall(&CameraParams { max_incidence_deg: limit_deg, ..quiet() });
        let steepest = pixels.iter().map(|p| p.cos_incidence).fold(1.0, f64::min).acos().to_degrees();
        assert!((9.8..=limit_deg).contains(&steepest), "{steepest} degrees");
    }

    #[test]
    fn a_surface_behind_the_camera_is_not_seen() {
        let away = vec![Point3::new(0.0, 0.0, -200.0), Point3::new(9.0, 0.0, -200.0), Point3::new(0.0, 9.0, -200.0)];
        let mesh = Mesh::new("ct", SurfaceOrigin::Exact, away, vec![[0, 1, 2]]).unwrap();
        let sight = Sight { object: &MeshQuery::new(&mesh), stretch: None, around: None };
        assert!(view(&sight, &Isometry3::identity(), &quiet()).is_empty());
    }
}
