//! A scene for 3D Slicer, `.mrb`: bone, scan, points and planes in their places and colours, and the registration as a transform.
//!
//! # Source
//! 3D Slicer at 583e9b37: `vtkMRMLScene`, `vtkMRMLModelStorageNode` (`SPACE=LPS` in a file precedes the node's), `vtkMRMLLinearTransformNode`
//! (to the parent, RAS), `vtkMRMLTransformStorageNode` (replaces that by a file: from the parent, LPS), `vtkMRMLMarkupsJsonStorageNode` (one
//! markup in a file), `vtkMRMLDisplayNode`, `vtkMRMLColorTableStorageNode`, `vtkMRMLCameraNode` (the singleton 1 is that of the first view).

use crate::{
    FileError, Space,
    picked_points::{planes_text, points_text},
    pose_file::itk_text,
    write::{NOTICE, stl, vtk},
};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Cloud, Mesh, Points};
use std::{io::Cursor, io::Write as _, path::Path, sync::Arc};
use zip::{DateTime, ZipWriter, result::ZipError, write::SimpleFileOptions};

/// What a scene shows: mm, LPS, in the coordinates of the bone but for the scan.
#[derive(Debug, Clone)]
pub struct Scene<'a> {
    /// The surface of the bone.
    pub bone: Option<&'a Mesh>,
    /// Its points, shown where there is no surface.
    pub bone_points: Option<&'a Cloud>,
    /// The scan in its own frame, and the motion that takes it onto the bone.
    pub scan: Option<(&'a Cloud, &'a Isometry3<f64>)>,
    /// The column that colours the scan if it has it, its value at the end of the scale, and the colours from minus that to it.
    pub scale: (&'a str, f64, &'a [[u8; 3]]),
    /// Lists of points by name, of which empty ones are left out.
    pub lists: Vec<(&'a str, Points)>,
    /// Planes by name; the z axis of each is its normal.
    pub planes: &'a [(Arc<str>, Isometry3<f64>)],
}

impl Scene<'_> {
    /// The bytes of the file `path`, of which errors speak. The same scene gives the same bytes.
    ///
    /// # Errors
    /// [`FileError`] if a point is not finite, or a column of the scan has the name of a coordinate.
    pub fn bytes(&self, path: &Path) -> Result<Vec<u8>, FileError> {
        let mut nodes = Nodes::default();
        let bone = ["", "color=\"0.95 0.84 0.57\"", ""];
        if let Some(mesh) = self.bone {
            nodes.add(["Model", "ModelStorage", "bone", "bone.stl"], stl(mesh, Space::Lps, Some(NOTICE)), bone);
        } else if let Some(points) = self.bone_points {
            nodes.add(["Model", "ModelStorage", "bone", "bone.vtk"], vtk(path, points, Space::Lps)?, bone);
        }
        if let Some((scan, t_ct_scan)) = self.scan {
            nodes.xml += &camera(scan, t_ct_scan);
            let ras = Space::Ras.turn() * *t_ct_scan * Space::Ras.turn();
            let numbers = ras.to_homogeneous().transpose().iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
            let own = [&*format!("matrixTransformToParent=\"{numbers}\""), "", ""];
            let file = itk_text(t_ct_scan, &["moves the scan onto the bone, mm, LPS".into(), NOTICE.into()]);
            let id = nodes.add(["LinearTransform", "TransformStorage", "scan_to_ct", "scan_to_ct.tfm"], file, own);
            let mut look = "pointSize=\"3\" lighting=\"false\"".to_owned();
            let (column, end, colours) = self.scale;
            if scan.extras().iter().any(|(name, _)| **name == *column) {
                let row = |(k, [r, g, b]): (usize, &[u8; 3])| format!("{k} _ {r} {g} {b} 255\n");
                let rows: String = colours.iter().enumerate().map(row).collect();
                let own = [&*format!("type=\"13\" numcolors=\"{}\"", colours.len()), "", ""];
                let table = nodes.add(["ColorTable", "ColorTableStorage", column, "scale.ctbl"], rows, own);
                look += &format!(
                    " scalarVisibility=\"true\" activeScalarName=\"{column}\" colorNodeID=\"{table}\" \
                     scalarRangeFlag=\"UseManual\" scalarRange=\"-{end} {end}\""
                );
            }
            let about = ["", &look, &format!("transform:{id};")];
            nodes.add(["Model", "ModelStorage", "scan", "scan.vtk"], vtk(path, scan, Space::Lps)?, about);
        }
        let visible = ["", "visibility=\"true\"", ""];
        for (name, list) in self.lists.iter().filter(|(_, list)| !list.points.is_empty()) {
            let (file, text) = (format!("{name}.mrk.json"), points_text(path, &list.points, Space::Lps)?);
            nodes.add(["MarkupsFiducial", "MarkupsJsonStorage", name, &file], text, visible);
        }
        for (k, plane) in self.planes.iter().enumerate() {
            let (file, text) = (format!("plane_{}.mrk.json", k + 1), planes_text(std::slice::from_ref(plane)));
            nodes.add(["MarkupsPlane", "MarkupsPlaneJsonStorage", &plane.0, &file], text, visible);
        }
        nodes.zipped().map_err(|error| FileError::content(path, "archive", error.to_string()))
    }
}

