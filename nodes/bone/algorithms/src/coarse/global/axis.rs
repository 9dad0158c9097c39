//! Long axes of scan and bone.

use super::descent::Placed;
use crate::axes::principal;
use crate::nearest::Nearest;
use crate::target::NearMap;
use crate::union_find::UnionFind;
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_geometry::Cloud;
use std::collections::BTreeMap;

/// Minimum ratio of length to width of a scan whose long axis can be laid along the bone.
const MIN_ELONGATION: f64 = 1.5;

/// Distance of the centroid of one face of a shaft from the shaft's axis, as a share of its mean radius.
const FACE_OFFSET: f64 = 0.6;

/// Minimum share of a surface's points in a bone of its own: less is a crumb of the segmentation.
const MIN_BONE: f64 = 0.15;

/// The scan's long axis and the side from which it was seen.
pub(super) struct Scan {
    along: Vector3<f64>,
    outward: Vector3<f64>,
    pub(super) half_length_mm: f64,
    /// Ratio of length to width.
    pub(super) elongation: f64,
}

impl Scan {
    /// `None` of a scan that is too short for its width to be laid along a bone.
    pub(super) fn new(source: &Cloud) -> Option<Self> {
        let points = source.points();
        let (middle, axes, spread) = principal(points);
        let elongation = (spread[0] / spread[1].max(f64::MIN_POSITIVE)).sqrt();
        if elongation < MIN_ELONGATION {
            return None;
        }
        let along = axes[0];
        let across = |v: Vector3<f64>| (v - along * v.dot(&along)).try_normalize(1e-6);
        let camera = source.viewpoint.map(|t| t * Point3::origin());
        let seen = camera.and_then(|camera| across(camera - middle));
        // The way it bulges: points far out to both sides lie lower.
        let bulge: f64 = points.iter().map(|p| (p - middle).dot(&axes[1]).powi(2) * (p - middle).dot(&axes[2])).sum();
        let outward = seen.or_else(|| across(axes[2] * if bulge > 0.0 { -1.0 } else { 1.0 }))?;
        let heights = points.iter().map(|p| (p - middle).dot(&along));
        let (min, max) = heights.fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(h), b.max(h)));
        Some(Self { along, outward, half_length_mm: (max - min) / 2.0, elongation })
    }
}

/// A position on the bone's centre line where a scan's centroid may lie, about the map's centre.
pub(super) struct Station {
    middle: Vector3<f64>,
    along: Vector3<f64>,
    /// Perpendicular to the bone: turns are counted from it.
    side: Vector3<f64>,
    radius_mm: f64,
}

impl Station {
    /// Turns from `n_turns` on are with the scan reversed end for end.
    pub(super) fn place(&self, scan: &Scan, turn: usize, n_turns: usize) -> Placed {
        let along = if turn < n_turns { self.along } else { -self.along };
        let angle = (turn % n_turns) as f64 / n_turns as f64 * std::f64::consts::TAU;
        let outward = self.side * angle.cos() + self.along.cross(&self.side) * angle.sin();
        let axes = |z: &Vector3<f64>, x: &Vector3<f64>| Rotation3::from_basis_unchecked(&[*x, z.cross(x), *z]);
        let turned = axes(&along, &outward) * axes(&scan.along, &scan.outward).inverse();
        let middle = self.middle + outward * (FACE_OFFSET * self.radius_mm);
        Placed::from_parts(middle.into(), UnitQuaternion::from_rotation_matrix(&turned))
    }
}

/// Positions along each of the bones at which at least half of the scan lies on it.
///
/// A surface of several bones has those of each, and none within another: a marrow canal is no bone.
pub(super) fn stations(map: &NearMap, half_length_mm: f64, slide_mm: f64) -> Vec<Station> {
    let points: Vec<Point3<f64>> = map.samples().iter().step_by(4).map(|s| Point3::from(s.point)).collect();
    let mut all: Vec<Station> = Vec::new();
    for bone in bones(&points) {
        let n_before = all.len();
        for station in along(&bone, half_length_mm, slide_mm) {
            let within = |other: &Station| (station.middle - other.middle).norm() < other.radius_mm;
            if !all[..n_before].iter().any(within) {
                all.push(station);
            }
        }
    }
    all
}

