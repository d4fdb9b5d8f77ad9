use autoref_cosine::{cosine, cosine_back};
use std::f64::consts::PI;

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
