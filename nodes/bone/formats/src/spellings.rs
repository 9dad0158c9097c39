//! Frames whose names differ by little.

use crate::Sign;
use osteoflow_geometry::Frame;
use std::collections::{BTreeMap, BTreeSet};

/// The names of frames in a file or a recording: those that differ by a leading slash alone are one frame, and those that differ by case or
/// blanks are two, of which one is probably misspelt.
#[derive(Debug, Clone, Default)]
pub struct Spellings {
    names: BTreeMap<String, BTreeSet<String>>,
    /// The frames with and without a leading slash, one sentence each.
    pub notes: Vec<String>,
    /// The frames that differ by case or blanks, one sentence each.
    pub signs: Vec<Sign>,
}

/// The name of a frame without the slash with which ROS 1 lets it begin.
pub fn without_slash(name: &str) -> &str {
    name.strip_prefix('/').filter(|rest| !rest.is_empty()).unwrap_or(name)
}

/// The words of a name in small letters.
pub(crate) fn words(name: &str) -> String {
    let words = without_slash(name.trim()).split(|c: char| c.is_whitespace() || "_-".contains(c));
    words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_").to_lowercase()
}

impl Spellings {
    /// The frame without a leading slash. A second spelling of a frame is told once.
    pub fn take(&mut self, frame: &Frame) -> Frame {
        let (name, plain) = (frame.as_str(), without_slash(frame.as_str()));
        let known = self.names.entry(words(name)).or_default();
        if known.contains(name) {
            return if plain == name { frame.clone() } else { plain.into() };
        }
        if known.iter().any(|other| without_slash(other) == plain) {
            self.notes
                .push(format!("frames \"{plain}\" and \"/{plain}\" differ by the slash alone, and are taken for one"));
        } else if let Some(other) = known.first() {
            let message = format!(
                "frames \"{other}\" and \"{name}\" differ by case, blanks or hyphens alone, and are taken for two; are they one? then give both one name"
            );
            self.signs.push(("frame_names", message));
        }
        known.insert(name.to_owned());
        plain.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(names: &[&str]) -> (Vec<String>, Vec<String>, Vec<String>) {
        let mut spellings = Spellings::default();
        let frames = names.iter().map(|name| spellings.take(&(*name).into()).to_string()).collect();
        (frames, spellings.notes, spellings.signs.into_iter().map(|(_, sign)| sign).collect())
    }

    #[test]
    fn a_leading_slash_is_no_other_frame_and_is_told_once_where_both_spellings_occur() {
        let (frames, notes, signs) = taken(&["map", "/base", "/map", "map", "/map", "/", ""]);
        assert_eq!(
            (&frames[..], &signs[..]),
            (&["map", "base", "map", "map", "map", "/", ""].map(String::from)[..], &[][..])
        );
        assert_eq!(notes, ["frames \"map\" and \"/map\" differ by the slash alone, and are taken for one"]);
    }

    #[test]
    fn names_that_differ_by_case_blanks_or_hyphens_stay_two_and_are_a_sign_and_a_slash_within_is_part_of_the_name() {
        let names = [
            "bone_marker",
            "Bone_Marker",
            "bone marker ",
            "bone-marker",
            "robot/map",
            "robot map",
            "m1_2",
            "m12",
            "bone_markers",
        ];
        let (frames, notes, signs) = taken(&names);
        assert_eq!(frames, names);
        assert_eq!((notes.len(), signs.len()), (0, 3), "{notes:?} {signs:?}");
        assert!(
            signs[0].starts_with("frames \"bone_marker\" and \"Bone_Marker\" differ by case, blanks or hyphens"),
            "{}",
            signs[0]
        );
    }
}
