//! Morphology of bit masks: median, dilation, closing and opening with a structuring element, filling of holes.
//!
//! Beyond the mask's window there is background for dilation and median, and no obstacle for erosion.

use super::{Element, Mask};
use crate::window::Window;

/// Bits of word `i` of a row moved by `k` columns: bit `j` is column `64·i + j + k`, 0 outside.
fn shifted(row: &[u64], i: usize, k: i64) -> u64 {
    let start = 64 * i as i64 + k;
    let (word, bit) = (start.div_euclid(64), start.rem_euclid(64) as u32);
    let at = |w: i64| usize::try_from(w).ok().and_then(|w| row.get(w)).copied().unwrap_or(0);
    if bit == 0 { at(word) } else { at(word) >> bit | at(word + 1) << (64 - bit) }
}

/// Clears the padding bits of the last word of each row.
fn trim(mask: &mut Mask) {
    let window = mask.window();
    let used = window.width % 64;
    if used == 0 {
        return;
    }
    for y in window.y..window.bottom() {
        if let Some(last) = mask.row_mut(y).last_mut() {
            *last &= (1 << used) - 1;
        }
    }
}

/// Dilation, then erosion.
pub fn closed(mask: &Mask, element: &Element) -> Mask {
    eroded(&dilated(mask, element), element)
}

/// Erosion, then dilation.
pub fn opened(mask: &Mask, element: &Element) -> Mask {
    dilated(&eroded(mask, element), element)
}

/// Every place where the element would touch the mask: p is set when p − s is, for any step s of the element.
pub fn dilated(mask: &Mask, element: &Element) -> Mask {
    grown(mask, element.steps().map(|(x, y)| (-x, -y)))
}

/// Every place where the element lies within the mask: p is set when p + s is, for all steps s of the element.
pub fn eroded(mask: &Mask, element: &Element) -> Mask {
    complement(&grown(&complement(mask), element.steps()))
}

/// Foreground for background and the other way round.
pub fn complement(mask: &Mask) -> Mask {
    let mut out = mask.clone();
    let window = mask.window();
    for y in window.y..window.bottom() {
        out.row_mut(y).iter_mut().for_each(|w| *w = !*w);
    }
    trim(&mut out);
    out
}

/// Sets every pixel that has foreground at one of these steps (columns, rows) from it.
fn grown(mask: &Mask, steps: impl Iterator<Item = (i64, i64)>) -> Mask {
    let window = mask.window();
    let mut rows: Vec<(i64, Vec<i64>)> = Vec::new();
    for (dx, dy) in steps {
        match rows.iter_mut().find(|(y, _)| *y == dy) {
            Some((_, columns)) => columns.push(dx),
            None => rows.push((dy, vec![dx])),
        }
    }
    let mut out = Mask::new(window);
    for y in window.y..window.bottom() {
        let row = out.row_mut(y);
        for (dy, columns) in &rows {
            let Some(v) = y.checked_add_signed(*dy).filter(|v| (window.y..window.bottom()).contains(v)) else {
                continue;
            };
            let from = mask.row(v);
            if from.iter().all(|&w| w == 0) {
                continue;
            }
            for (i, to) in row.iter_mut().enumerate() {
                for k in columns {
                    *to |= shifted(from, i, *k);
                }
            }
        }
    }
    trim(&mut out);
    out
}

/// Majority of 3 × 3.
pub fn median3(mask: &Mask) -> Mask {
    let window = mask.window();
    let mut out = Mask::new(window);
    for y in window.y..window.bottom() {
        let rows: Vec<&[u64]> =
            (y.saturating_sub(1).max(window.y)..(y + 2).min(window.bottom())).map(|v| mask.row(v)).collect();
        for (i, to) in out.row_mut(y).iter_mut().enumerate() {
            // Bit-sliced count of up to nine ones.
            let mut count = [0u64; 4];
            for bits in rows.iter().flat_map(|row| (-1..=1).map(|k| shifted(row, i, k))) {
                let mut carry = bits;
                for digit in &mut count {
                    (*digit, carry) = (*digit ^ carry, *digit & carry);
                }
            }
            // Five or more: 8 or 9, or 4 with anything below.
            *to = count[3] | count[2] & (count[0] | count[1]);
        }
    }
    trim(&mut out);
    out
}

/// Fills 4-connected holes of 8-connected regions whose bounding box is at most `max_side_px` on each side.
pub fn fill_holes(mask: &mut Mask, max_side_px: u64) {
    let window = mask.window();
    let mut seen = Mask::new(window);
    let mut fills: Vec<(u64, u64)> = Vec::new();
    for y in window.y + 1..window.bottom().saturating_sub(1) {
        for i in 0..mask.row(y).len() {
            // A hole's first pixel in raster order has foreground to its left and above it.
            let (here, above) = (mask.row(y)[i], mask.row(y - 1)[i]);
            let mut starts = !here & above & shifted(mask.row(y), i, -1);
            while starts != 0 {
                let x = window.x + 64 * i as u64 + u64::from(starts.trailing_zeros());
                starts &= starts - 1;
                if x + 1 >= window.right() || seen.get(x, y) {
                    continue;
                }
                let Some(hole) = bounded_set(mask, (x, y), max_side_px) else { continue };
                for &(u, v) in &hole {
                    seen.set(u, v, true);
                }
                if bounded_set(mask, (x - 1, y), max_side_px).is_some() {
                    fills.extend(hole);
                }
            }
        }
    }
    for (x, y) in fills {
        mask.set(x, y, true);
    }
}

/// The set of equal pixels connected to `start` (8-connected foreground, 4-connected background); `None` when it is
/// larger than `max_side_px` on a side, or background that touches the window's edge.
fn bounded_set(mask: &Mask, start: (u64, u64), max_side_px: u64) -> Option<Vec<(u64, u64)>> {
    let window = mask.window();
    let foreground = mask.get(start.0, start.1);
    let mut set = std::collections::BTreeSet::from([start]);
    let mut todo = vec![start];
    let mut bounds = Window::new(start.0, start.1, 1, 1);
    while let Some((x, y)) = todo.pop() {
        bounds = bounds.union(&Window::new(x, y, 1, 1));
        if bounds.width > max_side_px || bounds.height > max_side_px {
            return None;
        }
        for (dx, dy) in [(-1i64, 0i64), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
            let diagonal = dx != 0 && dy != 0;
            let (u, v) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            if !window.contains(u, v) {
                if !foreground && !diagonal {
                    return None;
                }
                continue;
            }
            if (foreground || !diagonal) && mask.get(u, v) == foreground && set.insert((u, v)) {
                todo.push((u, v));
            }
        }
    }
    Some(set.into_iter().collect())
}
