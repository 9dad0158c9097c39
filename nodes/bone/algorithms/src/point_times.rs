//! The times of a cloud's points, as other programs write them.

use osteoflow_geometry::{Cloud, StampNs, time_column};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The column that has the times in seconds from the cloud's stamp.
pub const POINT_TIME: &str = "t_from_stamp_s";

/// Longest and shortest time that a cloud takes, and how far its points are from its stamp, s.
const LONGEST_S: f64 = 30.0;
const SHORTEST_S: f64 = 1e-3;
const NEAR_S: f64 = 60.0;

/// The units that are tried, s.
const UNITS: [f64; 4] = [1.0, 1e-3, 1e-6, 1e-9];

/// The unit of the times of points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PointTimeUnit {
    /// As the column's name says (`t_ns`), or else the largest unit in which the cloud takes at most 30 s.
    #[default]
    Auto,
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
    /// The columns are no times.
    Ignored,
}

impl PointTimeUnit {
    /// In seconds.
    fn stated(self) -> Option<f64> {
        match self {
            Self::S => Some(1.0),
            Self::Ms => Some(1e-3),
            Self::Us => Some(1e-6),
            Self::Ns => Some(1e-9),
            Self::Auto | Self::Ignored => None,
        }
    }
}

/// The times of a cloud's points.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTimes {
    /// Of each point, from the cloud's stamp, ns.
    pub after_ns: Vec<StampNs>,
    /// The earliest and the latest, s.
    pub span_s: [f64; 2],
    /// The column's name.
    pub name: String,
}

/// A column that is named as times and holds none of the cloud's.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "column \"{name}\" has values from {least} to {most}, which in no unit are times of points within 60 s of the cloud's stamp: its clock is \
     another one, or it is no time; the cloud is taken for one whose points have no times (point_times = \"s\", \"ms\", \"us\" or \"ns\" states \
     the unit, \"ignored\" that it is no time)"
)]
pub struct NoTimes {
    name: String,
    least: f64,
    most: f64,
}

