//! Connected regions of a volume, as runs of voxels along x.

use crate::union_find::UnionFind;
use rayon::prelude::*;

/// Voxels `from..to` of a row along x; `row` is `z * ny + y`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    pub(super) row: u32,
    pub(super) from: u32,
    pub(super) to: u32,
}

/// Which voxels are neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Neighbours {
    /// Those that share a face.
    Six,
    /// Those that share a face, an edge or a corner.
    TwentySix,
}

/// A connected region.
#[derive(Debug, Clone)]
pub(super) struct Region {
    pub(super) n_voxels: u64,
    /// Its lowest and highest index along each axis, both inclusive.
    pub(super) low: [usize; 3],
    pub(super) high: [usize; 3],
    /// Sums of the indices along each axis.
    pub(super) sums: [f64; 3],
}

/// All regions of the voxels that `inside` takes.
pub(super) struct Regions {
    pub(super) runs: Vec<Run>,
    /// The region of each run.
    pub(super) labels: Vec<u32>,
    pub(super) regions: Vec<Region>,
}

/// The regions of a volume (`size`, x fastest), in the order of their first voxels; `None` if there are more runs than can
/// be numbered. `O(voxels)`.
pub(super) fn regions(
    voxels: &[f32],
    [nx, ny, nz]: [usize; 3],
    neighbours: Neighbours,
    inside: impl Fn(f32) -> bool + Sync,
) -> Option<Regions> {
    let layers: Vec<Vec<Run>> = voxels
        .par_chunks(nx * ny)
        .enumerate()
        .map(|(z, layer)| {
            let mut runs = Vec::new();
            for (y, row) in layer.chunks_exact(nx).enumerate() {
                let mut x = 0;
                while let Some(skipped) = row[x..].iter().position(|v| inside(*v)) {
                    let from = x + skipped;
                    x = row[from..].iter().position(|v| !inside(*v)).map_or(nx, |n| from + n);
                    runs.push(Run { row: (z * ny + y) as u32, from: from as u32, to: x as u32 });
                }
            }
            runs
        })
        .collect();
    let n_runs: usize = layers.iter().map(Vec::len).sum();
    if n_runs > i32::MAX as usize {
        return None;
    }
    let runs: Vec<Run> = layers.into_iter().flatten().collect();

    // Runs of row r are first[r]..first[r + 1].
    let mut first = vec![0u32; ny * nz + 1];
    runs.iter().for_each(|run| first[run.row as usize + 1] += 1);
    (0..ny * nz).for_each(|r| first[r + 1] += first[r]);
    let mut sets = UnionFind::new(n_runs);
    // Runs that meet at a corner overlap once one of them is longer by one on both sides.
    let reach = u32::from(neighbours == Neighbours::TwentySix);
    let mut join_rows = |a: usize, b: usize| {
        let (mut i, mut j) = (first[a], first[b]);
        while i < first[a + 1] && j < first[b + 1] {
            let (one, other) = (runs[i as usize], runs[j as usize]);
            if one.from < other.to + reach && other.from < one.to + reach {
                sets.join(i, j, false);
            }
            if one.to < other.to { i += 1 } else { j += 1 }
        }
    };
    for z in 0..nz {
        for y in 0..ny {
            let row = z * ny + y;
            if y > 0 {
                join_rows(row, row - 1);
            }
            if z > 0 {
                join_rows(row, row - ny);
                if neighbours == Neighbours::TwentySix {
                    if y > 0 {
                        join_rows(row, row - ny - 1);
                    }
                    if y + 1 < ny {
                        join_rows(row, row - ny + 1);
                    }
                }
            }
        }
    }
    let (labels, n_regions) = sets.labels();
    let labels: Vec<u32> = labels.into_iter().map(|(label, _)| label).collect();
    let empty = Region { n_voxels: 0, low: [usize::MAX; 3], high: [0; 3], sums: [0.0; 3] };
    let mut regions = vec![empty; n_regions];
    for (run, label) in runs.iter().zip(&labels) {
        let region = &mut regions[*label as usize];
        let (y, z) = (run.row as usize % ny, run.row as usize / ny);
        let n = u64::from(run.to - run.from);
        region.n_voxels += n;
        region.low = min(region.low, [run.from as usize, y, z]);
        region.high = max(region.high, [run.to as usize - 1, y, z]);
        let middle = [f64::from(run.from + run.to - 1) / 2.0, y as f64, z as f64];
        region.sums = std::array::from_fn(|k| region.sums[k] + n as f64 * middle[k]);
    }
    Some(Regions { runs, labels, regions })
}

fn min(a: [usize; 3], b: [usize; 3]) -> [usize; 3] {
    std::array::from_fn(|k| a[k].min(b[k]))
}

fn max(a: [usize; 3], b: [usize; 3]) -> [usize; 3] {
    std::array::from_fn(|k| a[k].max(b[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Regions by flooding, voxel by voxel.
    fn flooded(voxels: &[f32], [nx, ny, nz]: [usize; 3], neighbours: Neighbours) -> Vec<u64> {
        let mut seen = vec![false; voxels.len()];
        let mut sizes = Vec::new();
        for start in 0..voxels.len() {
            if seen[start] || voxels[start] <= 0.5 {
                continue;
            }
            let (mut stack, mut n) = (vec![start], 0);
            seen[start] = true;
            while let Some(at) = stack.pop() {
                n += 1;
                let here = [at % nx, at / nx % ny, at / nx / ny];
                for step in 0..27usize {
                    let step = [step % 3, step / 3 % 3, step / 9];
                    let n_moved = step.iter().filter(|s| **s != 1).count();
                    if n_moved == 0 || n_moved > 1 && neighbours == Neighbours::Six {
                        continue;
                    }
                    let there: [usize; 3] = std::array::from_fn(|k| (here[k] + step[k]).wrapping_sub(1));
                    if there[0] < nx && there[1] < ny && there[2] < nz {
                        let index = (there[2] * ny + there[1]) * nx + there[0];
                        if !seen[index] && voxels[index] > 0.5 {
                            seen[index] = true;
                            stack.push(index);
                        }
                    }
                }
            }
            sizes.push(n);
        }
        sizes
    }

    #[test]
    fn regions_are_those_that_flooding_finds() {
        let size = [9, 7, 8];
        for (seed, share) in [(1, 0.1), (2, 0.25), (3, 0.4), (4, 0.6)] {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let voxels: Vec<f32> = (0..9 * 7 * 8).map(|_| f32::from(u8::from(rng.random::<f64>() < share))).collect();
            for neighbours in [Neighbours::Six, Neighbours::TwentySix] {
                let parts = regions(&voxels, size, neighbours, |v| v > 0.5).unwrap();
                let sizes: Vec<u64> = parts.regions.iter().map(|r| r.n_voxels).collect();
                assert_eq!(sizes, flooded(&voxels, size, neighbours), "{neighbours:?}, share {share}");
            }
        }
    }
}
