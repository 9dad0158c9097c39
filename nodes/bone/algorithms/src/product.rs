//! Products of matrices whose sizes are known at run time.
//!
//! nalgebra's own products of such matrices sum by `matrixmultiply`, in an order and with a rounding that depend on the processor. No crate
//! of ours calls them, which a test holds (`tests/processors.rs`).

use nalgebra::DMatrix;

/// Rows and columns of what is summed at a time, in registers.
const TILE: usize = 4;

/// `a b`, each sum in the order of its terms. `O(n³)`.
///
/// # Panics
/// If `a` has another number of columns than `b` has rows.
pub(crate) fn product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    assert_eq!(a.ncols(), b.nrows(), "the product of {:?} and {:?}", a.shape(), b.shape());
    let (left, right) = (|term, row| a[(row, term)], |term, column| b[(term, column)]);
    let c = DMatrix::zeros(a.nrows(), b.ncols());
    if a.nrows().min(b.ncols()) < TILE {
        by_tiles::<1>(c, a.ncols(), left, right, false)
    } else {
        by_tiles::<TILE>(c, a.ncols(), left, right, false)
    }
}

/// `aᵀ a`, likewise, in half of the time.
pub(crate) fn gram(a: &DMatrix<f64>) -> DMatrix<f64> {
    let of = |term, column| a[(term, column)];
    let c = DMatrix::zeros(a.ncols(), a.ncols());
    if a.ncols() < TILE {
        by_tiles::<1>(c, a.nrows(), of, of, true)
    } else {
        by_tiles::<TILE>(c, a.nrows(), of, of, true)
    }
}

/// Fills `c` with the sums over the terms of `left(term, row) * right(term, column)`.
fn by_tiles<const N: usize>(
    mut c: DMatrix<f64>,
    n_terms: usize,
    left: impl Fn(usize, usize) -> f64,
    right: impl Fn(usize, usize) -> f64,
    is_symmetric: bool,
) -> DMatrix<f64> {
    // The last tile overlaps the one before.
    let tiles = |n: usize| (0..n).step_by(N).map(move |first| first.min(n - N));
    let packed = |of: &dyn Fn(usize, usize) -> f64, first: usize| -> Vec<[f64; N]> {
        (0..n_terms).map(|term| std::array::from_fn(|k| of(term, first + k))).collect()
    };
    let rows: Vec<_> = tiles(c.nrows()).map(|first| (first, packed(&left, first))).collect();
    for column in tiles(c.ncols()) {
        let right = packed(&right, column);
        for (row, left) in rows.iter().filter(|(row, _)| !is_symmetric || *row <= column) {
            let mut sums = [[0.0; N]; N];
            for (left, right) in left.iter().zip(&right) {
                for (sums, right) in sums.iter_mut().zip(right) {
                    sums.iter_mut().zip(left).for_each(|(sum, left)| *sum += left * right);
                }
            }
            for (k, i) in (0..N).flat_map(|k| (0..N).map(move |i| (k, i))) {
                c[(row + i, column + k)] = sums[k][i];
                if is_symmetric {
                    c[(column + k, row + i)] = sums[k][i];
                }
            }
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_is_that_of_plain_loops_to_the_last_bit_in_every_size() {
        let sizes = [0, 1, 3, 4, 5, 8, 13];
        let shapes = sizes.iter().flat_map(|m| sizes.iter().flat_map(move |k| sizes.map(|n| (*m, *k, n))));
        for (m, k, n) in shapes {
            let number = |row: usize, column: usize| (1.0 + row as f64 * 0.7 - column as f64 * 1.3).recip();
            let (a, b) = (DMatrix::from_fn(m, k, number), DMatrix::from_fn(k, n, |i, j| number(j, i + 1)));
            let plain = DMatrix::from_fn(m, n, |i, j| (0..k).fold(0.0, |sum, l| sum + a[(i, l)] * b[(l, j)]));
            assert_eq!(product(&a, &b), plain, "{m} × {k} by {k} × {n}");
            assert_eq!(gram(&a), product(&a.transpose(), &a), "of {m} × {k}");
        }
    }

    #[test]
    #[should_panic(expected = "the product of (2, 3) and (2, 3)")]
    fn matrices_that_do_not_meet_are_refused() {
        product(&DMatrix::zeros(2, 3), &DMatrix::zeros(2, 3));
    }
}
