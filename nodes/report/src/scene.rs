//! A view in three dimensions for the page's viewer: meshes, points and lines, quantised to 16 bits.

mod drawing;

use crate::format::number;
use base64::{Engine, engine::general_purpose::STANDARD};
use drawing::{Drawn, Solid, Tint};
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_draw::xml::escape;
use osteoflow_geometry::Mesh;
use serde_json::{Value as Json, json};
use std::{
    collections::BTreeMap,
    ops::{AddAssign, Div},
};

/// Blue over white to red (ColorBrewer's RdBu), safe for colour-blind readers.
const DIVERGING: [&str; 7] = ["#2166ac", "#67a9cf", "#d1e5f0", "#f7f7f7", "#fddbc7", "#ef8a62", "#b2182b"];

/// Registered or planned.
pub(crate) const BLUE: &str = "#0072b2";
/// Measured or executed.
pub(crate) const RED: &str = "#d55e00";
/// The bone.
pub(crate) const BONE: &str = "#c9c2b4";

/// Meshes with more faces are simplified for the page.
const MAX_FACES: usize = 60_000;
/// Clouds with more points are thinned out by stride.
const MAX_POINTS: usize = 40_000;

/// A view.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    parts: Vec<Json>,
    /// The same content for the SVG drawing.
    drawn: Vec<Drawn>,
    legend: Vec<(String, String)>,
    ramp: Option<(String, f64)>,
    centre: Point3<f64>,
    /// Half the visible width at the start, mm.
    half_width: f64,
    turn: Matrix3<f64>,
    /// Ratio of width to height.
    pub(crate) aspect: f64,
}

impl Scene {
    /// A scene that shows all of `points`: `towards` points from the scene to the viewer, `along` from left to right.
    pub(crate) fn looking(points: &[Point3<f64>], along: Vector3<f64>, towards: Vector3<f64>) -> Self {
        let fallback = |v: Vector3<f64>, or: Vector3<f64>| v.try_normalize(1e-9).unwrap_or(or);
        let right = fallback(along, Vector3::x());
        let viewer = fallback(towards - right * towards.dot(&right), any_across(&right));
        let up = viewer.cross(&right);
        let turn = Matrix3::from_rows(&[right.transpose(), up.transpose(), viewer.transpose()]);
        let seen: Vec<Vector3<f64>> = points.iter().map(|p| turn * p.coords).collect();
        let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        for p in &seen {
            (low, high) = (low.inf(p), high.sup(p));
        }
        if seen.is_empty() {
            (low, high) = (Vector3::repeat(-1.0), Vector3::repeat(1.0));
        }
        let size = (high - low).map(|s| s.max(1.0));
        let aspect = (size.x / size.y.max(size.z)).clamp(1.6, 2.6);
        let half_width = 0.62 * size.x.max(size.y.max(size.z) * aspect);
        let centre = Point3::from(turn.transpose() * ((low + high) / 2.0));
        Self { parts: Vec::new(), drawn: Vec::new(), legend: Vec::new(), ramp: None, centre, half_width, turn, aspect }
    }

    /// Adds a surface that the page shares by name.
    pub(crate) fn shared_mesh(&mut self, name: &str, mesh: &Mesh, colour: &str) {
        self.parts.push(json!({ "type": "mesh", "data": name, "colour": colour }));
        self.draw_mesh((mesh.vertices(), mesh.faces()), 1.0, Tint::Plain(colour.into()));
    }

    /// Adds a surface; transparent if `opacity` is below 1.
    pub(crate) fn mesh(&mut self, vertices: &[Point3<f64>], faces: &[[u32; 3]], colour: &str, opacity: f64) {
        let own = indexed(vertices, faces);
        self.parts.push(json!({ "type": "mesh", "own": own, "colour": colour, "opacity": opacity }));
        self.draw_mesh((vertices, faces), opacity, Tint::Plain(colour.into()));
    }

    /// Adds a surface coloured by a signed value at each vertex, clamped to `max`.
    pub(crate) fn coloured_mesh(&mut self, vertices: &[Point3<f64>], faces: &[[u32; 3]], values: &[f64], max: f64) {
        let mut own = indexed(vertices, faces);
        own["values"] = levels(values, max).into();
        self.parts.push(json!({ "type": "mesh", "own": own, "ramp": DIVERGING }));
        self.draw_mesh((vertices, faces), 1.0, Tint::Values(values.to_vec(), max));
    }

