//! The anatomical axes that a file states for its coordinates.

use crate::{FileError, unit};
use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion};
use osteoflow_geometry::Frame;
use std::{fmt, path::Path};

/// The axes of a patient's coordinates, as a file states them.
///
/// DICOM, ITK and this project use LPS; the scene of 3D Slicer uses RAS. A file of a scanner states neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Space {
    /// x to the patient's left, y to posterior, z to superior.
    Lps,
    /// x to the patient's right, y to anterior, z to superior: LPS with x and y negated.
    Ras,
    /// Not stated; the coordinates are taken as they are.
    #[default]
    Unknown,
}

impl fmt::Display for Space {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Lps => "LPS",
            Self::Ras => "RAS",
            Self::Unknown => "unknown",
        })
    }
}

impl Space {
    /// The space of coordinates in a frame: `ct` is LPS, the others are no patient's.
    pub fn of(frame: &Frame) -> Self {
        if frame.as_str() == "ct" { Self::Lps } else { Self::Unknown }
    }

    /// The beginning of the note of [`taken_for_lps`](Self::taken_for_lps).
    pub const TAKEN_FOR_LPS: &str = "the file states no space: its numbers are taken for LPS, as 3D Slicer takes them";

    /// A note, if a file states no space and is read into `frame`, which is LPS.
    pub fn taken_for_lps(self, frame: &Frame) -> Option<String> {
        let is_taken = self == Self::Unknown && Self::of(frame) == Self::Lps;
        is_taken.then(|| Self::TAKEN_FOR_LPS.into())
    }

    /// The rotation between coordinates in this space and LPS, in both directions; the identity if unknown.
    pub fn turn(self) -> UnitQuaternion<f64> {
        match self {
            Self::Ras => Unit::new_unchecked(Quaternion::new(0.0, 0.0, 0.0, 1.0)),
            Self::Lps | Self::Unknown => UnitQuaternion::identity(),
        }
    }

    /// The motion to LPS of the coordinates of a file that states `self` and is read in `space`; none if they are LPS already.
    ///
    /// # Errors
    /// A message, if the file states another.
    pub(crate) fn turn_to(self, space: Self) -> Result<Option<Isometry3<f64>>, String> {
        match self {
            Self::Unknown => {
                Ok((space == Self::Ras).then(|| Isometry3::from_parts(Translation3::identity(), space.turn())))
            }
            stated if stated == space => Ok(None),
            stated => Err(format!("the file states SPACE={stated}")),
        }
    }

    /// The factor of x and y between this space and LPS, in both directions.
    pub(crate) fn x_y_sign(self) -> f64 {
        if self == Self::Ras { -1.0 } else { 1.0 }
    }

    /// `SPACE=LPS` or `SPACE=RAS`, for a comment; none if unknown.
    pub(crate) fn tag(self) -> Option<String> {
        (self != Self::Unknown).then(|| format!("SPACE={self}"))
    }
}

/// The statements `SPACE=LPS`, `SPACE=RAS` and `UNIT=mm` in the comments of a file, as 3D Slicer writes them, and units [in other
/// words](unit::stated).
#[derive(Debug, Default)]
pub(crate) struct StatedSpace {
    pub(crate) space: Space,
    /// The unit of length.
    pub(crate) unit: Option<unit::Statement>,
    pub(crate) note: Option<String>,
}

impl StatedSpace {
    /// The statement in a text without lines, such as the header of a binary STL.
    pub(crate) fn of(comment: &str) -> Result<Self, String> {
        let mut stated = Self::default();
        stated.take(comment)?;
        Ok(stated)
    }

    /// Takes a comment into account.
    ///
    /// # Errors
    /// A message if it contradicts an earlier one, or states a unit of an unknown name.
    pub(crate) fn take(&mut self, comment: &str) -> Result<(), String> {
        for (text, mm) in unit::stated(comment)? {
            match &self.unit {
                Some((first, first_mm)) if !is_same(mm, *first_mm) => {
                    return Err(format!("{text} contradicts {first} before it"));
                }
                Some(_) => {}
                None => self.unit = Some((text, mm)),
            }
        }
        for value in values(comment, "SPACE") {
            let space = match value {
                "LPS" => Space::Lps,
                "RAS" => Space::Ras,
                _ => {
                    self.note = Some(format!(
                        "the file states SPACE={value}, which is neither LPS nor RAS; the coordinates are taken as they are"
                    ));
                    continue;
                }
            };
            if self.space != Space::Unknown && self.space != space {
                return Err(format!("SPACE={space} contradicts SPACE={} before it", self.space));
            }
            self.space = space;
        }
        Ok(())
    }

    /// Checks the stated unit against the one that the file is read in.
    ///
    /// # Errors
    /// A message, if it is another or unknown.
    pub(crate) fn check_unit(&self, unit_mm: f64) -> Result<(), String> {
        match &self.unit {
            Some((text, stated_mm)) if !is_same(*stated_mm, unit_mm) => Err(format!(
                "the file states {text}, but is read in units of {unit_mm} mm; give unit_mm = {stated_mm} (register: --unit-mm, convert: --scale times {})",
                stated_mm / unit_mm
            )),
            _ => Ok(()),
        }
    }
}

