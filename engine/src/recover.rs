//! Writes what is intact of a damaged recording into a sound file.

use std::collections::BTreeMap;

/// The metadata record of a recovered file: what is missing.
pub const RECOVERED_METADATA: &str = "osteoflow.recovered";

/// How many items of each wire lay before the first damage.
pub(crate) fn before_damage(recovered: &BTreeMap<String, String>) -> BTreeMap<String, u64> {
    recovered.get("before_damage").and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
}
