//! The kind `output.export`.

use super::{NOTICE, NoOutputs, is_refused, lps, not_a_link};
use crate::parts;
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    metrics::{distance_colour, distance_outside, distance_scale},
    trust::Verdict,
};
use osteoflow_formats::{
    durable,
    picked_points::{write_mrk_json, write_planes_mrk_json},
    pose_file::itk_text,
    scene_file::Scene,
    write::{Precision, write_cloud, write_mesh},
};
use osteoflow_geometry::{Cloud, CloudError, Mesh, Planes, Points, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Value, function, schemars::JsonSchema, serde::Deserialize};

/// A registration as a folder that 3D Slicer and CloudCompare open beside the CT: LPS, mm, in the run's folder, named after the
/// node.
///
/// `bone.stl` (`bone.ply` of a bone known by points only), `landmarks.mrk.json` and `planes.mrk.json` are the CT's surface and
/// the plan. `scan.vtk` (for 3D Slicer and ParaView) and `scan.ply` (for CloudCompare) are the scan on the CT, coloured by the
/// distance from the bone, mm, positive outside; a column `on_bone` says which points belong to it. `scan_to_ct.tfm` is the
/// motion that takes the scan there. These three are not written if the registration is refused or missing. Every file says
/// that it is for research use only.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.export"
in   = { bone = "bone.mesh", scan = "to_bone.cloud", t_ct_scan = "icp.t_target_source", landmarks = "plan.landmarks", planes = "plan.planes", icp = "icp.report", verdict = "verdict.verdict" }
"#)]
pub struct Export;

/// Parameters of [`Export`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Whether `scene.mrb` is written, too: all of it as one scene of 3D Slicer, the scan in its own frame under the motion
    /// onto the bone.
    pub scene: bool,
}

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
    /// How the registration ended. Points whose distance from the bone is among those of its inliers (`inliers_mm`) have 1 in
    /// the column `on_bone`, the others 0. Unwired: no such column.
    icp: Option<Value>,
    /// The verdict on the registration. Unwired: the scan is written whatever the verdict.
    verdict: Option<Verdict>,
}

#[function("output.export")]
impl Export {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
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
        let mut known = Vec::new();
        if let Some(planes) = &i.planes {
            planes.frame.expect(frame, "the planes")?;
            known.extend(planes.planes.iter().filter_map(|p| Some((p.name.clone(), *p.isometry()?))));
            write_planes_mrk_json(&file("planes.mrk.json")?, &known)?;
        }
        let registered = match i.scan.as_ref().zip(i.t_ct_scan) {
            Some(_) if is_refused(i.verdict.as_ref(), ctx) => None,
            Some((scan, t_ct_scan)) => {
                let t_ct_scan = t_ct_scan.expect(frame, &scan.frame)?;
                let inliers_mm =
                    i.icp.and_then(|report| serde_json::from_value(report.to_result()["inliers_mm"].take()).ok());
                let scan = with_distance(scan, &t_ct_scan, i.bone.as_ref(), inliers_mm)?;
                let on_ct = scan.transformed("ct", &t_ct_scan);
                let notes = write_cloud(&file("scan.ply")?, &for_cloudcompare(&on_ct)?, space, Precision::Single)?;
                notes.into_iter().for_each(|note| ctx.warn(note));
                write_cloud(&file("scan.vtk")?, &on_ct, space, Precision::Single)?;
                let frames =
                    format!("moves frame {} to frame ct, mm, LPS; the parameters are those of the inverse", scan.frame);
                durable::write(file("scan_to_ct.tfm")?, itk_text(&t_ct_scan, &[frames, NOTICE.into()]))?;
                Some((scan, t_ct_scan))
            }
            None => {
                ctx.warn("the scan is not written, since it is not registered");
                None
            }
        };
        if params.scene {
            let (path, (end_mm, colours)) = (file("scene.mrb")?, distance_scale());
            let scene = Scene {
                bone: i.bone.as_ref(),
                bone_points: i.bone_points.as_ref(),
                scan: registered.as_ref().map(|(scan, t_ct_scan)| (scan, t_ct_scan)),
                scale: (DISTANCE, end_mm, &colours),
                lists: i.landmarks.map(|landmarks| ("landmarks", landmarks)).into_iter().collect(),
                planes: &known,
            };
            durable::write(&path, scene.bytes(&path)?)?;
        }
        Ok(NoOutputs {})
    }
}

