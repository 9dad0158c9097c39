//! A view as JSON, for results.

use super::{Column, Field, View};
use crate::ColumnType;
use bytemuck::Pod;
use serde_json::{Map, Value as Json};

/// Head fields by name, then columns as lists of rows. NaN and infinities are `null`.
pub(crate) fn to_json(view: &View) -> Json {
    let field = |field: &Field| match field {
        Field::Bool(value) => (*value).into(),
        Field::Int(value) => (*value).into(),
        Field::Float(value) => (*value).into(),
        Field::Floats(values) => values.as_slice().into(),
        Field::Text(text) => (**text).into(),
    };
    let mut json: Map<_, _> = view.head.iter().map(|(name, value)| (name.to_string(), field(value))).collect();
    json.extend(view.columns.iter().map(|column| (column.name.to_string(), rows(column))));
    json.into()
}

fn rows(column: &Column) -> Json {
    fn values<T: Pod + Into<Json>>(column: &Column) -> Vec<Json> {
        bytemuck::pod_collect_to_vec::<u8, T>(column.bytes()).into_iter().map(Into::into).collect()
    }
    let values = match column.kind {
        ColumnType::F64 => values::<f64>(column),
        ColumnType::F32 => values::<f32>(column),
        ColumnType::I64 => values::<i64>(column),
        ColumnType::U32 => values::<u32>(column),
        ColumnType::U8 => values::<u8>(column),
    };
    match column.width {
        1 => values.into(),
        width => values.chunks(width as usize).map(<[Json]>::to_vec).collect(),
    }
}
