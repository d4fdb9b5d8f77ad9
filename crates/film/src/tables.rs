//! Marks of a frame for other programs: CSV as spymicmac and hipp read it, GeoJSON in pixel space.
//!
//! Columns: spymicmac's `get_im_meas(points, …, name='gcp', x='im_col', y='im_row')`; hipp's `iter_detect_fiducials`,
//! `split_position_tuples` and `image_restitution`, which take all columns between `fileName` and `principal_point` for
//! pairs of y and x.

use serde_json::{Value, json};

use super::types::{Camera, FrameResult, FrameStatus, InteriorModel, InteriorOrientation, MarkFind, MarkStatus};
use autoref_raster::coords::PixelPoint;

/// From where the pixels of an export count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelOrigin {
    /// The outer corner of the first pixel, as `docs/coordinates.md` and GDAL.
    Corner,
    /// The centre of the first pixel, as numpy, OpenCV and the resampling of MicMac.
    Centre,
}

impl PixelOrigin {
    fn shift(self) -> f64 {
        match self {
            PixelOrigin::Corner => 0.0,
            PixelOrigin::Centre => -0.5,
        }
    }
}

/// The marks of the interior orientation with their pixels from `origin`.
pub fn used_marks(frame: &FrameResult, origin: PixelOrigin) -> impl Iterator<Item = (&MarkFind, [f64; 2])> {
    let used = frame.interior.as_ref().map_or(&[][..], |interior| &interior.marks);
    frame.marks.iter().filter(|m| used.contains(&m.mark)).filter_map(move |m| {
        let centre = m.centre?;
        Some((m, [centre.x + origin.shift(), centre.y + origin.shift()]))
    })
}

fn text(out: csv::Writer<Vec<u8>>) -> String {
    String::from_utf8(out.into_inner().expect("memory takes all")).expect("made of strings")
}

/// `gcp,im_col,im_row` of the marks of the interior orientation; the residual columns are micrometres.
pub fn measures_csv(frame: &FrameResult, origin: PixelOrigin) -> String {
    let mut out = csv::Writer::from_writer(vec![]);
    out.write_record(["gcp", "im_col", "im_row", "residual_x_um", "residual_y_um"]).expect("memory takes all");
    for (m, [x, y]) in used_marks(frame, origin) {
        let r = m.residual_um.map_or(["".into(), "".into()], |r| r.map(|v| format!("{v:.3}")));
        let [rx, ry] = &r;
        out.write_record([&m.mark, &x.to_string(), &y.to_string(), rx, ry]).expect("memory takes all");
    }
    text(out)
}

/// hipp's names of the eight places, in its order.
const HIPP: [&str; 8] = [
    "midside_left",
    "midside_top",
    "midside_right",
    "midside_bottom",
    "corner_top_left",
    "corner_top_right",
    "corner_bottom_right",
    "corner_bottom_left",
];

/// Which mark stands at each of hipp's places; marks elsewhere have none, and two at one place leave it empty.
fn hipp_places(camera: &Camera) -> [Option<usize>; 8] {
    let points = camera.film_points();
    let centre = camera.film_centre();
    let half = [0, 1].map(|k| points.iter().map(|p| (p[k] - centre[k]).abs()).fold(1e-9, f64::max));
    let third = |v: f64| if v < -0.5 { -1 } else { i32::from(v > 0.5) };
    let place = |p: &[f64; 2]| match (third((p[0] - centre[0]) / half[0]), third((p[1] - centre[1]) / half[1])) {
        (-1, 0) => Some(0),
        (0, -1) => Some(1),
        (1, 0) => Some(2),
        (0, 1) => Some(3),
        (-1, -1) => Some(4),
        (1, -1) => Some(5),
        (1, 1) => Some(6),
        (-1, 1) => Some(7),
        _ => None,
    };
    let all: Vec<Option<usize>> = points.iter().map(place).collect();
    std::array::from_fn(|k| {
        let mut at = all.iter().enumerate().filter(|(_, p)| **p == Some(k)).map(|(mark, _)| mark);
        at.next().filter(|_| at.next().is_none())
    })
}