/// The column of the distance from the bone, by which 3D Slicer and ParaView colour a scan.
pub const DISTANCE: &str = "distance_mm";
/// The same for CloudCompare, which takes what begins so for a scalar field, and shows it without asking.
const SCALAR_DISTANCE: &str = "scalar_distance_mm";

/// A registered scan in its own frame, with its distance from the bone as first column if that is known, and without those of an earlier
/// registration. `inliers_mm` are the distances of points that belong to the bone.
///
/// # Errors
/// [`CloudError`] as of [`Cloud::with_extra`].
pub fn with_distance(
    scan: &Cloud,
    t_ct_scan: &Isometry3<f64>,
    bone: Option<&Mesh>,
    inliers_mm: Option<[f64; 2]>,
) -> Result<Cloud, CloudError> {
    let surface = bone.map(MeshQuery::new);
    let distances = scan.points().iter().map(|point| distance_outside(&(t_ct_scan * point), surface.as_ref()?));
    let mut cloud = scan.clone().without_extras();
    if let Some(distances) = distances.collect::<Option<Vec<f64>>>() {
        cloud = parts::with_on_bone(cloud.with_extra(DISTANCE, distances.clone())?, &distances, inliers_mm)?;
    }
    let earlier = [DISTANCE, SCALAR_DISTANCE, parts::ON_BONE];
    let mut others = scan.extras().iter().filter(|(name, _)| !earlier.iter().any(|of| name.eq_ignore_ascii_case(of)));
    others.try_fold(cloud, |cloud, (name, values)| cloud.with_extra(name.clone(), values.clone()))
}

/// Such a scan with the colours of the page, unless it has colours that a camera saw.
fn for_cloudcompare(scan: &Cloud) -> Result<Cloud, CloudError> {
    let colours = ["red", "green", "blue"];
    let has_colours = scan.extras().iter().any(|(name, _)| colours.contains(&&*name.to_ascii_lowercase()));
    let mut cloud = scan.clone().without_extras();
    for (name, values) in scan.extras() {
        let is_distance = **name == *DISTANCE;
        cloud = cloud.with_extra(if is_distance { SCALAR_DISTANCE.into() } else { name.clone() }, values.clone())?;
        for (k, colour) in colours.into_iter().enumerate().filter(|_| is_distance && !has_colours) {
            let part: Vec<f64> = values.iter().map(|&mm| distance_colour(mm)[k].into()).collect();
            cloud = cloud.with_extra(colour, part)?;
        }
    }
    Ok(cloud)
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::{SurfaceOrigin, nalgebra::Point3};

    #[test]
    fn a_distance_of_an_earlier_registration_is_never_shown_as_if_it_were_of_this_one() {
        let corners = [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]].map(|[x, y]| Point3::new(x, y, 3.0));
        let bone = Mesh::new("ct", SurfaceOrigin::User, corners.to_vec(), vec![[0, 1, 2]]).unwrap();
        let scan = Cloud::new("camera", vec![Point3::new(0.0, 0.0, 2.5), Point3::new(0.5, 0.0, 3.25)]).unwrap();
        let with = |cloud: Cloud, name: &str, value: f64| cloud.with_extra(name, vec![value; 2]).unwrap();
        let earlier = ["distance_mm", "Scalar_Distance_mm", "on_bone"];
        let scan =
            with(earlier.into_iter().fold(with(scan, "red", 9.0), |scan, name| with(scan, name, 77.0)), "time", 5.0);
        let columns =
            |cloud: &Cloud| cloud.extras().iter().map(|(n, v)| (n.to_string(), v.to_vec())).collect::<Vec<_>>();
        let column = |name: &str, values: [f64; 2]| (name.to_owned(), values.to_vec());
        let others = [column("red", [9.0; 2]), column("time", [5.0; 2])];
        // 1 mm along z from where it was scanned.
        let up = Isometry3::translation(0.0, 0.0, 1.0);
        let placed = with_distance(&scan, &up, Some(&bone), Some([-1.0, 1.0])).unwrap();
        let of_this = |name: &str| [column(name, [0.5, 1.25]), column("on_bone", [1.0, 0.0])];
        assert_eq!(columns(&placed), [of_this("distance_mm"), others.clone()].concat());
        assert_eq!(
            columns(&for_cloudcompare(&placed).unwrap()),
            [of_this("scalar_distance_mm"), others.clone()].concat()
        );
        assert_eq!(placed.points(), scan.points(), "in its own frame");
        let of_points = with_distance(&scan, &up, None, Some([-1.0, 1.0])).unwrap();
        assert_eq!(columns(&of_points), others, "an unknown distance is no column");
    }
}
