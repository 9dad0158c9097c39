//! Colour images of the scanned bone: shading, the laser's spot or a mark drawn with a pen, glare, saturation and noise.

use crate::camera::{Hole, Sight};
use crate::draws::{Term, normal, stream};
use crate::params::{ImageMark, ImageParams};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Image, ImageError, Intrinsics, StampNs};
use rand::RngExt;
use rayon::prelude::*;

/// Reflectance of bone, of soft tissue and of the dark around, red, green, blue. Assumed: ivory, and a red wound.
const BONE: [f64; 3] = [1.0, 0.92, 0.78];
const TISSUE: [f64; 3] = [0.55, 0.2, 0.18];
/// What is left of bone under the ink of a surgical pen. Assumed: gentian violet.
const INK: [f64; 3] = [0.38, 0.2, 0.7];
/// The share of the laser's light that each channel takes. Assumed: a colour filter leaks.
const LASER: [f64; 3] = [1.0, 0.1, 0.08];
/// Light that reaches a surface from everywhere, as a share of the lamp's.
const AMBIENT: f64 = 0.35;
/// Light scattered in the lens falls off over this share of the image's width.
const BLOOM_WIDTH: f64 = 0.012;
/// Share of the laser's light that is scattered.
const BLOOM: f64 = 0.004;
/// The laser's irradiance at the radius of its hole, relative to white. Assumed: the camera measures nothing down to there.
const AT_RIM: f64 = 0.12;

/// What the camera sees through one pixel.
#[derive(Clone, Copy)]
struct PixelSurface {
    /// Point, camera frame.
    point: Point3<f64>,
    reflectance: [f64; 3],
    /// Light from a lamp beside the lens, 0 to 1.
    shade: f64,
    on_bone: bool,
}

/// The rays of an image and where they meet the scene: the same for all images of one view.
pub(crate) struct View {
    intrinsics: Intrinsics,
    size: [u32; 2],
    seen: Vec<Option<PixelSurface>>,
}

/// What is in one image.
pub(crate) struct Shot<'a> {
    /// The laser's spot, camera frame; its hole gives shape and size.
    pub(crate) laser: &'a Hole,
    /// The mark on the bone, camera frame.
    pub(crate) mark: Point3<f64>,
    pub(crate) stamp_ns: StampNs,
    /// Number of the image in the run, which selects its random streams.
    pub(crate) number: u64,
}

impl View {
    pub(crate) fn new(sight: &Sight<'_>, t_object_camera: &Isometry3<f64>, params: &ImageParams) -> Self {
        let [width, height] = [params.width_px, params.height_px];
        let focal = f64::from(width) / 2.0 / (params.field_deg / 2.0).to_radians().tan();
        let middle = |side: u32| f64::from(side - 1) / 2.0;
        let intrinsics = Intrinsics::pinhole(focal, focal, middle(width), middle(height));
        let look = |index: usize| {
            let (x, y) = (index % width as usize, index / width as usize);
            let ray = intrinsics.ray([x as f64, y as f64]).expect("a pinhole has a ray through each pixel");
            look(sight, t_object_camera, ray.normalize())
        };
        let seen = (0..width as usize * height as usize).into_par_iter().map(look).collect();
        Self { intrinsics, size: [width, height], seen }
    }

    /// The image with its own glare and noise.
    pub(crate) fn image(&self, shot: &Shot<'_>, params: &ImageParams, seed: u64) -> Result<Image, ImageError> {
        let bone: Vec<Point3<f64>> = self.seen.iter().flatten().filter(|s| s.on_bone).map(|s| s.point).collect();
        let rng = &mut stream(seed, Term::ImageGlare, shot.number);
        let glare: Vec<Point3<f64>> =
            (0..params.n_glare).filter_map(|_| bone.get(rng.random_range(0..bone.len().max(1))).copied()).collect();
        let rng = &mut stream(seed, Term::ImageReflection, shot.number);
        let reflection = bone.get(rng.random_range(0..bone.len().max(1))).copied();
        // A Gaussian that falls from its peak to `AT_RIM` at the radius of the hole.
        let peak = params.laser_peak.max(2.0 * AT_RIM);
        let falloff = (peak / AT_RIM).ln() / (shot.laser.radius_mm * shot.laser.radius_mm);
        let laser =
            |hole: &Hole, point: &Point3<f64>, share: f64| share * peak * (-falloff * hole.off_mm(point).powi(2)).exp();
        let centre = self.intrinsics.pixel(&shot.laser.spot);
        let mut noise = stream(seed, Term::ImageNoise, shot.number);
        let mut pixels = Vec::with_capacity(self.seen.len() * 3);
        for (index, seen) in self.seen.iter().enumerate() {
            let mut light = [0.0; 3];
            if let Some(seen) = seen {
                let is_inked = params.mark == ImageMark::Pen
                    && seen.on_bone
                    && (seen.point - shot.mark).norm() < params.pen_radius_mm;
                let red = match params.mark {
                    ImageMark::Pen => 0.0,
                    ImageMark::Laser => {
                        let again = reflection.filter(|_| params.reflection > 0.0).map_or(0.0, |at| {
                            laser(&Hole { spot: at, beam: None, ..*shot.laser }, &seen.point, params.reflection)
                        });
                        laser(shot.laser, &seen.point, 1.0) + again
                    }
                };
                let shine: f64 = glare
                    .iter()
                    .map(|at| 4.0 * (-((seen.point - at).norm() / params.glare_radius_mm.max(1e-6)).powi(2)).exp())
                    .sum();
                for (k, light) in light.iter_mut().enumerate() {
                    let reflectance = if is_inked { BONE[k] * INK[k] } else { seen.reflectance[k] };
                    *light = params.exposure * reflectance * seen.shade + LASER[k] * red * seen.reflectance[k] + shine;
                }
            }
            if let Some([u, v]) = centre.filter(|_| params.mark == ImageMark::Laser) {
                let (x, y) = (index % self.size[0] as usize, index / self.size[0] as usize);
                let off = (x as f64 - u).hypot(y as f64 - v) / (BLOOM_WIDTH * f64::from(self.size[0]));
                light.iter_mut().zip(LASER).for_each(|(light, share)| *light += share * peak * BLOOM * (-off).exp());
            }
            for light in light {
                let level = 255.0 * light + params.noise_levels * normal(&mut noise);
                pixels.push(level.round().clamp(0.0, 255.0) as u8);
            }
        }
        Ok(Image::new("camera", self.size, 3, self.intrinsics, pixels)?.at(shot.stamp_ns))
    }
}

