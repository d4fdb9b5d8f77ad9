//! Marks planted into real photographs: all visible GCPs matched, none wrong, centres right. The ordinary run uses a
//! part of Lerkendal's pattern; `make check-large` the full geometry (22,039 × 20,051 px), tiles and strips, in two
//! budgets.

use std::path::Path;
use std::process::Command;

use autoref_synth::{Background, Compression, FileLayout, MarkSize, MarkStyle, SynthGcp, SynthSpec, Truth};
use serde_json::Value;

fn lerkendal() -> Option<(Vec<SynthGcp>, Background)> {
    let (photos, table) = (crate::common::data("photos")?, crate::common::data("thesis/b1_lerkendal_gcps.csv")?);
    let gcps = autoref_synth::read_gcp_csv(&table).expect("the table of the thesis");
    Some((gcps, Background::Photographs(autoref_synth::photographs(&[photos]).expect("photographs"))))
}

fn run(folder: &Path, spec: &SynthSpec, extra: &[&str]) -> (Truth, Value) {
    let (image, list) = (folder.join("l.tif"), folder.join("l.geojson"));
    let truth = autoref_synth::write(spec, &image).expect("a sample");
    autoref_synth::write_gcp_geojson(&list, &spec.gcps, Some(32632)).expect("a list");
    let output = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
        .arg(&image)
        .arg("--gcps")
        .arg(&list)
        .args(["--json", "--overwrite"])
        .args(extra)
        .output()
        .expect("the program starts");
    let result: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&output.stderr)));
    assert_eq!(result["status"], "solved", "{}", result["reason"]);
    (truth, result)
}

fn check(truth: &Truth, result: &Value) {
    let rows = result["matches"].as_array().expect("a list");
    let mut errors: Vec<f64> = rows
        .iter()
        .map(|row| {
            let gcp = truth.gcps.iter().find(|g| g.name == row["gcp"]).expect("a name of the list");
            assert!(gcp.visible, "{} has no mark", gcp.name);
            (row["x"].as_f64().expect("x") - gcp.x).hypot(row["y"].as_f64().expect("y") - gcp.y)
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    let visible = truth.visible().count();
    let close = errors.iter().filter(|e| **e <= 0.25).count();
    println!(
        "{visible} visible, {} matched, {close} within 0.25 px, worst {:.3} px; {} candidates; {} s; {} MiB",
        errors.len(),
        errors.last().expect("at least one"),
        result["candidates_found"],
        result["elapsed_s"],
        result["peak_memory_bytes"].as_u64().unwrap_or(0) >> 20
    );
    assert_eq!(errors.len(), visible, "not found: {}", result["not_found"]);
    assert!(close * 100 >= visible * 95 && errors.iter().all(|e| *e <= 0.5), "{errors:?}");
}

fn spec(gcps: Vec<SynthGcp>, background: Background, mark_px: f64, layout: FileLayout) -> SynthSpec {
    let mut spec = SynthSpec {
        gcps,
        background,
        gsd_m: 0.032,
        rotation_deg: -0.026,
        mark: MarkStyle { size: MarkSize::Px(mark_px), ..MarkStyle::default() },
        seed: 20 + mark_px as u64,
        ..SynthSpec::default()
    };
    spec.output.layout = layout;
    spec.output.compression = Compression::Deflate;
    spec
}

#[test]
fn marks_in_photographs_are_matched_and_centred() {
    let Some((gcps, background)) = lerkendal() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    for mark_px in [12.0, 20.0] {
        // Half the spacing: the whole pattern in a ninth of the pixels.
        let mut spec = spec(gcps.clone(), background.clone(), mark_px, FileLayout::Tiles(512));
        spec.gsd_m = 0.096;
        spec.output.overwrite = true;
        let (truth, result) = run(folder.path(), &spec, &[]);
        check(&truth, &result);
    }
}

#[test]
fn lerkendal_at_full_size_within_both_budgets() {
    if !crate::common::large() {
        crate::common::skipped("the full size runs with AUTOREF_LARGE=1 (make check-large)");
        return;
    }
    let Some((gcps, background)) = lerkendal() else { return };
    for (mark_px, layout, compression) in [
        (20.0, FileLayout::Tiles(512), Compression::None),
        (12.0, FileLayout::Strips(1), Compression::Lzw),
        (12.0, FileLayout::Tiles(256), Compression::Zstd),
    ] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut spec = spec(gcps.clone(), background.clone(), mark_px, layout);
        spec.size_px = Some((22_039, 20_051));
        spec.output.compression = compression;
        for (memory, bound) in [("512M", 512u64), ("128M", 128), ("112M", 112)] {
            spec.output.overwrite = true;
            let (truth, result) = run(folder.path(), &spec, &["--memory", memory]);
            check(&truth, &result);
            let peak = result["peak_memory_bytes"].as_u64().expect("measured");
            assert!(peak <= bound << 20, "{} MiB at {memory}", peak >> 20);
        }
    }
}
