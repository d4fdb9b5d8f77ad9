//! What was found as CSV and JSON.

use std::path::Path;

use crate::error::{Error, Result};

use super::summary::{PERCENTS, Summary};

/// Writes `statistics.csv`, `volumes.csv`, `variogram.csv` and `summary.json`.
pub(super) fn write_tables(folder: &Path, summary: &Summary) -> Result<()> {
    let put = |name: &str, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(|e| Error::io(&path, "write", e))
    };
    let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let mut text = String::from("group,class,n,mean_m,median_m,sd_m,nmad_m,rmse_m,min_m,max_m,share_within");
    PERCENTS.iter().for_each(|p| text.push_str(&format!(",p{p}_m")));
    text.push('\n');
    for s in &summary.statistics {
        let figures = [s.mean_m, s.median_m, s.sd_m, s.nmad_m, s.rmse_m, s.min_m, s.max_m, s.share_within];
        text.push_str(&format!("{},{},{}", s.group, quoted(&s.class), s.n));
        figures.iter().for_each(|v| text.push_str(&format!(",{}", number(*v))));
        for percent in PERCENTS {
            let value = s.percentiles_m.get(&format!("{percent}")).and_then(serde_json::Value::as_f64);
            text.push_str(&format!(",{}", number(value)));
        }
        text.push('\n');
    }
    put("statistics.csv", text)?;
    let mut text =
        String::from("zone,n,area_m2,mean_m,mean_se_m,effective_n,volume_m3,volume_se_m3,low_95_m3,high_95_m3,");
    text.push_str("zone_area_m2,covered_share\n");
    for v in &summary.volumes {
        text.push_str(&format!(
            "{},{},{},{},{},{},{},{},{},{},{},{}\n",
            quoted(&v.zone),
            v.n,
            v.area_m2,
            number(v.mean_m),
            number(v.mean_se_m),
            number(v.effective_n),
            number(v.volume_m3),
            number(v.volume_se_m3),
            number(v.volume_95_m3.map(|ends| ends[0])),
            number(v.volume_95_m3.map(|ends| ends[1])),
            v.zone_area_m2,
            number(v.covered_share)
        ));
    }
    put("volumes.csv", text)?;
    let mut text = String::from("lag_m,semivariance_m2,pairs,model_m2\n");
    for bin in &summary.variogram.bins {
        let model = summary.variogram.semivariance(bin.lag_m);
        text.push_str(&format!("{},{},{},{}\n", bin.lag_m, bin.semivariance_m2, bin.pairs, model));
    }
    put("variogram.csv", text)?;
    let json = serde_json::to_string_pretty(summary).map_err(|e| Error::usage(e.to_string(), "report this"))?;
    put("summary.json", json + "\n")
}
