//! The ranges of parameters, which their fields declare to the schema.

use crate::error::SimulationError;
use schemars::{JsonSchema, Schema};
use serde::Serialize;
use serde_json::Value;
use std::{
    any::TypeId,
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

/// Checks every number of `params` against its declared range; `table` is the name of the parameters' table.
pub(crate) fn check<P: Serialize + JsonSchema + 'static>(table: &str, params: &P) -> Result<(), SimulationError> {
    // Made once for each type: a sweep checks thousands of graphs.
    static SCHEMAS: Mutex<BTreeMap<TypeId, Arc<Value>>> = Mutex::new(BTreeMap::new());
    let mut schemas = SCHEMAS.lock().unwrap_or_else(PoisonError::into_inner);
    let schema =
        schemas.entry(TypeId::of::<P>()).or_insert_with(|| Arc::new(schemars::schema_for!(P).to_value())).clone();
    drop(schemas);
    let values = serde_json::to_value(params).expect("parameters are tables of numbers and words");
    within(&schema, &schema, table, &values)
}

fn within(root: &Value, schema: &Value, name: &str, value: &Value) -> Result<(), SimulationError> {
    let reference = schema["$ref"].as_str().and_then(|path| root.pointer(path.trim_start_matches('#')));
    let schema = reference.unwrap_or(schema);
    let (min, max) = (&schema["minimum"], &schema["maximum"]);
    let refused = |value: String, expected: String| Err(SimulationError::parameter(name, value, &expected));
    match value {
        Value::Object(fields) => fields.iter().try_for_each(|(key, value)| {
            let name = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
            within(root, &schema["properties"][key], &name, value)
        }),
        Value::Array(items) => items.iter().try_for_each(|item| within(root, &schema["items"], name, item)),
        // NaN and infinity, which JSON does not have.
        Value::Null if schema["type"] == "number" => refused("not finite".into(), "a number".into()),
        Value::Number(number) => {
            let value = number.as_f64().unwrap_or(f64::NAN);
            match (min.as_f64(), max.as_f64()) {
                (Some(min), Some(max)) if !(min..=max).contains(&value) => {
                    refused(value.to_string(), format!("between {min} and {max}"))
                }
                (Some(min), None) if value < min => refused(value.to_string(), format!("at least {min}")),
                (None, Some(max)) if value > max => refused(value.to_string(), format!("at most {max}")),
                _ => Ok(()),
            }
        }
        _ => Ok(()),
    }
}

/// Removes the defaults of whole tables from the schema of parameters: their numbers have defaults of their own.
pub fn without_table_defaults(schema: &mut Schema) {
    let properties = schema.get_mut("properties").and_then(Value::as_object_mut);
    for property in properties.into_iter().flat_map(|properties| properties.values_mut()) {
        if property["default"].is_object() {
            property.as_object_mut().and_then(|property| property.remove("default"));
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{BoneParams, CtParams, ProcedureParams};

    #[test]
    fn every_number_is_checked_against_the_range_that_its_field_declares() {
        let refused = |change: fn(&mut ProcedureParams)| {
            let mut params = ProcedureParams::default();
            change(&mut params);
            params.check().map_err(|error| error.to_string()).unwrap_err()
        };
        for (error, expected) in [
            (refused(|p| p.bone.length_mm = 100.0), "bone.length_mm is 100, but must be between 250 and 450"),
            (refused(|p| p.camera.n_points = 99), "camera.n_points is 99, but must be between 100 and 500000"),
            (refused(|p| p.tissue.patch_mm = [10.0, 101.0]), "tissue.patch_mm is 101, but must be between 2 and 100"),
            (refused(|p| p.bone.centre_mm[1] = f64::NAN), "bone.centre_mm is not finite, but must be a number"),
            (refused(|p| p.motion.knock_mm = f64::INFINITY), "motion.knock_mm is not finite, but must be a number"),
            (
                refused(|p| p.phantom.distance_mm = Some(f64::NAN)),
                "phantom.distance_mm is NaN, but must be a finite number",
            ),
            (
                refused(|p| p.phantom.distance_mm = Some(10.0)),
                "phantom.distance_mm is 10, but must be between 50 and 1000",
            ),
            (refused(|p| p.camera.scan_to_mm = 60.0), "camera.scan_to_mm is 60, but must be beyond scan_from_mm"),
        ] {
            assert_eq!(error, expected);
        }
        assert_eq!(ProcedureParams::default().check(), Ok(()));
        assert_eq!(BoneParams::default().check(), Ok(()));
        let coarse = CtParams { voxel_mm: 3.5, ..CtParams::default() }.check().unwrap_err();
        assert!(coarse.to_string().starts_with("ct.voxel_mm is 3.5"));
    }

    #[test]
    fn a_table_has_no_default_in_the_schema_and_its_numbers_have() {
        let schema = schemars::schema_for!(ProcedureParams).to_value();
        assert!(schema["properties"]["camera"].get("default").is_none(), "{}", schema["properties"]["camera"]);
        assert_eq!(schema["$defs"]["CameraParams"]["properties"]["n_points"]["default"], 20_000);
    }
}
