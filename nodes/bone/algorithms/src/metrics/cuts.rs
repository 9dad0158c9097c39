use super::paired::{not_finite, nothing, unpaired};
use crate::Refusal;
use crate::{
    fragment::{REACH_MM, known},
    section,
};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Axes, Mesh, Plane, Planes};
use serde::{Deserialize, Serialize};

/// Errors of the achieved cuts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CutsReport {
    /// Each planned plane.
    pub cuts: Vec<CutReport>,
    /// The segments between consecutive planes of the plan.
    pub segments: Vec<SegmentReport>,
    /// Number of planes.
    pub n: usize,
}

/// Errors of one achieved cut.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CutReport {
    /// The plane's name.
    pub name: String,
    /// Centre of the bone's outline in the planned plane, mm, in the planes' frame.
    pub at: [f64; 3],
    /// Distance along the planned normal from there to the achieved plane, mm: `(o' - c) · n' / (n · n')`.
    pub offset_mm: f64,
    /// Angle between the normals, rad: `acos(n · n')`.
    pub tilt_rad: f64,
    /// Rotation about the bone's z axis, rad, right-handed: the twist about z of the motion between the planes.
    pub roll_rad: f64,
    /// Displacement of the point `at` by that motion, mm. None in reports of older recordings.
    #[serde(default)]
    pub moved_mm: Option<f64>,
}

/// The length of the segment between two cuts, from centre to centre.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SegmentReport {
    /// The first plane.
    pub from: String,
    /// The second plane.
    pub to: String,
    /// As planned, mm.
    pub planned_mm: f64,
    /// As achieved, mm.
    pub achieved_mm: f64,
    /// Achieved minus planned, mm.
    pub difference_mm: f64,
}

/// Achieved planes against planned ones of the same names, all in one frame (usually `ct`, where the achieved planes
/// come through the true or measured registration).
///
/// Offsets are measured at the centre of the outline in which the planned plane cuts `bone`; without a bone, at the
/// plane's origin.
///
/// # Errors
/// [`Refusal`] if there is no plane, one has no counterpart or is unknown, or frames differ.
pub fn cuts(planned: &Planes, achieved: &Planes, axes: &Axes, bone: Option<&Mesh>) -> Result<CutsReport, Refusal> {
    let named = [(&achieved.frame, "the achieved planes"), (&axes.frame, "the axes")];
    for (frame, what) in named.into_iter().chain(bone.map(|bone| (&bone.frame, "the bone"))) {
        frame.expect(&planned.frame, what).map_err(Refusal::of)?;
    }
    if planned.planes.is_empty() {
        return Err(nothing("planned plane"));
    }
    let along = axes.columns.column(2).into_owned();
    let mut cuts = Vec::new();
    let mut middles = Vec::new();
    for plane in planned.planes.iter() {
        let counterpart = achieved
            .planes
            .iter()
            .find(|p| p.name == plane.name)
            .ok_or_else(|| unpaired(&plane.name, "achieved", achieved.planes.iter().map(|p| &*p.name)))?;
        let (plan, cut) = (known(plane)?, known(counterpart)?);
        let middle = bone.and_then(|bone| section::middle(bone, plan, Some(REACH_MM)));
        let at = middle.unwrap_or_else(|| plan * Point3::origin());
        let report = compare(&plane.name, plan, cut, &at, &along);
        if !report.offset_mm.is_finite() {
            return Err(not_finite(&format!("the offset of {}", plane.name)));
        }
        middles.push((at, at + plan * Vector3::z() * report.offset_mm));
        cuts.push(report);
    }
    let segments = cuts
        .windows(2)
        .zip(middles.windows(2))
        .map(|(cuts, middles)| {
            let planned_mm = (middles[1].0 - middles[0].0).norm();
            let achieved_mm = (middles[1].1 - middles[0].1).norm();
            SegmentReport {
                from: cuts[0].name.clone(),
                to: cuts[1].name.clone(),
                planned_mm,
                achieved_mm,
                difference_mm: achieved_mm - planned_mm,
            }
        })
        .collect();
    Ok(CutsReport { n: cuts.len(), cuts, segments })
}

/// The achieved planes in the frame of the planned ones, where each of them is meant to be at `truth` in the world: displaced
/// from the planned one as the plane by the registration is from the one that was meant.
///
/// # Errors
/// [`Refusal`] if a plane has no counterpart or is unknown.
pub fn achieved(planned: &Planes, truth: &Planes, t_ct_world: &Isometry3<f64>) -> Result<Planes, Refusal> {
    let one = |plane: &Plane| {
        let meant = truth.planes.iter().find(|p| p.name == plane.name);
        let meant = meant.ok_or_else(|| unpaired(&plane.name, "true", truth.planes.iter().map(|p| &*p.name)))?;
        let (plan, t_world_meant) = (known(plane)?, known(meant)?);
        let slip = t_world_meant.inverse() * t_ct_world.inverse() * plan;
        Ok(Plane::new(plane.name.clone(), plan * slip))
    };
    let planes = planned.planes.iter().map(one).collect::<Result<Vec<_>, Refusal>>()?;
    Ok(Planes::new(&planned.frame, planes))
}

fn compare(name: &str, plan: &Isometry3<f64>, cut: &Isometry3<f64>, at: &Point3<f64>, z: &Vector3<f64>) -> CutReport {
    let (n, n_cut) = (plan * Vector3::z(), cut * Vector3::z());
    let motion = (cut.rotation * plan.rotation.inverse()).into_inner();
    // Swing-twist: the part of the quaternion along z is the twist about it.
    let twist = 2.0 * motion.imag().dot(z).atan2(motion.scalar());
    let roll_rad = if twist > std::f64::consts::PI {
        twist - std::f64::consts::TAU
    } else if twist < -std::f64::consts::PI {
        twist + std::f64::consts::TAU
    } else {
        twist
    };
    CutReport {
        name: name.into(),
        at: at.coords.into(),
        offset_mm: (cut * Point3::origin() - at).dot(&n_cut) / n.dot(&n_cut),
        tilt_rad: n.angle(&n_cut),
        roll_rad,
        moved_mm: Some((cut * (plan.inverse() * at) - at).norm()),
    }
}
