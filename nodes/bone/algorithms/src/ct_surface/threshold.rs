//! A threshold to begin with.

use super::VolumeView;
use rayon::prelude::*;

/// Voxels between these values take part, HU: no air, no metal.
const TISSUE_HU: [f32; 2] = [-200.0, 3000.0];
/// Soft tissue is below, bone above, HU: where the search starts.
const START_HU: f64 = 300.0;
/// Number of bins of the histogram.
const N_BINS: usize = 4096;
/// Fewer voxels than this on a side are no class.
const MIN_VOXELS: u64 = 50;

/// A threshold half-way between soft tissue and bone, where blur moves a flat wall least; `None` if one of the two is
/// missing. A suggestion to look at, not a measurement.
///
/// With `is_hu` the classes are voxels of -200 to 3000 HU below and above 300 HU at first; otherwise all voxels below and
/// above their mean. `O(voxels)`.
///
/// # Source
/// Ridler and Calvard 1978: the threshold is moved to the middle of the two classes' means until it stays.
pub fn suggested_threshold(volume: &VolumeView<'_>, is_hu: bool) -> Option<f64> {
    let range = if is_hu { TISSUE_HU } else { extremes(volume.voxels) };
    let [low, high] = range.map(f64::from);
    let width = (high - low) / N_BINS as f64;
    if !(width > 0.0 && width.is_finite()) {
        return None;
    }
    let histogram = volume
        .voxels
        .par_chunks(1 << 18)
        .map(|chunk| {
            let mut bins = vec![0u64; N_BINS];
            for v in chunk.iter().filter(|v| (range[0]..=range[1]).contains(*v)) {
                bins[(((f64::from(*v) - low) / width) as usize).min(N_BINS - 1)] += 1;
            }
            bins
        })
        .reduce(|| vec![0; N_BINS], |a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect());
    let centre = |bin: usize| low + (bin as f64 + 0.5) * width;
    let class = |from: usize, to: usize| {
        let n: u64 = histogram[from..to].iter().sum();
        let sum: f64 = (from..to).map(|bin| histogram[bin] as f64 * centre(bin)).sum();
        (n >= MIN_VOXELS).then(|| sum / n as f64)
    };
    let mut threshold = if is_hu { START_HU } else { class(0, N_BINS)? };
    for _ in 0..100 {
        let bin = (((threshold - low) / width) as usize).clamp(1, N_BINS - 1);
        let next = (class(0, bin)? + class(bin, N_BINS)?) / 2.0;
        if (next - threshold).abs() < width {
            return Some(next);
        }
        threshold = next;
    }
    Some(threshold)
}

/// The lowest and the highest value.
fn extremes(voxels: &[f32]) -> [f32; 2] {
    let of = |chunk: &[f32]| chunk.iter().fold([f32::MAX, f32::MIN], |[a, b], v| [a.min(*v), b.max(*v)]);
    voxels.par_chunks(1 << 18).map(of).reduce(|| [f32::MAX, f32::MIN], |a, b| [a[0].min(b[0]), a[1].max(b[1])])
}
