//! The structured-light camera: rays through a grid of pixels onto a surface, with their errors.

use crate::bone::smoothstep;
use crate::draws::{Term, normal, stream};
use crate::params::{CameraParams, PeriosteumParams};
use crate::waves::Waves;
use nalgebra::{Isometry3, Point3, Rotation3, Unit, Vector3};
use osteoflow_algorithms::mesh_query::{MeshQuery, SurfacePoint};
use osteoflow_geometry::{Cloud, CloudError, StampNs};
use rand::RngExt;
use rayon::prelude::*;
use std::collections::HashMap;

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
    /// Whether the pixel sees the object, not its surroundings.
    pub(crate) on_object: bool,
    /// Column and row in the grid.
    cell: [i64; 2],
    /// Whether the surface ends close by.
    at_edge: bool,
    /// Film on the bone, along the ray, mm.
    film_mm: f64,
    /// Error of the distance that all clouds of the view share, mm.
    bias_mm: f64,
    /// Standard deviation of the error drawn for each cloud, mm.
    noise_mm: f64,
    /// When it is measured, where clouds take time.
    instant: Option<Instant>,
}

/// When a pixel is measured.
#[derive(Debug, Clone, Copy)]
struct Instant {
    /// Time from the cloud's stamp.
    from_stamp_s: f64,
    /// Carries what the camera sees at this instant, on the object, to where it sees it at the stamp.
    t_stamp_instant: Isometry3<f64>,
}

impl Pixel {
    /// The true point of the surface, camera frame at the cloud's stamp.
    pub(crate) fn point(&self) -> Point3<f64> {
        self.at_stamp(Point3::from(self.ray * self.distance_mm))
    }

    fn at_stamp(&self, point: Point3<f64>) -> Point3<f64> {
        self.instant.map_or(point, |instant| instant.t_stamp_instant * point)
    }

    /// Factor of an error along the ray: 1 where the surface faces the camera.
    fn slanted(&self, params: &CameraParams) -> f64 {
        self.cos_incidence.powf(-params.depth_noise_growth)
    }

    /// The true point of the film on it, which the light falls on; of the surface where it is bare.
    pub(crate) fn lit(&self) -> Point3<f64> {
        self.at_stamp(Point3::from(self.ray * (self.distance_mm - self.film_mm)))
    }
}

/// The visible stretch of an object; the rest is covered by soft tissue.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stretch {
    pub(crate) from: Point3<f64>,
    pub(crate) along: Vector3<f64>,
    pub(crate) min_mm: f64,
    pub(crate) max_mm: f64,
}

impl Stretch {
    pub(crate) fn holds(&self, point: &Point3<f64>) -> bool {
        let height = (point - self.from).dot(&self.along);
        self.min_mm <= height && height <= self.max_mm
    }
}

/// Ratio of pixels to points, so that dropout, patches and the laser's hole leave enough; the surplus is dropped at
/// random.
const SURPLUS: f64 = 1.12;

/// The surfaces in front of the camera, in one frame.
#[derive(Clone, Copy)]
pub(crate) struct Sight<'a> {
    pub(crate) object: &'a MeshQuery,
    /// The visible part of the object; all of it if `None`.
    pub(crate) stretch: Option<&'a Stretch>,
    /// Surroundings, which may hide the object.
    pub(crate) around: Option<&'a MeshQuery>,
    /// Lumps on the object, which belong to it.
    pub(crate) lumps: Option<&'a MeshQuery>,
}

/// The columns or rows of a cloud measured one after the other.
pub(crate) struct Sweep<'a> {
    pub(crate) duration_s: f64,
    /// From the image's x towards its y.
    pub(crate) direction_rad: f64,
    /// At a time from the cloud's stamp, which is in the middle.
    pub(crate) t_object_camera: &'a (dyn Fn(f64) -> Isometry3<f64> + Sync),
}

