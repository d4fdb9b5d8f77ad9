//! Sample orthophotos with known truth, for the demo, the tests and the benches.
