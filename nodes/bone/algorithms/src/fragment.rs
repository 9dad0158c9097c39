//! The fragment of a bone between two cuts, as a closed surface.

mod outline;
mod triangulate;

use crate::Refusal;
use crate::{mesh_topology, section};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Mesh, Plane, PlanePlace, Planes, SurfaceOrigin};
use std::collections::HashMap;

/// Maximum distance of an outline from the plane's origin, mm: more than a fibula is thick, less than the distance at
/// which a bent bone might be cut again.
pub(crate) const REACH_MM: f64 = 60.0;

/// A vertex this near to a plane lies on it, mm: far below any measurement, far above rounding.
const ON_PLANE_MM: f64 = 1e-7;

const NONE: u32 = u32::MAX;

/// The origin of a face of a fragment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaceKind {
    /// The bone's own surface.
    Wall,
    /// The face of the first (0) or the second (1) cut.
    Cap(usize),
}

/// A piece of a bone. If the bone is closed, so is the piece.
#[derive(Debug, Clone, PartialEq)]
pub struct Fragment {
    /// Its surface, in the bone's frame.
    pub mesh: Mesh,
    /// The origin of each face.
    pub face_kinds: Vec<FaceKind>,
}

/// One side of a plane.
#[derive(Debug, Clone, PartialEq)]
pub struct HalfSpace {
    /// The plane's name.
    pub name: String,
    /// A point of the plane, mm.
    pub point: Point3<f64>,
    /// The unit normal towards the inside.
    pub inward: Vector3<f64>,
}

impl HalfSpace {
    /// The half space moved by `motion`.
    pub fn moved(&self, motion: &Isometry3<f64>) -> Self {
        Self { name: self.name.clone(), point: motion * self.point, inward: motion * self.inward }
    }

    /// Distance of a point from the plane, mm; negative outside.
    pub fn height_mm(&self, point: &Point3<f64>) -> f64 {
        (point - self.point).dot(&self.inward)
    }
}

/// The half spaces between two planned planes, whichever way their normals point: each plane keeps the side on which
/// the other one cuts the bone. The points are the centres of the bone's outlines. `O(m)`.
///
/// # Errors
/// [`Refusal`] if there are not two known planes, one misses the bone, or both cut it in one place.
pub fn between(bone: &Mesh, planes: &Planes) -> Result<[HalfSpace; 2], Refusal> {
    let [first, second] = &*planes.planes else {
        let n = planes.planes.len();
        return Err(Refusal::of(format!("a fragment lies between two planes, but there are {n}; give the plan two")));
    };
    let cut = |plane: &Plane| -> Result<_, Refusal> {
        let t = known(plane)?;
        let middle = section::middle(bone, t, Some(REACH_MM)).ok_or_else(|| misses(&plane.name))?;
        Ok((middle, t * Vector3::z()))
    };
    let cuts = [cut(first)?, cut(second)?];
    let side = |plane: &Plane, here: usize| {
        let (point, normal) = cuts[here];
        let towards = (cuts[1 - here].0 - point).dot(&normal);
        let half = HalfSpace { name: plane.name.to_string(), point, inward: normal * towards.signum() };
        (towards.abs() > ON_PLANE_MM).then_some(half)
    };
    match (side(first, 0), side(second, 1)) {
        (Some(a), Some(b)) => Ok([a, b]),
        _ => Err(Refusal::of(format!(
            "{} and {} cut the bone in one place, so nothing lies between them; are they the same plane?",
            first.name, second.name
        ))),
    }
}

/// The pose of a plane whose place is known.
pub(crate) fn known(plane: &Plane) -> Result<&Isometry3<f64>, Refusal> {
    match &plane.place {
        PlanePlace::Known(t) => Ok(t),
        PlanePlace::Unknown(reason) => Err(Refusal::of(format!("plane {} is unknown: {reason}", plane.name))),
    }
}

fn misses(name: &str) -> Refusal {
    Refusal::of(format!(
        "{name} does not cut the bone within {REACH_MM} mm of its origin; is the plane in the bone's frame, or is the \
         registration far off?"
    ))
}

