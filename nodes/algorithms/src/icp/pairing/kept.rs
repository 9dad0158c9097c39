use super::{Cached, Known, Pairing};
use nalgebra::Vector3;

/// The nearest samples, for a source that comes near by many short steps: a partner is the nearest of the few samples that
/// were found around a source point, as long as it has not moved so far that another could be nearer.
///
/// The pairs of [`Cached`], which keeps one sample and is faster for a source that is there after a dozen steps.
///
/// Source: Greenspan and Godin 2001.
pub(in crate::icp) struct Kept<'a>(pub(in crate::icp) Cached<'a>);

impl Pairing for Kept<'_> {
    #[inline]
    fn find(&self, moved: &Vector3<f64>, reach_mm: f64, known: &mut Known) {
        let surface = self.0.0;
        let mut limit_mm = reach_mm;
        if let Some(around) = &known.around {
            let room_mm = around.free_mm - (moved - known.at).norm();
            match surface.index.cells().nearest_kept(around, moved) {
                Some((item, place, square)) if square.sqrt() < room_mm => {
                    if square.sqrt() > reach_mm {
                        known.clear();
                    } else if item != known.item {
                        known.take(surface, Some((item, Some(place))));
                    }
                    return;
                }
                // A little more, so that rounding does not lose it.
                Some((.., square)) => limit_mm = limit_mm.min(square.sqrt() * (1.0 + 1e-12)),
                None if reach_mm < room_mm => return known.clear(),
                None => {}
            }
        } else if known.is_some() {
            limit_mm = limit_mm.min((moved - known.target).norm() * (1.0 + 1e-12));
        }
        let Some(around) = surface.around(moved, limit_mm) else {
            known.around = None;
            return self.0.find(moved, reach_mm, known);
        };
        // What is known around here is more than how far the partner is alone.
        (known.at, known.free_mm) = (*moved, f64::NEG_INFINITY);
        let nearest = surface.index.cells().nearest_kept(&around, moved);
        let nearest = nearest.filter(|(.., square)| *square <= limit_mm * limit_mm);
        known.take(surface, nearest.map(|(item, place, _)| (item, Some(place))));
        match &mut known.around {
            Some(earlier) => **earlier = around,
            None => known.around = Some(Box::new(around)),
        }
    }
}