/// The points of each bone, the largest first: connected parts of at least 15 % of the points. All points if there is one only.
fn bones(points: &[Point3<f64>]) -> Vec<Vec<Point3<f64>>> {
    let parts = connected(points);
    let mut large: Vec<Vec<Point3<f64>>> =
        parts.into_iter().filter(|part| part.len() as f64 >= MIN_BONE * points.len() as f64).collect();
    large.sort_by_key(|part| std::cmp::Reverse(part.len()));
    if large.len() < 2 { vec![points.to_vec()] } else { large }
}

/// Parts of which no point is far from the others, in cells of a few spacings.
pub(super) fn connected(points: &[Point3<f64>]) -> Vec<Vec<Point3<f64>>> {
    let some = Nearest::new(points);
    let every = points.len().div_ceil(50).max(1);
    let mut spacings: Vec<f64> = points
        .iter()
        .step_by(every)
        .filter_map(|p| some.nearest_n(p, 7).last().map(|&(k, _)| (points[k] - p).norm()))
        .collect();
    spacings.sort_by(f64::total_cmp);
    let cell_mm = spacings.get(spacings.len() * 9 / 10).map_or(1.0, |mm| mm.max(1e-9));
    let mut cells: BTreeMap<[i64; 3], Vec<u32>> = BTreeMap::new();
    for (k, p) in points.iter().enumerate() {
        let key = std::array::from_fn(|axis| (p[axis] / cell_mm).floor() as i64);
        cells.entry(key).or_default().push(k as u32);
    }
    let mut sets = UnionFind::new(points.len());
    for ([x, y, z], members) in &cells {
        let first = members[0];
        members.iter().for_each(|k| sets.join(first, *k, false));
        for (dx, dy, dz) in (-1..=1).flat_map(|dx| (-1..=1).flat_map(move |dy| (-1..=1).map(move |dz| (dx, dy, dz)))) {
            if let Some(others) = cells.get(&[x + dx, y + dy, z + dz]) {
                sets.join(first, others[0], false);
            }
        }
    }
    let (labels, n_parts) = sets.labels();
    let mut parts = vec![Vec::new(); n_parts];
    for (point, (part, _)) in points.iter().zip(labels) {
        parts[part as usize].push(*point);
    }
    parts
}

