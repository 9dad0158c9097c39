//! Scenes of 3D Slicer: `.mrml`, which names files beside it, and `.mrb`, a ZIP archive of both.
//!
//! # Source
//! 3D Slicer at 583e9b37: `vtkMRMLNode.cxx` (`references`, and what is URL-encoded), `vtkMRMLStorageNode.cxx` (`fileName`, relative to
//! the scene), `vtkMRMLLinearTransformNode.cxx` (`matrixTransformToParent`, in RAS, of six digits), `vtkMRMLMarkupsJsonStorageNode.cxx`
//! (a node reads one markup of its own type; a file that states no coordinate system is LPS).

use super::{
    collected::{Collected, PickedList, PickedPoints},
    slicer,
    text::MOST_NODES,
};
use crate::{FileError, Space, input, pose_file::parse_pose, scene_header::scene_in};
use nalgebra::{Isometry3, Matrix4};
use osteoflow_geometry::nearest_isometry;
use roxmltree::Node;
use std::{
    collections::{HashMap, HashSet},
    io::{Cursor, Read as _},
    path::{Component, Path, PathBuf},
};
use zip::ZipArchive;

/// At most this many bytes are read of a scene with its files of markups and transforms: those of a plan take a hundredth.
const MAX_BYTES: u64 = 256 << 20;

type Archive<'a> = ZipArchive<Cursor<&'a [u8]>>;

/// What is picked in a scene that holds its files.
pub(super) fn bundle(path: &Path, bytes: &[u8]) -> Result<PickedPoints, FileError> {
    let fault = |message: &str| FileError::content(path, "archive", message);
    let damaged = |error: zip::result::ZipError| fault(&format!("no sound ZIP archive: {error}"));
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
    if zip.has_duplicate_names() || zip.has_overlapping_files().map_err(damaged)? {
        return Err(fault("files in it have one name, or share their bytes; save the scene again"));
    }
    let scene = scene_in(&zip).ok_or_else(|| fault("there is no scene (.mrml) in it"))?;
    let (folder, name) = scene.rsplit_once('/').map_or(("", &*scene), |(folder, name)| (folder, name));
    let mut files = Files { path: path.into(), zip: Some((zip, folder.to_owned())), left: MAX_BYTES };
    let (place, text) = files.read(name)?;
    markups(&place, &text, files)
}

/// What is picked in a scene whose files are beside it.
pub(super) fn beside(path: &Path) -> Result<PickedPoints, FileError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    markups(path, &input::read(path)?, Files { path: folder.into(), zip: None, left: MAX_BYTES })
}

/// The files of a scene: in a folder, or in an archive's folder.
struct Files<'a> {
    path: PathBuf,
    zip: Option<(Archive<'a>, String)>,
    left: u64,
}

impl Files<'_> {
    /// Where a file is, and its bytes.
    fn read(&mut self, name: &str) -> Result<(PathBuf, Vec<u8>), FileError> {
        let is_below = |part| matches!(part, Component::Normal(_) | Component::CurDir);
        if name.is_empty() || name.contains(['\\', ':', '\0']) || !Path::new(name).components().all(is_below) {
            let message = "the name leads out of the scene's folder, and is not followed; save the scene as .mrb, which holds its files";
            return Err(FileError::content(&self.path, format!("file {name:?}"), message));
        }
        let inner: PathBuf = match &self.zip {
            Some((_, folder)) => Path::new(folder).join(name),
            None => name.into(),
        };
        let inner: PathBuf = inner.components().filter(|part| *part != Component::CurDir).collect();
        let place = self.path.join(&inner);
        let n_bytes = match &mut self.zip {
            Some((zip, _)) => {
                let missing =
                    |error| FileError::content(&place, "archive", format!("the scene names it, and: {error}"));
                zip.by_name(&inner.to_string_lossy().replace('\\', "/")).map_err(missing)?.size()
            }
            None => {
                input::check(&place)?;
                std::fs::metadata(&place).map_err(FileError::read(&place))?.len()
            }
        };
        let Some(left) = self.left.checked_sub(n_bytes) else {
            let message = format!("it has {n_bytes} bytes, and at most {MAX_BYTES} are read of a scene's markups");
            return Err(FileError::content(&place, "size", message));
        };
        self.left = left;
        let mut bytes = Vec::new();
        match &mut self.zip {
            Some((zip, _)) => {
                let broken = |error: String| FileError::content(&place, "archive", error);
                let entry =
                    zip.by_name(&inner.to_string_lossy().replace('\\', "/")).map_err(|e| broken(e.to_string()))?;
                // One byte more than it claims to have shows that it claims too few.
                entry.take(n_bytes + 1).read_to_end(&mut bytes).map_err(|e| broken(e.to_string()))?;
                if bytes.len() as u64 != n_bytes {
                    return Err(broken(format!("it claims {n_bytes} bytes and has others; save the scene again")));
                }
            }
            None => bytes = input::read(&place)?,
        }
        Ok((place, bytes))
    }
}

