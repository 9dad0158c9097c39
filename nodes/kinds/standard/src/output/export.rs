//! The kind `output.export`.

use super::{NOTICE, NoOutputs, is_refused, lps, not_a_link};
use crate::parts;
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    metrics::{distance_colour, distance_outside},
    trust::Verdict,
};
use osteoflow_formats::{
    Space,
    picked_points::{write_mrk_json, write_planes_mrk_json},
    pose_file::itk_text,
    write::{Precision, write_cloud, write_mesh},
};
use osteoflow_geometry::{Cloud, Mesh, Planes, Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Value, function};
use std::path::PathBuf;

/// A registration as a folder that 3D Slicer and CloudCompare open beside the CT: LPS, mm, in the run's folder, named after the
/// node.
///
/// `bone.stl` (of a bone that is known by points only `bone.ply`), `landmarks.mrk.json` and `planes.mrk.json` are the CT's surface and
/// the plan; `scan.vtk` (drawn by 3D Slicer),
/// `scan.ply` (for CloudCompare, with the distance from the bone as scalar field, mm, positive outside, its colours as on the page, and a
/// column `on_bone` that says which points belong to the bone) and `scan_to_ct.tfm` the scan on the CT and the motion
/// that takes it there. If the registration is refused or missing, the last three are not written. Every file says that
/// it is for research use only.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.export"
in   = { bone = "bone.mesh", scan = "to_bone.cloud", t_ct_scan = "icp.t_target_source", landmarks = "plan.landmarks", planes = "plan.planes", icp = "icp.report", verdict = "verdict.verdict" }
"#)]
pub struct Export;

/// Inputs of [`Export`].
#[derive(Inputs)]
pub struct In {
    /// The surface in the CT.
    #[port(join = "once", frame = "@ct")]
    bone: Option<Mesh>,
    /// The points of a surface without faces.
    #[port(join = "once", frame = "@ct")]
    bone_points: Option<Cloud>,
    /// The scan, in its own frame; one folder for each.
    #[port(frame = "t_ct_scan.from")]
    scan: Option<Cloud>,
    /// Where the scan lies in the CT.
    #[port(to = "@ct", from = "scan")]
    t_ct_scan: Option<Pose>,
    /// The planned landmarks.
    #[port(join = "once", frame = "@ct")]
    landmarks: Option<Points>,
    /// The planned planes.
    #[port(join = "once", frame = "@ct")]
    planes: Option<Planes>,
    /// How the registration ended. Points whose distance from the bone is among those of its inliers (`inliers_mm`) are 1 in the
    /// column `on_bone`, the others 0. Unwired: there is no such column.
    icp: Option<Value>,
    /// The verdict on the registration. Unwired: the scan is written whatever the verdict.
    verdict: Option<Verdict>,
}

#[function("output.export")]
impl Export {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        let frame = match (&i.bone, &i.bone_points) {
            (Some(mesh), _) => &mesh.frame,
            (None, Some(points)) => &points.frame,
            (None, None) => {
                ctx.warn("nothing is written, since there is no bone");
                return Ok(NoOutputs {});
            }
        };
        let space = lps(frame, "the surface is", "name its frame ct")?;
        let Some(dir) = ctx.out_dir() else { return Ok(NoOutputs {}) };
        let number = if ctx.item() == 0 { String::new() } else { format!("-{}", ctx.item()) };
        let dir = not_a_link(dir.join(format!("{}{number}", ctx.node())))?;
        std::fs::create_dir_all(&dir)?;
        let file = |name: &str| not_a_link(dir.join(name));
        let notes = match (&i.bone, &i.bone_points) {
            (Some(mesh), _) => write_mesh(&file("bone.stl")?, mesh, space, Precision::Single)?,
            (None, Some(points)) => write_cloud(&file("bone.ply")?, points, space, Precision::Single)?,
            (None, None) => Vec::new(),
        };
        notes.into_iter().for_each(|note| ctx.warn(note));
        if let Some(landmarks) = &i.landmarks {
            landmarks.frame.expect(frame, "the landmarks")?;
            write_mrk_json(&file("landmarks.mrk.json")?, &landmarks.points, space)?;
        }
        if let Some(planes) = &i.planes {
            planes.frame.expect(frame, "the planes")?;
            let known: Vec<_> = planes.planes.iter().filter_map(|p| Some((p.name.clone(), *p.isometry()?))).collect();
            write_planes_mrk_json(&file("planes.mrk.json")?, &known)?;
        }
        let (Some(scan), Some(t_ct_scan)) = (&i.scan, &i.t_ct_scan) else {
            ctx.warn("the scan is not written, since it is not registered");
            return Ok(NoOutputs {});
        };
        if !is_refused(i.verdict.as_ref(), ctx) {
            let t_ct_scan = t_ct_scan.clone().expect(frame, &scan.frame)?;
            let inliers_mm =
                i.icp.and_then(|report| serde_json::from_value(report.to_result()["inliers_mm"].take()).ok());
            let notes = write_scan(&file, scan, &t_ct_scan, i.bone.as_ref(), space, inliers_mm)?;
            notes.into_iter().for_each(|note| ctx.warn(note));
        }
        Ok(NoOutputs {})
    }
}

fn write_scan(
    file: &dyn Fn(&str) -> Result<PathBuf, NodeError>,
    scan: &Cloud,
    t_ct_scan: &osteoflow_geometry::nalgebra::Isometry3<f64>,
    bone: Option<&Mesh>,
    space: Space,
    inliers_mm: Option<[f64; 2]>,
) -> Result<Vec<String>, NodeError> {
    let on_ct = scan.transformed("ct", t_ct_scan);
    let coloured = match bone {
        Some(bone) => coloured(on_ct.clone(), &MeshQuery::new(bone), inliers_mm)?,
        None => on_ct.clone(),
    };
    let notes = write_cloud(&file("scan.ply")?, &coloured, space, Precision::Single)?;
    write_cloud(&file("scan.vtk")?, &on_ct, space, Precision::Single)?;
    let frames = format!("moves frame {} to frame ct, mm, LPS; the parameters are those of the inverse", scan.frame);
    osteoflow_formats::durable::write(file("scan_to_ct.tfm")?, itk_text(t_ct_scan, &[frames, NOTICE.into()]))?;
    Ok(notes)
}

/// The column of the distance from the bone. CloudCompare takes what begins so for a scalar field, and shows it without asking.
const DISTANCE: &str = "scalar_distance_mm";

/// A cloud with its distance from a surface, whether it belongs to that, and the colours of that; those that a camera saw are kept instead.
fn coloured(cloud: Cloud, surface: &MeshQuery, inliers_mm: Option<[f64; 2]>) -> Result<Cloud, NodeError> {
    let distances: Vec<f64> = cloud.points().iter().map(|p| distance_outside(p, surface).unwrap_or(f64::NAN)).collect();
    let colours = ["red", "green", "blue"];
    let has = |name: &str| cloud.extras().iter().any(|(column, _)| column.eq_ignore_ascii_case(name));
    let (has_distance, has_colours) = (has(DISTANCE), colours.into_iter().any(has));
    let mut cloud = cloud;
    if !has_colours {
        for (k, name) in colours.into_iter().enumerate() {
            let part: Vec<f64> = distances.iter().map(|&distance| distance_colour(distance)[k].into()).collect();
            cloud = cloud.with_extra(name, part)?;
        }
    }
    if !has_distance {
        cloud = cloud.with_extra(DISTANCE, distances.clone())?;
    }
    Ok(parts::with_on_bone(cloud, &distances, inliers_mm)?)
}
