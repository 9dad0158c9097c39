//! What every format holds: points, and where it has them normals, further columns and faces; and the surface or cloud that
//! this becomes.

use crate::{
    FileError, Space,
    invalid::{Invalid, invalid},
    normals::unit_normals,
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Cloud, FARTHEST_MM, Frame, Mesh, MeshError, SurfaceOrigin, TooFar};
use std::path::Path;

/// A surface this small or this large (mm, the box's diagonal) is hardly a bone or a phantom: the unit is in doubt.
const PLAUSIBLE_MM: std::ops::Range<f64> = 3.0..3000.0;

/// Lengths of unit normals written with few digits.
pub(crate) const UNIT: std::ops::Range<f64> = 0.99..1.01;

/// A surface read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshRead {
    /// The surface, mm.
    pub mesh: Mesh,
    /// How many faces without an area were left out.
    pub n_degenerate: usize,
    /// The axes that the file states; `mesh` is LPS if it states any.
    pub space: Space,
    /// Suspicious properties of the file, one sentence each, such as a size that suggests metres.
    pub notes: Vec<String>,
}

impl MeshRead {
    /// The surface, where `space` is that of a file that does not state one.
    ///
    /// # Errors
    /// A message, if the file states another.
    pub fn in_space(mut self, space: Space) -> Result<Self, String> {
        if let Some(turn) = self.space.turn_to(space)? {
            self.mesh = self.mesh.transformed(self.mesh.frame.clone(), &turn);
        }
        Ok(Self { space, ..self })
    }
}

/// A cloud read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudFileRead {
    /// The finite points, mm, without stamp and viewpoint, which the format does not hold.
    pub cloud: Cloud,
    /// How many points the file has.
    pub n_points_in_file: usize,
    /// How many of them were NaN or infinite and were left out.
    pub n_dropped: usize,
    /// How many were pixels without depth, such as 0, 0, 0 far from all others, and were left out.
    pub n_invalid: usize,
    /// The axes that the file states; `cloud` is LPS if it states any.
    pub space: Space,
    /// Changes to the content and what was left out, one sentence each.
    pub notes: Vec<String>,
}

/// The content of a file in its own unit and space, with points that may be NaN.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    pub(crate) points: Vec<Point3<f64>>,
    /// One for each point, of any length.
    pub(crate) normals: Option<Vec<Vector3<f64>>>,
    /// Further columns, one value for each point.
    pub(crate) extras: Vec<(String, Vec<f64>)>,
    /// None for a cloud.
    pub(crate) faces: Option<Vec<[u32; 3]>>,
    pub(crate) stated: StatedSpace,
    pub(crate) notes: Vec<String>,
    /// Where the points are in the file.
    pub(crate) places: Places,
}

/// Where each point is in the file, for errors.
#[derive(Debug, Default)]
pub(crate) enum Places {
    /// Only their order is known.
    #[default]
    Order,
    /// The line of each.
    Lines(Vec<usize>),
    /// The byte of each.
    Bytes(Vec<usize>),
    /// The byte of the first, and the bytes from one to the next.
    Rows { first: usize, stride: usize },
}

impl Places {
    fn of(&self, index: usize) -> String {
        match self {
            Self::Lines(lines) if index < lines.len() => format!("line {}", lines[index]),
            Self::Bytes(bytes) if index < bytes.len() => format!("byte {}", bytes[index]),
            Self::Rows { first, stride } => format!("byte {}", first + index * stride),
            _ => format!("point {}", index + 1),
        }
    }
}

/// The names of the columns of normals that are in use.
const NORMALS: [[&str; 3]; 2] = [["nx", "ny", "nz"], ["normal_x", "normal_y", "normal_z"]];

/// The normals among the names, as places.
pub(crate) fn normal_columns(mut place: impl FnMut(&str) -> Option<usize>) -> Option<[usize; 3]> {
    NORMALS.iter().find_map(|names| {
        let [x, y, z] = names.map(&mut place);
        Some([x?, y?, z?])
    })
}

impl Shape {
    /// The shape of named columns of equal length: `x`, `y`, `z` at `places`, normals where they are named.
    pub(crate) fn of_columns(mut columns: Vec<(String, Vec<f64>)>, places: [usize; 3]) -> Self {
        let triple = |columns: &[(String, Vec<f64>)], places: [usize; 3]| -> Vec<[f64; 3]> {
            let [x, y, z] = places.map(|k| &columns[k].1);
            (0..x.len()).map(|k| [x[k], y[k], z[k]]).collect()
        };
        let points = triple(&columns, places).into_iter().map(Point3::from).collect();
        let normal_places =
            normal_columns(|name| columns.iter().position(|(column, _)| column.eq_ignore_ascii_case(name)));
        let normals = normal_places.map(|places| triple(&columns, places).into_iter().map(Vector3::from).collect());
        let mut k = 0;
        columns.retain(|_| {
            k += 1;
            !places.contains(&(k - 1)) && !normal_places.is_some_and(|places| places.contains(&(k - 1)))
        });
        Self { points, normals, extras: columns, ..Self::default() }
    }

