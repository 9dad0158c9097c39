//! Mistakes in the poses of a folder that no single row shows: another name of a marker, parent and child exchanged, the scalar
//! first, another unit of lengths or times.

use crate::{FileError, spellings::words};
use nalgebra::{UnitQuaternion, Vector3};
use osteoflow_geometry::StampNs;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// The children that a tracker reports in a procedure, with their parent.
const MARKERS: [&str; 3] = ["camera_marker", "bone_marker", "phantom_marker"];
const WORLD: &str = "world";

/// Markers are farther apart than this, mm: a camera sees from some hundred millimetres away.
const APART_MM: f64 = 20.0;
/// Markers are not closer to each other than this in metres, mm: poses all in one place say nothing of the unit.
const ONE_PLACE_MM: f64 = 0.01;
/// A marker is farther than this from a tracker, mm.
const FAR_MM: f64 = 50.0;
/// Time between a scan and the poses beyond which they are of other clocks, ns: an hour.
const CLOCK_NS: f64 = 3.6e12;
/// Number of attitudes from which the signs of their quaternions are no coincidence.
const N_ATTITUDES: usize = 6;
/// Attitudes that differ by less are one, rad: of a marker at rest all rows have one sign.
const APART_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Units of times, in ns.
const TIMES: [(f64, &str, &str); 3] = [(1e9, "seconds", "s"), (1e6, "milliseconds", "ms"), (1e3, "microseconds", "us")];

/// A row of a file of poses in which the marker was seen.
#[derive(Debug, Clone)]
pub(super) struct RowRead {
    pub(super) line: u64,
    pub(super) parent: String,
    pub(super) child: String,
    pub(super) stamp_ns: StampNs,
    pub(super) translation: Vector3<f64>,
    pub(super) rotation: UnitQuaternion<f64>,
}

/// A file of poses.
#[derive(Debug)]
pub(super) struct PosesFile {
    /// The file, as it is read.
    pub(super) path: PathBuf,
    pub(super) rows: Vec<RowRead>,
}

/// The first mistake that makes the poses useless.
pub(super) fn check(files: &[PosesFile], scans: &[StampNs]) -> Result<(), FileError> {
    let rows = || files.iter().flat_map(|file| file.rows.iter().map(|row| (&*file.path, row)));
    let occurs = |name: &str| rows().any(|(_, row)| row.child == name);
    rows().try_for_each(|(path, row)| exchanged(path, row, &occurs))?;
    rows().try_for_each(|(path, row)| other_name(path, row, &occurs))?;
    files.iter().try_for_each(metres)?;
    files.iter().try_for_each(|file| times(file, scans))
}

fn fault(path: &Path, line: u64, message: String) -> FileError {
    FileError::content(path, format!("line {line}"), message)
}

/// The world as a child, or as a parent a marker whose own pose never occurs: what is fixed to a marker that is tracked is no mistake.
fn exchanged(path: &Path, row: &RowRead, occurs: &dyn Fn(&str) -> bool) -> Result<(), FileError> {
    let RowRead { line, parent, child, .. } = row;
    let of_marker = MARKERS.contains(&parent.as_str()) && !MARKERS.contains(&child.as_str()) && !occurs(parent);
    if child == WORLD || of_marker {
        let message = format!(
            "parent is \"{parent}\" and child is \"{child}\"; likely cause: parent and child are exchanged, as a row is the pose of a \
             marker (parent {child}, child {parent}); exchange the two, or invert the poses if they are those of the {child} in the \
             marker"
        );
        return Err(fault(path, *line, message));
    }
    Ok(())
}

/// A marker that resembles one of a procedure which never occurs.
fn other_name(path: &Path, row: &RowRead, occurs: &dyn Fn(&str) -> bool) -> Result<(), FileError> {
    let RowRead { line, child, .. } = row;
    let is_known = MARKERS.contains(&child.as_str()) || row.parent != WORLD;
    let is_meant = |marker: &str| words(child) == marker || !occurs(marker) && resembles(child, marker);
    let Some(meant) = MARKERS.into_iter().find(|marker| !is_known && is_meant(marker)) else { return Ok(()) };
    let rows = if occurs(meant) { "other rows have" } else { "no row has" };
    Err(fault(
        path,
        *line,
        format!(
            "the child is \"{child}\", and {rows} the child \"{meant}\"; likely cause: another name of that marker; the markers of a \
             procedure are {}, so call it {meant} here",
            MARKERS.join(", ")
        ),
    ))
}

