/// The names of columns with the times of points, without the unit that may follow, in the order in which they are looked for: ours, and those
/// of Velodyne, Ouster, Livox, Hesai and RoboSense drivers and of LAS files.
const NAMES: [&str; 12] = [
    "t_from_stamp",
    "t",
    "time",
    "times",
    "timestamp",
    "timestamps",
    "time_stamp",
    "stamp",
    "offset_time",
    "time_offset",
    "t_offset",
    "gps_time",
];

/// The units that may follow, each in seconds.
const UNITS: [(&str, f64); 6] =
    [("_s", 1.0), ("_sec", 1.0), ("_ms", 1e-3), ("_us", 1e-6), ("_ns", 1e-9), ("_nsec", 1e-9)];

/// Whether a column is named as one with the times of points: its rank among such names, the lower the sooner, and the unit that its name
/// states, s.
pub fn time_column(name: &str) -> Option<(usize, Option<f64>)> {
    let name = name.to_ascii_lowercase();
    let unit = UNITS.iter().find_map(|(end, seconds)| Some((name.strip_suffix(end)?, Some(*seconds))));
    let rank = |(stem, unit): (&str, Option<f64>)| Some((NAMES.iter().position(|known| *known == stem)?, unit));
    rank((&name, None)).or_else(|| rank(unit?))
}
