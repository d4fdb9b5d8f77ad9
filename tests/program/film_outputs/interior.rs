//! The numbers of the interior orientation against calculations of their own.

use super::{Roll, affine};
use autoref_film::interior::{Observation, solve};
use autoref_film::{InteriorModel, load_camera};
use autoref_raster::coords::{Handedness, PixelPoint};

/// The numbers of the tables and of the JSON against least squares written out here.
#[test]
fn tables_of_the_interior_orientation_are_those_of_an_independent_calculation() {
    let roll = Roll::new("wild-15-4", "80", &["--frames", "3", "--seed", "4"]);
    roll.fiducials(&["--exports"], 0);
    let cell = |row: &csv::StringRecord, k: usize| row[k].parse::<f64>().unwrap_or_else(|_| panic!("{row:?} {k}"));
    let read = |name: &str| -> Vec<csv::StringRecord> {
        let mut csv = csv::Reader::from_path(roll.out(name)).expect("written");
        csv.records().map(|r| r.expect("a row")).collect()
    };
    let rows = read("inner_orientation.csv");
    assert_eq!(rows.len(), 3);
    let film: Vec<[f64; 2]> =
        roll.camera.marks.iter().map(|m| [m.x_mm.expect("there"), m.y_mm.expect("there")]).collect();
    let n = film.len();
    let size = |r: &[f64; 2]| r[0].hypot(r[1]);
    let rms = |all: &[[f64; 2]]| (all.iter().map(|r| size(r).powi(2)).sum::<f64>() / all.len() as f64).sqrt();
    let mut by_mark: Vec<Vec<[f64; 2]>> = vec![vec![]; n];
    for row in &rows {
        let frame = roll.frame(&row[0]);
        let px: Vec<[f64; 2]> = frame.marks.iter().map(|m| m.centre.map(|c| [c.x, c.y]).expect("found")).collect();
        let off = |f: &dyn Fn([f64; 2]) -> [f64; 2], i: usize| [0, 1].map(|k| 1e3 * (f(px[i])[k] - film[i][k]));
        let all = affine(&px, &film);
        let residuals: Vec<[f64; 2]> = (0..n).map(|i| off(&all, i)).collect();
        let without = |i: usize| {
            let keep = |v: &[[f64; 2]]| [&v[..i], &v[i + 1..]].concat();
            affine(&keep(&px), &keep(&film))
        };
        let left_out: Vec<[f64; 2]> = (0..n).map(|i| off(&without(i), i)).collect();
        let close = |k: usize, should: f64| {
            let is = cell(row, k);
            assert!((is - should).abs() < 6e-4, "column {k} of {row:?}: {should}");
        };
        assert_eq!((&row[1], &row[2], &row[3], &row[4]), ("ok", "affine", "8", "10"));
        close(5, rms(&residuals));
        close(6, rms(&residuals) * (n as f64 / 10.0).sqrt());
        close(7, residuals.iter().map(size).fold(0.0, f64::max));
        close(8, rms(&left_out));
        let inner = frame.interior.as_ref().expect("solved");
        for (i, r) in residuals.iter().enumerate() {
            let (said, out) = (frame.marks[i].residual_um.expect("solved"), inner.leave_one_out_um[i].expect("enough"));
            assert!((said[0] - r[0]).hypot(said[1] - r[1]) < 1e-6 && size(&left_out[i]) > size(r));
            assert!((out[0] - left_out[i][0]).hypot(out[1] - left_out[i][1]) < 1e-6, "{out:?} {:?}", left_out[i]);
            by_mark[i].push(*r);
        }
        // Film and scanner are drawn without shear, certificates are 3 µm off: a few ten ppm.
        assert!(cell(row, 12).abs() < 100.0 && cell(row, 13).abs() < 100.0 && (cell(row, 9) / 80.0 - 1.0).abs() < 1e-3);
    }
    for (row, (mark, residuals)) in read("roll_marks.csv").iter().zip(roll.camera.marks.iter().zip(&by_mark)) {
        assert_eq!((&row[0], &row[1], &row[2], &row[3], &row[4]), (mark.name.as_str(), "3", "3", "0", "0"));
        for k in 0..2 {
            let mean = residuals.iter().map(|r| r[k]).sum::<f64>() / 3.0;
            let sd = (residuals.iter().map(|r| (r[k] - mean).powi(2)).sum::<f64>() / 2.0).sqrt();
            assert!((cell(row, 5 + k) - mean).abs() < 6e-4 && (cell(row, 7 + k) - sd).abs() < 6e-4, "{row:?}");
        }
        assert!((cell(row, 9) - rms(residuals)).abs() < 6e-4);
        assert!((cell(row, 10) - residuals.iter().map(size).fold(0.0, f64::max)).abs() < 6e-4);
    }
}

