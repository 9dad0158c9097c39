//! Correspondence search: one file for each method.

mod cached;
mod mesh;
mod neighbour_lists;
mod tree;

pub(super) use cached::Cached;
pub(super) use mesh::Mesh;
pub(super) use neighbour_lists::NeighbourLists;
pub(super) use tree::{Thinned, Tree};

use super::visible_surface::VisibleSurface;
use crate::point_grid::Around;
use nalgebra::Vector3;

/// Index of no target point.
const NO_INDEX: u32 = u32::MAX;

/// The target point of a source point, and how far the source point may move before it must be searched again. About the
/// centre of the target's index, mm.
#[derive(Debug, Clone)]
pub(super) struct Correspondence {
    /// The target point.
    pub(super) target: Vector3<f64>,
    /// Its unit normal; zero where unknown.
    pub(super) normal: Vector3<f64>,
    /// Its index, or `NO_INDEX`.
    index: u32,
    /// The source point's position at the last search.
    searched_at: Vector3<f64>,
    /// Every other target point was farther than this from that position, mm.
    clearance_mm: f64,
    /// The target points near that position, if a method keeps them.
    neighbours: Option<Box<Around>>,
}

impl Correspondence {
    /// No target point, and nothing known.
    pub(super) const NONE: Self = Self {
        target: Vector3::new(0.0, 0.0, 0.0),
        normal: Vector3::new(0.0, 0.0, 0.0),
        index: NO_INDEX,
        searched_at: Vector3::new(0.0, 0.0, 0.0),
        clearance_mm: f64::NEG_INFINITY,
        neighbours: None,
    };

    /// Whether there is a target point.
    #[inline]
    pub(super) fn is_some(&self) -> bool {
        self.index != NO_INDEX
    }

    #[inline]
    fn set(&mut self, index: u32, target: Vector3<f64>, normal: Vector3<f64>) {
        (self.index, self.target, self.normal) = (index, target, normal);
    }

    #[inline]
    fn clear(&mut self) {
        self.index = NO_INDEX;
    }

    /// Sets a sample by its index and, where known, its place in the cells; clears if there is none.
    #[inline]
    fn set_sample(&mut self, surface: &VisibleSurface<'_>, sample: Option<(u32, Option<u32>)>) {
        match sample {
            Some((index, place)) => {
                let (target, normal) = surface.point_and_normal(index, place);
                self.set(index, target, normal);
            }
            None => self.clear(),
        }
    }
}

/// A method of correspondence search.
pub(super) trait Pairing: Sync {
    /// Finds the target point of a source point at `source`, if there is one within `radius_mm`.
    ///
    /// `correspondence` holds the result of the last call for this source point, and takes the new one.
    fn find(&self, source: &Vector3<f64>, radius_mm: f64, correspondence: &mut Correspondence);
}
