//! Nearest neighbours on entropy and intensity.
//!
//! Exact, and fast on images: the plane of entropy and intensity is cut into cells, and each cell holds the samples
//! that can be among the nearest of any point in it. Where they all belong to one class the cell is decided; elsewhere
//! the few are compared. Distances are Euclidean in `f64`; equal distances go to the sample that was given first.

/// One taught point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Entropy, bit.
    pub entropy: f64,
    /// Grey level / 255.
    pub intensity: f64,
    pub keep: bool,
}

/// Cells a bit of entropy; the intensity has a column for every grey level.
const CELLS_PER_BIT: usize = 32;
const BITS: usize = 8;
const LEVELS: usize = 256;

enum Cell {
    Decided(bool),
    /// Where its samples lie in the list.
    Mixed(u32, u32),
}

/// A classifier by the majority of the `k` nearest samples.
pub struct Neighbours {
    samples: Vec<Sample>,
    k: usize,
    cells: Vec<Cell>,
    near: Vec<u32>,
}

/// Why no classifier could be built.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum KnnError {
    #[error("{have} samples were given, but {k} neighbours are asked for")]
    TooFew { have: usize, k: usize },
    #[error("the number of neighbours must be odd, so that every vote has a majority; {0} was given")]
    Even(usize),
}

impl Neighbours {
    /// # Errors
    /// When there are fewer samples than neighbours, or `k` is even.
    pub fn new(samples: Vec<Sample>, k: usize) -> Result<Self, KnnError> {
        if k.is_multiple_of(2) {
            return Err(KnnError::Even(k));
        }
        if samples.len() < k {
            return Err(KnnError::TooFew { have: samples.len(), k });
        }
        let mut this = Neighbours { samples, k, cells: Vec::new(), near: Vec::new() };
        let rows: Vec<Vec<u32>> = (0..BITS * CELLS_PER_BIT * LEVELS).map(|cell| this.can_be_near(cell)).collect();
        for near in rows {
            let keeps = near.iter().filter(|&&i| this.samples[i as usize].keep).count();
            this.cells.push(if keeps == 0 || keeps == near.len() {
                Cell::Decided(keeps > 0)
            } else {
                let first = this.near.len() as u32;
                this.near.extend(near);
                Cell::Mixed(first, this.near.len() as u32)
            });
        }
        Ok(this)
    }

    /// Samples that may be among the nearest of a point in the cell.
    fn can_be_near(&self, cell: usize) -> Vec<u32> {
        let level = (cell % LEVELS) as f64 / 255.0;
        let low = (cell / LEVELS) as f64 / CELLS_PER_BIT as f64;
        // A little wider than the cell, so that rounding cannot leave a sample out.
        let (low, high) = (low - 1e-6, low + 1.0 / CELLS_PER_BIT as f64 + 1e-6);
        let bounds = |s: &Sample| {
            let across = (s.intensity - level).powi(2);
            let nearest = (low - s.entropy).max(s.entropy - high).max(0.0);
            let farthest = (s.entropy - low).abs().max((high - s.entropy).abs());
            (across + nearest * nearest, across + farthest * farthest)
        };
        let mut farthest: Vec<f64> = self.samples.iter().map(|s| bounds(s).1).collect();
        let (_, limit, _) = farthest.select_nth_unstable_by(self.k - 1, f64::total_cmp);
        let limit = *limit * (1.0 + 1e-9) + 1e-12;
        (0..self.samples.len() as u32).filter(|&i| bounds(&self.samples[i as usize]).0 <= limit).collect()
    }

    /// Keep or not, of a pixel with this entropy (bit) and grey level.
    pub fn keep(&self, entropy: f32, level: u8) -> bool {
        let bin = ((entropy.max(0.0) * CELLS_PER_BIT as f32) as usize).min(BITS * CELLS_PER_BIT - 1);
        match self.cells[bin * LEVELS + usize::from(level)] {
            Cell::Decided(keep) => keep,
            Cell::Mixed(first, end) => {
                let (entropy, level) = (f64::from(entropy), f64::from(level) / 255.0);
                self.vote(self.near[first as usize..end as usize].iter().copied(), entropy, level)
            }
        }
    }

    fn vote(&self, among: impl Iterator<Item = u32>, entropy: f64, level: f64) -> bool {
        // The k nearest so far, nearest first; k is small.
        let mut nearest: Vec<(f64, u32)> = Vec::with_capacity(self.k + 1);
        for i in among {
            let sample = &self.samples[i as usize];
            let distance = (sample.entropy - entropy).powi(2) + (sample.intensity - level).powi(2);
            if nearest.len() < self.k || distance < nearest[self.k - 1].0 {
                let at = nearest.partition_point(|&(d, _)| d <= distance);
                nearest.insert(at, (distance, i));
                nearest.truncate(self.k);
            }
        }
        2 * nearest.iter().filter(|(_, i)| self.samples[*i as usize].keep).count() > self.k
    }

    /// Distance to the nearest sample.
    pub fn distance(&self, entropy: f32, level: u8) -> f64 {
        let (entropy, level) = (f64::from(entropy), f64::from(level) / 255.0);
        let far = |sample: &Sample| (sample.entropy - entropy).powi(2) + (sample.intensity - level).powi(2);
        self.samples.iter().map(far).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// The samples that vote.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_give_what_all_samples_give() {
        let mut draws = autoref_raster::random::Mmix(2017);
        let mut random = || (draws.next_u64() >> 33) as f64 / (1u64 << 31) as f64;
        let samples: Vec<Sample> = (0..200)
            .map(|_| {
                let entropy = 2.0 + 5.0 * random();
                Sample { entropy, intensity: random(), keep: entropy + random() > 4.5 }
            })
            .collect();
        for k in [1, 3, 7] {
            let neighbours = Neighbours::new(samples.clone(), k).expect("enough samples");
            let mut kept = 0;
            for _ in 0..4000 {
                let (entropy, level) = ((8.0 * random()) as f32, (256.0 * random()) as u8);
                let all = neighbours.vote(0..200, f64::from(entropy), f64::from(level) / 255.0);
                assert_eq!(neighbours.keep(entropy, level), all);
                kept += usize::from(all);
            }
            assert!((500..3500).contains(&kept));
        }
    }

    #[test]
    fn too_few_samples_are_refused() {
        let sample = Sample { entropy: 5.0, intensity: 0.5, keep: true };
        assert_eq!(Neighbours::new(vec![sample; 2], 3).err(), Some(KnnError::TooFew { have: 2, k: 3 }));
        assert_eq!(Neighbours::new(vec![sample; 2], 2).err(), Some(KnnError::Even(2)));
    }
}
