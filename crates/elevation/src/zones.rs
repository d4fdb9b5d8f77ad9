//! Polygons on the map, met cell centre by cell centre.

use std::collections::BTreeMap;

use autoref_raster::rings::SidesByNorthing;

use crate::grid::GroundUnit;

/// One side of a ring.
#[derive(Clone, Copy, Debug)]
struct Edge {
    low: (f64, f64),
    high: (f64, f64),
    zone: u32,
    /// Of an area a whole turn away, which counts once.
    is_again: bool,
}

/// Numbered areas. A cell belongs to an area when its centre lies inside by the even-odd rule; where areas overlap, to
/// the last of them.
#[derive(Clone, Debug, Default)]
pub struct Zones {
    edges: Vec<Edge>,
    by_northing: SidesByNorthing,
    names: Vec<String>,
}

/// The areas of each cell of a row.
#[derive(Clone, Debug)]
pub struct RowSets {
    of_cell: Vec<u32>,
    /// The first is empty.
    sets: Vec<Vec<u32>>,
}

impl Default for RowSets {
    fn default() -> Self {
        RowSets { of_cell: Vec::new(), sets: vec![Vec::new()] }
    }
}

impl RowSets {
    /// No areas at all.
    pub fn clear(&mut self, cells: usize) {
        self.of_cell.clear();
        self.of_cell.resize(cells, 0);
    }

    /// Numbers of the areas that a cell lies in, from 0 on.
    pub fn of(&self, cell: usize) -> &[u32] {
        &self.sets[self.of_cell[cell] as usize]
    }
}

/// A ring of map positions: easting or longitude first; the last need not repeat the first.
pub type Ring = Vec<(f64, f64)>;

impl Zones {
    /// Each area with its name and all its rings, holes included.
    pub fn new(areas: impl IntoIterator<Item = (String, Vec<Ring>)>) -> Self {
        Self::placed(areas.into_iter().map(|(name, rings)| (name, rings, Vec::new())))
    }

    /// The same, each with those of its rings that lie on the model at a second place, a whole turn away.
    pub(crate) fn placed(areas: impl IntoIterator<Item = (String, Vec<Ring>, Vec<Ring>)>) -> Self {
        let (mut edges, mut names): (Vec<Edge>, _) = (Vec::new(), Vec::new());
        for (name, rings, again) in areas {
            let zone = names.len() as u32;
            names.push(name);
            let rings = rings.iter().map(|ring| (ring, false));
            for (ring, is_again) in rings.chain(again.iter().map(|ring| (ring, true))) {
                for (i, &a) in ring.iter().enumerate() {
                    let b = ring[(i + 1) % ring.len()];
                    if a.1 != b.1 {
                        let (low, high) = if a.1 < b.1 { (a, b) } else { (b, a) };
                        edges.push(Edge { low, high, zone, is_again });
                    }
                }
            }
        }
        let spans: Vec<(f64, f64)> = edges.iter().map(|e| (e.low.1, e.high.1)).collect();
        Zones { edges, by_northing: SidesByNorthing::new(&spans), names }
    }

    /// Of the areas, in their order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Whether there is no area.
    pub fn is_empty(&self) -> bool {
        self.edges.is_empty()
    }

    /// The names of areas whose rectangle does not meet these bounds: west, south, east, north.
    pub(crate) fn outside(&self, [west, south, east, north]: [f64; 4]) -> Vec<String> {
        let none = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        let mut extents = vec![[none; 2]; self.names.len()];
        for edge in &self.edges {
            let extent = &mut extents[edge.zone as usize][usize::from(edge.is_again)];
            for (x, y) in [edge.low, edge.high] {
                *extent = [extent[0].min(x), extent[1].min(y), extent[2].max(x), extent[3].max(y)];
            }
        }
        let meets = |e: &[f64; 4]| e[0] < east && e[2] > west && e[1] < north && e[3] > south;
        let beside = self.names.iter().zip(&extents).filter(|(_, extents)| !extents.iter().any(meets));
        beside.map(|(name, _)| name.clone()).collect()
    }

    /// What each area covers by the even-odd rule, square metres: the length of 2048 level lines through it, each as
    /// wide as the distance to the next; good to a thousandth.
    pub fn areas_m2(&self, unit: &GroundUnit) -> Vec<f64> {
        const LINES: usize = 2048;
        let mut areas = vec![0.0; self.names.len()];
        for edges in self.edges.chunk_by(|a, b| a.zone == b.zone) {
            let low = edges.iter().map(|e| e.low.1).fold(f64::INFINITY, f64::min);
            let high = edges.iter().map(|e| e.high.1).fold(f64::NEG_INFINITY, f64::max);
            let apart = (high - low) / LINES as f64;
            let northing = |line: usize| low + (line as f64 + 0.5) * apart;
            let mut crossings: Vec<(usize, f64)> = Vec::new();
            for e in edges.iter().filter(|e| !e.is_again) {
                let first = |y: f64| ((y - low) / apart - 0.5).ceil().clamp(0.0, LINES as f64) as usize;
                let across = (e.high.0 - e.low.0) / (e.high.1 - e.low.1);
                let lines = first(e.low.1)..first(e.high.1);
                crossings.extend(lines.map(|line| (line, e.low.0 + across * (northing(line) - e.low.1))));
            }
            crossings.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            let area = &mut areas[edges[0].zone as usize];
            for pair in crossings.chunks_exact(2).filter(|pair| pair[0].0 == pair[1].0) {
                let (mx, my) = unit.metres_per_unit(northing(pair[0].0));
                *area += (pair[1].1 - pair[0].1) * mx * apart * my;
            }
        }
        areas
    }