/// The piece of `bone` inside both half spaces, closed by a face at each cut, in the bone's frame.
///
/// Vertices of the bone are unchanged; an edge that crosses a plane gets one new vertex, shared by both faces at the
/// edge, so a closed bone gives a closed piece. The cut faces follow the outline, whatever its shape, with holes where
/// the bone is hollow. Of several pieces (a plane may cut a bent bone twice) the result is the one that extends from
/// cut to cut nearest to the half spaces' points, with the cavities inside it. `O(m log m)`.
///
/// # Errors
/// [`Refusal`] if a plane misses the bone or the bone is open where it is cut.
///
/// # Source
/// Sutherland and Hodgman 1974 for the faces; Chew 1989 for the constrained Delaunay triangulation of the cut faces.
pub fn fragment(bone: &Mesh, cuts: &[HalfSpace; 2]) -> Result<Fragment, Refusal> {
    let mut piece = Piece {
        vertices: bone.vertices().to_vec(),
        faces: bone.faces().to_vec(),
        face_kinds: vec![FaceKind::Wall; bone.faces().len()],
    };
    for (index, cut) in cuts.iter().enumerate() {
        piece = piece.clipped(cut, index)?;
    }
    piece.nearest(cuts)?.into_fragment(bone.frame.clone(), bone.origin).ok_or_else(|| misses(&cuts[0].name))
}

impl Fragment {
    /// The corners of the cut faces, mm.
    pub fn rim(&self) -> Vec<Point3<f64>> {
        let caps = self.mesh.faces().iter().zip(&self.face_kinds).filter(|(_, kind)| **kind != FaceKind::Wall);
        let mut corners: Vec<u32> = caps.flat_map(|(face, _)| *face).collect();
        corners.sort_unstable();
        corners.dedup();
        corners.into_iter().map(|v| self.mesh.vertices()[v as usize]).collect()
    }
}

/// A closed surface that is being clipped.
struct Piece {
    vertices: Vec<Point3<f64>>,
    faces: Vec<[u32; 3]>,
    face_kinds: Vec<FaceKind>,
}

/// Vertices of a clipped piece: those of the old one inside, and new ones on crossed edges.
struct ClippedVertices<'a> {
    old: &'a [Point3<f64>],
    heights: &'a [f64],
    kept: Vec<u32>,
    /// Never iterated over.
    crossings: HashMap<(u32, u32), u32>,
    vertices: Vec<Point3<f64>>,
}

impl ClippedVertices<'_> {
    fn is_in(&self, v: u32) -> bool {
        self.heights[v as usize] >= 0.0
    }

    fn keep(&mut self, v: u32) -> u32 {
        let place = &mut self.kept[v as usize];
        if *place == NONE {
            *place = self.vertices.len() as u32;
            self.vertices.push(self.old[v as usize]);
        }
        *place
    }

    /// The vertex at the intersection of the plane with the edge from a vertex inside to one outside.
    fn cross(&mut self, inside: u32, outside: u32) -> u32 {
        let (high, low) = (self.heights[inside as usize], self.heights[outside as usize]);
        if high == 0.0 {
            return self.keep(inside);
        }
        let (old, vertices) = (self.old, &mut self.vertices);
        *self.crossings.entry((inside, outside)).or_insert_with(|| {
            let (a, b) = (old[inside as usize], old[outside as usize]);
            vertices.push(a + (b - a) * (high / (high - low)));
            vertices.len() as u32 - 1
        })
    }
}

impl Piece {
    /// The part inside the half space, closed at the plane by faces of cap `index`.
    fn clipped(&self, cut: &HalfSpace, index: usize) -> Result<Self, Refusal> {
        let snap = |height: f64| if height.abs() <= ON_PLANE_MM { 0.0 } else { height };
        let heights: Vec<f64> = self.vertices.iter().map(|v| snap(cut.height_mm(v))).collect();
        let mut clipped = ClippedVertices {
            old: &self.vertices,
            heights: &heights,
            kept: vec![NONE; self.vertices.len()],
            crossings: HashMap::new(),
            vertices: Vec::new(),
        };
        let (mut faces, mut face_kinds, mut rim) = (Vec::new(), Vec::new(), Vec::new());
        for (face, kind) in self.faces.iter().zip(&self.face_kinds) {
            let n_in = face.iter().filter(|v| clipped.is_in(**v)).count();
            if n_in == 0 {
                continue;
            }
            let mut corners: Vec<u32> = Vec::with_capacity(4);
            let (mut leaves, mut enters) = (NONE, NONE);
            for k in 0..3 {
                let (here, next) = (face[k], face[(k + 1) % 3]);
                if clipped.is_in(here) {
                    corners.push(clipped.keep(here));
                }
                match (clipped.is_in(here), clipped.is_in(next)) {
                    (true, false) => {
                        leaves = clipped.cross(here, next);
                        corners.push(leaves);
                    }
                    (false, true) => {
                        enters = clipped.cross(next, here);
                        corners.push(enters);
                    }
                    _ => {}
                }
            }
            // The cap runs along its rim in the opposite direction.
            if leaves != enters {
                rim.push([enters, leaves]);
            }
            if n_in < 3 {
                corners.dedup();
                while corners.len() > 1 && corners.first() == corners.last() {
                    corners.pop();
                }
            }
            match corners[..] {
                [a, b, c] => faces.push([a, b, c]),
                [a, b, c, d] => {
                    let length = |p: u32, q: u32| clipped.vertices[p as usize] - clipped.vertices[q as usize];
                    if length(a, c).norm_squared() <= length(b, d).norm_squared() {
                        faces.extend([[a, b, c], [a, c, d]]);
                    } else {
                        faces.extend([[a, b, d], [b, c, d]]);
                    }
                }
                _ => {}
            }
            face_kinds.resize(faces.len(), *kind);
        }
        let vertices = clipped.vertices;
        let loops = outline::loops(&rim).map_err(|n_edges| {
            let name = &cut.name;
            Refusal::of(format!(
                "the bone's surface is open where {name} cuts it ({n_edges} loose ends); close the mesh first"
            ))
        })?;
        // Seen from outside, so that faces are counter-clockwise.
        let u = cut.inward.cross(&Vector3::ith(cut.inward.iamin(), 1.0)).normalize();
        let v = u.cross(&cut.inward);
        let flat = |i: u32| {
            let offset = vertices[i as usize] - cut.point;
            [offset.dot(&u), offset.dot(&v)]
        };
        faces.extend(triangulate::cap(&loops, &flat));
        face_kinds.resize(faces.len(), FaceKind::Cap(index));
        Ok(Self { vertices, faces, face_kinds })
    }

