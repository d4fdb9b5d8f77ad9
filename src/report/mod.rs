//! The report a client reads.
