//! Layered layout of a diagram, from left to right.
//!
//! After Sugiyama, Tagawa and Toda 1981. A node's rank is its longest path from a source. An edge has a vertex of its own in
//! each rank between its ends, and its label has a rank of its own behind the producer, so that nothing overlaps. Vertices
//! are ordered within a rank by the mean position of their neighbours. Their heights minimize the weighted squared distance
//! to their neighbours' heights subject to the gaps, solved exactly by pooling adjacent violators.

use std::collections::BTreeMap;

/// Width and height of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Size {
    pub(super) width: f64,
    pub(super) height: f64,
}

/// A box with the position of its upper left corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rect {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) size: Size,
}

impl Rect {
    pub(super) fn middle(&self) -> f64 {
        self.y + self.size.height / 2.0
    }

    pub(super) fn right(&self) -> f64 {
        self.x + self.size.width
    }
}

/// An edge between two nodes, by their indices.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) label: Size,
}

/// Positions of all nodes and edges.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) nodes: Vec<Rect>,
    /// For each edge the boxes between its ends, from left to right; the first is its label's.
    pub(super) edges: Vec<Vec<Rect>>,
    pub(super) size: Size,
}

/// Gap between columns: room for the curves.
const GAP_X: f64 = 26.0;
/// Gap between boxes of a column.
const GAP_Y: f64 = 14.0;
/// Gap between edges side by side.
const GAP_EDGES: f64 = 5.0;
/// Height of an edge without its label.
const EDGE_HEIGHT: f64 = 2.0;
/// Number of alternating sweeps over the columns that order them.
const SWEEPS: usize = 24;

/// A node, or a segment of an edge, in a rank.
struct Vertex {
    size: Size,
    is_node: bool,
    left: Vec<usize>,
    right: Vec<usize>,
}

/// Lays out nodes, which must be in topological order, and edges, which must lead from earlier nodes to later ones.
pub(super) fn layout(nodes: &[Size], edges: &[Edge]) -> Layout {
    let ranks = ranks(nodes.len(), edges);
    let mut vertices: Vec<Vertex> =
        nodes.iter().map(|size| Vertex { size: *size, is_node: true, left: Vec::new(), right: Vec::new() }).collect();
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
            let size = if rank == ranks[edge.from] + 1 { edge.label } else { Size { width: 0.0, height: EDGE_HEIGHT } };
            let vertex = vertices.len();
            vertices.push(Vertex { size, is_node: false, left: Vec::new(), right: Vec::new() });
            connect(&mut vertices, before, vertex);
            column.push(vertex);
            chain.push(vertex);
            before = vertex;
        }
        connect(&mut vertices, before, edge.to);
        chains.push(chain);
    }
    reduce_crossings(&mut columns, &vertices);
    let middles = heights(&columns, &vertices);

    let mut x = 0.0;
    let mut rects = vec![Rect { x: 0.0, y: 0.0, size: Size { width: 0.0, height: 0.0 } }; vertices.len()];
    for column in &columns {
        let width = column.iter().map(|vertex| vertices[*vertex].size.width).fold(0.0, f64::max);
        for &vertex in column {
            let Vertex { size, is_node, .. } = vertices[vertex];
            // An edge crosses the whole column horizontally; a node is centred in it.
            let size = if is_node { size } else { Size { width, ..size } };
            rects[vertex] = Rect { x: x + (width - size.width) / 2.0, y: middles[vertex] - size.height / 2.0, size };
        }
        x += width + GAP_X;
    }
    let top = rects.iter().map(|rect| rect.y).fold(f64::INFINITY, f64::min);
    rects.iter_mut().for_each(|rect| rect.y -= top);
    let height = rects.iter().map(|rect| rect.y + rect.size.height).fold(0.0, f64::max);
    Layout {
        nodes: rects[..nodes.len()].to_vec(),
        edges: chains.iter().map(|chain| chain.iter().map(|vertex| rects[*vertex]).collect()).collect(),
        size: Size { width: (x - GAP_X).max(0.0), height },
    }
}

