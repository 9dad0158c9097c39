//! Numbers and words as pages and terminals show them.

/// Formats a number: integers in full, others with three or four significant digits.
pub(crate) fn number(value: f64) -> String {
    let [text] = numbers([value]);
    text
}

/// Formats numbers that stand beside each other, with the decimals of the greatest.
pub(crate) fn numbers<const N: usize>(values: [f64; N]) -> [String; N] {
    let greatest = values.iter().fold(0.0, |greatest: f64, value| greatest.max(value.abs()));
    let are_whole = greatest < 1e15 && values.iter().all(|value| *value == value.trunc());
    values.map(|value| {
        let size = value.abs();
        let text = match greatest {
            _ if !value.is_finite() => return "\u{2013}".into(),
            _ if are_whole || size == 0.0 && greatest < 0.001 => format!("{size:.0}"),
            s if s >= 100.0 => format!("{size:.1}"),
            s if s >= 10.0 => format!("{size:.2}"),
            s if s >= 0.001 => format!("{size:.3}"),
            _ => format!("{size:.2e}"),
        };
        let sign = if value < 0.0 && text.bytes().any(|b| (b'1'..=b'9').contains(&b)) { "\u{2212}" } else { "" };
        format!("{sign}{text}")
    })
}

/// Formats a duration given in milliseconds, with three significant digits, in the unit from ns to s that suits it.
pub fn duration(ms: f64) -> String {
    let digits = |value: f64| match value {
        v if v >= 99.95 => format!("{v:.0}"),
        v if v >= 9.995 => format!("{v:.1}"),
        v => format!("{v:.2}"),
    };
    match ms {
        0.0 => "0 s".into(),
        ms if ms < 0.0009995 => format!("{:.0} ns", ms * 1e6),
        ms if ms < 0.9995 => format!("{} \u{b5}s", digits(ms * 1e3)),
        ms if ms < 999.5 => format!("{} ms", digits(ms)),
        ms => format!("{} s", digits(ms / 1e3)),
    }
}

/// Formats a share in percent.
pub fn percent(share: f64) -> String {
    match share * 100.0 {
        0.0 => "0 %".into(),
        p if p < 0.1 => "< 0.1 %".into(),
        p if p < 9.95 => format!("{p:.1} %"),
        p => format!("{p:.0} %"),
    }
}

/// Quotes a word for a shell, where it needs quotes.
pub fn shell_word(word: &str) -> String {
    match !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c)) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_few_significant_digits() {
        let texts: Vec<_> = [0.0, 20000.0, -0.02446, 3.2e-12, 0.1234, 12.345, 333.567, f64::NAN].map(number).into();
        let expected = ["0", "20000", "\u{2212}0.024", "3.20e-12", "0.123", "12.35", "333.6", "\u{2013}"];
        assert_eq!(texts, expected);
    }

    #[test]
    fn ends_of_an_interval_have_the_same_decimals() {
        for (ends, expected) in [
            ([3.12e-4, 0.089], ["0.000", "0.089"]),
            ([-3.12e-4, 0.089], ["0.000", "0.089"]),
            ([-0.375, 1.0], ["\u{2212}0.375", "1.000"]),
            ([9.5, 12.345], ["9.50", "12.35"]),
            ([34.24, 100.0], ["34.2", "100.0"]),
            ([30.0, 95.0], ["30", "95"]),
            ([0.0, 2e-5], ["0", "2.00e-5"]),
            ([0.1, f64::NAN], ["0.100", "\u{2013}"]),
        ] {
            assert_eq!(numbers(ends), expected, "{ends:?}");
        }
    }

    #[test]
    fn durations_and_shares_have_few_significant_digits() {
        let texts: Vec<_> = [0.0, 0.00012, 0.0123, 0.9994, 1.0, 12.345, 412.6, 999.7, 61_234.0].map(duration).into();
        let expected =
            ["0 s", "120 ns", "12.3 \u{b5}s", "999 \u{b5}s", "1.00 ms", "12.3 ms", "413 ms", "1.00 s", "61.2 s"];
        assert_eq!(texts, expected);
        assert_eq!([0.0, 0.0004, 0.012, 0.2251, 1.0].map(percent), ["0 %", "< 0.1 %", "1.2 %", "23 %", "100 %"]);
    }
}
