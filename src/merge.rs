//! Joining regions that straddle tile edges.
