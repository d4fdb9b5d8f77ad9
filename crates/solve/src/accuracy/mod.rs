//! What may be believed of a solved orientation: the error to expect at every place ([`error_map`]) and the statement
//! that surveying standards ask for ([`mod@statement`]).

pub mod error_map;
pub mod statement;

pub use error_map::{CornerError, ErrorMap, ErrorModel, ExpectedError};
pub use statement::{AccuracyFigures, AccuracyStatement, Basis, CheckError, StatementOptions, statement};
