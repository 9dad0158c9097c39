use super::*;

pub(super) fn cells_of(points: &[Point3<f64>]) -> PointGrid {
    PointGrid::new(points, &Point3::origin(), cell_mm(points, &Point3::origin()))
}

/// Points on a bent sheet, without a pattern.
pub(super) fn sheet(n: u32) -> Vec<Point3<f64>> {
    let part = |k: u32, m: u32| f64::from(k.wrapping_mul(2_654_435_761).wrapping_mul(m) >> 8) / f64::from(1 << 24);
    (0..n)
        .map(|k| {
            let (u, v) = (part(k, 1) * 40.0, part(k, 7919) * 25.0);
            Point3::new(u, v, 0.1 * u * u / 4.0 + v.sin())
        })
        .collect()
}

#[test]
fn the_nearest_point_and_the_bound_are_those_of_an_exhaustive_search() {
    let points = sheet(3000);
    let cells = cells_of(&points);
    let mut n_near = 0;
    for k in 0..400_usize {
        let off = Vector3::new(0.3, -0.2, 0.1) * (k % 7) as f64;
        let query = points[k * 7].coords + off;
        for limit_mm in [0.2, 1.0, 50.0] {
            let Some(found) = cells.nearest(&query, limit_mm, All) else { continue };
            n_near += 1;
            let mut squares: Vec<(f64, u32)> =
                points.iter().map(|p| (p.coords - query).norm_squared()).zip(0..).collect();
            squares.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let expected = Some((squares[0].1, squares[0].0)).filter(|n| n.1 <= limit_mm * limit_mm);
            assert_eq!(found.nearest, expected, "query {k}, limit {limit_mm}");
            let next = if expected.is_some() { squares[1].0 } else { squares[0].0 };
            assert!(found.free_square <= next, "query {k}: {} but {next}", found.free_square);
        }
    }
    assert!(n_near > 600, "{n_near} answers");
}

#[test]
fn a_grid_comes_back_from_its_columns_and_others_are_refused() {
    let points = sheet(3000);
    let cells = cells_of(&points);
    let parts = cells.to_columns();
    let back = PointGrid::from_columns(&points, &Point3::origin(), &parts).unwrap();
    assert_eq!((&back.points, &back.blocks), (&cells.points, &cells.blocks));
    assert_eq!((back.min, back.max, back.n_blocks), (cells.min, cells.max, cells.n_blocks));
    assert_eq!(back.to_columns(), parts);
    for of_few in [&points[..1], &[points[0]; 3]] {
        let cells = cells_of(of_few);
        assert_eq!(
            PointGrid::from_columns(of_few, &Point3::origin(), &cells.to_columns()).unwrap().points,
            cells.points
        );
    }

    let refused = |points: &[Point3<f64>], damage: &dyn Fn(&mut GridColumns), why: &str| {
        let mut parts = parts.clone();
        damage(&mut parts);
        let error = PointGrid::from_columns(points, &Point3::origin(), &parts).err();
        assert!(error.as_ref().is_some_and(|error| error.contains(why)), "{why}: {error:?}");
    };
    let changed = |column: &Column<u32>, at: usize, value: u32| {
        let mut values = column.to_vec();
        values[at] = value;
        Column::from(values)
    };
    refused(&points, &|p| p.cell_mm = f64::NAN, "NaN mm large");
    refused(&points, &|p| p.cell_mm = 1e-9, "not those of its points");
    refused(&points, &|p| p.cell_mm *= 1.5, "not those of its points");
    refused(&points, &|p| p.blocks = changed(&p.blocks, 0, u32::MAX), "not those of its points");
    refused(&points, &|p| p.starts = changed(&p.starts, 5, u32::MAX), "not those of its points");
    refused(&points, &|p| p.starts = p.starts[1..].to_vec().into(), "not those of its points");
    refused(&points, &|p| p.items = changed(&p.items, 7, p.items[8]), "not those of its points");
    refused(&points, &|p| p.items = changed(&p.items, 7, u32::MAX), "not those of its points");
    refused(&points[1..], &|_| {}, "not those of its points");
    let mut moved = points.clone();
    moved[40] += Vector3::repeat(2.0 * cells.cell_mm);
    refused(&moved, &|_| {}, "not those of its points");
}

#[test]
fn equal_points_give_the_lowest_index_and_no_clearance() {
    let cells = cells_of(&[1.0, 0.0, 1.0].map(|c| Point3::from(Vector3::repeat(c))));
    let found = cells.nearest(&Vector3::repeat(1.0), 0.5, All).unwrap();
    assert_eq!((found.nearest, found.free_square), (Some((0, 0.0)), 0.0));
    let cells = cells_of(&[]);
    assert_eq!(cells.nearest(&Vector3::repeat(1.0), 0.0, All).map(|n| n.nearest), Some(None));
}

#[test]
fn wide_clouds_and_queries_far_outside_are_handled() {
    let mut points = sheet(500);
    points.push(Vector3::repeat(1e7).into());
    let cells = cells_of(&points);
    // The reported size is that of the enlarged cells, so that columns are read back unchanged.
    assert_eq!(cells.cell_mm, cell_mm(&points, &Point3::origin()));
    assert_eq!(cells.nearest(&points[500].coords, 1.0, All).unwrap().nearest, Some((500, 0.0)));
    assert_eq!(cells.nearest(&Vector3::repeat(-1e9), 0.5, All).map(|n| n.nearest), Some(None));
}

