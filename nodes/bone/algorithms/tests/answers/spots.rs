//! Laser spots and pen marks in colour images of the own bone.

use super::BONE;
use super::holes::{scan, spot};
use super::text::{golden, outcome};
use crate::common::CLEAN;
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::hole::{Mark, RgbSpotParams, rgb_spot};
use osteoflow_geometry::{Image, Intrinsics};

const SIZE: [u32; 2] = [150, 70];
const INTRINSICS: Intrinsics = Intrinsics::pinhole(620.0, 600.0, 76.0, 33.0);

/// What a colour camera sees: bone by its slope to the light, a background, and what `paint` lays over the bone.
fn image(camera: &Isometry3<f64>, paint: impl Fn(&Point3<f64>) -> Option<[u8; 3]>) -> Image {
    let mut pixels = Vec::new();
    for v in 0..SIZE[1] {
        for u in 0..SIZE[0] {
            let ray = (camera * INTRINSICS.ray([f64::from(u), f64::from(v)]).unwrap()).normalize();
            let hit = BONE.query.cast_ray(&Point3::from(camera.translation.vector), &ray);
            let colour = hit.map(|hit| {
                let light = -hit.normal.dot(&ray);
                paint(&hit.point).unwrap_or([200.0, 175.0, 150.0].map(|c| (c * light) as u8))
            });
            pixels.extend(colour.unwrap_or([20, 60, 40]));
        }
    }
    Image::new("image", SIZE, 3, INTRINSICS, pixels).unwrap()
}

/// A laser's spot: white within a red ring.
fn laser(at: Point3<f64>, radius_mm: f64) -> impl Fn(&Point3<f64>) -> Option<[u8; 3]> {
    move |p| match (p - at).norm() / radius_mm {
        r if r < 0.5 => Some([255, 252, 251]),
        r if r < 1.0 => Some([240, (60.0 + 90.0 * (r - 0.5)) as u8, 70]),
        _ => None,
    }
}

#[test]
fn a_mark_in_the_image_is_found_where_it_was_or_refused_in_the_same_words() {
    let camera = BONE.camera(150.0);
    let t_camera_image = Isometry3::new(Vector3::new(4.0, -3.0, 1.0), Vector3::new(0.01, -0.02, 0.005));
    let eye = camera * t_camera_image;
    let params = RgbSpotParams::default();
    let pen = RgbSpotParams { mark: Mark::Pen, min_contrast: 20.0, ..params.clone() };
    let reference = scan(&camera, 0.5, &CLEAN, &[], 51);
    let mut text = String::new();
    for turn_deg in [-70.0, -40.0, 0.0, 25.0, 50.0, 65.0] {
        let at = spot(147.0, turn_deg);
        let hole = scan(&camera, 0.5, &CLEAN, &[(at, 2.0)], 52);
        let result = rgb_spot(&reference, &hole, &image(&eye, laser(at, 2.0)), &t_camera_image, &params);
        text += &outcome(format!("turned {turn_deg} at {at:.3}"), &result);
        let mark = image(&eye, |p| ((p - at).norm() < 1.7).then_some([60, 40, 120]));
        text += &outcome("    a pen's mark", &rgb_spot(&reference, &reference, &mark, &t_camera_image, &pen));
    }
    let (at, other) = (spot(150.0, 0.0), spot(158.0, 12.0));
    let hole = scan(&camera, 0.5, &CLEAN, &[(at, 2.0)], 53);
    let seen = image(&eye, laser(at, 2.0));
    let mut find = |name: &str, image: &Image, params: &RgbSpotParams| {
        text += &outcome(name, &rgb_spot(&reference, &hole, image, &t_camera_image, params));
    };
    for radius_mm in [0.6, 1.0, 1.5, 3.0, 4.5] {
        find(&format!("a spot of {radius_mm}"), &image(&eye, laser(at, radius_mm)), &params);
        let smaller = RgbSpotParams { spot_radius_mm: 1.2, ..params.clone() };
        find("    1.2 expected", &image(&eye, laser(at, radius_mm)), &smaller);
    }
    find("two", &image(&eye, |p| laser(at, 2.0)(p).or(laser(other, 2.0)(p))), &params);
    find("a large one and a small one", &image(&eye, |p| laser(at, 2.0)(p).or(laser(other, 1.2)(p))), &params);
    find("half of it covered", &image(&eye, |p| laser(at, 2.0)(p).filter(|_| p.x > at.x)), &params);
    find(
        "glare beside it",
        &image(&eye, |p| match (p - at).x {
            x if x > 1.2 => Some([255; 3]),
            _ => laser(at, 2.0)(p),
        }),
        &params,
    );
    find("another place than the hole", &image(&eye, laser(other, 2.0)), &params);
    let lenient = RgbSpotParams { require_hole: false, ..params.clone() };
    find("another place, no hole needed", &image(&eye, laser(other, 2.0)), &lenient);
    find("none", &image(&eye, |_| None), &params);
    find("a pen's mark for a laser", &image(&eye, |p| ((p - at).norm() < 1.7).then_some([60, 40, 120])), &params);
    find("black", &image(&eye, |p| (p.z > at.z - 4.0).then_some([12, 12, 12])), &params);
    find("saturated", &image(&eye, |p| (p.z > at.z - 4.0).then_some([250, 200, 100])), &params);
    find("contrast", &seen, &RgbSpotParams { min_contrast: 150.0, ..params.clone() });
    find("confidence", &seen, &RgbSpotParams { min_confidence: 0.999, ..params.clone() });
    let exchanged: Vec<u8> = seen.pixels().chunks_exact(3).flat_map(|c| [c[2], c[1], c[0]]).collect();
    find("red and blue exchanged", &Image::new("image", SIZE, 3, INTRINSICS, exchanged).unwrap(), &params);
    let grey: Vec<u8> = seen.pixels().chunks_exact(3).map(|c| c[0]).collect();
    find("grey", &Image::new("image", SIZE, 1, INTRINSICS, grey).unwrap(), &params);
    let zoomed = Intrinsics { fx: 6200.0, ..INTRINSICS };
    find("another lens", &Image::new("image", SIZE, 3, zoomed, seen.pixels().to_vec()).unwrap(), &params);
    golden("spots", &text);
}
