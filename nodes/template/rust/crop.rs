//! A crop as a starting point: change it, build it, and run the graph again.

use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::geometry::{Cloud, Region, nalgebra::Point3};

/// The points within a distance of a centre, and within the region of interest where one was drawn.
#[derive(Describe)]
#[describe(example = r#"
kind = "my_plugin.sphere"
in   = { cloud = "recording.scan" }
centre_mm = [0.0, 0.0, 200.0]
radius_mm = 80.0
"#)]
pub struct Sphere;

/// Parameters of [`Sphere`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// The centre in the cloud's frame.
    centre_mm: [f64; 3],
    /// The radius.
    #[schemars(range(min = 1e-3, max = 1e6))]
    radius_mm: f64,
}

/// The ports of every crop, so that graphs can switch to this one by its kind.
#[derive(Inputs)]
pub struct In {
    /// The cloud to crop.
    cloud: Cloud,
    /// A region drawn by the user; points outside it are removed too.
    #[port(join = "once", frame = "cloud")]
    region: Option<Region>,
}

/// The outputs.
#[derive(Outputs)]
pub struct Out {
    /// The points in the sphere, with their normals and all other columns.
    #[port(frame = "cloud")]
    cloud: Cloud,
}

impl Function for Sphere {
    const KIND: &'static str = "my_plugin.sphere";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        if let Some(region) = &i.region {
            region.frame.expect(&i.cloud.frame, "the region")?;
        }
        let (centre, radius_mm) = (Point3::from(params.centre_mm), params.radius_mm);
        let is_kept = |p: &Point3<f64>| {
            (p - centre).norm() <= radius_mm && i.region.as_ref().is_none_or(|region| region.contains(p))
        };
        let points = i.cloud.points();
        let kept: Vec<usize> = (0..points.len()).filter(|&index| is_kept(&points[index])).collect();
        if kept.is_empty() {
            let (n, frame) = (points.len(), &i.cloud.frame);
            return Err(NodeError::new(format!(
                "none of {n} points is within {radius_mm} mm of the centre; is it given in mm, in {frame}?"
            )));
        }
        Ok(Out { cloud: i.cloud.selected(&kept) })
    }
}

osteoflow_node::export!(Sphere);

#[cfg(test)]
mod tests {
    use super::*;

    fn cropped(centre_mm: [f64; 3], region: Option<Region>) -> Result<Out, NodeError> {
        let points = [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 0.001, 0.0], [-50.0, 7.0, 9.0]].map(Point3::from);
        let cloud = Cloud::new("camera", points.to_vec()).unwrap();
        let params = Params { centre_mm, radius_mm: 2.0 };
        Sphere::process(&params, In { cloud, region }, &mut Context::for_test("crop"))
    }

    #[test]
    fn points_up_to_the_boundary_of_sphere_and_region_are_kept() {
        assert_eq!(cropped([1.0, 0.0, 0.0], None).unwrap().cloud.len(), 2);
        let region = Region { frame: "camera".into(), min: [0.0; 3].into(), max: [1.0; 3].into() };
        assert_eq!(cropped([1.0, 0.0, 0.0], Some(region)).unwrap().cloud.len(), 1);
    }

    #[test]
    fn an_empty_crop_is_an_error_that_asks_for_the_unit() {
        let message = cropped([1000.0, 0.0, 0.0], None).map(|_| ()).unwrap_err().to_string();
        assert_eq!(message, "none of 4 points is within 2 mm of the centre; is it given in mm, in camera?");
    }
}