/// The first surface along a ray, whatever its slant.
fn look(sight: &Sight<'_>, t_object_camera: &Isometry3<f64>, ray: Vector3<f64>) -> Option<PixelSurface> {
    let (origin, along) = (Point3::from(t_object_camera.translation.vector), t_object_camera * ray);
    let cast = |surface: &MeshQuery| surface.cast_ray(&origin, &along);
    let bone = cast(sight.object)
        .filter(|hit| sight.stretch.is_none_or(|stretch| stretch.holds(&hit.point)))
        .map(|hit| (hit, BONE, true));
    let tissue = sight.around.into_iter().chain(sight.lumps).filter_map(cast).map(|hit| (hit, TISSUE, false));
    let (hit, reflectance, on_bone) =
        bone.into_iter().chain(tissue).min_by(|(a, ..), (b, ..)| a.distance_mm.total_cmp(&b.distance_mm))?;
    let facing = (-along.dot(&hit.normal)).max(0.0);
    let shade = AMBIENT + (1.0 - AMBIENT) * facing;
    Some(PixelSurface { point: Point3::from(ray * hit.distance_mm), reflectance, shade, on_bone })
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::{Mesh, SurfaceOrigin};

    /// A wall of 60 mm, 200 mm before the camera, with the laser at its centre, and the image at row and column.
    fn image(params: &ImageParams) -> Image {
        let corners = [[-30.0, -30.0], [30.0, -30.0], [30.0, 30.0], [-30.0, 30.0]];
        let vertices: Vec<Point3<f64>> = corners.iter().map(|[x, y]| Point3::new(*x, *y, 200.0)).collect();
        let wall =
            MeshQuery::new(&Mesh::new("ct", SurfaceOrigin::Exact, vertices, vec![[0, 2, 1], [0, 3, 2]]).unwrap());
        let sight = Sight { object: &wall, stretch: None, around: None, lumps: None };
        let spot = Point3::new(0.0, 0.0, 200.0);
        let shot = Shot { laser: &Hole { spot, radius_mm: 2.0, beam: None }, mark: spot, stamp_ns: 5, number: 2 };
        View::new(&sight, &Isometry3::identity(), params).image(&shot, params, 1).unwrap()
    }

    fn quiet() -> ImageParams {
        ImageParams { noise_levels: 0.0, n_glare: 0, ..ImageParams::default() }
    }

    #[test]
    fn the_lasers_core_is_white_its_ring_red_and_the_bone_around_ivory() {
        let image = image(&quiet());
        let mm = image.intrinsics().fx / 200.0;
        let at = |off_mm: f64| image.rgb((319.5 + off_mm * mm).round() as usize, 240);
        assert_eq!(at(0.0)[0], 255);
        let [red, green, _] = at(1.3);
        assert!(red == 255 && green < 200, "{red} {green}");
        let [red, green, blue] = at(6.0);
        assert!(red > green && green > blue && red < 200, "{red} {green} {blue}");
        assert_eq!(image.rgb(0, 0), [0; 3], "nothing is beyond the wall");
        assert_eq!((image.stamp_ns, image.frame.as_str()), (5, "camera"));
    }

    #[test]
    fn a_pen_leaves_a_violet_disc_and_no_laser() {
        let image = image(&ImageParams { mark: ImageMark::Pen, ..quiet() });
        let [red, green, blue] = image.rgb(320, 240);
        assert!(blue > red && red > green, "{red} {green} {blue}");
        let [red, ..] = image.rgb(335, 240);
        assert!(red < 200, "{red} beside the mark");
    }

    #[test]
    fn glare_saturates_all_channels_and_noise_has_its_size() {
        let glare = image(&ImageParams { n_glare: 1, ..quiet() });
        let white = |image: &Image| image.pixels().chunks_exact(3).filter(|p| p.iter().all(|c| *c == 255)).count();
        assert!(white(&glare) > white(&image(&quiet())) + 20);
        let (noisy, clean) = (image(&ImageParams { noise_levels: 3.0, ..quiet() }), image(&quiet()));
        let off = |k: usize| f64::from(noisy.pixels()[k]) - f64::from(clean.pixels()[k]);
        // A column of the wall beside the laser.
        let columns: Vec<usize> = (200..280).map(|row| (row * 640 + 260) * 3 + 1).collect();
        let sd = (columns.iter().map(|k| off(*k).powi(2)).sum::<f64>() / columns.len() as f64).sqrt();
        assert!((2.3..3.7).contains(&sd), "{sd} levels");
    }
}
