use osteoflow_node::{Display, DisplayContext, Payload, SchemaEntry, View, ViewError, serde_json};

/// A number.
#[derive(Debug, Clone, PartialEq)]
pub struct Number(pub f64);

impl Payload<Number> for Number {
    const NAME: &'static str = "toy/Number";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::float("value")];
    const INTERPOLATES: bool = true;

    fn to_view(&self) -> View {
        View::new().with("value", self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.float("value")?))
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.into()
    }

    fn interpolate(a: &Self, b: &Self, s: f64) -> Option<Self> {
        Some(Self(a.0 + s * (b.0 - a.0)))
    }

    fn display() -> Option<Display> {
        Some(crate::json_display("toy.Number"))
    }

    fn to_display(&self, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
        let stamp_ns = about.stamp_ns;
        Some(format!("{{\"value\": {}, \"stamp_ns\": {stamp_ns}}}", self.0).into_bytes())
    }
}
