//! The hand on bones of others, which lie along x, y and z as their files have them or are turned there, and on one that was measured by tracked
//! ultrasound: turned, registered from pairs, and cropped by real events of a mouse and of fingers, with poses that are known.

use crate::common::{browser::Browser, data, is_slow_run};
use crate::viewer_hands::{Case, crop_by_hand, pair_by_hand, t_world_camera, turn_by_hand};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_formats::mesh_or_cloud::{read_cloud, read_mesh};
use osteoflow_geometry::{
    Cloud, Mesh, SurfaceOrigin,
    nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3},
};
use std::{f64::consts::FRAC_PI_2, path::Path};

/// Distance between the rays of the camera that is made here, mm.
const PITCH_MM: f64 = 0.7;

fn bone(file: &Path) -> Mesh {
    read_mesh(file, 1.0, "ct", SurfaceOrigin::User).unwrap().mesh
}

fn middle(mesh: &Mesh) -> Point3<f64> {
    Point3::from(mesh.vertices().iter().fold(Vector3::zeros(), |sum, v| sum + v.coords) / mesh.vertices().len() as f64)
}

/// The direction in which the vertices are spread most, away from the origin of that axis.
fn long_axis(mesh: &Mesh) -> Vector3<f64> {
    let middle = middle(mesh);
    let spread: Matrix3<f64> = mesh.vertices().iter().map(|v| (v - middle) * (v - middle).transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let axis: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    axis * axis[axis.iamax()].signum()
}

/// The ends of a bone along an axis through its middle.
fn ends(mesh: &Mesh, axis: &Vector3<f64>) -> [Point3<f64>; 2] {
    let middle = middle(mesh);
    let levels: Vec<f64> = mesh.vertices().iter().map(|v| (v - middle).dot(axis)).collect();
    let [low, high] = [levels.iter().copied().fold(0.0, f64::min), levels.iter().copied().fold(0.0, f64::max)];
    [middle + axis * low, middle + axis * high]
}

/// What parallel rays across the bone meet first of its middle: points that lie on the surface exactly, seen from one side.
fn seen(mesh: &Mesh, axis: &Vector3<f64>) -> Vec<Point3<f64>> {
    let (query, [low, high]) = (MeshQuery::new(mesh), ends(mesh, axis));
    let towards = axis.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
    let aside = axis.cross(&towards);
    let length = (high - low).norm();
    let n = (0.7 * length / PITCH_MM) as i32;
    let rays = (0..n).flat_map(|along| (-60..=60).map(move |across| (along, across)));
    let meet = |(along, across): (i32, i32)| {
        let from = low
            + axis * (0.15 * length + f64::from(along) * PITCH_MM)
            + aside * (f64::from(across) * PITCH_MM)
            + towards * 200.0;
        let hit = query.cast_ray(&from, &-towards)?;
        // A camera sees nothing that it grazes.
        (hit.normal.dot(&towards).abs() > 0.25).then_some(hit.point)
    };
    rays.filter_map(meet).collect()
}

/// A bone of others, and rays that met it, moved to where a tracker has the camera.
fn made(name: &str, mesh: &Mesh) -> Case {
    let axis = long_axis(mesh);
    let t_world_bone = t_world_camera() * Isometry3::translation(12.0, -7.0, 3.0);
    let points: Vec<Point3<f64>> = seen(mesh, &axis).iter().map(|p| t_world_bone * p).collect();
    let scan = Cloud::new("camera", points).unwrap();
    // Points of the surface itself: what remains is the surface's sampling.
    Case::of(name, mesh, &scan, ends(mesh, &axis), Some((t_world_bone.inverse(), 0.2)))
}

/// The bones that are here, by name: skipped are those that are not.
fn cases(test: &str) -> Vec<Case> {
    let mut cases = Vec::new();
    if let Some(file) = data(test, "bones/TLEM2_CT_fibula_r.stl") {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2);
        let mesh = bone(&file).transformed("ct", &Isometry3::from_parts(Vector3::new(0.0, 20.0, -40.0).into(), turn));
        cases.push(made("TLEM2 fibula, turned along x", &mesh));
    }
    if !is_slow_run() {
        println!("skipped: {test}: the fibulas along y and z; they run with SLOW_TESTS");
    }
    if let Some(file) = data(test, "bones/myosim_fibula_r.stl").filter(|_| is_slow_run()) {
        cases.push(made("MyoSim fibula, along y", &bone(&file)));
    }
    if let Some(file) = data(test, "bones/MC22_fibula_r.stl").filter(|_| is_slow_run()) {
        cases.push(made("MC22 fibula, along z", &bone(&file)));
    }
    if let (Some(file), Some(measured)) = (
        data(test, "real/hip/preoperative_specimen00_left_femur.stl"),
        data(test, "real/hip/intraoperative_specimen00_left_femur.xyz"),
    ) {
        let mesh = bone(&file);
        let scan = read_cloud(&measured, 1.0, "camera").unwrap().cloud.transformed("camera", &t_world_camera());
        // Measured in the bone's own frame, 1.5 m from its origin, where the pose is none; right within 4 mm, as those say who measured it.
        let truth = Some((t_world_camera().inverse(), 4.0));
        let axis = long_axis(&mesh);
        cases.push(Case::of("femur by ultrasound", &mesh, &scan, ends(&mesh, &axis), truth));
    }
    cases
}

#[test]
fn bones_of_others_are_turned_registered_from_pairs_and_cropped_by_hand() {
    const TEST: &str = "bones_of_others_are_turned_registered_from_pairs_and_cropped_by_hand";
    let Some(mut browser) = Browser::start(TEST) else { return };
    let browser = &mut browser;
    for (k, mut case) in cases(TEST).into_iter().enumerate() {
        let served = case.view(browser);
        turn_by_hand(browser, &case);
        browser.key("1", false);
        // Every second one by fingers.
        let is_touch = k % 2 == 1;
        pair_by_hand(browser, &case, 2, is_touch);
        crop_by_hand(browser, &case, 3, "lasso", is_touch);
        crop_by_hand(browser, &case, 4, "box", is_touch);
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new(), "{}", case.name);
    }
}