    fn draw_mesh(&mut self, (vertices, faces): (&[Point3<f64>], &[[u32; 3]]), opacity: f64, tint: Tint) {
        let what = Solid::Mesh { vertices: vertices.to_vec(), faces: faces.to_vec(), opacity };
        self.drawn.push(Drawn { what, tint });
    }

    /// Adds points as balls.
    pub(crate) fn points(&mut self, points: &[Point3<f64>], radius_mm: f64, colour: &str) {
        self.parts.push(json!({ "type": "points", "own": positions(points), "colour": colour, "radius": radius_mm }));
        let what = Solid::Points { points: points.to_vec(), radius_mm };
        self.drawn.push(Drawn { what, tint: Tint::Plain(colour.into()) });
    }

    /// Adds points coloured by a signed value, clamped to `max`.
    pub(crate) fn coloured_points(&mut self, points: &[Point3<f64>], values: &[f64], max: f64, radius_mm: f64) {
        let every = points.len().div_ceil(MAX_POINTS).max(1);
        let points: Vec<_> = points.iter().copied().step_by(every).collect();
        let values: Vec<_> = values.iter().copied().step_by(every).collect();
        let mut own = positions(&points);
        own["values"] = levels(&values, max).into();
        self.parts.push(json!({ "type": "points", "own": own, "ramp": DIVERGING, "radius": radius_mm }));
        self.drawn.push(Drawn { what: Solid::Points { points, radius_mm }, tint: Tint::Values(values, max) });
    }

    /// Adds lines between pairs of points.
    pub(crate) fn lines(&mut self, ends: &[Point3<f64>], colour: &str) {
        if !ends.is_empty() {
            self.parts.push(json!({ "type": "lines", "own": positions(ends), "colour": colour }));
            self.drawn.push(Drawn { what: Solid::Lines(ends.to_vec()), tint: Tint::Plain(colour.into()) });
        }
    }

    /// Adds a label beside a point.
    pub(crate) fn tag(&mut self, at: &Point3<f64>, word: &str) {
        self.parts.push(json!({ "type": "tag", "at": [at.x, at.y, at.z], "word": word }));
        self.drawn.push(Drawn { what: Solid::Tag(*at, word.into()), tint: Tint::Plain(BONE.into()) });
    }

    /// Adds a colour to the legend.
    pub(crate) fn key(&mut self, colour: &str, what: &str) {
        self.legend.push((colour.into(), what.into()));
    }

    /// Adds a colour scale from `-max` to `max`, in mm, to the legend.
    pub(crate) fn ramp(&mut self, what: &str, max: f64) {
        self.ramp = Some((what.into(), max));
    }

    pub(crate) fn json(&self) -> Json {
        json!({
            "parts": self.parts,
            "centre": self.centre.coords.as_slice(),
            "halfWidth": self.half_width,
            "turn": self.turn.as_slice(),
        })
    }

    pub(crate) fn legend_html(&self) -> String {
        let mut out = String::from("<div class=\"legend\">");
        for (colour, what) in &self.legend {
            out += &format!("<span><i class=\"key\" style=\"background: {colour}\"></i>{}</span>", escape(what));
        }
        if let Some((what, max)) = &self.ramp {
            let max = number(*max);
            out += &format!(
                "<span>{} <span>\u{2212}{max}</span><i class=\"ramp\" role=\"img\" aria-label=\"from blue, minus {max} \
                 mm, over white to red, {max} mm\" style=\"background: linear-gradient(to right, {})\"></i><span>+{max} \
                 mm</span></span>",
                escape(what),
                DIVERGING.join(", ")
            );
        }
        out + "</div>"
    }
}

/// The next larger of 1, 1.5, 2, 3, 4, 5, 6, 8, 10 times a power of ten, for the end of a colour scale.
pub(crate) fn round_up(value: f64) -> f64 {
    let value = value.max(1e-6);
    let power = 10f64.powf(value.log10().floor());
    let steps = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0];
    steps.into_iter().map(|step| step * power).find(|step| *step >= value * (1.0 - 1e-9)).unwrap_or(value)
}

