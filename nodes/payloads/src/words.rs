use crate::Table;
use osteoflow_node::{Part, Payload, View, ViewError};
use std::sync::Arc;

/// A word or sentence that belongs to a result, such as where the CT surface comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Text(pub Arc<str>);

impl Payload<Table> for Text {
    const NAME: &'static str = "report/Text";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [Part] = &[Part::text("text")];

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

/// A yes or no that belongs to a result, such as whether it was simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flag(pub bool);

impl Payload<Table> for Flag {
    const NAME: &'static str = "report/Flag";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [Part] = &[Part::bool("flag")];

    fn to_view(&self) -> View {
        View::new().with("flag", self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        match view.field("flag") {
            Some(osteoflow_node::Field::Bool(flag)) => Ok(Self(*flag)),
            _ => Err(ViewError::Missing { what: "yes or no", name: "flag".into() }),
        }
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.into()
    }
}
