//! Where the boxes of a picture stand, from left to right.
//!
//! Layers after Sugiyama, Tagawa and Toda 1981: a node's rank is its longest path from a source; wires pass through a
//! place of their own in each rank between their ends, and their labels have a rank of their own behind the producer, so
//! that nothing stands on anything else; places are ordered within a rank by the mean of their neighbours; and their
//! heights are those nearest to their neighbours' that keep the distances, found exactly by pooling adjacent violators.

use std::collections::BTreeMap;

/// A box to be placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Size {
    pub(super) width: f64,
    pub(super) height: f64,
}

/// A box in its place: its left upper corner and its size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) size: Size,
}

impl Place {
    pub(super) fn middle(&self) -> f64 {
        self.y + self.size.height / 2.0
    }

    pub(super) fn right(&self) -> f64 {
        self.x + self.size.width
    }
}

/// An edge: what it joins, and the size of its label.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) label: Size,
}

/// Everything in its place.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) nodes: Vec<Place>,
    /// For each edge its places between its ends, from left to right; the first is its label's.
    pub(super) edges: Vec<Vec<Place>>,
    pub(super) size: Size,
}

/// Between the columns: room for the curves.
const GAP_X: f64 = 26.0;
/// Between boxes of a column.
const GAP_Y: f64 = 14.0;
/// Between wires that pass side by side.
const GAP_WIRES: f64 = 5.0;
/// The height of a wire that passes.
const PASSING: f64 = 2.0;
/// So often the order and the heights are swept to and fro.
const SWEEPS: usize = 24;

/// A box or a wire's place in a rank.
struct Spot {
    size: Size,
    is_node: bool,
    left: Vec<usize>,
    right: Vec<usize>,
}

/// Places nodes, which are in topological order, and edges, which lead from earlier nodes to later ones.
pub(super) fn layout(nodes: &[Size], edges: &[Edge]) -> Layout {
    let ranks = ranks(nodes.len(), edges);
    let mut spots: Vec<Spot> =
        nodes.iter().map(|size| Spot { size: *size, is_node: true, left: Vec::new(), right: Vec::new() }).collect();
    let n_ranks = ranks.iter().max().map_or(0, |last| last + 1);
    let mut columns: Vec<Vec<usize>> = vec![Vec::new(); n_ranks];
    for (node, rank) in ranks.iter().enumerate() {
        columns[*rank].push(node);
    }
    let mut chains = Vec::with_capacity(edges.len());
    for edge in edges {
        let mut chain = Vec::new();
        let mut before = edge.from;
        for (rank, column) in columns.iter_mut().enumerate().take(ranks[edge.to]).skip(ranks[edge.from] + 1) {
            let size = if rank == ranks[edge.from] + 1 { edge.label } else { Size { width: 0.0, height: PASSING } };
            let spot = spots.len();
            spots.push(Spot { size, is_node: false, left: Vec::new(), right: Vec::new() });
            join(&mut spots, before, spot);
            column.push(spot);
            chain.push(spot);
            before = spot;
        }
        join(&mut spots, before, edge.to);
        chains.push(chain);
    }
    order(&mut columns, &spots);
    let middles = heights(&columns, &spots);

    let mut x = 0.0;
    let mut places = vec![Place { x: 0.0, y: 0.0, size: Size { width: 0.0, height: 0.0 } }; spots.len()];
    for column in &columns {
        let width = column.iter().map(|spot| spots[*spot].size.width).fold(0.0, f64::max);
        for &spot in column {
            let Spot { size, is_node, .. } = spots[spot];
            // A wire passes the whole column level; a box stands in its middle.
            let size = if is_node { size } else { Size { width, ..size } };
            places[spot] = Place { x: x + (width - size.width) / 2.0, y: middles[spot] - size.height / 2.0, size };
        }
        x += width + GAP_X;
    }
    let top = places.iter().map(|place| place.y).fold(f64::INFINITY, f64::min);
    places.iter_mut().for_each(|place| place.y -= top);
    let height = places.iter().map(|place| place.y + place.size.height).fold(0.0, f64::max);
    Layout {
        nodes: places[..nodes.len()].to_vec(),
        edges: chains.iter().map(|chain| chain.iter().map(|spot| places[*spot]).collect()).collect(),
        size: Size { width: (x - GAP_X).max(0.0), height },
    }
}

fn join(spots: &mut [Spot], left: usize, right: usize) {
    spots[left].right.push(right);
    spots[right].left.push(left);
}

