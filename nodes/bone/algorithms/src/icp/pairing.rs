//! Correspondence search: one file for each method.

mod cached;
mod mesh;
mod neighbour_lists;
mod tree;

pub(super) use cached::{Cached, Thinned};
pub(super) use mesh::Mesh;
pub(super) use neighbour_lists::NeighbourLists;
pub(super) use tree::Tree;

use super::visible_surface::VisibleSurface;
use crate::point_grid::{Around, Nearby};
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

    /// Whether and how far to search, mm: not if the sample, or that there is none, is known from the last search.
    #[inline]
    fn search_limit_mm(&mut self, source: &Vector3<f64>, radius_mm: f64) -> Option<f64> {
        let clearance_mm = self.clearance_mm - (source - self.searched_at).norm();
        if !self.is_some() {
            return (radius_mm >= clearance_mm).then_some(radius_mm);
        }
        let distance_mm = (source - self.target).norm();
        if distance_mm >= clearance_mm {
            // A little more, so that rounding does not lose the paired sample.
            return Some(radius_mm.min(distance_mm * (1.0 + 1e-12)));
        }
        if distance_mm > radius_mm {
            self.clear();
            self.clearance_mm = f64::NEG_INFINITY;
        }
        None
    }

    /// Sets the sample that a search at `source` found.
    #[inline]
    fn set_found(&mut self, surface: &VisibleSurface<'_>, source: &Vector3<f64>, found: &Nearby) {
        (self.searched_at, self.clearance_mm) = (*source, found.free_square.sqrt());
        self.set_sample(surface, found.nearest.map(|(item, _)| (item, found.at)));
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

    /// [`find`](Self::find) for each of these source points.
    fn find_all(&self, sources: &[Vector3<f64>], radius_mm: f64, correspondences: &mut [Correspondence]) {
        for (source, correspondence) in sources.iter().zip(correspondences) {
            self.find(source, radius_mm, correspondence);
        }
    }
}
