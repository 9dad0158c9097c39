use super::{Correspondence, Pairing};
use crate::field::{ClosestPointField, FieldView};
use crate::icp::visible_surface::VisibleSurface;
use nalgebra::Vector3;

/// The closest points of the surface by its closest-point field, if they face the camera.
pub(in crate::icp) struct Field<'a> {
    surface: &'a VisibleSurface<'a>,
    field: FieldView<'a>,
    /// From the field's centre to that of the index, mm.
    shift: Vector3<f64>,
}

impl<'a> Field<'a> {
    pub(in crate::icp) fn new(surface: &'a VisibleSurface<'a>, field: &'a ClosestPointField) -> Self {
        Self { surface, field: field.view(), shift: surface.index.centre - field.centre() }
    }
}

impl Pairing for Field<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        match self.field.at_local(&(source + self.shift)) {
            Some(found) if found.distance_mm.abs() <= radius_mm && self.surface.is_visible(source, &found.normal) => {
                correspondence.set(0, source - found.normal * found.distance_mm, found.normal);
            }
            _ => correspondence.clear(),
        }
    }
}
