//! The kind `surface.prepare_cloud`.

use osteoflow_algorithms::{normals, target::Target};
use osteoflow_geometry::{Cloud, SurfaceOrigin};
use osteoflow_node::{
    CachePolicy, Context, Describe, Function, Inputs, NodeError, Outputs, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::Text;

/// The points of a surface without faces, prepared for registration; normals are estimated where missing.
///
/// Estimated normals point outwards if the surface is closed. On an open surface all of them point to the same side,
/// but which side is a guess. This does not change distances along them. But a source with a viewpoint is paired only
/// with the side that faces it; for such a source give the cloud normals by `cloud.normals`.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "surface.prepare_cloud"
in   = { cloud = "ct_points.cloud" }
"#,
    literature = ["Hoppe et al. 1992, sections 3.2 and 3.3"]
)]
pub struct PrepareCloud;

/// Parameters of [`PrepareCloud`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {}

/// Inputs of [`PrepareCloud`].
#[derive(Inputs)]
pub struct In {
    /// Points all over the surface.
    #[port(join = "once")]
    cloud: Cloud,
}

/// Outputs of [`PrepareCloud`].
#[derive(Outputs)]
pub struct Out {
    /// Points, normals, and the grid that finds them.
    #[port(frame = "cloud")]
    target: Target,
    /// Where the surface comes from: `user`.
    ct_surface: Text,
}

impl Function for PrepareCloud {
    const KIND: &'static str = "surface.prepare_cloud";
    const CACHE: CachePolicy = CachePolicy::ByInputs;
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(_: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let target = prepare(&i.cloud)?;
        Ok(Out { target, ct_surface: Text(SurfaceOrigin::User.to_string().into()) })
    }
}

/// Points of a surface, prepared; their normals are estimated where missing.
pub(super) fn prepare(points: &Cloud) -> Result<Target, NodeError> {
    let normals = match points.normal_column() {
        Some(given) => given.clone(),
        None => normals::of_surface(points.points())?.into(),
    };
    let target = Target::new(&points.frame, SurfaceOrigin::User, points.point_column().clone(), Some(normals))?;
    target.prepare();
    Ok(target)
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::{Point3, Vector3};

    #[test]
    fn a_cloud_without_normals_becomes_a_target_whose_normals_point_outwards() {
        // Points of a ball, evenly by the golden angle.
        let on_ball = |k: u32| {
            let (z, turn) = (1.0 - (f64::from(k) + 0.5) / 2000.0, 2.399_963 * f64::from(k));
            let across = (1.0 - z * z).sqrt();
            Point3::from(Vector3::new(across * turn.cos(), across * turn.sin(), z) * 20.0)
        };
        let cloud = Cloud::new("ct", (0..4000).map(on_ball).collect::<Vec<_>>()).expect("a cloud");
        let made = PrepareCloud::process(&Params {}, In { cloud }, &mut Context::for_test("ct")).expect("a target");
        let normals = made.target.normals().expect("estimated");
        assert!(made.target.points().iter().zip(normals).all(|(p, n)| p.coords.dot(n) > 19.5), "outwards");
    }
}