/// The times of a cloud's points: of the column [`POINT_TIME`], or one that other programs call so, from the stamp of the cloud or since 1970.
/// None without such a column, or where all its values are alike. `O(n)`.
///
/// # Errors
/// [`NoTimes`] where the values are no times near the cloud's stamp.
pub fn point_times(cloud: &Cloud, unit: PointTimeUnit) -> Result<Option<PointTimes>, NoTimes> {
    if unit == PointTimeUnit::Ignored {
        return Ok(None);
    }
    let named = cloud.extras().iter().filter_map(|(name, values)| Some((time_column(name)?, name, values)));
    let Some(((_, of_name), name, values)) = named.min_by_key(|((rank, _), ..)| *rank) else { return Ok(None) };
    let (least, most) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    let no_times = || NoTimes { name: name.to_string(), least, most };
    if !values.iter().all(|value| value.is_finite()) {
        return Err(no_times());
    }
    if least >= most {
        return Ok(None);
    }
    let stated = unit.stated().or(of_name);
    let units = stated.map_or(UNITS.to_vec(), |unit| vec![unit]);
    // Times since 1970 leave no doubt about their unit.
    let origins =
        [cloud.stamp_ns, 0].into_iter().flat_map(|origin_ns| units.iter().map(move |unit| (origin_ns, *unit)));
    let is_near = |(origin_ns, unit_s): &(StampNs, f64)| {
        let [from_s, to_s] = [least, most].map(|value| value * unit_s - *origin_ns as f64 / 1e9);
        let is_usual = (SHORTEST_S..=LONGEST_S).contains(&(to_s - from_s));
        from_s.abs().max(to_s.abs()) <= NEAR_S && (stated.is_some() || is_usual)
    };
    let (origin_ns, unit_s) = origins.into_iter().find(is_near).ok_or_else(no_times)?;
    // Whole units first: a time since 1970 in ns is exact to 256 ns only, and must not lose more.
    let unit_ns = (unit_s * 1e9).round();
    let after_ns = |value: &f64| {
        let (whole, rest) = (value.trunc(), value.fract());
        (whole as i128 * unit_ns as i128 + (rest * unit_ns).round() as i128 - i128::from(origin_ns)) as StampNs
    };
    let after_ns: Vec<StampNs> = values.iter().map(after_ns).collect();
    let ends = [after_ns.iter().min(), after_ns.iter().max()];
    let span_s = ends.map(|ns| ns.map_or(0.0, |ns| *ns as f64 / 1e9));
    Ok(Some(PointTimes { after_ns, span_s, name: name.to_string() }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    const STAMP_NS: StampNs = 1_750_000_011_000_000_000;

    fn read(name: &str, values: [f64; 3], unit: PointTimeUnit) -> Result<Option<PointTimes>, NoTimes> {
        let points: Vec<Point3<f64>> = (0..3).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect();
        let cloud = Cloud::new("camera", points).unwrap().at(STAMP_NS);
        let cloud = cloud.with_extra("intensity", vec![1.0, 2.0, 3.0]).unwrap();
        point_times(&cloud.with_extra(name, values.to_vec()).unwrap(), unit)
    }

    fn seconds(name: &str, values: [f64; 3]) -> Vec<f64> {
        let times = read(name, values, PointTimeUnit::Auto).unwrap().unwrap();
        times.after_ns.iter().map(|ns| *ns as f64 / 1e9).collect()
    }

    #[test]
    fn times_are_read_as_drivers_write_them() {
        // Velodyne: seconds, to the stamp; Ouster and Livox: nanoseconds, from it; RoboSense and Hesai: seconds since 1970.
        assert_eq!(seconds("time", [-0.1, -0.05, 0.0]), [-0.1, -0.05, 0.0]);
        assert_eq!(seconds("t", [0.0, 5e7, 1e8]), [0.0, 0.05, 0.1]);
        assert_eq!(seconds("offset_time", [0.0, 5e7, 1e8]), [0.0, 0.05, 0.1]);
        let near = |found: Vec<f64>, wanted: [f64; 3]| {
            assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 3e-7), "{found:?}, not {wanted:?}");
        };
        near(seconds("timestamp", [1_750_000_010.5, 1_750_000_011.0, 1_750_000_012.25]), [-0.5, 0.0, 1.25]);
        near(seconds("Timestamp", [1_750_000_010.5e9, 1_750_000_011e9, 1_750_000_012.25e9]), [-0.5, 0.0, 1.25]);
        near(seconds("stamp", [1_750_000_010.5e3, 1_750_000_011e3, 1_750_000_012.25e3]), [-0.5, 0.0, 1.25]);
        // A sweep by hand, and times in no order.
        assert_eq!(seconds("t", [3.0, 0.0, 1.5]), [3.0, 0.0, 1.5]);
        assert_eq!(seconds("t", [0.0, 3000.0, 1500.0]), [0.0, 3.0, 1.5]);
        assert_eq!(seconds("time_ms", [0.0, 20.0, 10.0]), [0.0, 0.02, 0.01]);
    }

    #[test]
    fn a_unit_that_is_stated_is_used_and_a_column_that_is_no_time_can_be_said_to_be_none() {
        let times = read("t", [0.0, 2e7, 1e7], PointTimeUnit::Ns).unwrap().unwrap();
        assert_eq!((times.span_s, times.name.as_str()), ([0.0, 0.02], "t"));
        assert_eq!(read("t", [0.0, 2e7, 1e7], PointTimeUnit::Ignored), Ok(None));
        // Temperatures are at most a minute, which the poses then contradict.
        assert_eq!(read("t", [36.5, 37.0, 38.0], PointTimeUnit::Auto).unwrap().unwrap().span_s, [36.5, 38.0]);
    }

    #[test]
    fn a_constant_is_no_time_and_a_clock_of_its_own_is_told() {
        assert_eq!(read("t", [4.0; 3], PointTimeUnit::Auto), Ok(None));
        assert_eq!(read("depth", [1.0, 2.0, 3.0], PointTimeUnit::Auto), Ok(None));
        // Seconds of the week, an hour later, and no number.
        let told = read("gps_time", [345_600.1, 345_601.0, 345_603.0], PointTimeUnit::S).unwrap_err().to_string();
        assert!(told.starts_with("column \"gps_time\" has values from 345600.1 to 345603, which in no unit"), "{told}");
        assert!(read("time", [1_750_003_611.0, 1_750_003_612.0, 1_750_003_613.0], PointTimeUnit::Auto).is_err());
        assert!(read("time", [0.0, f64::NAN, 1.0], PointTimeUnit::Auto).is_err());
    }
}
