//! Parameters of a simulated procedure from settings.

use crate::app::error::UsageError;
use anyhow::Result;
use osteoflow_simulation::{BoneParams, CtParams, ProcedureParams};
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// The procedure, the CT, and the bone in the CT if it is not the scanned one.
pub(super) struct Parameters {
    pub(super) procedure: ProcedureParams,
    pub(super) ct: CtParams,
    pub(super) ct_bone: Option<BoneParams>,
}

impl Parameters {
    /// Those with `n_points` in each cloud, changed by each `TABLE.PARAMETER=VALUE` in turn.
    pub(super) fn new(n_points: u64, sets: &[String]) -> Result<Self> {
        let mut tables = Table::new();
        put(&mut tables, &["camera", "n_points"], Value::Integer(i64::try_from(n_points)?));
        for set in sets {
            let (key, value) = set.split_once('=').ok_or_else(|| usage(set, "no = between key and value"))?;
            let path: Vec<&str> = key.trim().split('.').collect();
            if path.len() != 2 {
                return Err(usage(set, "a key is TABLE.PARAMETER, such as tissue.share"));
            }
            put(&mut tables, &path, parse(value.trim()));
        }
        // The CT's bone differs from the scanned one in what is set for it alone.
        let ct_bone = match tables.remove("ct_bone") {
            Some(Value::Table(own)) => {
                let mut bone = tables.get("bone").and_then(Value::as_table).cloned().unwrap_or_default();
                bone.extend(own);
                Some(read::<BoneParams>(bone, "ct_bone")?)
            }
            _ => None,
        };
        let ct = match tables.remove("ct") {
            Some(Value::Table(ct)) => read::<CtParams>(ct, "ct")?,
            _ => CtParams::default(),
        };
        Ok(Self { procedure: read(tables, "procedure")?, ct, ct_bone })
    }
}

fn usage(set: &str, reason: &str) -> anyhow::Error {
    UsageError(format!("--set {set}: {reason}")).into()
}

fn put(tables: &mut Table, path: &[&str], value: Value) {
    let [table, key] = path else { return };
    let table = tables.entry(*table).or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(table) = table {
        table.insert((*key).to_owned(), value);
    }
}

/// A TOML value; a word without quotes is a string.
fn parse(text: &str) -> Value {
    let table = format!("value = {text}").parse::<Table>().ok();
    table.and_then(|mut table| table.remove("value")).unwrap_or_else(|| Value::String(text.to_owned()))
}

fn read<T: DeserializeOwned>(table: Table, what: &str) -> Result<T> {
    T::deserialize(Value::Table(table)).map_err(|error| {
        let lines = error.to_string();
        UsageError(format!("--set: {what}: {}", lines.trim().replace('\n', ", "))).into()
    })
}
