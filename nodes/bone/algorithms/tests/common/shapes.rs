//! Small closed meshes for tests.

use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Mesh, SurfaceOrigin};

/// A box between two corners.
pub(crate) fn cuboid(min: [f64; 3], max: [f64; 3]) -> Mesh {
    let vertices: Vec<Point3<f64>> = (0..8)
        .map(|k| Point3::from(std::array::from_fn(|axis| if k >> axis & 1 == 0 { min[axis] } else { max[axis] })))
        .collect();
    let faces = vec![
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 4],
        [1, 5, 4],
        [2, 6, 3],
        [3, 6, 7],
        [0, 4, 2],
        [2, 4, 6],
        [1, 3, 5],
        [3, 7, 5],
    ];
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
}

/// The faces that are kept by their first corner, each with corners of its own, as in an STL.
pub(crate) fn soup(mesh: &Mesh, keep: impl Fn(&Vector3<f64>) -> bool) -> Mesh {
    let kept = (0..mesh.faces().len()).map(|k| mesh.corners(k)).filter(|corners| keep(&corners[0].coords));
    let vertices: Vec<_> = kept.flatten().collect();
    let faces: Vec<[u32; 3]> = (0..vertices.len() as u32 / 3).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    Mesh::new(mesh.frame.clone(), mesh.origin, vertices, faces).unwrap()
}

/// The mesh with the faces of these numbers turned over.
pub(crate) fn inside_out(mesh: &Mesh, is_turned: impl Fn(usize) -> bool) -> Mesh {
    let turned = |(k, &[a, b, c]): (usize, &[u32; 3])| if is_turned(k) { [a, c, b] } else { [a, b, c] };
    let faces: Vec<_> = mesh.faces().iter().enumerate().map(turned).collect();
    Mesh::new(mesh.frame.clone(), mesh.origin, mesh.vertices().to_vec(), faces).unwrap()
}

/// A closed, bumpy, tapered shaft along z, 120 mm long, which determines all six motions.
pub(crate) fn shaft() -> Mesh {
    let (rings, around) = (121_u32, 60_u32);
    let point = |i: u32, j: u32| {
        let (z, turn) = (f64::from(i), f64::from(j) / f64::from(around) * std::f64::consts::TAU);
        let radius =
            6.0 + 0.9 * (3.0 * turn).cos() + 0.02 * z + 0.5 * (z / 9.0).sin() + 0.3 * (z / 7.0 + 2.0 * turn).sin();
        Point3::new(radius * turn.cos() + 0.0005 * z * z, radius * turn.sin(), z)
    };
    let mut vertices: Vec<Point3<f64>> = (0..rings).flat_map(|i| (0..around).map(move |j| point(i, j))).collect();
    let index = |i: u32, j: u32| i * around + j % around;
    let mut faces = Vec::new();
    for i in 0..rings - 1 {
        for j in 0..around {
            faces.push([index(i, j), index(i, j + 1), index(i + 1, j)]);
            faces.push([index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)]);
        }
    }
    for (ring, end) in [(0, false), (rings - 1, true)] {
        let sum: Vector3<f64> = (0..around).map(|j| point(ring, j).coords).sum();
        let hub = vertices.len() as u32;
        vertices.push(Point3::from(sum / f64::from(around)));
        for j in 0..around {
            let (a, b) = (index(ring, j), index(ring, j + 1));
            faces.push(if end { [hub, a, b] } else { [hub, b, a] });
        }
    }
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
}
