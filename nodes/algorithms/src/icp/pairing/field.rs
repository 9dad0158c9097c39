use super::{Known, Pairing};
use crate::field::{ClosestPointField, FieldView};
use crate::icp::surface::Surface;
use nalgebra::Vector3;

/// The closest point of the surface as a field of it says, where that faces the camera.
pub(in crate::icp) struct Field<'a> {
    surface: &'a Surface<'a>,
    field: FieldView<'a>,
    /// From the field's centre to that of the index.
    shift: Vector3<f64>,
}

impl<'a> Field<'a> {
    pub(in crate::icp) fn new(surface: &'a Surface<'a>, field: &'a ClosestPointField) -> Self {
        Self { surface, field: field.view(), shift: surface.index.centre - field.centre() }
    }
}

impl Pairing for Field<'_> {
    #[inline]
    fn find(&self, moved: &Vector3<f64>, reach_mm: f64, known: &mut Known) {
        match self.field.at_local(&(moved + self.shift)) {
            Some(found) if found.distance_mm.abs() <= reach_mm && self.surface.faces(moved, &found.normal) => {
                known.set(0, moved - found.normal * found.distance_mm, found.normal);
            }
            _ => known.clear(),
        }
    }
}