fn along(points: &[Point3<f64>], half_length_mm: f64, slide_mm: f64) -> Vec<Station> {
    let (middle, axes, _) = principal(points);
    let height = |p: &Point3<f64>| (p - middle).dot(&axes[0]);
    let (min, max) = points.iter().map(height).fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(h), b.max(h)));
    let n = ((max - min) / slide_mm).ceil() as usize + 1;
    (0..n)
        .filter_map(|k| {
            let at = min + k as f64 * slide_mm;
            let near: Vec<Point3<f64>> =
                points.iter().filter(|p| (height(p) - at).abs() <= half_length_mm).copied().collect();
            if near.len() < 10 {
                return None;
            }
            let (local, local_axes, _) = principal(&near);
            // A piece as short as wide has no axis; use that of the bone.
            let bend = local_axes[0].dot(&axes[0]);
            let along = if bend.abs() > 0.8 { local_axes[0] * bend.signum() } else { axes[0] };
            let side = (axes[1] - along * axes[1].dot(&along)).try_normalize(1e-6)?;
            let from_line = |p: &Point3<f64>| (p - local - along * (p - local).dot(&along)).norm();
            let radius_mm = near.iter().map(from_line).sum::<f64>() / near.len() as f64;
            let centre = local + along * ((middle - local).dot(&along) + at);
            Some(Station { middle: centre.coords, along, side, radius_mm })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::motion;
    use super::*;
    use crate::kabsch::centroid;
    use crate::target::Target;
    use nalgebra::Isometry3;
    use osteoflow_geometry::SurfaceOrigin;

    /// Points of a tube along z of radius 5 mm, from -50 to 50 mm, between two angles from x.
    fn tube(from_deg: f64, to_deg: f64) -> Vec<Point3<f64>> {
        (0..4141)
            .map(|k| {
                let (turn, z) = (f64::from(k % 41) / 40.0, f64::from(k / 41) - 50.0);
                let (sin, cos) = (from_deg + turn * (to_deg - from_deg)).to_radians().sin_cos();
                Point3::new(5.0 * cos, 5.0 * sin, z)
            })
            .collect()
    }

    fn cloud(points: Vec<Point3<f64>>) -> Cloud {
        Cloud::new("scan", points).unwrap()
    }

    fn assert_near(vector: &Vector3<f64>, expected: [f64; 3]) {
        assert!((vector - Vector3::from(expected)).norm() < 1e-9, "{vector} is not {expected:?}");
    }

    #[test]
    fn a_scan_lies_along_its_longest_side_and_its_outside_is_towards_the_camera_or_where_it_bulges() {
        let points = tube(30.0, 150.0);
        let bare = Scan::new(&cloud(points.clone())).unwrap();
        assert_near(&(bare.along * bare.along.z), [0.0, 0.0, 1.0]);
        assert_near(&bare.outward, [0.0, 1.0, 0.0]);
        assert!((bare.half_length_mm - 50.0).abs() < 1e-9);
        // The other way round, the camera decides, not the bulge; what it has along the scan does not count.
        for (camera, outward) in [([0.0, -90.0, 70.0], [0.0, -1.0, 0.0]), ([0.0, 90.0, -300.0], [0.0, 1.0, 0.0])] {
            let seen = cloud(points.clone()).seen_from(Isometry3::translation(camera[0], camera[1], camera[2]));
            let scan = Scan::new(&seen).unwrap();
            assert_near(&scan.outward, outward);
        }
        let hollow = Scan::new(&cloud(tube(210.0, 330.0))).unwrap();
        assert_near(&hollow.outward, [0.0, -1.0, 0.0]);
    }

    #[test]
    fn a_scan_hardly_longer_than_wide_has_no_long_axis() {
        let is_long = |nx: u32, nz: u32| {
            let points = (0..nx * nz).map(|k| Point3::new(f64::from(k % nx), 0.0, f64::from(k / nx)));
            Scan::new(&cloud(points.collect())).is_some()
        };
        // The variance of n points in a row is (n² - 1) / 12: 1.4504 and 1.5508 times as long as wide.
        assert!(!is_long(20, 29) && is_long(20, 31) && is_long(4, 50));
    }

    #[test]
    fn axes_and_variances_of_points_come_the_longest_first() {
        let points: Vec<Point3<f64>> = [[1.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.0]]
            .into_iter()
            .flat_map(|p| [1.0, -1.0].map(|sign| Point3::from(Vector3::from(p) * sign + Vector3::new(7.0, 8.0, 9.0))))
            .collect();
        let (middle, axes, variances) = principal(&points);
        assert_near(&middle.coords, [7.0, 8.0, 9.0]);
        assert_near(&variances.into(), [3.0, 4.0 / 3.0, 1.0 / 3.0]);
        assert_eq!(axes.map(|axis| axis.iamax()), [1, 2, 0]);
    }

    #[test]
    fn a_scan_is_laid_along_a_station_and_turned_about_it_both_ways_round() {
        let points = tube(30.0, 150.0);
        let scan = Scan::new(&cloud(points)).unwrap();
        let (middle, along, side) = (Vector3::new(1.0, 2.0, 3.0), Vector3::x(), Vector3::y());
        let station = Station { middle, along, side, radius_mm: 4.0 };
        // A quarter of a turn from y about x is z; the centroid is 0.6 of the radius off the axis.
        for (turn, outward, along) in [
            (0, Vector3::y(), 1.0),
            (3, Vector3::z(), 1.0),
            (6, -Vector3::y(), 1.0),
            (11, Vector3::new(0.0, 0.75_f64.sqrt(), -0.5), 1.0),
            (12, Vector3::y(), -1.0),
            (15, Vector3::z(), -1.0),
        ] {
            let placed = station.place(&scan, turn, 12);
            assert_near(&placed.translation.vector, (middle + outward * 2.4).into());
            assert_near(&(placed.rotation * scan.outward), outward.into());
            assert_near(&(placed.rotation * scan.along), [along, 0.0, 0.0]);
        }
    }

    #[test]
    fn stations_follow_the_axis_of_a_tube_from_end_to_end() {
        let points: Vec<Point3<f64>> =
            tube(0.0, 360.0 * 40.0 / 41.0).iter().map(|p| p + Vector3::new(10.0, 20.0, 30.0)).collect();
        let target = Target::new("ct", SurfaceOrigin::Exact, points, None).unwrap();
        let map = NearMap::new(&target);
        let places = stations(&map, 30.0, 12.0);
        // Of 100 mm: ten steps and one on, whose half of a scan still touches the end.
        assert_eq!(places.len(), 10);
        let down = places[0].along.z.signum();
        for (k, station) in places.iter().enumerate() {
            // A piece at an end has its centroid 15 mm from it, but the station is where the scan's would be.
            let off = station.middle + map.centre().coords - Vector3::new(10.0, 20.0, 30.0);
            let expected = (k as f64 * 12.0 - 50.0) * down;
            // Every fourth point is not quite even around the tube.
            assert!((off.z - expected).abs() < 0.4 && off.xy().norm() < 0.4, "station {k} is at {off}");
            assert!((station.along.z * down - 1.0).abs() < 1e-3 && station.side.dot(&station.along).abs() < 1e-9);
            assert!((station.radius_mm - 5.0).abs() < 0.1, "{} mm", station.radius_mm);
        }
        let scan = Scan::new(&cloud(tube(30.0, 150.0))).unwrap();
        let placed = places[4].place(&scan, 5, 12);
        let middle = centroid(&tube(30.0, 150.0));
        let motion = motion(&map, &middle, &placed);
        assert_near(&(motion * middle).coords, (map.centre().coords + placed.translation.vector).into());
        assert_eq!(motion.rotation, placed.rotation);
        let far = stations(&map, 0.3, 12.0);
        // A ring of 41 points, every fourth of which is kept, is as wide as long: the axis is that of the tube.
        assert!(far.iter().all(|s| (s.along.z.abs() - 1.0).abs() < 1e-3), "{} stations", far.len());
    }

    #[test]
    fn each_of_two_bones_has_stations_of_its_own_and_a_canal_or_a_crumb_has_none() {
        let ring = || tube(0.0, 360.0 * 40.0 / 41.0);
        let n_at = |points: Vec<Point3<f64>>, middle: [f64; 2]| {
            let target = Target::new("ct", SurfaceOrigin::Exact, points, None).unwrap();
            let map = NearMap::new(&target);
            let off = |s: &Station| (s.middle + map.centre().coords).xy() - nalgebra::Vector2::from(middle);
            stations(&map, 30.0, 12.0).iter().filter(|s| off(s).norm() < 0.5).count()
        };
        let beside = |mm: f64| ring().into_iter().map(move |p| p + Vector3::x() * mm);
        let two = || ring().into_iter().chain(beside(40.0)).collect::<Vec<_>>();
        assert_eq!((n_at(two(), [0.0, 0.0]), n_at(two(), [40.0, 0.0])), (10, 10));
        let canal = ring().into_iter().map(|p| Point3::new(0.4 * p.x, 0.4 * p.y, p.z));
        assert_eq!(n_at(ring().into_iter().chain(canal).collect(), [0.0, 0.0]), 10);
        let crumb = beside(40.0).filter(|p| p.z > 40.0);
        let all = ring().into_iter().chain(crumb).collect();
        assert_eq!(n_at(all, [40.0, 0.0]), 0);
    }
}
