//! What became of cleaned clouds: the report beside each output, one document for all of them, and lines on standard
//! output.

use std::path::{Path, PathBuf};

use anyhow::Context;
use autoref_cloud::clean::{CleanReport, Step};
use autoref_cloud::io::stem;
use autoref_raster::bounded;
use autoref_raster::fingerprint::{self, Fingerprint};
use serde::Serialize;
use serde_json::{Value, json};

/// A file beside an output.
pub(super) fn beside(target: &Path, what: &str) -> PathBuf {
    target.with_file_name(format!("{}.clean.{what}", stem(target)))
}

/// The report beside an output.
#[derive(Serialize)]
pub(super) struct WrittenReport<'a> {
    #[serde(flatten)]
    pub report: &'a CleanReport,
    pub identity: &'a Identity,
    pub files_written: Vec<String>,
    pub output_bytes: u64,
    pub output_fingerprint: String,
}

/// What an output was made of.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Identity {
    /// Size of the cloud, and when it was modified.
    bytes: u64,
    modified_s: Option<f64>,
    parameters: Parameters,
    /// Fingerprint of the steps and of what the files hold that they name.
    steps: String,
    program: &'static str,
}

/// What the command line says of an output.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Parameters {
    /// Each step and its value, in the order written.
    pub steps: Vec<(&'static str, String)>,
    pub elevation_angle: f64,
    pub drop: Vec<String>,
    pub shift: Option<[f64; 3]>,
    pub crs: Option<String>,
    pub skip_invalid: bool,
}

impl Identity {
    pub fn of(cloud: &Path, parameters: &Parameters, steps: &[Step]) -> anyhow::Result<Self> {
        let metadata = std::fs::metadata(cloud).with_context(|| format!("{}: cannot open it", cloud.display()))?;
        let time = metadata.modified().ok().and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
        Ok(Identity {
            bytes: metadata.len(),
            modified_s: time.map(|time| time.as_secs_f64()),
            parameters: parameters.clone(),
            steps: Fingerprint::of(&format!("{steps:?}")).hex(),
            program: fingerprint::program(),
        })
    }
}

/// The report, as it was written, of an output that is there and was made of the same.
pub(super) fn finished(target: &Path, identity: &Identity) -> anyhow::Result<Option<Value>> {
    let identity = serde_json::to_value(identity)?;
    let of_the_same = || {
        let text = bounded::read_to_string(&beside(target, "json"), "a report", bounded::DOCUMENT_BYTES).ok()?;
        let report: Value = serde_json::from_str(&text).ok()?;
        let size = std::fs::metadata(target).is_ok_and(|output| report["output_bytes"] == output.len());
        if !(target.is_file() && size && report["identity"] == identity) {
            return None;
        }
        let mut content = Fingerprint::default();
        content.file(target).ok()?;
        (report["output_fingerprint"] == content.hex()).then_some(report)
    };
    Ok(of_the_same())
}

/// One document for all clouds: steps with their sums, and each cloud's own.
pub(super) fn document(reports: Vec<Value>) -> Value {
    let mut steps: Vec<Value> = Vec::new();
    for report in &reports {
        for (index, step) in report["steps"].as_array().into_iter().flatten().enumerate() {
            match steps.get_mut(index) {
                None => steps.push(step.clone()),
                Some(sum) => {
                    for key in ["points_in", "classified", "dropped", "ground"] {
                        if let (Some(a), Some(b)) = (sum[key].as_u64(), step[key].as_u64()) {
                            sum[key] = json!(a + b);
                        }
                    }
                    sum["seconds"] =
                        json!(sum["seconds"].as_f64().unwrap_or(0.0) + step["seconds"].as_f64().unwrap_or(0.0));
                    // Measured over one cloud.
                    if let Some(sum) = sum.as_object_mut() {
                        sum.remove("statistics");
                        sum.remove("greatest_range_m");
                    }
                }
            }
        }
    }
    let total = |key: &str| reports.iter().filter_map(|report| report[key].as_u64()).sum::<u64>();
    json!({
        "steps": steps,
        "points": total("points"),
        "points_kept": total("points_kept"),
        "files_written": reports.iter().filter_map(|report| report["files_written"].as_array()).flatten().collect::<Vec<_>>(),
        "clouds": reports,
    })
}

/// What each step took, and what looks wrong.
pub(super) fn print(report: &CleanReport) {
    println!("{}: {} points", report.input.display(), report.points);
    for step in &report.steps {
        let ground = step.ground.map_or(String::new(), |ground| format!(" {ground:>12} ground"));
        println!(
            "  {:<9} {} in {} classified {} dropped{ground}",
            step.step, step.points_in, step.classified, step.dropped
        );
    }
    println!("  {} points in {}", report.points_kept, report.output.display());
    let took_all = |taken: u64, points_in: u64| points_in > 0 && taken == points_in;
    let outside = report.steps.iter().any(|s| s.step == "crop" && took_all(s.classified, s.points_in));
    if outside && report.points_kept != 0 {
        eprintln!(
            "warning: {}: no point lies within --crop, so all are noise now; look at its reference system (cloud info)",
            report.input.display()
        );
    }
    // What went in was dropped whole.
    let emptied = report.steps.iter().find(|s| took_all(s.dropped, s.points_in));
    if let Some(step) = emptied.filter(|_| report.points_kept == 0) {
        eprintln!(
            "warning: {}: nothing is left after the step {}; look at its limits and at the cloud's heights and \
             coordinates (cloud info)",
            report.input.display(),
            step.step
        );
    }
}