#[derive(Clone, Copy)]
struct Even;

impl PointFilter for Even {
    const ALL: bool = false;

    fn accepts(&self, item: u32, _: &Vector3<f64>) -> bool {
        item.is_multiple_of(2)
    }
}

/// Answers of all searches to queries on the sheet, beside it and outside of the grid: how many, how many with a point, and
/// the mean of their bounds on the others, mm. Each answer is compared with an exhaustive search.
fn tally(filter: impl PointFilter, accepted: impl Fn(u32) -> bool) -> String {
    let points = sheet(3000);
    let cells = cells_of(&points);
    let mut tallies = [(0, 0, 0.0); 2];
    for k in 0..600_usize {
        let off = Vector3::new(0.45, -0.35, 0.6) * (k % 13) as f64 * if k % 2 == 0 { 0.5 } else { -0.5 };
        let query = points[k * 5].coords + off;
        let mut squares: Vec<(f64, u32)> = (0..)
            .zip(&points)
            .filter(|(i, _)| accepted(*i))
            .map(|(i, p)| ((p.coords - query).norm_squared(), i))
            .collect();
        squares.sort_by(|a, b| a.0.total_cmp(&b.0));
        for limit_mm in [0.2, 1.0, 3.0, 50.0] {
            let answers =
                [cells.nearest_by_lanes(&query, limit_mm, filter), cells.nearest_in_rings(&query, limit_mm, filter)];
            for (found, tally) in answers.iter().zip(&mut tallies) {
                let Some(found) = found else { continue };
                let expected = Some((squares[0].1, squares[0].0)).filter(|n| n.1 <= limit_mm * limit_mm);
                assert_eq!(found.nearest, expected, "query {k}, limit {limit_mm}");
                assert_eq!(found.at.map(|at| cells.items()[at as usize]), expected.map(|n| n.0), "its place");
                let next = if expected.is_some() { squares[1].0 } else { squares[0].0 };
                assert!(found.free_square <= next, "query {k}: {} but {next}", found.free_square);
                tally.0 += 1;
                tally.1 += usize::from(expected.is_some());
                tally.2 += found.free_square.sqrt();
            }
        }
    }
    format!("{:.4?}", tallies.map(|(n, n_found, sum)| (n, n_found, sum / f64::from(n))))
}

#[test]
fn all_searches_answer_as_often_and_with_as_wide_a_bound_as_they_did() {
    // Fewer answers are slower, as the kd-tree is asked; so is a narrower bound, as a point is looked up again sooner.
    assert_eq!(tally(All, |_| true), "[(1761, 1299, 0.3227), (1854, 1362, 0.3571)]");
    assert_eq!(tally(Even, |i| i.is_multiple_of(2)), "[(1135, 673, 0.3075), (1848, 1303, 0.3887)]");
}

#[test]
fn points_that_single_precision_confuses_are_told_apart_in_double_precision() {
    // 40 m from the centre a digit of single precision is 0.004 mm.
    let far = Vector3::new(4e4, 0.0, 0.0);
    let points: Vec<Point3<f64>> = sheet(3000).iter().map(|p| p + far).collect();
    let cells = cells_of(&points);
    let mut n_unclear = 0;
    for k in 0..300_usize {
        // A place between two neighbours, nearer to the first by 2e-5 mm.
        let (first, second) = (points[k * 10].coords, cells.points[(k * 10 + 1) % 3000]);
        let across = (second - first).normalize();
        let query = (first + second) / 2.0 - across * 1e-5;
        let nearest = points.iter().map(|p| (p.coords - query).norm_squared()).fold(f64::INFINITY, f64::min);
        // A limit between both, as that of a search from a known pair, too.
        for limit_mm in [50.0, nearest.sqrt() * (1.0 + 1e-12)] {
            let found = cells.nearest(&query, limit_mm, All);
            assert!(found.is_none_or(|found| found.nearest.is_some_and(|(_, square)| square == nearest)), "query {k}");
            n_unclear += usize::from(cells.nearest_by_lanes(&query, limit_mm, All).is_none());
        }
    }
    assert!(n_unclear > 100, "{n_unclear} of 600 unclear");
}

#[test]
fn cells_of_a_sheet_hold_as_many_points_as_they_did_and_those_around_a_cell_go_by_their_distance() {
    let points = sheet(3000);
    let cells = cells_of(&points);
    let n_occupied = cells.starts.windows(2).filter(|two| two[0] < two[1]).count();
    // Of so few points the trial cells are too small to tell how many would share one: fewer do than wanted.
    let per_cell = 3000.0 / f64::from(n_occupied as u32);
    assert_eq!(format!("{per_cell:.4} {:.6}", cells.cell_mm), "1.2479 0.220733");
    for (at, point) in cells.points.iter().enumerate() {
        let range = cells.range(cells.cell(point));
        assert!(range.contains(&at) && cells.cell(point) == cells.cell_of(point), "point {at} in {range:?}");
    }
    let steps = AROUND.map(|cell| cell.iter().filter(|c| **c != 1).count());
    assert_eq!(steps.map(|n| (1..=3).contains(&n)), [true; 26]);
    assert!(steps.is_sorted() && [1, 2, 3].map(|n| steps.iter().filter(|s| **s == n).count()) == [6, 12, 8]);
    let mut distinct = AROUND.to_vec();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), 26);
}
