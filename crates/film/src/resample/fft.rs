//! The cosine transform of any length, for the profiles of [`super::banding`].

use std::f64::consts::PI;

/// A complex number: (real, imaginary).
type Complex = (f64, f64);

fn times(a: Complex, b: Complex) -> Complex {
    (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
}

fn turn(angle: f64) -> Complex {
    let (s, c) = angle.sin_cos();
    (c, s)
}

/// In place, for a length that is a power of two; `sign` −1 forward, 1 back (without the divisor).
///
/// J. W. Cooley, J. W. Tukey, An algorithm for the machine calculation of complex Fourier series, 1965.
fn power_of_two(a: &mut [Complex], sign: f64) {
    let n = a.len();
    let mut j = 0;
    for i in 1..n {
        let mut bit = n >> 1;
        while j & bit != 0 {
            j ^= bit;
            bit >>= 1;
        }
        j ^= bit;
        if i < j {
            a.swap(i, j);
        }
    }
    let mut half = 1;
    while half < n {
        let factors: Vec<Complex> = (0..half).map(|k| turn(sign * PI * k as f64 / half as f64)).collect();
        for block in a.chunks_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for ((l, h), f) in low.iter_mut().zip(high).zip(&factors) {
                let t = times(*h, *f);
                (*h, *l) = ((l.0 - t.0, l.1 - t.1), (l.0 + t.0, l.1 + t.1));
            }
        }
        half *= 2;
    }
}

/// Forward transform of any length: L. I. Bluestein, A linear filtering approach to the computation of discrete Fourier
/// transform, 1970.
fn forward(a: &[Complex]) -> Vec<Complex> {
    let n = a.len();
    // k² modulo 2n, so that the angle keeps its digits.
    let chirp = |k: usize| turn(-PI * ((k as u128 * k as u128) % (2 * n as u128)) as f64 / n as f64);
    let size = (2 * n).next_power_of_two();
    let (mut x, mut y) = (vec![(0.0, 0.0); size], vec![(0.0, 0.0); size]);
    for (k, v) in a.iter().enumerate() {
        let c = chirp(k);
        x[k] = times(*v, c);
        y[k] = (c.0, -c.1);
        if k > 0 {
            y[size - k] = y[k];
        }
    }
    power_of_two(&mut x, -1.0);
    power_of_two(&mut y, -1.0);
    for (x, y) in x.iter_mut().zip(&y) {
        *x = times(*x, *y);
    }
    power_of_two(&mut x, 1.0);
    (0..n).map(|k| times((x[k].0 / size as f64, x[k].1 / size as f64), chirp(k))).collect()
}

/// D(u) = Σ f(x) · cos(π u (x + ½) / n): the Fourier transform of the profile continued as in a mirror, so that its ends make
/// no step.
pub fn cosine(f: &[f64]) -> Vec<f64> {
    let n = f.len();
    let mirrored: Vec<Complex> = f.iter().chain(f.iter().rev()).map(|v| (*v, 0.0)).collect();
    let all = forward(&mirrored);
    (0..n).map(|u| 0.5 * times(all[u], turn(-PI * u as f64 / (2 * n) as f64)).0).collect()
}

/// The profile whose [`cosine`] transform is `d`.
pub fn cosine_back(d: &[f64]) -> Vec<f64> {
    let n = d.len();
    // f(x) = (D(0) + 2 Σ D(u) cos(π u (x + ½) / n)) / n: the real part of a forward transform of length 2n, since the cosine is even.
    let mut all = vec![(0.0, 0.0); 2 * n];
    for (u, v) in d.iter().enumerate() {
        let weight = if u == 0 { 1.0 } else { 2.0 } / n as f64;
        let t = turn(-PI * u as f64 / (2 * n) as f64);
        all[u] = (weight * v * t.0, weight * v * t.1);
    }
    forward(&all)[..n].iter().map(|v| v.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_is_the_sum_and_turns_back() {
        for n in [1usize, 2, 7, 64, 131] {
            let f: Vec<f64> = (0..n).map(|i| ((i * i * 37 + 11) % 101) as f64 - 50.0).collect();
            let d = cosine(&f);
            for (u, v) in d.iter().enumerate() {
                let sum: f64 =
                    f.iter().enumerate().map(|(x, f)| f * (PI * u as f64 * (x as f64 + 0.5) / n as f64).cos()).sum();
                assert!((v - sum).abs() < 1e-8, "{n} {u}: {v} {sum}");
            }
            let back = cosine_back(&d);
            assert!(back.iter().zip(&f).all(|(a, b)| (a - b).abs() < 1e-9), "{n}");
        }
    }
}
