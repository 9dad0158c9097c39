//! Draws a view from its initial viewpoint as SVG, for paper and for pages without WebGL.
//!
//! Painter's algorithm: triangles, points and lines are drawn from the farthest to the nearest, by their middles.

use super::{DIVERGING, Scene, packed::thinned};
use crate::{chart::disclaimer, format::number};
use nalgebra::Point3;
use osteoflow_draw::xml::{escape, text};
use std::fmt::Write;

/// Width of the drawing, in its units.
const WIDTH: f64 = 720.0;
/// Height of a line of text.
const ROW: f64 = 18.0;
/// Surfaces with more visible faces are simplified.
const MAX_FACES: usize = 5_000;
/// Clouds with more points are thinned out by stride.
const MAX_POINTS: usize = 5_000;
/// Points and lines are moved towards the viewer, mm, because the simplified surfaces may cover them.
const NEARER_MM: f64 = 1.0;

/// A solid with its colour.
#[derive(Debug, Clone)]
pub(super) struct Drawable {
    pub(super) what: Solid,
    pub(super) tint: Tint,
}

#[derive(Debug, Clone)]
pub(super) enum Solid {
    Mesh {
        vertices: Vec<Point3<f64>>,
        faces: Vec<[u32; 3]>,
        opacity: f64,
    },
    Points {
        points: Vec<Point3<f64>>,
        radius_mm: f64,
    },
    /// Pairs of ends.
    Lines(Vec<Point3<f64>>),
    Tag(Point3<f64>, String),
}

#[derive(Debug, Clone)]
pub(super) enum Tint {
    Plain(String),
    /// A value at each vertex or point, and the end of the colour scale.
    Values(Vec<f64>, f64),
}

impl Tint {
    /// Red, green and blue at the mean of the values of these vertices.
    fn at(&self, vertices: &[u32]) -> [f64; 3] {
        match self {
            Self::Plain(colour) => rgb(colour),
            Self::Values(values, max) => {
                let mean = vertices.iter().map(|v| values[*v as usize]).sum::<f64>() / vertices.len() as f64;
                let last = (DIVERGING.len() - 1) as f64;
                // In steps too small to see, so that neighbours have the same colour.
                let at = round(((mean / max).clamp(-1.0, 1.0) + 1.0) / 2.0 * last, 0.125);
                let low = at.floor().min(last - 1.0);
                let [a, b] = [low, low + 1.0].map(|stop| rgb(DIVERGING[stop as usize]));
                [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * (at - low))
            }
        }
    }
}

/// A drawn element: its depth, its style and its path.
struct Piece {
    near: f64,
    paint: String,
    path: String,
}

