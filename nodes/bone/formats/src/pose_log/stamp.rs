//! Stamps in text, digit by digit.

use osteoflow_geometry::StampNs;

/// Nanoseconds of a decimal number of units of `10^exponent` nanoseconds, such as 9 for seconds, rounded to the nearest.
///
/// A float of seconds since 1970 has steps of 240 ns; the digits of the text have none.
///
/// # Errors
/// A message, if the text is no decimal number, or is beyond the year 2262.
pub(super) fn nanoseconds(text: &str, exponent: i32) -> Result<StampNs, String> {
    parse(text, exponent).map_err(|reason| match reason {
        Reason::NoNumber => format!("the stamp \"{text}\" is not a number"),
        Reason::Far => {
            let unit = ["nanoseconds", "microseconds", "milliseconds", "seconds"];
            let unit = unit.get(usize::try_from(exponent / 3).unwrap_or_default()).unwrap_or(&"frames");
            format!("the stamp {text}, taken in {unit}, is beyond the year 2262; is it in another unit?")
        }
    })
}

enum Reason {
    NoNumber,
    Far,
}

fn parse(text: &str, exponent: i32) -> Result<StampNs, Reason> {
    let (mantissa, power) = match text.split_once(['e', 'E']) {
        Some((mantissa, power)) => (mantissa, power.parse::<i32>().map_err(|_| Reason::NoNumber)?),
        None => (text, 0),
    };
    let (is_negative, digits) = match mantissa.as_bytes() {
        [b'-', ..] => (true, &mantissa[1..]),
        [b'+', ..] => (false, &mantissa[1..]),
        _ => (false, mantissa),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let all = || whole.bytes().chain(fraction.bytes());
    if all().next().is_none() || !all().all(|b| b.is_ascii_digit()) {
        return Err(Reason::NoNumber);
    }
    // Number of digits before the point, in nanoseconds.
    let n_whole = i64::try_from(whole.len()).map_err(|_| Reason::Far)?
        + i64::from(power.clamp(-1000, 1000))
        + i64::from(exponent);
    let mut value: i128 = 0;
    for k in 0..n_whole.max(0) {
        let digit = usize::try_from(k).ok().and_then(|k| all().nth(k)).map_or(0, |b| i128::from(b - b'0'));
        value = value * 10 + digit;
        if value > i128::from(StampNs::MAX) {
            return Err(Reason::Far);
        }
    }
    let next = usize::try_from(n_whole).ok().and_then(|k| all().nth(k));
    value += i128::from(next.is_some_and(|b| b >= b'5'));
    let value = StampNs::try_from(value).map_err(|_| Reason::Far)?;
    Ok(if is_negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_taken_to_the_nanosecond() {
        for (text, exponent, ns) in [
            ("1403636579.763555584", 9, 1_403_636_579_763_555_584),
            ("1.403636579763555527e+09", 9, 1_403_636_579_763_555_527),
            ("280.4611428572264", 9, 280_461_142_857),
            ("0", 9, 0),
            ("-1.5", 9, -1_500_000_000),
            (".5", 6, 500_000),
            ("12.", 3, 12_000),
            ("0.0000000006", 9, 1),
            ("1e-3", 9, 1_000_000),
            ("1403636579763555584", 0, 1_403_636_579_763_555_584),
            ("000000000000000000000000000001", 9, 1_000_000_000),
        ] {
            assert_eq!(nanoseconds(text, exponent), Ok(ns), "{text}");
        }
        for text in ["", "-", "1,5", "nan", "1e", "1.2.3", "0x10"] {
            assert!(nanoseconds(text, 9).unwrap_err().ends_with("is not a number"), "{text}");
        }
        let far = nanoseconds("1403636579763555584", 9).unwrap_err();
        assert_eq!(
            far,
            "the stamp 1403636579763555584, taken in seconds, is beyond the year 2262; is it in another unit?"
        );
        assert!(nanoseconds("1e999999999", 9).is_err());
    }
}
