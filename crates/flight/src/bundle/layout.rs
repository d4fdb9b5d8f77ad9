//! Where each unknown stands in the reduced system.

use super::problem::Problem;
use super::skyline::order;
use crate::camera::Parameter;

/// Interior parameters of one camera that can be adjusted at once.
pub(super) const MOST_INTERIOR: usize = 13;

/// Where each unknown stands in the reduced system.
#[derive(Clone)]
pub(super) struct Layout {
    pub frame_at: Vec<usize>,
    pub interior_at: Vec<usize>,
    pub active: Vec<Vec<Parameter>>,
    /// What all positions are off together, where that is adjusted.
    pub offset_at: Option<usize>,
    pub size: usize,
    /// First column of each row that is not zero.
    pub first: Vec<usize>,
    /// Observations of each point.
    pub of_point: Vec<Vec<u32>>,
}

impl Layout {
    /// Frames first, then what is adjusted of the cameras, then the offset of the positions.
    pub fn new(problem: &Problem) -> Self {
        let n = problem.frames.len();
        let mut of_point = vec![Vec::new(); problem.points.len()];
        for (i, o) in problem.observations.iter().enumerate() {
            of_point[o.point].push(i as u32);
        }
        let mut linked: Vec<std::collections::BTreeSet<usize>> = vec![Default::default(); n];
        for list in &of_point {
            for a in list {
                for b in list {
                    let (fa, fb) = (problem.observations[*a as usize].frame, problem.observations[*b as usize].frame);
                    if fa != fb {
                        linked[fa].insert(fb);
                    }
                }
            }
        }
        let neighbours: Vec<Vec<usize>> = linked.into_iter().map(|s| s.into_iter().collect()).collect();
        let order = order(&neighbours);
        let mut frame_at = vec![0; n];
        for (place, frame) in order.iter().enumerate() {
            frame_at[*frame] = place * 6;
        }
        let active: Vec<Vec<Parameter>> = problem.cameras.iter().map(|c| c.active()).collect();
        let mut interior_at = Vec::new();
        let mut size = n * 6;
        for list in &active {
            interior_at.push(size);
            size += list.len();
        }
        let offset_at = problem.offset.map(|_| size);
        size += if offset_at.is_some() { 3 } else { 0 };
        let mut first = vec![0; size];
        for frame in 0..n {
            let low = neighbours[frame].iter().map(|k| frame_at[*k]).min().unwrap_or(usize::MAX).min(frame_at[frame]);
            for row in frame_at[frame]..frame_at[frame] + 6 {
                first[row] = low;
            }
        }
        Layout { frame_at, interior_at, active, offset_at, size, first, of_point }
    }
}
