//! Defaults and ranges that the fields of parameters state.

use osteoflow_node::{
    params,
    schemars::{JsonSchema, schema_for},
    serde::Deserialize,
    serde_json::{from_value, json},
};

#[params]
#[derive(Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", default, deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
struct Cut {
    #[param(1.5, -2.0..=2.0)]
    tilt_deg: f64,
    #[param("ct")]
    frame: String,
    #[param(true)]
    keeps: bool,
    side: Option<u8>,
}

#[params(path)]
#[derive(Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(crate = "osteoflow_node::serde", deny_unknown_fields)]
#[schemars(crate = "osteoflow_node::schemars")]
struct File {
    path: String,
    #[param(1.0, 1e-6..=1e6)]
    unit_mm: f64,
    series: Option<String>,
}

#[test]
fn a_field_has_the_default_and_the_range_that_it_states() {
    let cut = Cut { tilt_deg: 1.5, frame: "ct".into(), keeps: true, side: None };
    assert_eq!(Cut::default(), cut);
    assert_eq!(from_value::<Cut>(json!({ "tilt_deg": -1.0 })).unwrap(), Cut { tilt_deg: -1.0, ..cut });
    let schema = schema_for!(Cut).to_value();
    let tilt = &schema["properties"]["tilt_deg"];
    assert_eq!((&tilt["default"], &tilt["minimum"], &tilt["maximum"]), (&json!(1.5), &json!(-2.0), &json!(2.0)));
    assert_eq!(schema["properties"]["frame"]["minimum"], json!(null), "a default alone sets no range");
}

#[test]
fn a_required_field_is_asked_for_and_the_others_have_their_defaults() {
    let file = File { path: "a.stl".into(), unit_mm: 1.0, series: None };
    assert_eq!(from_value::<File>(json!({ "path": "a.stl" })).unwrap(), file);
    let missing = from_value::<File>(json!({ "unit_mm": 2.0 })).unwrap_err().to_string();
    assert_eq!(missing, "missing field `path`");
    let schema = schema_for!(File).to_value();
    assert_eq!(schema["required"], json!(["path"]));
    assert_eq!(schema["properties"]["unit_mm"]["default"], json!(1.0));
}
