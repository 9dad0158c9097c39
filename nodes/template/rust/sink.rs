//! A sink as a starting point, which writes a file of points: change it, build it, and run the graph again.

use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::{Text, geometry::Cloud};
use std::fmt::Write;

/// Writes clouds as text files of points into the run's folder, named after the node: one point per line, x y z.
///
/// The numbers read back to the same bits. The first line is a comment with frame and unit.
#[derive(Describe)]
#[describe(example = r#"
kind = "my_plugin.xyz"
in   = { cloud = "to_bone.cloud" }
unit_mm = 1.0
"#)]
pub struct Xyz;

/// Parameters of [`Xyz`].
#[osteoflow_node::params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", default, deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// Millimetres in the file's unit. 1: the file is in mm; 1000: in metres.
    #[param(1.0, 1e-6..=1e6)]
    unit_mm: f64,
}

/// The inputs.
#[derive(Inputs)]
pub struct In {
    /// A cloud; one file for each.
    cloud: Cloud,
}

/// The outputs.
#[derive(Outputs)]
pub struct Out {
    /// The name of the file.
    file: Text,
}

impl Function for Xyz {
    const KIND: &'static str = "my_plugin.xyz";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let Some(dir) = ctx.out_dir() else {
            return Err(NodeError::new("the run has no folder to write into; name one with --out"));
        };
        let file = format!("{}-{}.xyz", ctx.node(), ctx.item());
        let path = dir.join(&file);
        std::fs::write(&path, text(&i.cloud, params.unit_mm))
            .map_err(|error| NodeError::new(format!("{} cannot be written: {error}", path.display())))?;
        Ok(Out { file: Text(file.into()) })
    }
}

/// The content of a file.
fn text(cloud: &Cloud, unit_mm: f64) -> String {
    let mut text = format!("# frame {}, unit {unit_mm} mm\n", cloud.frame);
    for point in cloud.points() {
        let [x, y, z] = point.coords.map(|c| c / unit_mm).into();
        // A String takes all that is written.
        let _ = writeln!(text, "{x} {y} {z}");
    }
    text
}

osteoflow_node::export!(Xyz);

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_payloads::geometry::nalgebra::Point3;

    #[test]
    fn every_point_is_a_line_in_the_unit_of_the_file() {
        let cloud = Cloud::new("ct", vec![Point3::new(1.0, -0.5, 2e-9), Point3::new(1.0 / 3.0, 0.0, 1e3)]).unwrap();
        assert_eq!(text(&cloud, 1.0), "# frame ct, unit 1 mm\n1 -0.5 0.000000002\n0.3333333333333333 0 1000\n");
        assert_eq!(text(&cloud, 1000.0).lines().last(), Some("0.0003333333333333333 0 1"));
    }

    #[test]
    fn a_run_without_a_folder_is_an_error() {
        let input = In { cloud: Cloud::new("ct", vec![Point3::origin()]).unwrap() };
        let message = Xyz::process(&Params::default(), input, &mut Context::for_test("sink")).map(|_| ()).unwrap_err();
        assert!(message.to_string().starts_with("the run has no folder"), "{message}");
    }
}