/// Even ranks for nodes, odd ones for the labels of the wires that begin before them. What nothing feeds stands close to
/// what it feeds first.
fn ranks(n_nodes: usize, edges: &[Edge]) -> Vec<usize> {
    let mut ranks = vec![0; n_nodes];
    for node in 0..n_nodes {
        let fed = edges.iter().filter(|edge| edge.from == node);
        for edge in fed {
            ranks[edge.to] = ranks[edge.to].max(ranks[node] + 2);
        }
    }
    for node in 0..n_nodes {
        if !edges.iter().any(|edge| edge.to == node) {
            let first = edges.iter().filter(|edge| edge.from == node).map(|edge| ranks[edge.to]).min();
            ranks[node] = first.map_or(0, |first| first - 2);
        }
    }
    ranks
}

/// Orders each column so that few wires cross.
fn order(columns: &mut Vec<Vec<usize>>, spots: &[Spot]) {
    let mut best = (crossings(columns, spots), columns.clone());
    for sweep in 0..SWEEPS {
        let forth = sweep % 2 == 0;
        let n = columns.len();
        for step in 1..n {
            let at = if forth { step } else { n - 1 - step };
            let beside = if forth { at - 1 } else { at + 1 };
            let places: BTreeMap<usize, usize> =
                columns[beside].iter().enumerate().map(|(i, spot)| (*spot, i)).collect();
            let mean = |spot: &usize| {
                let near = if forth { &spots[*spot].left } else { &spots[*spot].right };
                let sum: usize = near.iter().map(|other| places[other]).sum();
                (!near.is_empty()).then(|| sum as f64 / near.len() as f64)
            };
            // What has no neighbour there keeps its place among the others.
            let means: Vec<_> = columns[at].iter().map(mean).collect();
            let mut sorted: Vec<(f64, usize)> =
                columns[at].iter().zip(&means).filter_map(|(spot, mean)| Some(((*mean)?, *spot))).collect();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut sorted = sorted.into_iter();
            for (place, mean) in means.iter().enumerate() {
                if mean.is_some()
                    && let Some((_, spot)) = sorted.next()
                {
                    columns[at][place] = spot;
                }
            }
        }
        let found = crossings(columns, spots);
        if found < best.0 {
            best = (found, columns.clone());
        }
    }
    *columns = best.1;
}

/// How often wires cross between neighbouring columns.
fn crossings(columns: &[Vec<usize>], spots: &[Spot]) -> usize {
    let mut crossings = 0;
    for pair in columns.windows(2) {
        let places: BTreeMap<usize, usize> = pair[1].iter().enumerate().map(|(i, spot)| (*spot, i)).collect();
        let mut ends: Vec<usize> = Vec::new();
        for spot in &pair[0] {
            let own: Vec<usize> = spots[*spot].right.iter().map(|right| places[right]).collect();
            crossings += own.iter().map(|end| ends.iter().filter(|before| *before > end).count()).sum::<usize>();
            ends.extend(own);
        }
    }
    crossings
}

/// The middles of all spots: near their neighbours', at least their distances apart, straight where wires only pass.
fn heights(columns: &[Vec<usize>], spots: &[Spot]) -> Vec<f64> {
    let apart = |a: usize, b: usize| {
        let gap = if spots[a].is_node || spots[b].is_node { GAP_Y } else { GAP_WIRES };
        (spots[a].size.height + spots[b].size.height) / 2.0 + gap
    };
    let mut middles = vec![0.0; spots.len()];
    for column in columns {
        let mut y = 0.0;
        for (i, spot) in column.iter().enumerate() {
            y += if i == 0 { 0.0 } else { apart(column[i - 1], *spot) };
            middles[*spot] = y;
        }
    }
    for sweep in 0..SWEEPS * 4 {
        let forth = sweep % 2 == 0;
        for step in 0..columns.len() {
            let column = &columns[if forth { step } else { columns.len() - 1 - step }];
            let wishes: Vec<(f64, f64)> = column
                .iter()
                .map(|spot| {
                    let (mut sum, mut weight) = (0.0, 0.0);
                    let Spot { left, right, is_node, .. } = &spots[*spot];
                    for other in left.iter().chain(right) {
                        // A wire that passes wants to be straight more than a node wants to be in the middle.
                        let w = if *is_node || spots[*other].is_node { 1.0 } else { 20.0 };
                        sum += w * middles[*other];
                        weight += w;
                    }
                    if weight == 0.0 { (middles[*spot], 0.01) } else { (sum / weight, weight) }
                })
                .collect();
            let distances: Vec<f64> = column.windows(2).map(|pair| apart(pair[0], pair[1])).collect();
            for (spot, y) in column.iter().zip(nearest(&wishes, &distances)) {
                middles[*spot] = y;
            }
        }
    }
    middles
}

