//! The anatomical axes that a file states for its coordinates.

use nalgebra::{Quaternion, Unit, UnitQuaternion};
use osteoflow_geometry::Frame;
use std::fmt;

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

    /// The rotation between coordinates in this space and LPS, in both directions; the identity if unknown.
    pub fn turn(self) -> UnitQuaternion<f64> {
        match self {
            Self::Ras => Unit::new_unchecked(Quaternion::new(0.0, 0.0, 0.0, 1.0)),
            Self::Lps | Self::Unknown => UnitQuaternion::identity(),
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

/// The statements `SPACE=LPS` and `SPACE=RAS` in the comments of a file, as 3D Slicer writes them.
#[derive(Debug, Default)]
pub(crate) struct StatedSpace {
    pub(crate) space: Space,
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
    /// A message if it contradicts an earlier one.
    pub(crate) fn take(&mut self, comment: &str) -> Result<(), String> {
        const KEY: &str = "SPACE=";
        for (at, _) in comment.match_indices(KEY) {
            if comment[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_') {
                continue;
            }
            let rest = &comment[at + KEY.len()..];
            let value = &rest[..rest.find(|c: char| !c.is_alphanumeric()).unwrap_or(rest.len())];
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_space_is_found_in_any_comment_and_a_contradiction_is_refused() {
        let of = |text| StatedSpace::of(text).map(|s| (s.space, s.note.is_some()));
        assert_eq!(of("3D Slicer output. SPACE=LPS"), Ok((Space::Lps, false)));
        assert_eq!(of("SPACE=RAS;UNIT=mm"), Ok((Space::Ras, false)));
        assert_eq!(of("COLORSPACE=RAS, SPACED"), Ok((Space::Unknown, false)));
        assert_eq!(of("SPACE=scanner"), Ok((Space::Unknown, true)));
        assert_eq!(of("SPACE=RAS SPACE=LPS"), Err("SPACE=LPS contradicts SPACE=RAS before it".into()));
    }
}