fn connect(vertices: &mut [Vertex], left: usize, right: usize) {
    vertices[left].right.push(right);
    vertices[right].left.push(left);
}

/// Even ranks for nodes, odd ranks for the labels of their outgoing edges. A node without inputs is placed directly before
/// its first consumer.
fn ranks(n_nodes: usize, edges: &[Edge]) -> Vec<usize> {
    let mut ranks = vec![0; n_nodes];
    for node in 0..n_nodes {
        let outgoing = edges.iter().filter(|edge| edge.from == node);
        for edge in outgoing {
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

/// Orders each column by the mean position of its neighbours and keeps the order with the fewest crossings.
fn reduce_crossings(columns: &mut Vec<Vec<usize>>, vertices: &[Vertex]) {
    let mut best = (crossings(columns, vertices), columns.clone());
    for sweep in 0..SWEEPS {
        let to_the_right = sweep % 2 == 0;
        let n = columns.len();
        for step in 1..n {
            let at = if to_the_right { step } else { n - 1 - step };
            let beside = if to_the_right { at - 1 } else { at + 1 };
            let positions: BTreeMap<usize, usize> =
                columns[beside].iter().enumerate().map(|(i, vertex)| (*vertex, i)).collect();
            let mean = |vertex: &usize| {
                let near = if to_the_right { &vertices[*vertex].left } else { &vertices[*vertex].right };
                let sum: usize = near.iter().map(|other| positions[other]).sum();
                (!near.is_empty()).then(|| sum as f64 / near.len() as f64)
            };
            // A vertex without neighbours there keeps its position.
            let means: Vec<_> = columns[at].iter().map(mean).collect();
            let mut sorted: Vec<(f64, usize)> =
                columns[at].iter().zip(&means).filter_map(|(vertex, mean)| Some(((*mean)?, *vertex))).collect();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut sorted = sorted.into_iter();
            for (position, mean) in means.iter().enumerate() {
                if mean.is_some()
                    && let Some((_, vertex)) = sorted.next()
                {
                    columns[at][position] = vertex;
                }
            }
        }
        let n_crossings = crossings(columns, vertices);
        if n_crossings < best.0 {
            best = (n_crossings, columns.clone());
        }
    }
    *columns = best.1;
}

/// Number of edge crossings between neighbouring columns.
fn crossings(columns: &[Vec<usize>], vertices: &[Vertex]) -> usize {
    let mut crossings = 0;
    for pair in columns.windows(2) {
        let positions: BTreeMap<usize, usize> = pair[1].iter().enumerate().map(|(i, vertex)| (*vertex, i)).collect();
        let mut ends: Vec<usize> = Vec::new();
        for vertex in &pair[0] {
            let own: Vec<usize> = vertices[*vertex].right.iter().map(|right| positions[right]).collect();
            crossings += own.iter().map(|end| ends.iter().filter(|before| *before > end).count()).sum::<usize>();
            ends.extend(own);
        }
    }
    crossings
}

/// The vertical middles of all vertices: close to those of their neighbours and at least the gaps apart.
fn heights(columns: &[Vec<usize>], vertices: &[Vertex]) -> Vec<f64> {
    let distance = |a: usize, b: usize| {
        let gap = if vertices[a].is_node || vertices[b].is_node { GAP_Y } else { GAP_EDGES };
        (vertices[a].size.height + vertices[b].size.height) / 2.0 + gap
    };
    let mut middles = vec![0.0; vertices.len()];
    for column in columns {
        let mut y = 0.0;
        for (i, vertex) in column.iter().enumerate() {
            y += if i == 0 { 0.0 } else { distance(column[i - 1], *vertex) };
            middles[*vertex] = y;
        }
    }
    for sweep in 0..SWEEPS * 4 {
        let to_the_right = sweep % 2 == 0;
        for step in 0..columns.len() {
            let column = &columns[if to_the_right { step } else { columns.len() - 1 - step }];
            let desired: Vec<(f64, f64)> = column
                .iter()
                .map(|vertex| {
                    let (mut sum, mut weight) = (0.0, 0.0);
                    let Vertex { left, right, is_node, .. } = &vertices[*vertex];
                    for other in left.iter().chain(right) {
                        // Straight edges matter more than centred nodes.
                        let w = if *is_node || vertices[*other].is_node { 1.0 } else { 20.0 };
                        sum += w * middles[*other];
                        weight += w;
                    }
                    if weight == 0.0 { (middles[*vertex], 0.01) } else { (sum / weight, weight) }
                })
                .collect();
            let distances: Vec<f64> = column.windows(2).map(|pair| distance(pair[0], pair[1])).collect();
            for (vertex, y) in column.iter().zip(fit_heights(&desired, &distances)) {
                middles[*vertex] = y;
            }
        }
    }
    middles
}

/// Weighted least-squares fit to `desired` (value, weight) whose neighbours are at least `distances` apart.
fn fit_heights(desired: &[(f64, f64)], distances: &[f64]) -> Vec<f64> {
    // After subtracting the distances the values must not decrease: blocks that would are pooled into their mean.
    let mut offset = 0.0;
    let mut offsets = vec![0.0];
    offsets.extend(distances.iter().map(|distance| {
        offset += distance;
        offset
    }));
    let mut blocks: Vec<(f64, f64, usize)> = Vec::new();
    for ((value, weight), offset) in desired.iter().zip(&offsets) {
        let mut block = (value - offset, *weight, 1);
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

    fn overlap(a: &Rect, b: &Rect) -> bool {
        let apart = a.right() <= b.x || b.right() <= a.x;
        let stacked = a.y + a.size.height <= b.y || b.y + b.size.height <= a.y;
        !apart && !stacked
    }

    #[test]
    fn fitted_heights_keep_the_distances_and_move_no_more_than_needed() {
        assert_eq!(fit_heights(&[(0.0, 1.0), (0.0, 1.0)], &[10.0]), [-5.0, 5.0]);
        assert_eq!(fit_heights(&[(0.0, 1.0), (50.0, 1.0)], &[10.0]), [0.0, 50.0]);
        assert_eq!(fit_heights(&[(0.0, 3.0), (0.0, 1.0)], &[8.0]), [-2.0, 6.0]);
        assert_eq!(fit_heights(&[], &[]), [0.0; 0]);
    }

    #[test]
    fn a_chain_is_straight() {
        let size = Size { width: 100.0, height: 40.0 };
        let edges: Vec<_> = (0..4).map(|n| Edge { from: n, to: n + 1, label: LABEL }).collect();
        let placed = layout(&[size; 5], &edges);
        let middles: Vec<_> = placed.nodes.iter().map(Rect::middle).collect();
        assert!(middles.iter().all(|y| (y - middles[0]).abs() < 1e-9), "{middles:?}");
        assert!(placed.nodes.windows(2).all(|pair| pair[0].right() < pair[1].x));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn nothing_overlaps(
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
            let all: Vec<Rect> = placed.nodes.iter().chain(placed.edges.iter().flatten()).copied().collect();
            for (i, a) in all.iter().enumerate() {
                for b in &all[..i] {
                    prop_assert!(!overlap(a, b), "{a:?} and {b:?}");
                }
                prop_assert!(a.x >= 0.0 && a.y >= -1e-9, "{a:?}");
                prop_assert!(a.right() <= placed.size.width + 1e-9 && a.y + a.size.height <= placed.size.height + 1e-9);
            }
            for (edge, chain) in edges.iter().zip(&placed.edges) {
                let xs: Vec<_> = [placed.nodes[edge.from]].iter().chain(chain).chain(&[placed.nodes[edge.to]])
                    .map(|rect| rect.x).collect();
                prop_assert!(xs.windows(2).all(|pair| pair[0] < pair[1]), "an edge leads backwards: {xs:?}");
                prop_assert!(chain[0].size.height == LABEL.height);
            }
        }
    }
}
