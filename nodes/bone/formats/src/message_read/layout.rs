use super::fault::MessageError;
use crate::scalar::Scalar;
use foxglove::messages::{PointCloud, packed_element_field::NumericType};
use osteoflow_geometry::time_column;

/// A number within a point.
#[derive(Clone, Copy)]
pub(super) struct Field {
    offset: usize,
    scalar: Scalar,
    big_endian: bool,
}

impl Field {
    /// The number in a point.
    pub(super) fn value(self, point: &[u8]) -> f64 {
        self.scalar.first(&point[self.offset..], self.big_endian).expect("a field is within its point")
    }
}

/// The offsets of the numbers of a point, checked to be within it.
pub(super) struct Layout {
    pub(super) stride: usize,
    pub(super) n_points: usize,
    pub(super) position: [Field; 3],
    pub(super) normal: Option<[Field; 3]>,
    /// The times of points, with their name.
    pub(super) time: Option<(String, Field)>,
}

impl Layout {
    /// Finds the fields of a message by name.
    pub(super) fn of(raw: &PointCloud, big_endian: bool) -> Result<Self, MessageError> {
        let stride = raw.point_stride;
        let [x, y, z] = ["x", "y", "z"].map(|name| Self::field(raw, name, big_endian));
        let position = [Self::needed(raw, "x", x?)?, Self::needed(raw, "y", y?)?, Self::needed(raw, "z", z?)?];
        let normal = [["normal_x", "normal_y", "normal_z"], ["nx", "ny", "nz"]].into_iter().find_map(|names| {
            // Normals are optional: if they are incomplete or of an unknown type, the cloud has none.
            let [x, y, z] = names.map(|name| Self::field(raw, name, big_endian).ok().flatten());
            Some([x?, y?, z?])
        });
        let time =
            raw.fields.iter().find(|field| time_column(&field.name).is_some()).and_then(|field| {
                Some((field.name.clone(), Self::field(raw, &field.name, big_endian).ok().flatten()?))
            });
        let n_bytes = raw.data.len();
        let rest = n_bytes.checked_rem(stride as usize).unwrap_or(n_bytes);
        if rest != 0 {
            return Err(MessageError(format!(
                "the data has {n_bytes} bytes, which is no whole number of points of {stride} bytes: {rest} remain; was the \
                 message cut short?"
            )));
        }
        let n_points = n_bytes.checked_div(stride as usize).unwrap_or(0);
        Ok(Self { stride: stride as usize, n_points, position, normal, time })
    }

    /// The first field of that name.
    fn field(raw: &PointCloud, name: &str, big_endian: bool) -> Result<Option<Field>, MessageError> {
        let Some(field) = raw.fields.iter().find(|f| f.name == name) else { return Ok(None) };
        let scalar = match NumericType::try_from(field.r#type).unwrap_or(NumericType::Unknown) {
            NumericType::Uint8 => Scalar::U8,
            NumericType::Int8 => Scalar::I8,
            NumericType::Uint16 => Scalar::U16,
            NumericType::Int16 => Scalar::I16,
            NumericType::Uint32 => Scalar::U32,
            NumericType::Int32 => Scalar::I32,
            NumericType::Float32 => Scalar::F32,
            NumericType::Float64 => Scalar::F64,
            NumericType::Unknown => {
                let code = field.r#type;
                return Err(MessageError(format!(
                    "field \"{name}\" has numeric type {code}, but 1 (uint8) to 8 (float64) are known"
                )));
            }
        };
        let end = u64::from(field.offset) + scalar.n_bytes() as u64;
        if end > raw.point_stride.into() {
            let stride = raw.point_stride;
            return Err(MessageError(format!(
                "field \"{name}\" ends at byte {end} of a point, but a point has {stride} bytes (point_stride)"
            )));
        }
        Ok(Some(Field { offset: field.offset as usize, scalar, big_endian }))
    }

    fn needed(raw: &PointCloud, missing: &str, field: Option<Field>) -> Result<Field, MessageError> {
        field.ok_or_else(|| {
            let names: Vec<&str> = raw.fields.iter().map(|f| f.name.as_str()).collect();
            let list = if names.is_empty() { "none".into() } else { names.join(", ") };
            MessageError(format!("the points have no field \"{missing}\"; there are: {list}"))
        })
    }
}