fn any_across(v: &Vector3<f64>) -> Vector3<f64> {
    let least = if v.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    (least - v * v.dot(&least)).normalize()
}

/// Positions with 16 bits per coordinate, from their lowest corner in steps of `step` mm.
fn positions(points: &[Point3<f64>]) -> Json {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for p in points {
        (low, high) = (low.inf(&p.coords), high.sup(&p.coords));
    }
    if points.is_empty() {
        (low, high) = (Vector3::zeros(), Vector3::zeros());
    }
    let step = ((high - low).max() / f64::from(u16::MAX)).max(1e-9);
    let bytes: Vec<u8> = points
        .iter()
        .flat_map(|p| ((p.coords - low) / step).iter().map(|c| c.round() as u16).collect::<Vec<_>>())
        .flat_map(u16::to_le_bytes)
        .collect();
    json!({ "positions": STANDARD.encode(bytes), "low": low.as_slice(), "step": step })
}

/// Values from `-max` to `max` with 8 bits each.
fn levels(values: &[f64], max: f64) -> String {
    let level = |v: &f64| (127.5 * (v / max).clamp(-1.0, 1.0) + 127.5).round() as u8;
    STANDARD.encode(values.iter().map(level).collect::<Vec<_>>())
}

/// A surface for the page, simplified if it has many faces.
pub(crate) fn surface(mesh: &Mesh) -> Json {
    let (groups, faces) = thinned(mesh.vertices(), mesh.faces(), MAX_FACES);
    let positions: Vec<_> = mesh.vertices().iter().map(|p| p.coords).collect();
    let vertices: Vec<_> = groups.means(&positions).into_iter().map(Point3::from).collect();
    indexed(&vertices, &faces)
}

/// A surface with all its faces, in the order of its vertices.
fn indexed(vertices: &[Point3<f64>], faces: &[[u32; 3]]) -> Json {
    let mut data = positions(vertices);
    let bytes: Vec<u8> = faces.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
    data["faces"] = STANDARD.encode(bytes).into();
    data
}

/// Groups of vertices that were merged.
struct Groups {
    /// The group of each vertex; if empty, every vertex is a group.
    of_vertex: Option<Vec<u32>>,
    n: usize,
}

impl Groups {
    /// One value for each group: the mean of its vertices' values.
    fn means<T: Copy + AddAssign + Div<f64, Output = T>>(&self, values: &[T]) -> Vec<T> {
        let Some(of_vertex) = &self.of_vertex else { return values.to_vec() };
        let mut sums: Vec<Option<(T, f64)>> = vec![None; self.n];
        for (group, value) in of_vertex.iter().zip(values) {
            match &mut sums[*group as usize] {
                Some((sum, n)) => {
                    *sum += *value;
                    *n += 1.0;
                }
                none => *none = Some((*value, 1.0)),
            }
        }
        sums.into_iter().flatten().map(|(sum, n)| sum / n).collect()
    }
}

/// At max `max` faces: all if they are few, otherwise by merging vertices in cubes that grow until the faces are few enough.
fn thinned(vertices: &[Point3<f64>], faces: &[[u32; 3]], max: usize) -> (Groups, Vec<[u32; 3]>) {
    if faces.len() <= max {
        return (Groups { of_vertex: None, n: vertices.len() }, faces.to_vec());
    }
    let corners = |face: &[u32; 3]| face.map(|v| vertices[v as usize]);
    let area = |[a, b, c]: [Point3<f64>; 3]| 0.5 * (b - a).cross(&(c - a)).norm();
    let area: f64 = faces.iter().map(|face| area(corners(face))).sum();
    // A cube on a surface holds about two faces of half the area of its side.
    let mut side = (2.0 * area / max as f64).sqrt().max(1e-6);
    loop {
        let mut cubes: BTreeMap<[i64; 3], u32> = BTreeMap::new();
        let mut of_vertex = Vec::with_capacity(vertices.len());
        for p in vertices {
            let n = cubes.len() as u32;
            of_vertex.push(*cubes.entry([p.x, p.y, p.z].map(|c| (c / side).floor() as i64)).or_insert(n));
        }
        let kept = faces.iter().map(|face| face.map(|v| of_vertex[v as usize]));
        let kept: Vec<_> = kept.filter(|[a, b, c]| a != b && b != c && a != c).collect();
        if kept.len() <= max {
            return (Groups { of_vertex: Some(of_vertex), n: cubes.len() }, kept);
        }
        side *= 1.2;
    }
}

