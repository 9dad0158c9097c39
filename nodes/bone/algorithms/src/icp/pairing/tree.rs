use super::{Correspondence, Pairing};
use crate::icp::visible_surface::VisibleSurface;
use nalgebra::Vector3;

/// The nearest samples, searched at every step in a kd-tree.
pub(in crate::icp) struct Tree<'a>(pub(in crate::icp) &'a VisibleSurface<'a>);

impl Pairing for Tree<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        let found = self.0.nearest_by_tree(source);
        set(self.0, found, radius_mm, correspondence);
    }
}

/// The nearest samples of a thinned target, for the first level.
pub(in crate::icp) struct Thinned<'a>(pub(in crate::icp) &'a VisibleSurface<'a>);

impl Pairing for Thinned<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        set(self.0, self.0.nearest_thinned(source), radius_mm, correspondence);
    }
}

fn set(surface: &VisibleSurface<'_>, found: Option<(usize, f64)>, radius_mm: f64, correspondence: &mut Correspondence) {
    match found.filter(|(_, square)| *square <= radius_mm * radius_mm) {
        Some((item, _)) => correspondence.set(item as u32, surface.index.local(item), surface.normals[item]),
        None => correspondence.clear(),
    }
}
