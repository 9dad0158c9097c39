//! Surfaces, planes and named points as entities of a scene, metres.

use super::{encode, pose, schema, timestamp};
use foxglove::messages::{
    ArrowPrimitive, Color, Duration, Point3 as FoxglovePoint, SceneEntity, SceneEntityDeletion, SceneUpdate,
    SpherePrimitive, TextPrimitive, TriangleListPrimitive, Vector3 as FoxgloveVector3, scene_entity_deletion,
};
use osteoflow_geometry::{
    Frame, MM_PER_M, Mesh, PlanePlace, Planes, Points,
    nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3},
};
use osteoflow_node::{Display, DisplayContext, StampNs};
use std::{collections::BTreeSet, f64::consts::FRAC_PI_2};

/// Side of the square that a plane is drawn as: twice the width of a fibula with soft tissue left out.
const PLANE_SIDE_MM: f64 = 40.0;
/// Length of the arrow along a plane's normal, its own z axis.
const NORMAL_MM: f64 = 15.0;
/// Diameter of a named point, that of a laser spot.
const POINT_MM: f64 = 2.0;
/// Height of names.
const TEXT_MM: f64 = 4.0;
/// Size of names, pixels: as large from near as from far.
const TEXT_PX: f64 = 14.0;
/// Edge of the triangle that a point of a surface without a mesh is drawn as.
const SURFEL_MM: f64 = 0.5;

const BONE: Color = Color { r: 0.89, g: 0.85, b: 0.75, a: 1.0 };
const PLANE: Color = Color { r: 0.0, g: 0.45, b: 0.70, a: 0.4 };
const NORMAL: Color = Color { r: 0.0, g: 0.45, b: 0.70, a: 1.0 };
const POINT: Color = Color { r: 0.84, g: 0.37, b: 0.0, a: 1.0 };
const TEXT: Color = Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };

/// The channel of everything here.
pub(crate) fn scene_schema() -> Option<Display> {
    schema::<SceneUpdate>()
}

/// The channel of surfaces.
pub(crate) fn surface_schema() -> Option<Display> {
    Some(Display { anchor: true, ..scene_schema()? })
}

/// A mesh as triangles.
pub(crate) fn mesh(mesh: &Mesh, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
    let points = mesh.vertices().iter().map(point).collect();
    surface(&mesh.frame, points, mesh.faces().concat(), about)
}

/// Points of a surface, each as a triangle across its normal, or across z where there are no normals.
pub(crate) fn surface_points(
    frame: &Frame,
    points: &[Point3<f64>],
    normals: Option<&[Vector3<f64>]>,
    about: &DisplayContext<'_>,
) -> Option<Vec<u8>> {
    let corners = points.iter().enumerate().flat_map(|(i, p)| {
        let normal = normals.map_or(Vector3::z(), |normals| normals[i]);
        let turn = Rotation3::rotation_between(&Vector3::z(), &normal);
        let turn = turn.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), 2.0 * FRAC_PI_2));
        [[-0.5, -0.3], [0.5, -0.3], [0.0, 0.6]].map(|[x, y]| p + turn * Vector3::new(x, y, 0.0) * SURFEL_MM)
    });
    let corners: Vec<_> = corners.map(|corner| point(&corner)).collect();
    surface(frame, corners, Vec::new(), about)
}

fn surface(
    frame: &Frame,
    points: Vec<FoxglovePoint>,
    indices: Vec<u32>,
    about: &DisplayContext<'_>,
) -> Option<Vec<u8>> {
    let triangles = TriangleListPrimitive {
        pose: Some(pose(&Isometry3::identity())),
        points,
        color: Some(BONE),
        colors: Vec::new(),
        indices,
    };
    update(vec![SceneEntity { triangles: vec![triangles], ..entity(frame, "surface", about) }], Vec::new())
}

