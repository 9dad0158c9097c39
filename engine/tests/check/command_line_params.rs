//! Parameters from the command line alone.

use super::golden::compare;
use osteoflow_engine::check::{CommandLineParam, parameters};
use osteoflow_toy::stages;
use serde_json::json;
use std::path::Path;

fn option<'a>(option: &'a str, key: &'a str, value: &'a str) -> CommandLineParam<'a> {
    CommandLineParam::Option { option, key, value }
}

fn read(given: &[CommandLineParam<'_>]) -> Result<serde_json::Value, String> {
    let registry = stages::registry();
    let kind = &registry.kind("icp.point_to_point").unwrap().description;
    let (params, warnings) = parameters(kind, "register", given).map_err(|faults| faults.render(false))?;
    assert!(warnings.is_empty(), "{warnings:?}");
    Ok(params)
}

#[test]
fn missing_parameters_have_defaults_and_later_ones_take_precedence() {
    let plain = json!({ "max_iterations": 50, "max_pair_distance_mm": 5.0, "tolerance_rad": 1e-6 });
    assert_eq!(read(&[]).unwrap(), plain);
    let given = [
        CommandLineParam::Set("max_iterations=7"),
        option("max-pair-distance-mm", "max_pair_distance_mm", "3"),
        CommandLineParam::Set(" max_iterations = 8 "),
        option("max-pair-distance-mm", "max_pair_distance_mm", "2.5"),
    ];
    let expected = json!({ "max_iterations": 8, "max_pair_distance_mm": 2.5, "tolerance_rad": 1e-6 });
    assert_eq!(read(&given).unwrap(), expected);
}

#[test]
fn faults_are_those_of_a_graph_and_show_what_was_typed() {
    let faults = read(&[
        CommandLineParam::Set("max_pair_distance=3"),
        option("max-iterations", "max_iterations", "0"),
        CommandLineParam::Set("tolerance_rad"),
        CommandLineParam::Set("tolerance_rad=1 mrad"),
        CommandLineParam::Set("graph.seed=7"),
    ]);
    compare(&faults.unwrap_err(), Path::new("tests/check/command_line_params.txt")).unwrap();
}
