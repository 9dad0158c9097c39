//! The attributes that are used, of a data set and of the frames in it.

use super::elements::{Element, elements, items, text};

/// Attributes of the geometry, the scaling and the place in a series. All others are passed over, patients' names among them.
const USED: [u32; 32] = [
    0x0008_0008,
    0x0008_0016,
    0x0008_0060,
    0x0018_0050,
    0x0018_1210,
    0x0020_000e,
    0x0020_0011,
    0x0020_0012,
    0x0020_0032,
    0x0020_0037,
    0x0020_0052,
    0x0020_0100,
    0x0020_9056,
    0x0020_9128,
    0x0020_9156,
    0x0028_0002,
    0x0028_0004,
    0x0028_0008,
    0x0028_0010,
    0x0028_0011,
    0x0028_0030,
    0x0028_0100,
    0x0028_0101,
    0x0028_0102,
    0x0028_0103,
    0x0028_0120,
    0x0028_0121,
    0x0028_0301,
    0x0028_1052,
    0x0028_1053,
    0x0028_1054,
    0x0028_3000,
];

/// The sequences of a functional group that hold such attributes: frame content, position, orientation, spacing, scaling.
const GROUPS: [u32; 5] = [0x0020_9111, 0x0020_9113, 0x0020_9116, 0x0028_9110, 0x0028_9145];

/// Bytes of a value that are kept.
const MAX_VALUE: usize = 256;

/// Values by tag; a frame's own come before those of all frames, and these before those of the data set.
#[derive(Debug, Clone, Default)]
pub(super) struct Attributes {
    values: Vec<(u32, Vec<u8>)>,
    is_big: bool,
}

impl Attributes {
    pub(super) fn new(is_big: bool) -> Self {
        Self { values: Vec::new(), is_big }
    }

    /// Takes an element of the data set.
    ///
    /// # Errors
    /// It is there already.
    pub(super) fn take(&mut self, element: &Element<'_>) -> Result<(), String> {
        let tag = element.tag;
        if !USED.contains(&tag) {
            return Ok(());
        }
        if self.value(tag).is_some() {
            return Err(format!("{} is given twice; export the image again", shown(tag)));
        }
        let value = if element.is_items { &[] } else { element.value };
        self.values.push((tag, value[..value.len().min(MAX_VALUE)].to_vec()));
        Ok(())
    }

    /// Attributes of the functional groups in each item of a sequence.
    pub(super) fn of_groups(sequence: &Element<'_>) -> Result<Vec<Self>, String> {
        let syntax = sequence.syntax;
        let mut all = Vec::new();
        for item in items(sequence)? {
            let mut attributes = Self::new(syntax.is_big);
            let mut groups = elements(item, syntax);
            while let Some(group) = groups.next()? {
                if !GROUPS.contains(&group.tag) {
                    continue;
                }
                for inner in items(&group)? {
                    let mut reader = elements(inner, group.syntax);
                    while let Some(element) = reader.next()? {
                        attributes.take(&element)?;
                    }
                }
            }
            all.push(attributes);
        }
        Ok(all)
    }

    /// These before those of `behind`.
    pub(super) fn before(mut self, behind: &Self) -> Self {
        let more: Vec<_> = behind.values.iter().filter(|(tag, _)| self.value(*tag).is_none()).cloned().collect();
        self.values.extend(more);
        self
    }

    fn value(&self, tag: u32) -> Option<&[u8]> {
        self.values.iter().find(|(t, _)| *t == tag).map(|(_, v)| v.as_slice())
    }

    pub(super) fn has(&self, tag: u32) -> bool {
        self.value(tag).is_some()
    }

    pub(super) fn text(&self, tag: u32) -> Option<String> {
        self.value(tag).map(text).filter(|t| !t.is_empty())
    }

    /// A unique identifier; none of other characters.
    pub(super) fn uid(&self, tag: u32) -> Option<String> {
        self.text(tag).filter(|uid| uid.bytes().all(|b| b.is_ascii_digit() || b == b'.'))
    }

    /// A code of capitals, digits, underscores, blanks and the separator of several; anything else is not repeated.
    pub(super) fn code(&self, tag: u32) -> Option<String> {
        let is_code = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b' ' | b'\\');
        self.text(tag).filter(|text| text.bytes().all(is_code))
    }

    /// Decimal numbers, separated by backslashes.
    pub(super) fn decimals(&self, tag: u32) -> Result<Option<Vec<f64>>, String> {
        let Some(text) = self.text(tag) else { return Ok(None) };
        let number = |word: &str| word.trim().parse::<f64>().ok().filter(|n| n.is_finite());
        let numbers: Option<Vec<f64>> = text.split('\\').map(number).collect();
        numbers.map(Some).ok_or_else(|| format!("{} holds no decimal numbers", shown(tag)))
    }

    pub(super) fn decimal(&self, tag: u32) -> Result<Option<f64>, String> {
        match self.decimals(tag)?.as_deref() {
            None => Ok(None),
            Some([one]) => Ok(Some(*one)),
            Some(other) => Err(format!("{} holds {} numbers; one is needed", shown(tag), other.len())),
        }
    }

    pub(super) fn vector<const N: usize>(&self, tag: u32, name: &str) -> Result<[f64; N], String> {
        let missing = || format!("{} {name} is missing; without it nobody knows where the voxels are", shown(tag));
        let numbers = self.decimals(tag)?.ok_or_else(missing)?;
        let n = numbers.len();
        numbers.try_into().map_err(|_| format!("{} {name} holds {n} numbers; {N} are needed", shown(tag)))
    }

    pub(super) fn u16(&self, tag: u32) -> Option<u16> {
        let bytes: [u8; 2] = self.value(tag)?.get(..2)?.try_into().ok()?;
        Some(if self.is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    pub(super) fn u32(&self, tag: u32) -> Option<u32> {
        let bytes: [u8; 4] = self.value(tag)?.get(..4)?.try_into().ok()?;
        Some(if self.is_big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    pub(super) fn needed(&self, tag: u32, name: &str) -> Result<u16, String> {
        self.u16(tag).ok_or_else(|| format!("{} {name} is missing; is it an image of a scanner?", shown(tag)))
    }
}

pub(super) fn shown(tag: u32) -> String {
    format!("({:04x},{:04x})", tag >> 16, tag & 0xffff)
}
