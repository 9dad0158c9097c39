//! The kinds `surface.prepare`, `surface.prepare_cloud`, and `surface.prepare_any`, which takes the inputs of both.

use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    mesh_topology::moved_outward,
    normals, sample,
    sensor::{Sensor, SensorParams},
    target::Target,
};
use osteoflow_geometry::{Cloud, Column, Mesh, SurfaceOrigin, nalgebra::Vector3};
use osteoflow_node::{
    CachePolicy, Context, Describe, Inputs, NodeError, Outputs, function, params, schemars::JsonSchema,
    serde::Deserialize,
};
use osteoflow_payloads::Text;

/// A surface prepared for registration: points sampled uniformly by area, their normals, a search grid, and the surface itself.
///
/// Prepared once for all registrations onto it. The sampling is seeded by the run.
#[derive(Describe)]
#[describe(example = r#"
kind = "surface.prepare"
in   = { mesh = "bone.mesh" }
n_points = 150000
"#)]
pub struct Prepare;

/// Minimum number of points.
const MIN_POINTS: usize = 100;
/// Maximum number of points, for the memory they take.
const MAX_POINTS: usize = 10_000_000;

/// Parameters of [`Prepare`] and [`PrepareAny`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Number of points. 150000: one per 0.3 mm on a whole fibula, as dense as a structured-light scan.
    #[param(150_000, MIN_POINTS..=MAX_POINTS)]
    pub n_points: usize,
    /// One point for each square of this edge, instead of `n_points`. 0: `n_points` decides.
    #[param(0.0, 0.0..=100.0)]
    pub spacing_mm: f64,
    /// What the scan is measured with: the surface is moved to where its tip touches, and the verdict expects its errors. Without it the
    /// scan is taken for one of structured light.
    pub sensor: SensorParams,
}

impl Params {
    /// Samples a surface and prepares it.
    fn prepare(&self, mesh: &Mesh, ctx: &mut Context) -> Result<Target, NodeError> {
        let sensor = self.sensor.sensor();
        let tip_mm = sensor.as_ref().map_or(0.0, |sensor| sensor.tip_radius_mm);
        let moved = (tip_mm != 0.0).then(|| moved_outward(mesh, tip_mm)).transpose()?;
        let mesh = moved.as_ref().unwrap_or(mesh);
        let samples = sample::surface(mesh, self.n_points_on(mesh.area_mm2())?, &mut ctx.rng());
        let target = Target::new(&mesh.frame, mesh.origin, samples.points, Some(samples.normals.into()))?;
        let target = target.with_mesh(MeshQuery::new(mesh)).for_sensor(sensor);
        target.prepare();
        Ok(target)
    }

    /// Number of points on a surface of this area.
    fn n_points_on(&self, area_mm2: f64) -> Result<usize, NodeError> {
        if self.spacing_mm == 0.0 {
            return Ok(self.n_points);
        }
        let n = (area_mm2 / (self.spacing_mm * self.spacing_mm)).round();
        if (MIN_POINTS as f64..=MAX_POINTS as f64).contains(&n) {
            return Ok(n as usize);
        }
        Err(NodeError::new(format!(
            "spacing_mm = {} asks for {n} points on {area_mm2:.0} mm2, {MIN_POINTS} to {MAX_POINTS} are possible; set \
             another spacing_mm, or n_points",
            self.spacing_mm
        )))
    }
}

/// Inputs of [`Prepare`].
#[derive(Inputs)]
pub struct In {
    /// The surface.
    #[port(join = "once")]
    mesh: Mesh,
}

/// Outputs of [`Prepare`].
#[derive(Outputs)]
pub struct Out {
    /// Points, normals, the grid that finds them, and the surface.
    #[port(frame = "mesh")]
    target: Target,
    /// Where the surface comes from: `exact`, `simulated_ct` or `user`.
    ct_surface: Text,
}

#[function("surface.prepare")]
impl Prepare {
    const CACHE: CachePolicy = CachePolicy::ByInputsAndSeed;

    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let target = params.prepare(&i.mesh, ctx)?;
        Ok(Out { target, ct_surface: Text(i.mesh.origin.to_string().into()) })
    }
}

/// The points of a surface without faces, prepared for registration; normals are estimated where missing.
///
/// Estimated normals point outwards if the surface is closed. On an open surface all point to one side, which is a guess. This
/// does not change distances along them, but a source with a viewpoint is paired only with the side that faces it: for such a
/// source give the cloud normals by `cloud.normals`.
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
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct CloudParams {
    /// What the scan is measured with, as of `surface.prepare`.
    pub sensor: SensorParams,
}

/// Inputs of [`PrepareCloud`].
#[derive(Inputs)]
pub struct CloudIn {
    /// Points all over the surface.
    #[port(join = "once")]
    cloud: Cloud,
}

/// Outputs of [`PrepareCloud`].
#[derive(Outputs)]
pub struct CloudOut {
    /// Points, normals, and the grid that finds them.
    #[port(frame = "cloud")]
    target: Target,
    /// Where the surface comes from: `user`.
    ct_surface: Text,
}

#[function("surface.prepare_cloud")]
impl PrepareCloud {
    const CACHE: CachePolicy = CachePolicy::ByInputs;

