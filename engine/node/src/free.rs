//! Payload types that are made while the program runs: of a plugin, or of a recording.

use crate::{Column, ColumnType, Field, Part, PayloadType, SchemaError, Value, View};
use bytemuck::Pod;
use serde_json::{Map, Value as Json};
use std::{
    any::{Any, TypeId},
    collections::BTreeSet,
    sync::{Arc, Mutex, PoisonError},
};

/// A value of a type that this program knows by its schema alone: it is its view.
#[derive(Debug, Clone, PartialEq)]
pub struct FreePayload(View);

impl FreePayload {
    /// The view, which fits the schema of its type.
    pub fn view(&self) -> &View {
        &self.0
    }

    /// Reads lengths and walks no column.
    fn n_bytes(&self) -> usize {
        let columns: usize = self.0.columns.iter().map(|column| column.bytes().len()).sum();
        let fields = self.0.head.iter().map(|(name, field)| {
            let bulk = match field {
                Field::Text(text) => text.len(),
                Field::Floats(values) => size_of_val(&**values),
                _ => 0,
            };
            size_of_val(field) + name.len() + bulk
        });
        size_of::<Self>() + columns + fields.sum::<usize>()
    }
}

/// All types made so far: for each name, version and schema one.
static TYPES: Mutex<Vec<&'static PayloadType>> = Mutex::new(Vec::new());
/// All texts kept so far.
static TEXTS: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());

impl PayloadType {
    /// A payload type of which only this is known; its values are [`FreePayload`]s.
    ///
    /// It is kept until the program ends, as a loaded library is: who asks again for the same gets the same.
    ///
    /// # Errors
    /// [`SchemaError`] if the parts are no schema, or the name none of a payload.
    pub fn free(name: &str, version: u32, schema: Vec<Part>) -> Result<&'static Self, SchemaError> {
        if name.is_empty() || name == "any" || name.contains(|c: char| c.is_control() || c == '@') {
            let wrong = "is no name of a payload; one such as geometry/Cloud is expected";
            return Err(SchemaError(format!("\"{}\" {wrong}", name.escape_debug())));
        }
        Part::check_all(&schema)?;
        let mut types = TYPES.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |ty: &&&Self| (ty.name, ty.version, ty.schema) == (name, version, &*schema);
        if let Some(ty) = types.iter().find(same) {
            return Ok(ty);
        }
        let ty: &'static Self = Box::leak(Box::new(Self {
            name: kept(name),
            version,
            interpolates: false,
            schema: schema.leak(),
            id: TypeId::of::<FreePayload>,
            to_view: |any| free(any).0.clone(),
            from_view: |ty, view| {
                view.check(ty.schema)?;
                Ok(Value { inner: Arc::new(FreePayload(view.clone())), ty })
            },
            to_result: |any| to_json(&free(any).0),
            n_bytes: |any| free(any).n_bytes(),
            interpolate: |_, _, _| None,
            display: || None,
            to_display: |_, _| None,
        }));
        types.push(ty);
        Ok(ty)
    }
}

fn free(any: &dyn Any) -> &FreePayload {
    any.downcast_ref().expect("a value carries its own type")
}

/// The text, kept until the program ends; equal texts are kept once.
pub(crate) fn kept(text: &str) -> &'static str {
    let mut texts = TEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    match texts.get(text) {
        Some(kept) => kept,
        None => {
            let kept: &'static str = String::leak(text.to_owned());
            texts.insert(kept);
            kept
        }
    }
}