impl Sweep<'_> {
    /// Times before and after the stamp at which the sweep begins and ends.
    fn ends_s(&self) -> [f64; 2] {
        [-self.duration_s / 2.0, self.duration_s / 2.0]
    }

    /// When a direction within a window is measured.
    fn instant(&self, [x0, x1, y0, y1]: [f64; 4], [x, y]: [f64; 2]) -> Instant {
        let (sin, cos) = self.direction_rad.sin_cos();
        let extent = cos.abs() * (x1 - x0) + sin.abs() * (y1 - y0);
        let share = (cos * (x - (x0 + x1) / 2.0) + sin * (y - (y0 + y1) / 2.0)) / extent;
        let from_stamp_s = self.duration_s * share.clamp(-0.5, 0.5);
        let at = self.t_object_camera;
        Instant { from_stamp_s, t_stamp_instant: at(0.0).inverse() * at(from_stamp_s) }
    }
}

/// Pixels of the grid that see the object within its stretch or its surroundings, row by row, up to the maximum
/// incidence. Nothing is drawn at random, so all scans of one view have the same pixels.
///
/// `t_object_camera` maps into the surfaces' frame, at the cloud's stamp. The resolution of the grid follows from `n_points`.
pub(crate) fn view(
    sight: &Sight<'_>,
    t_object_camera: &Isometry3<f64>,
    params: &CameraParams,
    bias: &DepthBias,
    sweep: Option<&Sweep<'_>>,
) -> Vec<Pixel> {
    let Sight { object, stretch, around, lumps } = *sight;
    let outline = around.unwrap_or(object).mesh().vertices().iter();
    let outline = outline.chain(lumps.map_or(&[][..], |lumps| lumps.mesh().vertices()));
    let stretch_seen = if around.is_some() { None } else { stretch };
    let outline: Vec<_> = outline.filter(|p| stretch_seen.is_none_or(|s| s.holds(p))).collect();
    let ends = sweep.into_iter().flat_map(|sweep| sweep.ends_s().map(sweep.t_object_camera));
    let poses: Vec<Isometry3<f64>> = std::iter::once(*t_object_camera).chain(ends).map(|t| t.inverse()).collect();
    let seen = poses.iter().flat_map(|t_camera_object| outline.iter().map(move |p| t_camera_object * **p));
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
                        let [x, y] = [column as f64 * step, row as f64 * step];
                        let ray = Vector3::new(x, y, 1.0).normalize();
                        let instant = sweep.map(|sweep| sweep.instant(window, [x, y]));
                        let at = instant.map_or(*t_object_camera, |i| t_object_camera * i.t_stamp_instant);
                        look(sight, &at, params, ray).map(|pixel| Pixel { cell: [column, row], instant, ..pixel })
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
    let step = (solid_angle / (params.n_points as f64 * SURPLUS)).sqrt();
    let mut pixels = cast(step);
    pixels.par_iter_mut().for_each(|pixel| {
        let seen = Point3::from(pixel.ray * pixel.distance_mm);
        pixel.bias_mm = bias.at(&seen) + pixel.slanted(params) * bias.across(&seen);
        pixel.noise_mm = params.depth_noise_mm * pixel.slanted(params);
    });
    if params.edge_outliers > 0.0 {
        mark_edges(&mut pixels, (EDGE_MM / (step * params.working_distance_mm)).ceil() as i64);
    }
    pixels
}

/// Width of the band along an edge in which points may be outliers.
const EDGE_MM: f64 = 0.5;

/// Marks the pixels within `reach` columns and rows of one beside which there is nothing, or something else in depth.
fn mark_edges(pixels: &mut [Pixel], reach: i64) {
    /// A larger step from pixel to pixel is another surface.
    const JUMP_MM: f64 = 2.0;
    let at: HashMap<[i64; 2], usize> = pixels.iter().enumerate().map(|(k, pixel)| (pixel.cell, k)).collect();
    let goes_on = |pixel: &Pixel, [dx, dy]: [i64; 2]| {
        let beside = at.get(&[pixel.cell[0] + dx, pixel.cell[1] + dy]).map(|&k| &pixels[k]);
        beside.is_some_and(|beside| (beside.distance_mm - pixel.distance_mm).abs() < JUMP_MM)
    };
    let ends = |pixel: &&Pixel| ![[1, 0], [-1, 0], [0, 1], [0, -1]].iter().all(|&step| goes_on(pixel, step));
    let ends: Vec<[i64; 2]> = pixels.iter().filter(ends).map(|pixel| pixel.cell).collect();
    for [column, row] in ends {
        for near in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| [column + dx, row + dy])) {
            if let Some(&k) = at.get(&near) {
                pixels[k].at_edge = true;
            }
        }
    }
}

