//! Working out which candidate is which GCP, from the pattern alone.
