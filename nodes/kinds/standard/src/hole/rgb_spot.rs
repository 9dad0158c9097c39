//! The kind `hole.rgb_spot`.

use super::{Out, answer, name};
use osteoflow_algorithms::hole::{self, RgbSpotParams};
use osteoflow_geometry::{Cloud, FrameError, Image, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Describe, Inputs, NodeError, function};

/// The landmark under a laser spot, or under a mark of a surgical pen, found by its colour in an image of the scan.
///
/// Needs a camera with colour, unlike the paper's. The spot is searched among the pixels that show bone. Its centre is that of
/// a circle through its rim on the scanned surface, as glare and saturation do not move the rim. The node fails, and says why,
/// if there is no spot, if several look alike, if the silhouette cuts it, if the image is black or saturated, or if it
/// contradicts the scan, which lacks points where the laser is. A mirrored or wrongly calibrated image of a pen's mark is not
/// noticed: see docs/begin/frames-and-units.md.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "hole.rgb_spot"
in   = { reference = "to_bone.cloud", cloud = "to_bone_laser.cloud", image = "recording.image" }
spot_radius_mm = 2.0
"#,
    literature = ["section 2.3 of the paper, whose camera has no colour", "Kasa 1976, a circle fitting procedure"]
)]
pub struct RgbSpot;

/// Inputs of [`RgbSpot`].
#[derive(Inputs)]
pub struct In {
    /// The full scan.
    #[port(join = "once", frame = "cloud")]
    reference: Cloud,
    /// A scan with the laser spot, labelled with the landmark's name, with the pose of its camera as viewpoint.
    #[port(frame = "reference")]
    cloud: Cloud,
    /// The colour image taken with that scan, at most 100 ms before or after it.
    image: Image,
    /// The pose of the image's camera, if it is not the scan's. Unwired: the image has to be in frame `camera`.
    #[port(join = "once", to = "@camera", from = "image")]
    t_camera_image: Option<Pose>,
}

/// Maximum difference of the stamps of scan and image: scans with the laser are seconds apart.
const MAX_APART_NS: u64 = 100_000_000;

#[function("hole.rgb_spot")]
impl RgbSpot {
    fn process(params: &RgbSpotParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.cloud.frame.expect(&i.reference.frame, "the scan with the laser")?;
        i.check_pair(&name(&i.cloud, ctx))?;
        let t_camera_image = i.t_camera_image()?;
        answer(&i.cloud, hole::rgb_spot(&i.reference, &i.cloud, &i.image, &t_camera_image, params), ctx)
    }
}

impl In {
    /// Refuses an image of another scan.
    fn check_pair(&self, name: &str) -> Result<(), NodeError> {
        let apart_ns = self.cloud.stamp_ns.abs_diff(self.image.stamp_ns);
        if apart_ns > MAX_APART_NS {
            let apart_s = apart_ns as f64 * 1e-9;
            return Err(NodeError::new(format!(
                "{name}: the image was taken {apart_s:.1} s before or after the scan, 0.1 s are allowed; does it belong to another scan?"
            )));
        }
        match (&self.cloud.label, &self.image.label) {
            (Some(cloud), Some(image)) if cloud != image => Err(NodeError::new(format!(
                "{name}: the image is labelled {image}; wire the images in the order of the scans"
            ))),
            _ => Ok(()),
        }
    }

    fn t_camera_image(&self) -> Result<Isometry3<f64>, FrameError> {
        match &self.t_camera_image {
            Some(pose) => pose.expect(&"camera".into(), &self.image.frame),
            None => self.image.frame.expect(&"camera".into(), "the image").map(|()| Isometry3::identity()),
        }
    }
}