/// The camera of the first 3D view: it looks at the scan from where that was seen, else from the front.
fn camera(scan: &Cloud, t_ct_scan: &Isometry3<f64>) -> String {
    let points = scan.points();
    let focal = Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64);
    let radius = points.iter().map(|p| (p - focal).norm()).fold(1.0, f64::max);
    let seen_from = scan.viewpoint.and_then(|view| (view.translation.vector - focal.coords).try_normalize(1e-9));
    let towards = seen_from.map_or(-Vector3::y(), |from| t_ct_scan * from);
    let up = if towards.z.abs() < 0.9 { Vector3::z() } else { Vector3::y() };
    // Within the default angle of view, 30 degrees, a sphere is seen whole from 3.9 of its radii.
    let (focal, away) = ((t_ct_scan * focal).coords, towards * (4.0 * radius));
    let [position, focal, up] = [focal + away, focal, up].map(|p| format!("{} {} {}", -p.x, -p.y, p.z));
    let place = format!("position=\"{position}\" focalPoint=\"{focal}\" viewUp=\"{up}\"");
    format!(" <Camera id=\"vtkMRMLCameraNode1\" name=\"Camera\" singletonTag=\"1\" {place}></Camera>\n")
}

/// The nodes of a scene as XML, and their files.
#[derive(Default)]
struct Nodes {
    xml: String,
    files: Vec<(String, Vec<u8>)>,
}

impl Nodes {
    /// Adds a node with its file, of its class, class of storage, name and file name, and with its own attributes, those of its display if
    /// it is drawn, and its references. Returns its identifier.
    fn add(&mut self, of: [&str; 4], bytes: impl Into<Vec<u8>>, about: [&str; 3]) -> String {
        let ([class, storage, name, file], [own, look, references]) = (of, about);
        self.files.push((format!("Data/{file}"), bytes.into()));
        let id = |class: &str| format!("vtkMRML{class}Node{}", self.files.len());
        let node = |class: &str, rest: &str| format!(" <{class} id=\"{}\" {rest}></{class}>\n", id(class));
        self.xml += &node(storage, &format!("fileName=\"Data/{file}\" coordinateSystem=\"LPS\""));
        let mut all = format!("storage:{};{references}", id(storage));
        if !look.is_empty() {
            let display = format!("{class}Display");
            self.xml += &node(&display, look);
            all += &format!("display:{};", id(&display));
        }
        let name =
            name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;").replace(char::is_control, " ");
        self.xml += &node(class, &format!("name=\"{name}\" description=\"{NOTICE}\" {own} references=\"{all}\""));
        id(class)
    }

    fn zipped(mut self) -> Result<Vec<u8>, ZipError> {
        let head = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<MRML version=\"Slicer4.4.0\" userTags=\"\">\n";
        self.files.push(("scene.mrml".into(), format!("{head}{}</MRML>\n", self.xml).into()));
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in &self.files {
            zip.start_file(
                format!("scene/{name}"),
                SimpleFileOptions::default().last_modified_time(DateTime::default()),
            )?;
            zip.write_all(bytes)?;
        }
        Ok(zip.finish()?.into_inner())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picked_points::read_scene;

    #[test]
    fn a_plane_may_be_called_anything_and_is_read_where_it_was() {
        let pose = Isometry3::new(Vector3::new(1.0, -2.0, 300.0), Vector3::new(0.3, -0.2, 0.9));
        let names = ["<Plane id=\"x\"/> & 'b'", "line\nbreak \u{1} &amp;", "plane_1.mrk.json"];
        let planes = names.map(|name| (Arc::from(name), pose));
        let lists = vec![("landmarks", Points::new("ct", Vec::new()))];
        let scene = Scene { bone: None, bone_points: None, scan: None, scale: ("", 1.0, &[]), lists, planes: &planes };
        let file = tempfile::NamedTempFile::with_suffix(".mrb").unwrap();
        std::fs::write(file.path(), scene.bytes(file.path()).unwrap()).unwrap();
        let read = read_scene(file.path()).unwrap();
        assert_eq!((read.space, read.lists.len(), read.planes.len()), (Space::Lps, 0, 3));
        for (plane, name) in read.planes.iter().zip(names) {
            assert_eq!(&*plane.name, name.replace(['\n', '\u{1}'], " "));
            assert!((plane.isometry().unwrap().to_homogeneous() - pose.to_homogeneous()).amax() < 1e-9);
        }
    }
}
