//! What a run leaves beside a mask, and what a later run makes of it: done frames are left alone, stale files go.

use std::path::Path;

use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use autoref_raster::fingerprint::{self, Fingerprint, size_and_time};
use serde_json::Value;

use crate::given::Given;
use crate::names::{Names, name_of};
use crate::options::Options;
use crate::report::Report;
use crate::teach::Taught;

/// Changes when the frame or anything that its mask depends on changes.
pub(crate) fn fingerprint(frame: &Path, taught: &Taught, given: &Given, options: &Options) -> String {
    let global = given.global_mask.as_deref().map(size_and_time);
    let what = format!(
        "{} {} {:?} {} {} {} {:?} {} {:?} {:?} {:?} {:?} {global:?} {given:?}",
        fingerprint::program(),
        size_and_time(frame),
        options.method,
        options.reduce,
        options.neighbours,
        options.threshold_bit,
        options.cleaning,
        options.auto_area_share,
        options.compression,
        options.extras,
        options.corrections,
        taught.mark,
    );
    Fingerprint::of(&what).hex()
}

/// The report of an earlier run.
pub(crate) struct Earlier(Report);

/// Reports of earlier runs in a folder whose masks are there, but for those of the frames with these stems.
pub(crate) fn others(folder: &Path, but: &[String]) -> Vec<Report> {
    let files = std::fs::read_dir(folder).into_iter().flatten().filter_map(|entry| entry.ok().map(|e| e.file_name()));
    let mut stems: Vec<String> = files
        .filter_map(|name| Some(name.to_str()?.strip_suffix("_Masq.json")?.to_string()))
        .filter(|stem| !but.contains(stem))
        .collect();
    stems.sort();
    let report = |stem: String| {
        let of_stem = Names::of_stem(&stem, &stem, folder);
        let report = earlier(&of_stem)?.report(&of_stem);
        of_stem.mask.is_file().then_some(report)
    };
    stems.into_iter().filter_map(report).collect()
}

/// What an earlier run said of a frame, when it left a report.
pub(crate) fn earlier(names: &Names) -> Option<Earlier> {
    let text = bounded::read_to_string(&names.report, "a report", bounded::DOCUMENT_BYTES).ok()?;
    let document: Value = serde_json::from_str(&text).ok()?;
    let report = Some(document).filter(Value::is_object).and_then(|document| serde_json::from_value(document).ok());
    Some(Earlier(report.unwrap_or_default()))
}

impl Earlier {
    /// Was it made from the same, and is everything still there as it was written?
    pub(crate) fn is_whole(&self, names: &Names, fingerprint: &str) -> bool {
        let all = names.all();
        let there = |path: &Path| {
            let mut now = Fingerprint::default();
            // The report itself was read to get here.
            path == names.report || now.file(path).is_ok() && self.0.contents.get(&name_of(path)) == Some(&now.hex())
        };
        let written = |name: &str| all.iter().any(|path| name_of(path) == name && there(path));
        self.0.fingerprint == fingerprint
            && !self.0.outputs.is_empty()
            && self.0.outputs.iter().all(|name| written(name))
    }

    /// Removes what the earlier run wrote and this one did not: it shows another mask.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub(crate) fn remove_what_is_stale(&self, names: &Names, report: &Report) -> Result<()> {
        for name in self.0.outputs.iter().filter(|name| !report.outputs.contains(name)) {
            let Some(path) = names.all().into_iter().find(|path| name_of(path) == *name) else { continue };
            match std::fs::remove_file(path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io(path, "remove", e)),
                _ => {}
            }
        }
        Ok(())
    }

    /// The report as it was, with the files that are there.
    pub(crate) fn report(self, names: &Names) -> Report {
        Report {
            mask: names.mask.clone(),
            probability: names.probability.is_file().then(|| names.probability.clone()),
            ..self.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::Method;
    use crate::report::{Reduction, Status};

    #[test]
    fn what_is_damaged_in_a_report_is_left_out_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let names = Names::of_stem("a", "a.tif", folder.path());
        let read = |text: &str| {
            std::fs::write(&names.report, text).expect("writable");
            earlier(&names).map(|earlier| earlier.report(&names))
        };
        assert!(read("{").is_none());
        let nothing = read("[]").expect("JSON");
        assert_eq!((nothing.method, nothing.reduce, nothing.status), (Method::Auto, Reduction(4), Status::Unchanged));
        let text = r#"{"frame": "b.tif", "status": "done", "width": -3, "height": 7, "keep_share": null,
            "classes": {"keep": 0.25, "mask": "much"}, "unlike_share": 0.5, "warnings": ["one", 2], "mask": 5,
            "method": "thesis-2017", "reduce": "two", "outputs": ["a", null], "contents": {"a": "f", "b": 1}}"#;
        let found = read(text).expect("JSON");
        assert_eq!((found.frame.as_path(), found.status), (Path::new("b.tif"), Status::Unchanged));
        assert_eq!((found.width, found.height, found.keep_share), (0, 7, 0.0));
        assert_eq!((found.classes.keep, found.classes.mask, found.unlike_share), (0.25, 0.0, Some(0.5)));
        assert_eq!((found.warnings, found.outputs), (vec!["one".to_string()], vec!["a".to_string()]));
        assert_eq!((found.mask, found.method, found.reduce), (names.mask.clone(), Method::Thesis2017, Reduction(4)));
        assert_eq!(found.contents.into_iter().collect::<Vec<_>>(), [("a".to_string(), "f".to_string())]);
    }
}
