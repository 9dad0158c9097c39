use super::{Cached, Correspondence, Pairing};
use nalgebra::Vector3;

/// The nearest samples, from a list of those near each source point, which is valid until the source point has moved so far
/// that a sample outside the list could be nearer.
///
/// The pairs of [`Cached`], which keeps one sample for each point. Lists are faster for hundreds of short steps, `Cached` for
/// a dozen long ones.
///
/// Source: Greenspan and Godin 2001.
pub(in crate::icp) struct NeighbourLists<'a>(pub(in crate::icp) Cached<'a>);

impl Pairing for NeighbourLists<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        let surface = self.0.0;
        let mut limit_mm = radius_mm;
        if let Some(neighbours) = &correspondence.neighbours {
            let clearance_mm = neighbours.free_mm - (source - correspondence.searched_at).norm();
            match surface.index.cells().nearest_kept(neighbours, source) {
                Some((index, place, square)) if square.sqrt() < clearance_mm => {
                    if square.sqrt() > radius_mm {
                        correspondence.clear();
                    } else if index != correspondence.index {
                        correspondence.set_sample(surface, Some((index, Some(place))));
                    }
                    return;
                }
                // A little more, so that rounding does not lose it.
                Some((.., square)) => limit_mm = limit_mm.min(square.sqrt() * (1.0 + 1e-12)),
                None if radius_mm < clearance_mm => return correspondence.clear(),
                None => {}
            }
        } else if correspondence.is_some() {
            limit_mm = limit_mm.min((source - correspondence.target).norm() * (1.0 + 1e-12));
        }
        let Some(neighbours) = surface.around(source, limit_mm) else {
            correspondence.neighbours = None;
            return self.0.find(source, radius_mm, correspondence);
        };
        // The list has its own clearance.
        (correspondence.searched_at, correspondence.clearance_mm) = (*source, f64::NEG_INFINITY);
        let nearest = surface.index.cells().nearest_kept(&neighbours, source);
        let nearest = nearest.filter(|(.., square)| *square <= limit_mm * limit_mm);
        correspondence.set_sample(surface, nearest.map(|(index, place, _)| (index, Some(place))));
        match &mut correspondence.neighbours {
            Some(earlier) => **earlier = neighbours,
            None => correspondence.neighbours = Some(Box::new(neighbours)),
        }
    }
}
