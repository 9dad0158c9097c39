//! Connected parts of a surface, and clusters of points; which way their faces turn.

use crate::Refusal;
use crate::iso_surface::compacted;
use crate::median::median;
use crate::mesh_query::MeshQuery;
use crate::mesh_topology::{components, each_edge, first_in_place};
use crate::nearest::Nearest;
use crate::union_find::UnionFind;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Mesh;
use serde::Serialize;
use std::{
    collections::{BTreeMap, HashMap},
    str::FromStr,
};

/// Number of parts that are listed; the smaller ones are counted.
pub const MAX_LISTED: usize = 20;

/// Two parts are about equal if the smaller has at least this share of the larger one's area: left and right bones of a pair
/// differ by less.
const ABOUT_EQUAL: f64 = 0.8;

/// Points belong to one cluster if gaps between them are at most this many times the median distance to the nearest other point: a scan
/// has no such gap within a surface that is seen at up to 78 degrees.
pub const GAP: f64 = 5.0;

/// Number of points whose nearest neighbours are looked up for that median.
const MEDIAN_OF: usize = 2000;

/// Which part of a surface or of a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PartChoice {
    /// The part of this number by size: 1 is the largest.
    Rank(usize),
    /// The part nearest to a point, mm.
    Nearest(Point3<f64>),
}

impl FromStr for PartChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let point = |text: &str| {
            let cells: Option<Vec<f64>> = text.split(',').map(|cell| cell.trim().parse().ok()).collect();
            let cells: [f64; 3] = cells?.try_into().ok()?;
            cells.iter().all(|c| c.is_finite()).then(|| Point3::from(cells))
        };
        let choice = match (text.trim(), text.trim().strip_prefix("nearest:")) {
            ("largest", _) => Some(Self::Rank(1)),
            (_, Some(place)) => point(place).map(Self::Nearest),
            (rank, None) => rank.parse().ok().filter(|rank| *rank >= 1).map(Self::Rank),
        };
        choice.ok_or_else(|| {
            format!(
                "\"{text}\" names no part; give largest, its number by size, such as 2, or nearest:X,Y,Z in mm, such as \
                 nearest:10,0,-250"
            )
        })
    }
}

/// A connected part of a surface, or a cluster of points.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Part {
    /// Its number by size: 1 is the largest, by area or by number of points.
    pub number: usize,
    /// Number of its vertices or points.
    pub n_points: usize,
    /// Number of faces of a surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub n_faces: Option<usize>,
    /// Area of a surface, mm².
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area_mm2: Option<f64>,
    /// Edges of the box around it, mm.
    pub extent_mm: [f64; 3],
    /// Centre of that box, mm.
    pub centre_mm: [f64; 3],
}

impl Part {
    /// Size and place, in words.
    pub fn describe(&self) -> String {
        let ([x, y, z], [a, b, c]) = (self.centre_mm, self.extent_mm);
        let n = self.n_faces.map_or_else(|| format!("{} points", self.n_points), |n| format!("{n} faces"));
        format!("{n}, {a:.1} x {b:.1} x {c:.1} mm about {x:.1}, {y:.1}, {z:.1}")
    }

    /// Distance of a place from the box around it, mm; zero within.
    pub fn outside_mm(&self, at: &Point3<f64>) -> f64 {
        let beyond = |k: usize| ((at[k] - self.centre_mm[k]).abs() - 0.5 * self.extent_mm[k]).max(0.0);
        (0..3).map(beyond).fold(0.0, f64::hypot)
    }

    /// Whether the box of the other is within the box of this one.
    fn holds(&self, other: &Part) -> bool {
        let reach = |k: usize| 0.5 * (self.extent_mm[k] - other.extent_mm[k]);
        (0..3).all(|k| (self.centre_mm[k] - other.centre_mm[k]).abs() <= reach(k))
    }
}

/// The parts of a surface or of a cloud, the largest first.
#[derive(Debug, Clone)]
pub struct Parts {
    /// Each of them.
    pub list: Vec<Part>,
    /// Gaps up to here are within one cluster of points, mm; `None` for a surface.
    pub gap_mm: Option<f64>,
    /// The place in the list of the part of each face, or of each point of a cloud.
    labels: Vec<u32>,
}

/// What a part is made of, while it is counted.
#[derive(Clone)]
struct Count {
    points: usize,
    faces: usize,
    area_mm2: f64,
    min: Point3<f64>,
    max: Point3<f64>,
}