/// The head fields by name, then the columns, each a list of its rows. A number that JSON does not have is `null`.
fn to_json(view: &View) -> Json {
    let field = |field: &Field| match field {
        Field::Bool(value) => (*value).into(),
        Field::Int(value) => (*value).into(),
        Field::Float(value) => (*value).into(),
        Field::Floats(values) => values.as_slice().into(),
        Field::Text(text) => (**text).into(),
    };
    let mut told: Map<_, _> = view.head.iter().map(|(name, value)| (name.to_string(), field(value))).collect();
    told.extend(view.columns.iter().map(|column| (column.name.to_string(), rows(column))));
    told.into()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Registry;
    use serde_json::json;

    const SCHEMA: &[Part] = &[
        Part::text("label"),
        Part::float("gain").optional(),
        Part::column("points", ColumnType::F64, 2).unit("mm"),
        Part::column("hits", ColumnType::U8, 1),
    ];

    fn view() -> View {
        let points: Vec<u8> = [1.0, f64::NAN, 3.0, 4.5].into_iter().flat_map(f64::to_ne_bytes).collect();
        View::new()
            .with("label", "a")
            .with_column(Column::new("points", ColumnType::F64, 2, Arc::new(points)))
            .with_column(Column::new("hits", ColumnType::U8, 1, Arc::new(vec![7_u8, 255])))
    }

    #[test]
    fn a_view_of_a_free_type_comes_back_as_it_was_and_shares_its_columns() {
        let ty = PayloadType::free("free/Shared", 1, SCHEMA.to_vec()).unwrap();
        let view = view();
        let value = ty.from_view(&view).unwrap();
        assert_eq!((value.ty(), value.to_view()), (ty, view.clone()));
        assert_eq!(value.to_view().columns[0].bytes().as_ptr(), view.columns[0].bytes().as_ptr());
        assert_eq!(value.get::<FreePayload>().unwrap().view(), &view);
        assert!(value.n_bytes() > 4 * 8 + 2, "{} bytes", value.n_bytes());
        let told = json!({ "label": "a", "points": [[1.0, null], [3.0, 4.5]], "hits": [7, 255] });
        assert_eq!(value.to_result().to_string(), told.to_string());
    }

    #[test]
    fn a_view_that_does_not_fit_the_schema_is_refused() {
        let ty = PayloadType::free("free/Refused", 1, SCHEMA.to_vec()).unwrap();
        let error = ty.from_view(&view().with("colour", "red")).unwrap_err().to_string();
        assert_eq!(error, "the view has a field \"colour\" that its payload does not have");
    }

    #[test]
    fn free_types_are_equal_by_name_version_and_schema_and_made_once() {
        let of = |name, version, schema: &[Part]| PayloadType::free(name, version, schema.to_vec()).unwrap();
        let ty = of("free/One", 1, SCHEMA);
        assert!(std::ptr::eq(ty, of("free/One", 1, SCHEMA)));
        assert_ne!(ty, of("free/Two", 1, SCHEMA));
        assert_ne!(ty, of("free/One", 2, SCHEMA));
        assert_ne!(ty, of("free/One", 1, &SCHEMA[..1]));
        let mut told_more = SCHEMA.to_vec();
        told_more[0] = told_more[0].doc("what it is called");
        assert_eq!(ty, of("free/One", 1, &told_more), "what is said of a part makes no other type");
    }

    #[test]
    fn what_is_no_schema_or_no_name_makes_no_type() {
        let error = |name, schema: &[Part]| PayloadType::free(name, 1, schema.to_vec()).unwrap_err().to_string();
        assert!(error("free/Twice", &[SCHEMA[0], SCHEMA[0]]).contains("twice"));
        assert!(error("any", SCHEMA).contains("\"any\" is no name of a payload"));
        assert!(error("free/A@1", SCHEMA).contains("geometry/Cloud is expected"));
    }

    #[test]
    fn a_registry_takes_a_type_once_and_refuses_another_of_its_name() {
        let of = |version, schema: &[Part]| PayloadType::free("free/Known", version, schema.to_vec()).unwrap();
        let mut registry = Registry::default();
        let ty = of(1, SCHEMA);
        assert_eq!(registry.add_payload_type(ty), Ok(ty));
        assert_eq!(registry.add_payload_type(of(1, SCHEMA)), Ok(ty));
        assert_eq!(registry.payload_type("free/Known"), Some(ty));
        let refused = |registry: &mut Registry, ty| registry.add_payload_type(ty).unwrap_err().to_string();
        assert_eq!(
            refused(&mut registry, of(2, SCHEMA)),
            "payload free/Known is known with version 1 and comes with version 2; build both against one of them"
        );
        let mut narrow = SCHEMA.to_vec();
        narrow[2] = Part::column("points", ColumnType::F32, 2).unit("mm");
        assert_eq!(
            refused(&mut registry, of(1, &narrow)),
            "payload free/Known@1 is known with column \"points\" of 2 x f64 in mm and comes with column \"points\" of \
             2 x f32 in mm; raise the version where a view changes"
        );
        assert_eq!(
            refused(&mut registry, of(1, &SCHEMA[..3])),
            "payload free/Known@1 is known with column \"hits\" of 1 x u8 and comes with nothing there; raise the \
             version where a view changes"
        );
    }
}
