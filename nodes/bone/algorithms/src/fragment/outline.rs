//! The loops of a cut's rim.

use std::collections::BTreeMap;

/// Closed loops of the directed edges; opposite edges cancel, and no loop passes a vertex twice.
///
/// # Errors
/// The number of loose ends, where the numbers of edges to and from a vertex differ.
pub(super) fn loops(edges: &[[u32; 2]]) -> Result<Vec<Vec<u32>>, usize> {
    let mut count: BTreeMap<[u32; 2], i32> = BTreeMap::new();
    for &[a, b] in edges {
        *count.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
    }
    let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    let mut balance: BTreeMap<u32, i32> = BTreeMap::new();
    for ([a, b], n) in count {
        let (from, to) = if n > 0 { (a, b) } else { (b, a) };
        for _ in 0..n.unsigned_abs() {
            next.entry(from).or_default().push(to);
            *balance.entry(from).or_default() += 1;
            *balance.entry(to).or_default() -= 1;
        }
    }
    let loose: u32 = balance.values().map(|n| n.unsigned_abs()).sum();
    if loose > 0 {
        return Err(loose as usize);
    }
    let mut loops = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut path = vec![start];
        let mut here = start;
        while let Some(to) = next.get_mut(&here).and_then(Vec::pop) {
            if next.get(&here).is_some_and(Vec::is_empty) {
                next.remove(&here);
            }
            // The path returns to a vertex: the part since then is a loop.
            match path.iter().position(|&v| v == to) {
                Some(place) => {
                    loops.push(path.split_off(place));
                    path.push(to);
                }
                None => path.push(to),
            }
            here = to;
        }
    }
    Ok(loops)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_become_loops_that_pass_no_vertex_twice() {
        let eight = [[0, 1], [1, 2], [2, 0], [0, 3], [3, 4], [4, 0], [7, 8], [8, 7]];
        let mut loops = loops(&eight).unwrap();
        loops.sort();
        assert_eq!(loops.len(), 2);
        assert!(loops.iter().all(|l| l.len() == 3 && l.contains(&0)), "{loops:?}");
    }

    #[test]
    fn loose_ends_are_counted() {
        assert_eq!(loops(&[[0, 1], [1, 2]]), Err(2));
        assert_eq!(loops(&[]), Ok(Vec::new()));
    }
}
