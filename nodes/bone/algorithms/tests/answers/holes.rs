//! Laser holes in scans of the own bone.

use super::BONE;
use super::text::{golden, outcome};
use crate::common::{CLEAN, Noise, USUAL, displaced};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::Refusal;
use osteoflow_algorithms::hole::{Hole, HoleParams, boundary, cloud_difference, range_image};
use osteoflow_geometry::Cloud;

const HEIGHTS: [f64; 2] = [130.0, 170.0];
const STEP_MM: f64 = 0.45;

/// The surface at a height above the tip, turned about the bone from the middle of the camera's view.
pub(crate) fn spot(height_mm: f64, turn_deg: f64) -> Point3<f64> {
    let camera = BONE.camera(150.0);
    let out = Isometry3::rotation(BONE.proximal * turn_deg.to_radians()) * -(camera * Vector3::z());
    let axis = BONE.camera(height_mm) * Point3::new(0.0, 0.0, 206.0);
    BONE.query.cast_ray(&(axis + out * 60.0), &-out).unwrap().point
}

/// A scan with discs left out.
pub(crate) fn scan(
    camera: &Isometry3<f64>,
    step_mm: f64,
    noise: &Noise,
    spots: &[(Point3<f64>, f64)],
    seed: u64,
) -> Cloud {
    let scan = BONE.scan(camera, HEIGHTS, step_mm, noise, None, seed);
    let lies = |p: &Point3<f64>| spots.iter().all(|(at, radius)| (p - at).norm() > *radius);
    scan.selected(&(0..scan.len()).filter(|&i| lies(&scan.points()[i])).collect::<Vec<_>>())
}

/// The answers of all detectors to a pair of scans.
fn described(name: &str, reference: &Cloud, laser: &Cloud, params: &HoleParams) -> String {
    type Detector = fn(&Cloud, &Cloud, &HoleParams) -> Result<Hole, Refusal>;
    let detectors: [(&str, Detector); 3] = [
        ("cloud_difference", cloud_difference),
        ("range_image", range_image),
        ("boundary", |_, laser, params| boundary(laser, params)),
    ];
    detectors.iter().map(|(by, find)| outcome(format!("{name}, {by}"), &find(reference, laser, params))).collect()
}

#[test]
fn a_spot_anywhere_on_the_bone_is_found_where_it_was() {
    let camera = BONE.camera(150.0);
    let moved = displaced(&Point3::from(camera.translation.vector), 5.0, 0.01, 4) * camera;
    let reference = scan(&camera, STEP_MM, &USUAL, &[], 21);
    let blind = Cloud::new("ct", reference.points().to_vec()).unwrap();
    let mut text = String::new();
    for turn_deg in [-75.0, -60.0, -30.0, 0.0, 20.0, 45.0, 55.0, 65.0, 80.0] {
        let at = spot(146.0, turn_deg);
        let laser = scan(&moved, STEP_MM, &USUAL, &[(at, 2.0)], 22);
        text += &described(&format!("turned {turn_deg} at {at:.3}"), &reference, &laser, &HoleParams::default());
        let strict = HoleParams { min_confidence_agreeing: 1.0, ..HoleParams::default() };
        text += &outcome("    one tier", &cloud_difference(&reference, &laser, &strict));
        text += &outcome("    no viewpoint", &cloud_difference(&blind, &laser, &HoleParams::default()));
    }
    golden("holes", &text);
}

#[test]
fn a_hole_of_another_size_or_at_the_end_of_the_scan_has_the_confidence_it_had() {
    let camera = BONE.camera(150.0);
    let reference = scan(&camera, STEP_MM, &CLEAN, &[], 31);
    let mut text = String::new();
    for radius_mm in [0.8, 1.2, 1.6, 2.5, 3.0, 4.0] {
        let laser = scan(&camera, STEP_MM, &CLEAN, &[(spot(150.0, 10.0), radius_mm)], 32);
        text += &described(&format!("radius {radius_mm}"), &reference, &laser, &HoleParams::default());
    }
    for height_mm in [128.5, 130.5, 132.0, 134.0, 169.0] {
        let laser = scan(&camera, STEP_MM, &CLEAN, &[(spot(height_mm, 0.0), 2.0)], 33);
        text += &described(&format!("height {height_mm}"), &reference, &laser, &HoleParams::default());
    }
    for spot_radius_mm in [1.2, 3.0] {
        let params = HoleParams { spot_radius_mm, min_confidence: 0.3, ..HoleParams::default() };
        let laser = scan(&camera, STEP_MM, &CLEAN, &[(spot(150.0, -20.0), spot_radius_mm)], 34);
        text += &described(&format!("a spot of {spot_radius_mm}"), &reference, &laser, &params);
    }
    golden("holes_sizes", &text);
}

#[test]
fn what_is_no_single_hole_is_refused_in_the_words_it_was() {
    let camera = BONE.camera(150.0);
    let reference = scan(&camera, STEP_MM, &CLEAN, &[], 41);
    let params = HoleParams::default();
    let with = |spots: &[(Point3<f64>, f64)]| scan(&camera, STEP_MM, &CLEAN, spots, 42);
    let one = with(&[(spot(150.0, 0.0), 2.0)]);
    let two = with(&[(spot(150.0, 0.0), 2.0), (spot(160.0, -10.0), 2.0)]);
    let near = with(&[(spot(150.0, 0.0), 2.0), (spot(155.0, 0.0), 1.9)]);
    let three = with(&[(spot(150.0, 0.0), 2.0), (spot(160.0, -10.0), 2.0), (spot(140.0, 10.0), 2.1)]);
    let none = with(&[]);
    let half = none.selected(
        &(0..none.len()).filter(|&i| (none.points()[i] - BONE.tip).dot(&BONE.proximal) < 150.0).collect::<Vec<_>>(),
    );
    let apart = one.transformed("ct", &Isometry3::translation(1.0, 1.0, 0.0));
    let sparse = |step: f64, seed| scan(&camera, step, &CLEAN, &[(spot(150.0, 0.0), 2.0)], seed);
    let sparse_reference = |step: f64| scan(&camera, step, &CLEAN, &[], 43);
    let empty = Cloud::new("ct", Vec::new()).unwrap().seen_from(camera);
    let blind = Cloud::new("ct", one.points().to_vec()).unwrap();
    let mut text = String::new();
    for (name, laser) in
        [("two", &two), ("near", &near), ("three", &three), ("none", &none), ("half", &half), ("apart", &apart)]
    {
        text += &described(name, &reference, laser, &params);
    }
    text += &described("sparse", &sparse_reference(1.2), &sparse(1.2, 44), &params);
    text += &described("a sparse laser scan", &reference, &sparse(0.9, 45), &params);
    text += &described("a sparse reference", &sparse_reference(0.9), &one, &params);
    text += &described("no laser scan", &reference, &empty, &params);
    text += &described("no reference", &empty, &one, &params);
    text += &described("no viewpoint", &reference, &blind, &params);
    text += &described("six points", &reference, &one.selected(&[0, 1, 2, 3, 4, 5]), &params);
    golden("holes_refused", &text);
}
