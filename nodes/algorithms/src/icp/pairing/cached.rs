use super::{Known, Pairing};
use crate::icp::surface::Surface;
use nalgebra::Vector3;

/// The nearest samples; a partner is kept while the source point has not moved so far that another could be nearer.
///
/// Exact: where the point was found, no other sample lies within a known radius; while the partner is nearer than that
/// radius less the way gone since, it is the nearest. Else the search begins from the old partner's distance.
///
/// Source: Greenspan and Godin 2001.
pub(in crate::icp) struct Cached<'a>(pub(in crate::icp) &'a Surface<'a>);

impl Pairing for Cached<'_> {
    #[inline]
    fn find(&self, moved: &Vector3<f64>, reach_mm: f64, known: &mut Known) {
        let room_mm = known.free_mm - (moved - known.at).norm();
        let mut limit_mm = reach_mm;
        if known.is_some() {
            let distance_mm = (moved - known.target).norm();
            if distance_mm < room_mm {
                if distance_mm > reach_mm {
                    known.clear();
                    known.free_mm = f64::NEG_INFINITY;
                }
                return;
            }
            // A little more, so that rounding does not lose the old partner.
            limit_mm = limit_mm.min(distance_mm * (1.0 + 1e-12));
        } else if reach_mm < room_mm {
            return;
        }
        let found = self.0.nearest(moved, limit_mm);
        known.at = *moved;
        known.free_mm = found.free_square.sqrt();
        known.take(self.0, found.nearest.map(|(item, _)| (item, found.at)));
    }
}
