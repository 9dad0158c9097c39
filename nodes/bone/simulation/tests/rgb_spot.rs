//! The laser's spot in colour images, beside the three detectors that see clouds alone, and images that do not belong to the scan.
//!
//! The detector's limits were set before any run, and a fault of its fit was mended on seeds 100 and 101; the tests take other seeds.
//! With `SLOW_TESTS` they take more, of more settings.

use nalgebra::{Isometry3, Point3};
use osteoflow_algorithms::Refusal;
use osteoflow_algorithms::hole::{
    Hole, HoleParams, Mark, RgbSpotParams, boundary, cloud_difference, range_image, rgb_spot,
};
use osteoflow_geometry::{Cloud, Image, Intrinsics};
use osteoflow_simulation::{ImageMark, LaserDisc, Procedure, ProcedureParams, Subject};
use std::sync::LazyLock;

fn params(shape_seed: u64) -> ProcedureParams {
    let mut params = ProcedureParams::default();
    params.bone.shape_seed = shape_seed;
    params.image.taken = true;
    params
}

fn subject(shape_seed: u64) -> &'static Subject {
    crate::common::shared::built_in(&params(shape_seed).bone)
}

/// Procedures on the built-in bones 2 and 4.
fn procedures(n: u64, change: impl Fn(&mut ProcedureParams)) -> Vec<Procedure> {
    let n = if std::env::var_os("SLOW_TESTS").is_some() { 10 * n } else { n };
    let of_bone = |shape_seed| {
        let (subject, mut params) = (subject(shape_seed), params(shape_seed));
        change(&mut params);
        (200..200 + n).filter_map(move |seed| Procedure::simulate_for(subject, &params, seed).ok())
    };
    [2, 4].into_iter().flat_map(of_bone).collect()
}

/// A procedure of each bone as the simulation makes it, for tests that change the image alone.
static PLAIN: LazyLock<Vec<Procedure>> = LazyLock::new(|| procedures(1, |_| ()));

/// The true spots, or marks, in the camera's frame, in which the clouds and images are.
fn spots(procedure: &Procedure, mark: ImageMark) -> Vec<Point3<f64>> {
    let truth = &procedure.truth;
    let t_camera_ct = truth.t_world_camera_at_scan.isometry.inverse() * truth.t_world_ct_at_scan.isometry;
    let points = if mark == ImageMark::Pen { &truth.laser_marks_ct } else { &truth.laser_spots_ct };
    points.points.iter().map(|p| t_camera_ct * p.position).collect()
}

fn find(procedure: &Procedure, k: usize, image: &Image) -> Result<Hole, Refusal> {
    let here = Isometry3::identity();
    rgb_spot(&procedure.scan, &procedure.laser[k], image, &here, &RgbSpotParams::default())
}

/// Confidence that counts by itself in `coarse.three_point`.
const CONFIDENT: f64 = 0.4;

/// Distances from the spots, those of confident ones, and reasons of the refusals.
#[derive(Default)]
struct Tally {
    mm: Vec<f64>,
    confident_mm: Vec<f64>,
    refused: Vec<String>,
}

impl Tally {
    fn add(&mut self, result: Result<Hole, String>, spot: &Point3<f64>) {
        match result {
            Ok(hole) => {
                let mm = (hole.centre - spot).norm();
                self.mm.push(mm);
                assert_eq!(hole.report.tier == 1, hole.confidence >= CONFIDENT, "{:?}", hole.report);
                if hole.confidence >= CONFIDENT {
                    self.confident_mm.push(mm);
                }
            }
            Err(reason) => self.refused.push(reason),
        }
    }
}

fn mean(mm: &[f64]) -> f64 {
    mm.iter().sum::<f64>() / mm.len().max(1) as f64
}

fn largest(mm: &[f64]) -> f64 {
    mm.iter().copied().fold(0.0, f64::max)
}

type Detector = fn(&Cloud, &Cloud, &HoleParams) -> Result<Hole, Refusal>;

