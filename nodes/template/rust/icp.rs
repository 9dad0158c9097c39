//! A point-to-point ICP as a starting point: change it, build it, and run the graph again.
//!
//! Unchanged, it gives the pose of the built-in `icp.published` with `reading = "change_1e-5"`, which is the same method, within
//! 1e-9 mm. The built-in `icp.point_to_point` is faster and more accurate.

use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs, schemars::JsonSchema, serde::Deserialize,
    serde_json::json, tracing,
};
use osteoflow_payloads::{
    Json,
    algorithms::{kabsch::kabsch, nearest::Nearest, target::Target},
    geometry::{
        Cloud, Pose,
        nalgebra::{Isometry3, Point3, Vector3, distance},
    },
};

/// Target points whose normals point up to 20 degrees away from the camera are still paired, since the initial pose may be
/// off by less: the sine.
const PAST_SILHOUETTE: f64 = 0.34;

/// Fewer pairs determine six unknowns, but leave no redundancy.
const MIN_PAIRS: usize = 10;

/// Fine registration of a bone surface onto the CT surface by a plain point-to-point ICP.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "my_plugin.point_to_point"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
"#,
    literature = ["Besl & McKay 1992"]
)]
pub struct PointToPoint;

/// Parameters of [`PointToPoint`].
#[osteoflow_node::params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", default, deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// Pairs farther apart are not used, mm. 5: twice the largest error of a three-point fit to laser holes.
    #[param(5.0, 1e-6..=1e6)]
    max_pair_distance_mm: f64,
    /// Stop when a step changes the RMS distance of the pairs by less, mm. 1e-5: far below the noise of a camera.
    #[param(1e-5, 0.0..=10.0)]
    stop_residual_mm: f64,
    /// Maximum number of steps. 500: more than real bones need.
    #[param(500, 1..=100_000)]
    max_iterations: u32,
}

/// The ports of every ICP, so that graphs can switch to this one by its kind.
#[derive(Inputs)]
pub struct In {
    /// Moves: the scanned surface, cropped.
    source: Cloud,
    /// Stays: the CT surface.
    #[port(join = "once", frame = "init.to")]
    target: Target,
    /// Where to start: from the coarse fit.
    #[port(to = "target", from = "source")]
    init: Pose,
}

/// The outputs.
#[derive(Outputs)]
pub struct Out {
    /// The registration.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// Steps, pairs, their RMS distance, and why it stopped.
    report: Json,
}

impl Function for PointToPoint {
    const KIND: &'static str = "my_plugin.point_to_point";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let mut t = i.init.expect(&i.target.frame, &i.source.frame)?;
        let surface = visible(&i.target, &i.source, &t);
        let tree = Nearest::new(&surface);
        let mut pairs = pair(i.source.points(), &surface, &tree, &t, params.max_pair_distance_mm)?;
        let (mut n_steps, mut converged) = (0, false);
        while !converged && n_steps < params.max_iterations && !ctx.cancelled() {
            t = kabsch(&pairs.target, &pairs.source)?;
            let next = pair(i.source.points(), &surface, &tree, &t, params.max_pair_distance_mm)?;
            converged = (next.rms_mm - pairs.rms_mm).abs() < params.stop_residual_mm;
            pairs = next;
            n_steps += 1;
        }
        let (n_pairs, rms_mm) = (pairs.source.len(), pairs.rms_mm);
        tracing::debug!(n_steps, n_pairs, rms_mm, "registered");
        let stop_reason = match converged {
            true => "residual",
            false if ctx.cancelled() => "cancelled",
            false => "iterations",
        };
        let report = json!({
            "iterations": n_steps, "n_pairs": n_pairs, "rms_mm": rms_mm, "converged": converged, "stop_reason": stop_reason
        });
        let pose = Pose::new(&i.target.frame, &i.source.frame, t).at(ctx.stamp_ns());
        Ok(Out { t_target_source: pose, report: Json(report.into()) })
    }
}

