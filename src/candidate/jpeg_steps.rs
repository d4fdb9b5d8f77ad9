//! The steps in which a JPEG rounded the coefficients of a picture, found in the picture.

use nalgebra::{Matrix3, Vector3};

use autoref_raster::Patch;

/// Side of a block.
pub(super) const N: usize = 8;
pub(super) const CELLS: usize = N * N;
/// Pixels or coefficients of a block, in rows.
pub(super) type Cells = [f64; CELLS];

/// From red, green and blue to luma and the differences of blue and red from it (ITU-T T.871, 2011).
#[rustfmt::skip]
pub(super) const TO_YCC: Matrix3<f64> = Matrix3::new(
    0.299, 0.587, 0.114,
    -0.168_736, -0.331_264, 0.5,
    0.5, -0.418_688, -0.081_312,
);

/// The tables that libjpeg scales (ITU-T T.81, annex K.1), luma and chroma, in rows.
const LUMA: [u16; CELLS] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51,
    87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];
const CHROMA: [u16; CELLS] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99, 47, 66, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99,
];

/// The orthonormal cosine transform of 8 samples: `[sample][frequency]`.
pub(super) struct Cosines([[f64; N]; N]);

impl Cosines {
    pub fn new() -> Cosines {
        let norm = |k: usize| (if k == 0 { 1.0 } else { 2.0 } / N as f64).sqrt();
        let turn = |x: usize, k: usize| std::f64::consts::PI * ((2 * x + 1) * k) as f64 / (2 * N) as f64;
        Cosines(std::array::from_fn(|x| std::array::from_fn(|k| norm(k) * turn(x, k).cos())))
    }

    /// Of a block, rows being frequencies in y.
    pub fn transform(&self, block: &Cells) -> Cells {
        let mut half = [0.0; CELLS];
        for (cells, out) in block.chunks_exact(N).zip(half.chunks_exact_mut(N)) {
            for (cell, cosines) in cells.iter().zip(&self.0) {
                for k in 0..N {
                    out[k] += cell * cosines[k];
                }
            }
        }
        let mut all = [0.0; CELLS];
        for (row, cosines) in half.chunks_exact(N).zip(&self.0) {
            for (out, cosine) in all.chunks_exact_mut(N).zip(cosines) {
                for x in 0..N {
                    out[x] += cosine * row[x];
                }
            }
        }
        all
    }

    /// The block that has these coefficients.
    pub fn back(&self, coefficients: &Cells) -> Cells {
        let mut half = [0.0; CELLS];
        for (row, cosines) in half.chunks_exact_mut(N).zip(&self.0) {
            for (coefficients, cosine) in coefficients.chunks_exact(N).zip(cosines) {
                for x in 0..N {
                    row[x] += cosine * coefficients[x];
                }
            }
        }
        let mut block = [0.0; CELLS];
        for (row, out) in half.chunks_exact(N).zip(block.chunks_exact_mut(N)) {
            for (cell, cosines) in out.iter_mut().zip(&self.0) {
                *cell = row.iter().zip(cosines).map(|(a, b)| a * b).sum();
            }
        }
        block
    }
}

/// The steps of a quality.
pub(super) struct Tables {
    /// As libjpeg counts.
    pub quality: u32,
    pub luma: Cells,
    pub chroma: Cells,
}

impl Tables {
    fn of(quality: u32) -> Tables {
        Tables { quality, luma: steps(&LUMA, quality), chroma: steps(&CHROMA, quality) }
    }

    /// The tables whose steps the luma of a patch shows, on a grid that begins at the image's corner (tiles of a TIFF
    /// begin at multiples of 16); `None` when it shows none, or those of no table that libjpeg makes.
    pub fn shown_by(patch: &Patch, cosines: &Cosines) -> Option<Tables> {
        /// Natural logarithm of how much likelier the steps are than none.
        const LEAST: f64 = 25.0;
        let seen = low_frequencies(patch, cosines);
        // Steps rise as the quality falls, mostly by nothing: what was counted for a step is kept.
        let mut last = [(0.0, 0.0); CELLS];
        let evidence = |quality: u32| {
            let steps = steps(&LUMA, quality);
            let of = |(k, values): (usize, &Vec<f64>)| {
                if last[k].0 != steps[k] {
                    last[k] = (steps[k], values.iter().map(|&c| evidence(c, steps[k])).sum());
                }
                last[k].1
            };
            (seen.iter().enumerate().filter(|(_, v)| !v.is_empty()).map(of).sum::<f64>(), quality)
        };
        let best = (25..=97).map(evidence).max_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 > LEAST).then(|| Tables::of(best.1))
    }
}

/// Steps of a table at a quality, as libjpeg scales it.
fn steps(table: &[u16; CELLS], quality: u32) -> Cells {
    let scale = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    table.map(|q| f64::from(((u32::from(q) * scale + 50) / 100).clamp(1, 255)))
}