    /// The component that extends from cut to cut nearest to the points of both, with the cavities inside it.
    fn nearest(self, cuts: &[HalfSpace; 2]) -> Result<Self, Refusal> {
        let (component, n) = mesh_topology::components(self.vertices.len(), &self.faces);
        let mut known = vec![Component::default(); n];
        for (face, kind) in self.faces.iter().zip(&self.face_kinds) {
            let own = &mut known[component[face[0] as usize]];
            for v in face.map(|v| self.vertices[v as usize]) {
                own.min = own.min.inf(&v);
                own.max = own.max.sup(&v);
                if let FaceKind::Cap(k) = kind {
                    own.reach[*k] = own.reach[*k].min((v - cuts[*k].point).norm());
                }
            }
        }
        for (k, cut) in cuts.iter().enumerate() {
            if known.iter().all(|c| c.reach[k] > REACH_MM) {
                return Err(misses(&cut.name));
            }
        }
        let span = |c: &Component| c.reach[0] + c.reach[1];
        let main = (0..n)
            .min_by(|&a, &b| span(&known[a]).total_cmp(&span(&known[b])))
            .filter(|&c| span(&known[c]).is_finite());
        let Some(main) = main else {
            return Err(misses(&cuts[1].name));
        };
        let (min, max) = (known[main].min, known[main].max);
        let within = |c: &Component| (c.min - min).min() >= 0.0 && (max - c.max).min() >= 0.0;
        let kept: Vec<bool> = (0..n).map(|c| c == main || within(&known[c])).collect();
        Ok(self.only(|face| kept[component[face[0] as usize]]))
    }

    /// The selected faces, with the vertices that they use.
    fn only(self, wanted: impl Fn(&[u32; 3]) -> bool) -> Self {
        let mut place = vec![NONE; self.vertices.len()];
        let mut left = Self { vertices: Vec::new(), faces: Vec::new(), face_kinds: Vec::new() };
        for (face, kind) in self.faces.iter().zip(&self.face_kinds).filter(|(face, _)| wanted(face)) {
            left.faces.push(face.map(|v| {
                if place[v as usize] == NONE {
                    place[v as usize] = left.vertices.len() as u32;
                    left.vertices.push(self.vertices[v as usize]);
                }
                place[v as usize]
            }));
            left.face_kinds.push(*kind);
        }
        left
    }

    /// `None` without faces.
    fn into_fragment(self, frame: osteoflow_geometry::Frame, origin: SurfaceOrigin) -> Option<Fragment> {
        let mesh = Mesh::new(frame, origin, self.vertices, self.faces).ok()?;
        Some(Fragment { mesh, face_kinds: self.face_kinds })
    }
}

/// The extent of a connected component.
#[derive(Clone)]
struct Component {
    min: Point3<f64>,
    max: Point3<f64>,
    /// Distance of its face at each cut from that cut's point, mm.
    reach: [f64; 2],
}

impl Default for Component {
    fn default() -> Self {
        let far = f64::INFINITY;
        Self { min: Point3::new(far, far, far), max: Point3::new(-far, -far, -far), reach: [far; 2] }
    }
}

#[cfg(test)]
pub(crate) mod tests;
