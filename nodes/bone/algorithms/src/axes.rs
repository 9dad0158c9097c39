//! Principal axes of a bone.

use crate::kabsch::centroid;
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_geometry::{Axes, Mesh};

/// Centroid, axes and variances of points, the longest first.
pub(crate) fn principal(points: &[Point3<f64>]) -> (Point3<f64>, [Vector3<f64>; 3], [f64; 3]) {
    let middle = centroid(points);
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
    let (axes, variances) = largest_first(&(scatter / points.len().max(1) as f64));
    (middle, axes, variances)
}

/// The principal axes of a surface through its centroid, with faces weighted by area.
///
/// Order: z runs along the bone (largest spread), y has the second largest, x the smallest. Sign: the largest component
/// of z and of y in the mesh's frame is positive, and x = y × z makes the axes right-handed; so in an LPS frame z of a
/// long bone points to the head. [`towards`] flips z to a known direction instead. The result does not depend on how
/// finely the surface is meshed. `O(m)`.
pub fn principal_axes(mesh: &Mesh) -> Axes {
    let n_faces = mesh.faces().len();
    let start = mesh.vertices().first().copied().unwrap_or_else(Point3::origin);
    let (mut area, mut moment) = (0.0, Vector3::zeros());
    for face in 0..n_faces {
        let weight = mesh.area_vector(face).norm() / 2.0;
        let [a, b, c] = mesh.corners(face).map(|p| p - start);
        area += weight;
        moment += (a + b + c) * (weight / 3.0);
    }
    // A mesh without area has no principal axes; use those of its frame.
    let centre = if area > 0.0 { start + moment / area } else { start };
    let mut spread = Matrix3::zeros();
    for face in 0..n_faces {
        let weight = mesh.area_vector(face).norm() / 2.0;
        let [a, b, c] = mesh.corners(face).map(|p| p - centre);
        // Exact over a triangle: the integral of p pᵀ from its corners and their sum.
        let sum = a + b + c;
        spread += (a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose()) * (weight / 12.0);
    }
    let eigen = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]).then(i.cmp(&j)));
    let z = upright(eigen.eigenvectors.column(order[2]).into_owned());
    let y = upright(eigen.eigenvectors.column(order[1]).into_owned());
    Axes { frame: mesh.frame.clone(), centre, columns: Matrix3::from_columns(&[y.cross(&z), y, z]) }
}

/// The axes with z pointing towards `proximal`, flipped together with y if necessary.
pub fn towards(axes: &Axes, proximal: &Vector3<f64>) -> Axes {
    let [x, y, z] = [0, 1, 2].map(|k| axes.columns.column(k).into_owned());
    let columns = if z.dot(proximal) < 0.0 { Matrix3::from_columns(&[x, -y, -z]) } else { axes.columns };
    Axes { columns, ..axes.clone() }
}

/// Directions evenly over the sphere, by the golden angle, from the pole of z on.
pub(crate) fn directions(n: usize) -> impl Iterator<Item = Vector3<f64>> {
    (0..n).map(move |k| {
        let (z, turn) = (1.0 - (2 * k + 1) as f64 / n as f64, 2.399_963 * k as f64);
        Vector3::new(turn.cos(), turn.sin(), 0.0) * (1.0 - z * z).sqrt() + Vector3::z() * z
    })
}

/// Eigenvectors and eigenvalues of a symmetric matrix, largest first.
pub(crate) fn largest_first(matrix: &Matrix3<f64>) -> ([Vector3<f64>; 3], [f64; 3]) {
    let eigen = matrix.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[j].total_cmp(&eigen.eigenvalues[i]).then(i.cmp(&j)));
    (order.map(|k| eigen.eigenvectors.column(k).into_owned()), order.map(|k| eigen.eigenvalues[k]))
}

fn upright(v: Vector3<f64>) -> Vector3<f64> {
    if v[v.iamax()] < 0.0 { -v } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, shaft};
    use nalgebra::{Isometry3, Vector3};

    #[test]
    fn a_box_has_its_edges_as_axes_longest_last_and_right_handed() {
        let turn = Isometry3::new(Vector3::new(5.0, 6.0, 7e3), Vector3::new(0.2, -0.3, 0.4));
        let mesh = cuboid([-5.0, -50.0, -10.0], [5.0, 50.0, 10.0]).transformed("ct", &turn);
        let axes = principal_axes(&mesh);
        assert!((axes.centre.coords - turn.translation.vector).norm() < 1e-9);
        for (k, edge) in [(0, Vector3::x()), (1, Vector3::z()), (2, Vector3::y())] {
            let along = axes.columns.column(k).dot(&(turn * edge)).abs();
            assert!((along - 1.0).abs() < 1e-9, "axis {k}: {along}");
        }
        assert!((axes.columns.determinant() - 1.0).abs() < 1e-12);
        for k in [1, 2] {
            let axis = axes.columns.column(k);
            assert!(axis[axis.iamax()] > 0.0);
        }
    }

    #[test]
    fn a_finer_mesh_of_the_same_surface_has_the_same_axes() {
        let mesh = shaft();
        let split: Vec<[u32; 3]> = mesh.faces().to_vec();
        // Every second face is divided into four: the same surface, unevenly meshed.
        let (mut vertices, mut faces) = (mesh.vertices().to_vec(), Vec::new());
        for (k, [a, b, c]) in split.into_iter().enumerate() {
            if k % 2 == 0 {
                faces.push([a, b, c]);
                continue;
            }
            let n = vertices.len() as u32;
            for (p, q) in [(a, b), (b, c), (c, a)] {
                vertices.push(nalgebra::center(&vertices[p as usize], &vertices[q as usize]));
            }
            faces.extend([[a, n, n + 2], [n, b, n + 1], [n + 2, n + 1, c], [n, n + 1, n + 2]]);
        }
        let finer = Mesh::new("ct", mesh.origin, vertices, faces).unwrap();
        let (coarse, fine) = (principal_axes(&mesh), principal_axes(&finer));
        assert!((coarse.columns - fine.columns).amax() < 1e-9 && (coarse.centre - fine.centre).norm() < 1e-9);
    }

    #[test]
    fn z_can_be_flipped_towards_the_knee() {
        let axes = principal_axes(&shaft());
        assert!(axes.columns.column(2).z > 0.9);
        let down = towards(&axes, &-Vector3::z());
        assert!(down.columns.column(2).z < -0.9 && (down.columns.determinant() - 1.0).abs() < 1e-12);
        assert_eq!(towards(&axes, &Vector3::z()), axes);
    }
}