/// A row per frame as hipp keeps it: `fileName`, `_y` and `_x` of each place that the camera has a mark at, empty where
/// the mark takes no part in the orientation, and the principal point: the mean of the midpoints of opposite marks.
pub fn hipp_csv(camera: &Camera, frames: &[FrameResult], origin: PixelOrigin) -> String {
    let places = hipp_places(camera);
    let known: Vec<usize> = (0..8).filter(|&k| places[k].is_some()).collect();
    let mut out = csv::Writer::from_writer(vec![]);
    let pair = |name: &str| [format!("{name}_y"), format!("{name}_x")];
    let head = known.iter().flat_map(|&k| pair(HIPP[k])).chain(pair("principal_point"));
    out.write_record(std::iter::once("fileName".to_string()).chain(head)).expect("memory takes all");
    for frame in frames {
        let at = |k: usize| {
            let name = &camera.marks[places[k]?].name;
            used_marks(frame, origin).find(|(m, _)| m.mark == *name).map(|(_, at)| at)
        };
        let cells =
            |at: Option<[f64; 2]>| at.map_or([String::new(), String::new()], |[x, y]| [y, x].map(|v| v.to_string()));
        let middles: Vec<[f64; 2]> = [(0, 2), (1, 3), (4, 6), (5, 7)]
            .iter()
            .filter_map(|&(a, b)| at(a).zip(at(b)))
            .map(|(a, b)| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])])
            .collect();
        let mean = |k: usize| middles.iter().map(|m| m[k]).sum::<f64>() / middles.len() as f64;
        let principal = (!middles.is_empty()).then(|| [mean(0), mean(1)]);
        let row = known.iter().flat_map(|&k| cells(at(k))).chain(cells(principal));
        out.write_record(std::iter::once(frame.path.display().to_string()).chain(row)).expect("memory takes all");
    }
    text(out)
}

fn digits(v: Option<f64>, digits: usize) -> String {
    v.map_or(String::new(), |v| format!("{v:.digits$}"))
}

/// A line per frame about its interior orientation. `scale_difference_ppm` and `shear_urad` say how far the film, as
/// scanned, is from a similarity: (pixel size along x / along y − 1), and how far the angle between the axes is from a
/// right one, both at the middle of the marks.
pub fn orientations_csv(camera: &Camera, frames: &[FrameResult]) -> String {
    let mut out = csv::Writer::from_writer(vec![]);
    out.write_record([
        "frame",
        "status",
        "model",
        "marks",
        "redundancy",
        "rmse_um",
        "sigma0_um",
        "largest_residual_um",
        "leave_one_out_rmse_um",
        "pixel_um",
        "rotation_deg",
        "mirrored",
        "scale_difference_ppm",
        "shear_urad",
    ])
    .expect("memory takes all");
    for frame in frames {
        let status = match &frame.status {
            FrameStatus::Ok => "ok",
            FrameStatus::Doubtful { .. } => "doubtful",
            FrameStatus::Failed { .. } => "failed",
        };
        let mut row = vec![frame.name.clone(), status.into()];
        match &frame.interior {
            None => row.extend((0..12).map(|_| String::new())),
            Some(interior) => {
                let (model, free) = match interior.model {
                    InteriorModel::Similarity => ("similarity", 4),
                    InteriorModel::Affine => ("affine", 6),
                    InteriorModel::Projective => ("projective", 8),
                };
                let largest = used_marks(frame, PixelOrigin::Corner)
                    .filter_map(|(m, _)| m.residual_um)
                    .map(|r| r[0].hypot(r[1]))
                    .fold(0.0, f64::max);
                let form = deformation(camera, interior);
                row.extend([
                    model.into(),
                    interior.marks.len().to_string(),
                    (2 * interior.marks.len()).saturating_sub(free).to_string(),
                    digits(Some(interior.rmse_um), 3),
                    digits(interior.sigma0_um, 3),
                    digits(Some(largest), 3),
                    digits(interior.leave_one_out_rmse_um, 3),
                    digits(Some(interior.pixel_um), 5),
                    digits(Some(interior.rotation_deg), 5),
                    interior.mirrored.is_mirrored().to_string(),
                    digits(form.map(|f| 1e6 * f[0]), 1),
                    digits(form.map(|f| 1e6 * f[1]), 1),
                ]);
            }
        }
        out.write_record(&row).expect("memory takes all");
    }
    text(out)
}

