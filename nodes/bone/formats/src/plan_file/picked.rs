//! A plan of what was drawn in 3D Slicer, also by its extension BoneReconstructionPlanner.
//!
//! # Source
//! SlicerBoneReconstructionPlanner at e084abd0, `BoneReconstructionPlanner.py`: `createFibulaPlanesFromMandiblePlanesAndFibulaAxis` names
//! the planes of segment 0 `FibulaPlane0_A` and `FibulaPlane0_B`, and those on the jaw `mandibularPlane`;
//! `createAndUpdateDynamicModelerNodes` takes as segment what is on the negative side of B and not of A, so that both normals lead from A to B.

use super::PlanRead;
use crate::{FileError, Space, picked_points::PickedPoints};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use osteoflow_geometry::{NamedPoint, Plane, Planes, Points, SurgicalPlan};
use std::{collections::BTreeMap, f64::consts::PI, path::Path, str::FromStr, sync::Arc};

/// What a plane, a point or a list of points is in a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanRole {
    /// Landmarks, which start a registration.
    Landmarks,
    /// Assessment points.
    Assessment,
    /// A cutting plane whose normal leads out of the piece that is kept.
    Plane,
    /// A cutting plane whose normal leads into the piece that is kept; it is turned over.
    PlaneInward,
    /// No part of the plan.
    Ignored,
}

/// The roles, by their names.
const ROLES: [(&str, PlanRole); 5] = [
    ("landmarks", PlanRole::Landmarks),
    ("assessment", PlanRole::Assessment),
    ("plane", PlanRole::Plane),
    ("plane_inward", PlanRole::PlaneInward),
    ("ignored", PlanRole::Ignored),
];

impl FromStr for PlanRole {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let role = ROLES.iter().find(|(name, _)| *name == text).map(|(_, role)| *role);
        role.ok_or_else(|| format!("\"{text}\" is no role; the roles are {}", ROLES.map(|(name, _)| name).join(", ")))
    }
}

/// The plan of points and planes in LPS.
///
/// A name in `roles` is that of a plane, a list of points or a point. Without a role, planes of BoneReconstructionPlanner on the
/// fibula are taken with their normals out of the segment, or else all planes but those on the jaw, as they are; landmarks are the
/// points of a list `landmarks` and points `P1`, `P2` .., assessment points those of `assessment` and `M1`, `M2` ... What is left out is noted.
///
/// # Errors
/// [`FileError`] if a name is of nothing, a role does not fit, a segment lacks a plane, a normal leads the wrong way, or nothing is taken.
pub fn plan_of_picked(path: &Path, picked: &PickedPoints, roles: &[(String, PlanRole)]) -> Result<PlanRead, FileError> {
    let drawn = Drawn { path, picked, roles };
    drawn.check_names()?;
    let mut notes: Vec<String> = picked.notes.iter().map(|note| format!("{}: {note}", path.display())).collect();
    let mut left_out = Vec::new();
    let planes = drawn.planes(&mut notes, &mut left_out)?;
    let [landmarks, assessment] = drawn.points(&mut left_out)?;
    if planes.is_empty() && landmarks.is_empty() && assessment.is_empty() {
        let message = format!(
            "there is nothing in it that is known to be part of a plan; say what is by --map NAME=ROLE of osteoflow convert: {}",
            left_out.join(", ")
        );
        return Err(FileError::content(path, "roles", message));
    }
    if !left_out.is_empty() {
        notes.push(format!(
            "{}: not part of the plan: {}; --map NAME=ROLE of osteoflow convert takes more",
            path.display(),
            left_out.join(", ")
        ));
    }
    if picked.space == Space::Unknown {
        notes.push(format!("{}: {}", path.display(), Space::TAKEN_FOR_LPS));
    }
    let plan = SurgicalPlan {
        landmarks: Points::new("ct", landmarks),
        assessment: Points::new("ct", assessment),
        planes: Planes::new("ct", planes),
        axes: None,
        anatomy: None,
        t_phantom_phantom_marker: None,
        t_camera_camera_marker_nominal: None,
        surface: None,
    };
    Ok(PlanRead { plan, notes, unread: Vec::new() })
}

