//! The fragment between the executed cuts, coloured by its distance from the planned one.

use crate::{
    format::number,
    html::Page,
    run_folder::RunFolder,
    scene::{BONE, Scene, round_up},
};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::{
    axes::principal_axes,
    fragment::{FaceKind, Fragment, HalfSpace, between},
    mesh_query::MeshQuery,
    metrics::{CutDifferenceParams, DistanceSummary, PlannedFragment, signed_distances},
};
use osteoflow_engine::plan::Plan;
use osteoflow_geometry::{Mesh, Planes, Pose};
use osteoflow_statistics::quantile;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The kinds whose inputs describe the cuts of the bone.
const KINDS: [&str; 2] = ["metrics.cut_difference", "metrics.cuts"];

/// Gap between the fragment and the rest of the bone, mm, so that the cut faces can be seen.
const GAP_MM: f64 = 3.0;

/// Radius around the fragment's middle within which bone is shown, mm.
const AROUND_MM: f64 = 60.0;

/// The reason if the graph has no such node.
pub(crate) const NO_NODE: &str =
    "the graph has no node metrics.cut_difference or metrics.cuts, which need the true registration";

/// The node whose inputs describe the cuts.
pub(crate) fn node(run: &RunFolder) -> Option<&str> {
    KINDS.iter().find_map(|kind| run.node_of_kind(kind))
}

/// The wires that the maps need, if the graph has them.
pub(crate) fn wires(plan: &Plan) -> Option<Vec<String>> {
    let node = KINDS.iter().find_map(|kind| plan.nodes.iter().find(|node| node.kind == *kind))?;
    let wanted = ["planes", "bone", "t_ct_world", "t_ct_world_true"];
    let wire = |name: &str| {
        let input = node.inputs.iter().find(|input| input.port.name == name)?;
        plan.wires_of(input)
    };
    wanted.into_iter().map(wire).collect()
}

/// Two views of the executed fragment: in the bone, and aligned with the planned one.
pub(crate) fn maps(page: &mut Page, run: &RunFolder) {
    match Maps::of(run) {
        Ok(maps) => maps.draw(page, maps.range_mm, "", ""),
        Err(why) => page.missing("The fragment against the planned one", &why),
    }
}

/// A fragment with its distances from the planned one, ready to draw.
pub(crate) struct Maps {
    in_place: Vec<Point3<f64>>,
    aligned: Vec<Point3<f64>>,
    faces: Vec<[u32; 3]>,
    distances_mm: [Vec<f64>; 2],
    summaries: [DistanceSummary; 2],
    left: (Vec<Point3<f64>>, Vec<[u32; 3]>),
    along: Vector3<f64>,
    /// The value at the ends of the colour scale, for both views.
    pub(crate) range_mm: f64,
}

impl Maps {
    pub(crate) fn of(run: &RunFolder) -> Result<Self, String> {
        let node = node(run).ok_or(NO_NODE)?;
        let bone: Mesh = run.input(node, "bone")?;
        let planned: Planes = run.input(node, "planes")?;
        let slip = slip(run, node, &planned)?;
        let params = CutDifferenceParams::default();
        let plan = PlannedFragment::new(&bone, &planned, &params).map_err(|e| e.to_string())?;
        let executed = plan.executed(&slip).map_err(|e| e.to_string())?;
        let compared = plan.against(&slip).map_err(|e| e.to_string())?;
        let cuts = between(&bone, &planned).map_err(|e| e.to_string())?;

        let surface = MeshQuery::new(&plan.fragment().mesh);
        surface.prepare();
        let back = slip.inverse();
        let (in_place, faces) = with_edges(&executed);
        let aligned: Vec<Point3<f64>> = in_place.iter().map(|p| back * p).collect();
        let distances_mm = [&in_place, &aligned].map(|points| distances(points, &surface));
        let mut sizes: Vec<f64> = distances_mm.iter().flatten().map(|d| d.abs()).collect();
        Ok(Self {
            left: left_of(&bone, &cuts, &plan.middle()),
            along: principal_axes(&bone).columns.column(2).into_owned(),
            range_mm: round_up(quantile(&mut sizes, 0.98).max(1e-3)),
            summaries: [compared.in_place.surface, compared.aligned.surface],
            in_place,
            aligned,
            faces,
            distances_mm,
        })
    }

