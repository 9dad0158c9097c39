//! Payload types defined at run time, by a plugin or a recording.

use crate::{Field, PayloadType, SchemaEntry, SchemaError, Value, View, intern::intern, view::json::to_json};
use std::{
    any::{Any, TypeId},
    sync::{Arc, Mutex, PoisonError},
};

/// A payload of a type that the program knows only by its schema; holds its view.
#[derive(Debug, Clone, PartialEq)]
pub struct DynamicPayload(View);

impl DynamicPayload {
    /// The view, which matches the schema of the type.
    pub fn view(&self) -> &View {
        &self.0
    }

    /// `O(n)` in the number of fields and columns, not in rows.
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

/// All types made so far, one for each name, version and schema.
static TYPES: Mutex<Vec<&'static PayloadType>> = Mutex::new(Vec::new());
impl PayloadType {
    /// A payload type with this name, version and schema; its values are [`DynamicPayload`]s.
    ///
    /// It lives until the program ends. Equal arguments give the same type.
    ///
    /// # Errors
    /// [`SchemaError`] if the schema or the name is invalid.
    pub fn dynamic(name: &str, version: u32, schema: Vec<SchemaEntry>) -> Result<&'static Self, SchemaError> {
        if name.is_empty() || name == "any" || name.contains(|c: char| c.is_control() || c == '@') {
            let wrong = "is not a valid payload name; expected one such as geometry/Cloud";
            return Err(SchemaError(format!("\"{}\" {wrong}", name.escape_debug())));
        }
        SchemaEntry::check_all(&schema)?;
        let mut types = TYPES.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |ty: &&&Self| (ty.name, ty.version, ty.schema) == (name, version, &*schema);
        if let Some(ty) = types.iter().find(same) {
            return Ok(ty);
        }
        let ty: &'static Self = Box::leak(Box::new(Self {
            name: intern(name),
            version,
            oldest: version,
            interpolates: false,
            schema: schema.leak(),
            id: TypeId::of::<DynamicPayload>,
            to_view: |any| dynamic(any).0.clone(),
            from_view: |ty, view| {
                view.check(ty.schema)?;
                Ok(Value { inner: Arc::new(DynamicPayload(view.clone())), ty })
            },
            to_result: |any| to_json(&dynamic(any).0),
            n_bytes: |any| dynamic(any).n_bytes(),
            interpolate: |_, _, _| None,
            display: || None,
            to_display: |_, _| None,
            to_display_on: |_, _, _, _| None,
            display_centre: |_| None,
        }));
        types.push(ty);
        Ok(ty)
    }
}

fn dynamic(any: &dyn Any) -> &DynamicPayload {
    any.downcast_ref().expect("a value carries its own type")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Column, ColumnType, Registry};
    use serde_json::json;

    const SCHEMA: &[SchemaEntry] = &[
        SchemaEntry::text("label"),
        SchemaEntry::float("gain").optional(),
        SchemaEntry::column("points", ColumnType::F64, 2).unit("mm"),
        SchemaEntry::column("hits", ColumnType::U8, 1),
    ];

    fn view() -> View {
        let points: Vec<u8> = [1.0, f64::NAN, 3.0, 4.5].into_iter().flat_map(f64::to_ne_bytes).collect();
        View::new()
            .with("label", "a")
            .with_column(Column::new("points", ColumnType::F64, 2, Arc::new(points)))
            .with_column(Column::new("hits", ColumnType::U8, 1, Arc::new(vec![7_u8, 255])))
    }

    #[test]
    fn a_view_of_a_dynamic_type_round_trips_and_shares_its_columns() {
        let ty = PayloadType::dynamic("dynamic/Shared", 1, SCHEMA.to_vec()).unwrap();
        let view = view();
        let value = ty.from_view(&view).unwrap();
        assert_eq!((value.ty(), value.to_view()), (ty, view.clone()));
        assert_eq!(value.to_view().columns[0].bytes().as_ptr(), view.columns[0].bytes().as_ptr());
        assert_eq!(value.get::<DynamicPayload>().unwrap().view(), &view);
        assert!(value.n_bytes() > 4 * 8 + 2, "{} bytes", value.n_bytes());
        let expected = json!({ "label": "a", "points": [[1.0, null], [3.0, 4.5]], "hits": [7, 255] });
        assert_eq!(value.to_result().to_string(), expected.to_string());
    }

    #[test]
    fn a_view_that_does_not_fit_the_schema_is_refused() {
        let ty = PayloadType::dynamic("dynamic/Refused", 1, SCHEMA.to_vec()).unwrap();
        let error = ty.from_view(&view().with("colour", "red")).unwrap_err().to_string();
        assert_eq!(error, "the view has a field \"colour\" that its payload does not have");
    }

    #[test]
    fn dynamic_types_are_equal_by_name_version_and_schema_and_made_once() {
        let of = |name, version, schema: &[SchemaEntry]| PayloadType::dynamic(name, version, schema.to_vec()).unwrap();
        let ty = of("dynamic/One", 1, SCHEMA);
        assert!(std::ptr::eq(ty, of("dynamic/One", 1, SCHEMA)));
        assert_ne!(ty, of("dynamic/Two", 1, SCHEMA));
        assert_ne!(ty, of("dynamic/One", 2, SCHEMA));
        assert_ne!(ty, of("dynamic/One", 1, &SCHEMA[..1]));
        let mut documented = SCHEMA.to_vec();
        documented[0] = documented[0].doc("what it is called");
        assert_eq!(ty, of("dynamic/One", 1, &documented), "docs do not make another type");
    }

    #[test]
    fn an_invalid_schema_or_name_is_refused() {
        let error =
            |name, schema: &[SchemaEntry]| PayloadType::dynamic(name, 1, schema.to_vec()).unwrap_err().to_string();
        assert!(error("dynamic/Twice", &[SCHEMA[0], SCHEMA[0]]).contains("twice"));
        assert!(error("any", SCHEMA).contains("\"any\" is not a valid payload name"));
        assert!(error("dynamic/A@1", SCHEMA).contains("such as geometry/Cloud"));
    }

    #[test]
    fn a_registry_takes_a_type_once_and_refuses_another_of_its_name() {
        let of =
            |version, schema: &[SchemaEntry]| PayloadType::dynamic("dynamic/Known", version, schema.to_vec()).unwrap();
        let mut registry = Registry::default();
        let ty = of(1, SCHEMA);
        assert_eq!(registry.add_payload_type(ty), Ok(ty));
        assert_eq!(registry.add_payload_type(of(1, SCHEMA)), Ok(ty));
        assert_eq!(registry.payload_type("dynamic/Known"), Some(ty));
        let refused = |registry: &mut Registry, ty| registry.add_payload_type(ty).unwrap_err().to_string();
        assert_eq!(
            refused(&mut registry, of(2, SCHEMA)),
            "payload dynamic/Known is known with version 1 and comes with version 2; build both against one of them"
        );
        let mut narrow = SCHEMA.to_vec();
        narrow[2] = SchemaEntry::column("points", ColumnType::F32, 2).unit("mm");
        assert_eq!(
            refused(&mut registry, of(1, &narrow)),
            "payload dynamic/Known@1 is known with column \"points\" of 2 x f64 in mm and comes with column \"points\" of \
             2 x f32 in mm; raise the version where a view changes"
        );
        assert_eq!(
            refused(&mut registry, of(1, &SCHEMA[..3])),
            "payload dynamic/Known@1 is known with column \"hits\" of 1 x u8 and comes with no entry; raise the \
             version where a view changes"
        );
    }
}