/// The intersection of a surface with the xy plane of `t_mesh_plane`, as pairs of points.
pub(crate) fn outline(mesh: &Mesh, t_mesh_plane: &nalgebra::Isometry3<f64>, reach_mm: f64) -> Vec<Point3<f64>> {
    let mut ends = Vec::new();
    for face in 0..mesh.faces().len() {
        let corners = mesh.corners(face).map(|p| t_mesh_plane.inverse_transform_point(&p));
        let mut cut = Vec::with_capacity(2);
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            if (a.z < 0.0) != (b.z < 0.0) {
                cut.push(a + (b - a) * (a.z / (a.z - b.z)));
            }
        }
        if cut.len() == 2 && cut.iter().all(|p| p.coords.norm() <= reach_mm) {
            ends.extend(cut.iter().map(|p| t_mesh_plane * p));
        }
    }
    ends
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;
    use osteoflow_geometry::SurfaceOrigin;

    fn grid(n: usize) -> Mesh {
        let vertices: Vec<_> = (0..=n)
            .flat_map(|i| (0..=n).map(move |j| Point3::new(i as f64, j as f64, ((i * 7 + j) % 3) as f64 * 0.01)))
            .collect();
        let at = |i: usize, j: usize| (i * (n + 1) + j) as u32;
        let faces: Vec<_> = (0..n)
            .flat_map(|i| {
                (0..n).flat_map(move |j| {
                    [[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]]
                })
            })
            .collect();
        Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
    }

    #[test]
    fn a_colour_bar_ends_at_a_round_number() {
        let ends = [0.138, 0.15, 0.151, 0.94, 0.2, 12.0].map(round_up);
        for (end, expected) in ends.into_iter().zip([0.15, 0.15, 0.2, 1.0, 0.2, 15.0]) {
            assert!((end - expected).abs() < 1e-9, "{end} is not {expected}");
        }
    }

    #[test]
    fn a_fine_mesh_is_simplified_and_stays_in_place() {
        let mesh = grid(100);
        let (groups, faces) = thinned(mesh.vertices(), mesh.faces(), 2000);
        assert!((500..=2000).contains(&faces.len()), "{} faces", faces.len());
        let vertices = groups.means(&mesh.vertices().iter().map(|p| p.coords).collect::<Vec<_>>());
        assert!(vertices.iter().all(|p| p.z.abs() <= 0.021 && p.x >= 0.0 && p.x <= 100.0));
        assert_eq!(thinned(mesh.vertices(), mesh.faces(), 20_000).1.len(), 20_000, "few enough: as it is");
    }

    #[test]
    fn positions_are_quantised_within_half_a_step() {
        let points = [Point3::new(-80.0, 3.0, -890.0), Point3::new(270.0, 3.5, -889.0)];
        let json = positions(&points);
        let bytes = STANDARD.decode(json["positions"].as_str().unwrap()).unwrap();
        let step = json["step"].as_f64().unwrap();
        assert!(step < 0.006, "350 mm in steps of {step} mm");
        let back = f64::from(u16::from_le_bytes([bytes[6], bytes[7]])) * step + json["low"][0].as_f64().unwrap();
        assert!((back - 270.0).abs() <= 0.5 * step);
    }

    #[test]
    fn a_plane_cuts_a_mesh_along_its_outline() {
        let across = Isometry3::rotation(Vector3::y() * std::f64::consts::FRAC_PI_2);
        let at = Isometry3::translation(5.5, 0.0, 0.0) * across;
        let ends = outline(&grid(10), &at, 1000.0);
        assert_eq!(ends.len(), 2 * 20);
        assert!(ends.iter().all(|p| (p.x - 5.5).abs() < 1e-9));
    }
}
