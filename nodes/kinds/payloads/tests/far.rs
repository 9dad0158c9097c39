//! Coordinates beyond 10 km at the border of plugins, processes and exact recordings.

use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{
    Cloud, Mesh, NamedPoint, Plane, Planes, Points, Pose, SurfaceOrigin,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::Payload;
use osteoflow_payloads::Table;
use std::sync::Arc;

/// What is message of a payload whose column has another number at a place.
fn message<T: Payload<Table>>(payload: &T, column: &str, at: usize, number: f64) -> String {
    let mut view = payload.to_view();
    let column = view.columns.iter_mut().find(|c| c.name == column).unwrap();
    let mut bytes = column.bytes().to_vec();
    bytes[8 * at..][..8].copy_from_slice(&number.to_le_bytes());
    column.data = Arc::new(bytes);
    T::from_view(&view).err().unwrap().to_string()
}

#[test]
fn coordinates_beyond_ten_kilometres_are_refused_by_the_name_of_what_they_are() {
    let corners = vec![Point3::origin(), Point3::new(9.0, 0.0, 0.0), Point3::new(0.0, 9.0, 0.0)];
    let cloud = Cloud::new("camera", corners.clone()).unwrap();
    let mesh = Mesh::new("ct", SurfaceOrigin::User, corners.clone(), vec![[0, 1, 2]]).unwrap();
    let target = Target::new("ct", SurfaceOrigin::User, corners, None).unwrap();
    let points = Points::new("ct", vec![NamedPoint::new("P1", Point3::origin())]);
    let planes = Planes::new("ct", vec![Plane::new("distal", Isometry3::identity())]);
    let far = "the coordinate 1e45 mm is farther than 1e7 mm (10 km)";
    for (message, place) in [
        (message(&cloud, "points", 5, 1e45), "point 1: "),
        (message(&mesh, "vertices", 8, 1e45), "vertex 2: "),
        (message(&target, "points", 0, 1e45), "target point 0: "),
        (message(&points, "positions", 1, 1e45), "point 0 \"P1\": "),
        (message(&planes, "isometries", 2, 1e45), "plane 0 \"distal\": the translation: "),
    ] {
        assert!(message.contains(&format!("{place}{far}")), "{place}\n{message}");
    }
    let pose = Pose::new("world", "bone_marker", Isometry3::translation(0.0, 1e45, 0.0));
    let message = Pose::from_view(&pose.to_view()).unwrap_err().to_string();
    assert!(message.contains(&format!("t_world_bone_marker is no rigid motion: the translation: {far}")), "{message}");
}
