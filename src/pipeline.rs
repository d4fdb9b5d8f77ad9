//! Threads, channels and the memory budget: the only wiring.
