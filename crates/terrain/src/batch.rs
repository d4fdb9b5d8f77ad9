//! Frames one after another: a mask and a report for each, and what is done already is left alone.

use std::path::Path;

use autoref_raster::atomic::Transaction;
use autoref_raster::error::{Error, Result};

use crate::bits::BitMask;
use crate::by_hand::{self, FullMask};
use crate::classify::{Cleaner, classify};
use crate::given::Given;
use crate::names::{Names, name_of};
use crate::options::{Method, Options};
use crate::reduce::{Reading, Reduced, plane_memory};
use crate::report::{Report, report};
use crate::resume;
use crate::teach::Taught;
use crate::write;

/// A frame's result with what a picture of it needs.
pub struct Done {
    pub report: Report,
    /// The frame and its mask at the reduced scale; `None` when the frame was done before.
    pub picture: Option<(Reduced, BitMask)>,
}

/// Makes the mask of one frame.
///
/// # Errors
/// When the frame cannot be read or an output cannot be written; nothing is left half-written.
pub fn mask_frame(frame: &Path, folder: &Path, taught: &Taught, given: &Given, options: &Options) -> Result<Done> {
    guarded(frame, || make_mask(frame, folder, taught, given, options))
}

/// A fault of ours in one frame is that frame's error: the others of a batch have their masks.
fn guarded<R>(frame: &Path, work: impl FnOnce() -> Result<R>) -> Result<R> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or_else(|fault| {
        let text = fault.downcast_ref::<String>().map(String::as_str);
        let text = text.or(fault.downcast_ref::<&str>().copied()).unwrap_or("no reason is given");
        Err(Error::format(frame, "frame", format!("a fault of this program, please report it: {text}")))
    })
}

fn make_mask(frame: &Path, folder: &Path, taught: &Taught, given: &Given, options: &Options) -> Result<Done> {
    let _span = tracing::info_span!("frame").entered();
    let classifier = &taught.classifier;
    let names = Names::of(frame, folder);
    let fingerprint = resume::fingerprint(frame, taught, given, options);
    let earlier = resume::earlier(&names);
    let earlier = match earlier {
        Some(earlier) if options.resume && earlier.is_whole(&names, &fingerprint) => {
            return Ok(Done { report: earlier.report(&names), picture: None });
        }
        other => other,
    };
    // With --resume, what is there belongs to a frame that has changed, or to a run that was stopped.
    autoref_raster::atomic::check_outputs(
        &[&names.mask, &names.xml],
        autoref_raster::atomic::Existing::of_flag(options.overwrite || options.resume),
    )?;
    let source = options.open(frame)?;
    let masks_beside = u64::from(by_hand::speaks_of(frame, given)) + 2 * u64::from(options.extras.explain);
    let reading = Reading { masks_beside, ..options.reading(source.as_ref()) };
    let reduced = options.reduced(&source, &reading)?;
    let cleaner = match options.method {
        Method::Auto => Cleaner::Areas(options.auto_area_share),
        _ => Cleaner::Thesis(options.cleaning.clone()),
    };
    let memory = plane_memory(&reading);
    let mut classes = classify(&reduced, classifier, &cleaner, memory)?;
    let told_apart = by_hand::speaks_of(frame, given).then(|| classes.keep.clone());
    by_hand::lay_over(frame, &reduced, given, &mut classes)?;
    if !options.extras.probability {
        classes.probability = None;
    }
    let mut report = report(frame, &names, &reduced, &classes, options, fingerprint);
    report.warnings.extend(by_hand::beside(frame, reduced.width, reduced.height, given));
    // Their share is told; two masks less while the outlines are traced.
    (classes.unsure, classes.decided) = (None, None);
    let full = FullMask::new(frame, told_apart.as_ref().unwrap_or(&classes.keep), &reduced, given);
    let mut transaction = Transaction::new();
    let size = [reduced.width as usize, reduced.height as usize];
    transaction.stage(&names.mask, |path| write::mask(path, &full, options.compression))?;
    let mask_name = names.mask.file_name().unwrap_or_default().to_string_lossy();
    transaction.stage_bytes(&names.xml, write::micmac_xml(&mask_name, size).as_bytes())?;
    let name = frame.file_name().unwrap_or_default().to_string_lossy();
    let outlines = crate::outline::polygons(&classes.keep, size, reduced.factor, &name);
    transaction.stage_bytes(&names.outlines, outlines.as_bytes())?;
    drop(outlines);
    if let Some(plane) = &classes.probability {
        transaction.stage(&names.probability, |path| write::grey_plane(path, size, reduced.factor, plane))?;
    }
    if options.extras.colmap {
        transaction.stage(&names.colmap, |path| write::colmap(path, &full))?;
    }
    if options.extras.explain {
        crate::explain::stage(&mut transaction, &names, &reduced, classifier, memory)?;
    }
    report.contents = transaction.fingerprints()?.into_iter().map(|(path, hex)| (name_of(&path), hex)).collect();
    let json = serde_json::to_string_pretty(&report).expect("a report is plain data");
    transaction.stage_bytes(&names.report, json.as_bytes())?;
    transaction.commit()?;
    if let Some(earlier) = earlier {
        earlier.remove_what_is_stale(&names, &report)?;
    }
    Ok(Done { report, picture: Some((reduced, classes.keep)) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_in_one_frame_is_its_error() {
        let none: Vec<u8> = Vec::new();
        let found = guarded(Path::new("a.tif"), || Ok(none[3]));
        let said = found.expect_err("nothing is there").to_string();
        assert!(said.contains("a.tif") && said.contains("index"), "{said}");
        assert!(guarded(Path::new("a.tif"), || Ok(7)).is_ok_and(|seven| seven == 7));
    }
}
