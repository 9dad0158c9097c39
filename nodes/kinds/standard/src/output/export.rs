//! The kind `output.export`.

use super::{NOTICE, NoOutputs, is_refused, lps, not_a_link};
use crate::parts;
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    metrics::{distance_colour, distance_outside, distance_scale},
    trust::Verdict,
};
use osteoflow_formats::{
    FileError, Space,
    picked_points::{write_mrk_json, write_planes_mrk_json},
    pose_file::itk_text,
    scene_file::Scene,
    write::{Precision, write_cloud, write_mesh},
};
use osteoflow_geometry::{
    Cloud, CloudError, Mesh, Planes, Points, Pose,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Value, function, schemars::JsonSchema, serde::Deserialize};
use std::path::{Path, PathBuf};

/// A registration as a folder that 3D Slicer and CloudCompare open beside the CT: LPS, mm, in the run's folder, named after the
/// node.
///
/// `bone.stl` (of a bone that is known by points only `bone.ply`), `landmarks.mrk.json` and `planes.mrk.json` are the CT's surface and
/// the plan; `scan.vtk` (for 3D Slicer and ParaView, which colour it by the distance from the bone, mm, positive outside),
/// `scan.ply` (for CloudCompare, with the distance as scalar field and its colours as on the page) and `scan_to_ct.tfm` the scan on the CT
/// and the motion that takes it there. In both a column `on_bone` says which points belong to the bone. If the registration is refused or
/// missing, these three are not written. Every file says that it is for research use only.
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
    /// Also write `scene.mrb`: all of it as one scene of 3D Slicer, with the scan in its own frame under the motion that takes it onto
    /// the bone.
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
    /// How the registration ended. Points whose distance from the bone is among those of its inliers (`inliers_mm`) are 1 in the
    /// column `on_bone`, the others 0. Unwired: there is no such column.
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
        let mut registered = None;
        match (&i.scan, &i.t_ct_scan) {
            (Some(scan), Some(t_ct_scan)) if !is_refused(i.verdict.as_ref(), ctx) => {
                let t_ct_scan = t_ct_scan.clone().expect(frame, &scan.frame)?;
                let inliers_mm =
                    i.icp.and_then(|report| serde_json::from_value(report.to_result()["inliers_mm"].take()).ok());
                let scan = registered.insert(RegisteredScan::new(scan, t_ct_scan, i.bone.as_ref(), inliers_mm)?);
                write_scan(&file, scan, space)?.into_iter().for_each(|note| ctx.warn(note));
            }
            (Some(_), Some(_)) => {}
            _ => ctx.warn("the scan is not written, since it is not registered"),
        }
        if params.scene {
            let landmarks = i.landmarks.as_ref().map(|landmarks| ("landmarks", &*landmarks.points));
            let (path, lists) = (file("scene.mrb")?, landmarks.as_slice());
            let (bone, bone_points) = (i.bone.as_ref(), i.bone_points.as_ref());
            let scene = Scene { bone, bone_points, scan: None, scale: None, lists, planes: &known };
            osteoflow_formats::durable::write(&path, scene_bytes(&path, scene, registered.as_ref())?)?;
        }
        Ok(NoOutputs {})
    }
}

/// Writes the scan on the CT, and the motion that takes it there.
fn write_scan(
    file: &dyn Fn(&str) -> Result<PathBuf, NodeError>,
    scan: &RegisteredScan,
    space: Space,
) -> Result<Vec<String>, NodeError> {
    let on_ct = |cloud: &Cloud| cloud.transformed("ct", &scan.t_ct_scan);
    let notes = write_cloud(&file("scan.ply")?, &on_ct(&scan.coloured()?), space, Precision::Single)?;
    write_cloud(&file("scan.vtk")?, &on_ct(&scan.cloud), space, Precision::Single)?;
    let frames =
        format!("moves frame {} to frame ct, mm, LPS; the parameters are those of the inverse", scan.cloud.frame);
    osteoflow_formats::durable::write(file("scan_to_ct.tfm")?, itk_text(&scan.t_ct_scan, &[frames, NOTICE.into()]))?;
    Ok(notes)
}