/// The pixel of a ray that meets the object within its stretch, or its surroundings, up to the maximum incidence.
fn look(
    sight: &Sight<'_>,
    t_object_camera: &Isometry3<f64>,
    params: &CameraParams,
    ray: Vector3<f64>,
) -> Option<Pixel> {
    let Sight { object, stretch, around, lumps } = *sight;
    let (origin, along) = (Point3::from(t_object_camera.translation.vector), t_object_camera * ray);
    let before = around.and_then(|a| a.cast_ray(&origin, &along));
    let lump = lumps.and_then(|lumps| lumps.cast_ray(&origin, &along));
    let nearer = |a: SurfacePoint, b: SurfacePoint| if b.distance_mm < a.distance_mm { b } else { a };
    let behind = match (object.cast_ray(&origin, &along), lump) {
        (Some(bone), Some(lump)) => Some(nearer(bone, lump)),
        (bone, lump) => bone.or(lump),
    };
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
        cell: [0, 0],
        at_edge: false,
        film_mm: 0.0,
        bias_mm: 0.0,
        noise_mm: 0.0,
        instant: None,
    })
}

/// The visible share of a hole: 1 where its disc faces the camera, less where the surface turns away, where the disc
/// extends over the object's outline, and where the camera measures nothing. Nothing is drawn at random.
///
/// It is the share of the rays towards a disc of the hole's radius, perpendicular to the line of sight, that meet the
/// object within the hole.
pub(crate) fn hole_share(
    sight: &Sight<'_>,
    t_object_camera: &Isometry3<f64>,
    params: &CameraParams,
    hole: &Hole,
) -> f64 {
    // Vogel's spiral: rays of uniform density over the disc.
    const N_RAYS: usize = 256;
    let golden_rad = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let across = Rotation3::rotation_between(&Vector3::z(), &hole.spot.coords).unwrap_or_else(Rotation3::identity);
    let shows = |k: &usize| {
        let out_mm = hole.radius_mm * ((*k as f64 + 0.5) / N_RAYS as f64).sqrt();
        let (sin, cos) = (*k as f64 * golden_rad).sin_cos();
        let aside = across * Vector3::new(out_mm * cos, out_mm * sin, 0.0);
        let pixel = look(sight, t_object_camera, params, (hole.spot.coords + aside).normalize());
        pixel.is_some_and(|pixel| pixel.on_object && hole.takes(&pixel.point()))
    };
    (0..N_RAYS).filter(shows).count() as f64 / N_RAYS as f64
}

/// The smooth error of depth that the camera's own calibration leaves, and the shorter one across the surface, mm: fields in
/// the camera's frame, the same for every cloud of a run.
pub(crate) struct DepthBias {
    waves: Waves,
    rms_mm: f64,
    short: Waves,
    short_rms_mm: f64,
}

impl DepthBias {
    pub(crate) fn new(params: &CameraParams, seed: u64) -> Self {
        let rng = &mut stream(params.bias_seed.unwrap_or(seed), Term::DepthBias, 0);
        let short = &mut stream(seed, Term::SurfaceError, 0);
        Self {
            waves: Waves::new(rng, params.depth_bias_wavelength_mm),
            rms_mm: params.depth_bias_mm,
            short: Waves::new(short, params.surface_error_wavelength_mm),
            short_rms_mm: params.surface_error_mm,
        }
    }

    /// Added across the surface.
    fn across(&self, point: &Point3<f64>) -> f64 {
        self.short.scaled(self.short_rms_mm, point)
    }

    /// Added to the distance along the ray.
    pub(crate) fn at(&self, point: &Point3<f64>) -> f64 {
        self.waves.scaled(self.rms_mm, point)
    }
}

