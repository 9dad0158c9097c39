//! The node of docs/extend/writing-a-node.md. A test compares the code on the page with this file.
#![allow(unreachable_pub, reason = "in a crate of nodes it is public")]

use osteoflow_geometry::{
    Cloud,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize,
};

/// Indices of the points at `min_mm` to `max_mm` from `origin`, in order. `O(n)`.
pub fn in_range(points: &[Point3<f64>], origin: &Point3<f64>, min_mm: f64, max_mm: f64) -> Vec<usize> {
    let inside = |p: &Point3<f64>| (min_mm..=max_mm).contains(&(p - origin).norm());
    (0..points.len()).filter(|&index| inside(&points[index])).collect()
}

/// Points within the camera's working distance.
///
/// Structured light is in focus within a certain range only; points outside it are noise that no later stage can tell
/// from bone. Distances are measured from the viewpoint of the cloud, so the cloud may be in any frame.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "crop.range"
in = { cloud = "recording.scan" }
max_distance_mm = 250.0
"#,
    literature = ["the camera's data sheet: working distance 200 mm, range 50 mm to either side"]
)]
pub struct Range(RangeParams);

/// Range of distances to keep.
#[osteoflow_node::params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", default, deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct RangeParams {
    /// Minimum distance. 150: the near end of the camera's range.
    #[param(150.0, 0.0..=10_000.0)]
    min_distance_mm: f64,
    /// Maximum distance. 250: the far end of the camera's range.
    #[param(250.0, 0.0..=10_000.0)]
    max_distance_mm: f64,
}

/// The inputs.
#[derive(Inputs)]
pub struct In {
    /// The scan, with its viewpoint.
    cloud: Cloud,
}

/// The outputs.
#[derive(Outputs)]
pub struct Out {
    /// The points in range, in the order of the input.
    #[port(frame = "cloud")]
    cloud: Cloud,
}

impl Node for Range {
    const KIND: &'static str = "crop.range";
    type Params = RangeParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: RangeParams) -> Result<Self, ParamError> {
        if params.min_distance_mm >= params.max_distance_mm {
            let message = format!("{} mm is not greater than min_distance_mm; swap the two", params.max_distance_mm);
            return Err(ParamError::new("max_distance_mm", message));
        }
        Ok(Self(params))
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let Some(viewpoint) = i.cloud.viewpoint else {
            return Err(NodeError::new("the cloud has no viewpoint; wire it before merging views"));
        };
        let origin = Point3::from(viewpoint.translation.vector);
        let (min_mm, max_mm) = (self.0.min_distance_mm, self.0.max_distance_mm);
        let kept = in_range(i.cloud.points(), &origin, min_mm, max_mm);
        if kept.is_empty() {
            let n = i.cloud.len();
            return Err(NodeError::new(format!(
                "none of {n} points is {min_mm} to {max_mm} mm from the camera; is the cloud in mm?"
            )));
        }
        Ok(Out { cloud: i.cloud.selected(&kept) })
    }
}

fn cloud_at(distances_mm: &[f64]) -> Cloud {
    let points: Vec<_> = distances_mm.iter().map(|&z| Point3::new(0.0, 0.0, z)).collect();
    Cloud::new("camera", points).unwrap().seen_from(Isometry3::identity())
}

#[test]
fn points_out_of_range_are_removed_in_any_frame() {
    let mut node = Range::new(RangeParams::default()).unwrap();
    let moved = cloud_at(&[100.0, 180.0, 220.0, 300.0]).transformed("world", &Isometry3::translation(5.0, -700.0, 2.0));
    let kept = node.process(In { cloud: moved }, &mut Context::for_test("crop")).unwrap().cloud;
    assert_eq!((kept.len(), kept.frame.as_str()), (2, "world"));
}

#[test]
fn an_empty_result_is_an_error_that_asks_for_the_unit() {
    let mut node = Range::new(RangeParams::default()).unwrap();
    let in_metres = In { cloud: cloud_at(&[0.18, 0.22]) };
    let message = node.process(in_metres, &mut Context::for_test("crop")).map(|_| ()).unwrap_err().to_string();
    assert_eq!(message, "none of 2 points is 150 to 250 mm from the camera; is the cloud in mm?");
}

#[test]
fn a_registry_with_the_node_describes_it() {
    let mut registry = osteoflow_standard::registry();
    registry.node::<Range>();
    let description = &registry.kind("crop.range").unwrap().description;
    assert_eq!(description.summary, "Points within the camera's working distance.");
    assert_eq!(description.params["properties"]["max_distance_mm"]["default"], 250.0);
}

#[test]
fn the_page_shows_this_code() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(root.join("docs/extend/writing-a-node.md")).unwrap();
    let code = std::fs::read_to_string(root.join("tests/writing_a_node.rs")).unwrap();
    let blocks: Vec<_> = page.split("```rust\n").skip(1).map(|rest| rest.split("```").next().unwrap()).collect();
    assert!(blocks.len() >= 5, "{} blocks of Rust on the page", blocks.len());
    for block in blocks {
        assert!(
            code.contains(block),
            "docs/extend/writing-a-node.md shows code that is not in tests/writing_a_node.rs:\n{block}"
        );
    }
}