/// The heights nearest to the wishes (height, weight) in the sense of least squares that are at least so far apart.
fn nearest(wishes: &[(f64, f64)], distances: &[f64]) -> Vec<f64> {
    // Without the distances the heights may not decrease: blocks that would are pooled into their mean.
    let mut offset = 0.0;
    let mut offsets = vec![0.0];
    offsets.extend(distances.iter().map(|distance| {
        offset += distance;
        offset
    }));
    let mut blocks: Vec<(f64, f64, usize)> = Vec::new();
    for ((wish, weight), offset) in wishes.iter().zip(&offsets) {
        let mut block = (wish - offset, *weight, 1);
        while let Some(before) = blocks.pop_if(|before| before.0 > block.0) {
            let weight = before.1 + block.1;
            block = ((before.0 * before.1 + block.0 * block.1) / weight, weight, before.2 + block.2);
        }
        blocks.push(block);
    }
    let heights = blocks.iter().flat_map(|(height, _, n)| std::iter::repeat_n(*height, *n));
    heights.zip(offsets).map(|(height, offset)| height + offset).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LABEL: Size = Size { width: 60.0, height: 14.0 };

    fn overlap(a: &Place, b: &Place) -> bool {
        let apart = a.right() <= b.x || b.right() <= a.x;
        let stacked = a.y + a.size.height <= b.y || b.y + b.size.height <= a.y;
        !apart && !stacked
    }

    #[test]
    fn the_nearest_heights_keep_the_distances_and_move_no_more_than_needed() {
        assert_eq!(nearest(&[(0.0, 1.0), (0.0, 1.0)], &[10.0]), [-5.0, 5.0]);
        assert_eq!(nearest(&[(0.0, 1.0), (50.0, 1.0)], &[10.0]), [0.0, 50.0]);
        assert_eq!(nearest(&[(0.0, 3.0), (0.0, 1.0)], &[8.0]), [-2.0, 6.0]);
        assert_eq!(nearest(&[], &[]), [0.0; 0]);
    }

    #[test]
    fn a_chain_is_straight() {
        let size = Size { width: 100.0, height: 40.0 };
        let edges: Vec<_> = (0..4).map(|n| Edge { from: n, to: n + 1, label: LABEL }).collect();
        let placed = layout(&[size; 5], &edges);
        let middles: Vec<_> = placed.nodes.iter().map(Place::middle).collect();
        assert!(middles.iter().all(|y| (y - middles[0]).abs() < 1e-9), "{middles:?}");
        assert!(placed.nodes.windows(2).all(|pair| pair[0].right() < pair[1].x));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn nothing_stands_on_anything_else(
            heights in prop::collection::vec(20.0f64..90.0, 1..35),
            pairs in prop::collection::vec((0usize..35, 0usize..35), 0..70),
        ) {
            let nodes: Vec<_> = heights.iter().map(|height| Size { width: 60.0 + height, height: *height }).collect();
            let mut pairs: Vec<_> = pairs.into_iter().map(|(a, b)| (a % nodes.len(), b % nodes.len())).collect();
            pairs.sort_unstable();
            pairs.dedup();
            let edges: Vec<_> =
                pairs.into_iter().filter(|(a, b)| a < b).map(|(from, to)| Edge { from, to, label: LABEL }).collect();
            let placed = layout(&nodes, &edges);
            let all: Vec<Place> = placed.nodes.iter().chain(placed.edges.iter().flatten()).copied().collect();
            for (i, a) in all.iter().enumerate() {
                for b in &all[..i] {
                    prop_assert!(!overlap(a, b), "{a:?} and {b:?}");
                }
                prop_assert!(a.x >= 0.0 && a.y >= -1e-9, "{a:?}");
                prop_assert!(a.right() <= placed.size.width + 1e-9 && a.y + a.size.height <= placed.size.height + 1e-9);
            }
            for (edge, chain) in edges.iter().zip(&placed.edges) {
                let xs: Vec<_> = [placed.nodes[edge.from]].iter().chain(chain).chain(&[placed.nodes[edge.to]])
                    .map(|place| place.x).collect();
                prop_assert!(xs.windows(2).all(|pair| pair[0] < pair[1]), "an edge goes back: {xs:?}");
                prop_assert!(chain[0].size.height == LABEL.height);
            }
        }
    }
}