    fn process(params: &CloudParams, i: CloudIn, _ctx: &mut Context) -> Result<CloudOut, NodeError> {
        let target = prepare_points(&i.cloud, params.sensor.sensor())?;
        Ok(CloudOut { target, ct_surface: Text(SurfaceOrigin::User.to_string().into()) })
    }
}

/// Points of a surface, prepared; their normals are estimated where missing.
fn prepare_points(points: &Cloud, sensor: Option<Sensor>) -> Result<Target, NodeError> {
    let normals: Column<Vector3<f64>> = match points.normal_column() {
        Some(given) => given.clone(),
        None => normals::of_surface(points.points())?.into(),
    };
    let tip_mm = sensor.as_ref().map_or(0.0, |sensor| sensor.tip_radius_mm);
    let at = match tip_mm {
        0.0 => points.point_column().clone(),
        _ => points.points().iter().zip(&*normals).map(|(p, normal)| p + normal * tip_mm).collect::<Vec<_>>().into(),
    };
    let target = Target::new(&points.frame, SurfaceOrigin::User, at, Some(normals))?.for_sensor(sensor);
    target.prepare();
    Ok(target)
}

/// A surface, or points of it, prepared for registration.
///
/// A surface is prepared as by `surface.prepare`, points as by `surface.prepare_cloud`, which uses all of them.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "surface.prepare_any"
in   = { mesh = "bone.mesh", points = "bone.points" }
"#,
    literature = ["Hoppe et al. 1992, sections 3.2 and 3.3"]
)]
pub struct PrepareAny;

/// Inputs of [`PrepareAny`].
#[derive(Inputs)]
pub struct AnyIn {
    /// The surface.
    #[port(join = "once", frame = "points")]
    mesh: Option<Mesh>,
    /// Points all over the surface.
    #[port(join = "once", frame = "mesh")]
    points: Option<Cloud>,
}

/// Outputs of [`PrepareAny`].
#[derive(Outputs)]
pub struct AnyOut {
    /// Points, normals, the grid that finds them, and the surface if there is one.
    #[port(frame = "mesh")]
    target: Target,
}

#[function("surface.prepare_any")]
impl PrepareAny {
    const CACHE: CachePolicy = CachePolicy::ByInputsAndSeed;

    fn process(params: &Params, i: AnyIn, ctx: &mut Context) -> Result<AnyOut, NodeError> {
        let target = match (&i.mesh, &i.points) {
            (Some(mesh), None) => params.prepare(mesh, ctx)?,
            (None, Some(points)) => prepare_points(points, params.sensor.sensor())?,
            (None, None) => return Err(NodeError::new("there is neither a surface nor points of one")),
            (Some(_), Some(_)) => {
                return Err(NodeError::new("there are a surface and points of one; wire one of them"));
            }
        };
        Ok(AnyOut { target })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::{Point3, Vector3};
    use osteoflow_node::Function;

    #[test]
    fn points_are_as_far_apart_as_asked_for_whatever_the_surfaces_size_or_refused() {
        let n = |spacing_mm, area_mm2| Params { spacing_mm, ..Params::default() }.n_points_on(area_mm2);
        assert_eq!(n(0.25, 14_309.0).unwrap(), 228_944);
        assert_eq!(n(0.25, 2.0 * 14_309.0).unwrap(), 457_888);
        assert_eq!(n(0.0, 14_309.0).unwrap(), 150_000);
        for spacing in [0.01, 50.0] {
            let message = n(spacing, 14_309.0).unwrap_err().to_string();
            assert!(message.contains("mm2, 100 to 10000000 are possible"), "{message}");
        }
    }

    #[test]
    fn a_cloud_without_normals_becomes_a_target_whose_normals_point_outwards() {
        // Points of a ball, evenly by the golden angle.
        let on_ball = |k: u32| {
            let (z, turn) = (1.0 - (f64::from(k) + 0.5) / 2000.0, 2.399_963 * f64::from(k));
            let across = (1.0 - z * z).sqrt();
            Point3::from(Vector3::new(across * turn.cos(), across * turn.sin(), z) * 20.0)
        };
        let cloud = Cloud::new("ct", (0..4000).map(on_ball).collect::<Vec<_>>()).expect("a cloud");
        let prepared = |params: CloudParams| {
            PrepareCloud::process(&params, CloudIn { cloud: cloud.clone() }, &mut Context::for_test("ct"))
                .expect("a target")
                .target
        };
        let target = prepared(CloudParams::default());
        let normals = target.normals().expect("estimated");
        assert!(target.points().iter().zip(normals).all(|(p, n)| p.coords.dot(n) > 19.5), "outwards");
        // Where the middle of a tip is that touches it, outside or inside.
        for tip_mm in [0.5, -0.5] {
            let sensor = SensorParams { tip_radius_mm: Some(tip_mm), ..SensorParams::default() };
            let touched = prepared(CloudParams { sensor: sensor.clone() });
            assert!(touched.points().iter().all(|p| (p.coords.norm() - 20.0 - tip_mm).abs() < 0.01), "{tip_mm}");
            assert_eq!(touched.sensor(), sensor.sensor().as_ref());
        }
    }
}
