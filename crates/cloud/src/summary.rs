//! What a report shows of a cleaned cloud: histograms of heights, and a map of what each step took.

use serde::Serialize;

/// Bins of a histogram of heights.
pub const BINS: usize = 60;
/// Cells of the map along its longer side.
const MAP_CELLS: usize = 96;

/// Counts over the whole cloud, in map coordinates.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub min: [f64; 3],
    pub max: [f64; 3],
    /// Points by class as written: unclassified or as it came, ground, noise.
    pub unclassified: u64,
    pub ground: u64,
    pub noise: u64,
    pub dropped: u64,
    pub height_min_m: f64,
    pub height_max_m: f64,
    /// Points by height: all of them, then those that each step classified.
    pub heights: Vec<u64>,
    pub heights_by_step: Vec<Vec<u64>>,
    pub step_names: Vec<String>,
    pub map_columns: usize,
    pub map_rows: usize,
    #[serde(skip)]
    pub map: Vec<u64>,
    #[serde(skip)]
    pub map_by_step: Vec<Vec<u64>>,
    #[serde(skip)]
    shift: [f64; 3],
}

impl Summary {
    pub fn new<'a>(steps: impl Iterator<Item = &'a str>, min: [f64; 3], max: [f64; 3], shift: [f64; 3]) -> Summary {
        let step_names: Vec<String> = steps.map(String::from).collect();
        let (min, max) = ([0, 1, 2].map(|axis| min[axis] + shift[axis]), [0, 1, 2].map(|axis| max[axis] + shift[axis]));
        let (width, height) = (max[0] - min[0], max[1] - min[1]);
        let longer = width.max(height).max(f64::MIN_POSITIVE);
        let cells = |side: f64| ((side / longer * MAP_CELLS as f64).ceil() as usize).clamp(1, MAP_CELLS);
        let (map_columns, map_rows) = (cells(width), cells(height));
        Summary {
            min,
            max,
            unclassified: 0,
            ground: 0,
            noise: 0,
            dropped: 0,
            height_min_m: min[2],
            height_max_m: max[2],
            heights: vec![0; BINS],
            heights_by_step: vec![vec![0; BINS]; step_names.len()],
            map_columns,
            map_rows,
            map: vec![0; map_columns * map_rows],
            map_by_step: vec![vec![0; map_columns * map_rows]; step_names.len()],
            step_names,
            shift,
        }
    }

    /// Takes a point of the file's coordinates; `step` counts from 1, 0 is none.
    pub fn add(&mut self, xyz: [f64; 3], class: u8, step: u8, dropped: bool) {
        let share = |axis: usize| {
            let extent = self.max[axis] - self.min[axis];
            if extent > 0.0 { (xyz[axis] + self.shift[axis] - self.min[axis]) / extent } else { 0.0 }
        };
        let cell = |share: f64, count: usize| ((share * count as f64) as usize).min(count - 1);
        let bin = cell(share(2), BINS);
        let place = cell(1.0 - share(1), self.map_rows) * self.map_columns + cell(share(0), self.map_columns);
        self.heights[bin] += 1;
        self.map[place] += 1;
        // What a step took: noise, or what it found not to be ground.
        if let Some(step) = usize::from(step).checked_sub(1).filter(|_| class != 2) {
            self.heights_by_step[step][bin] += 1;
            self.map_by_step[step][place] += 1;
        }
        match class {
            _ if dropped => self.dropped += 1,
            7 => self.noise += 1,
            2 => self.ground += 1,
            _ => self.unclassified += 1,
        }
    }
}