#[test]
fn the_four_detectors_side_by_side() {
    let is_slow = std::env::var_os("SLOW_TESTS").is_some();
    let detectors: [(&str, Detector); 3] = [
        ("hole.cloud_difference", cloud_difference),
        ("hole.range_image", range_image),
        ("hole.boundary", |_, cloud, params| boundary(cloud, params)),
    ];
    type Change = fn(&mut ProcedureParams);
    // Limits on the mean and the largest error of the confident spots of `hole.rgb_spot`, mm. With a beam: half the spot's radius, and the
    // radius.
    let settings: [(&str, Change, [f64; 2]); 4] = [
        ("as shipped", |_| (), [0.2, 1.0]),
        ("laser disc `beam`", |p| p.laser.disc = LaserDisc::Beam, [1.0, 2.0]),
        ("10 highlights of 1.5 mm", |p| (p.image.n_glare, p.image.glare_radius_mm) = (10, 1.5), [0.2, 1.0]),
        ("from 30 degrees, P1 near the silhouette", |p| p.camera.view_azimuth_deg = 30.0, [0.3, 1.5]),
    ];
    for (setting, change, [mean_mm, worst_mm]) in settings.into_iter().take(if is_slow { 4 } else { 2 }) {
        let mut tallies: Vec<(&str, Tally)> = detectors.iter().map(|(name, _)| (*name, Tally::default())).collect();
        tallies.push(("hole.rgb_spot", Tally::default()));
        for procedure in procedures(1, change) {
            for (k, spot) in spots(&procedure, ImageMark::Laser).iter().enumerate() {
                let cloud = &procedure.laser[k];
                // Beside the fourth, of which alone something is asserted.
                for ((_, detect), (_, tally)) in detectors.iter().zip(&mut tallies).take(if is_slow { 3 } else { 0 }) {
                    let result = detect(&procedure.scan, cloud, &HoleParams::default());
                    tally.add(result.map_err(|e| e.to_string()), spot);
                }
                tallies[3].1.add(find(&procedure, k, &procedure.images[k]).map_err(|e| e.to_string()), spot);
            }
        }
        for (name, Tally { mm, confident_mm, refused }) in &tallies {
            let (n, n_confident) = (mm.len() + refused.len(), confident_mm.len());
            if n == 0 {
                continue;
            }
            let (result, confident) = ([mean(mm), largest(mm)], [mean(confident_mm), largest(confident_mm)]);
            println!(
                "| {setting} | `{name}` | {n} | {:.2} | {:.2} | {} | {n_confident} | {:.2} | {:.2} |",
                result[0],
                result[1],
                refused.len(),
                confident[0],
                confident[1]
            );
            if *name == "hole.rgb_spot" {
                refused.iter().for_each(|reason| println!("  {reason}"));
                assert!(mm.len() * 2 > n && n >= 6, "{setting}: {} of {n} are found", mm.len());
                assert!(n_confident * 3 > n, "{setting}: {n_confident} of {n} are confident");
                assert!(confident[0] < mean_mm && confident[1] < worst_mm, "{setting}: {confident:.2?} mm");
            }
        }
    }
}

