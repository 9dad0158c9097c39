use osteoflow_node::{Column, ColumnType, Payload, SchemaEntry, View, ViewError, serde_json};
use std::sync::Arc;

/// Samples with a label.
#[derive(Debug, Clone)]
pub struct Samples {
    pub label: String,
    pub samples: Vec<f64>,
}

impl Payload<Samples> for Samples {
    const NAME: &'static str = "toy/Samples";
    const VERSION: u32 = 2;
    const SCHEMA: &'static [SchemaEntry] =
        &[SchemaEntry::text("label"), SchemaEntry::column("samples", ColumnType::F64, 1)];

    fn to_view(&self) -> View {
        View::new().with("label", self.label.as_str()).with_column(float_column("samples", 1, &self.samples))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self { label: view.text("label")?.into(), samples: view.column("samples")?.rows_of::<f64>()?.into_owned() })
    }

    fn to_result(&self) -> serde_json::Value {
        self.samples.len().into()
    }
}

pub(crate) fn float_column(name: &'static str, width: u32, values: &[f64]) -> Column {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
    Column::new(name, ColumnType::F64, width, Arc::new(bytes))
}
