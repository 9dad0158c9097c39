//! The kind `crop.file`.

use super::Out;
use osteoflow_formats::region_file::read_region;
use osteoflow_geometry::{Cloud, DrawnRegion, Region};
use osteoflow_node::{
    Context, Describe, FilePath, Inputs, Node, NodeError, ParamError, Unused, schemars::JsonSchema, serde::Deserialize,
};

/// A share of the points inside that is this much lower than on the cloud that the region was drawn on is a warning: half.
const WARNED_SHARE: f64 = 0.5;

/// The points in a region that was drawn by hand, on the page of `osteoflow view` or elsewhere.
///
/// The file is JSON in mm and states its frame, which must be the cloud's (docs/use/formats.md). It replaces the region of the recording.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "crop.file"
in   = { cloud = "recording.scan" }
path = "region.json"
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct File {
    path: FilePath,
    region: Option<DrawnRegion>,
}

/// Parameters of [`File`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The region.
    pub path: FilePath,
}

/// Inputs of [`File`].
#[derive(Inputs)]
pub struct In {
    /// The cloud to crop.
    cloud: Cloud,
    /// The recording's region, which the file replaces.
    #[port(join = "once", frame = "cloud")]
    region: Unused<Region>,
}

impl Node for File {
    const KIND: &'static str = "crop.file";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { path: params.path, region: None })
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let _ = i.region;
        let region = match &self.region {
            Some(region) => region,
            None => self.region.insert(read_region(self.path.as_ref())?),
        };
        region.frame.expect(&i.cloud.frame, "the drawn region of interest")?;
        let n = i.cloud.len();
        let chosen: Vec<usize> = (0..n).filter(|&k| region.contains(&i.cloud.points()[k])).collect();
        if chosen.is_empty() {
            let message = format!("none of {n} points lies in the drawn region; was it drawn on another scan?");
            return Err(NodeError::new(message));
        }
        if let Some(on) = region.drawn_on {
            let (now, then) = (chosen.len() as f64 / n as f64, on.n_inside as f64 / on.n_points.max(1) as f64);
            if now < WARNED_SHARE * then {
                ctx.warn(format!(
                    "{} of {n} points lie in the drawn region, {} of {} did when it was drawn; was the camera moved since?",
                    chosen.len(),
                    on.n_inside,
                    on.n_points
                ));
            }
        }
        let cloud = if chosen.len() == n { i.cloud } else { i.cloud.selected(&chosen) };
        Ok(Out { cloud })
    }
}
