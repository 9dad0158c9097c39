use crate::Table;
use osteoflow_node::{Payload, SchemaEntry, View, ViewError};
use std::sync::Arc;

/// A text in a result, such as the origin of the CT surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Text(pub Arc<str>);

impl Payload<Table> for Text {
    const NAME: &'static str = "report/Text";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::text("text")];

    fn to_view(&self) -> View {
        View::new().with("text", &*self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.text("text")?.into()))
    }

    fn n_bytes(&self) -> usize {
        size_of::<Self>() + self.0.len()
    }

    fn to_result(&self) -> serde_json::Value {
        (*self.0).into()
    }
}

/// A yes or no in a result, such as whether it was simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flag(pub bool);

impl Payload<Table> for Flag {
    const NAME: &'static str = "report/Flag";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::bool("flag")];

    fn to_view(&self) -> View {
        View::new().with("flag", self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        match view.field("flag") {
            Some(osteoflow_node::Field::Bool(flag)) => Ok(Self(*flag)),
            _ => Err(ViewError::Missing { what: "boolean field", name: "flag".into() }),
        }
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.into()
    }
}

/// Any JSON, for results without a payload of their own. In `results.json` it is unchanged.
///
/// A number in it has no unit but the suffix of its key; [`crate::Metrics`] carries units.
#[derive(Debug, Clone, PartialEq)]
pub struct Json(pub Arc<serde_json::Value>);

impl Payload<Table> for Json {
    const NAME: &'static str = "report/Json";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::text("json")];

    fn to_view(&self) -> View {
        View::new().with("json", self.0.to_string())
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        let json = serde_json::from_str(view.text("json")?).map_err(|error| ViewError::Invalid(error.to_string()))?;
        Ok(Self(Arc::new(json)))
    }

    fn to_result(&self) -> serde_json::Value {
        (*self.0).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn json_comes_back_with_its_keys_in_order_and_its_numbers_to_the_bit() {
        let json = Json(Arc::new(json!({ "z": [0.1, -0.0, 1e308, u64::MAX], "a": { "b": null, "c": "µ" } })));
        let back = Json::from_view(&json.to_view()).unwrap();
        assert_eq!(back.to_result().to_string(), json.to_result().to_string());
        assert_eq!(back.0["z"][0].as_f64().map(f64::to_bits), Some(0.1_f64.to_bits()));
        let message = Json::from_view(&View::new().with("json", "{")).unwrap_err().to_string();
        assert!(message.starts_with("the view is not a valid payload"), "{message}");
    }
}
