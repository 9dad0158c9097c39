//! Distance between two numbers.

/// A number of a view, as stored.
#[derive(Debug, Clone, Copy)]
pub(super) enum Scalar {
    Double(f64),
    Single(f32),
    Int(i64),
}

/// Distance between two numbers with different bits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Distance {
    /// In steps between adjacent representable numbers; `None` for integers and NaN.
    pub(super) ulp: Option<u64>,
    /// Absolute difference; `None` for NaN.
    pub(super) distance: Option<f64>,
    /// Additional note.
    pub(super) note: Option<&'static str>,
}

impl Scalar {
    /// `None` if both have the same bits.
    pub(super) fn apart(self, other: Self) -> Option<Distance> {
        match (self, other) {
            (Self::Double(a), Self::Double(b)) => (a.to_bits() != b.to_bits())
                .then(|| floats(a, b, ulp(ordered(a.to_bits(), 64), ordered(b.to_bits(), 64)))),
            (Self::Single(a), Self::Single(b)) => (a.to_bits() != b.to_bits()).then(|| {
                let ulp = ulp(ordered(a.to_bits().into(), 32), ordered(b.to_bits().into(), 32));
                floats(a.into(), b.into(), ulp)
            }),
            (Self::Int(a), Self::Int(b)) => (a != b).then(|| {
                let distance = Some(a.abs_diff(b) as f64);
                Distance { ulp: None, distance, note: None }
            }),
            _ => Some(Distance { ulp: None, distance: None, note: Some("they are of different types") }),
        }
    }

    /// Formats the number in full: parsing it gives the same bits.
    pub(super) fn format(self) -> String {
        match self {
            Self::Double(x) => format_float(x, x.to_bits(), x.is_nan()),
            Self::Single(x) => format_float(x, x.to_bits().into(), x.is_nan()),
            Self::Int(x) => x.to_string(),
        }
    }
}

fn format_float(x: impl std::fmt::Debug, bits: u64, is_nan: bool) -> String {
    if is_nan { format!("NaN (bits {bits:x})") } else { format!("{x:?}") }
}

/// Maps floats to integers in the order of their values; both zeros become 0.
fn ordered(bits: u64, width: u32) -> i128 {
    let sign = 1_u64 << (width - 1);
    let magnitude = i128::from(bits & (sign - 1));
    if bits & sign == 0 { magnitude } else { -magnitude }
}

fn ulp(a: i128, b: i128) -> u64 {
    u64::try_from((a - b).abs()).unwrap_or(u64::MAX)
}

fn floats(a: f64, b: f64, ulp: u64) -> Distance {
    if a.is_nan() || b.is_nan() {
        let both = a.is_nan() && b.is_nan();
        let note = if both { "both are NaN, of different bits" } else { "one is NaN" };
        return Distance { ulp: None, distance: None, note: Some(note) };
    }
    let note = (ulp == 0).then_some("they differ in the sign of a zero");
    Distance { ulp: Some(ulp), distance: Some((a - b).abs()), note }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apart(a: f64, b: f64) -> Option<Distance> {
        Scalar::Double(a).apart(Scalar::Double(b))
    }

    #[test]
    fn distances_count_representable_numbers() {
        assert_eq!(apart(1.0, 1.0), None);
        assert_eq!(apart(f64::NAN, f64::NAN), None);
        assert_eq!(apart(1.0, 1.0 + f64::EPSILON).unwrap().ulp, Some(1));
        assert_eq!(apart(-f64::from_bits(1), f64::from_bits(1)).unwrap().ulp, Some(2));
        let zeros = apart(0.0, -0.0).unwrap();
        assert_eq!((zeros.ulp, zeros.distance), (Some(0), Some(0.0)));
        assert!(zeros.note.unwrap().contains("sign of a zero"));
        assert!(apart(f64::NAN, -f64::NAN).unwrap().note.unwrap().contains("different bits"));
        assert_eq!(apart(f64::NAN, 0.0).unwrap().distance, None);
        assert_eq!(apart(f64::NEG_INFINITY, f64::INFINITY).unwrap().distance, Some(f64::INFINITY));
        assert_eq!(Scalar::Single(1.0).apart(Scalar::Single(1.0 + f32::EPSILON)).unwrap().ulp, Some(1));
        assert_eq!(Scalar::Int(i64::MIN).apart(Scalar::Int(i64::MAX)).unwrap().distance, Some(u64::MAX as f64));
    }
}