/// Logarithm of the likelihood of a coefficient when it was rounded in steps, over that when it was not.
fn evidence(coefficient: f64, step: f64) -> f64 {
    /// Of a coefficient of rounded samples.
    const SD: f64 = 0.45;
    let n = (coefficient / step).round();
    let z = (coefficient - n * step) / SD;
    let gain = ((step / SD).ln() - 0.5 * std::f64::consts::TAU.ln() - 0.5 * z * z).max(-4.0);
    // Smooth ground has small coefficients anyway.
    if n == 0.0 { gain.min(0.0) } else { gain }
}

/// Coefficients of luma of the blocks that lie in the patch with nothing saturated: of each low frequency its values.
fn low_frequencies(patch: &Patch, cosines: &Cosines) -> Vec<Vec<f64>> {
    const HIGHEST: usize = 4;
    const MOST_BLOCKS: usize = 24;
    let window = &patch.window;
    let (width, height) = (window.width as usize, window.height as usize);
    let first = |at: u64| (N as u64 - at % N as u64) as usize % N;
    let scale = 255.0 / f64::from(patch.white);
    let mut seen = vec![Vec::new(); CELLS];
    let rows = (first(window.y)..(height + 1).saturating_sub(N)).step_by(N);
    let corners = rows.flat_map(|y| (first(window.x)..(width + 1).saturating_sub(N)).step_by(N).map(move |x| (x, y)));
    let clear = |at: usize| patch.valid[at] && patch.rgb[at].iter().all(|&v| v > 0 && v < patch.white);
    let place = |(x, y): (usize, usize), i: usize| (y + i / N) * width + x + i % N;
    for corner in corners.filter(|&c| (0..CELLS).all(|i| clear(place(c, i)))).take(MOST_BLOCKS) {
        let luma = |i: usize| {
            let rgb = Vector3::from(patch.rgb[place(corner, i)].map(|v| f64::from(v) * scale));
            TO_YCC.row(0).transpose().dot(&rgb) - 128.0
        };
        let all = cosines.transform(&std::array::from_fn(luma));
        for k in (0..CELLS).filter(|k| k / N + k % N <= HIGHEST) {
            seen[k].push(all[k]);
        }
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::window::Window;
    use autoref_synth::plant::{Picture, Random};

    /// Smooth hills with grain on them.
    fn picture(random: &mut Random) -> Picture {
        let (width, height) = (64, 64);
        let rgb = (0..width * height).map(|i| {
            let (x, y) = ((i % width) as f64, (i / width) as f64);
            let hill = 110.0 + 40.0 * (x / 7.0).sin() * (y / 9.0).cos() + 12.0 * random.gauss();
            [1.0, 0.9, 0.7].map(|c| (c * hill).round().clamp(1.0, 254.0) as u8)
        });
        Picture { width, height, rgb: rgb.collect() }
    }

    fn patch(picture: &Picture, x: usize, y: usize) -> Patch {
        let cut = picture.crop(x, y, 48, 48);
        let rgb: Vec<[u16; 3]> = cut.rgb.iter().map(|c| c.map(u16::from)).collect();
        Patch { window: Window::new(x as u64, y as u64, 48, 48), valid: vec![true; rgb.len()], rgb, white: 255 }
    }

    #[test]
    fn the_quality_of_a_jpeg_shows_in_it_and_none_where_there_was_none() {
        let (mut random, cosines) = (Random(7), Cosines::new());
        for quality in [50, 75, 85, 90] {
            let seen = picture(&mut random).through_jpeg(quality);
            for (x, y) in [(0, 0), (3, 5), (13, 16)] {
                let shown = Tables::shown_by(&patch(&seen, x, y), &cosines).map(|t| t.quality);
                assert!(shown.is_some_and(|q| q.abs_diff(u32::from(quality)) <= 1), "{shown:?} for {quality}");
            }
            // The grid is the image's: moved off it, the steps are gone.
            let mut moved = patch(&seen, 8, 8);
            moved.window = Window::new(11, 12, 48, 48);
            assert!(Tables::shown_by(&moved, &cosines).is_none());
        }
        for _ in 0..20 {
            assert!(Tables::shown_by(&patch(&picture(&mut random), 0, 0), &cosines).is_none());
        }
    }

    #[test]
    fn the_transform_is_orthonormal() {
        let (cosines, mut random) = (Cosines::new(), Random(3));
        let cells: Cells = std::array::from_fn(|_| random.gauss());
        let all = cosines.transform(&cells);
        let square = |c: &Cells| c.iter().map(|v| v * v).sum::<f64>();
        assert!((square(&all) - square(&cells)).abs() < 1e-9);
        assert!((all[0] - cells.iter().sum::<f64>() / 8.0).abs() < 1e-12);
        let again = cosines.back(&all);
        assert!(again.iter().zip(&cells).all(|(a, b)| (a - b).abs() < 1e-9));
        let wave: Cells = std::array::from_fn(|i| (std::f64::consts::PI * (2 * (i / N) + 1) as f64 * 3.0 / 16.0).cos());
        let all = cosines.transform(&wave);
        assert!((0..CELLS).all(|k| (all[k].abs() > 1e-9) == (k == 3 * N)));
    }
}
