//! The surface of the bone in a CT.

use super::any::Params;
use osteoflow_algorithms::ct_surface::{
    ComponentChoice, CtSurface, CtSurfaceParams, VolumeView, ct_surface, suggested_threshold,
};
use osteoflow_formats::{
    FileError, input,
    volume::{Volume, VoxelUnit, data_files, read_volume},
};
use osteoflow_geometry::Mesh;
use osteoflow_node::NodeError;
use std::path::Path;

/// A bone's surface from a CT.
pub struct CtBone {
    /// The surface, without the faces on the volume's border.
    pub mesh: Mesh,
    /// What is in doubt, one sentence each.
    pub notes: Vec<String>,
    /// The volume, the components, and how far the surface moves with the threshold.
    pub report: serde_json::Value,
}

/// What to do without a threshold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoThreshold {
    /// Refuse, with a suggestion.
    Refuse,
    /// Take the suggestion where the values are HU, with a note; refuse elsewhere.
    Suggest,
}

/// Reads a volume and extracts the bone's surface.
///
/// # Errors
/// The volume cannot be read, there is no threshold, or nothing lies above it.
pub fn read_bone(params: &Params, no_threshold: NoThreshold) -> Result<CtBone, NodeError> {
    let read = read_volume(params.path.as_ref(), params.series.as_deref())?;
    let volume = &read.volume;
    let view = VolumeView { size: volume.size, voxels: &volume.voxels, t_lps_voxel: &volume.t_lps_voxel };
    let mut notes = read.notes.clone();
    let suggested = || {
        let wanted = no_threshold == NoThreshold::Suggest && volume.unit == VoxelUnit::Hu;
        wanted.then(|| suggested_threshold(&view, true)).flatten().inspect(|threshold| {
            notes.push(format!(
                "the threshold is {threshold:.0} HU, half-way between soft tissue and bone in this volume; look at the bone's outline \
                 there"
            ));
        })
    };
    let Some(threshold) = params.threshold_hu.or_else(suggested) else {
        return Err(NodeError::new(without_threshold(&view, volume.unit)));
    };
    let component = params.part_of_ct().map_err(|error| NodeError::new(error.to_string()))?;
    let choice = CtSurfaceParams { threshold, component, fill_cavities: params.fill_cavities.unwrap_or(true) };
    let surface = ct_surface(&view, &choice)?;
    notes.extend(warnings(volume, &surface, &choice));
    let report = serde_json::json!({
        "source": read.source,
        "size": volume.size,
        "t_lps_voxel": (0..4).map(|r| (0..4).map(|c| volume.t_lps_voxel[(r, c)]).collect()).collect::<Vec<Vec<f64>>>(),
        "unit": if volume.unit == VoxelUnit::Hu { "hu" } else { "unknown" },
        "is_oriented": volume.is_oriented,
        "frame_of_reference_uid": read.frame_of_reference_uid,
        "sha256": file_sha256(params.path.as_ref())?,
        "threshold": threshold,
        "n_components": surface.n_components,
        "components": surface.components,
        "chosen": surface.chosen,
        "n_faces": surface.faces.len() - surface.n_border_faces(),
        "n_border_faces": surface.n_border_faces(),
        "n_filled": surface.n_filled,
        "filled_mm3": surface.filled_mm3,
        "n_raised_voxels": surface.n_raised,
        "shift_mm_per_50": surface.shift_mm_per_50,
        "shift_p95_mm_per_50": surface.shift_p95_mm_per_50,
    });
    Ok(CtBone { mesh: surface.open_mesh(params.frame.as_str())?, notes, report })
}

/// SHA-256 of a volume in one file; `None` for a folder, and for a header with its voxels in another file.
fn file_sha256(path: &Path) -> Result<Option<String>, FileError> {
    let is_one_file = path.is_file() && data_files(path).is_empty();
    is_one_file.then(|| input::sha256(path)).transpose()
}

