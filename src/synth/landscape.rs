//! A landscape drawn from nothing.

use super::rng::value_noise;
use crate::window::Window;

#[derive(Debug)]
pub(crate) struct Landscape {
    seed: u64,
    gsd_m: f64,
}

impl Landscape {
    pub(crate) fn new(seed: u64, gsd_m: f64) -> Self {
        Landscape { seed, gsd_m }
    }

    pub(crate) fn render(&self, window: Window, out: &mut [u8]) {
        for (i, p) in out.chunks_exact_mut(3).enumerate() {
            let x = (window.x + i as u64 % window.width) as f32 * self.gsd_m as f32;
            let y = (window.y + i as u64 / window.width) as f32 * self.gsd_m as f32;
            let v = value_noise(self.seed, x, y) * 60.0;
            p.copy_from_slice(&[(60.0 + v) as u8, (90.0 + v) as u8, (40.0 + v) as u8]);
        }
    }
}
