use super::*;
use crate::morton;
use nalgebra::Point3;
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// Boxes of up to 2 mm along a Morton curve through a bar of 120 mm.
fn boxes(n: usize) -> Vec<Aabb> {
    let mut rng = ChaCha8Rng::seed_from_u64(n as u64);
    let mut point = |size: [f64; 3]| Vector3::from(size.map(|c| c * (rng.random::<f64>() - 0.5)));
    let corners: Vec<Point3<f64>> = (0..n).map(|_| Point3::from(point([20.0, 30.0, 120.0]))).collect();
    morton::order(&corners)
        .into_iter()
        .map(|i| Aabb::of(&[corners[i as usize].coords, corners[i as usize].coords + point([2.0; 3])]))
        .collect()
}

fn queries() -> Vec<Vector3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut at =
        |k: usize| Vector3::from([40.0, 40.0, 150.0].map(|c| c * (k % 3) as f64 * (rng.random::<f64>() - 0.5)));
    (0..60).map(|k| at(k + 1)).collect()
}

/// Distance between two boxes, mm.
fn gap(a: &Aabb, b: &Aabb) -> f64 {
    (a.min - b.max).sup(&(b.min - a.max)).sup(&Vector3::zeros()).norm()
}

/// Length of a ray before it enters a box and before it leaves it.
fn span(e: &Aabb, origin: &Vector3<f64>, direction: &Vector3<f64>) -> [f64; 2] {
    let sides = [0, 1, 2].map(|k| [e.min[k], e.max[k]].map(|side| (side - origin[k]) / direction[k]));
    [
        sides.iter().map(|[a, b]| a.min(*b)).fold(f64::NEG_INFINITY, f64::max),
        sides.iter().map(|[a, b]| a.max(*b)).fold(f64::INFINITY, f64::min),
    ]
}

/// The items found are those expected but for those that rounding (1e-3 mm) decides.
fn assert_found(mut items: Vec<usize>, distance_mm: impl Fn(usize) -> f64, n: usize, limit_mm: f64) {
    items.sort_unstable();
    assert!(items.windows(2).all(|two| two[0] < two[1]), "none twice");
    for k in 0..n {
        let (mm, is_found) = (distance_mm(k), items.binary_search(&k).is_ok());
        assert!(is_found || mm > limit_mm - 1e-3, "item {k} at {mm} mm is within {limit_mm} mm");
        assert!(!is_found || mm < limit_mm + 1e-3, "item {k} at {mm} mm is not within {limit_mm} mm");
    }
}

#[test]
fn a_search_visits_each_item_within_its_bound_and_no_other() {
    for n in [0, 1, 7, 8, 9, 64, 65, 700] {
        let boxes = boxes(n);
        let bvh = Bvh::new(&boxes);
        for (k, at) in queries().into_iter().enumerate() {
            let limit_mm = [1.0, 6.0, 30.0, 500.0][k % 4];
            let point = Aabb { min: at, max: at };
            let mut items = Vec::new();
            bvh.nearest(&at, limit_mm * limit_mm, |i| {
                items.push(i);
                limit_mm * limit_mm
            });
            assert_found(items, |i| gap(&boxes[i], &point), n, limit_mm);
            let query = Aabb { min: at, max: at + Vector3::new(3.0, 1.0, 7.0) };
            let mut items = Vec::new();
            bvh.within(&query, limit_mm, |i| items.push(i));
            assert_found(items, |i| gap(&boxes[i], &query), n, limit_mm);
        }
    }
}

#[test]
fn a_ray_visits_each_box_that_it_meets_within_its_bound_and_no_other() {
    let boxes = boxes(700);
    let bvh = Bvh::new(&boxes);
    let at = queries();
    for (k, towards) in at.iter().enumerate().skip(1) {
        for far_mm in [0.0, 300.0, 1e4] {
            let direction = (towards - at[k - 1]).normalize();
            let origin = at[k - 1] - direction * far_mm;
            let limit_mm = far_mm + [5.0, 60.0, 500.0][k % 3];
            let mut items = Vec::new();
            bvh.along(&origin, &direction, limit_mm, |i| {
                items.push(i);
                limit_mm
            });
            items.sort_unstable();
            assert!(items.windows(2).all(|two| two[0] < two[1]), "none twice");
            for (i, e) in boxes.iter().enumerate() {
                // Boxes are widened by the rounding of their largest coordinate, and lengths by 1e-5 of it.
                let widened = |by: f64| Aabb { min: e.min.add_scalar(-by), max: e.max.add_scalar(by) };
                let meets = |by: f64| {
                    let [enter, leave] = span(&widened(by), &origin, &direction);
                    enter.max(-by) <= leave + by && enter <= limit_mm + by && leave >= -by
                };
                let is_found = items.binary_search(&i).is_ok();
                assert!(is_found || !meets(-0.01), "ray {k} from {far_mm} mm meets box {i}");
                assert!(!is_found || meets(0.01), "ray {k} from {far_mm} mm does not meet box {i}");
            }
        }
    }
}

#[test]
fn a_nearest_item_is_found_after_a_few_dozen_of_700() {
    let boxes = boxes(700);
    let bvh = Bvh::new(&boxes);
    let (mut n_visits, mut n_met, mut n_rays) = (0, 0, 0);
    let at = queries();
    for at in &at {
        let distance = |i: usize| gap(&boxes[i], &Aabb { min: *at, max: *at });
        let first = bvh.near(at).unwrap();
        let mut bound = distance(first).powi(2) * 1.000_1 + 1e-6;
        bvh.nearest(at, bound, |i| {
            n_visits += 1;
            bound = bound.min(distance(i).powi(2));
            bound
        });
        let least = (0..700).map(distance).fold(f64::INFINITY, f64::min);
        assert!((bound.sqrt() - least).abs() < 2e-3, "{at}: {} mm is not {least} mm", bound.sqrt());
        // Through a box, from outside of all.
        let aimed = &boxes[n_rays * 11];
        n_rays += 1;
        let direction = ((aimed.min + aimed.max) / 2.0 - at).normalize();
        let origin = at - direction * 300.0;
        let enter = |i: usize| {
            let [enter, leave] = span(&boxes[i], &origin, &direction);
            if enter <= leave { enter } else { f64::INFINITY }
        };
        let mut nearest = f64::INFINITY;
        bvh.along(&origin, &direction, 1e3, |i| {
            n_met += 1;
            nearest = nearest.min(enter(i));
            nearest.min(1e3)
        });
        assert_eq!(nearest, (0..700).map(enter).fold(f64::INFINITY, f64::min), "ray towards {at}");
    }
    // Near nodes come first, so that the bound falls early: without that order it would be several times as many.
    assert_eq!(n_visits, 139, "visits of 60 queries");
    assert!((60..=75).contains(&n_met), "{n_met} visits of 60 rays, each through a box");
    assert_eq!(Bvh::new(&[]).near(&Vector3::zeros()), None);
}
