//! Open edges and connected components of a mesh.

use crate::iso_surface::compacted;
use crate::union_find::UnionFind;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Mesh, MeshError};

/// The faces over vertices of which none is where another is, without those that have no area then. `O(n log n)`.
pub(crate) fn welded(mesh: &Mesh) -> Vec<[u32; 3]> {
    let mut faces = first_in_place(mesh.vertices(), mesh.faces());
    faces.retain(|[a, b, c]| a != b && b != c && c != a);
    faces
}

/// The faces over the first of the vertices in each place. `O(n log n)`.
pub(crate) fn first_in_place(vertices: &[Point3<f64>], faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    // Zeros of either sign are in one place.
    let bits = |k: u32| vertices[k as usize].coords.map(|c| (c + 0.0).to_bits());
    let mut keyed: Vec<([u64; 3], u32)> = (0..vertices.len() as u32).map(|k| (bits(k).into(), k)).collect();
    keyed.sort_unstable();
    let mut first = vec![0; vertices.len()];
    for group in keyed.chunk_by(|a, b| a.0 == b.0) {
        group.iter().for_each(|&(_, k)| first[k as usize] = group[0].1);
    }
    faces.iter().map(|face| face.map(|k| first[k as usize])).collect()
}

/// Outward unit normals of the vertices, with faces weighted by area; zero where there are none. `O(n)`.
pub fn vertex_normals(vertices: &[Point3<f64>], faces: &[[u32; 3]]) -> Vec<Vector3<f64>> {
    let mut normals = vec![Vector3::zeros(); vertices.len()];
    for face in faces {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        let area = (b - a).cross(&(c - a));
        face.iter().for_each(|v| normals[*v as usize] += area);
    }
    normals.into_iter().map(|n| n.try_normalize(0.0).unwrap_or_default()).collect()
}

/// The mesh with each vertex moved along its normal, mm; vertices in one place stay together. `O(n log n)`.
///
/// # Errors
/// [`MeshError`] if a vertex then lies too far away.
pub fn moved_outward(mesh: &Mesh, mm: f64) -> Result<Mesh, MeshError> {
    let faces = first_in_place(mesh.vertices(), mesh.faces());
    let normals = vertex_normals(mesh.vertices(), &faces);
    let vertices: Vec<_> = mesh.vertices().iter().zip(normals).map(|(v, normal)| v + normal * mm).collect();
    Mesh::new(&mesh.frame, mesh.origin, vertices, faces)
}

/// Number of edges that are not shared by exactly two faces running along them in opposite directions.
pub fn open_edges(mesh: &Mesh) -> usize {
    open_edges_of(mesh.faces())
}

/// Calls `see` with each edge: for each face at it the edge's higher vertex, whether the face runs along it from the lower one, and the
/// face. Faces with two equal corners have no edge. `O(m)` where few faces meet in a vertex.
pub(crate) fn each_edge(faces: &[[u32; 3]], mut see: impl FnMut(&[(u32, bool, u32)])) {
    let n = faces.iter().flatten().max().map_or(0, |v| *v as usize + 1);
    let ways = || {
        let faces = (0_u32..).zip(faces).filter(|(_, [a, b, c])| a != b && b != c && c != a);
        faces.flat_map(|(k, &[a, b, c])| [(a, b, k), (b, c, k), (c, a, k)])
    };
    // Edges by their lower vertex.
    let mut starts = vec![0_usize; n + 1];
    ways().for_each(|(from, to, _)| starts[from.min(to) as usize + 1] += 1);
    (0..n).for_each(|v| starts[v + 1] += starts[v]);
    let (mut next, mut sorted) = (starts.clone(), vec![(0, false, 0); starts[n]]);
    for (from, to, face) in ways() {
        let place = &mut next[from.min(to) as usize];
        sorted[*place] = (from.max(to), from < to, face);
        *place += 1;
    }
    for v in 0..n {
        let own = &mut sorted[starts[v]..starts[v + 1]];
        own.sort_unstable();
        own.chunk_by(|a, b| a.0 == b.0).for_each(&mut see);
    }
}

/// The number of such edges of these faces.
pub(crate) fn open_edges_of(faces: &[[u32; 3]]) -> usize {
    let mut n = 0;
    each_edge(faces, |ways| n += usize::from(!matches!(ways, [(_, false, _), (_, true, _)])));
    n
}

/// For each vertex the number of its connected component, and the number of components. `O(n + m)`.
///
/// Components are numbered in the order of their lowest vertices; a vertex of no face is a component of its own.
pub fn components(n_vertices: usize, faces: &[[u32; 3]]) -> (Vec<usize>, usize) {
    let mut sets = UnionFind::new(n_vertices);
    for &[a, b, c] in faces {
        sets.join(a, b, false);
        sets.join(a, c, false);
    }
    let (labels, n_components) = sets.labels();
    (labels.into_iter().map(|(label, _)| label as usize).collect(), n_components)
}

/// The connected component with the most faces (the first of several), with the vertices that it uses, in their order.
pub fn largest_component(vertices: Vec<Point3<f64>>, faces: &[[u32; 3]]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let (component, n_components) = components(vertices.len(), faces);
    let mut n_faces = vec![0usize; n_components];
    faces.iter().for_each(|face| n_faces[component[face[0] as usize]] += 1);
    // `max_by_key` takes the last of several.
    let Some(largest) = (0..n_components).rev().max_by_key(|&c| n_faces[c]) else { return (vertices, Vec::new()) };

    compacted(&vertices, faces.iter().filter(|face| component[face[0] as usize] == largest).copied().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_larger_of_two_components_keeps_its_own_vertices() {
        let vertices: Vec<Point3<f64>> = (0..8).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect();
        let (used, faces) = largest_component(vertices, &[[0, 2, 4], [1, 3, 5], [3, 5, 7]]);
        assert_eq!(used.iter().map(|p| p.x).collect::<Vec<_>>(), [1.0, 3.0, 5.0, 7.0]);
        assert_eq!(faces, [[0, 1, 2], [1, 2, 3]]);
    }
}
