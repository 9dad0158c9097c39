//! Parts of a scan that lie inside the bone's surface. A robust fit leaves them out, so its residuals do not show them.

use super::Residual;
use osteoflow_verdict::{Answer, Reason};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Edge of a patch, mm.
const PATCH_MM: f64 = 4.0;

/// Patches with fewer points are left out.
const MIN_POINTS: usize = 5;

/// Share of a patch's points that are inside, where the patch is: outliers of a sensor lie on both sides.
const COHERENT: f64 = 0.8;

/// A point farther aside of its target point than this and than its depth is past the surface's border, mm.
const BORDER_MM: f64 = 1.0;

/// The patches inside the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Inside {
    /// Share of the scan in them.
    pub share: f64,
    /// Median depth of their points, mm; zero without any.
    pub depth_mm: f64,
}

impl Inside {
    /// Patches of `near`, of `n` points in all, of which four in five are deeper than `limit_mm`.
    pub(super) fn new(near: &[Residual], n: usize, limit_mm: f64) -> Self {
        let mut patches: BTreeMap<[i64; 3], (usize, Vec<f64>)> = BTreeMap::new();
        for near in near.iter().filter(|near| near.aside_mm <= BORDER_MM.max(near.signed_mm.abs())) {
            let key = std::array::from_fn(|k| (near.point[k] / PATCH_MM).floor() as i64);
            let (n, depths) = patches.entry(key).or_default();
            *n += 1;
            depths.extend(Some(-near.signed_mm).filter(|depth| *depth > limit_mm));
        }
        let is_inside =
            |(n, depths): &(usize, Vec<f64>)| *n >= MIN_POINTS && depths.len() as f64 >= COHERENT * *n as f64;
        let mut depths: Vec<f64> = patches.into_values().filter(is_inside).flat_map(|(_, depths)| depths).collect();
        depths.sort_by(f64::total_cmp);
        let depth_mm = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
        Self { share: depths.len() as f64 / n.max(1) as f64, depth_mm }
    }
}

/// The reason against a scan of which patches lie inside the bone.
pub(super) fn inside_reason(inside: &Inside, noise_mm: f64, max_share: f64) -> Option<Reason> {
    let Inside { share, depth_mm } = *inside;
    (share > max_share).then(|| {
        let reason = format!(
            "{:.0} % of the scan lies {depth_mm:.1} mm inside the bone's surface, in whole patches, where neither noise ({noise_mm:.2} mm) nor \
             tissue puts it; likely cause: the segmentation's threshold there, a part of the bone that has moved or is gone, or \
             another bone",
            100.0 * share
        );
        let remedy = "look where the scan lies inside the surface; check the CT's segmentation, and that CT and scan are of one bone";
        Reason::new("inside", Answer::Doubtful, reason, remedy)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    /// Points in 0.5 mm over 40 mm by 40 mm, at the depths that `of` gives.
    fn plate(of: impl Fn(usize, f64) -> (f64, f64)) -> Vec<Residual> {
        let at = |k: usize| {
            let (x, y) = ((k % 80) as f64 * 0.5, (k / 80) as f64 * 0.5);
            let (signed_mm, aside_mm) = of(k, x);
            Residual { point: Point3::new(x, y, 0.0), normal: Vector3::z(), signed_mm, aside_mm }
        };
        (0..6400).map(at).collect()
    }

    fn inside(of: impl Fn(usize, f64) -> (f64, f64)) -> Inside {
        let near = plate(of);
        Inside::new(&near, near.len(), 0.3)
    }

    #[test]
    fn whole_patches_below_the_limit_count_and_scattered_points_past_borders_and_outside_do_not() {
        assert_eq!(inside(|_, x| (if x < 16.0 { -1.0 } else { 0.0 }, 0.1)), Inside { share: 0.4, depth_mm: 1.0 });
        let none = Inside { share: 0.0, depth_mm: 0.0 };
        assert_eq!(inside(|_, x| (if x < 16.0 { 1.0 } else { 0.0 }, 0.1)), none, "tissue");
        assert_eq!(inside(|k, _| (if k % 2 == 0 { -1.0 } else { 0.0 }, 0.1)), none, "half of each patch");
        assert_eq!(inside(|_, x| (if x < 16.0 { -1.0 } else { 0.0 }, 4.0)), none, "4 mm past a border");
        assert_eq!(inside(|_, x| (if x < 16.0 { -0.3 } else { 0.0 }, 0.1)), none, "at the limit");
        assert_eq!(Inside::new(&[], 0, 0.3), none);
    }
}