    /// Draws both views, coloured up to `range_mm`. `of` names the run of a sweep, `name` is appended to the names of the files.
    pub(crate) fn draw(&self, page: &mut Page, range_mm: f64, of: &str, name: &str) {
        let [here, there] = &self.distances_mm;
        let [in_place, aligned] = &self.summaries;
        for (view, points, values, what, summary) in [
            ("in-place", &self.in_place, here, "in place", in_place),
            (
                "aligned",
                &self.aligned,
                there,
                "aligned by the inverse of the error, so that its cuts coincide with the planned ones",
                aligned,
            ),
        ] {
            let mut scene = Scene::looking(points, self.along, Vector3::zeros());
            scene.mesh("rest of the bone", &self.left.0, &self.left.1, BONE);
            scene.coloured_mesh("fragment", (points, &self.faces), values, range_mm);
            scene.key(BONE, "bone beyond the planned cuts");
            scene.ramp("executed fragment, signed distance from the planned one", range_mm);
            let DistanceSummary { n, mean_mm, sd_mm, max_mm, .. } = summary;
            let caption = format!(
                "The executed fragment{of}, {what}, coloured by the signed distance of its vertices from the planned \
                 fragment (orange: outside it, blue: inside). Surface to surface, both ways: {} \u{b1} {} mm, at most {} mm (n = {n} points \
                 of one pair of fragments).",
                number(*mean_mm),
                number(*sd_mm),
                number(*max_mm),
            );
            page.view(&format!("fragment-{view}{name}"), &scene, &caption);
        }
    }
}

/// The motion from a planned plane to the executed one in the bone's frame: to the world by the registration, back by the truth.
pub(crate) fn slip(run: &RunFolder, node: &str, planned: &Planes) -> Result<Isometry3<f64>, String> {
    let registered: Pose = run.input(node, "t_ct_world")?;
    let truth: Pose = run.input(node, "t_ct_world_true")?;
    let slip = truth.compose(&registered.inverse()).map_err(|e| e.to_string())?;
    slip.expect(&planned.frame, &planned.frame).map_err(|e| e.to_string())
}

fn distances(points: &[Point3<f64>], surface: &MeshQuery) -> Vec<f64> {
    points.par_chunks(512).flat_map_iter(|points| signed_distances(points, surface)).collect()
}

/// The fragment with separate vertices for each cut face, so that its edges are sharp.
fn with_edges(fragment: &Fragment) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let mut vertices = fragment.mesh.vertices().to_vec();
    let mut own: BTreeMap<(usize, u32), u32> = BTreeMap::new();
    let mut corner = |kind: &FaceKind, vertex: u32| match kind {
        FaceKind::Wall => vertex,
        FaceKind::Cap(cut) => *own.entry((*cut, vertex)).or_insert_with(|| {
            vertices.push(vertices[vertex as usize]);
            vertices.len() as u32 - 1
        }),
    };
    let faces = fragment.mesh.faces().iter().zip(&fragment.face_kinds);
    let faces = faces.map(|(face, kind)| face.map(|vertex| corner(kind, vertex))).collect();
    (vertices, faces)
}

/// The bone near the fragment beyond either planned cut.
fn left_of(bone: &Mesh, cuts: &[HalfSpace; 2], middle: &Point3<f64>) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    let near = |face: &usize| bone.corners(*face).iter().all(|p| (p - middle).norm() <= AROUND_MM);
    for face in (0..bone.faces().len()).filter(near) {
        for cut in cuts {
            let kept = clipped(&bone.corners(face), |p| -cut.height_mm(p) - GAP_MM);
            let first = vertices.len() as u32;
            faces.extend((2..kept.len() as u32).map(|k| [first, first + k - 1, first + k]));
            vertices.extend(kept);
        }
    }
    (vertices, faces)
}

/// The part of a triangle where `height` is positive, with up to four corners.
fn clipped(corners: &[Point3<f64>; 3], height: impl Fn(&Point3<f64>) -> f64) -> Vec<Point3<f64>> {
    let mut kept = Vec::new();
    for k in 0..3 {
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        let (at_a, at_b) = (height(&a), height(&b));
        if at_a > 0.0 {
            kept.push(a);
        }
        if (at_a > 0.0) != (at_b > 0.0) {
            kept.push(a + (b - a) * (at_a / (at_a - at_b)));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_is_clipped_to_what_lies_above() {
        let corners = [Point3::new(0.0, 0.0, -1.0), Point3::new(2.0, 0.0, 1.0), Point3::new(-2.0, 0.0, 1.0)];
        let kept = clipped(&corners, |p| p.z);
        assert_eq!(kept.len(), 4);
        assert!(kept.iter().all(|p| p.z >= -1e-12));
        assert_eq!(clipped(&corners, |p| p.z - 5.0).len(), 0);
        assert_eq!(clipped(&corners, |p| p.z + 5.0), corners);
    }
}
