//! Scanned film: fiducial marks and the inner orientation.
