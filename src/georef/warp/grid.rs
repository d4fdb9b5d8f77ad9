//! The grid of a warped copy.

use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::error::{Error, Result};

/// Where the copy lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    pub transform: GeoTransform,
    pub width: u64,
    pub height: u64,
}

impl Grid {
    /// The smallest north-up grid that holds an image of `width` × `height` pixels. A north-up image keeps its own grid
    /// unless another `resolution` is asked for.
    ///
    /// # Errors
    /// [`Error::Usage`] when the copy would have no pixels, or more than a GeoTIFF can hold across.
    pub fn around(transform: &GeoTransform, width: u64, height: u64, resolution: Option<f64>) -> Result<Grid> {
        let g = transform.0;
        if resolution.is_none() && g[2] == 0.0 && g[4] == 0.0 && g[1] > 0.0 && g[5] < 0.0 {
            return Ok(Grid { transform: *transform, width, height });
        }
        let corners = [(0, 0), (width, 0), (0, height), (width, height)]
            .map(|(x, y)| transform.apply(PixelPoint { x: x as f64, y: y as f64 }));
        let low = |f: fn(&autoref_raster::coords::MapPoint) -> f64| corners.iter().map(f).fold(f64::INFINITY, f64::min);
        let high =
            |f: fn(&autoref_raster::coords::MapPoint) -> f64| corners.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
        let (west, east) = (low(|c| c.easting), high(|c| c.easting));
        let (south, north) = (low(|c| c.northing), high(|c| c.northing));
        let pixel = resolution.unwrap_or_else(|| transform.scale());
        let longest = (east - west).max(north - south);
        if pixel > longest {
            return Err(Error::usage(
                format!("a warped copy with pixels of {pixel:e}, and the image is {longest:.3} across"),
                "give a smaller --resolution, in map units",
            ));
        }
        // A thousandth of a pixel is no reason for another column.
        let count = |length: f64| (length / pixel - 1e-3).ceil().max(1.0);
        let (columns, rows) = (count(east - west), count(north - south));
        if !(columns * rows).is_finite() || columns.max(rows) > f64::from(i32::MAX) {
            return Err(Error::usage(
                format!("a warped copy of {columns} × {rows} pixels"),
                "give a larger --resolution",
            ));
        }
        let transform = GeoTransform([west, pixel, 0.0, north, 0.0, -pixel]);
        Ok(Grid { transform, width: columns as u64, height: rows as u64 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_holds_all_corners_and_a_north_up_image_keeps_its_own() {
        let turned = GeoTransform([100.0, 0.3, -0.4, 200.0, -0.4, -0.3]);
        let grid = Grid::around(&turned, 1000, 500, None).expect("sensible");
        assert!((grid.transform.0[1] - 0.5).abs() < 1e-12, "a pixel keeps its area");
        for (x, y) in [(0.0, 0.0), (1000.0, 0.0), (0.0, 500.0), (1000.0, 500.0)] {
            let p = grid.transform.invert(turned.apply(PixelPoint { x, y })).expect("not singular");
            let slack = 2e-3;
            assert!((-slack..=grid.width as f64 + slack).contains(&p.x), "{p:?} in {grid:?}");
            assert!((-slack..=grid.height as f64 + slack).contains(&p.y), "{p:?} in {grid:?}");
        }
        let up = GeoTransform([100.0, 0.5, 0.0, 200.0, 0.0, -0.25]);
        assert_eq!(Grid::around(&up, 10, 20, None).expect("sensible"), Grid { transform: up, width: 10, height: 20 });
        assert!(Grid::around(&turned, 1000, 500, Some(1e-9)).is_err());
    }
}