impl Scene {
    /// Draws the initial view as a complete SVG file.
    pub(crate) fn svg(&self, title: &str, simulated: bool) -> String {
        let height = WIDTH / self.aspect;
        let rows = self.legend.len() + usize::from(self.ramp.is_some()) + 1;
        let total = height + rows as f64 * ROW + 10.0;
        let mut out = String::new();
        let _ = writeln!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{total:.0}\" viewBox=\"0 0 {WIDTH} \
             {total:.0}\" role=\"img\" font-family=\"system-ui, 'DejaVu Sans', sans-serif\" font-size=\"12\" \
             fill=\"#24292f\">\n<title>{}</title>\n<rect width=\"{WIDTH}\" height=\"{total:.0}\" \
             fill=\"#ffffff\"/>\n<clipPath id=\"view\"><rect width=\"{WIDTH}\" height=\"{height:.1}\"/></clipPath>\n<g \
             clip-path=\"url(#view)\" stroke-linejoin=\"round\" stroke-linecap=\"round\">\n<rect width=\"{WIDTH}\" \
             height=\"{height:.1}\" fill=\"#f3f5f7\"/>",
            escape(title)
        );
        let mut pieces: Vec<Piece> = self.drawn.iter().flat_map(|drawn| self.pieces(drawn, height)).collect();
        pieces.sort_by(|a, b| a.near.total_cmp(&b.near));
        // Neighbours with the same style are one path.
        for alike in pieces.chunk_by(|a, b| a.paint == b.paint) {
            let _ = write!(out, "<path {} d=\"", alike[0].paint);
            alike.iter().for_each(|piece| out.push_str(&piece.path));
            out.push_str("\"/>\n");
        }
        for drawn in &self.drawn {
            if let Solid::Tag(at, word) = &drawn.what {
                let [x, y, _] = self.seen(at, height);
                let (x, end) = if x > 0.8 * WIDTH { (x - 5.0, "text-anchor=\"end\"") } else { (x + 5.0, "") };
                text(&mut out, (x, y - 5.0), end, word);
            }
        }
        out.push_str("</g>\n");
        self.scale_bar(&mut out, height);
        self.key_rows(&mut out, height);
        let faint = "text-anchor=\"end\" font-size=\"11\" fill=\"#59636e\"";
        text(&mut out, (WIDTH - 8.0, total - 8.0), faint, &disclaimer(simulated));
        out + "</svg>\n"
    }

    /// Drawing units per millimetre.
    fn per_mm(&self) -> f64 {
        WIDTH / (2.0 * self.half_width)
    }

    /// Coordinates in the drawing: right, down, and towards the viewer in mm.
    fn seen(&self, point: &Point3<f64>, height: f64) -> [f64; 3] {
        let p = self.turn * (point - self.centre);
        [WIDTH / 2.0 + p.x * self.per_mm(), height / 2.0 - p.y * self.per_mm(), p.z]
    }

    fn pieces(&self, drawn: &Drawable, height: f64) -> Vec<Piece> {
        let tint = &drawn.tint;
        match &drawn.what {
            Solid::Mesh { vertices, faces, opacity } if *opacity < 1.0 => {
                let (vertices, faces) = split(vertices, faces);
                self.faces((&vertices, &faces), tint, *opacity, height)
            }
            Solid::Mesh { vertices, faces, opacity } => self.faces((vertices, faces), tint, *opacity, height),
            Solid::Points { points, radius_mm } => {
                let every = points.len().div_ceil(MAX_POINTS).max(1);
                let width = (2.0 * radius_mm * self.per_mm()).max(1.5);
                let piece = |(index, point): (usize, &Point3<f64>)| {
                    let [x, y, near] = self.seen(point, height);
                    let colour = hex(tint.at(&[index as u32]), 1.0);
                    let paint = format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width:.1}\"");
                    Piece { near: near + radius_mm + NEARER_MM, paint, path: format!("M{x:.1} {y:.1}h0") }
                };
                points.iter().enumerate().step_by(every).map(piece).collect()
            }
            Solid::Lines(ends) => {
                let paint = format!("fill=\"none\" stroke=\"{}\" stroke-width=\"1.6\"", hex(tint.at(&[0]), 1.0));
                let piece = |ends: &[Point3<f64>]| {
                    let [[ax, ay, a], [bx, by, b]] = [0, 1].map(|k| self.seen(&ends[k], height));
                    let path = format!("M{ax:.1} {ay:.1}L{bx:.1} {by:.1}");
                    Piece { near: (a + b) / 2.0 + NEARER_MM, paint: paint.clone(), path }
                };
                ends.chunks_exact(2).map(piece).collect()
            }
            Solid::Tag(..) => Vec::new(),
        }
    }

    fn faces(
        &self,
        (vertices, faces): (&[Point3<f64>], &[[u32; 3]]),
        tint: &Tint,
        opacity: f64,
        height: f64,
    ) -> Vec<Piece> {
        let inside = |v: &u32| {
            let [x, y, _] = self.seen(&vertices[*v as usize], height);
            (0.0..=WIDTH).contains(&x) && (0.0..=height).contains(&y)
        };
        let in_view: Vec<[u32; 3]> = faces.iter().filter(|face| face.iter().any(inside)).copied().collect();
        // A face larger than the view may have no corner in it.
        let in_view = if in_view.is_empty() { faces.to_vec() } else { in_view };
        let (groups, faces) = thinned(vertices, &in_view, MAX_FACES);
        let vertices = groups.means(&vertices.iter().map(|p| p.coords).collect::<Vec<_>>());
        let tint = match tint {
            Tint::Values(values, max) => Tint::Values(groups.means(values), *max),
            plain => plain.clone(),
        };
        let piece = |face: &[u32; 3]| {
            let corners = face.map(|v| Point3::from(vertices[v as usize]));
            let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).try_normalize(1e-12)?;
            let facing = (self.turn * normal).z.abs();
            // The viewer's lighting; transparent faces have uniform light.
            let light = if opacity < 1.0 { 1.0 } else { round(0.38 + 0.62 * facing, 0.02) };
            let colour = hex(tint.at(face), light);
            let seen = corners.map(|p| self.seen(&p, height));
            let near = seen.iter().map(|[_, _, z]| z).sum::<f64>() / 3.0;
            // A stroke of the same colour closes the seams between faces.
            let paint = match opacity < 1.0 {
                true => format!("fill=\"{colour}\" fill-opacity=\"{opacity}\""),
                false => format!("fill=\"{colour}\" stroke=\"{colour}\" stroke-width=\"0.7\""),
            };
            let [[ax, ay, _], [bx, by, _], [cx, cy, _]] = seen;
            Some(Piece { near, paint, path: format!("M{ax:.1} {ay:.1}L{bx:.1} {by:.1} {cx:.1} {cy:.1}z") })
        };
        faces.iter().filter_map(piece).collect()
    }

    fn scale_bar(&self, out: &mut String, height: f64) {
        let length_mm = super::round_up(self.half_width / 6.0);
        let (end, y) = (12.0 + length_mm * self.per_mm(), height - 14.0);
        let _ = writeln!(
            out,
            "<path d=\"M12 {:.1}v5H{end:.1}v-5\" fill=\"none\" stroke=\"#24292f\" stroke-width=\"1.5\"/>",
            y - 5.0
        );
        text(out, (12.0, y + 11.0), "font-size=\"11\"", &format!("{} mm", number(length_mm)));
    }

    fn key_rows(&self, out: &mut String, height: f64) {
        let mut y = height + ROW;
        for (colour, what) in &self.legend {
            let _ = writeln!(out, "<circle cx=\"17\" cy=\"{:.1}\" r=\"5\" fill=\"{colour}\"/>", y - 4.0);
            text(out, (27.0, y), "", what);
            y += ROW;
        }
        if let Some((what, max)) = &self.ramp {
            const STEP: f64 = 18.0;
            let max = number(*max);
            for (k, colour) in DIVERGING.iter().enumerate() {
                let x = 80.0 + k as f64 * STEP;
                let _ = write!(
                    out,
                    "<rect x=\"{x:.0}\" y=\"{:.1}\" width=\"{STEP}\" height=\"10\" fill=\"{colour}\"/>",
                    y - 9.0
                );
            }
            text(out, (74.0, y), "text-anchor=\"end\"", &format!("\u{2212}{max}"));
            text(out, (86.0 + DIVERGING.len() as f64 * STEP, y), "", &format!("+{max} mm: {what}"));
        }
    }
}

