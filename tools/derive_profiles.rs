//! Prints the colour clouds of the shipped profiles, derived from the mixing model in `profile::mixing`.
//!
//! `cargo run --release -p autoref-tools --bin derive_profiles`

use autoref_stream::profile::colour::{Cloud, Metric, lab_from_srgb};
use autoref_stream::profile::mixing::{Mixing, cloud, population};

/// Paints as sRGB in full sun: marking sprays and plates from fluorescent to plain.
const PAINTS: [(&str, &[[u8; 3]]); 6] = [
    ("orange", &[[255, 103, 0], [255, 121, 0], [255, 90, 31], [255, 127, 39], [245, 110, 20], [255, 80, 10]]),
    ("pink", &[[255, 20, 147], [255, 60, 160], [240, 30, 120], [255, 105, 180]]),
    ("green", &[[0, 230, 60], [60, 255, 40], [20, 200, 80], [100, 240, 30]]),
    ("yellow", &[[255, 230, 0], [255, 245, 40], [250, 215, 20], [240, 240, 0]]),
    ("blue", &[[0, 80, 255], [20, 100, 230], [0, 60, 200], [30, 120, 255]]),
    ("white-on-dark", &[[255, 255, 255], [245, 245, 240], [235, 238, 240]]),
];

fn main() {
    // Fresh paint, and worn paint: one cloud over both would be so wide that it takes in bare soil.
    let wear = [("fresh", (0.0, 0.15), 0.15), ("worn", (0.1, 0.4), 0.15)];
    for ((name, paints), (state, fading, max_blur_share)) in PAINTS.iter().flat_map(|p| wear.map(|w| (*p, w))) {
        let colours = population(paints, Mixing { fading, max_blur_share, ..Mixing::default() }, 20_000);
        let spec = cloud(&colours);
        let c = Cloud::new(spec.mean, spec.covariance, Metric::Mahalanobis).expect("the population spans three axes");
        let mut d: Vec<f64> = colours.iter().map(|v| c.distance2(&lab_from_srgb(*v)).sqrt()).collect();
        d.sort_by(f64::total_cmp);
        let q = |p: f64| d[(p * (d.len() - 1) as f64) as usize];
        println!(
            "# {name}, {state}: distances p50 {:.2} p95 {:.2} p99 {:.2} p99.9 {:.2}",
            q(0.5),
            q(0.95),
            q(0.99),
            q(0.999)
        );
        println!("[[colour.clouds]]");
        println!("mean = [{:.2}, {:.2}, {:.2}]", spec.mean[0], spec.mean[1], spec.mean[2]);
        let row = |r: [f64; 3]| format!("[{:.2}, {:.2}, {:.2}]", r[0], r[1], r[2]);
        let rows: Vec<String> = spec.covariance.iter().map(|r| row(*r)).collect();
        println!("covariance = [{}]", rows.join(", "));
        for rgb in [[255u8, 103, 0], [190, 100, 60], [170, 110, 80], [180, 130, 90], [140, 140, 140], [204, 117, 63]] {
            let lab = lab_from_srgb(rgb.map(|v| f64::from(v) / 255.0));
            println!("#   {rgb:?} Lab {:.0} {:.0} {:.0}: {:.2}", lab[0], lab[1], lab[2], c.distance2(&lab).sqrt());
        }
    }
}
