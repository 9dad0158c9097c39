//! Principal axes of a bone.

use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_geometry::{Axes, Mesh};

/// The principal axes of a surface through its centroid, each face weighing as much as its area.
///
/// Order: z runs along the bone (largest spread), y has the second largest, x the smallest. Sign: the largest component
/// of z and of y in the mesh's frame is positive, and x = y × z makes the axes right-handed; so in an LPS frame z of a
/// long bone points to the head. [`towards`] turns z to a known direction instead. How finely the surface is meshed does
/// not matter. `O(m)`.
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
    // A mesh without area has no axes of its own; its frame's serve.
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

/// The same axes with z pointing towards `proximal`: y and z are turned over together where it did not.
pub fn towards(axes: &Axes, proximal: &Vector3<f64>) -> Axes {
    let [x, y, z] = [0, 1, 2].map(|k| axes.columns.column(k).into_owned());
    let columns = if z.dot(proximal) < 0.0 { Matrix3::from_columns(&[x, -y, -z]) } else { axes.columns };
    Axes { columns, ..axes.clone() }
}

fn upright(v: Vector3<f64>) -> Vector3<f64> {
    if v[v.iamax()] < 0.0 { -v } else { v }
}
