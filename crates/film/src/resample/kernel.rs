//! Interpolation between pixels, with the kernels and the widening that GDAL's warper uses, so that both can be
//! compared.

use crate::window::Grey;
use autoref_raster::keys;

/// How values between pixels are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    Bilinear,
    /// Keys' cubic convolution ([`keys`]).
    Cubic,
    /// sinc(t) · sinc(t/3) (C. E. Duchon, Lanczos filtering in one and two dimensions, 1979).
    Lanczos,
}

impl Kernel {
    /// As the command line has it.
    pub fn name(self) -> &'static str {
        match self {
            Kernel::Bilinear => "bilinear",
            Kernel::Cubic => "cubic",
            Kernel::Lanczos => "lanczos",
        }
    }

    /// Values on each side that take part.
    pub fn radius(self) -> f64 {
        match self {
            Kernel::Bilinear => 1.0,
            Kernel::Cubic => 2.0,
            Kernel::Lanczos => 3.0,
        }
    }

    /// Weight at a distance of `t` values.
    pub fn weight(self, t: f64) -> f64 {
        let t = t.abs();
        if t >= self.radius() {
            return 0.0;
        }
        match self {
            Kernel::Bilinear => 1.0 - t,
            Kernel::Cubic => keys::weight(t),
            Kernel::Lanczos if t < 1e-9 => 1.0,
            Kernel::Lanczos => {
                let a = std::f64::consts::PI * t;
                3.0 * a.sin() * (a / 3.0).sin() / (a * a)
            }
        }
    }
}

/// Steps of the table per value.
const STEPS: usize = 2048;

/// A kernel as a table, widened `stretch` times where the output's pixels are larger than the values.
pub struct Sampler {
    table: Vec<f32>,
    stretch: f64,
    reach: f64,
}

impl Sampler {
    /// Below 1/0.95 the kernel is not widened, as in GDAL: it would only blur.
    pub fn new(kernel: Kernel, ratio: f64) -> Sampler {
        let stretch = if ratio > 1.0 / 0.95 { ratio } else { 1.0 };
        let last = (kernel.radius() * STEPS as f64) as usize;
        let table = (0..=last + 1).map(|i| kernel.weight(i as f64 / STEPS as f64) as f32).collect();
        Sampler { table, stretch, reach: kernel.radius() * stretch }
    }

    /// Values on each side of a place that take part.
    pub fn reach(&self) -> f64 {
        self.reach
    }

    fn weight(&self, t: f64) -> f32 {
        let at = t.abs() / self.stretch * STEPS as f64;
        let i = at as usize;
        if i + 1 >= self.table.len() {
            return 0.0;
        }
        let f = (at - i as f64) as f32;
        self.table[i] + f * (self.table[i + 1] - self.table[i])
    }

    /// Weights of the values from the first to the last that exists, of `n`.
    fn axis(&self, x: f64, n: usize, out: &mut Vec<f32>) -> usize {
        out.clear();
        let centre = x - 0.5;
        let first = ((centre - self.reach).floor() as i64 + 1).max(0);
        let last = ((centre + self.reach).ceil() as i64 - 1).min(n as i64 - 1);
        out.extend((first..=last).map(|i| self.weight(i as f64 - centre)));
        first.max(0) as usize
    }

