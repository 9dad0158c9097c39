//! Surfaces, points and values for the page's views: 16 bits for a coordinate, 8 for a value.

use base64::{Engine, engine::general_purpose::STANDARD};
use nalgebra::Point3;
use osteoflow_geometry::Mesh;
use serde_json::{Value as Json, json};
use std::{
    collections::BTreeMap,
    ops::{AddAssign, Div},
};

/// Meshes with more faces are simplified for the page.
const MAX_FACES: usize = 60_000;
/// Clouds with more points are thinned out by stride.
pub(crate) const MAX_POINTS: usize = 40_000;

/// Positions with 16 bits per coordinate, from their lowest corner in steps of `step` mm.
pub(crate) fn positions(points: &[Point3<f64>]) -> Json {
    let bounds = points.iter().map(|p| (p.coords, p.coords)).reduce(|(a, b), (p, _)| (a.inf(&p), b.sup(&p)));
    let (low, high) = bounds.unwrap_or_default();
    let step = ((high - low).max() / f64::from(u16::MAX)).max(1e-9);
    let bytes: Vec<u8> = points
        .iter()
        .flat_map(|p| ((p.coords - low) / step).iter().map(|c| c.round() as u16).collect::<Vec<_>>())
        .flat_map(u16::to_le_bytes)
        .collect();
    json!({ "positions": STANDARD.encode(bytes), "low": low.as_slice(), "step": step })
}

/// Values from `-max` to `max` with 8 bits each: 1 to 255, and 0 where there is none.
pub(crate) fn levels(values: &[f64], max: f64) -> String {
    let level = |v: &f64| if v.is_nan() { 0 } else { (128.0 + 127.0 * (v / max).clamp(-1.0, 1.0)).round() as u8 };
    STANDARD.encode(values.iter().map(level).collect::<Vec<_>>())
}

/// A surface for the page, simplified if it has many faces.
pub(crate) fn surface(mesh: &Mesh) -> Json {
    let (groups, faces) = thinned(mesh.vertices(), mesh.faces(), MAX_FACES);
    let positions: Vec<_> = mesh.vertices().iter().map(|p| p.coords).collect();
    let vertices: Vec<_> = groups.means(&positions).into_iter().map(Point3::from).collect();
    indexed(&vertices, &faces)
}

/// A surface with all its faces, in the order of its vertices; 16 bits for a vertex index where they are enough.
pub(crate) fn indexed(vertices: &[Point3<f64>], faces: &[[u32; 3]]) -> Json {
    let mut data = positions(vertices);
    let bytes: Vec<u8> = match u16::try_from(vertices.len()) {
        Ok(_) => faces.iter().flatten().flat_map(|i| (*i as u16).to_le_bytes()).collect(),
        Err(_) => faces.iter().flatten().flat_map(|i| i.to_le_bytes()).collect(),
    };
    data["faces"] = STANDARD.encode(bytes).into();
    data
}

/// Groups of vertices that were merged.
pub(super) struct Groups {
    /// The group of each vertex; if empty, every vertex is a group.
    of_vertex: Option<Vec<u32>>,
    n: usize,
}

impl Groups {
    /// One value for each group: the mean of its vertices' values.
    pub(super) fn means<T: Copy + AddAssign + Div<f64, Output = T>>(&self, values: &[T]) -> Vec<T> {
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

/// At most `max` faces: all if they are few, otherwise by merging vertices in cubes that grow until the faces are few enough.
pub(super) fn thinned(vertices: &[Point3<f64>], faces: &[[u32; 3]], max: usize) -> (Groups, Vec<[u32; 3]>) {
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

#[cfg(test)]
mod tests {
    use super::{super::tests::grid, *};

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
    fn values_are_within_half_a_step_and_none_is_none() {
        let bytes = STANDARD.decode(levels(&[-2.0, -1.0, 0.0, 0.25, 1.0, f64::NAN], 1.0)).unwrap();
        assert_eq!(bytes, [1, 1, 128, 160, 255, 0]);
    }

    #[test]
    fn indices_have_two_bytes_while_they_are_enough() {
        let bytes = |n: usize| {
            let data = indexed(&vec![Point3::origin(); n], &[[0, 1, 2]]);
            STANDARD.decode(data["faces"].as_str().unwrap()).unwrap().len()
        };
        assert_eq!((bytes(3), bytes(usize::from(u16::MAX)), bytes(1 << 16)), (6, 6, 12));
    }
}
