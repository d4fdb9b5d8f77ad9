//! What a run leaves beside a mask, and what a later run makes of it: done frames are left alone, stale files go.

use std::collections::BTreeMap;
use std::path::Path;

use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use autoref_raster::fingerprint::{self, Fingerprint, size_and_time};

use crate::given::Given;
use crate::names::{Names, name_of};
use crate::options::{Method, Options};
use crate::report::{Report, Shares};
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
pub(crate) struct Earlier(serde_json::Value);

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
    serde_json::from_str(&text).ok().map(Earlier)
}

impl Earlier {
    fn outputs(&self) -> impl Iterator<Item = &str> {
        self.0["outputs"].as_array().into_iter().flatten().filter_map(|name| name.as_str())
    }

    fn contents(&self) -> BTreeMap<String, String> {
        let known = self.0["contents"].as_object().into_iter().flatten();
        known.filter_map(|(name, hex)| Some((name.clone(), hex.as_str()?.to_string()))).collect()
    }

    /// Was it made from the same, and is everything still there as it was written?
    pub(crate) fn is_whole(&self, names: &Names, fingerprint: &str) -> bool {
        let all = names.all();
        let there = |path: &Path| {
            let mut now = Fingerprint::default();
            // The report itself was read to get here.
            path == names.report
                || now.file(path).is_ok() && self.0["contents"][name_of(path)].as_str() == Some(now.hex().as_str())
        };
        let written = |name: &str| all.iter().any(|path| name_of(path) == name && there(path));
        self.0["fingerprint"] == fingerprint && self.outputs().count() > 0 && self.outputs().all(written)
    }

    /// Removes what the earlier run wrote and this one did not: it shows another mask.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub(crate) fn remove_what_is_stale(&self, names: &Names, report: &Report) -> Result<()> {
        for name in self.outputs().filter(|name| !report.outputs.iter().any(|now| now == name)) {
            let Some(path) = names.all().into_iter().find(|path| name_of(path) == name) else { continue };
            match std::fs::remove_file(path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io(path, "remove", e)),
                _ => {}
            }
        }
        Ok(())
    }

    /// The report as it was.
    pub(crate) fn report(&self, names: &Names) -> Report {
        let earlier = &self.0;
        let number = |value: &serde_json::Value| value.as_f64().unwrap_or(0.0);
        let classes = &earlier["classes"];
        let words = earlier["warnings"].as_array().cloned().unwrap_or_default();
        let methods = [Method::Thesis2017, Method::Threshold, Method::Auto].map(Method::name);
        Report {
            frame: earlier["frame"].as_str().unwrap_or_default().into(),
            status: "unchanged",
            width: earlier["width"].as_u64().unwrap_or(0),
            height: earlier["height"].as_u64().unwrap_or(0),
            keep_share: number(&earlier["keep_share"]),
            classes: Shares {
                keep: number(&classes["keep"]),
                mask: number(&classes["mask"]),
                empty: number(&classes["empty"]),
            },
            unsure_share: number(&earlier["unsure_share"]),
            unlike_share: earlier["unlike_share"].as_f64(),
            warnings: words.iter().filter_map(|w| w.as_str().map(String::from)).collect(),
            mask: names.mask.clone(),
            probability: names.probability.is_file().then(|| names.probability.clone()),
            method: methods.into_iter().find(|name| earlier["method"] == *name).unwrap_or("auto"),
            reduce: earlier["reduce"].as_u64().unwrap_or(4) as usize,
            outputs: self.outputs().map(String::from).collect(),
            contents: self.contents(),
            fingerprint: earlier["fingerprint"].as_str().unwrap_or_default().into(),
        }
    }
}