/// The points of the target that face the camera; all of them if its position is unknown.
fn visible(target: &Target, source: &Cloud, t_target_source: &Isometry3<f64>) -> Vec<Point3<f64>> {
    let (Some(normals), Some(viewpoint)) = (target.normals(), source.viewpoint) else {
        return target.points().to_vec();
    };
    let camera = t_target_source * Point3::from(viewpoint.translation.vector);
    let faces = |point: &Point3<f64>, normal: &Vector3<f64>| {
        let sight = camera - point;
        sight.dot(normal) > -PAST_SILHOUETTE * sight.norm()
    };
    let all = target.points().iter().zip(normals);
    all.filter(|(point, normal)| faces(point, normal)).map(|(point, _)| *point).collect()
}

/// Corresponding points, by index.
struct Pairs {
    target: Vec<Point3<f64>>,
    source: Vec<Point3<f64>>,
    rms_mm: f64,
}

/// Pairs each source point, moved by `t`, with the nearest point of the surface within `max_mm`.
fn pair(
    source: &[Point3<f64>],
    surface: &[Point3<f64>],
    tree: &Nearest,
    t: &Isometry3<f64>,
    max_mm: f64,
) -> Result<Pairs, NodeError> {
    let mut pairs = Pairs { target: Vec::new(), source: Vec::new(), rms_mm: 0.0 };
    let mut squares = 0.0;
    for point in source {
        let moved = t * point;
        let Some((index, _)) = tree.nearest(&moved) else { continue };
        let distance_mm = distance(&moved, &surface[index]);
        if distance_mm <= max_mm {
            pairs.target.push(surface[index]);
            pairs.source.push(*point);
            squares += distance_mm * distance_mm;
        }
    }
    let (n, n_source) = (pairs.source.len(), source.len());
    if n < MIN_PAIRS {
        return Err(NodeError::new(format!(
            "{n} of {n_source} source points are within {max_mm} mm of the target, {MIN_PAIRS} are needed; is init \
             right, and are both in mm?"
        )));
    }
    pairs.rms_mm = (squares / n as f64).sqrt();
    Ok(pairs)
}

osteoflow_node::export!(PointToPoint);

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_payloads::geometry::SurfaceOrigin;

    /// An asymmetric bowl of 21 x 21 points, 1 mm apart.
    fn bowl() -> Vec<Point3<f64>> {
        let place = |k: u32| (f64::from(k % 21) - 10.0, f64::from(k / 21) - 10.0);
        let height = |x: f64, y: f64| 0.03 * x * x + 0.05 * y * y + 0.5 * (x / 3.0).sin();
        (0..441).map(place).map(|(x, y)| Point3::new(x, y, height(x, y))).collect()
    }

    fn register(source: Vec<Point3<f64>>) -> Result<Out, NodeError> {
        let input = In {
            source: Cloud::new("camera", source)?,
            target: Target::new("ct", SurfaceOrigin::Exact, bowl(), None)?,
            init: Pose::new("ct", "camera", Isometry3::identity()),
        };
        PointToPoint::process(&Params::default(), input, &mut Context::for_test("icp"))
    }

    #[test]
    fn a_known_motion_is_found() {
        let truth = Isometry3::new(Vector3::new(0.2, -0.1, 0.3), Vector3::new(0.01, -0.02, 0.015));
        let out = register(bowl().iter().map(|p| truth.inverse() * p).collect()).unwrap();
        let error =
            (out.t_target_source.isometry * truth.inverse()).to_homogeneous() - Isometry3::identity().to_homogeneous();
        assert!(error.amax() < 1e-9, "{error}");
    }

    #[test]
    fn too_few_pairs_are_an_error_and_no_pose() {
        let far = bowl().iter().map(|p| p + Vector3::new(0.0, 0.0, 500.0)).collect();
        let message = register(far).map(|_| ()).unwrap_err().to_string();
        assert!(message.starts_with("0 of 441 source points are within 5 mm"), "{message}");
    }
}
