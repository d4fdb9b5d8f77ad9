//! Numbers of JSON documents.

use std::path::Path;

use serde_json::Value;

use crate::error::{Error, Result};

pub(super) fn number(path: &Path, of: &Value, key: &str, place: &str) -> Result<f64> {
    of.get(key).and_then(Value::as_f64).ok_or_else(|| Error::format(path, place, format!("`{key}` is no number")))
}

pub(super) fn triple(path: &Path, of: &Value, key: &str, place: &str) -> Result<[f64; 3]> {
    let list = of.get(key).and_then(Value::as_array);
    let values: Option<Vec<f64>> = list.and_then(|l| l.iter().map(Value::as_f64).collect());
    values
        .and_then(|v| v.try_into().ok())
        .ok_or_else(|| Error::format(path, place, format!("`{key}`: 3 numbers expected")))
}
