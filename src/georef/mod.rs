//! Writing what was solved so that other programs understand it.
