//! Every n-th cell of both models, for the page's map.

use base64::prelude::{BASE64_STANDARD as BASE64, Engine as _};
use serde_json::json;

use super::scan::Scan;

/// Cells of the map's longer side at most.
const LONGEST_PX: u64 = 700;

/// Which cells stand for the whole.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sampling {
    step: u64,
    width: u64,
    height: u64,
}

/// A cell of the map: its number, difference and height of B.
pub(super) type Sample = (u32, f32, f32);

impl Sampling {
    pub(super) fn of(width: u64, height: u64) -> Sampling {
        Sampling { step: width.max(height).div_ceil(LONGEST_PX).max(1), width, height }
    }

    fn size(&self) -> (u64, u64) {
        (self.width.div_ceil(self.step), self.height.div_ceil(self.step))
    }

    /// The number of a cell in the map, when it stands there.
    pub(super) fn number(&self, x: u64, y: u64) -> Option<u32> {
        // The middle of each square, or what there is of it at the border.
        let stands = |at: u64, count: u64| at == (at / self.step * self.step + self.step / 2).min(count - 1);
        (stands(x, self.width) && stands(y, self.height))
            .then(|| ((y / self.step) * self.size().0 + x / self.step) as u32)
    }

    /// The map as the page's script takes it.
    pub(super) fn data(&self, scan: &Scan<'_>, samples: &[Sample]) -> serde_json::Value {
        let (width, height) = self.size();
        let nothing = vec![f32::NAN; (width * height) as usize];
        let (mut b, mut d) = (nothing.clone(), nothing);
        for &(number, difference, below) in samples {
            d[number as usize] = difference;
            b[number as usize] = below;
        }
        let grid = scan.grid;
        let (mx, my) = scan.unit.metres_per_unit(grid.centre().1);
        let step = self.step as f64;
        json!({
            "width": width,
            "height": height,
            "cell_x_m": (grid.step_x * mx * step).abs(),
            "cell_y_m": (grid.step_y * my * step).abs(),
            "x0": grid.x0,
            "y0": grid.y0,
            "step_x": grid.step_x * step,
            "step_y": grid.step_y * step,
            "cells_apart": self.step,
            "cells": [self.width, self.height],
            "b": base64(&b),
            "d": base64(&d),
        })
    }
}

/// The values' little-endian bytes as base64.
fn base64(values: &[f32]) -> String {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    BASE64.encode(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_as_the_rfc_has_it() {
        // printf '\x00\x00\x80\x3f' | base64
        assert_eq!(base64(&[1.0]), "AACAPw==");
        assert_eq!(base64(&[1.0, -2.0, 0.5]), "AACAPwAAAMAAAAA/");
    }

    #[test]
    fn every_square_has_one_cell() {
        for (width, height) in [(5, 3), (1401, 3), (1, 1_000_000), (1_000_000, 1), (2100, 1399)] {
            let sampling = Sampling::of(width, height);
            let (columns, rows) = sampling.size();
            let mut seen = 0;
            for y in 0..height {
                seen += (0..width).filter(|&x| sampling.number(x, y).is_some()).count() as u64;
            }
            assert_eq!(seen, columns * rows, "{width} × {height}");
            assert!(columns.max(rows) <= LONGEST_PX);
        }
    }
}
