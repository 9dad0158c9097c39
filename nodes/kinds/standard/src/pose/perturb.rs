//! The kind `pose.perturb`.

use osteoflow_algorithms::perturb::random_motion;
use osteoflow_formats::pose_file::read_pose;
use osteoflow_geometry::{Cloud, Frame, Pose, nalgebra::Isometry3};
use osteoflow_node::{
    Context, Describe, FilePath, Inputs, NodeError, Outputs, function, params, schemars::JsonSchema, serde::Deserialize,
};

/// A scan at a random pose, and the pose that takes it back: the start of a registration whose answer is known.
///
/// The scan turns about its centroid about a random axis, then moves in a random direction, drawn from the run's seed.
#[derive(Describe)]
#[describe(example = r#"
kind = "pose.perturb"
in   = { cloud = "scan.cloud" }
max_turn_deg = 180.0
max_shift_mm = 500.0
"#)]
pub struct Perturb;

/// Parameters of [`Perturb`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Largest angle; all up to it are equally likely. 180: nothing is known of the start.
    #[param(180.0, 0.0..=180.0)]
    pub max_turn_deg: f64,
    /// Largest length of the shift; all up to it are equally likely. 500: as published for bones in a tracker's view.
    #[param(500.0, 0.0..=1e6)]
    pub max_shift_mm: f64,
    /// A file with the true pose of the scan, a matrix of 16 numbers that takes it to the surface, mm. Unset: both files are in
    /// one frame.
    pub truth: Option<FilePath>,
    /// The frame of the surface, which the pose leads to. `ct`: that of a bone.
    #[param("ct")]
    pub to: String,
    /// The frame of the perturbed scan. `camera`: that of a scan.
    #[param("camera")]
    pub frame: String,
}

/// Inputs of [`Perturb`].
#[derive(Inputs)]
pub struct In {
    /// The scan where its file has it.
    cloud: Cloud,
}

/// Outputs of [`Perturb`].
#[derive(Outputs)]
pub struct Out {
    /// The scan at the random pose. A known camera moves with it.
    #[port(frame = "$frame")]
    cloud: Cloud,
    /// The true pose of the perturbed scan, which a registration should find.
    #[port(to = "$to", from = "$frame")]
    pose: Pose,
}

#[function("pose.perturb")]
impl Perturb {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let t_to_file = match &params.truth {
            Some(path) => {
                let read = read_pose(path.as_ref(), 1.0)?;
                read.notes.into_iter().for_each(|note| ctx.warn(note));
                read.isometry
            }
            None => Isometry3::identity(),
        };
        let (turn_rad, shift_mm) = (params.max_turn_deg.to_radians(), params.max_shift_mm);
        let perturbed_by = random_motion(i.cloud.points(), turn_rad, shift_mm, &mut ctx.rng());
        let frame = Frame::from(params.frame.as_str());
        let cloud = i.cloud.transformed(frame.clone(), &perturbed_by);
        let pose = Pose::new(params.to.as_str(), frame, t_to_file * perturbed_by.inverse());
        Ok(Out { cloud, pose: pose.at(ctx.stamp_ns()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::{Point3, Vector3};
    use osteoflow_node::Function;

    fn perturbed(params: &Params, seed: u64) -> (Vec<Point3<f64>>, Pose) {
        let points = [[0.0, 0.0, 900.0], [30.0, 0.0, 900.0], [0.0, 40.0, 910.0]].map(Point3::from);
        let cloud = Cloud::new("ct", points.to_vec()).expect("a cloud");
        let mut ctx = Context::new("perturb", seed, Default::default(), Vec::new().into());
        let out = Perturb::process(params, In { cloud }, &mut ctx).expect("a pose");
        assert_eq!(
            (out.cloud.frame.as_str(), out.pose.to.as_str(), out.pose.from.as_str()),
            ("camera", "ct", "camera")
        );
        for (moved, point) in out.cloud.points().iter().zip(points) {
            let back_mm = (out.pose.isometry * moved - point).norm();
            assert!(params.truth.is_some() || back_mm < 1e-9, "{back_mm} mm off");
        }
        (out.cloud.points().to_vec(), out.pose)
    }

    #[test]
    fn the_pose_takes_the_perturbed_scan_back_and_follows_the_seed() {
        let params = Params::default();
        let (points, pose) = perturbed(&params, 1);
        assert_eq!((perturbed(&params, 1).0, perturbed(&params, 2).0 == points), (points, false));
        assert!(pose.isometry.rotation.angle() > 0.01);
        let still = Params { max_turn_deg: 0.0, max_shift_mm: 0.0, ..params };
        assert!(
            (perturbed(&still, 1).1.isometry.to_homogeneous() - Isometry3::identity().to_homogeneous()).norm() < 1e-9
        );
    }

    #[test]
    fn the_true_pose_of_a_file_comes_after_the_motion_back() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), "1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n").expect("writes");
        let plain = Params { max_turn_deg: 0.0, ..Params::default() };
        let with = Params { truth: Some(FilePath(file.path().into())), ..plain.clone() };
        let (a, b) = (perturbed(&plain, 3).1.isometry, perturbed(&with, 3).1.isometry);
        assert!((b.translation.vector - a.translation.vector - Vector3::new(5.0, 0.0, 0.0)).norm() < 1e-9);
    }
}
