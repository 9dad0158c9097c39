use serde_json::Value as Json;

/// The range of a number.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Range {
    low: Option<f64>,
    high: Option<f64>,
    above: Option<f64>,
    below: Option<f64>,
}

impl Range {
    pub(super) fn of(schema: &Json) -> Self {
        let get = |key: &str| schema.get(key).and_then(Json::as_f64);
        Self {
            low: get("minimum"),
            high: get("maximum"),
            above: get("exclusiveMinimum"),
            below: get("exclusiveMaximum"),
        }
    }

    /// Why the value is out of range, if it is.
    pub(super) fn refuses(&self, value: f64) -> Option<&'static str> {
        if self.low.is_some_and(|low| value < low) || self.above.is_some_and(|above| value <= above) {
            return Some("too small");
        }
        let over = self.high.is_some_and(|high| value > high) || self.below.is_some_and(|below| value >= below);
        over.then_some("too large")
    }

    /// `a number from 0.1 to 100`.
    pub(super) fn describe(&self, what: &str) -> String {
        if let (Some(low), Some(high), None, None) = (self.low, self.high, self.above, self.below) {
            return format!("{what} from {low} to {high}");
        }
        let mut parts = Vec::new();
        parts.extend(self.above.map(|above| format!("above {above}")));
        parts.extend(self.low.map(|low| format!("of at least {low}")));
        parts.extend(self.below.map(|below| format!("below {below}")));
        parts.extend(self.high.map(|high| format!("of at most {high}")));
        if parts.is_empty() { what.into() } else { format!("{what} {}", parts.join(" and ")) }
    }
}

/// The limits of the integer formats that schemas name but do not spell out.
pub(super) fn int_limits(schema: &Json) -> (i128, i128) {
    match schema.get("format").and_then(Json::as_str) {
        Some("int8") => (i8::MIN.into(), i8::MAX.into()),
        Some("int16") => (i16::MIN.into(), i16::MAX.into()),
        Some("int32") => (i32::MIN.into(), i32::MAX.into()),
        Some("uint8") => (0, u8::MAX.into()),
        Some("uint16") => (0, u16::MAX.into()),
        Some("uint32") => (0, u32::MAX.into()),
        Some("uint" | "uint64" | "uint128") => (0, u64::MAX.into()),
        _ => (i64::MIN.into(), i64::MAX.into()),
    }
}
