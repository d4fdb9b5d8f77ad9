//! How densely the cells of a mean lie: where holes are scattered, a cell has fewer others to err with.

use crate::error::Result;
use crate::window::Window;

use super::observed::Observed;
use super::scan::Buffers;

/// Cells that are looked at, at most.
const LOOKED_AT: usize = 250;
/// Cells to each side of one.
const REACH_PX: u64 = 2;

/// The share of the cells about `places` that are there, and in the zone. Holes wider than the reach count less than
/// they could: the error of the mean comes out larger then.
///
/// # Errors
/// When a model cannot be read.
pub(super) fn share_beside(observed: &Observed<'_>, places: &[(u64, u64)], zone: Option<u32>) -> Result<f64> {
    let grid = &observed.scan.grid;
    let mut buffers = Buffers::default();
    let (mut there, mut possible) = (0u64, 0u64);
    for &(x, y) in places.iter().take(LOOKED_AT) {
        let (left, top) = (x.saturating_sub(REACH_PX), y.saturating_sub(REACH_PX));
        let (right, bottom) = ((x + REACH_PX + 1).min(grid.width), (y + REACH_PX + 1).min(grid.height));
        let window = Window::new(left, top, right - left, bottom - top);
        possible += window.area() - 1;
        observed.cells(window, &mut buffers, |cell| {
            let is_itself = (cell.x, cell.y) == (x, y);
            there += u64::from(!is_itself && zone.is_none_or(|zone| cell.zones.contains(&zone)));
        })?;
    }
    Ok(if possible == 0 { 1.0 } else { there as f64 / possible as f64 })
}