/// Covariances by moving every coordinate a little and solving again, for all models; and what can be left out.
#[test]
fn covariances_are_those_of_propagated_errors_and_leaving_out_needs_redundancy() {
    let camera = load_camera("wild-15-4").expect("built in");
    let sigma_px = 0.1;
    let at = |mm: [f64; 2], k: usize| {
        // A turned scan with residuals of about 0.05 px, well below the stated precision.
        let (x, y) = (2900.0 + 11.9 * mm[0] - 0.4 * mm[1], 2850.0 - 0.4 * mm[0] - 11.9 * mm[1]);
        PixelPoint { x: x + 0.03 * ((k * 7 % 5) as f64 - 2.0), y: y + 0.03 * ((k * 3 % 5) as f64 - 2.0) }
    };
    let marks: Vec<Observation> = camera
        .marks
        .iter()
        .enumerate()
        .map(|(k, m)| {
            let mm = [m.x_mm.expect("there"), m.y_mm.expect("there")];
            let covariance_px2 = [sigma_px * sigma_px, 0.0, sigma_px * sigma_px];
            Observation { name: m.name.clone(), mm, pixel: at(mm, k), covariance_px2 }
        })
        .collect();
    for (model, free) in [(InteriorModel::Similarity, 4), (InteriorModel::Affine, 6), (InteriorModel::Projective, 8)] {
        let inner = solve(&camera, &marks, model, Handedness::AsIs).expect("solved");
        // Similarity: a = h0, b = −h1, X₀, Y₀; the others: h0 and on.
        let free_of =
            |h: &[f64; 9]| -> Vec<f64> { if free == 4 { vec![h[0], -h[1], h[2], h[5]] } else { h[..free].to_vec() } };
        let step = 1e-4;
        let mut propagated = vec![vec![0.0; free]; free];
        for i in 0..marks.len() {
            for axis in 0..2 {
                let moved = |by: f64| {
                    let mut next = marks.clone();
                    // An error of a millimetre coordinate: the program takes a pixel's error for one on the film.
                    next[i].mm[axis] += by;
                    free_of(&solve(&camera, &next, model, Handedness::AsIs).expect("solved").pixel_to_mm)
                };
                let (up, down) = (moved(step), moved(-step));
                let sigma_mm = sigma_px * inner.pixel_um / 1e3;
                let d: Vec<f64> = up.iter().zip(&down).map(|(a, b)| (a - b) / (2.0 * step) * sigma_mm).collect();
                for a in 0..free {
                    for b in 0..free {
                        propagated[a][b] += d[a] * d[b];
                    }
                }
            }
        }
        for a in 0..free {
            for b in 0..free {
                let unit = (propagated[a][a] * propagated[b][b]).sqrt();
                let off = (inner.covariance[a][b] - propagated[a][b]).abs() / unit;
                assert!(off < 0.01, "{model:?} {a} {b}: {} {}", inner.covariance[a][b], propagated[a][b]);
            }
        }
        // One mark fewer than the model needs to be left out: the corners are enough for a similarity and an affine
        // only.
        let four = solve(&camera, &marks[..4], model, Handedness::AsIs).expect("solved");
        assert!(four.leave_one_out_um.iter().all(Option::is_some) && four.leave_one_out_rmse_um.is_some());
        assert_ne!(four.model, InteriorModel::Projective, "four marks leave a projective unchecked");
        let two = solve(&camera, &marks[..2], model, Handedness::AsIs).expect("solved");
        assert!(two.leave_one_out_um.iter().all(Option::is_none) && two.leave_one_out_rmse_um.is_none());
    }
}
