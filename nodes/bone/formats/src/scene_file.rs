//! A scene for 3D Slicer, `.mrb`: bone, scan, points and planes in their places and colours, and the registration as a transform.
//!
//! # Source
//! 3D Slicer at 583e9b37: `vtkMRMLScene.cxx` (`UnpackSlicerDataBundle`), `vtkMRMLModelStorageNode.cxx` (a file's `SPACE=LPS` precedes the
//! node's), `vtkMRMLLinearTransformNode.cxx` (`matrixTransformToParent`, RAS), `vtkMRMLTransformStorageNode.cxx` (a file replaces it: LPS,
//! from parent), `vtkMRMLMarkupsJsonStorageNode.cxx` (a file of one markup), `vtkMRMLDisplayNode.cxx`,
//! `vtkMRMLColorTableStorageNode.cxx` (`.ctbl`), `vtkMRMLCameraNode.cxx` (the singleton 1 is that of the first 3D view).

use crate::{
    FileError, Space,
    picked_points::{planes_text, points_text},
    pose_file::itk_text,
    write::{NOTICE, stl, vtk},
};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Cloud, Mesh, NamedPoint};
use std::{
    fmt::Write as _,
    io::{Cursor, Write as _},
    path::Path,
    sync::Arc,
};
use zip::{DateTime, ZipWriter, result::ZipError, write::SimpleFileOptions};

/// What a scene shows: mm, LPS, in the coordinates of the bone but for the scan.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The surface of the bone.
    pub bone: Option<&'a Mesh>,
    /// Its points, shown where there is no surface.
    pub bone_points: Option<&'a Cloud>,
    /// The scan in its own frame, and the motion that takes it onto the bone.
    pub scan: Option<(&'a Cloud, &'a Isometry3<f64>)>,
    /// The column of the scan that colours it, its value at the end of the scale, and the colours from minus that to it.
    pub scale: Option<(&'a str, f64, &'a [[u8; 3]])>,
    /// Lists of points, by name.
    pub lists: &'a [(&'a str, &'a [NamedPoint])],
    /// Planes, by name; the z axis of each is its normal.
    pub planes: &'a [(Arc<str>, Isometry3<f64>)],
}

impl Scene<'_> {
    /// The bytes of the file `path`, of which errors speak. The same scene gives the same bytes.
    ///
    /// # Errors
    /// [`FileError`] if a point is not finite, or a column of the scan has the name of a coordinate.
    pub fn bytes(&self, path: &Path) -> Result<Vec<u8>, FileError> {
        let mut nodes = Nodes::default();
        self.camera(&mut nodes);
        let bone = "color=\"0.95 0.84 0.57\"";
        match (self.bone, self.bone_points) {
            (Some(mesh), _) => nodes.model("bone", "bone.stl", stl(mesh, Space::Lps, Some(NOTICE)), bone, ""),
            (None, Some(points)) => nodes.model("bone", "bone.vtk", vtk(path, points, Space::Lps)?, bone, ""),
            (None, None) => {}
        }
        if let Some((cloud, t_ct_scan)) = self.scan {
            let comments = ["moves the scan onto the bone, mm, LPS; the parameters are those of the inverse", NOTICE];
            let file = itk_text(t_ct_scan, &comments.map(String::from));
            let ras = Space::Ras.turn() * *t_ct_scan * Space::Ras.turn();
            let numbers = ras.to_homogeneous().transpose().iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
            let matrix = format!("matrixTransformToParent=\"{numbers}\"");
            let transform = nodes.stored("LinearTransform", "scan_to_ct", &matrix, "", "scan_to_ct.tfm", file);
            let mut look = "pointSize=\"3\" lighting=\"false\"".to_owned();
            if let Some((column, end, colours)) = self.scale {
                let row = |(k, [r, g, b]): (usize, &[u8; 3])| format!("{k} _ {r} {g} {b} 255\n");
                let rows: String = colours.iter().enumerate().map(row).collect();
                let of_user = format!("type=\"13\" numcolors=\"{}\"", colours.len());
                let table = nodes.stored("ColorTable", column, &of_user, "", "scale.ctbl", rows);
                look += &format!(
                    " scalarVisibility=\"true\" activeScalarName=\"{column}\" colorNodeID=\"{table}\" \
                     scalarRangeFlag=\"UseManual\" scalarRange=\"-{end} {end}\""
                );
            }
            nodes.model("scan", "scan.vtk", vtk(path, cloud, Space::Lps)?, &look, &format!("transform:{transform};"));
        }
        for (name, points) in self.lists {
            nodes.markup("Fiducial", name, &format!("{name}.mrk.json"), points_text(path, points, Space::Lps)?);
        }
        for (k, plane) in self.planes.iter().enumerate() {
            let text = planes_text(std::slice::from_ref(plane));
            nodes.markup("Plane", &plane.0, &format!("plane_{}.mrk.json", k + 1), text);
        }
        nodes.zipped().map_err(|error| FileError::content(path, "archive", error.to_string()))
    }

    /// The camera of the first 3D view: it looks at the scan from where that was seen, else from the front at the bone.
    fn camera(&self, nodes: &mut Nodes) {
        let bone = || self.bone.map(Mesh::vertices).or(self.bone_points.map(Cloud::points)).unwrap_or_default();
        let (points, motion) = self
            .scan
            .map_or_else(|| (bone(), Isometry3::identity()), |(cloud, t_ct_scan)| (cloud.points(), *t_ct_scan));
        let Some(first) = points.first() else { return };
        let ends = points.iter().fold((*first, *first), |(a, b), p| (a.inf(p), b.sup(p)));
        let (centre, radius) = (nalgebra::center(&ends.0, &ends.1), (ends.1 - ends.0).norm() / 2.0);
        let seen_from =
            self.scan.and_then(|(cloud, _)| cloud.viewpoint).map(|view| Point3::from(view.translation.vector));
        let towards =
            seen_from.and_then(|from| (motion * (from - centre)).try_normalize(1e-9)).unwrap_or(-Vector3::y());
        let up = if towards.z.abs() < 0.9 { Vector3::z() } else { Vector3::y() };
        let focal = motion * centre;
        // The default angle of view, 30 degrees, sees a sphere whole from 3.9 of its radii.
        let [position, focal, up] = [(focal + towards * (4.0 * radius)).coords, focal.coords, up].map(|lps| {
            let [x, y, z]: [f64; 3] = (Space::Ras.turn() * lps).into();
            format!("{x} {y} {z}")
        });
        let place = format!("singletonTag=\"1\" position=\"{position}\" focalPoint=\"{focal}\" viewUp=\"{up}\"");
        nodes.add("Camera", "Camera", &place, "");
    }
}

