//! A plan of what was drawn in 3D Slicer, also by its extension BoneReconstructionPlanner.
//!
//! # Source
//! SlicerBoneReconstructionPlanner at e084abd0, `BoneReconstructionPlanner.py`: `createFibulaPlanesFromMandiblePlanesAndFibulaAxis` names
//! the planes of segment 0 `FibulaPlane0_A` and `FibulaPlane0_B`, and those on the jaw `mandibularPlane`;
//! `createAndUpdateDynamicModelerNodes` takes as segment what is on the negative side of B and not of A, so that both normals lead from A to B.

use super::PlanRead;
use crate::{FileError, Space, picked_points::PickedPoints};
use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3};
use osteoflow_geometry::{NamedPoint, Plane, Planes, Points, SurgicalPlan};
use std::{collections::BTreeMap, ops::RangeInclusive, path::Path, str::FromStr, sync::Arc};

/// What a plane, a point or a list of points is in a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanRole {
    /// Landmarks, which start a registration.
    Landmarks,
    /// Assessment points.
    Assessment,
    /// A cutting plane. Two by two they bound a segment, and both normals lead from the first to the second.
    Plane,
    /// A cutting plane with its normal to the other side.
    PlaneReversed,
    /// No part of the plan.
    Ignored,
}

/// The roles, by their names.
const ROLES: [(&str, PlanRole); 5] = [
    ("landmarks", PlanRole::Landmarks),
    ("assessment", PlanRole::Assessment),
    ("plane", PlanRole::Plane),
    ("plane_reversed", PlanRole::PlaneReversed),
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
/// A name in `roles` is that of a plane, a list of points or a point; planes come in their order. Without a role, planes of
/// BoneReconstructionPlanner on the fibula are taken by segment, or else all planes but those on the jaw, in the file's order; landmarks are the
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
    let half_turn = UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0));
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
            let is_of_plane = matches!(role, PlanRole::Plane | PlanRole::PlaneReversed);
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
        let mut others = Vec::new();
        for plane in &self.picked.planes {
            match (self.role(&plane.name), end_of_segment(&plane.name)) {
                (Some(PlanRole::Plane | PlanRole::PlaneReversed), _) => {}
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
            if let [Some(a), Some(b)] = ends {
                planes.extend([a.clone(), b.clone()]);
            } else if let Some(only) = ends.into_iter().flatten().next() {
                let message = format!(
                    "segment {segment} has no other plane, so that it is not known which side of this one is kept; name the two planes of the segment \
                     by --map NAME=plane, both normals from the first to the second"
                );
                return Err(self.fault(&only.name, message));
            }
        }
        for (name, role) in self.roles {
            if let Some(plane) = self.picked.planes.iter().find(|plane| *plane.name == **name) {
                match role {
                    PlanRole::Plane => planes.push(plane.clone()),
                    PlanRole::PlaneReversed => planes.push(turned_over(plane)),
                    _ => {}
                }
            }
        }
        let (taken, more) = match planes.is_empty() {
            true => others.into_iter().partition(|plane| !plane.name.starts_with("mandibularPlane")),
            false => (Vec::new(), others),
        };
        left_out.extend(more.iter().map(|plane| plane.name.to_string()));
        if !taken.is_empty() {
            let names: Vec<&str> = taken.iter().map(|plane: &&Plane| &*plane.name).collect();
            notes.push(format!(
                "{}: {} are taken in the order of the file, two to a segment, as nothing says which side of them is kept; osteoflow convert --map says it",
                self.path.display(),
                names.join(", ")
            ));
        }
        planes.extend(taken.into_iter().cloned());
        planes.chunks_exact(2).try_for_each(|pair| self.check_sides(&pair[0], &pair[1], notes))?;
        Ok(planes)
    }

    /// Both normals of a segment lead from the first plane to the second, as in the extension, which would cut nothing out otherwise.
    fn check_sides(&self, a: &Plane, b: &Plane, notes: &mut Vec<String>) -> Result<(), FileError> {
        let between = pose(b) * Point3::origin() - pose(a) * Point3::origin();
        let is_against = |plane: &Plane| (pose(plane) * Vector3::z()).dot(&between) <= 0.0;
        let (first, second, mm) = (&a.name, &b.name, between.norm());
        let (plane, why) = match (is_against(a), is_against(b)) {
            (false, false) => {
                let why = if mm < *SEGMENT_MM.start() {
                    "are the lengths metres? --scale 1000 of osteoflow convert makes them mm"
                } else {
                    "does the file of each plane state its unit and coordinate system rightly?"
                };
                if !SEGMENT_MM.contains(&mm) {
                    let apart = format!("\"{first}\" and \"{second}\" are {mm:.3} mm apart");
                    notes.push(format!("{}: {apart}, which is no segment of a fibula; {why}", self.path.display()));
                }
                return Ok(());
            }
            (true, true) => (
                a,
                format!("both normals lead from \"{second}\" to \"{first}\"; are they swapped, or both turned over?"),
            ),
            (true, false) => (a, format!("its normal leads away from \"{second}\"; is it turned over?")),
            (false, true) => (b, format!("its normal leads towards \"{first}\"; is it turned over?")),
        };
        let message = format!(
            "{why} The normals of the two planes of a segment lead from the first to the second; make the plan again, or name both by --map in their \
             order, one that is turned over as plane_reversed"
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

/// Lengths of segments of a fibula, mm: those of a jaw take 15 to 80.
const SEGMENT_MM: RangeInclusive<f64> = 3.0..=150.0;
