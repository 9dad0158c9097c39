//! Crops to the region of interest. All kinds have the same ports.

pub mod r#box;
pub mod file;
pub mod polygon;
pub mod slab;
pub mod sphere;

use osteoflow_geometry::{Cloud, Region};
use osteoflow_node::{Inputs, NodeError, Outputs};

/// Inputs of every crop.
#[derive(Inputs)]
pub struct In {
    /// The cloud to crop.
    cloud: Cloud,
    /// A region drawn by the user; points outside it are removed too. None: the parameters alone.
    #[port(join = "once", frame = "cloud")]
    region: Option<Region>,
}

/// Outputs of every crop.
#[derive(Outputs)]
pub struct Out {
    /// The points in the region.
    #[port(frame = "cloud")]
    cloud: Cloud,
}

impl In {
    /// The cloud of the chosen points that are also in the drawn region.
    fn cropped(self, chosen: Vec<usize>) -> Result<Out, NodeError> {
        let mut chosen = chosen;
        if let Some(region) = &self.region {
            region.frame.expect(&self.cloud.frame, "the region of interest")?;
            chosen.retain(|&i| region.contains(&self.cloud.points()[i]));
        }
        if self.cloud.is_empty() {
            return Err(NodeError::new(
                "there are no points to crop; is the scan empty, or none of its points finite?",
            ));
        }
        if chosen.is_empty() {
            let (points, frame) = (self.cloud.points(), &self.cloud.frame);
            let (low, high) = points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)));
            return Err(NodeError::new(format!(
                "none of {} points lies in the region of interest; is it given in mm, in {frame}? They lie in the box \
                 {:.1},{:.1},{:.1},{:.1},{:.1},{:.1}",
                points.len(),
                low.x,
                low.y,
                low.z,
                high.x,
                high.y,
                high.z
            )));
        }
        let cloud = if chosen.len() == self.cloud.len() { self.cloud } else { self.cloud.selected(&chosen) };
        Ok(Out { cloud })
    }
}
