use super::{Correspondence, Pairing};
use crate::icp::visible_surface::VisibleSurface;
use nalgebra::Vector3;

/// The nearest samples, searched at every step in a kd-tree.
pub(in crate::icp) struct Tree<'a>(pub(in crate::icp) &'a VisibleSurface<'a>);

impl Pairing for Tree<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        let nearest = self.0.nearest_by_tree(source).filter(|(_, square)| *square <= radius_mm * radius_mm);
        match nearest {
            Some((item, _)) => {
                correspondence.set(item as u32, self.0.index.local(item), self.0.normals[item]);
            }
            None => correspondence.clear(),
        }
    }
}