/// The four detectors, given a procedure and the number of a spot.
fn all_four(p: &Procedure, k: usize) -> [(&'static str, Option<Hole>); 4] {
    let (scan, cloud, params) = (&p.scan, &p.laser[k], HoleParams::default());
    [
        ("hole.cloud_difference", cloud_difference(scan, cloud, &params).ok()),
        ("hole.range_image", range_image(scan, cloud, &params).ok()),
        ("hole.boundary", boundary(cloud, &params).ok()),
        ("hole.rgb_spot", find(p, k, &p.images[k]).ok()),
    ]
}

/// The limits of the rule were chosen on the bones 1, 3 and 5, seeds 0 to 19.
#[test]
fn a_slanted_beams_spot_is_within_its_radius_of_the_centre_or_has_a_low_confidence_and_says_why() {
    let n_seeds = if std::env::var_os("SLOW_TESTS").is_some() { 20 } else { 1 };
    for disc in [LaserDisc::Beam, LaserDisc::Ball] {
        let mut tallies: [Tally; 4] = Default::default();
        let mut n_doubtful = 0;
        for shape_seed in if n_seeds > 1 { vec![2, 4, 6] } else { vec![6] } {
            let (subject, mut params) = (subject(shape_seed), params(shape_seed));
            params.laser.disc = disc;
            for seed in 300..300 + n_seeds {
                let Ok(procedure) = Procedure::simulate_for(subject, &params, seed) else { continue };
                for (k, spot) in spots(&procedure, ImageMark::Laser).iter().enumerate() {
                    for ((name, result), tally) in all_four(&procedure, k).into_iter().zip(&mut tallies) {
                        let Some(hole) = result else {
                            tally.refused.push(name.into());
                            continue;
                        };
                        let mm = (hole.centre - spot).norm();
                        let what = format!(
                            "bone {shape_seed}, seed {seed}, P{}, {name}: {mm:.2} mm, {:?}",
                            k + 1,
                            hole.report
                        );
                        let uncertainty_mm = hole.report.centre_uncertainty_mm.unwrap();
                        // Half a millimetre besides: noise, and a beam tilted by more than is assumed.
                        if mm > uncertainty_mm + 0.5 {
                            n_doubtful += 1;
                        }
                        assert!(mm < 2.0 || (hole.confidence < CONFIDENT && uncertainty_mm > 1.0), "{what}");
                        tally.add(Ok(hole), spot);
                    }
                }
            }
        }
        let names = ["hole.cloud_difference", "hole.range_image", "hole.boundary", "hole.rgb_spot"];
        for (name, Tally { mm, confident_mm, refused }) in names.into_iter().zip(&tallies) {
            let n = mm.len() + refused.len();
            println!(
                "| {disc:?} | `{name}` | {n} | {} | {} | {:.2} | {:.2} | {:.2} |",
                refused.len(),
                confident_mm.len(),
                mean(confident_mm),
                largest(confident_mm),
                largest(mm)
            );
            // All but hole.boundary find nearly all spots; most discs are clear.
            assert!(name == "hole.boundary" || refused.len() * 5 < n, "{disc:?}, {name}: {} of {n}", refused.len());
            assert!(
                disc == LaserDisc::Beam || confident_mm.len() * 2 > mm.len(),
                "{name}: {} are confident",
                confident_mm.len()
            );
        }
        println!("{disc:?}: {n_doubtful} spots are more than 0.5 mm beyond the uncertainty that is reported");
    }
}

/// An image of the same camera with other pixels.
fn repainted(image: &Image, pixel: impl Fn(usize, usize) -> [u8; 3]) -> Image {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let pixels: Vec<u8> = (0..width * height).flat_map(|i| pixel(i % width, i / width)).collect();
    with_pixels(image, 3, *image.intrinsics(), pixels)
}

fn with_pixels(image: &Image, channels: u32, intrinsics: Intrinsics, pixels: Vec<u8>) -> Image {
    Image::new(image.frame.clone(), [image.width(), image.height()], channels, intrinsics, pixels).unwrap()
}

/// Every spot of a few procedures with an image that is wrong: its refusals.
fn refusals(what: &str, change: impl Fn(&Procedure, usize) -> Image) -> Vec<Refusal> {
    let mut errors = Vec::new();
    for procedure in PLAIN.iter() {
        for k in 0..3 {
            match find(procedure, k, &change(procedure, k)) {
                Ok(hole) => panic!("{what}, P{}: found at {}", k + 1, hole.centre),
                Err(error) => errors.push(error),
            }
        }
    }
    assert_eq!(errors.len(), 3 * PLAIN.len(), "{what}");
    println!("{what}: {}", errors[0]);
    errors
}

#[test]
fn red_and_blue_exchanged_are_recognized_by_the_blue_spot() {
    let bgr = |p: &Procedure, k: usize| {
        repainted(&p.images[k], |x, y| {
            let [red, green, blue] = p.images[k].rgb(x, y);
            [blue, green, red]
        })
    };
    for error in refusals("BGR", bgr) {
        assert!(error.to_string().ends_with("is the image BGR?"), "{error}");
    }
}

#[test]
fn a_mirrored_image_is_refused() {
    let across = |p: &Procedure, k: usize| {
        let image = &p.images[k];
        repainted(image, |x, y| image.rgb(image.width() as usize - 1 - x, y))
    };
    refusals("mirrored", across);
    let down = |p: &Procedure, k: usize| {
        let image = &p.images[k];
        repainted(image, |x, y| image.rgb(x, image.height() as usize - 1 - y))
    };
    refusals("upside down", down);
}

#[test]
fn an_image_of_another_scan_is_refused_by_the_hole_that_is_elsewhere() {
    for error in refusals("of the next landmark", |p, k| p.images[(k + 1) % 3].clone()) {
        assert!(error.to_string().starts_with("the image shows the laser at"), "{error}");
    }
}

#[test]
fn intrinsics_of_half_the_resolution_and_of_another_lens_are_refused() {
    let scaled = |share: f64, of_centre: f64| {
        move |p: &Procedure, k: usize| {
            let (image, Intrinsics { fx, fy, cx, cy, .. }) = (&p.images[k], *p.images[k].intrinsics());
            let wrong = Intrinsics::pinhole(fx * share, fy * share, cx * of_centre, cy * of_centre);
            with_pixels(image, 3, wrong, image.pixels().to_vec())
        }
    };
    refusals("half the resolution", scaled(0.5, 0.5));
    // A spot near the principal point hardly moves with the focal length.
    let (mut n_refused, mut n) = (0, 0);
    for procedure in PLAIN.iter() {
        for (k, spot) in spots(procedure, ImageMark::Laser).iter().enumerate() {
            n += 1;
            match find(procedure, k, &scaled(1.15, 1.0)(procedure, k)) {
                Err(_) => n_refused += 1,
                Ok(hole) => assert!((hole.centre - spot).norm() < 2.0, "P{} is at {}", k + 1, hole.centre),
            }
        }
    }
    assert!(n_refused * 2 > n, "{n_refused} of {n} are refused");
    let (image, Intrinsics { fx, fy, cx, cy, .. }) = {
        let image = &PLAIN[0].images[0];
        (image, *image.intrinsics())
    };
    let twice = Intrinsics::pinhole(2.0 * fx, 2.0 * fy, 2.0 * cx + 0.5, 2.0 * cy + 0.5);
    let error = Image::new("camera", [image.width(), image.height()], 3, twice, image.pixels().to_vec()).unwrap_err();
    assert!(error.to_string().contains("another resolution"), "{error}");
}

#[test]
fn an_image_of_a_camera_beside_needs_its_pose() {
    for procedure in PLAIN.iter() {
        let cloud = &procedure.laser[0];
        // The scan as a sensor 25 mm beside the lens of the image would give it.
        let t_camera_image = Isometry3::translation(25.0, 0.0, 0.0);
        let beside = |c: &Cloud| {
            let mut moved = c.transformed("camera", &t_camera_image);
            moved.viewpoint = Some(Isometry3::identity());
            moved
        };
        let (scan, laser) = (beside(&procedure.scan), beside(cloud));
        let find = |pose: &Isometry3<f64>| rgb_spot(&scan, &laser, &procedure.images[0], pose, &Default::default());
        let hole = find(&t_camera_image).unwrap();
        let spot = t_camera_image * spots(procedure, ImageMark::Laser)[0];
        assert!((hole.centre - spot).norm() < 1.0, "{} mm", (hole.centre - spot).norm());
        let error = find(&Isometry3::identity()).unwrap_err();
        println!("without the pose: {error}");
    }
}

#[test]
fn a_black_a_saturated_and_a_grey_image_are_refused_as_such() {
    let level = |of: [u8; 3]| move |p: &Procedure, k: usize| repainted(&p.images[k], |_, _| of);
    for error in refusals("black", level([3; 3])) {
        assert!(error.to_string().starts_with("the image is black at"), "{error}");
    }
    for error in refusals("saturated", level([255; 3])) {
        assert!(error.to_string().starts_with("the image is saturated at"), "{error}");
    }
    for error in refusals("all red", level([255, 10, 10])) {
        assert!(!error.to_string().starts_with("the image shows the laser at"), "{error}");
    }
    let grey = |p: &Procedure, k: usize| {
        let image = &p.images[k];
        let green: Vec<u8> = image.pixels().chunks_exact(3).map(|rgb| rgb[1]).collect();
        with_pixels(image, 1, *image.intrinsics(), green)
    };
    for error in refusals("grey", grey) {
        assert!(error.to_string().starts_with("the image is grey"), "{error}");
    }
}

#[test]
fn an_image_without_the_laser_is_refused() {
    // The image of a pen's mark, with the laser off.
    let procedures = procedures(1, |p| p.image.mark = ImageMark::Pen);
    for procedure in &procedures {
        for k in 0..3 {
            let error = find(procedure, k, &procedure.images[k]).unwrap_err();
            assert!(error.to_string().contains("is the laser on and red"), "{error}");
        }
    }
}

#[test]
fn a_second_reflection_of_the_laser_never_takes_the_place_of_the_spot() {
    let (mut n, mut n_refused) = (0, 0);
    for reflection in [0.1, 0.5, 1.0] {
        for procedure in procedures(1, |p| p.image.reflection = reflection) {
            for (k, spot) in spots(&procedure, ImageMark::Laser).iter().enumerate() {
                n += 1;
                match find(&procedure, k, &procedure.images[k]) {
                    Ok(hole) => {
                        let mm = (hole.centre - spot).norm();
                        assert!(mm < 1.5, "P{}: {mm:.1} mm, reflection {reflection}", k + 1);
                    }
                    Err(error) => {
                        n_refused += 1;
                        println!("{reflection}: {error}");
                    }
                }
            }
        }
    }
    assert!(n_refused * 3 > n, "{n_refused} of {n} are refused");
}

#[test]
fn a_mark_of_a_pen_is_found_and_two_are_refused() {
    let pen = RgbSpotParams { mark: Mark::Pen, spot_radius_mm: 1.0, ..RgbSpotParams::default() };
    let here = Isometry3::identity();
    let (mut n, mut n_found, mut n_both) = (0, 0, 0);
    for procedure in procedures(2, |p| p.image.mark = ImageMark::Pen) {
        for (k, mark) in spots(&procedure, ImageMark::Pen).iter().enumerate() {
            let image = &procedure.images[k];
            n += 1;
            let hole = match rgb_spot(&procedure.scan, &procedure.scan, image, &here, &pen) {
                Ok(hole) => hole,
                Err(error) => {
                    println!("P{}: {error}", k + 1);
                    continue;
                }
            };
            n_found += 1;
            let mm = (hole.centre - mark).norm();
            assert!(mm < 0.5, "P{}: {mm:.2} mm from the mark", k + 1);
            // Another mark in the same image: the darker of both pixels.
            let other = &procedure.images[(k + 1) % 3];
            if rgb_spot(&procedure.scan, &procedure.scan, other, &here, &pen).is_err() {
                continue; // too slanted to be bright enough
            }
            n_both += 1;
            let both = repainted(image, |x, y| {
                let (a, b) = (image.rgb(x, y), other.rgb(x, y));
                if a[1] < b[1] { a } else { b }
            });
            let error = rgb_spot(&procedure.scan, &procedure.scan, &both, &here, &pen).unwrap_err();
            assert!(error.to_string().starts_with("2 violet or blue spots look alike"), "{error}");
        }
    }
    println!("{n_found} of {n} marks are found, {n_both} pairs are refused");
    assert!(n_found * 2 >= n && n_both >= 2, "{n_found} of {n} are found, {n_both} pairs refused");
}

#[test]
fn images_change_nothing_else_of_a_procedure_and_are_the_same_again() {
    let subject = subject(2);
    let without = Procedure::simulate_for(subject, &ProcedureParams::default(), 7).unwrap();
    let with = Procedure::simulate_for(subject, &params(2), 7).unwrap();
    assert_eq!((without.images.len(), with.images.len()), (0, 3));
    assert_eq!(with, Procedure::simulate_for(subject, &params(2), 7).unwrap());
    let stamps = |p: &Procedure| p.laser.iter().map(|c| (c.stamp_ns, c.label.clone())).collect::<Vec<_>>();
    assert_eq!(stamps(&with), with.images.iter().map(|i| (i.stamp_ns, i.label.clone())).collect::<Vec<_>>());
    assert_eq!(Procedure { images: Vec::new(), ..with }, without);
}