/// A laser spot's hole, camera frame: points within `radius_mm` of the spot, or of the beam, are not measured.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hole {
    pub(crate) spot: Point3<f64>,
    pub(crate) radius_mm: f64,
    /// Direction of the beam if the disc is its cross-section; otherwise the hole is a ball.
    pub(crate) beam: Option<Unit<Vector3<f64>>>,
}

impl Hole {
    pub(crate) fn takes(&self, point: &Point3<f64>) -> bool {
        self.off_mm(point) < self.radius_mm
    }

    /// Distance from the spot, or from the beam; infinite far along the beam, where there is another surface.
    pub(crate) fn off_mm(&self, point: &Point3<f64>) -> f64 {
        const REACH_MM: f64 = 20.0;
        let off = point - self.spot;
        let Some(beam) = self.beam else { return off.norm() };
        let along = off.dot(&beam);
        if along.abs() < REACH_MM { (off - *beam * along).norm() } else { f64::INFINITY }
    }
}

/// Blood and tissue on a bone in a wound.
pub(crate) struct Wound {
    /// Centres of the pools of blood, frame of the bone.
    pub(crate) pools: Vec<Point3<f64>>,
    /// The surface of lumps of soft tissue, frame of the bone.
    pub(crate) tissue: Option<MeshQuery>,
}

/// A film on the bone: patches, and what grows along and around it.
pub(crate) struct Periosteum {
    waves: Waves,
    thickness_mm: f64,
    threshold: f64,
    grows_mm: f64,
    around_mm: f64,
    site: Option<FilmSite>,
}

/// Where on the bone a film is, frame of the bone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FilmSite {
    /// Middles of the bone's sections at the start and the end of the stripped stretch.
    pub(crate) from: Point3<f64>,
    pub(crate) to: Point3<f64>,
    /// Where a film that grows around the bone is thinnest, and where it is thickest.
    pub(crate) lateral: Unit<Vector3<f64>>,
    pub(crate) posterior: Unit<Vector3<f64>>,
}

impl FilmSite {
    /// Shares of the way along the stretch, and from the lateral side to the posterior one.
    fn shares(&self, point: &Point3<f64>) -> [f64; 2] {
        let (length, off) = (self.to - self.from, point - self.from);
        let along = (off.dot(&length) / length.norm_squared()).clamp(0.0, 1.0);
        let aside = off - length * along;
        let around = aside.dot(&self.posterior).atan2(aside.dot(&self.lateral));
        [along, (around / std::f64::consts::FRAC_PI_2).clamp(0.0, 1.0)]
    }
}

impl Periosteum {
    pub(crate) fn new(params: &PeriosteumParams, site: Option<FilmSite>, seed: u64) -> Self {
        let rng = &mut stream(params.film_seed.unwrap_or(seed), Term::Periosteum, 0);
        // Logistic approximation of the normal distribution, within 0.01.
        let threshold = -(params.share / (1.0 - params.share)).ln() / 1.702;
        Self {
            waves: Waves::new(rng, params.patch_mm),
            thickness_mm: params.thickness_mm,
            threshold,
            grows_mm: params.grows_mm,
            around_mm: params.around_mm,
            site,
        }
    }

    /// Thickness along the normal, mm: 0 where it is scraped off.
    fn at(&self, point: &Point3<f64>) -> f64 {
        let patches = self.thickness_mm * smoothstep(self.waves.scaled(1.0, point) - self.threshold);
        let Some(site) = &self.site else { return patches };
        let [along, around] = site.shares(point);
        patches + self.grows_mm * along + self.around_mm * around
    }

    /// Moves what pixels see of the bone towards the camera, until it is as far off the bone as the film is thick.
    pub(crate) fn cover(&self, pixels: &mut [Pixel], t_object_camera: &Isometry3<f64>, object: &MeshQuery) {
        pixels.par_iter_mut().filter(|pixel| pixel.on_object).for_each(|pixel| {
            let seen = Point3::from(pixel.ray * pixel.distance_mm);
            let t_stamp_instant = pixel.instant.map_or_else(Isometry3::identity, |instant| instant.t_stamp_instant);
            pixel.film_mm = self.along(&seen, pixel.cos_incidence, &(t_object_camera * t_stamp_instant), object);
        });
    }