impl Count {
    const NONE: Self = Self {
        points: 0,
        faces: 0,
        area_mm2: 0.0,
        min: Point3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        max: Point3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    fn add(&mut self, point: &Point3<f64>) {
        self.points += 1;
        (self.min, self.max) = (self.min.inf(point), self.max.sup(point));
    }
}

impl Parts {
    /// The parts of a surface whose faces share corners: vertices in one place are one corner. `O(n log n)`.
    pub fn of_mesh(mesh: &Mesh) -> Self {
        let n = mesh.vertices().len();
        let (component, n_components) = components(n, mesh.faces());
        let counted = of_faces(mesh, mesh.faces(), &component, n_components);
        if counted.iter().filter(|count| count.faces > 0).count() > 1 {
            let faces = first_in_place(mesh.vertices(), mesh.faces());
            let (component, n_components) = components(n, &faces);
            let counted = of_faces(mesh, &faces, &component, n_components);
            return Self::sorted(counted, faces.iter().map(|face| component[face[0] as usize]).collect(), None);
        }
        Self::sorted(counted, mesh.faces().iter().map(|face| component[face[0] as usize]).collect(), None)
    }

    /// The clusters of a cloud: chains of points whose gaps are at most [`GAP`] times the median distance to the nearest other point.
    /// `O(n log n)`.
    pub fn of_points(points: &[Point3<f64>]) -> Self {
        let gap_mm = GAP * median_spacing_mm(points);
        let (labels, n) = clusters(points, gap_mm);
        let mut counted = vec![Count::NONE; n];
        points.iter().zip(&labels).for_each(|(point, label)| counted[*label].add(point));
        Self::sorted(counted, labels, Some(gap_mm))
    }

    fn sorted(counted: Vec<Count>, labels: Vec<usize>, gap_mm: Option<f64>) -> Self {
        let is_surface = gap_mm.is_none();
        let is_part = |count: &Count| if is_surface { count.faces > 0 } else { count.points > 0 };
        let mut order: Vec<usize> = (0..counted.len()).filter(|k| is_part(&counted[*k])).collect();
        let size = |k: usize| if is_surface { counted[k].area_mm2 } else { counted[k].points as f64 };
        // A stable sort: of equal ones, the one that comes first.
        order.sort_by(|a, b| size(*b).total_cmp(&size(*a)));
        let mut place = vec![0; counted.len()];
        order.iter().enumerate().for_each(|(at, &k)| place[k] = at as u32);
        let part = |(at, &k): (usize, &usize)| {
            let count = &counted[k];
            Part {
                number: at + 1,
                n_points: count.points,
                n_faces: is_surface.then_some(count.faces),
                area_mm2: is_surface.then_some(count.area_mm2),
                extent_mm: (count.max - count.min).into(),
                centre_mm: nalgebra::center(&count.min, &count.max).into(),
            }
        };
        let list = order.iter().enumerate().map(part).collect();
        Self { list, gap_mm, labels: labels.into_iter().map(|label| place[label]).collect() }
    }

    /// The place in the list of the part that is chosen from a surface.
    ///
    /// # Errors
    /// [`Refusal`] if there are fewer parts.
    pub fn chosen_of_mesh(&self, mesh: &Mesh, choice: PartChoice) -> Result<usize, Refusal> {
        let nearest = |at: &Point3<f64>| MeshQuery::new(mesh).closest_point(at).map(|closest| closest.face);
        self.chosen(choice, "the surface", nearest)
    }

    /// The place in the list of the part that is chosen from a cloud.
    ///
    /// # Errors
    /// [`Refusal`] if there are fewer parts.
    pub fn chosen_of_points(&self, points: &[Point3<f64>], choice: PartChoice) -> Result<usize, Refusal> {
        let distance = |at: &Point3<f64>, k: usize| (points[k] - at).norm_squared();
        let nearest = |at: &Point3<f64>| (0..points.len()).min_by(|a, b| distance(at, *a).total_cmp(&distance(at, *b)));
        self.chosen(choice, "the cloud", nearest)
    }