/// Whether two names share their telling word, or differ by a few letters.
fn resembles(name: &str, marker: &str) -> bool {
    let plain = |text: &str| text.to_lowercase().replace(|c: char| !c.is_ascii_alphanumeric(), "");
    let (name, marker) = (plain(name), plain(marker));
    let word = marker.strip_suffix("marker").unwrap_or(&marker);
    let short = &word[..word.len().min(3)];
    name.contains(word)
        || name.starts_with(short) && name.len() <= marker.len() + 2
        || strsim::levenshtein(&name, &marker) <= 3
}

/// Markers that lie within a few millimetres of each other and of the tracker.
fn metres(file: &PosesFile) -> Result<(), FileError> {
    let mut markers: BTreeMap<&str, &RowRead> = BTreeMap::new();
    for row in file.rows.iter().filter(|row| row.parent == WORLD) {
        markers.entry(&row.child).or_insert(row);
    }
    let at: Vec<_> = markers.values().collect();
    let all = || {
        at.iter().enumerate().flat_map(|(k, a)| at[k + 1..].iter().map(move |b| (a.translation - b.translation).norm()))
    };
    let apart_mm = all().fold(0.0, f64::max);
    let far_mm = at.iter().map(|row| row.translation.norm()).fold(0.0, f64::max);
    if at.len() < 2 || !(ONE_PLACE_MM..=APART_MM).contains(&apart_mm) || far_mm > FAR_MM {
        return Ok(());
    }
    let first = at.iter().min_by_key(|row| row.line).expect("there are two");
    let [x, y, z]: [f64; 3] = first.translation.map(|mm| (mm * 1e5).round() / 1e5).into();
    let message = format!(
        "{} is at {x}, {y}, {z} mm, and all {} markers lie within {apart_mm:.2} mm of each other; likely cause: the poses are in metres; \
         write unit = \"m\" in their [[poses]] of procedure.toml",
        first.child,
        at.len()
    );
    Err(fault(&file.path, first.line, message))
}

/// Stamps of another unit than those of the scans.
fn times(file: &PosesFile, scans: &[StampNs]) -> Result<(), FileError> {
    let stamped = || file.rows.iter().filter(|row| row.stamp_ns != 0 && row.parent == WORLD);
    let Some(first) = stamped().min_by_key(|row| row.line) else { return Ok(()) };
    let ends = stamped().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), row| {
        (low.min(row.stamp_ns as f64), high.max(row.stamp_ns as f64))
    });
    let is_in = |stamp: f64, unit: f64| stamp > ends.0 * unit - CLOCK_NS && stamp < ends.1 * unit + CLOCK_NS;
    for &scan in scans.iter().filter(|&&stamp| stamp != 0) {
        if is_in(scan as f64, 1.0) {
            continue;
        }
        let unit = TIMES.iter().find(|(unit, ..)| is_in(scan as f64, *unit));
        if let Some((unit, name, _)) = unit {
            let (found, meant) = (first.stamp_ns, i128::from(first.stamp_ns) * *unit as i128);
            let message = format!(
                "t_ns is {found}, and a scan is of {scan} ns; likely cause: the stamps are in {name}; write nanoseconds: {meant}"
            );
            return Err(fault(&file.path, first.line, message));
        }
        if let Some((_, name, _)) = TIMES.iter().find(|(unit, ..)| is_in(scan as f64 * unit, 1.0)) {
            let message = format!(
                "t_ns is {}, and the stamp of a scan in procedure.toml is {scan} ns; likely cause: the scan's stamp is in {name}; write \
                 stamp_s, or nanoseconds as stamp_ns",
                first.stamp_ns
            );
            return Err(fault(&file.path, first.line, message));
        }
        let (before, gap_ns) = match (scan as f64) < ends.0 {
            true => ("earlier than the first", ends.0 - scan as f64),
            false => ("later than the last", scan as f64 - ends.1),
        };
        let message = format!(
            "t_ns is {}, and the stamp of a scan in procedure.toml is {scan} ns, {} {before} pose; likely cause: the scan is of another \
             recording, or its clock is not that of the tracker; both need one clock",
            first.stamp_ns,
            duration(gap_ns)
        );
        return Err(fault(&file.path, first.line, message));
    }
    Ok(())
}

/// A duration in the unit in which it is short.
fn duration(ns: f64) -> String {
    let s = ns / 1e9;
    match s {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} minutes", s / 60.0),
        s if s < 172_800.0 => format!("{:.0} hours", s / 3600.0),
        s => format!("{:.0} days", s / 86_400.0),
    }
}