fn without_threshold(view: &VolumeView<'_>, unit: VoxelUnit) -> String {
    let suggested = suggested_threshold(view, unit == VoxelUnit::Hu);
    match (unit, suggested) {
        (VoxelUnit::Hu, Some(t)) => format!(
            "threshold_hu is not given, and it decides where the surface is; half-way between soft tissue and bone in this volume \
             is about {t:.0} HU: look at the bone's outline there, then set threshold_hu"
        ),
        (VoxelUnit::Hu, None) => {
            "threshold_hu is not given, and no bone was found above 300 HU from which to suggest one; is it \
                                  the right series?"
                .into()
        }
        (VoxelUnit::Unknown, Some(t)) => format!(
            "threshold_hu is not given, and the values are not HU (an MR, or not scaled), so nobody knows which of them are bone; \
             half-way between their two classes is about {t:.4}: look at the bone's outline there, then set threshold_hu in the \
             file's own values"
        ),
        (VoxelUnit::Unknown, None) => {
            "threshold_hu is not given, and the values are not HU (an MR, or not scaled) nor of two \
                                       classes; set it in the file's own values"
                .into()
        }
    }
}

fn warnings(volume: &Volume, surface: &CtSurface, params: &CtSurfaceParams) -> Vec<String> {
    let unit = if volume.unit == VoxelUnit::Hu { "HU" } else { "units" };
    let mut all = Vec::new();
    if volume.unit == VoxelUnit::Unknown {
        all.push(format!(
            "the values are not known to be HU; {} was taken as the threshold in the file's own values",
            params.threshold
        ));
    }
    if !volume.is_oriented {
        all.push(
            "the orientation of the volume is unknown; a mirrored surface would be registered as if it were the bone"
                .into(),
        );
    }
    let chosen = &surface.chosen;
    if surface.n_components > 1 {
        let by = match params.component {
            ComponentChoice::Seed(_) => "the one at the seed",
            ComponentChoice::Nearest(_) => "the nearest",
            ComponentChoice::Rank(1) => "the largest",
            ComponentChoice::Rank(_) => "the one asked for",
        };
        let [x, y, z] = chosen.centre_mm;
        let next = surface.components.iter().find(|c| c.rank != chosen.rank);
        all.push(format!(
            "{} parts are above {} {unit}; {by} was taken (rank {}, {} voxels, {:.0} mm3, centre {x:.1}, {y:.1}, {z:.1} mm){}",
            surface.n_components,
            params.threshold,
            chosen.rank,
            chosen.n_voxels,
            chosen.volume_mm3,
            next.map_or(String::new(), |c| format!("; another has {:.0} mm3", c.volume_mm3)),
        ));
    }
    let n_border = surface.n_border_faces();
    if n_border > 0 {
        all.push(format!(
            "the volume's border cuts the bone; {n_border} of {} faces lie there and were left out, so the surface is open",
            surface.faces.len()
        ));
    }
    if surface.n_filled > 0 {
        all.push(format!(
            "{} spaces inside the bone, {:.0} mm3, were filled, so only its outer surface is given",
            surface.n_filled, surface.filled_mm3
        ));
    }
    all.push(format!(
        "a threshold 50 {unit} higher or lower moves the surface by {:.2} mm (median; {:.2} mm at the 95th percentile)",
        surface.shift_mm_per_50, surface.shift_p95_mm_per_50
    ));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        constant::Once,
        surface::any::{Ct, CtParams, MeshOut},
    };
    use osteoflow_geometry::nalgebra::Point3;
    use osteoflow_node::{Context, FilePath, Source};
    use std::path::PathBuf;

    fn params(path: &Path) -> Params {
        Params {
            path: FilePath(path.into()),
            frame: "ct".into(),
            unit_mm: 1.0,
            space: None,
            threshold_hu: Some(500.0),
            series: None,
            component: None,
            seed_mm: None,
            fill_cavities: None,
        }
    }

    fn run(params: Params) -> Result<(MeshOut, Vec<String>), String> {
        let mut ctx = Context::for_test("bone");
        let mut node = Once::<Ct>::new(CtParams { bone: params }).map_err(|error| error.to_string())?;
        let out = node.next(&mut ctx).map_err(|error| error.to_string())?.ok_or("nothing")?;
        assert!(node.next(&mut ctx).unwrap().is_none(), "once");
        Ok((out, ctx.warnings().to_vec()))
    }

    /// Two balls of 1000 HU in soft tissue and a little air, one cut by the volume's end at z = 0, as a raw NRRD; `lift` is
    /// added to all values.
    fn two_balls(lift: f64, space: &str) -> tempfile::NamedTempFile {
        let centres = [Point3::new(10.0, 10.0, 10.0), Point3::new(24.0, 10.0, 0.5)];
        let value = |k: usize| {
            let at = Point3::new((k % 70) as f64, (k / 70 % 40) as f64, (k / 2800) as f64) * 0.5;
            let d = ((at - centres[0]).norm() - 6.0).min((at - centres[1]).norm() - 5.0);
            if at.y < 1.0 { -1000.0 + lift } else { (500.0 - 500.0 * d).clamp(0.0, 1000.0) + lift }
        };
        let mut bytes = format!(
            "NRRD0004\ntype: float\ndimension: 3\n{space}sizes: 70 40 40\nendian: little\nencoding: raw\nspace directions: \
             (0.5,0,0) (0,0.5,0) (0,0,0.5)\nspace origin: (0,0,0)\n\n"
        )
        .into_bytes();
        bytes.extend((0..70 * 40 * 40).flat_map(|k| (value(k) as f32).to_le_bytes()));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        file
    }

    #[test]
    fn the_chosen_part_becomes_the_surface_and_what_is_in_doubt_is_warned_of() {
        let file = two_balls(0.0, "space: LPS\n");
        let (out, warnings) = run(params(file.path())).unwrap();
        assert_eq!(out.mesh.frame.as_str(), "ct");
        assert!(out.mesh.vertices().iter().all(|v| ((v - Point3::new(10.0, 10.0, 10.0)).norm() - 6.0).abs() < 0.05));
        let has = |warnings: &[String], words: &str| {
            assert!(warnings.iter().any(|w| w.contains(words)), "{words}: {warnings:?}")
        };
        has(&warnings, "2 parts are above 500 HU; the largest was taken (rank 1,");
        has(&warnings, "a threshold 50 HU higher or lower moves the surface by 0.10 mm");
        has(&warnings, "they were taken as HU");
        assert_eq!(warnings.len(), 3, "{warnings:?}");
        assert_eq!(out.report.0["n_components"], 2);

        for choice in [
            Params { component: Some("2".into()), ..params(file.path()) },
            // Nearer to the centre of the other ball than to that of this one, but not to its surface.
            Params { component: Some("nearest:17.8,10,2".into()), ..params(file.path()) },
            Params { seed_mm: Some([24.0, 10.0, 1.0]), ..params(file.path()) },
        ] {
            let (out, warnings) = run(choice).unwrap();
            has(&warnings, "the volume's border cuts the bone");
            assert!(
                out.mesh
                    .vertices()
                    .iter()
                    .all(|v| v.z >= 0.0 && ((v - Point3::new(24.0, 10.0, 0.5)).norm() - 5.0).abs() < 0.05)
            );
            assert!(out.report.0["n_border_faces"].as_u64().unwrap() > 100);
        }
        let unknown = two_balls(2000.0, "");
        let (_, warnings) = run(Params { threshold_hu: Some(2500.0), ..params(unknown.path()) }).unwrap();
        has(&warnings, "the values are not known to be HU");
        has(&warnings, "the orientation of the volume is unknown");
    }

    #[test]
    fn without_a_threshold_one_is_suggested_and_wrong_choices_are_refused() {
        let file = two_balls(0.0, "space: LPS\n");
        let refused = |params: Params| run(params).err().unwrap();
        let message = refused(Params { threshold_hu: None, ..params(file.path()) });
        assert!(message.contains("is about 4") && message.contains("HU: look at the bone's outline"), "{message}");
        let unknown = two_balls(2000.0, "");
        let message = refused(Params { threshold_hu: None, ..params(unknown.path()) });
        assert!(message.contains("the values are not HU"), "{message}");
        let message = refused(Params { component: Some("0".into()), ..params(file.path()) });
        assert!(message.contains("\"0\" names no part; give largest"), "{message}");
        let message = refused(Params { component: Some("2".into()), seed_mm: Some([0.0; 3]), ..params(file.path()) });
        assert!(message.contains("give one of them"), "{message}");
        let message = refused(Params { component: Some("3".into()), ..params(file.path()) });
        assert!(message.contains("component 3 was asked for, but 2 are above"), "{message}");
        let message = refused(Params { threshold_hu: Some(9000.0), ..params(file.path()) });
        assert!(message.contains("no voxel is above the threshold 9000"), "{message}");
    }

    fn data(test: &str) -> Option<PathBuf> {
        let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../shared/data");
        let folder = std::env::var_os("OSTEOFLOW_DATA").map_or_else(|| PathBuf::from(beside), PathBuf::from);
        if !folder.join("medical").is_dir() {
            println!("skipped: {test}: no development data");
            return None;
        }
        Some(folder)
    }

    #[test]
    fn the_surface_of_a_ct_is_that_of_the_bone_it_was_made_of_in_each_format() {
        use osteoflow_algorithms::mesh_query::MeshQuery;
        use osteoflow_formats::mesh_or_cloud::read_mesh;
        use osteoflow_geometry::SurfaceOrigin;
        let Some(data) = data("a CT of a known bone") else { return };
        let bone = data.join("bones/TLEM2_CT_fibula_r.stl");
        let bone = MeshQuery::new(&read_mesh(&bone, 1.0, "ct", SurfaceOrigin::User).unwrap().mesh);
        // The slices of the DICOM series are twice as thick.
        let surfaces = ["tlem2r_distal_ct.nii.gz", "tlem2r_distal_ct_dicom"].map(|name| {
            let path = data.join("medical").join(name);
            let message = run(Params { threshold_hu: None, ..params(&path) }).err().unwrap();
            let start = std::time::Instant::now();
            let (out, warnings) = run(Params { threshold_hu: Some(600.0), ..params(&path) }).unwrap();
            println!("{name}: {:.2} s, {warnings:#?}\n{message}", start.elapsed().as_secs_f64());
            out.mesh
        });
        let top = |mesh: &Mesh| mesh.vertices().iter().map(|v| v.z).fold(f64::MIN, f64::max);
        let quantiles = |mesh: &Mesh, other: &MeshQuery| {
            let end = top(mesh).min(top(other.mesh())) - 2.0;
            let inner = mesh.vertices().iter().filter(|v| v.z < end);
            let mut off: Vec<f64> = inner.map(|v| other.closest_point(v).unwrap().distance_mm).collect();
            off.sort_by(f64::total_cmp);
            [0.5, 0.95, 1.0].map(|share| off[((off.len() - 1) as f64 * share) as usize])
        };
        for mesh in &surfaces {
            let [median, p95, max] = quantiles(mesh, &bone);
            println!("{} vertices: median {median:.4}, 95 % {p95:.4}, largest {max:.4} mm", mesh.vertices().len());
            assert!(median < 0.1 && p95 < 0.3, "median {median} mm, 95 % {p95} mm");
        }
        let [median, p95, max] = quantiles(&surfaces[1], &MeshQuery::new(&surfaces[0]));
        println!("DICOM to NIfTI: median {median:.4}, 95 % {p95:.4}, largest {max:.4} mm");
        assert!(median < 0.1 && p95 < 0.3, "median {median} mm, 95 % {p95} mm");
        // The bone's faces look outwards.
        let mesh = &surfaces[0];
        let n_same = (0..mesh.faces().len()).step_by(7).filter(|face| {
            let middle = Point3::from(
                mesh.corners(*face).iter().map(|p| p.coords).sum::<osteoflow_geometry::nalgebra::Vector3<f64>>() / 3.0,
            );
            mesh.area_vector(*face).dot(&bone.closest_point(&middle).unwrap().normal) > 0.0
        });
        assert!(n_same.count() as f64 > 0.99 * (mesh.faces().len() / 7) as f64);
    }
}