/// Relative difference of the pixel's sizes along x and y, and the shear in radians.
fn deformation(camera: &Camera, interior: &InteriorOrientation) -> Option<[f64; 2]> {
    let centre = camera.film_centre();
    let middle = interior.to_pixel([centre[0], camera.y_sign() * centre[1]])?;
    let at = |dx: f64, dy: f64| interior.to_mm(PixelPoint { x: middle.x + dx, y: middle.y + dy });
    let along = |dx: f64, dy: f64| {
        let (a, b) = (at(dx, dy)?, at(-dx, -dy)?);
        Some([a[0] - b[0], a[1] - b[1]])
    };
    let (x, y) = (along(100.0, 0.0)?, along(0.0, 100.0)?);
    let (lx, ly) = (x[0].hypot(x[1]), y[0].hypot(y[1]));
    Some([lx / ly - 1.0, ((x[0] * y[0] + x[1] * y[1]) / (lx * ly)).asin()])
}

/// A line per mark of the camera over the roll: how often it is part of an orientation, and mean, standard deviation
/// (divisor n − 1) and largest of its residuals. A mean that is far from zero against its deviation over √n says that
/// the certificate, or what the finder calls the mark's centre, is off for this mark.
pub fn roll_marks_csv(camera: &Camera, frames: &[FrameResult]) -> String {
    let mut out = csv::Writer::from_writer(vec![]);
    out.write_record([
        "mark",
        "frames",
        "used",
        "doubtful",
        "missing",
        "mean_x_um",
        "mean_y_um",
        "sd_x_um",
        "sd_y_um",
        "rms_um",
        "largest_um",
    ])
    .expect("memory takes all");
    for mark in &camera.marks {
        let of = |frame: &FrameResult| frame.marks.iter().find(|m| m.mark == mark.name).map(|m| m.status);
        let count = |status: MarkStatus| frames.iter().filter(|f| of(f) == Some(status)).count().to_string();
        let residuals: Vec<[f64; 2]> = frames
            .iter()
            .flat_map(|f| used_marks(f, PixelOrigin::Corner))
            .filter(|(m, _)| m.mark == mark.name)
            .filter_map(|(m, _)| m.residual_um)
            .collect();
        let n = residuals.len() as f64;
        let mean = [0, 1].map(|k| residuals.iter().map(|r| r[k]).sum::<f64>() / n);
        let spread =
            [0, 1].map(|k| (residuals.iter().map(|r| (r[k] - mean[k]).powi(2)).sum::<f64>() / (n - 1.0)).sqrt());
        let size = |r: &[f64; 2]| r[0].hypot(r[1]);
        let rms = (residuals.iter().map(|r| size(r).powi(2)).sum::<f64>() / n).sqrt();
        let (some, two) = (n > 0.0, n > 1.0);
        out.write_record([
            mark.name.clone(),
            frames.len().to_string(),
            residuals.len().to_string(),
            count(MarkStatus::Doubtful),
            count(MarkStatus::Missing),
            digits(some.then_some(mean[0]), 3),
            digits(some.then_some(mean[1]), 3),
            digits(two.then_some(spread[0]), 3),
            digits(two.then_some(spread[1]), 3),
            digits(some.then_some(rms), 3),
            digits(some.then(|| residuals.iter().map(size).fold(0.0, f64::max)), 3),
        ])
        .expect("memory takes all");
    }
    text(out)
}

/// One point per mark that has a place. GIS programs show pixel space with y upwards, so y is **minus** the row; `x_px`
/// and `y_px` have the pixels themselves.
pub fn features(frame: &FrameResult) -> Vec<Value> {
    let one = |m: &MarkFind| {
        let c = m.centre?;
        Some(json!({
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [c.x, -c.y]},
            "properties": {"frame": frame.name, "mark": m.mark, "status": m.status, "x_px": c.x, "y_px": c.y,
                "score": m.score, "residual_um": m.residual_um, "reason": m.reason},
        }))
    };
    frame.marks.iter().filter_map(one).collect()
}

/// A collection of [`features`].
pub fn geojson(frame: &FrameResult) -> String {
    json!({"type": "FeatureCollection", "features": features(frame)}).to_string() + "\n"
}