    /// A point of the bone moved onto the film along its ray, camera frame.
    pub(crate) fn onto(
        &self,
        point: &Point3<f64>,
        t_object_camera: &Isometry3<f64>,
        object: &MeshQuery,
    ) -> Point3<f64> {
        let ray = point.coords.normalize();
        let normal = object.closest_point(&(t_object_camera * point)).map_or(-(t_object_camera * ray), |at| at.normal);
        // Beyond this slant no pixel sees it.
        const LEAST_COS: f64 = 0.1;
        let cos_incidence = (-(t_object_camera * ray).dot(&normal)).max(LEAST_COS);
        point - ray * self.along(point, cos_incidence, t_object_camera, object)
    }

    /// Length of a ray, to this point of the bone, within the film, mm.
    fn along(
        &self,
        point: &Point3<f64>,
        cos_incidence: f64,
        t_object_camera: &Isometry3<f64>,
        object: &MeshQuery,
    ) -> f64 {
        let thickness_mm = self.at(&(t_object_camera * point));
        if thickness_mm <= 0.0 {
            return 0.0;
        }
        let (ray, distance_mm) = (point.coords.normalize(), point.coords.norm());
        let off = |film_mm: f64| {
            let point = t_object_camera * Point3::from(ray * (distance_mm - film_mm));
            object.closest_point(&point).map_or(0.0, |closest| closest.distance_mm)
        };
        // On a plane; a convex bone turns away from a slanted ray.
        let (mut low, mut high) = (0.0, thickness_mm / cos_incidence);
        const PRECISION_MM: f64 = 1e-3;
        if off(high) > thickness_mm + PRECISION_MM {
            while high - low > PRECISION_MM {
                let middle = (low + high) / 2.0;
                if off(middle) < thickness_mm { low = middle } else { high = middle }
            }
        }
        high
    }
}

/// The parameters of one scan.
pub(crate) struct Shot<'a> {
    pub(crate) pixels: &'a [Pixel],
    pub(crate) t_object_camera: Isometry3<f64>,
    pub(crate) hole: Option<Hole>,
    pub(crate) wound: Option<&'a Wound>,
    pub(crate) stamp_ns: StampNs,
    /// Number of the cloud in the run, which selects its random streams.
    pub(crate) number: u64,
}