/// The pose of the marker on the phantom, read with the scalar first, where that is what the plan says of it and the pose as it is
/// read is not.
pub(super) fn against_plan(file: &PosesFile, planned: &UnitQuaternion<f64>) -> Result<(), FileError> {
    let Some(row) = file.rows.iter().find(|row| row.parent == "phantom") else { return Ok(()) };
    let q = row.rotation.quaternion();
    let reread = UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q.i, q.j, q.k, q.w));
    let [as_read, as_reread] = [&row.rotation, &reread].map(|turn| turn.angle_to(planned).to_degrees());
    if as_read < SAME_DEG || as_reread > SAME_DEG {
        return Ok(());
    }
    let message = format!(
        "{} in the phantom is turned by {as_read:.1} degrees against the plan, and by {as_reread:.1} if the scalar of its quaternion comes \
         first; likely cause: it does; qx,qy,qz,qw are expected: name the columns in their order, which may be any",
        row.child
    );
    Err(fault(&file.path, row.line, message))
}

/// Turns that are the same but for rounding and a mounted marker, degrees.
const SAME_DEG: f64 = 1.0;

/// A sign that the scalar of the quaternions comes first, in words.
///
/// Programs write a quaternion and not its negative, which is the same rotation, so that the scalar is positive.
pub(super) fn scalar_first(file: &PosesFile) -> Option<String> {
    let first = file.rows.first()?;
    let quaternions = || file.rows.iter().map(|row| (row, row.rotation.quaternion()));
    let half_turn = quaternions().find(|(_, q)| q.i > 1.0 - 1e-9);
    let shown = |q: &nalgebra::Quaternion<f64>| format!("{:.4}, {:.4}, {:.4}, {:.4}", q.i, q.j, q.k, q.w);
    let remedy = "qx,qy,qz,qw are expected: name the columns in their order, which may be any";
    if let Some((row, q)) = half_turn {
        return Some(format!(
            "line {}: the quaternion is {}, half a turn about x; likely cause: the scalar comes first, and it is no rotation at all; {remedy}",
            row.line,
            shown(q)
        ));
    }
    let (n_first, n_last) =
        quaternions().fold((0, 0), |(i, w), (_, q)| (i + usize::from(q.i < 0.0), w + usize::from(q.w < 0.0)));
    let mut attitudes: Vec<UnitQuaternion<f64>> = Vec::new();
    for row in file.rows.iter().take_while(|_| n_first == 0 && n_last > 0) {
        let is_new = attitudes.iter().all(|other| other.angle_to(&row.rotation) > APART_RAD);
        attitudes.extend((is_new && attitudes.len() < N_ATTITUDES).then_some(row.rotation));
    }
    (attitudes.len() == N_ATTITUDES).then(|| {
        format!(
            "line {}: the quaternion is {}, and in all {} rows its first number is positive while its last is negative in {n_last}; likely \
             cause: the scalar comes first; {remedy}",
            first.line,
            shown(first.rotation.quaternion()),
            file.rows.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(line: u64, parent: &str, child: &str, translation: [f64; 3]) -> RowRead {
        let rotation = UnitQuaternion::identity();
        let stamp_ns = 1_750_000_000_000_000_000 + line as i64;
        RowRead {
            line,
            parent: parent.into(),
            child: child.into(),
            stamp_ns,
            translation: translation.into(),
            rotation,
        }
    }

    fn message(rows: Vec<RowRead>, scans: &[StampNs]) -> String {
        let file = PosesFile { path: "poses.csv".into(), rows };
        check(&[file], scans).map_or_else(|error| error.to_string(), |()| String::new())
    }

    const AT: [f64; 3] = [640.0, 1375.0, -200.0];
    const BESIDE: [f64; 3] = [500.0, 1200.0, -150.0];

    #[test]
    fn good_poses_pass() {
        let rows = vec![
            row(2, "world", "camera_marker", AT),
            row(3, "world", "bone_marker", BESIDE),
            row(4, "phantom", "phantom_marker", AT),
        ];
        assert_eq!(message(rows, &[1_750_000_000_500_000_000, 0]), "");
        let pointer = vec![row(2, "world", "camera_marker", AT), row(3, "world", "pointer", BESIDE)];
        assert_eq!(message(pointer, &[]), "", "others may be tracked, too");
        let fixed = vec![row(2, "world", "camera_marker", AT), row(3, "camera_marker", "camera", BESIDE)];
        assert_eq!(message(fixed, &[]), "", "and things fixed to a marker");
    }

    #[test]
    fn each_mistake_is_named_with_its_line_and_likely_cause() {
        let (camera, bone) = (|| row(2, "world", "camera_marker", AT), || row(3, "world", "bone_marker", BESIDE));
        for name in ["cam_marker", "camera-marker", "CameraMarker", "camera", "camera_markr"] {
            let found = message(vec![row(2, "world", name, AT), bone()], &[]);
            let expected = format!(
                "poses.csv: line 2: the child is \"{name}\", and no row has the child \"camera_marker\"; likely cause: another name"
            );
            assert!(found.starts_with(&expected), "{found}");
        }
        let found = message(vec![camera(), row(3, "bone_marker", "world", BESIDE)], &[]);
        assert!(
            found.starts_with(
                "poses.csv: line 3: parent is \"bone_marker\" and child is \"world\"; likely cause: parent and child"
            ),
            "{found}"
        );
        let found = message(vec![camera(), row(3, "bone_marker", "tracker", BESIDE)], &[]);
        assert!(found.starts_with("poses.csv: line 3: parent is \"bone_marker\" and child is \"tracker\""), "{found}");
        let small = |mut row: RowRead| {
            row.translation *= 1e-3;
            row
        };
        let found = message(vec![small(camera()), small(bone())], &[]);
        assert!(
            found.contains("line 2: camera_marker is at 0.64, 1.375, -0.2 mm")
                && found.contains("likely cause: the poses are in metres"),
            "{found}"
        );
        for (unit, name) in [(1e9, "seconds"), (1e6, "milliseconds"), (1e3, "microseconds")] {
            let coarse = |mut row: RowRead| {
                row.stamp_ns = (row.stamp_ns as f64 / unit) as i64;
                row
            };
            let found = message(vec![coarse(camera()), coarse(bone())], &[1_750_000_000_500_000_000]);
            assert!(
                found.starts_with("poses.csv: line 2: t_ns is 1750000000")
                    && found.contains(&format!("the stamps are in {name}")),
                "{found}"
            );
            let found = message(vec![camera(), bone()], &[(1_750_000_000_500_000_000_f64 / unit) as i64]);
            assert!(found.contains(&format!("the scan's stamp is in {name}")), "{found}");
        }
    }

    #[test]
    fn another_spelling_of_a_marker_that_occurs_is_refused_and_its_rows_are_not_left_out() {
        for name in ["Bone_Marker", "bone marker", "bone-marker"] {
            let rows = vec![row(2, "world", "bone_marker", AT), row(3, "world", name, BESIDE)];
            let found = message(rows, &[]);
            let expected = format!("line 3: the child is \"{name}\", and other rows have the child \"bone_marker\"");
            assert!(found.contains(&expected), "{found}");
        }
        let other = vec![row(2, "world", "bone_marker", AT), row(3, "world", "bone_marker_2", BESIDE)];
        assert_eq!(message(other, &[]), "", "another marker");
    }

    #[test]
    fn a_scalar_that_comes_first_shows_in_the_signs_and_in_the_identity() {
        let turned = |k: usize| {
            // The scalar last and positive, as a program writes it.
            let q = UnitQuaternion::from_euler_angles(0.3 * k as f64, -0.2 * k as f64, 0.1 * k as f64);
            if q.w < 0.0 { -q.into_inner() } else { q.into_inner() }
        };
        let file = |is_first: bool| {
            let rows = (0..40).map(|k| {
                let q = turned(k);
                let read = if is_first { nalgebra::Quaternion::new(q.k, q.w, q.i, q.j) } else { q };
                RowRead {
                    rotation: UnitQuaternion::new_unchecked(read),
                    ..row(k as u64 + 2, "world", "camera_marker", AT)
                }
            });
            PosesFile { path: "poses.csv".into(), rows: rows.collect() }
        };
        assert_eq!(scalar_first(&file(false)), None);
        // Of a program that writes either sign, a marker at rest shows one of them.
        let mut at_rest = file(true);
        at_rest.rows.iter_mut().for_each(|row| {
            row.rotation = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(-0.8, 0.4, 0.2, 0.4))
        });
        assert_eq!(scalar_first(&at_rest), None);
        let mut first = file(true);
        first.rows.remove(0);
        let found = scalar_first(&first).expect("it is named");
        assert!(found.starts_with("line 3: ") && found.contains("likely cause: the scalar comes first"), "{found}");
        let found = scalar_first(&file(true)).expect("the identity");
        assert!(
            found.starts_with("line 2: the quaternion is 1.0000, 0.0000, 0.0000, 0.0000, half a turn about x"),
            "{found}"
        );
    }
}
