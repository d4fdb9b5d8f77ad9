//! What a feature says of itself, as text.

use gdal::vector::{Feature, FieldValue};

/// The values of a feature as text, empty where none was set.
pub(super) fn fields(feature: &Feature<'_>) -> Vec<String> {
    let set = |i: usize| feature.field_as_string(i).ok().flatten().is_some_and(|text| !text.is_empty());
    // A number that was never set reads as 0, as text it is empty.
    let value = |i: usize| if set(i) { text(feature.field(i).ok().flatten()) } else { String::new() };
    (0..feature.field_count()).map(value).collect()
}

fn text(value: Option<FieldValue>) -> String {
    match value {
        Some(FieldValue::StringValue(text)) => text.trim().to_string(),
        Some(FieldValue::IntegerValue(value)) => value.to_string(),
        Some(FieldValue::Integer64Value(value)) => value.to_string(),
        Some(FieldValue::RealValue(value)) => value.to_string(),
        _ => String::new(),
    }
}
