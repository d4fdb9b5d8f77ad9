//! Doubts that hold under the similarity only.

use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_stream::gcp::GcpList;
use autoref_stream::pipeline::reasons::{NotFound, Reason};
use autoref_stream::result::RunResult;

/// Takes back what was said against points and marks that do not fit the similarity, by which marks are matched, but
/// fit the affine transform that is written.
pub(super) fn explain_under(result: &mut RunResult, written: &GeoTransform, list: &GcpList) {
    /// A mark fits within so many of the marks' root mean square residuals, and so many pixels at least and at most.
    const TIMES: f64 = 4.0;
    const REACH_PX: (f64, f64) = (1.0, 5.0);
    let candidates: Vec<PixelPoint> = result.candidates.iter().map(|c| c.centre).collect();
    let Some(solved) = result.solved_mut() else { return };
    let used: Vec<(f64, f64)> = solved.matches.iter().map(|row| (row.x, row.y)).collect();
    let candidates: Vec<PixelPoint> = candidates.into_iter().filter(|c| !used.contains(&(c.x, c.y))).collect();
    let reach_px = (TIMES * solved.fit.rmse_m / solved.fit.scale_m_per_px).clamp(REACH_PX.0, REACH_PX.1);
    let mut fitting = vec![];
    for point in &mut solved.not_found {
        // What the image or other points say holds whatever the transform.
        if matches!(point.reason, Reason::Outside | Reason::Ambiguous) {
            continue;
        }
        let Some(gcp) = list.gcps.iter().find(|gcp| gcp.name == point.name) else { continue };
        let Some(at) = written.invert(gcp.position()) else { continue };
        let off = candidates.iter().map(|c| (c.x - at.x).hypot(c.y - at.y)).min_by(f64::total_cmp);
        // By the similarity the mark must lie elsewhere.
        let apart = (at.x - point.x).hypot(at.y - point.y) > reach_px;
        if let Some(off_px) = off.filter(|off| *off <= reach_px && apart) {
            let detail = format!(
                "a mark lies {off_px:.1} px from where the affine transform puts it, but not where the similarity does, by \
                 which marks are matched"
            );
            let name = point.name.clone();
            fitting.push(name.clone());
            *point = NotFound { between: vec![name.clone()], ..NotFound::new(name, Reason::Ambiguous, at, detail) };
        }
    }
    if fitting.is_empty() {
        return;
    }
    result.warnings.retain(|warning| !fitting.iter().any(|name| warning.misses(name)));
    result.warn(format!(
        "{}: marks lie where the affine transform puts them, but marks are matched by a similarity: left out; make the \
         pixels square first (gdalwarp -tr), or solve the candidates by hand",
        fitting.join(", ")
    ));
}
