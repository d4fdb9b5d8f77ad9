//! Fields of a report that may be damaged: each that cannot be read is left out alone.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

/// What is of another kind is as if it were not there.
///
/// # Errors
/// Those of the document itself.
pub(crate) fn or_nothing<'de, T, D>(field: D) -> Result<T, D::Error>
where
    T: Default + DeserializeOwned,
    D: Deserializer<'de>,
{
    Ok(serde_json::from_value(Value::deserialize(field)?).unwrap_or_default())
}

/// The texts of a list.
///
/// # Errors
/// Those of the document itself.
pub(crate) fn texts<'de, D: Deserializer<'de>>(field: D) -> Result<Vec<String>, D::Error> {
    let all: Vec<Value> = or_nothing(field)?;
    Ok(all.iter().filter_map(|text| text.as_str().map(String::from)).collect())
}

/// The texts of an object, by their keys.
///
/// # Errors
/// Those of the document itself.
pub(crate) fn texts_by_name<'de, D: Deserializer<'de>>(field: D) -> Result<BTreeMap<String, String>, D::Error> {
    let all: BTreeMap<String, Value> = or_nothing(field)?;
    Ok(all.into_iter().filter_map(|(name, text)| Some((name, text.as_str()?.to_string()))).collect())
}
