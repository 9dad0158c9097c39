//! The part of a surface or of a cloud that a node takes, and which way its faces turn.

use osteoflow_algorithms::{
    Refusal,
    parts::{MAX_LISTED, PartChoice, Parts, turned_outwards},
};
use osteoflow_formats::mesh_or_cloud::{MeshOrCloud, MeshRead};
use osteoflow_geometry::{Cloud, CloudError, Mesh};
use osteoflow_node::{NodeError, ParamError};
use std::path::Path;

/// The choice that the parameter `component` names.
pub(crate) fn choice(component: Option<&str>) -> Result<Option<PartChoice>, ParamError> {
    component.map(|text| text.parse().map_err(|message: String| ParamError::new("component", message))).transpose()
}

/// A refusal of a part, with the file that lacks it.
pub(crate) fn in_file(path: &Path, refusal: &Refusal) -> NodeError {
    NodeError::new(format!("{}: {refusal}", path.display()))
}

/// The chosen part of a bone's surface, all parts by default, with closed ones turned outwards; and notes.
///
/// # Errors
/// [`Refusal`] if there is no such part.
pub fn of_bone(mesh: Mesh, choice: Option<PartChoice>) -> Result<(Mesh, Vec<String>), Refusal> {
    let parts = Parts::of_mesh(&mesh);
    let (mesh, mut notes) = match choice {
        Some(choice) => {
            let place = parts.chosen_of_mesh(&mesh, choice)?;
            (parts.mesh(&mesh, place), taken(&parts, place, choice))
        }
        None => {
            let all = parts.n_equal().map(|n| {
                format!(
                    "{n} parts of about the same size, and all are taken: choose one by component = \"1\" to component = \"{n}\" ({})",
                    listed(&parts, n)
                )
            });
            (mesh, Vec::from_iter(all))
        }
    };
    let (mesh, turns) = turned_outwards(&mesh);
    let n = mesh.faces().len();
    if turns.n_turned > 0 {
        let (what, k) = match turns.n_turned {
            all if all == n => ("the surface is inside out: ".to_owned(), n),
            some => (String::new(), some),
        };
        notes.push(format!(
            "{what}{k} of {n} faces, all of closed parts, pointed inwards, by the signed volume of their part, and were turned outwards"
        ));
    }
    let flipped = (turns.n_flipped, "turn the other way than most of those they are connected to");
    let doubled = (turns.n_doubled, "are over the same corners as others");
    for (count, what) in [flipped, doubled].into_iter().filter(|(count, _)| *count > 0) {
        notes.push(format!(
            "{count} of {n} faces {what}, so the sign of distances is wrong there; repair the surface (in MeshLab: Re-Orient All Faces \
             Coherently, Remove Duplicate Faces)"
        ));
    }
    Ok((mesh, notes))
}

/// As [`of_bone`], of whatever a file holds.
///
/// # Errors
/// [`Refusal`] if there is no such part.
pub fn of_target(read: MeshOrCloud, choice: Option<PartChoice>) -> Result<(MeshOrCloud, Vec<String>), Refusal> {
    match read {
        MeshOrCloud::Mesh(read) => {
            let (mesh, notes) = of_bone(read.mesh, choice)?;
            Ok((MeshOrCloud::Mesh(MeshRead { mesh, ..read }), notes))
        }
        cloud @ MeshOrCloud::Cloud(..) => of_scan(cloud, choice),
    }
}

/// The chosen part of a scan: a part of its surface, or a cluster of its points; all of it by default. With notes.
///
/// # Errors
/// [`Refusal`] if there is no such part.
pub fn of_scan(read: MeshOrCloud, choice: Option<PartChoice>) -> Result<(MeshOrCloud, Vec<String>), Refusal> {
    let Some(choice) = choice else { return Ok((read, Vec::new())) };
    Ok(match read {
        MeshOrCloud::Mesh(read) => {
            let parts = Parts::of_mesh(&read.mesh);
            let place = parts.chosen_of_mesh(&read.mesh, choice)?;
            (MeshOrCloud::Mesh(MeshRead { mesh: parts.mesh(&read.mesh, place), ..read }), taken(&parts, place, choice))
        }
        MeshOrCloud::Cloud(mut read, notes) => {
            let parts = Parts::of_points(read.cloud.points());
            let place = parts.chosen_of_points(read.cloud.points(), choice)?;
            if parts.list.len() > 1 {
                read.cloud = read.cloud.selected(&parts.points(place));
            }
            (MeshOrCloud::Cloud(read, notes), taken(&parts, place, choice))
        }
    })
}

/// The column that says which points belong to the bone.
pub(crate) const ON_BONE: &str = "on_bone";

/// A cloud with the column `on_bone`: 1 for points whose distance from the bone, mm, is among those of the registration's inliers, 0 for
/// the others. Without inliers, or with such a column, it stays as it is.
///
/// # Errors
/// [`CloudError`] if there is not one distance for each point.
pub fn with_on_bone(cloud: Cloud, distances_mm: &[f64], inliers_mm: Option<[f64; 2]>) -> Result<Cloud, CloudError> {
    let has_column = cloud.extras().iter().any(|(column, _)| column.eq_ignore_ascii_case(ON_BONE));
    match inliers_mm.filter(|_| !has_column) {
        Some([inside, outside]) => {
            let on_bone = |mm: &f64| f64::from(u8::from((inside..=outside).contains(mm)));
            cloud.with_extra(ON_BONE, distances_mm.iter().map(on_bone).collect::<Vec<f64>>())
        }
        None => Ok(cloud),
    }
}

/// A note on the part that was taken, on a place that is far from it, and on those that are as large.
fn taken(parts: &Parts, place: usize, choice: PartChoice) -> Vec<String> {
    let (part, n) = (&parts.list[place], parts.list.len());
    let mut notes = Vec::new();
    if n > 1 {
        notes.push(format!("part {} of {n} was taken: {}", part.number, part.describe()));
    }
    if let PartChoice::Nearest(at) = choice {
        let away_mm = part.outside_mm(&at);
        if away_mm > part.extent_mm.into_iter().fold(0.0, f64::max) {
            notes.push(format!(
                "{}, {}, {} is {away_mm:.0} mm from the nearest part, farther than that is long; is it in the file's frame and in mm?",
                at.x, at.y, at.z
            ));
        }
    }
    if let Some(equal) = parts.n_equal().filter(|equal| part.number <= *equal) {
        notes
            .push(format!("{equal} parts are of about the same size ({}); is it the right one?", listed(parts, equal)));
    }
    notes
}

/// The first parts in words.
fn listed(parts: &Parts, n: usize) -> String {
    let listed = parts.list.iter().take(n.min(MAX_LISTED)).map(|part| format!("{}: {}", part.number, part.describe()));
    listed.collect::<Vec<_>>().join("; ")
}
