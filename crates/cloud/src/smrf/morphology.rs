//! Grey openings with discs.

use rayon::prelude::*;

use super::surface::Surface;

/// Rows of one piece of work.
const BAND_ROWS: usize = 64;

/// What is taken over the disc.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extremum {
    Least,
    Greatest,
}

/// The least or greatest value in a disc of `radius` cells about every cell (dx² + dy² ≤ radius²); beyond the border
/// there is nothing. The surface must hold no NaN.
///
/// Rows of growing half-width are made one from the other: a window of half-width w + 1 is the union of those of
/// half-width w one cell to the left and to the right.
pub fn extremum(surface: &Surface, radius: usize, which: Extremum) -> Surface {
    match which {
        Extremum::Least => over_discs(surface, radius, |a, b| if b < a { b } else { a }),
        Extremum::Greatest => over_discs(surface, radius, |a, b| if b > a { b } else { a }),
    }
}

fn over_discs(surface: &Surface, radius: usize, better: impl Fn(f64, f64) -> f64 + Sync) -> Surface {
    let (columns, rows) = (surface.columns, surface.rows);
    let half_widths: Vec<usize> = (0..=radius).map(|dy| (radius * radius - dy * dy).isqrt()).collect();
    let mut result = surface.clone();
    result.values.par_chunks_mut(BAND_ROWS * columns).enumerate().for_each(|(band, out)| {
        let begin = band * BAND_ROWS;
        let end = begin + out.len() / columns;
        let mut wide = vec![0.0; columns];
        let mut wider = vec![0.0; columns];
        for source in begin.saturating_sub(radius)..(end + radius).min(rows) {
            wide.copy_from_slice(surface.row(source));
            let mut half = 0;
            for dy in (0..=radius).rev() {
                while half < half_widths[dy] {
                    widen(&wide, &mut wider, half, &better);
                    std::mem::swap(&mut wide, &mut wider);
                    half += 1;
                }
                let mut combine = |row: usize| {
                    if (begin..end).contains(&row) {
                        let target = &mut out[(row - begin) * columns..(row - begin + 1) * columns];
                        target.iter_mut().zip(&wide).for_each(|(a, &b)| *a = better(*a, b));
                    }
                };
                combine(source + dy);
                if dy > 0 && dy <= source {
                    combine(source - dy);
                }
            }
        }
    });
    result
}

/// From half-width `half` to the next one.
fn widen(wide: &[f64], wider: &mut [f64], half: usize, better: &impl Fn(f64, f64) -> f64) {
    let n = wide.len();
    if n == 1 {
        wider[0] = wide[0];
        return;
    }
    wider[0] = better(wide[0], wide[1]);
    wider[n - 1] = better(wide[n - 1], wide[n - 2]);
    for x in 1..n - 1 {
        wider[x] = better(wide[x - 1], wide[x + 1]);
    }
    if half == 0 {
        wider.iter_mut().zip(wide).for_each(|(a, &b)| *a = better(*a, b));
    }
}

/// Erosion, then dilation, with the same disc.
pub fn opening(surface: &Surface, radius: usize) -> Surface {
    extremum(&extremum(surface, radius, Extremum::Least), radius, Extremum::Greatest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute(surface: &Surface, radius: isize, which: Extremum) -> Vec<f64> {
        let (columns, rows) = (surface.columns as isize, surface.rows as isize);
        let mut out = Vec::new();
        for y in 0..rows {
            for x in 0..columns {
                let mut best = surface.values[(y * columns + x) as usize];
                for dy in -radius..=radius {
                    for dx in -radius..=radius {
                        let (px, py) = (x + dx, y + dy);
                        if dx * dx + dy * dy <= radius * radius && px >= 0 && py >= 0 && px < columns && py < rows {
                            let value = surface.values[(py * columns + px) as usize];
                            best = if which == Extremum::Least { best.min(value) } else { best.max(value) };
                        }
                    }
                }
                out.push(best);
            }
        }
        out
    }

    proptest! {
        #[test]
        fn discs_are_the_definition(columns in 1usize..20, rows in 1usize..90, radius in 0usize..8, seed in 0u64..1000) {
            let value = |i: usize| ((i as u64 * 2_654_435_761 + seed * 97) % 1009) as f64;
            let values = (0..columns * rows).map(value).collect();
            let surface = Surface { columns, rows, values };
            for which in [Extremum::Least, Extremum::Greatest] {
                prop_assert_eq!(extremum(&surface, radius, which).values, brute(&surface, radius as isize, which));
            }
        }
    }
}
