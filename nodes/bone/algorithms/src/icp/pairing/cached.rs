use super::{Correspondence, Pairing};
use crate::icp::visible_surface::VisibleSurface;
use nalgebra::Vector3;

/// The nearest samples; a pair is kept until the source point has moved so far that another sample could be nearer.
///
/// Exact: at the last search no other sample was within a known radius. As long as the paired sample is nearer than that radius
/// less the distance moved since, it is the nearest. Otherwise the search starts from its distance.
///
/// Source: Greenspan and Godin 2001.
pub(in crate::icp) struct Cached<'a>(pub(in crate::icp) &'a VisibleSurface<'a>);

impl Pairing for Cached<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        let clearance_mm = correspondence.clearance_mm - (source - correspondence.searched_at).norm();
        let mut limit_mm = radius_mm;
        if correspondence.is_some() {
            let distance_mm = (source - correspondence.target).norm();
            if distance_mm < clearance_mm {
                if distance_mm > radius_mm {
                    correspondence.clear();
                    correspondence.clearance_mm = f64::NEG_INFINITY;
                }
                return;
            }
            // A little more, so that rounding does not lose the paired sample.
            limit_mm = limit_mm.min(distance_mm * (1.0 + 1e-12));
        } else if radius_mm < clearance_mm {
            return;
        }
        let found = self.0.nearest(source, limit_mm);
        correspondence.searched_at = *source;
        correspondence.clearance_mm = found.free_square.sqrt();
        correspondence.set_sample(self.0, found.nearest.map(|(item, _)| (item, found.at)));
    }
}