/// The nodes of a scene as XML, and their files.
#[derive(Default)]
struct Nodes {
    n: usize,
    xml: String,
    files: Vec<(String, Vec<u8>)>,
}

impl Nodes {
    /// Adds a node; its identifier.
    fn add(&mut self, class: &str, name: &str, attributes: &str, references: &str) -> String {
        self.n += 1;
        let id = format!("vtkMRML{class}Node{}", self.n);
        let name =
            name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;").replace(char::is_control, " ");
        writeln!(
            self.xml,
            " <{class} id=\"{id}\" name=\"{name}\" description=\"{NOTICE}\" {attributes} references=\"{references}\"></{class}>"
        )
        .expect("a string takes any text");
        id
    }

    /// Adds a node with its file; its identifier.
    fn stored(
        &mut self,
        class: &str,
        name: &str,
        attributes: &str,
        references: &str,
        file: &str,
        bytes: impl Into<Vec<u8>>,
    ) -> String {
        let storage = match class {
            "LinearTransform" => "Transform",
            "MarkupsFiducial" => "MarkupsJson",
            "MarkupsPlane" => "MarkupsPlaneJson",
            other => other,
        };
        let place = format!("fileName=\"Data/{file}\" coordinateSystem=\"LPS\"");
        let storage = self.add(&format!("{storage}Storage"), file, &place, "");
        self.files.push((file.to_owned(), bytes.into()));
        self.add(class, name, attributes, &format!("storage:{storage};{references}"))
    }

    fn model(&mut self, name: &str, file: &str, bytes: Vec<u8>, look: &str, references: &str) {
        let display = self.add("ModelDisplay", "", look, "");
        self.stored("Model", name, "", &format!("display:{display};{references}"), file, bytes);
    }

    fn markup(&mut self, kind: &str, name: &str, file: &str, text: String) {
        let display = format!("display:{};", self.add(&format!("Markups{kind}Display"), "", "", ""));
        self.stored(&format!("Markups{kind}"), name, "", &display, file, text);
    }

    fn zipped(self) -> Result<Vec<u8>, ZipError> {
        let head = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<MRML version=\"Slicer4.4.0\" userTags=\"\">\n";
        let scene = format!("{head}{}</MRML>\n", self.xml).into_bytes();
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        let files = self.files.into_iter().map(|(name, bytes)| (format!("Data/{name}"), bytes));
        for (name, bytes) in std::iter::once(("scene.mrml".to_owned(), scene)).chain(files) {
            zip.start_file(
                format!("scene/{name}"),
                SimpleFileOptions::default().last_modified_time(DateTime::default()),
            )?;
            zip.write_all(&bytes)?;
        }
        Ok(zip.finish()?.into_inner())
    }
}