/// Each known plane as a square with its normal and its name; a plane that is unknown is removed.
pub(crate) fn planes(planes: &Planes, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
    let (mut entities, mut deletions) = (Vec::new(), Vec::new());
    for plane in planes.planes.iter() {
        match &plane.place {
            PlanePlace::Known(t) => entities.push(SceneEntity {
                triangles: vec![square(t)],
                arrows: vec![normal(t)],
                texts: vec![text(&(t * Point3::new(0.0, 0.0, NORMAL_MM + TEXT_MM)), &plane.name)],
                // Planes belong to the bone, whatever frame they are given in: where the bone is the root they stay on it.
                frame_locked: !about.anchored,
                ..entity(&planes.frame, &plane.name, about)
            }),
            PlanePlace::Unknown(_) => deletions.push(SceneEntityDeletion {
                timestamp: timestamp(about.stamp_ns),
                r#type: i32::from(scene_entity_deletion::Type::MatchingId),
                id: plane.name.to_string(),
            }),
        }
    }
    update(entities, deletions)
}

/// Removes all planes, whenever they were shown.
pub(crate) fn no_planes() -> Option<Vec<u8>> {
    let all = i32::from(scene_entity_deletion::Type::All);
    // Viewers keep what is later than the deletion.
    let deletion = SceneEntityDeletion { timestamp: timestamp(StampNs::MAX), r#type: all, id: String::new() };
    update(Vec::new(), vec![deletion])
}

/// Each point as a sphere with its name.
pub(crate) fn named_points(points: &Points, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
    let size = POINT_MM / MM_PER_M;
    let mut ids = BTreeSet::new();
    let entities = points.points.iter().enumerate().map(|(index, p)| {
        // Of entities of one name viewers keep the last.
        let id = if ids.insert(&*p.name) { p.name.to_string() } else { format!("{} {index}", p.name) };
        let place = Isometry3::from_parts(Translation3::from(p.position.coords), Default::default());
        let sphere = SpherePrimitive {
            pose: Some(pose(&place)),
            size: Some(FoxgloveVector3 { x: size, y: size, z: size }),
            color: Some(POINT),
        };
        let above = p.position + Vector3::new(0.0, 0.0, TEXT_MM);
        SceneEntity { spheres: vec![sphere], texts: vec![text(&above, &p.name)], ..entity(&points.frame, &id, about) }
    });
    update(entities.collect(), Vec::new())
}

/// A square about the plane's origin, seen from both sides.
fn square(t: &Isometry3<f64>) -> TriangleListPrimitive {
    let half = PLANE_SIDE_MM / 2.0;
    let corners = [[-half, -half], [half, -half], [half, half], [-half, half]];
    TriangleListPrimitive {
        pose: Some(pose(t)),
        points: corners.map(|[x, y]| point(&Point3::new(x, y, 0.0))).to_vec(),
        color: Some(PLANE),
        colors: Vec::new(),
        indices: vec![0, 1, 2, 0, 2, 3],
    }
}

/// An arrow from the plane's origin along its z axis; arrows of viewers point along x.
fn normal(t: &Isometry3<f64>) -> ArrowPrimitive {
    let x_to_z = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -FRAC_PI_2);
    let m = |mm: f64| mm / MM_PER_M;
    ArrowPrimitive {
        pose: Some(pose(&(t * x_to_z))),
        shaft_length: m(NORMAL_MM * 0.7),
        shaft_diameter: m(0.8),
        head_length: m(NORMAL_MM * 0.3),
        head_diameter: m(2.4),
        color: Some(NORMAL),
    }
}

fn text(at: &Point3<f64>, text: &str) -> TextPrimitive {
    TextPrimitive {
        pose: Some(pose(&Isometry3::translation(at.x, at.y, at.z))),
        billboard: true,
        font_size: TEXT_PX,
        scale_invariant: true,
        color: Some(TEXT),
        text: text.into(),
    }
}

fn point(p: &Point3<f64>) -> FoxglovePoint {
    FoxglovePoint { x: p.x / MM_PER_M, y: p.y / MM_PER_M, z: p.z / MM_PER_M }
}

/// An empty entity that stays until one of the same name replaces it, and moves with its frame.
fn entity(frame: &Frame, id: &str, about: &DisplayContext<'_>) -> SceneEntity {
    SceneEntity {
        timestamp: timestamp(about.stamp_ns),
        frame_id: frame.to_string(),
        id: id.into(),
        lifetime: Some(Duration::new(0, 0)),
        frame_locked: true,
        ..SceneEntity::default()
    }
}

fn update(entities: Vec<SceneEntity>, deletions: Vec<SceneEntityDeletion>) -> Option<Vec<u8>> {
    encode(&SceneUpdate { deletions, entities })
}
