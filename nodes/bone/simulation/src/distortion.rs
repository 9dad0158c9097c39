//! What a CT, and the plan drawn on it, have different from the bone that is scanned.

use crate::plan::section_centre;
use crate::{BoneParams, SimulationError};
use nalgebra::{Matrix3, Point3, Rotation3, Unit, Vector3};
use osteoflow_geometry::{Anatomy, Mesh, SurgicalPlan};

/// A map from the bone as it is to the bone in its CT, about the middle of the landmarks.
pub(crate) struct Distortion {
    centre: Point3<f64>,
    /// Growth, stretch along z and shear of y by z.
    linear: Matrix3<f64>,
    /// Towards lateral, mm for each mm² along the bone.
    bend_per_mm: f64,
    twist_rad_per_mm: f64,
    anatomy: Anatomy,
    step: Option<Step>,
}

/// The motion of the distal part.
struct Step {
    at_mm: f64,
    /// The middle of the bone at the step.
    pivot: Point3<f64>,
    shift: Vector3<f64>,
    turn: Rotation3<f64>,
}

impl Distortion {
    /// `None` if nothing differs.
    pub(crate) fn new(params: &BoneParams, bone: &Mesh, plan: &SurgicalPlan) -> Result<Option<Self>, SimulationError> {
        let sizes = [
            params.stretch_percent,
            params.growth_percent,
            params.gantry_deg,
            params.bend_mm,
            params.twist_deg,
            params.step_mm,
            params.step_deg,
        ];
        if sizes.iter().all(|size| *size == 0.0) {
            return Ok(None);
        }
        let anatomy = plan.anatomy.clone().ok_or_else(SimulationError::no_anatomy)?;
        let landmarks = plan.landmarks.positions();
        let sum: Vector3<f64> = landmarks.iter().map(|p| p.coords).sum();
        let centre = Point3::from(sum / landmarks.len().max(1) as f64);
        let mut linear = Matrix3::identity() * (1.0 + params.growth_percent / 100.0);
        linear[(2, 2)] *= 1.0 + params.stretch_percent / 100.0;
        linear[(1, 2)] = params.gantry_deg.to_radians().tan();
        // The sagitta of an arc over a chord of 100 mm is its curvature times 50² / 2.
        const HALF_CHORD_MM: f64 = 50.0;
        let has_step = params.step_mm != 0.0 || params.step_deg != 0.0;
        let step = has_step.then(|| {
            Ok::<_, SimulationError>(Step {
                at_mm: params.step_at_mm,
                pivot: section_centre(bone, &anatomy, params.step_at_mm)?,
                shift: *anatomy.lateral * params.step_mm,
                turn: Rotation3::from_axis_angle(&anatomy.posterior, params.step_deg.to_radians()),
            })
        });
        Ok(Some(Self {
            centre,
            linear,
            bend_per_mm: params.bend_mm / HALF_CHORD_MM.powi(2),
            twist_rad_per_mm: params.twist_deg.to_radians() / 100.0,
            step: step.transpose()?,
            anatomy,
        }))
    }

    pub(crate) fn point(&self, point: &Point3<f64>) -> Point3<f64> {
        let Anatomy { proximal, lateral, malleolus_tip, .. } = &self.anatomy;
        let mut point = *point;
        if let Some(step) = self.step.as_ref().filter(|step| (point - malleolus_tip).dot(proximal) < step.at_mm) {
            point = step.pivot + step.turn * (point - step.pivot) + step.shift;
        }
        let off = point - self.centre;
        let along_mm = off.dot(proximal);
        let twisted = Rotation3::from_axis_angle(proximal, self.twist_rad_per_mm * along_mm) * off;
        self.centre + self.linear * (twisted + **lateral * (self.bend_per_mm * along_mm.powi(2)))
    }

    /// The direction at a point of the bone, of unit length.
    pub(crate) fn direction(&self, at: &Point3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        // Across a step, a difference would not be a derivative.
        const STEP_MM: f64 = 1e-3;
        let step = Unit::new_normalize(*v).into_inner() * STEP_MM;
        let sign = if step.dot(&self.anatomy.proximal) < 0.0 { -1.0 } else { 1.0 };
        (self.point(&(at + step * sign)) - self.point(at)).normalize() * sign
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Subject, assert_closed_and_outward};
    use osteoflow_geometry::{Plane, PlanePlace};

    fn subject(change: impl Fn(&mut BoneParams)) -> Subject {
        let mut params = BoneParams::default();
        change(&mut params);
        Subject::built_in(&params).unwrap()
    }

