//! Surfaces of several parts, for tests here and of the command.

use osteoflow_geometry::Mesh;
use std::borrow::Borrow;

/// The faces of all, as a CAD program exports several parts, in the frame of the first.
pub(crate) fn joined<M: Borrow<Mesh>>(meshes: &[M]) -> Mesh {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for mesh in meshes.iter().map(Borrow::borrow) {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(mesh.vertices());
        faces.extend(mesh.faces().iter().map(|face| face.map(|v| v + first)));
    }
    let first: &Mesh = meshes[0].borrow();
    Mesh::new(first.frame.clone(), first.origin, vertices, faces).unwrap()
}
