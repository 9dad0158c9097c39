//! What the scan shows of the phantom, and what of its calibration it leaves open.

use super::align::MIN_HOLD_MM;
use super::contradicted::{Contradiction, contradicted};
use super::mirror::mirrored_mm;
use super::pairs::{Faces, Scan, capped_rms_mm, distances, on_faces};
use super::parts::{OnCad, PhantomPart, parts};
use super::turned::best_turned;
use crate::median::median;
use crate::mesh_query::MeshQuery;
use crate::nearest::Nearest;
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Another pose fits as well if it leaves less than this times the distances of the fit.
const AS_WELL: f64 = 1.2;

/// Share of a plane with points below which it counts as not seen.
const SEEN_SHARE: f64 = 0.2;

/// Neighbour of a point whose distance is the spacing of the scan.
const SPACING_OF: usize = 4;

/// A scale is told if it differs from 1 by more than this, and by four of its standard deviations: 1 mm at 200 mm.
const TOLD_SCALE: f64 = 0.005;
const SCALE_SIGMAS: f64 = 4.0;

/// What a scan shows of the phantom.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PhantomShown {
    /// The planes of the CAD that the camera could see, largest first; none of a curved phantom.
    pub parts: Vec<PhantomPart>,
    /// Points that the camera sees through the CAD: the CAD has a part that the phantom lacks.
    pub through: Contradiction,
    /// Points before the CAD: the phantom has a part that the CAD lacks, or something is before it.
    pub before: Contradiction,
    /// The turn of the phantom about its own axes in which it fits best of all others: rotation vector, rad. None of a phantom without
    /// planes.
    pub turned_rad: Option<[f64; 3]>,
    /// RMS distance of its points there, each counted as at most `3 max_rms_mm`, mm.
    pub turned_rms_mm: Option<f64>,
    /// The same of their mirror image.
    pub mirrored_rms_mm: Option<f64>,
    /// The same in the fit, of the points near the CAD: with what stands around the phantom all poses would be alike.
    pub near_rms_mm: f64,
}

/// The body and the scan of a fit.
pub(super) struct Fitted<'a> {
    pub(super) query: &'a MeshQuery,
    pub(super) faces: &'a Faces,
    pub(super) scan: &'a Scan,
    /// Number of points that are registered in other poses.
    pub(super) n_thin: usize,
    pub(super) t_phantom_camera: &'a Isometry3<f64>,
    pub(super) noise_mm: f64,
    pub(super) max_mm: f64,
    pub(super) cap_mm: f64,
    /// Area of the CAD's surface that a sample stands for, mm².
    pub(super) sample_mm2: f64,
}

impl PhantomShown {
    pub(super) fn of(fit: &Fitted<'_>) -> Self {
        let t = fit.t_phantom_camera;
        let points: Vec<Point3<f64>> = fit.scan.points.iter().map(|p| t * p).collect();
        let normals: Vec<Vector3<f64>> = fit.scan.normals.iter().map(|n| t * n).collect();
        let tree = Nearest::new(&points);
        let near = |p: &Point3<f64>| tree.nearest_n(p, SPACING_OF + 1).last().map_or(0.0, |(_, square)| square.sqrt());
        let mut spacings: Vec<f64> = points.iter().step_by(points.len().div_ceil(1000)).map(near).collect();
        let spacing_mm = median(&mut spacings);
        let [through, before] = contradicted(fit.query, fit.faces, &points, &tree, t, fit.noise_mm);
        let on_cad = OnCad::new(points, normals, &tree, spacing_mm, fit.sample_mm2);
        let parts = parts(fit.faces, fit.query, &on_cad, t);
        // Samples of the CAD's surface are about the root of their area apart.
        let near = fit.scan.near(fit.faces, t, fit.cap_mm + fit.sample_mm2.sqrt()).thinned(fit.n_thin);
        let turned = best_turned(fit.faces, &near, &parts, t, fit.max_mm, fit.cap_mm);
        let mirrored_rms_mm = mirrored_mm(fit.faces, &near, t, t, fit.max_mm, fit.cap_mm);
        let of_fit = distances(&on_faces(fit.faces, &near, t, fit.max_mm));
        Self {
            parts,
            through,
            before,
            turned_rad: turned.map(|(turn, _)| turn),
            turned_rms_mm: turned.map(|(_, rms_mm)| rms_mm),
            mirrored_rms_mm,
            near_rms_mm: capped_rms_mm(&of_fit, near.points.len(), fit.cap_mm),
        }
    }

    /// Whether the scan fits as well in a pose that leaves this `capped_rms_mm`.
    pub(super) fn is_as_well(&self, rms_mm: Option<f64>) -> bool {
        rms_mm.is_some_and(|rms_mm| rms_mm < AS_WELL * self.near_rms_mm)
    }

    /// What the user should know of the calibration, one sentence each.
    pub(super) fn notes(&self, scale: Option<(f64, f64)>, working_distance_mm: f64) -> Vec<String> {
        let mut notes = Vec::new();
        let unseen: Vec<&PhantomPart> = self.parts.iter().filter(|part| part.seen_share < SEEN_SHARE).collect();
        if let Some(largest) = unseen.first() {
            let (of, all, [x, y, z]) = (unseen.len(), self.parts.len(), largest.normal);
            notes.push(format!(
                "of the {all} planes of the phantom that face the camera {of} have no points: the largest has the normal ({x:.2}, {y:.2}, \
                 {z:.2}), at {:.1} mm, and {:.0} mm2",
                largest.at_mm, largest.area_mm2
            ));
        }
        match scale {
            None => notes.push(format!(
                "the seen faces do not determine the scale of the scan (a change by a factor of e leaves less than {MIN_HOLD_MM} mm): that \
                 camera, CAD and print are of one size is not checked"
            )),
            Some((scale, sd)) if (scale - 1.0).abs() > TOLD_SCALE.max(SCALE_SIGMAS * sd) => notes.push(format!(
                "the phantom's scan is {:.1} +- {:.1} % too {}: at {working_distance_mm} mm it moves the calibration by {:.1} mm; print and \
                 camera are of one size within the limit, max_scale_error",
                (scale - 1.0).abs() * 100.0,
                sd * 100.0,
                if scale > 1.0 { "large" } else { "small" },
                (scale - 1.0).abs() * working_distance_mm
            )),
            Some(_) => {}
        }
        if self.is_as_well(self.mirrored_rms_mm) {
            notes.push("the seen faces do not tell the scan from its mirror image: a flipped axis of the camera is not recognized".into());
        }
        if let (Some(turn), true) = (self.turned_rad.map(Vector3::from), self.is_as_well(self.turned_rms_mm)) {
            let ([x, y, z], deg): ([f64; 3], f64) = (turn.normalize().into(), turn.norm().to_degrees());
            notes.push(format!(
                "the phantom fits as well when it is turned by {deg:.0} degrees about ({x:.2}, {y:.2}, {z:.2}): the seen faces do not tell which \
                 way it stands, and the nominal pose decided; is the phantom's marker mounted as in its CAD?"
            ));
        }
        notes
    }
}
