//! Any tiling and any order of points give the answer of all points in memory.

mod common;

use std::collections::BTreeMap;

use autoref_cloud::clean::{Plan, Step};
use autoref_cloud::isolated;
use autoref_cloud::smrf;
use common::{Random, landscape, plan, run, write_ply};

fn chain() -> Vec<Step> {
    vec![
        Step::Outliers { neighbours: 8, multiplier: 2.0 },
        Step::Radius { radius_m: 4.0, least: 3 },
        Step::Low { cell_m: 10.0, gap_m: 1.0 },
        Step::Isolated(isolated::Options::default()),
        Step::Ground(smrf::Options::default()),
    ]
}

/// Classes by coordinates: points of one place must have got the same ones.
fn by_place(xyz: &[[f64; 3]], classes: &[u8]) -> BTreeMap<[u64; 3], Vec<u8>> {
    let mut all: BTreeMap<[u64; 3], Vec<u8>> = BTreeMap::new();
    for (xyz, &class) in xyz.iter().zip(classes) {
        all.entry(xyz.map(f64::to_bits)).or_default().push(class);
    }
    all.values_mut().for_each(|classes| classes.sort_unstable());
    all
}

#[test]
fn tiles_and_order_change_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cloud.ply");
    let mut points = landscape(6000, 3);
    write_ply(&path, &points);
    let with = |tile_points: usize| Plan { tile_points: Some(tile_points), ..plan(chain()) };
    let (whole, xyz, classes) = run(&path, &with(1 << 20), "ply");
    assert_eq!(whole.tiles, 1);
    assert!(whole.steps.iter().all(|step| step.classified > 0), "{:?}", whole.steps);
    for tile_points in [7, 100, 999, 3000] {
        let (tiled, tiled_xyz, tiled_classes) = run(&path, &with(tile_points), "ply");
        assert!(tiled.tiles > 1);
        assert!(xyz == tiled_xyz && classes == tiled_classes, "{tile_points}");
        for (a, b) in whole.steps.iter().zip(&tiled.steps) {
            assert_eq!((a.points_in, a.classified, a.statistics), (b.points_in, b.classified, b.statistics));
        }
    }
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let (_, _, alone) = threads.install(|| run(&path, &with(999), "ply"));
    assert!(classes == alone);

    let mut random = Random(5);
    for at in (1..points.len()).rev() {
        points.swap(at, (random.next_u64() % (at as u64 + 1)) as usize);
    }
    write_ply(&path, &points);
    let (_, shuffled_xyz, shuffled) = run(&path, &with(500), "ply");
    assert!(by_place(&xyz, &classes) == by_place(&shuffled_xyz, &shuffled));
}

#[test]
fn outliers_are_those_of_brute_force() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cloud.ply");
    for (seed, count, k, m) in [(1, 700, 8, 2.0), (2, 400, 1, 1.0), (3, 9, 12, 0.5), (4, 900, 20, 0.0)] {
        let points = landscape(count, seed);
        write_ply(&path, &points);
        let mean = |at: usize| {
            let others = points.iter().enumerate().filter(|(other, _)| *other != at);
            let mut distances: Vec<f64> =
                others.map(|(_, b)| (0..3).map(|i| (points[at][i] - b[i]).powi(2)).sum::<f64>().sqrt()).collect();
            distances.sort_by(f64::total_cmp);
            distances.truncate(k);
            distances.iter().sum::<f64>() / distances.len() as f64
        };
        let means: Vec<f64> = (0..count).map(mean).collect();
        let mu = means.iter().sum::<f64>() / count as f64;
        let sigma = (means.iter().map(|v| (v - mu).powi(2)).sum::<f64>() / (count - 1) as f64).sqrt();
        let expected: Vec<u8> = means.iter().map(|&v| if v >= mu + m * sigma { 7 } else { 1 }).collect();
        for tile_points in [50, 100_000] {
            let step = Step::Outliers { neighbours: k, multiplier: m };
            let (_, _, classes) = run(&path, &Plan { tile_points: Some(tile_points), ..plan(vec![step]) }, "ply");
            assert!(classes == expected, "seed {seed}, tiles of {tile_points}");
        }
        let (radius_m, least) = (3.0, 4);
        let near = |at: usize| {
            let others = points.iter().enumerate().filter(|(other, _)| *other != at);
            others
                .filter(|(_, b)| (0..3).map(|i| (points[at][i] - b[i]).powi(2)).sum::<f64>() < radius_m * radius_m)
                .count()
        };
        let expected: Vec<u8> = (0..count).map(|at| if near(at) < least { 7 } else { 1 }).collect();
        let step = Step::Radius { radius_m, least };
        let (_, _, classes) = run(&path, &Plan { tile_points: Some(60), ..plan(vec![step]) }, "ply");
        assert!(classes == expected, "radius, seed {seed}");
    }
}