    fn chosen(
        &self,
        choice: PartChoice,
        whole: &str,
        nearest: impl Fn(&Point3<f64>) -> Option<usize>,
    ) -> Result<usize, Refusal> {
        match choice {
            PartChoice::Rank(number) if (1..=self.list.len()).contains(&number) => Ok(number - 1),
            PartChoice::Rank(number) => {
                let shown = self.list.iter().take(3).map(|part| format!("{}: {}", part.number, part.describe()));
                let (shown, n) = (shown.collect::<Vec<_>>().join("; "), self.list.len());
                Err(Refusal::of(format!(
                    "part {number} was asked for, but {whole} has {n} ({shown}); give 1 to {n}, or nearest:X,Y,Z"
                )))
            }
            PartChoice::Nearest(at) => {
                let found = nearest(&at).ok_or_else(|| Refusal::of(format!("{whole} has no part")))?;
                Ok(self.labels[found] as usize)
            }
        }
    }

    /// The part at a place in the list, with the vertices that it uses.
    ///
    /// # Panics
    /// If it has no faces, which no part of the list has.
    pub fn mesh(&self, mesh: &Mesh, place: usize) -> Mesh {
        let own = mesh.faces().iter().zip(&self.labels).filter(|(_, label)| **label as usize == place);
        let (vertices, faces) = compacted(mesh.vertices(), own.map(|(face, _)| *face).collect());
        Mesh::new(mesh.frame.clone(), mesh.origin, vertices, faces).expect("a part of a mesh has faces")
    }

    /// The points of the cluster at a place in the list, in their order.
    pub fn points(&self, place: usize) -> Vec<usize> {
        (0..self.labels.len()).filter(|k| self.labels[*k] as usize == place).collect()
    }

    /// Number of the largest parts that are about equal, if there are several beside each other: a surface within another is its
    /// inner wall.
    pub fn n_equal(&self) -> Option<usize> {
        let [largest, others @ ..] = &self.list[..] else { return None };
        let size = |part: &Part| part.area_mm2.unwrap_or(part.n_points as f64);
        let equal = others.iter().take_while(|part| size(part) >= ABOUT_EQUAL * size(largest));
        let n = equal.filter(|part| !largest.holds(part)).count();
        (n > 0).then_some(n + 1)
    }
}

/// What each component of `faces` is made of, which are those of the mesh over these vertices.
fn of_faces(mesh: &Mesh, faces: &[[u32; 3]], component: &[usize], n: usize) -> Vec<Count> {
    let mut counted = vec![Count::NONE; n];
    let mut is_used = vec![false; component.len()];
    for (k, face) in faces.iter().enumerate() {
        let count = &mut counted[component[face[0] as usize]];
        count.faces += 1;
        count.area_mm2 += mesh.area_vector(k).norm() / 2.0;
        face.iter().for_each(|v| is_used[*v as usize] = true);
    }
    let used = mesh.vertices().iter().zip(component).zip(&is_used).filter(|(_, used)| **used);
    used.for_each(|((vertex, c), _)| counted[*c].add(vertex));
    counted
}

/// Median distance of points to their nearest other point, mm.
fn median_spacing_mm(points: &[Point3<f64>]) -> f64 {
    let tree = Nearest::new(points);
    let step = points.len().div_ceil(MEDIAN_OF).max(1);
    let spacing = |point: &Point3<f64>| Some(tree.nearest_n(point, 2).get(1)?.1.sqrt());
    let mut spacings: Vec<f64> = points.iter().step_by(step).filter_map(spacing).collect();
    median(&mut spacings)
}

/// For each point the number of its cluster, and the number of clusters: chains of gaps up to `gap_mm`.
fn clusters(points: &[Point3<f64>], gap_mm: f64) -> (Vec<usize>, usize) {
    if gap_mm <= 0.0 {
        return (vec![0; points.len()], usize::from(!points.is_empty()));
    }
    // Points of one cell are nearer to each other than the gap, and others within it are at most two cells away.
    let edge_mm = gap_mm / 3.0_f64.sqrt() * (1.0 - 1e-9);
    let low = points.iter().fold(points[0], |low, point| low.inf(point));
    let cell = |point: &Point3<f64>| -> [i64; 3] { ((point - low) / edge_mm).map(|c| c.floor() as i64).into() };
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    let mut order = Vec::new();
    for (k, point) in (0_u32..).zip(points) {
        let key = cell(point);
        let own = cells.entry(key).or_default();
        if own.is_empty() {
            order.push(key);
        }
        own.push(k);
    }
    let mut sets = UnionFind::new(points.len());
    for key in &order {
        cells[key].iter().for_each(|k| sets.join(cells[key][0], *k, false));
    }
    let is_near = |a: u32, b: u32| (points[a as usize] - points[b as usize]).norm_squared() <= gap_mm * gap_mm;
    for key in &order {
        // Each pair of cells once.
        for at in 63..125 {
            let offset = [at / 25 - 2, at / 5 % 5 - 2, at % 5 - 2];
            let Some(others) = cells.get(&std::array::from_fn(|k| key[k] + offset[k])) else { continue };
            let own = &cells[key];
            if sets.root(own[0]).0 != sets.root(others[0]).0
                && own.iter().any(|a| others.iter().any(|b| is_near(*a, *b)))
            {
                sets.join(own[0], others[0], false);
            }
        }
    }
    let (labels, n) = sets.labels();
    (labels.into_iter().map(|(label, _)| label as usize).collect(), n)
}

/// Which way the faces of a surface turn.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Turns {
    /// Number of faces of closed parts that pointed inwards and are turned.
    pub n_turned: usize,
    /// Number of faces that turn the other way than most of the faces connected to them, and stay so.
    pub n_flipped: usize,
    /// Number of faces over the same three corners as one before them.
    pub n_doubled: usize,
}