/// Checks what the comments of a text, which begin with `#`, `//` or `%`, state of its unit against the one that it is read in.
///
/// # Errors
/// [`FileError`], naming the line: another unit, or an unknown one.
pub(crate) fn check_comments(path: &Path, text: &[u8], unit_mm: f64) -> Result<(), FileError> {
    let mut stated = StatedSpace::default();
    for (k, line) in text.split(|b| *b == b'\n').enumerate() {
        let begins = |at: usize| matches!(line[at], b'#' | b'%') || line[at..].starts_with(b"//");
        let Some(at) = (0..line.len()).find(|at| begins(*at)) else { continue };
        let comment = String::from_utf8_lossy(&line[at..]);
        let taken = stated.take(comment.trim_start_matches('/')).and_then(|()| stated.check_unit(unit_mm));
        taken.map_err(|message| FileError::content(path, format!("line {}", k + 1), message))?;
    }
    Ok(())
}

/// Whether two units are one, up to rounding.
pub(crate) fn is_same(a_mm: f64, b_mm: f64) -> bool {
    (a_mm / b_mm - 1.0).abs() < 1e-9
}

/// The words behind each `key` that is a word of its own, and the equals sign after it, with or without blanks.
fn values<'a>(comment: &'a str, key: &'static str) -> impl Iterator<Item = &'a str> {
    let is_own = |at: usize| !comment[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
    comment.match_indices(key).filter(move |(at, _)| is_own(*at)).filter_map(move |(at, _)| {
        let rest = comment[at + key.len()..].trim_start().strip_prefix('=')?.trim_start();
        Some(&rest[..rest.find(|c: char| !c.is_alphanumeric()).unwrap_or(rest.len())])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_space_is_found_in_any_comment_and_a_contradiction_is_refused() {
        let of = |text| StatedSpace::of(text).map(|s| (s.space, s.note.is_some()));
        assert_eq!(of("3D Slicer output. SPACE=LPS"), Ok((Space::Lps, false)));
        assert_eq!(of("SPACE=RAS;UNIT=mm"), Ok((Space::Ras, false)));
        assert_eq!(of("SPACE = RAS"), Ok((Space::Ras, false)));
        assert_eq!(of("space of RAS; SPACE RAS; SPACE =LPS"), Ok((Space::Lps, false)));
        assert_eq!(of("COLORSPACE=RAS, SPACED"), Ok((Space::Unknown, false)));
        assert_eq!(of("SPACE=scanner"), Ok((Space::Unknown, true)));
        assert_eq!(of("SPACE=RAS SPACE=LPS"), Err("SPACE=LPS contradicts SPACE=RAS before it".into()));
    }

    #[test]
    fn comments_of_logs_and_matrices_state_their_unit_wherever_they_begin() {
        let check = |text: &str, unit_mm| {
            check_comments("a.txt".as_ref(), text.as_bytes(), unit_mm).map_err(|error| error.to_string())
        };
        for text in ["time,Tx,Tx#2,x y\n1,2,3,4\n", "# poses of a tool\n1 2 3\n", "# units: mm\n1 2 3 # unit: mm\n", ""]
        {
            assert_eq!(check(text, 1.0), Ok(()), "{text}");
        }
        for (text, place) in [
            ("# units: m\n1 2 3\n", "line 1: the file states units: m,"),
            ("1 0 0 10 # units: m\n", "line 1: the file states units: m,"),
            ("\n// Units: inches\n1 2 3\n", "line 2: the file states Units: inches,"),
            ("% 1 unit = 10 mm\n1 2 3\n", "line 1: the file states 1 unit=10 mm,"),
            ("# units: mm\n# units: m\n", "line 2: units: m contradicts units: mm before it"),
            ("# units: lightyears\n", "line 1: the file states units=lightyears, which is not mm"),
        ] {
            let said = check(text, 1.0).unwrap_err();
            assert!(said.starts_with(&format!("a.txt: {place}")), "{said}");
        }
        let said = check("# units: mm\n1 2 3 4\n", 1000.0).unwrap_err();
        assert!(said.ends_with("give unit_mm = 1 (register: --unit-mm, convert: --scale times 0.001)"), "{said}");
    }

    #[test]
    fn a_stated_unit_is_that_of_the_reader_or_refused() {
        let of = |text, unit_mm| StatedSpace::of(text).and_then(|stated| stated.check_unit(unit_mm));
        assert_eq!(of("3D Slicer output. SPACE=RAS;UNIT=mm", 1.0), Ok(()));
        assert_eq!(of("UNIT=m", 1000.0), Ok(()));
        assert_eq!(of("no unit; LASTUNIT=m", 1.0), Ok(()));
        let message = |text, unit_mm| of(text, unit_mm).unwrap_err();
        assert!(message("UNIT=m", 1.0).contains("read in units of 1 mm; give unit_mm = 1000 ("));
        assert!(message("UNIT=mm", 1000.0).contains("give unit_mm = 1 ("));
        assert!(
            message("# 1 unit = 10 mm", 1.0)
                .contains("states 1 unit=10 mm, but is read in units of 1 mm; give unit_mm = 10 (")
        );
        assert!(message("UNIT=inch", 1.0).contains("give unit_mm = 25.4 ("));
        assert!(message("UNIT=furlong", 1.0).contains("not mm, cm, m, um"));
        assert_eq!(message("UNIT=m UNITS=mm", 1.0), "UNITS=mm contradicts UNIT=m before it");
    }
}
