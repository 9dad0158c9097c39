use super::{Correspondence, Pairing};
use crate::icp::visible_surface::VisibleSurface;
use nalgebra::Vector3;

/// Number of source points searched together.
const SEARCHED_TOGETHER: usize = 64;

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
        if let Some(limit_mm) = correspondence.search_limit_mm(source, radius_mm) {
            correspondence.set_found(self.0, source, &self.0.nearest(source, limit_mm));
        }
    }

    /// First tells which to search, then searches: the processor then seldom mispredicts what comes next, and fetches the
    /// samples of one search while it is at another.
    fn find_all(&self, sources: &[Vector3<f64>], radius_mm: f64, correspondences: &mut [Correspondence]) {
        let mut to_search = [(0, 0.0); SEARCHED_TOGETHER];
        let parts = correspondences.chunks_mut(SEARCHED_TOGETHER).zip(sources.chunks(SEARCHED_TOGETHER));
        for (correspondences, sources) in parts {
            let mut n = 0;
            for (k, (correspondence, source)) in correspondences.iter_mut().zip(sources).enumerate() {
                let limit_mm = correspondence.search_limit_mm(source, radius_mm);
                to_search[n] = (k, limit_mm.unwrap_or(0.0));
                n += usize::from(limit_mm.is_some());
            }
            for &(k, limit_mm) in &to_search[..n] {
                correspondences[k].set_found(self.0, &sources[k], &self.0.nearest(&sources[k], limit_mm));
            }
        }
    }
}

/// The nearest samples of a thinned target, for the first level, kept as those of [`Cached`].
pub(in crate::icp) struct Thinned<'a>(pub(in crate::icp) &'a VisibleSurface<'a>);

impl Pairing for Thinned<'_> {
    #[inline]
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence) {
        if let Some(limit_mm) = correspondence.search_limit_mm(source, radius_mm) {
            correspondence.set_found(self.0, source, &self.0.nearest_thinned(source, limit_mm));
        }
    }
}