/// How low the origin lies below the envelope of places around it, and how much alone with so many others: by Cramer's
/// rule, all in memory.
fn lowness_of_brute_force(around: &[[f64; 3]], company: usize) -> Option<f64> {
    let determinant = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let mut weights = vec![1.0; around.len()];
    let mut plane = [0.0; 3];
    let off = |plane: [f64; 3], p: &[f64; 3]| p[2] - plane[0] - plane[1] * p[0] - plane[2] * p[1];
    for _ in 0..8 {
        let (mut m, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
        for (p, w) in around.iter().zip(&weights) {
            let row = [1.0, p[0], p[1]];
            for i in 0..3 {
                right[i] += w * row[i] * p[2];
                (0..3).for_each(|j| m[i][j] += w * row[i] * row[j]);
            }
        }
        let whole = determinant(m);
        for (k, value) in plane.iter_mut().enumerate() {
            let mut replaced = m;
            (0..3).for_each(|i| replaced[i][k] = right[i]);
            *value = determinant(replaced) / whole;
        }
        let next = around.iter().map(|p| if off(plane, p) > 0.0 { 0.02 } else { 1.0 }).collect();
        if next == weights {
            break;
        }
        weights = next;
    }
    let sum: f64 = weights.iter().sum();
    let squares: f64 = around.iter().zip(&weights).map(|(p, w)| w * off(plane, p).powi(2)).sum();
    let mut heights: Vec<f64> = around.iter().map(|p| off([0.0, plane[1], plane[2]], p)).collect();
    heights.sort_by(f64::total_cmp);
    let gap = heights[company - 1];
    let farthest = around.iter().map(|p| p[0].hypot(p[1])).fold(0.0, f64::max);
    let spacing = farthest * (std::f64::consts::PI / around.len() as f64).sqrt();
    (plane[0] > 0.0 && gap > 0.0).then(|| (plane[0] / (squares / sum).sqrt() * gap / spacing).sqrt())
}

#[test]
fn isolated_points_are_those_of_brute_force() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cloud.ply");
    for (seed, count, radius_m, lowness, least) in
        [(11, 900, 9.0, 0.35, 5), (12, 700, 25.0, 0.8, 3), (13, 500, 4.0, 0.2, 9), (14, 600, 8.0, 0.3, 1)]
    {
        let points = landscape(count, seed);
        write_ply(&path, &points);
        let others = |at: usize| points.iter().enumerate().filter(move |(other, _)| *other != at).map(|(_, p)| p);
        let apart = |at: usize, b: &[f64; 3]| -> [f64; 3] { std::array::from_fn(|i| b[i] - points[at][i]) };
        let is_low = |at: usize| {
            let mut around: Vec<[f64; 3]> =
                others(at).map(|b| apart(at, b)).filter(|d| d[0] * d[0] + d[1] * d[1] <= radius_m * radius_m).collect();
            around.sort_by(|a, b| (a[0] * a[0] + a[1] * a[1]).total_cmp(&(b[0] * b[0] + b[1] * b[1])));
            around.truncate(128);
            let company = (least - 1).clamp(1, 6);
            around.len() >= 6 && lowness_of_brute_force(&around, company).is_some_and(|found| found >= lowness)
        };
        let neighbour = |at: usize| {
            let mut distances: Vec<f64> = others(at).map(|b| apart(at, b).iter().map(|d| d * d).sum()).collect();
            distances.sort_by(f64::total_cmp);
            distances[least - 1]
        };
        let distances: Vec<f64> = (0..count).map(neighbour).collect();
        let mut sorted = distances.clone();
        sorted.sort_by(f64::total_cmp);
        let limit = 16.0 * sorted[count / 2];
        let expected: Vec<u8> = (0..count).map(|at| if is_low(at) || distances[at] >= limit { 7 } else { 1 }).collect();
        let noise = expected.iter().filter(|class| **class == 7).count();
        assert!((3..count / 2).contains(&noise), "seed {seed}: {noise}");
        for tile_points in [40, 333, 100_000] {
            let step = Step::Isolated(isolated::Options { radius_m: Some(radius_m), lowness, least });
            let (_, _, classes) = run(&path, &Plan { tile_points: Some(tile_points), ..plan(vec![step]) }, "ply");
            assert!(classes == expected, "seed {seed}, tiles of {tile_points}");
        }
    }
}
