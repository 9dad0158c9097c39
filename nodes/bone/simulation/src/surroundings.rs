//! The surroundings of the bone in the wound: the bed, its edges, and the skin that covers the rest.

use crate::bone::smoothstep;
use crate::plan::section_centre;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Anatomy, Mesh, SurfaceOrigin};

/// Extent of the surroundings across the bone to either side, mm.
const HALF_WIDTH_MM: f64 = 30.0;
/// Extent along the bone beyond the stripped stretch, mm.
const BEYOND_MM: f64 = 25.0;
/// Edge of the mesh's squares, mm.
const STEP_MM: f64 = 1.5;
/// Height of the bed and of the skin over the bone's centre line, towards the camera, mm.
const BED_MM: f64 = -6.0;
const SKIN_MM: f64 = 12.0;
/// Half width of the bed before it rises to the skin, and the length over which it rises, mm.
const BED_HALF_WIDTH_MM: f64 = 12.0;
const RISE_MM: f64 = 10.0;

/// Soft tissue around the stripped stretch, as a surface open to the back, in the frame of `bone`: a bed beneath the
/// bone, and skin over the rest. `None` if the stretch is not on the bone.
///
/// It does not depend on the seed and moves with the bone; a crop has to remove it.
pub(crate) fn surroundings(
    bone: &Mesh,
    anatomy: &Anatomy,
    towards_camera: &Vector3<f64>,
    [from_mm, to_mm]: [f64; 2],
) -> Option<Mesh> {
    let along = anatomy.proximal.into_inner();
    let across = along.cross(towards_camera).normalize();
    let n_across = (2.0 * HALF_WIDTH_MM / STEP_MM).round() as usize + 1;
    let n_along = ((to_mm - from_mm + 2.0 * BEYOND_MM) / STEP_MM).ceil() as usize + 1;
    // The centre line of the stripped stretch, straight between its ends.
    let (first, last) = (section_centre(bone, anatomy, from_mm).ok()?, section_centre(bone, anatomy, to_mm).ok()?);
    let mut vertices = Vec::with_capacity(n_along * n_across);
    for i in 0..n_along {
        let height_mm = from_mm - BEYOND_MM + i as f64 * STEP_MM;
        let middle = first + (last - first) * ((height_mm - from_mm) / (to_mm - from_mm));
        for j in 0..n_across {
            let aside_mm = j as f64 * STEP_MM - HALF_WIDTH_MM;
            let beyond = (from_mm - height_mm).max(height_mm - to_mm);
            let beside = aside_mm.abs() - BED_HALF_WIDTH_MM;
            let skin = smoothstep(beyond / (0.5 * RISE_MM)).max(smoothstep(beside / RISE_MM));
            let uneven =
                0.8 * (height_mm / 5.0).sin() * (aside_mm / 4.0).cos() + 0.5 * (height_mm / 2.3 + aside_mm).cos();
            let depth_mm = BED_MM + (SKIN_MM - BED_MM) * skin + uneven;
            vertices.push(Point3::from(middle.coords + across * aside_mm + towards_camera * depth_mm));
        }
    }
    let vertex = |i: usize, j: usize| (i * n_across + j) as u32;
    let mut faces = Vec::with_capacity(2 * n_along * n_across);
    for i in 1..n_along {
        for j in 1..n_across {
            let [a, b, c, d] = [vertex(i - 1, j - 1), vertex(i, j - 1), vertex(i, j), vertex(i - 1, j)];
            faces.extend([[a, c, b], [a, d, c]]);
        }
    }
    Mesh::new(&bone.frame, SurfaceOrigin::Exact, vertices, faces).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bone::{BoneParams, anatomy, fibula};

    #[test]
    fn the_surroundings_face_the_camera() {
        let (bone, axes) = (fibula(&BoneParams::default()), anatomy(&BoneParams::default()));
        let towards = (*axes.lateral + *axes.posterior).normalize();
        let around = surroundings(&bone, &axes, &towards, [70.0, 165.0]).unwrap();
        let facing: Vec<f64> =
            (0..around.faces().len()).map(|f| around.area_vector(f).normalize().dot(&towards)).collect();
        assert!(facing.iter().all(|cos| *cos > 0.0), "every face is seen from the camera's side");
        assert!(surroundings(&bone, &axes, &towards, [400.0, 500.0]).is_none());
    }
}
