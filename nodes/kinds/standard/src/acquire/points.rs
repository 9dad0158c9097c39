//! The kind `acquire.points`.

use crate::constant::Constant;
use osteoflow_formats::{Space, picked_points::read_picked_points};
use osteoflow_geometry::Points;
use osteoflow_node::{
    Context, Describe, FilePath, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize,
};

/// Named points from a file, picked in another program or on the page of `osteoflow view`.
///
/// Formats: 3D Slicer's `.mrk.json` and `.fcsv`, MeshLab's `.pp`, CloudCompare's picking list, and CSV with the heading
/// `label,x,y,z`; mm. RAS, which Slicer's files state, is turned to LPS, with a note. The others are taken as they are.
#[derive(Describe)]
#[describe(example = r#"
kind  = "acquire.points"
path  = "scan_points.mrk.json"
frame = "camera"
"#)]
pub struct PointsFile;

/// Parameters of [`PointsFile`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The file.
    pub path: FilePath,
    /// The frame of its coordinates, such as `ct` for points on the bone, or `camera` on a scan. No default: a file does not
    /// say what its points were picked on.
    pub frame: String,
}

/// Outputs of [`PointsFile`].
#[derive(Outputs)]
pub struct Out {
    /// The points, once, in the order of the file.
    #[port(frame = "$frame")]
    points: Points,
}

impl Constant for PointsFile {
    const KIND: &'static str = "acquire.points";
    type Params = Params;
    type Outputs = Out;

    fn check(params: &Params) -> Result<(), ParamError> {
        if params.frame.trim().is_empty() {
            return Err(ParamError::new("frame", "a name is expected, such as \"ct\""));
        }
        Ok(())
    }

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        let Params { path, frame } = params;
        let read = read_picked_points(path.as_ref())?;
        let name = path.as_ref().display();
        if read.points.is_empty() {
            return Err(NodeError::new(format!("{name} holds planes or boxes, but no points")));
        }
        if let Some(stated) = read.frame.as_ref().filter(|stated| stated.as_str() != frame) {
            let message =
                format!("{name} states that its points are in \"{stated}\", and frame is \"{frame}\"; set frame to it");
            return Err(NodeError::new(message));
        }
        read.notes.into_iter().for_each(|note| ctx.warn(format!("{name}: {note}")));
        if !read.is_named {
            ctx.warn(format!("{name}: points without a name are called by their place in the list"));
        }
        if read.space == Space::Unknown && frame == "ct" {
            ctx.warn(format!("{name}: the file states neither LPS nor RAS, and its numbers are taken to be LPS"));
        }
        Ok(Out { points: Points::new(frame.as_str(), read.points) })
    }
}
