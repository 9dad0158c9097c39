//! Parameters of a simulated procedure from settings.

use crate::app::error::UsageError;
use anyhow::Result;
use osteoflow_simulation::{BoneParams, CtParams, DisplacedParams, ProcedureParams};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// The procedure, the CT, the bone in the CT if it is not the scanned one, and a displacement of the plan.
pub(super) struct Parameters {
    pub(super) procedure: ProcedureParams,
    pub(super) ct: CtParams,
    pub(super) ct_bone: Option<BoneParams>,
    pub(super) displaced: DisplacedParams,
}

impl Parameters {
    /// Those with `n_points` in each cloud, changed by each `TABLE.PARAMETER=VALUE` in turn.
    pub(super) fn new(n_points: u64, sets: &[String]) -> Result<Self> {
        let mut tables: BTreeMap<&str, Table> = BTreeMap::new();
        let n_points = Value::Integer(i64::try_from(n_points)?);
        tables.entry("camera").or_default().insert("n_points".into(), n_points);
        for set in sets {
            let (path, value) = set.split_once('=').ok_or_else(|| usage(set, "no = between key and value"))?;
            let Some((table, key)) = path.trim().split_once('.').filter(|(_, key)| !key.contains('.')) else {
                return Err(usage(set, "a key is TABLE.PARAMETER, such as tissue.share"));
            };
            tables.entry(table).or_default().insert(key.into(), parse(value.trim()));
        }
        // The CT's bone differs from the scanned one in what is set for it alone.
        let ct_bone = tables.remove("ct_bone").map(|own| {
            let mut bone = tables.get("bone").cloned().unwrap_or_default();
            bone.extend(own);
            read(bone, "ct_bone")
        });
        let ct = read(tables.remove("ct").unwrap_or_default(), "ct")?;
        let displaced = read(tables.remove("displaced").unwrap_or_default(), "displaced")?;
        Ok(Self { ct, displaced, ct_bone: ct_bone.transpose()?, procedure: read(tables, "procedure")? })
    }
}

fn usage(set: &str, reason: &str) -> anyhow::Error {
    UsageError(format!("--set {set}: {reason}")).into()
}

/// A TOML value; a word without quotes is a string.
fn parse(text: &str) -> Value {
    let table = format!("value = {text}").parse::<Table>().ok();
    table.and_then(|mut table| table.remove("value")).unwrap_or_else(|| Value::String(text.to_owned()))
}

fn read<T: DeserializeOwned>(table: impl Into<Value>, what: &str) -> Result<T> {
    T::deserialize(table.into()).map_err(|error| {
        let lines = error.to_string();
        UsageError(format!("--set: {what}: {}", lines.trim().replace('\n', ", "))).into()
    })
}