/// Text in which `%20` stands for a blank, and so on.
fn decoded(text: &str) -> String {
    let (mut bytes, mut rest) = (Vec::new(), text.as_bytes());
    while let [first, after @ ..] = rest {
        let code = after.get(..2).filter(|_| *first == b'%').and_then(|two| std::str::from_utf8(two).ok());
        match code.and_then(|code| u8::from_str_radix(code, 16).ok()) {
            Some(byte) => (bytes.push(byte), rest = &after[2..]),
            None => (bytes.push(*first), rest = after),
        };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// The identifier of the node that a node refers to in a role.
fn reference<'a>(node: Node<'a, '_>, role: &str) -> Option<&'a str> {
    let listed = node.attribute("references").and_then(|all| {
        all.split(';').find_map(|one| one.trim().split_once(':').filter(|(name, _)| *name == role).map(|(_, ids)| ids))
    });
    // Before version 4.11 each role was an attribute.
    listed.or_else(|| node.attribute(&*format!("{role}NodeRef"))).and_then(|ids| ids.split_whitespace().next())
}

/// The markups of a scene, in the coordinates of its volumes and surfaces.
fn markups(path: &Path, bytes: &[u8], files: Files<'_>) -> Result<PickedPoints, FileError> {
    let fault = |message: String| FileError::content(path, "scene", message);
    let text = std::str::from_utf8(bytes).map_err(|_| fault("the scene is no UTF-8".into()))?;
    let options = roxmltree::ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES };
    let document = roxmltree::Document::parse_with_options(text, options).map_err(|error| fault(error.to_string()))?;
    // Scene views hold copies of nodes as they once were.
    let nodes = || document.root_element().children().filter(Node::is_element);
    let by_id: HashMap<&str, Node<'_, '_>> = nodes().filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let shapes = nodes().filter(|node| SHAPES.contains(&node.tag_name().name()));
    let moved_with = shapes.filter_map(|shape| Some((reference(shape, "transform")?, name_of(shape)))).collect();
    let mut scene = Scene { path, by_id, moved_with, files, all: Collected::default() };
    let (mut planes, mut rois, mut lists) = (Vec::new(), Vec::new(), Vec::new());
    let mut points = Vec::new();
    for node in nodes() {
        let Some(kind) = node.tag_name().name().strip_prefix("Markups").filter(|kind| KINDS.contains(kind)) else {
            continue;
        };
        let Some(read) = scene.markup(node, kind)? else { continue };
        let name = name_of(node);
        let is_own = kind == "Fiducial";
        let own = points.len()..points.len() + if is_own { read.points.len() } else { 0 };
        if !matches!(kind, "Plane" | "ROI") {
            lists.push(PickedList { name: name.into(), kind: kind.into(), n_points: read.points.len(), points: own });
        }
        planes.extend(read.planes.into_iter().map(|plane| osteoflow_geometry::Plane { name: name.into(), ..plane }));
        rois.extend(read.rois.into_iter().map(|roi| super::PickedRoi { name: name.into(), ..roi }));
        points.extend(read.points.into_iter().filter(|_| is_own));
    }
    for (what, names) in [
        ("planes", planes.iter().map(|plane| &plane.name).collect::<Vec<_>>()),
        ("boxes", rois.iter().map(|roi| &roi.name).collect()),
        ("lists of points", lists.iter().map(|list| &list.name).filter(|name| !name.is_empty()).collect()),
    ] {
        // The extension of the measured segments names one line for each way of measuring.
        let is_point_list = |name: &str| lists.iter().any(|list| &*list.name == name && list.kind == "Fiducial");
        let mut before = HashSet::new();
        let twice =
            names.into_iter().find(|name| !before.insert(*name) && (what != "lists of points" || is_point_list(name)));
        if let Some(name) = twice {
            return Err(fault(format!("two {what} are called \"{name}\"; rename one of them in 3D Slicer")));
        }
    }
    let mut n_of = HashMap::new();
    points.iter().for_each(|point: &osteoflow_geometry::NamedPoint| *n_of.entry(point.name.clone()).or_insert(0) += 1);
    for list in &lists {
        for point in &mut points[list.points.clone()] {
            if n_of[&point.name] > 1 {
                scene.note(format!(
                    "\"{}\" is a label in several lists; their points are called LIST:LABEL",
                    point.name
                ));
                point.name = format!("{}:{}", list.name, point.name).into();
            }
        }
    }
    scene.all.points = points;
    Ok(PickedPoints { planes, rois, lists, ..scene.all.finish(Space::Lps) })
}

/// Nodes of which a file may be what is registered.
const SHAPES: [&str; 4] = ["Volume", "LabelMapVolume", "Model", "Segmentation"];

/// Nodes of markups, without the beginning of their names.
const KINDS: [&str; 7] = ["Fiducial", "Line", "Angle", "Curve", "ClosedCurve", "Plane", "ROI"];

fn name_of<'a>(node: Node<'a, '_>) -> &'a str {
    node.attribute("name").unwrap_or_default().trim()
}

struct Scene<'a, 'b> {
    path: &'a Path,
    by_id: HashMap<&'a str, Node<'a, 'a>>,
    /// A volume or surface that a transform moves.
    moved_with: HashMap<&'a str, &'a str>,
    files: Files<'b>,
    /// Notes, and how many points were passed over.
    all: Collected,
}

impl<'a> Scene<'a, '_> {
    fn note(&mut self, note: String) {
        if !self.all.notes.contains(&note) {
            self.all.notes.push(note);
        }
    }

    fn fault(&self, node: Node<'_, '_>, message: impl AsRef<str>) -> FileError {
        let place = format!("node \"{}\"", name_of(node));
        FileError::content(self.path, place, message.as_ref())
    }

    /// What the file of a node of markups holds; none if the node has no file, or is not placed.
    fn markup(&mut self, node: Node<'a, 'a>, kind: &str) -> Result<Option<PickedPoints>, FileError> {
        let Some((place, bytes)) = self.stored(node)? else {
            self.note(format!("\"{}\" has no file in the scene, and was passed over", name_of(node)));
            return Ok(None);
        };
        let read = if slicer::is_fcsv(&bytes) {
            slicer::fcsv(&place, &bytes)?
        } else {
            let read = slicer::markups(&place, &bytes)?;
            let kinds = read.lists.iter().map(|list| &*list.kind);
            let kinds: Vec<_> =
                kinds.chain(read.planes.iter().map(|_| "Plane")).chain(read.rois.iter().map(|_| "ROI")).collect();
            if !kinds.is_empty() && kinds != [kind] {
                let message =
                    format!("the scene has one markup of type {kind} there, and the file {}", kinds.join(", "));
                return Err(FileError::content(&place, "markups", message));
            }
            read
        };
        if read.space == Space::Unknown {
            if slicer::is_fcsv(&bytes) {
                return Err(FileError::content(
                    &place,
                    "header",
                    "it states neither LPS nor RAS; save the list as .mrk.json",
                ));
            }
            self.note(Space::TAKEN_FOR_LPS.into());
        }
        let own = ["the file states", "not placed or not active"];
        read.notes.iter().filter(|note| !own.iter().any(|of_file| note.contains(of_file))).for_each(|note| {
            self.note(format!("{}: {note}", name_of(node)));
        });
        self.all.n_skipped += read.n_skipped;
        let motion = self.motion_above(node)?;
        Ok(Some(read.transformed(&motion, 1.0)))
    }

    /// The file that a node is stored in.
    fn stored(&mut self, node: Node<'a, 'a>) -> Result<Option<(PathBuf, Vec<u8>)>, FileError> {
        let storage = reference(node, "storage").and_then(|id| self.by_id.get(id));
        let name = storage.and_then(|storage| storage.attribute("fileName")).filter(|name| !name.is_empty());
        name.map(|name| self.files.read(&decoded(name))).transpose()
    }

    /// The motion from the coordinates of a node's file to those of the files of volumes and surfaces, in LPS.
    fn motion_above(&mut self, node: Node<'a, 'a>) -> Result<Isometry3<f64>, FileError> {
        let (mut motion, mut seen, mut below) = (Isometry3::identity(), HashSet::new(), node);
        while let Some(id) = reference(below, "transform") {
            let Some(&transform) = self.by_id.get(id) else {
                return Err(self.fault(below, format!("its transform {id} is not in the scene; save the scene again")));
            };
            if !seen.insert(id) {
                return Err(self.fault(below, "its transforms are below each other in a ring"));
            }
            let to_parent = self.own_motion(transform)?;
            let name = name_of(transform);
            match self.moved_with.get(id) {
                _ if to_parent == Isometry3::identity() => {}
                Some(shape) => {
                    self.note(format!(
                        "transform \"{name}\" moves \"{shape}\" too, so it is not applied: places are those in the file of \"{shape}\""
                    ));
                    return Ok(motion);
                }
                None => self.note(format!("transform \"{name}\" is applied to what is below it")),
            }
            motion = to_parent * motion;
            below = transform;
        }
        Ok(motion)
    }

    /// A transform, in LPS: of its file, which is exact, or else as the scene has it.
    fn own_motion(&mut self, node: Node<'a, 'a>) -> Result<Isometry3<f64>, FileError> {
        let stated = ["matrixTransformToParent", "matrixTransformFromParent"].map(|key| node.attribute(key));
        let is_linear = matches!(node.tag_name().name(), "LinearTransform" | "Transform");
        if let Some((place, bytes)) = self.stored(node)?.filter(|_| is_linear) {
            if !bytes.starts_with(b"\x89HDF") {
                return Ok(parse_pose(&place, &bytes, 1.0)?.isometry);
            }
            self.note(format!(
                "transform \"{}\" is stored as HDF5, which is not read; its six digits in the scene are taken",
                name_of(node)
            ));
        }
        let (text, is_inverse) = match stated {
            [Some(text), _] if is_linear => (text, false),
            [_, Some(text)] if is_linear => (text, true),
            _ => {
                let message =
                    "the transform is not linear, or has no matrix; harden it in 3D Slicer, and save the scene again";
                return Err(self.fault(node, message));
            }
        };
        let numbers: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().unwrap_or_default();
        if numbers.len() != 16 {
            return Err(self.fault(node, format!("16 numbers are expected in its matrix, found \"{text}\"")));
        }
        let nearest = nearest_isometry(&Matrix4::from_row_slice(&numbers))
            .map_err(|error| self.fault(node, format!("{error}; harden it in 3D Slicer if this is meant")))?;
        let ras = if is_inverse { nearest.value.inverse() } else { nearest.value };
        let turn = Space::Ras.turn();
        let exact = if numbers == [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0] {
            Isometry3::identity()
        } else {
            turn * ras * turn.inverse()
        };
        Ok(exact)
    }
}
