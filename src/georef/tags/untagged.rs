//! A tagged file as it was before all tags, for GDAL, without a copy of it.

use std::fmt::Write;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use quick_xml::escape::escape;

use super::journal;
use super::store::{Imagined, Store};
use autoref_raster::error::{Error, Result};

/// A file of GDAL's that shows the bytes of another as they were; gone with this value.
pub struct Untagged {
    table: PathBuf,
    bytes: PathBuf,
}

impl Untagged {
    /// Of a file that [`super::is_tagged`].
    ///
    /// # Errors
    /// When another program has changed the file since; when it cannot be read.
    pub fn of(image: &Path) -> Result<Untagged> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let file = File::open(image).map_err(|e| Error::io(image, "open", e))?;
        let io = |e| Error::io(image, "read", e);
        let mut imagined = Imagined::of(&file).map_err(io)?;
        journal::undo_all(image, &mut imagined)?;
        let absolute = std::fs::canonicalize(image).map_err(|e| Error::io(image, "resolve", e))?;
        let number = COUNTER.fetch_add(1, Ordering::Relaxed);
        let name = |end: &str| PathBuf::from(format!("/vsimem/autoref-untagged-{}-{number}.{end}", std::process::id()));
        let untagged = Untagged { table: name("xml"), bytes: name("bin") };
        let (mut old, mut table) =
            (Vec::new(), format!("<VSISparseFile><Length>{}</Length>", imagined.length().map_err(io)?));
        for (at, length) in imagined.stretches() {
            let (source, from) = match imagined.is_written(at) {
                true => {
                    let from = old.len();
                    old.resize(from + length as usize, 0);
                    imagined.read_at(at, &mut old[from..]).map_err(io)?;
                    (untagged.bytes.as_path(), from as u64)
                }
                false => (absolute.as_path(), at),
            };
            write!(
                table,
                "<SubfileRegion><Filename relative=\"0\">{}</Filename><DestinationOffset>{at}</DestinationOffset>\
                 <SourceOffset>{from}</SourceOffset><RegionLength>{length}</RegionLength></SubfileRegion>",
                escape(source.to_string_lossy().as_ref())
            )
            .expect("a string takes all writes");
        }
        table.push_str("</VSISparseFile>");
        let gdal = |e| Error::gdal(image, e);
        gdal::vsi::create_mem_file(&untagged.bytes, old).map_err(gdal)?;
        gdal::vsi::create_mem_file(&untagged.table, table.into_bytes()).map_err(gdal)?;
        Ok(untagged)
    }

    /// What GDAL opens.
    pub fn name(&self) -> PathBuf {
        PathBuf::from(format!("/vsisparse/{}", self.table.display()))
    }
}

impl Drop for Untagged {
    fn drop(&mut self) {
        for file in [&self.table, &self.bytes] {
            // One that was never made is no loss.
            let _ = gdal::vsi::unlink_mem_file(file);
        }
    }
}