    /// Each point of the plan in the CT, beside that on the bone, from the middle of the landmarks.
    fn beside(change: impl Fn(&mut BoneParams)) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let (plain, other) = (subject(|_| ()), subject(change));
        assert_closed_and_outward(other.bone());
        let of = |subject: &Subject| {
            let plan = &subject.plan;
            let planes = plan.planes.planes.iter().filter_map(Plane::isometry).map(|t| t.translation.vector.into());
            [plan.landmarks.positions(), plan.assessment.positions(), planes.collect()].concat()
        };
        let landmarks = plain.plan.landmarks.positions();
        let centre = landmarks.iter().map(|p| p.coords).sum::<Vector3<f64>>() / landmarks.len() as f64;
        let (plain_points, points) = (of(&plain), of(&other));
        for point in &points[..8] {
            let off = other.surface.closest_point(point).unwrap().distance_mm;
            assert!(off < 0.02, "a planned point is {off} mm off the surface of the CT");
        }
        let pairs = points.iter().zip(&plain_points);
        pairs.map(|(a, b): (&Point3<f64>, &Point3<f64>)| (a.coords - centre, b.coords - centre)).collect()
    }

    #[test]
    fn a_ct_of_wrong_spacing_size_or_tilt_is_an_affine_image_with_the_plan_drawn_on_it() {
        for (in_ct, on_bone) in beside(|p| p.stretch_percent = 4.0) {
            let expected = Vector3::new(on_bone.x, on_bone.y, on_bone.z * 1.04);
            assert!((in_ct - expected).norm() < 1e-9, "{in_ct}, not {expected}");
        }
        for (in_ct, on_bone) in beside(|p| p.growth_percent = -3.0) {
            assert!((in_ct - on_bone * 0.97).norm() < 1e-9, "{in_ct}, not {}", on_bone * 0.97);
        }
        for (in_ct, on_bone) in beside(|p| p.gantry_deg = 15.0) {
            let expected = on_bone + Vector3::y() * on_bone.z * 15f64.to_radians().tan();
            assert!((in_ct - expected).norm() < 1e-9, "{in_ct}, not {expected}");
        }
    }

    #[test]
    fn a_planned_plane_has_the_points_of_the_plane_on_the_bone() {
        let (plain, tilted) = (subject(|_| ()), subject(|p| (p.gantry_deg, p.stretch_percent) = (15.0, 5.0)));
        let map = Distortion::new(
            &BoneParams { gantry_deg: 15.0, stretch_percent: 5.0, ..BoneParams::default() },
            plain.bone(),
            &plain.plan,
        );
        let map = map.unwrap().unwrap();
        for (on_bone, in_ct) in plain.plan.planes.planes.iter().zip(tilted.plan.planes.planes.iter()) {
            let (PlanePlace::Known(on_bone), PlanePlace::Known(in_ct)) = (&on_bone.place, &in_ct.place) else {
                panic!("the planes are known")
            };
            for [x, y] in [[5.0, 0.0], [0.0, 5.0], [-7.0, 3.0]] {
                let off = in_ct.inverse() * map.point(&(on_bone * Point3::new(x, y, 0.0)));
                // The directions are differences over a micrometre of coordinates of about 1000 mm.
                assert!(off.z.abs() < 1e-5, "a point of the cut is {} mm off the plane in the CT", off.z);
            }
        }
    }

    #[test]
    fn a_bend_has_its_sagitta_over_100_mm_and_a_twist_its_angle() {
        let plain = subject(|_| ());
        let map = |params| Distortion::new(&params, plain.bone(), &plain.plan).unwrap().unwrap();
        let bent = map(BoneParams { bend_mm: 2.0, ..BoneParams::default() });
        let (along, lateral) = (bent.anatomy.proximal, bent.anatomy.lateral);
        let [from, middle, to] = [-50.0, 0.0, 50.0].map(|mm| bent.point(&(bent.centre + *along * mm)));
        let sagitta = ((from.coords + to.coords) / 2.0 - middle.coords).dot(&lateral);
        assert!((sagitta - 2.0).abs() < 1e-9, "{sagitta} mm");
        let twisted = map(BoneParams { twist_deg: 6.0, ..BoneParams::default() });
        let aside = |mm: f64| {
            let on_axis = twisted.centre + *along * mm;
            twisted.point(&(on_axis + *lateral * 5.0)) - twisted.point(&on_axis)
        };
        let turn_deg = aside(-50.0).angle(&aside(50.0)).to_degrees();
        assert!((turn_deg - 6.0).abs() < 1e-6, "{turn_deg} degrees");
    }

    #[test]
    fn a_step_moves_the_distal_part_alone() {
        let pairs = beside(|p| (p.step_mm, p.step_at_mm) = (1.5, 110.0));
        let moved: Vec<f64> = pairs.iter().map(|(in_ct, on_bone)| (in_ct - on_bone).norm()).collect();
        // P1 to P3 at 100, 130 and 125 mm, M1 to M5 at 85 to 155 mm, the cuts at 180 and 214 mm.
        for (k, expected) in [1.5, 0.0, 0.0, 1.5, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0].into_iter().enumerate() {
            assert!((moved[k] - expected).abs() < 1e-9, "point {k} is moved by {} mm, not {expected}", moved[k]);
        }
    }
}