    /// The value at a place in units of values (0 the outer corner of the first); weights add up to one, also at the
    /// rim and beside values that hold nothing (`holds`; `None`: all do), which take no part. `None` outside and in
    /// such a value. `scratch` spares allocations.
    pub fn at(
        &self,
        (grey, holds): (&Grey, Option<&[bool]>),
        [x, y]: [f64; 2],
        scratch: &mut [Vec<f32>; 2],
    ) -> Option<f32> {
        if !(x >= 0.0 && y >= 0.0 && x < grey.width as f64 && y < grey.height as f64) {
            return None;
        }
        let own = y as usize * grey.width + x as usize;
        if holds.is_some_and(|holds| !holds[own]) {
            return None;
        }
        let [wx, wy] = scratch;
        let (x0, y0) = (self.axis(x, grey.width, wx), self.axis(y, grey.height, wy));
        let (mut sum, mut total) = (0.0f32, 0.0f32);
        let (mut held, mut lost) = (0.0f32, 0.0f32);
        for (j, v) in wy.iter().enumerate() {
            let first = (y0 + j) * grey.width + x0;
            let row = &grey.data[first..][..wx.len()];
            sum += v * row.iter().zip(wx.iter()).map(|(g, w)| g * w).sum::<f32>();
            total += v;
            let Some(holds) = holds else { continue };
            for ((g, w), _) in row.iter().zip(wx.iter()).zip(&holds[first..]).filter(|(_, holds)| !**holds) {
                held += v * w * g;
                lost += v * w;
            }
        }
        let total = total * wx.iter().sum::<f32>();
        if lost != 0.0 && total - lost < LEAST_WEIGHT * total {
            // In a corner of what holds something the rest of the kernel would be blown up.
            return Some(grey.data[own]);
        }
        (total.abs() > 1e-6).then(|| (sum - held) / (total - lost))
    }
}

/// Less of a kernel's weight gives no value.
const LEAST_WEIGHT: f32 = 0.3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kernel_gives_pixels_back_and_keeps_a_constant() {
        let grey = Grey {
            width: 9,
            height: 8,
            data: (0..72).map(|i| (i * 7 % 11) as f32).collect(),
            origin: [0, 0],
            factor: 1,
        };
        let flat = Grey { data: vec![0.25; 72], ..grey.clone() };
        let mut scratch = Default::default();
        for kernel in [Kernel::Bilinear, Kernel::Cubic, Kernel::Lanczos] {
            for ratio in [0.7, 1.0, 2.6] {
                let sampler = Sampler::new(kernel, ratio);
                for (x, y) in [(0.1, 0.2), (4.5, 3.5), (8.9, 7.9), (3.3, 6.1)] {
                    let v = sampler.at((&flat, None), [x, y], &mut scratch).expect("inside");
                    assert!((v - 0.25).abs() < 1e-6, "{kernel:?} {ratio}: {v}");
                }
                if ratio <= 1.0 {
                    let v = sampler.at((&grey, None), [4.5, 3.5], &mut scratch).expect("inside");
                    assert!((v - grey.at(4, 3)).abs() < 1e-5, "{kernel:?}: {v}");
                }
                assert_eq!(sampler.at((&flat, None), [9.0, 1.0], &mut scratch), None);
            }
        }
    }

    #[test]
    fn values_that_hold_nothing_take_no_part() {
        let holds: Vec<bool> = (0..72).map(|i| i % 9 + i / 9 > 6).collect();
        let data = holds.iter().map(|h| if *h { 0.25 } else { 1.0 }).collect();
        let grey = Grey { width: 9, height: 8, data, origin: [0, 0], factor: 1 };
        let mut scratch = Default::default();
        for kernel in [Kernel::Bilinear, Kernel::Cubic, Kernel::Lanczos] {
            for ratio in [0.7, 1.0, 2.6] {
                let sampler = Sampler::new(kernel, ratio);
                for i in 0..4 * 72 {
                    let (x, y) = ((i % 18) as f64 / 2.0 + 0.2, (i / 18) as f64 / 2.0 + 0.3);
                    let value = sampler.at((&grey, Some(&holds)), [x, y], &mut scratch);
                    let own = holds[y as usize * 9 + x as usize];
                    assert_eq!(value.is_some(), own, "{kernel:?} {ratio}: {x}, {y}");
                    assert!(value.is_none_or(|v| (v - 0.25).abs() < 1e-5), "{kernel:?} {ratio}: {value:?} at {x}, {y}");
                }
            }
        }
    }
}
