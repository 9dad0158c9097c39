//! Partners for source points: one file for each way of finding them.

mod cached;
mod field;
mod kept;
mod mesh;
mod tree;

pub(super) use cached::Cached;
pub(super) use field::Field;
pub(super) use kept::Kept;
pub(super) use mesh::Mesh;
pub(super) use tree::{Thinned, Tree};

use super::surface::Surface;
use crate::cells::Around;
use nalgebra::Vector3;

/// No partner is known.
const NONE: u32 = u32::MAX;

/// The partner of a source point, and how long it surely stays that. About the centre of the target's index, mm.
#[derive(Debug, Clone)]
pub(super) struct Known {
    /// Where it is.
    pub(super) target: Vector3<f64>,
    /// Its unit normal; zero where unknown.
    pub(super) normal: Vector3<f64>,
    /// Its index, or `NONE`.
    item: u32,
    /// Where the source point was when it was found.
    at: Vector3<f64>,
    /// No other partner lies closer than this to that place.
    free_mm: f64,
    /// What could be the partner near that place, where it is sought for many steps.
    around: Option<Box<Around>>,
}

impl Known {
    pub(super) const NOTHING: Self = Self {
        target: Vector3::new(0.0, 0.0, 0.0),
        normal: Vector3::new(0.0, 0.0, 0.0),
        item: NONE,
        at: Vector3::new(0.0, 0.0, 0.0),
        free_mm: f64::NEG_INFINITY,
        around: None,
    };

    /// Whether there is a partner.
    #[inline]
    pub(super) fn is_some(&self) -> bool {
        self.item != NONE
    }

    #[inline]
    fn set(&mut self, item: u32, target: Vector3<f64>, normal: Vector3<f64>) {
        (self.item, self.target, self.normal) = (item, target, normal);
    }

    #[inline]
    fn clear(&mut self) {
        self.item = NONE;
    }

    /// Makes a sample the partner, by its index and, where known, its place in the cells; or none.
    #[inline]
    fn take(&mut self, surface: &Surface<'_>, found: Option<(u32, Option<u32>)>) {
        match found {
            Some((item, place)) => {
                let (target, normal) = surface.point_and_normal(item, place);
                self.set(item, target, normal);
            }
            None => self.clear(),
        }
    }
}

/// A way of finding partners.
pub(super) trait Pairing: Sync {
    /// Makes `known` the partner of a source point at `moved`, if there is one within `reach_mm`.
    ///
    /// `known` is what the last call for this source point left.
    fn find(&self, moved: &Vector3<f64>, reach_mm: f64, known: &mut Known);
}