    /// Checks that the file states no other unit, and that no finite point is farther than [`FARTHEST_MM`] once it is in mm.
    fn check_lengths(&self, path: &Path, unit_mm: f64) -> Result<(), FileError> {
        self.stated.check_unit(unit_mm).map_err(|message| FileError::content(path, "header", message))?;
        let far = |p: &Point3<f64>| TooFar::check((p.coords * unit_mm).as_slice()).err();
        // A loop without branches is the fastest, and such points are rare.
        let limit = FARTHEST_MM / unit_mm;
        let is_near = |p: &Point3<f64>| (p.x.abs() <= limit) & (p.y.abs() <= limit) & (p.z.abs() <= limit);
        if self.points.iter().fold(true, |near, p| near & is_near(p)) {
            return Ok(());
        }
        let is_finite = |p: &Point3<f64>| p.coords.iter().all(|c| c.is_finite());
        let mut finite = self.points.iter().enumerate().filter(|(_, p)| is_finite(p));
        let Some((index, far)) = finite.find_map(|(index, p)| Some((index, far(p)?))) else { return Ok(()) };
        let Point3 { coords: p } = self.points[index];
        let unit = if unit_mm == 1.0 { String::new() } else { format!(" in units of {unit_mm} mm") };
        let message = format!("the point ({:?}, {:?}, {:?}){unit}: {far}", p.x, p.y, p.z);
        Err(FileError::content(path, self.places.of(index), message))
    }

    /// Turns points and normals to LPS and points to mm, and gives the notes.
    fn place(&mut self, unit_mm: f64) -> (Space, Vec<String>) {
        let StatedSpace { space, note, .. } = std::mem::take(&mut self.stated);
        let sign = space.x_y_sign();
        let factors = Vector3::new(sign * unit_mm, sign * unit_mm, unit_mm);
        if factors != Vector3::repeat(1.0) {
            self.points.iter_mut().for_each(|p| p.coords.component_mul_assign(&factors));
        }
        let mut notes = std::mem::take(&mut self.notes);
        notes.extend(note);
        if space == Space::Ras {
            for normal in self.normals.iter_mut().flatten() {
                (normal.x, normal.y) = (-normal.x, -normal.y);
            }
            notes.push("the file states SPACE=RAS; x and y were negated, which gives LPS".into());
        }
        (space, notes)
    }

    /// Keeps some of the points, with their normals and further columns.
    fn retain(&mut self, keep: &[bool]) {
        retain(&mut self.points, keep);
        self.normals.iter_mut().for_each(|normals| retain(normals, keep));
        self.extras.iter_mut().for_each(|(_, values)| retain(values, keep));
    }

    /// The points that are finite and have depth, with their normals and further columns.
    pub(crate) fn into_cloud(mut self, path: &Path, unit_mm: f64, frame: Frame) -> Result<CloudFileRead, FileError> {
        self.check_lengths(path, unit_mm)?;
        let n_points_in_file = self.points.len();
        let is_finite = |p: &Point3<f64>| p.x.is_finite() & p.y.is_finite() & p.z.is_finite();
        // No early end: a loop without branches is the fastest, and points that are not finite are rare.
        if !self.points.iter().fold(true, |finite, p| finite & is_finite(p)) {
            self.retain(&self.points.iter().map(is_finite).collect::<Vec<_>>());
        }
        let n_dropped = n_points_in_file - self.points.len();
        let mut n_invalid = 0;
        if let Some(Invalid { keep, n, note }) = invalid(&self.points, n_points_in_file) {
            self.retain(&keep);
            self.notes.push(note);
            n_invalid = n;
        }
        if n_points_in_file == 0 {
            let message = "there is no point in the file; was it exported from an empty selection?";
            return Err(FileError::content(path, "points", message));
        }
        self.notes.extend(scale_colours(&mut self.extras, false));
        let (space, mut notes) = self.place(unit_mm);
        let mut cloud = Cloud::new(frame, self.points)
            .map_err(|error| FileError::content(path, "points", format!("{error} (unit_mm = {unit_mm})")))?;
        if let Some(normals) = self.normals {
            let (normals, normal_notes) = unit_normals(normals);
            notes.extend(normal_notes);
            if let Some(normals) = normals {
                cloud = cloud.with_normals(normals).expect("each kept point has its unit normal");
            }
        }
        for (name, values) in self.extras {
            cloud = cloud.with_extra(name, values).expect("each kept point has its value");
        }
        Ok(CloudFileRead { cloud, n_points_in_file, n_dropped, n_invalid, space, notes })
    }

