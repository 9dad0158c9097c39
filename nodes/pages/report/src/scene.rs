//! A view in three dimensions for the page: layers for its scripts, and the same content for an SVG drawing.

mod drawing;
pub(crate) mod packed;

use crate::format::number;
use drawing::{Drawable, Solid, Tint};
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use osteoflow_algorithms::section;
use osteoflow_draw::xml::escape;
use osteoflow_geometry::Mesh;
use packed::{MAX_POINTS, indexed, levels, positions};
use serde_json::{Value as Json, json};

/// Blue over white to orange, as on the live page; they differ in lightness, too.
const DIVERGING: [&str; 7] = ["#0073b2", "#529fc7", "#a5cbdd", "#f7f7f2", "#ecc4a1", "#e19151", "#d65e00"];

/// Registered or planned.
pub(crate) const BLUE: &str = "#0072b2";
/// Measured or executed.
pub(crate) const ORANGE: &str = "#d55e00";
/// Predicted errors, as on the live page.
pub(crate) const ELLIPSOID: &str = "#005f73";
/// The bone.
pub(crate) const BONE: &str = "#d9cfbb";

/// A view.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    /// Layers of the view; each has a name, by which it can be hidden.
    layers: Vec<Json>,
    /// The same content for the SVG drawing.
    drawn: Vec<Drawable>,
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
        let bounds = seen.iter().map(|p| (*p, *p)).reduce(|(low, high), (p, _)| (low.inf(&p), high.sup(&p)));
        let (low, high) = bounds.unwrap_or((Vector3::repeat(-1.0), Vector3::repeat(1.0)));
        let size = (high - low).map(|s| s.max(1.0));
        let aspect = (size.x / size.y.max(size.z)).clamp(1.6, 2.6);
        let half_width = 0.62 * size.x.max(size.y.max(size.z) * aspect);
        let centre = Point3::from(turn.transpose() * ((low + high) / 2.0));
        Self { layers: Vec::new(), drawn: Vec::new(), legend: Vec::new(), ramp: None, centre, half_width, turn, aspect }
    }

    /// Adds a surface that the page shares by name.
    pub(crate) fn shared_mesh(&mut self, layer: &str, name: &str, mesh: &Mesh, colour: &str) {
        self.layers.push(json!({ "name": layer, "type": "mesh", "shared": name, "colour": colour }));
        self.draw_mesh((mesh.vertices(), mesh.faces()), 1.0, Tint::Plain(colour.into()));
    }

    /// Adds a surface.
    pub(crate) fn mesh(&mut self, layer: &str, vertices: &[Point3<f64>], faces: &[[u32; 3]], colour: &str) {
        let own = indexed(vertices, faces);
        self.layers.push(json!({ "name": layer, "type": "mesh", "own": own, "colour": colour }));
        self.draw_mesh((vertices, faces), 1.0, Tint::Plain(colour.into()));
    }

    /// Adds a surface coloured by a signed value at each vertex, clamped to `max`.
    pub(crate) fn coloured_mesh(
        &mut self,
        layer: &str,
        (vertices, faces): (&[Point3<f64>], &[[u32; 3]]),
        values: &[f64],
        max: f64,
    ) {
        let mut own = indexed(vertices, faces);
        own["values"] = levels(values, max).into();
        self.layers.push(json!({ "name": layer, "type": "mesh", "own": own }));
        self.draw_mesh((vertices, faces), 1.0, Tint::Values(values.to_vec(), max));
    }

    fn draw_mesh(&mut self, (vertices, faces): (&[Point3<f64>], &[[u32; 3]]), opacity: f64, tint: Tint) {
        let what = Solid::Mesh { vertices: vertices.to_vec(), faces: faces.to_vec(), opacity };
        self.drawn.push(Drawable { what, tint });
    }

    fn draw(&mut self, what: Solid, colour: &str) {
        self.drawn.push(Drawable { what, tint: Tint::Plain(colour.into()) });
    }

    /// Adds planes with names, drawn as squares around their origins.
    pub(crate) fn planes(&mut self, layer: &str, planes: &[(&str, Isometry3<f64>)], colour: &str) {
        let rows: Vec<f64> = planes
            .iter()
            .flat_map(|(_, t)| t.translation.vector.iter().chain(t.rotation.coords.iter()).copied().collect::<Vec<_>>())
            .collect();
        let names: Vec<_> = planes.iter().map(|(name, _)| *name).collect();
        let names = names.join("\n");
        self.layers.push(json!({ "name": layer, "type": "planes", "rows": rows, "names": names, "colour": colour }));
        for (_, t) in planes {
            let corners = square(t);
            self.draw_mesh((&corners, &[[0, 1, 2], [0, 2, 3]]), 0.22, Tint::Plain(colour.into()));
            let edges = (0..4).flat_map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
            self.draw(Solid::Lines(edges), colour);
        }
        for (name, t) in planes.iter().filter(|(name, _)| !name.is_empty()) {
            self.draw(Solid::Tag(square(t)[0], (*name).into()), BONE);
        }
    }

    /// Adds points as balls.
    pub(crate) fn points(&mut self, layer: &str, points: &[Point3<f64>], radius_mm: f64, colour: &str) {
        let own = positions(points);
        self.layers.push(json!({ "name": layer, "type": "balls", "own": own, "colour": colour, "radius": radius_mm }));
        self.draw(Solid::Points { points: points.to_vec(), radius_mm }, colour);
    }

    /// Adds points coloured by a signed value, clamped to `max`, to the drawing alone: the view has the clouds of the recording.
    pub(crate) fn drawn_points(&mut self, points: &[Point3<f64>], values: &[f64], max: f64, radius_mm: f64) {
        let every = points.len().div_ceil(MAX_POINTS).max(1);
        let points: Vec<_> = points.iter().copied().step_by(every).collect();
        let values: Vec<_> = values.iter().copied().step_by(every).collect();
        self.drawn.push(Drawable { what: Solid::Points { points, radius_mm }, tint: Tint::Values(values, max) });
    }

    /// Adds a surface to the drawing alone.
    pub(crate) fn drawn_mesh(&mut self, mesh: &Mesh, colour: &str) {
        self.draw_mesh((mesh.vertices(), mesh.faces()), 1.0, Tint::Plain(colour.into()));
    }

    /// Adds lines between pairs of points.
    pub(crate) fn lines(&mut self, layer: &str, ends: &[Point3<f64>], colour: &str) {
        if !ends.is_empty() {
            let own = positions(ends);
            self.layers.push(json!({ "name": layer, "type": "lines", "own": own, "colour": colour }));
            self.draw(Solid::Lines(ends.to_vec()), colour);
        }
    }

    /// Adds a label beside a point.
    pub(crate) fn tag(&mut self, layer: &str, at: &Point3<f64>, word: &str) {
        self.layers.push(json!({ "name": layer, "type": "tag", "at": [at.x, at.y, at.z], "word": word }));
        self.draw(Solid::Tag(*at, word.into()), BONE);
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
            "layers": self.layers,
            "look": {
                "centre": self.centre.coords.as_slice(),
                "halfWidth": self.half_width,
                "up": self.turn.row(1).iter().collect::<Vec<_>>(),
                "from": self.turn.row(2).iter().collect::<Vec<_>>(),
            },
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
                 mm, over white to orange, {max} mm\" style=\"background: linear-gradient(to right, {})\"></i><span>+{max} \
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

/// Half the side of a drawn plane, mm, as on the live page.
const PLANE_MM: f64 = 18.0;

/// The corners of a plane's square.
pub(crate) fn square(t: &Isometry3<f64>) -> [Point3<f64>; 4] {
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| t * Point3::new(x * PLANE_MM, y * PLANE_MM, 0.0))
}

fn any_across(v: &Vector3<f64>) -> Vector3<f64> {
    let least = if v.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    (least - v * v.dot(&least)).normalize()
}

/// The intersection of a surface with the xy plane of `t_mesh_plane`, as pairs of points.
pub(crate) fn outline(mesh: &Mesh, t_mesh_plane: &nalgebra::Isometry3<f64>, reach_mm: f64) -> Vec<Point3<f64>> {
    let within = section::cuts(mesh, t_mesh_plane).filter(|ends| ends.iter().all(|p| p.coords.norm() <= reach_mm));
    within.flatten().map(|p| t_mesh_plane * p).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;
    use osteoflow_geometry::SurfaceOrigin;

    pub(super) fn grid(n: usize) -> Mesh {
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
    fn a_plane_cuts_a_mesh_along_its_outline() {
        let across = Isometry3::rotation(Vector3::y() * std::f64::consts::FRAC_PI_2);
        let at = Isometry3::translation(5.5, 0.0, 0.0) * across;
        let ends = outline(&grid(10), &at, 1000.0);
        assert_eq!(ends.len(), 2 * 20);
        assert!(ends.iter().all(|p| (p.x - 5.5).abs() < 1e-9));
    }
}
