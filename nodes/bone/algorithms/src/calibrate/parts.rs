//! Which planes of the phantom the camera could see, and which the scan shows.

use super::pairs::{Faces, SAME_FACE_COS};
use crate::median::median;
use crate::mesh_query::MeshQuery;
use crate::nearest::Nearest;
use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Planes whose normals differ by less, and whose offsets by less than that of [`SAME_OFFSET_MM`], are one.
const SAME_NORMAL_COS: f64 = 0.9998;
const SAME_OFFSET_MM: f64 = 0.1;

/// Maximum number of planes of a phantom; more are a curved surface, which has no parts.
const MAX_PLANES: usize = 300;

/// Minimum visible area of a plane that is listed, mm²: the side of a block of 5 mm.
const MIN_AREA_MM2: f64 = 25.0;

/// Cosine of the incidence up to which a camera of structured light sees a face: 70 degrees.
const SEEN_COS: f64 = 0.34;

/// Distance by which a face before another hides it, mm.
const HIDES_MM: f64 = 0.5;

/// Maximum distance of a point from the plane that it is on, mm.
const ON_PLANE_MM: f64 = 3.0;

/// Minimum number of points from which the distance of a plane is estimated.
const MIN_POINTS: usize = 15;

/// A plane of the phantom's CAD that faces the camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhantomPart {
    /// Outward unit normal, in the phantom's frame.
    pub normal: [f64; 3],
    /// Distance of the plane from the phantom's origin along the normal, mm.
    pub at_mm: f64,
    /// Area that the camera could see, mm²: in front of other parts, at no more than 70 degrees of incidence.
    pub area_mm2: f64,
    /// Share of that area with points of the scan.
    pub seen_share: f64,
    /// Median distance of its points from the plane, mm, positive outside; none of fewer than 15.
    pub off_mm: Option<f64>,
}

/// The planes of the CAD that the camera could see, largest first; none of a curved surface.
pub(super) fn parts(
    faces: &Faces,
    query: &MeshQuery,
    scan: &OnCad<'_>,
    t_phantom_camera: &Isometry3<f64>,
) -> Vec<PhantomPart> {
    let eye = t_phantom_camera * Point3::origin();
    let (samples, normals) = (&faces.points, &faces.normals);
    let mut planes: Vec<(Vector3<f64>, f64, Vec<usize>)> = Vec::new();
    for (i, (point, normal)) in samples.iter().zip(normals.iter()).enumerate() {
        let offset = normal.dot(&point.coords);
        let is_same = |(n, at, _): &(Vector3<f64>, f64, Vec<usize>)| {
            n.dot(normal) > SAME_NORMAL_COS && (at - offset).abs() < SAME_OFFSET_MM
        };
        match planes.iter().position(is_same) {
            Some(plane) => planes[plane].2.push(i),
            None if planes.len() == MAX_PLANES => return Vec::new(),
            None => planes.push((*normal, offset, vec![i])),
        }
    }
    let is_visible = |i: &&usize| {
        let (sight, normal) = (samples[**i] - eye, normals[**i]);
        let distance_mm = sight.norm();
        -sight.dot(&normal) > SEEN_COS * distance_mm
            && query.cast_ray(&eye, &(sight / distance_mm)).is_none_or(|hit| hit.distance_mm > distance_mm - HIDES_MM)
    };
    let mut parts: Vec<PhantomPart> = planes
        .par_iter()
        .filter_map(|(normal, at_mm, of)| {
            let visible: Vec<usize> = of.iter().filter(is_visible).copied().collect();
            let area_mm2 = visible.len() as f64 * scan.sample_mm2;
            if area_mm2 < MIN_AREA_MM2 {
                return None;
            }
            let near = |i: &&usize| scan.shows(&samples[**i], normal);
            let n_seen = visible.iter().filter(near).count();
            let off_mm = scan.median_off(&visible.iter().map(|i| samples[*i]).collect::<Vec<_>>(), normal, *at_mm);
            let seen_share = n_seen as f64 / visible.len() as f64;
            Some(PhantomPart { normal: (*normal).into(), at_mm: *at_mm, area_mm2, seen_share, off_mm })
        })
        .collect();
    parts.sort_by(|a, b| b.area_mm2.total_cmp(&a.area_mm2));
    parts
}

/// A scan in the phantom's frame.
pub(super) struct OnCad<'a> {
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    tree: &'a Nearest,
    /// Distance within which a point of the CAD that was seen has a point of the scan, mm.
    reach_mm: f64,
    /// Area that a sample of the CAD stands for, mm².
    sample_mm2: f64,
}

impl<'a> OnCad<'a> {
    pub(super) fn new(
        points: Vec<Point3<f64>>,
        normals: Vec<Vector3<f64>>,
        tree: &'a Nearest,
        spacing_mm: f64,
        sample_mm2: f64,
    ) -> Self {
        Self { points, normals, tree, reach_mm: 3.0 * spacing_mm, sample_mm2 }
    }

    /// Whether points of the scan are on the plane, near a place on it.
    fn shows(&self, place: &Point3<f64>, normal: &Vector3<f64>) -> bool {
        self.tree.within(place, self.reach_mm.max(ON_PLANE_MM)).iter().any(|(i, _)| {
            let off = self.points[*i] - place;
            off.dot(normal).abs() <= ON_PLANE_MM
                && (off - normal * off.dot(normal)).norm() <= self.reach_mm
                && self.is_along(*i, normal)
        })
    }

    fn is_along(&self, i: usize, normal: &Vector3<f64>) -> bool {
        self.normals[i].dot(normal).abs() >= SAME_FACE_COS
    }

    fn median_off(&self, places: &[Point3<f64>], normal: &Vector3<f64>, at_mm: f64) -> Option<f64> {
        // Once each, however many places are near.
        let mut on: Vec<usize> = places
            .iter()
            .flat_map(|place| self.tree.within(place, ON_PLANE_MM))
            .map(|(i, _)| i)
            .filter(|i| self.is_along(*i, normal))
            .collect();
        on.sort_unstable();
        on.dedup();
        let mut off: Vec<f64> = on.iter().map(|i| normal.dot(&self.points[*i].coords) - at_mm).collect();
        off.retain(|mm| mm.abs() <= ON_PLANE_MM);
        (off.len() >= MIN_POINTS).then(|| median(&mut off))
    }
}
