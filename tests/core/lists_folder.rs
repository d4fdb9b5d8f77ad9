//! A folder for the lists of a test.

use std::path::PathBuf;

use autoref_stream::gcp::convert::{ConvertOptions, Converted, convert};
use autoref_stream::gcp::{self, GcpList, GcpOptions};

pub struct Folder(pub tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, content).expect("writable");
        path
    }

    pub fn read(&self, name: &str, content: impl AsRef<[u8]>, options: &GcpOptions) -> Result<GcpList, String> {
        gcp::read(&self.write(name, content), options).map_err(|e| e.to_string())
    }

    pub fn converted(&self, name: &str, content: impl AsRef<[u8]>) -> Converted {
        let options = ConvertOptions { crs: Some("local".into()), ..ConvertOptions::default() };
        let output = self.0.path().join(format!("{name}.out.csv"));
        convert(&self.write(name, content), &output, &options).unwrap_or_else(|e| panic!("{e}"))
    }
}