/// The column of the distance from the bone, by which programs colour the scan.
const DISTANCE: &str = "distance_mm";
/// The same where CloudCompare reads it: it takes what begins so for a scalar field, and shows it without asking.
const SCALAR_DISTANCE: &str = "scalar_distance_mm";

/// A scan in its own frame with its distances from the bone, where it was registered.
pub struct RegisteredScan {
    /// Its first column is the distance if that is known.
    cloud: Cloud,
    t_ct_scan: Isometry3<f64>,
    distances: Option<Vec<f64>>,
}

impl RegisteredScan {
    /// The scan; distances of an earlier registration are left out. `inliers_mm` are the distances of points that belong to the bone.
    ///
    /// # Errors
    /// [`CloudError`] as of its columns.
    pub fn new(
        scan: &Cloud,
        t_ct_scan: Isometry3<f64>,
        bone: Option<&Mesh>,
        inliers_mm: Option<[f64; 2]>,
    ) -> Result<Self, CloudError> {
        let surface = bone.map(MeshQuery::new);
        let outside = |p: &Point3<f64>| distance_outside(&(t_ct_scan * p), surface.as_ref()?);
        let distances: Option<Vec<f64>> = scan.points().iter().map(outside).collect();
        let mut cloud = scan.clone().without_extras();
        if let Some(distances) = &distances {
            cloud = parts::with_on_bone(cloud.with_extra(DISTANCE, distances.clone())?, distances, inliers_mm)?;
        }
        let is_earlier =
            |name: &str| [DISTANCE, SCALAR_DISTANCE, parts::ON_BONE].iter().any(|of| name.eq_ignore_ascii_case(of));
        for (name, values) in scan.extras().iter().filter(|(name, _)| !is_earlier(name)) {
            cloud = cloud.with_extra(name.clone(), values.clone())?;
        }
        Ok(Self { cloud, t_ct_scan, distances })
    }

    /// The scan with the colours of the page and the distance as CloudCompare shows it; colours that a camera saw are kept instead.
    fn coloured(&self) -> Result<Cloud, CloudError> {
        let Some(distances) = &self.distances else { return Ok(self.cloud.clone()) };
        let mut cloud = self.cloud.clone().without_extras();
        for (name, values) in self.cloud.extras() {
            let name = if **name == *DISTANCE { SCALAR_DISTANCE.into() } else { name.clone() };
            cloud = cloud.with_extra(name, values.clone())?;
        }
        let colours = ["red", "green", "blue"];
        if colours.into_iter().any(|name| cloud.extras().iter().any(|(column, _)| column.eq_ignore_ascii_case(name))) {
            return Ok(cloud);
        }
        for (k, name) in colours.into_iter().enumerate() {
            let part: Vec<f64> = distances.iter().map(|&distance| distance_colour(distance)[k].into()).collect();
            cloud = cloud.with_extra(name, part)?;
        }
        Ok(cloud)
    }
}

/// The bytes of a scene for 3D Slicer, with the scan in the colours of the page; all in LPS.
///
/// # Errors
/// [`FileError`] as of [`Scene::bytes`].
pub fn scene_bytes(path: &Path, scene: Scene<'_>, scan: Option<&RegisteredScan>) -> Result<Vec<u8>, FileError> {
    let (end_mm, colours) = distance_scale();
    let scale = scan.and_then(|scan| scan.distances.as_ref()).map(|_| (DISTANCE, end_mm, &colours[..]));
    Scene { scan: scan.map(|scan| (&scan.cloud, &scan.t_ct_scan)), scale, ..scene }.bytes(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::SurfaceOrigin;

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
        let placed = RegisteredScan::new(&scan, up, Some(&bone), Some([-1.0, 1.0])).unwrap();
        let of_this = |name: &str| [column(name, [0.5, 1.25]), column("on_bone", [1.0, 0.0])];
        assert_eq!(columns(&placed.cloud), [of_this("distance_mm"), others.clone()].concat());
        assert_eq!(columns(&placed.coloured().unwrap()), [of_this("scalar_distance_mm"), others.clone()].concat());
        assert_eq!(placed.cloud.points(), scan.points(), "in its own frame");
        let of_points = RegisteredScan::new(&scan, up, None, Some([-1.0, 1.0])).unwrap();
        assert_eq!(columns(&of_points.cloud), others, "an unknown distance is no column");
    }
}
