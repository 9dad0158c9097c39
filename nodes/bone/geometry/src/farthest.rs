//! How large a coordinate from outside may be.

use nalgebra::Point3;

/// Largest coordinate that is taken for one, mm: 10 km.
///
/// Patients, trackers and scanners span metres; a coordinate beyond 10 km is of another unit, or bytes that are no coordinate.
/// Up to here double precision resolves 2e-9 mm and squares of distances are far from overflowing, so that every algorithm
/// may take a finite coordinate for a usable one.
pub const FARTHEST_MM: f64 = 1e7;

/// A coordinate beyond [`FARTHEST_MM`], or one that is not finite.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the coordinate {value_mm:?} mm is farther than {FARTHEST_MM:e} mm (10 km) from the origin; is its unit another, or are the \
     numbers damaged?"
)]
pub struct TooFar {
    /// The coordinate.
    pub value_mm: f64,
}

impl TooFar {
    /// Checks coordinates in mm.
    ///
    /// # Errors
    /// [`TooFar`] with the first that is beyond [`FARTHEST_MM`] or not finite.
    pub fn check(coordinates_mm: &[f64]) -> Result<(), Self> {
        let far = coordinates_mm.iter().find(|c| !is_near(**c));
        far.map_or(Ok(()), |&value_mm| Err(Self { value_mm }))
    }

    /// The index of the first point that is beyond [`FARTHEST_MM`] or not finite, with the coordinate. `O(n)`.
    pub fn first(points: &[Point3<f64>]) -> Option<(usize, Self)> {
        let index = first_not(points, |p| is_near(p.x) & is_near(p.y) & is_near(p.z))?;
        Self::check(points[index].coords.as_slice()).err().map(|far| (index, far))
    }
}

/// Whether a coordinate is finite and no farther than [`FARTHEST_MM`].
fn is_near(coordinate_mm: f64) -> bool {
    coordinate_mm.abs() <= FARTHEST_MM
}

/// The index of the first item for which `is_fine` does not hold. Looked for by blocks, which a compiler checks without branches.
pub(crate) fn first_not<T>(items: &[T], is_fine: impl Fn(&T) -> bool) -> Option<usize> {
    const BLOCK: usize = 1024;
    let k = items.chunks(BLOCK).position(|block| !block.iter().fold(true, |fine, item| fine & is_fine(item)))?;
    let at = k * BLOCK;
    items[at..].iter().position(|item| !is_fine(item)).map(|i| at + i)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_coordinate_beyond_ten_kilometres_is_found_with_its_value() {
        assert_eq!(TooFar::check(&[FARTHEST_MM, -FARTHEST_MM, 0.0]), Ok(()));
        for far in [1.0000001e7, -1e45, f64::INFINITY] {
            assert_eq!(TooFar::check(&[0.0, far, 1e99]), Err(TooFar { value_mm: far }));
            let mut points = vec![Point3::origin(); 3000];
            points[2500].z = far;
            assert_eq!(TooFar::first(&points), Some((2500, TooFar { value_mm: far })));
        }
        assert!(TooFar::check(&[f64::NAN]).is_err(), "NaN compares as false");
        let message = TooFar { value_mm: -1e45 }.to_string();
        assert!(message.starts_with("the coordinate -1e45 mm is farther than 1e7 mm (10 km)"), "{message}");
    }
}