struct Drawn<'a> {
    path: &'a Path,
    picked: &'a PickedPoints,
    roles: &'a [(String, PlanRole)],
}

/// Segment and end that a name of BoneReconstructionPlanner says: 0 for A, 1 for B. Slicer adds `_1` to a name that is there already.
fn end_of_segment(name: &str) -> Option<(u32, usize)> {
    let (segment, end) = name.strip_prefix("FibulaPlane")?.split_once('_')?;
    let (end, copy) = end.split_once('_').unwrap_or((end, "1"));
    copy.parse::<u32>().ok()?;
    Some((segment.parse().ok()?, ["A", "B"].iter().position(|letter| *letter == end)?))
}

/// A plane with the normal to the other side.
fn turned_over(plane: &Plane) -> Plane {
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let pose = plane.isometry().map(|pose| pose * half_turn);
    pose.map_or_else(|| plane.clone(), |pose| Plane::new(plane.name.clone(), pose))
}

fn pose(plane: &Plane) -> Isometry3<f64> {
    plane.isometry().copied().unwrap_or_default()
}

impl Drawn<'_> {
    fn fault(&self, name: &str, message: impl Into<String>) -> FileError {
        FileError::content(self.path, format!("\"{name}\""), message)
    }

    fn role(&self, name: &str) -> Option<PlanRole> {
        self.roles.iter().find(|(mapped, _)| mapped == name).map(|(_, role)| *role)
    }

    fn check_names(&self) -> Result<(), FileError> {
        let planes = self.picked.planes.iter().map(|plane| (&plane.name, true));
        let lists = self.picked.lists.iter().filter(|list| !list.points.is_empty()).map(|list| (&list.name, false));
        let points = self.picked.points.iter().map(|point| (&point.name, false));
        let names: Vec<(&Arc<str>, bool)> = planes.chain(lists).chain(points).collect();
        for (k, (name, role)) in self.roles.iter().enumerate() {
            let is_of_plane = matches!(role, PlanRole::Plane | PlanRole::PlaneInward);
            let fits = |is_plane: bool| *role == PlanRole::Ignored || is_plane == is_of_plane;
            let found: Vec<_> = names.iter().filter(|(other, _)| ***other == **name).collect();
            if self.roles[..k].iter().any(|(before, _)| before == name) {
                return Err(self.fault(name, "it is given two roles; give one"));
            }
            if found.is_empty() {
                let known: Vec<_> = names.iter().map(|(name, _)| &***name).collect();
                return Err(self.fault(name, format!("nothing is called so; there are: {}", known.join(", "))));
            }
            if !found.iter().any(|(_, is_plane)| fits(*is_plane)) {
                let message = if is_of_plane { "points are no plane" } else { "a plane has no points" };
                return Err(self.fault(name, format!("{message}; give it another role")));
            }
        }
        Ok(())
    }

    fn planes(&self, notes: &mut Vec<String>, left_out: &mut Vec<String>) -> Result<Vec<Plane>, FileError> {
        let mut segments: BTreeMap<u32, [Option<&Plane>; 2]> = BTreeMap::new();
        let (mut mapped, mut others) = (Vec::new(), Vec::new());
        for plane in &self.picked.planes {
            match (self.role(&plane.name), end_of_segment(&plane.name)) {
                (Some(PlanRole::Plane), _) => mapped.push(plane.clone()),
                (Some(PlanRole::PlaneInward), _) => mapped.push(turned_over(plane)),
                (Some(_), _) => left_out.push(plane.name.to_string()),
                (None, Some((segment, end))) => {
                    let place = &mut segments.entry(segment).or_default()[end];
                    if let Some(before) = place {
                        let message = format!(
                            "\"{}\" is the same plane of the same segment; delete the one that is left from an earlier plan, or say --map NAME=ignored",
                            before.name
                        );
                        return Err(self.fault(&plane.name, message));
                    }
                    *place = Some(plane);
                }
                (None, None) => others.push(plane),
            }
        }
        let mut planes = Vec::new();
        for (segment, ends) in segments {
            match ends {
                [Some(a), Some(b)] => {
                    self.check_sides(a, b, notes)?;
                    planes.extend([turned_over(a), b.clone()]);
                }
                [Some(only), None] | [None, Some(only)] => {
                    let message = format!(
                        "segment {segment} has no other plane, so that it is not known which side of this one is kept; say --map {0}=plane if its \
                         normal leads out of the piece that is kept, --map {0}=plane_inward if into it",
                        only.name
                    );
                    return Err(self.fault(&only.name, message));
                }
                [None, None] => {}
            }
        }
        planes.extend(mapped);
        let takes_all = planes.is_empty();
        for plane in others {
            if !takes_all || plane.name.starts_with("mandibularPlane") {
                left_out.push(plane.name.to_string());
                continue;
            }
            notes.push(format!(
                "{}: which side of \"{}\" is kept is not stated; its normal is taken as it is (--map {1}=plane or plane_inward of osteoflow convert says it)",
                self.path.display(),
                plane.name
            ));
            planes.push(plane.clone());
        }
        Ok(planes)
    }

    /// Both normals of a segment lead from A to B, or the extension would have cut nothing out.
    fn check_sides(&self, a: &Plane, b: &Plane, notes: &mut Vec<String>) -> Result<(), FileError> {
        let between = pose(b) * Point3::origin() - pose(a) * Point3::origin();
        let is_against = |plane: &Plane| (pose(plane) * Vector3::z()).dot(&between) <= 0.0;
        let why = match (is_against(a), is_against(b)) {
            (false, false) => {
                if between.norm() < SHORTEST_MM {
                    notes.push(format!(
                        "{}: \"{}\" and \"{}\" are {:.3} mm apart, which is no segment; are the lengths metres? --scale 1000 of osteoflow convert makes them mm",
                        self.path.display(), a.name, b.name, between.norm()
                    ));
                }
                return Ok(());
            }
            (true, true) => "both normals lead from B to A; are A and B swapped, or both turned over?",
            (true, false) => "its normal leads away from B; is it turned over?",
            (false, true) => "its normal leads towards A; is it turned over?",
        };
        let plane = if is_against(a) { a } else { b };
        let message = format!(
            "{why} Normals of a segment lead from A to B in BoneReconstructionPlanner; make the plan there again, or say of each of both \
             --map {}=plane or --map {}=plane_inward, {}",
            a.name, b.name, "as its normal leads out of or into the piece that is kept"
        );
        Err(self.fault(&plane.name, message))
    }

    /// Landmarks and assessment points.
    fn points(&self, left_out: &mut Vec<String>) -> Result<[Vec<NamedPoint>; 2], FileError> {
        let (mut landmarks, mut assessment) = (Vec::new(), Vec::new());
        for (k, point) in self.picked.points.iter().enumerate() {
            let list = self.picked.lists.iter().find(|list| list.points.contains(&k)).map_or("", |list| &list.name);
            let numbered =
                |letter: char| point.name.strip_prefix(letter).is_some_and(|rest| rest.parse::<u32>().is_ok());
            let by_name = match () {
                () if list.eq_ignore_ascii_case("landmarks") => Some(PlanRole::Landmarks),
                () if list.eq_ignore_ascii_case("assessment") => Some(PlanRole::Assessment),
                () if numbered('P') => Some(PlanRole::Landmarks),
                () if numbered('M') => Some(PlanRole::Assessment),
                () => None,
            };
            match self.role(&point.name).or_else(|| self.role(list)).or(by_name) {
                Some(PlanRole::Landmarks) => landmarks.push(point.clone()),
                Some(PlanRole::Assessment) => assessment.push(point.clone()),
                _ => left_out.push(point.name.to_string()),
            }
        }
        let lists = self.picked.lists.iter().filter(|list| list.points.is_empty() && list.n_points > 0);
        left_out.extend(lists.map(|list| list.name.to_string()));
        Ok([landmarks, assessment])
    }
}

/// A segment is longer than this, mm.
const SHORTEST_MM: f64 = 3.0;
