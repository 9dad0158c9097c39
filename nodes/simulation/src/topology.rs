//! How the faces of a mesh hang together.

use nalgebra::Point3;
use osteoflow_geometry::Mesh;

/// Edges that are not shared by exactly two faces running along them in opposite directions. `O(n log n)`.
pub(crate) fn open_edges(mesh: &Mesh) -> usize {
    let mut edges: Vec<(u64, bool)> = Vec::with_capacity(3 * mesh.faces().len());
    for &[a, b, c] in mesh.faces() {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            edges.push((u64::from(from.min(to)) << 32 | u64::from(from.max(to)), from < to));
        }
    }
    edges.sort_unstable();
    edges.chunk_by(|a, b| a.0 == b.0).filter(|ways| !matches!(ways, [(_, false), (_, true)])).count()
}

/// The connected piece with the most faces, with the vertices that it uses, in their order.
pub(crate) fn largest_component(vertices: Vec<Point3<f64>>, faces: &[[u32; 3]]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let mut parent: Vec<u32> = (0..vertices.len() as u32).collect();
    fn root(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    for &[a, b, c] in faces {
        for other in [b, c] {
            let (r, s) = (root(&mut parent, a), root(&mut parent, other));
            parent[r.max(s) as usize] = r.min(s);
        }
    }
    let roots: Vec<u32> = faces.iter().map(|face| root(&mut parent, face[0])).collect();
    let mut n_faces = vec![0usize; vertices.len()];
    roots.iter().for_each(|&r| n_faces[r as usize] += 1);
    // The first of the largest: `max_by_key` would take the last.
    let Some(largest) = (0..n_faces.len()).rev().max_by_key(|&v| n_faces[v]) else { return (vertices, Vec::new()) };

    const UNUSED: u32 = u32::MAX;
    let mut new_index = vec![UNUSED; vertices.len()];
    let own: Vec<[u32; 3]> =
        faces.iter().zip(&roots).filter(|&(_, &r)| r as usize == largest).map(|(face, _)| *face).collect();
    own.iter().flatten().for_each(|&v| new_index[v as usize] = 0);
    let mut kept = Vec::new();
    for (index, vertex) in new_index.iter_mut().zip(vertices) {
        if *index != UNUSED {
            *index = kept.len() as u32;
            kept.push(vertex);
        }
    }
    let own = own.into_iter().map(|face| face.map(|v| new_index[v as usize])).collect();
    (kept, own)
}

/// The volume inside, mm³, negative if the faces turn the wrong way.
pub(crate) fn volume_mm3(mesh: &Mesh) -> f64 {
    let about = mesh.vertices()[0];
    (0..mesh.faces().len())
        .map(|face| {
            let [a, b, c] = mesh.corners(face).map(|p| p - about);
            a.dot(&b.cross(&c)) / 6.0
        })
        .sum()
}

#[cfg(test)]
pub(crate) fn assert_closed_and_outward(mesh: &Mesh) -> f64 {
    let open = open_edges(mesh);
    assert_eq!(open, 0, "{open} edges are not shared by two faces that turn alike");
    let volume = volume_mm3(mesh);
    assert!(volume > 0.0, "the normals point inward: volume {volume} mm3");
    volume
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_pieces_the_larger_is_kept_with_its_own_vertices() {
        let vertices: Vec<Point3<f64>> = (0..8).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect();
        let (kept, faces) = largest_component(vertices, &[[0, 2, 4], [1, 3, 5], [3, 5, 7]]);
        assert_eq!(kept.iter().map(|p| p.x).collect::<Vec<_>>(), [1.0, 3.0, 5.0, 7.0]);
        assert_eq!(faces, [[0, 1, 2], [1, 2, 3]]);
    }
}
