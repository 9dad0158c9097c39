//! JSON in which no key is given twice.

use serde::{
    Deserialize, Deserializer,
    de::{Error, MapAccess, SeqAccess, Visitor},
};
use serde_json::{Map, Number, Value};
use std::fmt;

/// Parses a text; a key that an object has twice, at any depth, is an error with its place.
///
/// `serde_json` alone keeps the last of both values.
pub(crate) fn parse(text: &str) -> Result<Value, serde_json::Error> {
    serde_json::from_str::<Strict>(text).map(|strict| strict.0)
}

/// A list of `N` finite numbers.
pub(crate) fn numbers<const N: usize>(list: &Value) -> Option<[f64; N]> {
    let numbers = Vec::<f64>::deserialize(list).ok()?.try_into().ok();
    numbers.filter(|numbers: &[f64; N]| numbers.iter().all(|n| n.is_finite()))
}

/// A value whose objects have each key once.
struct Strict(Value);

impl<'de> Deserialize<'de> for Strict {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(StrictVisitor).map(Self)
    }
}

struct StrictVisitor;

impl<'de> Visitor<'de> for StrictVisitor {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_unit<E: Error>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<Value, E> {
        Ok(Value::Bool(value))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Value, E> {
        Ok(Number::from_f64(value).map_or(Value::Null, Value::Number))
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        let mut list = Vec::new();
        while let Some(Strict(item)) = items.next_element()? {
            list.push(item);
        }
        Ok(Value::Array(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut map = Map::new();
        while let Some(key) = entries.next_key::<String>()? {
            if map.contains_key(&key) {
                return Err(A::Error::custom(format!("key \"{key}\" is given twice; which of both is meant?")));
            }
            let Strict(value) = entries.next_value()?;
            map.insert(key, value);
        }
        Ok(Value::Object(map))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_gives_the_value_of_serde_json() {
        let text =
            r#"{"a": [1, -2, 2.5, 1e300, null, true, "x\u0041"], "b": {"a": {}, "c": []}, "d": 18446744073709551615}"#;
        assert_eq!(parse(text).unwrap(), serde_json::from_str::<Value>(text).unwrap());
        assert!(parse("{").is_err() && parse("{} x").is_err() && parse("NaN").is_err());
    }

    #[test]
    fn a_key_twice_is_refused_at_any_depth_with_its_line() {
        for (text, line) in [
            ("{\"a\": 1,\n\"a\": 2}", 2),
            ("{\"x\": [0,\n{\"a\": 1,\n\"b\": {}, \"a\": 1}]}", 3),
            ("[{\"x\": {\"y\": {\"a\": 1, \"\\u0061\": 2}}}]", 1),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.to_string().starts_with("key \"a\" is given twice"), "{error}");
            assert_eq!(error.line(), line, "{error}");
        }
    }
}