/// Splits each face into 256, so that intersecting surfaces are sorted correctly.
fn split(vertices: &[Point3<f64>], faces: &[[u32; 3]]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let (mut vertices, mut faces) = (vertices.to_vec(), faces.to_vec());
    for _ in 0..4 {
        let halves = |[a, b, c]: [u32; 3]| {
            let first = vertices.len() as u32;
            for (from, to) in [(a, b), (b, c), (c, a)] {
                vertices.push(nalgebra::center(&vertices[from as usize], &vertices[to as usize]));
            }
            let [ab, bc, ca] = [0, 1, 2].map(|k| first + k);
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        faces = faces.into_iter().flat_map(halves).collect();
    }
    (vertices, faces)
}

fn rgb(colour: &str) -> [f64; 3] {
    [1, 3, 5].map(|k| colour.get(k..k + 2).and_then(|part| u8::from_str_radix(part, 16).ok()).map_or(0.0, f64::from))
}

fn round(value: f64, step: f64) -> f64 {
    (value / step).round() * step
}

/// The colour under a light, as hex.
fn hex(colour: [f64; 3], light: f64) -> String {
    let [r, g, b] = colour.map(|c| (c * light).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::{super::BONE, *};
    use nalgebra::Vector3;

    #[test]
    fn nearer_elements_are_drawn_later_and_nothing_is_outside_the_drawing() {
        let square = |z: f64| [(-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)].map(|(x, y)| Point3::new(x, y, z));
        let faces = [[0, 1, 2], [0, 2, 3]];
        let mut scene = Scene::looking(&square(0.0), Vector3::x(), Vector3::z());
        scene.coloured_mesh("", (&square(3.0), &faces), &[0.5; 4], 0.5);
        scene.mesh("", &square(-3.0), &faces, BONE);
        scene.points("", &square(-8.0), 0.5, "#0072b2");
        scene.ramp("distance <mm>", 0.5);
        let svg = scene.svg("a view & its name", true);
        let parsed = roxmltree::Document::parse(&svg).expect("it is XML");
        let painted: Vec<_> = parsed.descendants().filter(|n| n.has_tag_name("path")).collect();
        let last = hex(rgb(DIVERGING[6]), 1.0);
        assert!(painted[0].attribute("stroke") == Some("#0072b2"), "the farthest first: {svg}");
        assert_eq!(painted[2].attribute("fill"), Some(last.as_str()), "the orange square nearest: {svg}");
        assert_eq!(painted[2].attribute("d").map(|d| d.matches('M').count()), Some(2), "alike faces are one path");
        assert!(svg.contains("SIMULATED") && !svg.contains("NaN"));
    }

    #[test]
    fn a_fine_surface_is_drawn_by_few_faces_with_its_colours() {
        let n = 120u32;
        let at = |i: u32, j: u32| i * (n + 1) + j;
        let vertices: Vec<_> =
            (0..=n).flat_map(|i| (0..=n).map(move |j| Point3::new(f64::from(i), f64::from(j), 0.0))).collect();
        let faces: Vec<_> = (0..n)
            .flat_map(|i| {
                (0..n).flat_map(move |j| {
                    [[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]]
                })
            })
            .collect();
        let values: Vec<f64> = vertices.iter().map(|p| if p.x < 60.0 { -1.0 } else { 1.0 }).collect();
        let mut scene = Scene::looking(&vertices, Vector3::x(), Vector3::z());
        scene.coloured_mesh("", (&vertices, &faces), &values, 1.0);
        let svg = scene.svg("", false);
        let drawn = svg.matches('z').count();
        assert!((1000..=MAX_FACES + 50).contains(&drawn), "{drawn} faces of {}", faces.len());
        let [blue, orange] = [DIVERGING[0], DIVERGING[6]].map(|end| hex(rgb(end), 1.0));
        assert!(svg.contains(&blue) && svg.contains(&orange), "both ends of the ramp");
    }
}
