//! The kind `output.csv`.

use super::{NoOutputs, file_of};
use osteoflow_geometry::Points;
use osteoflow_node::{Context, Describe, Inputs, NodeError, function};

/// Named points as a CSV file in the run's folder: `name,frame,x_mm,y_mm,z_mm,stamp_ns`.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.csv"
in   = { points = "laser_points.points" }
"#)]
pub struct Csv;

/// Inputs of [`Csv`].
#[derive(Inputs)]
pub struct In {
    /// A list of points; one file for each.
    points: Points,
}

#[function("output.csv")]
impl Csv {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        let Some(path) = file_of(ctx, "csv")? else { return Ok(NoOutputs {}) };
        let mut file = ::csv::Writer::from_path(path)?;
        file.write_record(["name", "frame", "x_mm", "y_mm", "z_mm", "stamp_ns"])?;
        for p in &*i.points.points {
            let [x, y, z] = [p.position.x, p.position.y, p.position.z].map(|c| c.to_string());
            file.write_record([&*p.name, i.points.frame.as_str(), &x, &y, &z, &p.stamp_ns.to_string()])?;
        }
        file.flush()?;
        Ok(NoOutputs {})
    }
}
