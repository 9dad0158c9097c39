use super::{Known, Pairing};
use crate::icp::surface::Surface;
use nalgebra::Vector3;

/// The nearest samples, searched anew in a k-d tree.
pub(in crate::icp) struct Tree<'a>(pub(in crate::icp) &'a Surface<'a>);

impl Pairing for Tree<'_> {
    #[inline]
    fn find(&self, moved: &Vector3<f64>, reach_mm: f64, known: &mut Known) {
        let found = self.0.nearest_by_tree(moved);
        set(self.0, found, reach_mm, known);
    }
}

/// The nearest of a few of the samples, for a start that needs no more.
pub(in crate::icp) struct Thinned<'a>(pub(in crate::icp) &'a Surface<'a>);

impl Pairing for Thinned<'_> {
    #[inline]
    fn find(&self, moved: &Vector3<f64>, reach_mm: f64, known: &mut Known) {
        set(self.0, self.0.nearest_of_few(moved), reach_mm, known);
    }
}

fn set(surface: &Surface<'_>, found: Option<(usize, f64)>, reach_mm: f64, known: &mut Known) {
    match found.filter(|(_, square)| *square <= reach_mm * reach_mm) {
        Some((item, _)) => known.set(item as u32, surface.index.local(item), surface.normals[item]),
        None => known.clear(),
    }
}