/// A cloud of the view with its own noise.
///
/// Each draw belongs to a pixel (noise, dropout, thinning) or to a patch, whether it is used or not, so switching a
/// term off changes nothing else. At most `n_points` points, in the order of the pixels, frame `camera`.
pub(crate) fn scan(shot: &Shot<'_>, params: &CameraParams, seed: u64) -> Result<Cloud, CloudError> {
    let Shot { pixels, t_object_camera, hole, wound, stamp_ns, number } = *shot;
    let mut patch_rng = stream(seed, Term::Patches, number);
    let patches: Vec<Point3<f64>> = (0..params.n_patches)
        .map(|_| patch_rng.random_range(0..pixels.len().max(1)))
        .filter_map(|pixel| Some(pixels.get(pixel)?.point()))
        .collect();
    let pools: Vec<Point3<f64>> =
        wound.map_or(&[][..], |w| &w.pools).iter().map(|p| t_object_camera.inverse_transform_point(p)).collect();
    let mut specular = (wound.is_some() && params.specular_dropout > 0.0).then(|| stream(seed, Term::Specular, number));
    let mirror_cos = params.specular_deg.to_radians().cos();
    let projector = Point3::new(params.projector_mm, 0.0, 0.0);
    let (mut noise, mut dropout) = (stream(seed, Term::DepthNoise, number), stream(seed, Term::Dropout, number));
    let mut thinning = stream(seed, Term::Thinning, number);
    let n_at_edge = pixels.iter().filter(|pixel| pixel.at_edge).count();
    let outlier_share = params.edge_outliers * pixels.len() as f64 / n_at_edge.max(1) as f64;
    let mut outliers = (n_at_edge > 0).then(|| stream(seed, Term::EdgeOutliers, number));
    let within = |p: &Point3<f64>, centre: &Point3<f64>, radius_mm: f64| (p - centre).norm() < radius_mm;

    let mut kept: Vec<(u64, Point3<f64>, f64)> = Vec::with_capacity(pixels.len());
    for pixel in pixels {
        let (noise, drop, key) = (normal(&mut noise), dropout.random::<f64>(), thinning.random::<u64>());
        let outlier_mm = outliers.as_mut().map_or(0.0, |rng| {
            let (chance, error) = (rng.random::<f64>(), normal(rng));
            let is_outlier = pixel.at_edge && chance < outlier_share;
            if is_outlier { error * params.edge_outlier_mm * pixel.slanted(params) } else { 0.0 }
        });
        let shines = specular.as_mut().is_some_and(|rng| rng.random::<f64>() < params.specular_dropout);
        let truth = pixel.point();
        if drop < params.dropout
            || patches.iter().any(|centre| within(&truth, centre, params.patch_radius_mm))
            || hole.is_some_and(|hole| hole.takes(&pixel.lit()))
            || pools.iter().any(|centre| within(&truth, centre, params.pool_radius_mm))
        {
            continue;
        }
        if shines {
            // Specular reflection into the lens: the normal bisects the directions to projector and lens.
            let halfway = ((projector - truth).normalize() - pixel.ray).normalize();
            if t_object_camera.inverse_transform_vector(&pixel.normal).dot(&halfway) > mirror_cos {
                continue;
            }
        }
        let distance_mm = pixel.distance_mm - pixel.film_mm + pixel.noise_mm * noise + pixel.bias_mm + outlier_mm;
        let from_stamp_s = pixel.instant.map_or(0.0, |instant| instant.from_stamp_s);
        kept.push((key, Point3::from(pixel.ray * distance_mm), from_stamp_s));
    }
    if kept.len() > params.n_points {
        let mut keys: Vec<u64> = kept.iter().map(|(key, ..)| *key).collect();
        // Truncation keeps the lower index in the unlikely case of equal keys.
        let (_, &mut limit, _) = keys.select_nth_unstable(params.n_points - 1);
        kept.retain(|(key, ..)| *key <= limit);
        kept.truncate(params.n_points);
    }
    let points: Vec<Point3<f64>> = kept.iter().map(|(_, point, _)| *point).collect();
    let cloud = Cloud::new("camera", points)?.at(stamp_ns).seen_from(Isometry3::identity());
    if !params.point_times || wound.is_none() {
        return Ok(cloud);
    }
    cloud.with_extra("t", kept.iter().map(|(.., from_stamp_s)| *from_stamp_s).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use osteoflow_geometry::{Mesh, SurfaceOrigin};

    /// A square wall of 100 mm, 200 mm before the camera, its normal towards it.
    fn wall() -> MeshQuery {
        let corners = [[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]];
        let vertices: Vec<Point3<f64>> = corners.iter().map(|[x, y]| Point3::new(*x, *y, 200.0)).collect();
        MeshQuery::new(&Mesh::new("ct", SurfaceOrigin::Exact, vertices, vec![[0, 2, 1], [0, 3, 2]]).unwrap())
    }

    fn pixels(params: &CameraParams) -> Vec<Pixel> {
        let sight = Sight { object: &wall(), stretch: None, around: None, lumps: None };
        view(&sight, &Isometry3::identity(), params, &DepthBias::new(params, 1), None)
    }

    fn quiet() -> CameraParams {
        CameraParams {
            depth_noise_mm: 0.0,
            dropout: 0.0,
            n_patches: 0,
            depth_bias_mm: 0.0,
            surface_error_mm: 0.0,
            edge_outliers: 0.0,
            ..CameraParams::default()
        }
    }

    fn shot(pixels: &[Pixel]) -> Shot<'_> {
        Shot { pixels, t_object_camera: Isometry3::identity(), hole: None, wound: None, stamp_ns: 1, number: 1 }
    }

    /// The cloud before the surplus is dropped.
    fn left(pixels: &[Pixel], params: &CameraParams, seed: u64) -> Cloud {
        let all = CameraParams { n_points: pixels.len(), ..params.clone() };
        scan(&shot(pixels), &all, seed).unwrap()
    }

    #[test]
    fn the_grid_gives_the_requested_points_and_the_surplus_is_dropped() {
        let params = quiet();
        let pixels = pixels(&params);
        let share = pixels.len() as f64 / 20_000.0;
        assert!((1.08..1.16).contains(&share), "{share} pixels for each point");
        let cloud = scan(&shot(&pixels), &params, 1).unwrap();
        assert_eq!(cloud.len(), 20_000);
        assert!(cloud.points().iter().all(|p| (p.z - 200.0).abs() < 1e-9));
        assert_eq!(cloud.viewpoint, Some(Isometry3::identity()));
    }

    #[test]
    fn dropout_takes_its_share() {
        let params = CameraParams { dropout: 0.3, ..quiet() };
        let pixels = pixels(&params);
        let kept = left(&pixels, &params, 1).len() as f64 / pixels.len() as f64;
        // Four standard errors over 22,000 pixels.
        assert!((kept - 0.7).abs() < 0.013, "{kept} are kept");
    }

    #[test]
    fn patches_are_discs_of_their_radius_drawn_for_every_scan() {
        let params = CameraParams { n_patches: 3, patch_radius_mm: 4.0, ..quiet() };
        let pixels = pixels(&params);
        let lost = |seed: u64| pixels.len() - left(&pixels, &params, seed).len();
        let mean = (0..60).map(lost).sum::<usize>() as f64 / 60.0 / pixels.len() as f64;
        // Three discs in a wall of 100 x 100 mm; some overlap or reach over its edge.
        let discs = 3.0 * std::f64::consts::PI * 16.0 / 10_000.0;
        assert!((0.85 * discs..1.001 * discs).contains(&mean), "{mean} of the wall is lost, discs are {discs}");
        assert_ne!(left(&pixels, &params, 1), left(&pixels, &params, 2));
    }

    #[test]
    fn pixels_beyond_the_maximum_incidence_give_no_points() {
        // Seen from the wall's centre line, its edges are at up to 19.5 degrees.
        let limit_deg = 10.0;
        let pixels = pixels(&CameraParams { max_incidence_deg: limit_deg, ..quiet() });
        let steepest = pixels.iter().map(|p| p.cos_incidence).fold(1.0, f64::min).acos().to_degrees();
        assert!((9.8..=limit_deg).contains(&steepest), "{steepest} degrees");
    }

    #[test]
    fn a_hole_looks_smaller_at_an_edge_and_where_the_surface_turns_away() {
        let wall = wall();
        let sight = Sight { object: &wall, stretch: None, around: None, lumps: None };
        let share = |x: f64, y: f64, slant_deg: f64| {
            let spot = Point3::new(x, y, 200.0);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), slant_deg.to_radians());
            let t_object_camera = Translation3::from(spot) * turn * Translation3::from(-spot.coords);
            hole_share(&sight, &t_object_camera, &quiet(), &Hole { spot, radius_mm: 2.0, beam: None })
        };
        assert_eq!((share(0.0, 0.0, 0.0), share(54.0, 0.0, 0.0)), (1.0, 0.0));
        // A spiral of 256 rays measures areas to a hundredth.
        for (seen, expected) in [
            (share(50.0, 10.0, 0.0), 0.5),
            (share(-50.0, 50.0, 0.0), 0.25),
            (share(0.0, 0.0, 60.0), 0.5),
            (share(0.0, 0.0, 45.0), 0.5f64.sqrt()),
        ] {
            assert!((seen - expected).abs() < 0.025, "{seen} of the disc, {expected} expected");
        }
    }

    #[test]
    fn a_surface_behind_the_camera_is_not_seen() {
        let away = vec![Point3::new(0.0, 0.0, -200.0), Point3::new(9.0, 0.0, -200.0), Point3::new(0.0, 9.0, -200.0)];
        let mesh = Mesh::new("ct", SurfaceOrigin::Exact, away, vec![[0, 1, 2]]).unwrap();
        let sight = Sight { object: &MeshQuery::new(&mesh), stretch: None, around: None, lumps: None };
        assert!(view(&sight, &Isometry3::identity(), &quiet(), &DepthBias::new(&quiet(), 1), None).is_empty());
    }
}
