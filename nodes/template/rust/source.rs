//! A source as a starting point, which reads a file of points: change it, build it, and run the graph again.

use osteoflow_node::{
    Context, Describe, FilePath, NodeError, Outputs, ParamError, Source, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::geometry::{Cloud, nalgebra::Point3};

/// The points of a text file: one per line, x y z, separated by spaces; `#` begins a comment.
///
/// The last line must end, since a file that was cut within its last number would otherwise give a wrong point.
#[derive(Describe)]
#[describe(example = r#"
kind  = "my_plugin.xyz"
path  = "points.xyz"
frame = "bone_marker"
"#)]
pub struct Xyz {
    params: Params,
    done: bool,
}

/// Parameters of [`Xyz`].
#[osteoflow_node::params(path)]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// The file.
    path: FilePath,
    /// The frame of its coordinates. `camera`: a scan is in the frame of the camera that made it.
    #[param("camera")]
    frame: String,
    /// Millimetres in the file's unit. 1: the file is in mm; 1000: in metres.
    #[param(1.0, 1e-6..=1e6)]
    unit_mm: f64,
}

/// The outputs.
#[derive(Outputs)]
pub struct Out {
    /// The points, once, in the order of the file.
    #[port(frame = "$frame")]
    cloud: Cloud,
}

impl Source for Xyz {
    const KIND: &'static str = "my_plugin.xyz";
    const CONSTANT: bool = true;
    type Params = Params;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, done: false })
    }

    fn next(&mut self, _ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        if std::mem::replace(&mut self.done, true) {
            return Ok(None);
        }
        let path = self.params.path.as_ref().display();
        let text = std::fs::read_to_string(&self.params.path)
            .map_err(|error| NodeError::new(format!("{path}: cannot be read: {error}")))?;
        let points = points(&text, self.params.unit_mm).map_err(|error| NodeError::new(format!("{path}:{error}")))?;
        Ok(Some(Out { cloud: Cloud::new(self.params.frame.as_str(), points)? }))
    }
}

/// The points of a text, mm; an error begins with the number of its line.
fn points(text: &str, unit_mm: f64) -> Result<Vec<Point3<f64>>, String> {
    let mut points = Vec::new();
    for (number, line) in (1..).zip(text.split_inclusive('\n')) {
        let content = line.split('#').next().unwrap_or_default();
        let parsed: Vec<f64> = content.split_whitespace().map(|word| word.parse().unwrap_or(f64::NAN)).collect();
        match parsed[..] {
            _ if !line.ends_with('\n') => {
                return Err(format!("{number}: the last line does not end; is the file whole?"));
            }
            [] => {}
            [x, y, z] if parsed.iter().all(|c| (c * unit_mm).is_finite()) => {
                points.push(Point3::new(x, y, z) * unit_mm);
            }
            _ => return Err(format!("{number}: three numbers are expected, found {:?}", content.trim())),
        }
    }
    if points.is_empty() { Err("1: the file has no points".into()) } else { Ok(points) }
}

osteoflow_node::export!(Xyz);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_read_in_order_and_in_mm() {
        let read = points("# x y z\n1 2.5 -3e-1\n\n 4\t5 6 # the last\r\n", 1000.0).unwrap();
        assert_eq!(read, [Point3::new(1000.0, 2500.0, -300.0), Point3::new(4000.0, 5000.0, 6000.0)]);
    }

    #[test]
    fn a_file_that_is_cut_or_holds_no_points_is_an_error_with_its_line() {
        for (text, message) in [
            ("1 2 3\n4 5\n", "2: three numbers are expected, found \"4 5\""),
            ("1 2 3\n4 5 nan\n", "2: three numbers are expected, found \"4 5 nan\""),
            ("1 2 3 4\n", "1: three numbers are expected, found \"1 2 3 4\""),
            ("1 2 3\n4 5 6", "2: the last line does not end; is the file whole?"),
            ("# none\n", "1: the file has no points"),
        ] {
            assert_eq!(points(text, 1.0).unwrap_err(), message);
        }
    }
}