    /// All areas of the cells of a row, whose centres are `x0 + i·step` at height `y` of the map.
    pub fn row_sets(&self, y: f64, (x0, step): (f64, f64), cells: usize, out: &mut RowSets) {
        out.of_cell.clear();
        out.of_cell.resize(cells, 0);
        out.sets.truncate(1);
        // Where the set changes, from left to right: one more or one less of an area.
        let mut changes: Vec<(usize, u32, i32)> = Vec::new();
        self.spans(y, (x0, step), cells, |zone, from, to| changes.extend([(from, zone, 1), (to, zone, -1)]));
        changes.sort_unstable();
        let mut inside: BTreeMap<u32, i32> = BTreeMap::new();
        let mut changes = changes.into_iter().peekable();
        while let Some((from, zone, by)) = changes.next() {
            let depth = inside.entry(zone).or_default();
            *depth += by;
            if *depth == 0 {
                inside.remove(&zone);
            }
            let Some(&(to, ..)) = changes.peek() else { break };
            if from < to && !inside.is_empty() {
                out.of_cell[from..to].fill(out.sets.len() as u32);
                out.sets.push(inside.keys().copied().collect());
            }
        }
    }

    /// Number + 1 of the area of each cell centre `x0 + i·step` at height `y` of the map; 0 outside all.
    pub fn row(&self, y: f64, x0: f64, step: f64, out: &mut [u32]) {
        out.fill(0);
        self.spans(y, (x0, step), out.len(), |zone, from, to| out[from..to].fill(zone + 1));
    }

    /// Area, first cell and the one after the last of all stretches inside areas, area by area.
    fn spans(&self, y: f64, (x0, step): (f64, f64), cells: usize, mut see: impl FnMut(u32, usize, usize)) {
        let mut crossings: Vec<(u32, f64)> = self
            .by_northing
            .near(y)
            .iter()
            .map(|&i| &self.edges[i as usize])
            .filter(|e| e.low.1 <= y && y < e.high.1)
            .map(|e| (e.zone, e.low.0 + (e.high.0 - e.low.0) * ((y - e.low.1) / (e.high.1 - e.low.1))))
            .collect();
        crossings.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        for pair in crossings.chunks_exact(2).filter(|pair| pair[0].0 == pair[1].0) {
            let (a, b) = ((pair[0].1 - x0) / step, (pair[1].1 - x0) / step);
            // Centres from the lower crossing on, the upper one left out.
            let from = a.min(b).ceil().clamp(0.0, cells as f64) as usize;
            let to = a.max(b).ceil().clamp(0.0, cells as f64) as usize;
            if from < to {
                see(pair[0].0, from, to);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_and_overlaps() {
        let square = |a: f64, b: f64| vec![(a, a), (b, a), (b, b), (a, b)];
        let zones = Zones::new([
            ("ring".into(), vec![square(0.0, 10.0), square(3.0, 7.0)]),
            ("corner".into(), vec![square(8.0, 12.0)]),
        ]);
        let mut out = [9u32; 12];
        zones.row(5.0, 0.5, 1.0, &mut out);
        assert_eq!(out, [1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 0, 0]);
        zones.row(9.0, 0.5, 1.0, &mut out);
        assert_eq!(out, [1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2]);
        let mut sets = RowSets::default();
        zones.row_sets(9.0, (0.5, 1.0), 12, &mut sets);
        assert_eq!([0, 7, 8, 9, 10, 11].map(|cell| sets.of(cell)), [&[0][..], &[0], &[0, 1], &[0, 1], &[1], &[1]]);
        zones.row_sets(5.0, (0.5, 1.0), 12, &mut sets);
        assert_eq!([2, 3, 7, 10].map(|cell| sets.of(cell)), [&[0][..], &[], &[0], &[]]);
        zones.row(-1.0, 0.5, 1.0, &mut out);
        assert_eq!(out, [0; 12]);
        let areas = zones.areas_m2(&GroundUnit::Projected { metres_per_unit: 2.0 });
        // The hole ends between two lines.
        assert!((areas[0] / (4.0 * 84.0) - 1.0).abs() < 1e-3 && (areas[1] - 4.0 * 16.0).abs() < 1e-6, "{areas:?}");
    }
}
