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
