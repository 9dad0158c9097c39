//! Open edges and connected components of a mesh.

use crate::iso_surface::compacted;
use crate::union_find::UnionFind;
use nalgebra::Point3;
use osteoflow_geometry::Mesh;

/// Number of edges that are not shared by exactly two faces running along them in opposite directions. `O(m log m)`.
pub fn open_edges(mesh: &Mesh) -> usize {
    let mut edges: Vec<(u64, bool)> = Vec::with_capacity(3 * mesh.faces().len());
    for &[a, b, c] in mesh.faces() {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            edges.push((u64::from(from.min(to)) << 32 | u64::from(from.max(to)), from < to));
        }
    }
    edges.sort_unstable();
    edges.chunk_by(|a, b| a.0 == b.0).filter(|ways| !matches!(ways, [(_, false), (_, true)])).count()
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
