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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target::Target;
    use nalgebra::Point3;
    use osteoflow_geometry::SurfaceOrigin;

    /// Steps of all lengths, to and fro, so that samples are kept and searched.
    #[test]
    fn the_pairs_of_moving_points_are_the_nearest_samples() {
        let part = |k: u32, m: u32| f64::from(k.wrapping_mul(2_654_435_761).wrapping_mul(m) >> 8) / f64::from(1 << 24);
        let points: Vec<Point3<f64>> = (0..4000)
            .map(|k| (part(k, 1) * 30.0, part(k, 7919) * 20.0))
            .map(|(x, y)| Point3::new(x, y, 0.02 * x * x + y.sin()))
            .collect();
        let normals = vec![Vector3::z(); points.len()];
        let target = Target::new("ct", SurfaceOrigin::Exact, points, Some(normals.into())).unwrap();
        target.prepare();
        let surface = VisibleSurface::new(&target, None, &[], 5.0).unwrap();
        let samples: Vec<Vector3<f64>> = (0..surface.index.len()).map(|i| surface.index.local(i)).collect();
        let mut sources: Vec<Vector3<f64>> =
            (0..200).map(|k| samples[k * 20] + Vector3::new(0.1, -0.2, 0.15) * part(k as u32, 31)).collect();
        let mut correspondences = vec![Correspondence::NONE; sources.len()];
        let mut n_searched = 0;
        for step in 0..40 {
            let radius_mm = [0.35, 3.0][step % 2];
            Cached(&surface).find_all(&sources, radius_mm, &mut correspondences);
            for (k, (source, found)) in sources.iter().zip(&correspondences).enumerate() {
                let (square, nearest) = samples
                    .iter()
                    .map(|s| ((source - s).norm_squared(), s))
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .unwrap();
                let expected = Some(nearest).filter(|_| square <= radius_mm * radius_mm);
                assert_eq!(found.is_some().then_some(&found.target), expected, "point {k} at step {step}");
                n_searched += usize::from(found.searched_at == *source);
            }
            let length_mm = [0.3, 0.03, 0.01, 0.003, 0.001][step / 2 % 5] * if step % 3 == 0 { -1.0 } else { 1.0 };
            sources.iter_mut().for_each(|s| *s += Vector3::new(0.8, 0.6, 0.1) * length_mm);
        }
        // Of 8000.
        assert!((1000..7500).contains(&n_searched), "{n_searched} searched");
    }
}