    /// The surface.
    pub(crate) fn into_mesh(
        mut self,
        path: &Path,
        unit_mm: f64,
        frame: Frame,
        origin: SurfaceOrigin,
    ) -> Result<MeshRead, FileError> {
        let Some(faces) = self.faces.take() else {
            let message = format!(
                "the file holds {} points and no faces, but a surface is needed; export the bone as triangles",
                self.points.len()
            );
            return Err(FileError::content(path, "surface", message));
        };
        self.check_lengths(path, unit_mm)?;
        let (space, mut notes) = self.place(unit_mm);
        let (vertices, places) = (self.points, self.places);
        let n_faces = faces.len();
        let is_proper = |&[a, b, c]: &[u32; 3]| {
            // A corner that is not there is for the mesh to name.
            let corner = |i: u32| vertices.get(i as usize);
            let (Some(a), Some(b), Some(c)) = (corner(a), corner(b), corner(c)) else { return true };
            (b - a).cross(&(c - a)) != Vector3::zeros()
        };
        let faces: Vec<[u32; 3]> = faces.into_iter().filter(is_proper).collect();
        let n_degenerate = n_faces - faces.len();
        let mesh = Mesh::new(frame, origin, vertices, faces).map_err(|error| {
            let (place, advice) = match error {
                MeshError::Empty => ("surface".into(), "give the bone's surface, not its points"),
                MeshError::NotFinite { vertex } => (places.of(vertex), "export the surface again"),
                _ => ("surface".into(), "export the surface again"),
            };
            FileError::content(path, place, format!("{error}; {advice}"))
        })?;
        if n_degenerate > 0 {
            notes.push(format!("{n_degenerate} of {n_faces} faces have no area and were left out"));
        }
        notes.extend(size_note(mesh.vertices(), "surface spans"));
        Ok(MeshRead { mesh, n_degenerate, space, notes })
    }
}

/// Keeps the values of the points to keep.
pub(crate) fn retain<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    values.retain(|_| *keep.next().expect("one for each value"));
}

/// The triangles of a polygon as a fan around its first corner; one without an area if it has fewer than three corners.
pub(crate) fn fan(faces: &mut Vec<[u32; 3]>, corners: &[u32]) {
    match corners {
        [] => faces.push([0; 3]),
        &[a] | &[a, _] => faces.push([a; 3]),
        &[a, ref rest @ ..] => faces.extend(rest.windows(2).map(|w| [a, w[0], w[1]])),
    }
}

/// Scales colours from 0 to 1, as of MeshLab's OBJ, to whole numbers up to 255; with a note. Unless `may_be_whole`, one of them has a
/// fraction: where whole numbers are bytes, 1 is nearly black.
fn scale_colours(columns: &mut [(String, Vec<f64>)], may_be_whole: bool) -> Option<String> {
    let is_colour = |name: &str| ["red", "green", "blue"].iter().any(|colour| name.eq_ignore_ascii_case(colour));
    let mut colours: Vec<_> =
        columns.iter_mut().filter(|(name, _)| is_colour(name)).map(|(_, values)| values).collect();
    let values = || colours.iter().flat_map(|values| values.iter().copied());
    let is_scaled = colours.len() == 3
        && values().all(|value| (0.0..=1.0).contains(&value))
        && values().any(|value| if may_be_whole { value > 0.0 } else { value.fract() != 0.0 });
    if !is_scaled {
        return None;
    }
    colours.iter_mut().for_each(|values| values.iter_mut().for_each(|value| *value = (*value * 255.0).round()));
    Some("colours from 0 to 1 were scaled to 0 to 255".into())
}

/// Columns of red, green and blue, with a note if they were from 0 to 1.
pub(crate) fn of_colours(colours: &[[f64; 3]], notes: &mut Vec<String>) -> Vec<(String, Vec<f64>)> {
    let column = |k: usize| colours.iter().map(|colour| colour[k]).collect();
    if colours.is_empty() {
        return Vec::new();
    }
    let mut columns: Vec<_> =
        ["red", "green", "blue"].into_iter().enumerate().map(|(k, name)| (name.into(), column(k))).collect();
    notes.extend(scale_colours(&mut columns, true));
    columns
}

/// A note on an implausible size; `what` names the surface or cloud.
pub(crate) fn size_note(points: &[Point3<f64>], what: &str) -> Option<String> {
    let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for point in points {
        // Coordinates are finite: plain comparisons take a fifth of the time of `f64::min`, which minds NaN.
        for (k, &c) in point.iter().enumerate() {
            min[k] = if c < min[k] { c } else { min[k] };
            max[k] = if c > max[k] { c } else { max[k] };
        }
    }
    let span_mm = Some((Point3::from(max) - Point3::from(min)).norm()).filter(|_| !points.is_empty())?;
    let advice = match span_mm {
        s if PLAUSIBLE_MM.contains(&s) => return None,
        s if s < PLAUSIBLE_MM.start => "is the file in metres? then give unit_mm = 1000",
        _ => "is the file in micrometres? then give unit_mm = 0.001",
    };
    Some(format!("the {what} {span_mm:.3} mm, which is no size of a bone or phantom; {advice}"))
}
