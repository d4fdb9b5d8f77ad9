//! Keys' cubic convolution with a = −1/2, after R. Keys, "Cubic convolution interpolation for digital image
//! processing", IEEE Trans. ASSP 29, 1981.

/// The weight of a value that lies `distance` values away.
pub fn weight(distance: f64) -> f64 {
    let t = distance.abs();
    match t {
        t if t < 1.0 => 1.5 * t * t * t - 2.5 * t * t + 1.0,
        t if t < 2.0 => -0.5 * t * t * t + 2.5 * t * t - 4.0 * t + 2.0,
        _ => 0.0,
    }
}

/// The weights of the four values about a place that lies by `t` of their distance beyond the second.
pub fn weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2]
}

/// The value at `at`, in values from the centre of the first; the outermost values go on beyond the picture.
pub fn cubic(size: [usize; 2], at: [f64; 2], value: impl Fn(usize, usize) -> f32) -> f32 {
    let weights = at.map(|v| weights((v - v.floor()) as f32));
    let place =
        |axis: usize, k: usize| (at[axis].floor() as i64 + k as i64 - 1).clamp(0, size[axis] as i64 - 1) as usize;
    let columns = [0, 1, 2, 3].map(|k| place(0, k));
    let row = |j: usize| (0..4).map(|k| weights[0][k] * value(columns[k], j)).sum::<f32>();
    (0..4).map(|k| weights[1][k] * row(place(1, k))).sum()
}