/// The surface with each closed part turned outwards by its signed volume, and what is wrong with the others.
///
/// The faces of a closed part that do not agree are first brought to agree. A closed part within the box of another may be its inner wall, and is
/// turned with it, or stays as it is where its faces do not agree. So do parts that are open. `O(n log n)`.
pub fn turned_outwards(mesh: &Mesh) -> (Mesh, Turns) {
    let faces = first_in_place(mesh.vertices(), mesh.faces());
    let is_face = |[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
    let mut turns = Turns::default();
    let mut neighbours = UnionFind::new(faces.len());
    // The faces at edges of other than two.
    let mut open: Vec<u32> = Vec::new();
    let mut is_doubtful = false;
    each_edge(&faces, |ways| match *ways {
        [(_, from, a), (_, to, b)] => {
            is_doubtful |= from == to;
            neighbours.join(a, b, from == to);
        }
        _ => {
            is_doubtful |= ways.len() > 2;
            open.extend(ways.iter().map(|way| way.2));
        }
    });
    if is_doubtful {
        turns.n_doubled = n_doubled(&faces);
    }
    let (labels, n) = neighbours.labels();
    let mut is_closed = vec![true; n];
    open.iter().for_each(|face| is_closed[labels[*face as usize].0 as usize] = false);
    if is_doubtful {
        // A surface that has one side only is none of a body.
        each_edge(&faces, |ways| {
            if let [(_, from, a), (_, to, b)] = *ways {
                let [(label, a), (_, b)] = [a, b].map(|face| labels[face as usize]);
                is_closed[label as usize] &= (a != b) == (from == to);
            }
        });
    }
    let mut n_of = vec![[0_usize; 2]; n];
    let mut volume = vec![0.0; n];
    let start = mesh.vertices()[faces[0][0] as usize];
    let mut counted = vec![Count::NONE; n];
    for (k, &(label, is_opposite)) in labels.iter().enumerate().filter(|(k, _)| is_face(&faces[*k])) {
        let label = label as usize;
        n_of[label][usize::from(is_opposite)] += 1;
        let corners = mesh.corners(k);
        let [a, b, c]: [Vector3<f64>; 3] = corners.map(|v| v - start);
        volume[label] += a.dot(&b.cross(&c)) / if is_opposite { -6.0 } else { 6.0 };
        corners.iter().for_each(|v| counted[label].add(v));
    }
    let agrees = |k: usize| n_of[k][0].min(n_of[k][1]) == 0;
    let holds = |outer: usize, inner: usize| {
        let (outer, inner) = (&counted[outer], &counted[inner]);
        (inner.min - outer.min).min() >= 0.0 && (outer.max - inner.max).min() >= 0.0
    };
    let mut by_size: Vec<usize> = (0..n).filter(|k| counted[*k].points > 0 && is_closed[*k]).collect();
    by_size.sort_by(|a, b| volume[*b].abs().total_cmp(&volume[*a].abs()));
    let mut is_turned: BTreeMap<usize, bool> = BTreeMap::new();
    for (at, &k) in by_size.iter().enumerate() {
        let outer = by_size[..at].iter().find(|outer| holds(**outer, k));
        match outer {
            None => is_turned.insert(k, volume[k] < 0.0),
            // Whether the root of an outer part is turned says nothing of one whose faces do not agree.
            Some(outer) => match (is_turned.get(outer), agrees(*outer) && agrees(k)) {
                (Some(&turned), true) => is_turned.insert(k, turned),
                _ => None,
            },
        };
    }
    let is_kept = |k: &usize| !is_turned.contains_key(k);
    turns.n_flipped = (0..n).filter(is_kept).map(|k| n_of[k][0].min(n_of[k][1])).sum();
    let turns_over = |k: usize| {
        let (label, is_opposite) = labels[k];
        is_turned.get(&(label as usize)).is_some_and(|turned| *turned != is_opposite)
    };
    turns.n_turned = (0..faces.len()).filter(|k| turns_over(*k)).count();
    if turns.n_turned == 0 {
        return (mesh.clone(), turns);
    }
    let turned = |(k, &[a, b, c]): (usize, &[u32; 3])| if turns_over(k) { [a, c, b] } else { [a, b, c] };
    let faces: Vec<[u32; 3]> = mesh.faces().iter().enumerate().map(turned).collect();
    let turned = Mesh::new(mesh.frame.clone(), mesh.origin, mesh.vertex_column().clone(), faces);
    (turned.expect("the same corners in another order"), turns)
}

/// Number of faces over the same corners as another before them, whichever way they turn.
fn n_doubled(faces: &[[u32; 3]]) -> usize {
    let mut sorted: Vec<[u32; 3]> = faces.to_vec();
    sorted.iter_mut().for_each(|face| face.sort_unstable());
    sorted.sort_unstable();
    let n = sorted.len();
    sorted.dedup();
    n - sorted.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joined::joined;
    use crate::shapes::{cuboid, inside_out, soup};
    use osteoflow_geometry::SurfaceOrigin;

    #[test]
    fn a_choice_is_a_word_a_number_or_a_place() {
        assert_eq!("largest".parse(), Ok(PartChoice::Rank(1)));
        assert_eq!("3".parse(), Ok(PartChoice::Rank(3)));
        assert_eq!("nearest:1, -2,3e1".parse(), Ok(PartChoice::Nearest(Point3::new(1.0, -2.0, 30.0))));
        for wrong in ["", "0", "-1", "smallest", "nearest:1,2", "nearest:1,2,x", "nearest:1,2,inf", "nearest:1,2,3,4"] {
            let message = wrong.parse::<PartChoice>().unwrap_err();
            assert!(message.contains("such as nearest:10,0,-250") && message.contains(wrong), "{message}");
        }
    }

    #[test]
    fn parts_are_numbered_by_area_and_chosen_by_number_or_place() {
        let (small, large) = (cuboid([0.0; 3], [10.0, 10.0, 20.0]), cuboid([50.0, 0.0, 0.0], [60.0, 20.0, 40.0]));
        for mesh in [joined(&[small.clone(), large.clone()]), soup(&joined(&[small, large]), |_| true)] {
            let parts = Parts::of_mesh(&mesh);
            assert_eq!(parts.list.len(), 2, "{parts:?}");
            assert_eq!((parts.list[0].centre_mm, parts.list[0].extent_mm), ([55.0, 10.0, 20.0], [10.0, 20.0, 40.0]));
            assert_eq!(parts.n_equal(), None);
            let outside = |x: f64, y: f64| parts.list[0].outside_mm(&Point3::new(x, y, 40.0));
            assert_eq!((outside(55.0, 20.0), outside(63.0, 24.0)), (0.0, 5.0));
            let chosen = |choice| parts.chosen_of_mesh(&mesh, choice);
            assert_eq!(chosen(PartChoice::Rank(2)).unwrap(), 1);
            assert_eq!(chosen(PartChoice::Nearest(Point3::new(20.0, 0.0, 0.0))).unwrap(), 1);
            assert_eq!(chosen(PartChoice::Nearest(Point3::new(40.0, 0.0, 0.0))).unwrap(), 0);
            let message = chosen(PartChoice::Rank(3)).unwrap_err().to_string();
            assert!(message.contains("part 3 was asked for, but the surface has 2 (1: "), "{message}");
            let (chosen, whole) = (parts.mesh(&mesh, 1), mesh.vertices().len());
            assert!(chosen.vertices().iter().all(|v| v.x <= 10.0) && chosen.vertices().len() == whole / 2);
        }
    }

    #[test]
    fn equal_parts_beside_each_other_are_told_and_inner_walls_are_not() {
        let at = |x: f64| cuboid([x, 0.0, 0.0], [x + 10.0, 10.0, 20.0]);
        assert_eq!(Parts::of_mesh(&joined(&[at(0.0), at(30.0), cuboid([60.0; 3], [61.0; 3])])).n_equal(), Some(2));
        let wall = cuboid([0.5; 3], [9.5, 9.5, 19.5]);
        assert_eq!(Parts::of_mesh(&joined(&[at(0.0), wall])).n_equal(), None);
    }

    #[test]
    fn points_are_one_cluster_up_to_five_times_their_spacing() {
        let grid = |x: f64, n: u32| (0..n * n).map(move |k| Point3::new(x + f64::from(k % n), f64::from(k / n), 0.0));
        // The columns of the grids are 9 mm apart, or 4.9 mm.
        let points: Vec<_> = grid(0.0, 10).chain(grid(18.0, 5)).collect();
        let parts = Parts::of_points(&points);
        assert_eq!(parts.gap_mm, Some(5.0));
        assert_eq!(parts.list.iter().map(|part| part.n_points).collect::<Vec<_>>(), [100, 25]);
        assert_eq!(parts.points(1), (100..125).collect::<Vec<_>>());
        assert_eq!(parts.chosen_of_points(&points, PartChoice::Nearest(Point3::new(30.0, 0.0, 0.0))).unwrap(), 1);
        let points: Vec<_> = grid(0.0, 10).chain(grid(13.9, 5)).collect();
        assert_eq!(Parts::of_points(&points).list.len(), 1);
        assert_eq!(Parts::of_points(&[Point3::origin(); 3]).list.len(), 1);
        assert!(Parts::of_points(&[]).list.is_empty());
    }

    #[test]
    fn closed_parts_are_turned_outwards_with_their_inner_walls_and_what_is_wrong_elsewhere_is_counted() {
        let outer = cuboid([0.0; 3], [10.0, 10.0, 20.0]);
        let wall = inside_out(&cuboid([1.0; 3], [9.0, 9.0, 19.0]), |_| true);
        let hollow = joined(&[outer.clone(), wall, cuboid([30.0; 3], [35.0; 3])]);
        let n = hollow.faces().len();
        assert_eq!(turned_outwards(&hollow), (hollow.clone(), Turns::default()));
        for mesh in [hollow.clone(), soup(&hollow, |_| true)] {
            let (turned, turns) = turned_outwards(&inside_out(&mesh, |_| true));
            assert_eq!((turned, turns.n_turned, turns.n_flipped), (mesh, n, 0));
        }
        for (is_turned, n_turned) in
            [(&(|k: usize| k == 3) as &dyn Fn(usize) -> bool, 1), (&|k| k % 2 == 0, 6), (&|k| k != 3, 11)]
        {
            let some = inside_out(&outer, is_turned);
            assert_eq!(turned_outwards(&some), (outer.clone(), Turns { n_turned, ..Turns::default() }));
        }
        // Around the wall within another it is open which side is out.
        let within = joined(&[outer.clone(), inside_out(&cuboid([1.0; 3], [9.0, 9.0, 19.0]), |k| k < 3)]);
        assert_eq!(turned_outwards(&within), (within.clone(), Turns { n_flipped: 3, ..Turns::default() }));
        let one = Mesh::new("ct", SurfaceOrigin::User, outer.vertices().to_vec(), outer.faces()[1..].to_vec()).unwrap();
        let one = inside_out(&one, |k| k == 3);
        assert_eq!(turned_outwards(&one), (one.clone(), Turns { n_flipped: 1, ..Turns::default() }), "open");
        let open =
            Mesh::new("ct", SurfaceOrigin::User, outer.vertices().to_vec(), outer.faces()[1..].to_vec()).unwrap();
        let open = inside_out(&open, |_| true);
        assert_eq!(turned_outwards(&open), (open.clone(), Turns::default()));
        let twice: Vec<_> = outer.faces().iter().chain(&outer.faces()[..2]).copied().collect();
        let twice = Mesh::new("ct", SurfaceOrigin::User, outer.vertices().to_vec(), twice).unwrap();
        assert_eq!(turned_outwards(&twice).1.n_doubled, 2);
    }
}
