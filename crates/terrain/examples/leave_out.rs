//! What the shipped examples say of photographs that did not teach: `leave_out`.
//!
//! One photograph at a time, all its frames and their variants, is left out of `src/shipped.bin`; a forest of the rest
//! judges its rows. Then the distance within which nine tenths of the rows have a neighbour when an eleventh of their
//! list is left out: `FAR` of `src/unlike.rs`.

use std::collections::BTreeMap;

use autoref_terrain::features::FEATURES;
use autoref_terrain::forest::{Example, Forest, Growth};
use autoref_terrain::model::shipped_by_frame;
use rayon::prelude::*;

type Row = (u8, Example<FEATURES>);

/// The part of `right` in `all`; nothing where there is nothing.
fn recall(right: usize, all: usize) -> Option<f64> {
    (all > 0).then(|| right as f64 / all as f64)
}

fn shown(recall: Option<f64>) -> String {
    recall.map_or("  –  ".into(), |v| format!("{v:.3}"))
}

fn distance(a: &Example<FEATURES>, b: &Example<FEATURES>) -> u32 {
    a.features.iter().zip(&b.features).map(|(a, b)| u32::from(a.abs_diff(*b))).sum()
}

/// Distances of the rows to the nearest of the others, when an eleventh of the list is left out at a time.
fn nearest(rows: &[Row]) -> Vec<u32> {
    let part = rows.len().div_ceil(11);
    let one = |(i, (_, row)): (usize, &Row)| {
        let first = i / part * part;
        let others = rows[..first].iter().chain(&rows[(first + part).min(rows.len())..]);
        others.map(|(_, other)| distance(row, other)).min().unwrap_or(u32::MAX)
    };
    rows.par_iter().enumerate().map(one).collect()
}

fn main() {
    let rows = shipped_by_frame();
    let table = include_str!("../teaching/frames.csv");
    let mut photographs: BTreeMap<&str, Vec<u8>> = BTreeMap::new();
    for line in table.lines().skip(1) {
        let mut columns = line.split(',');
        let number = columns.next().and_then(|n| n.parse().ok()).expect("a number");
        photographs.entry(columns.next().expect("a photograph")).or_default().push(number);
    }
    println!("{:18} {:>6} {:>6}   keep  mask", "left out", "keep", "mask");
    let mut means: [Vec<f64>; 2] = Default::default();
    for (name, frames) in &photographs {
        let (own, rest): (Vec<Row>, Vec<Row>) = rows.iter().partition(|(frame, _)| frames.contains(frame));
        let rest: Vec<Example<FEATURES>> = rest.into_iter().map(|(_, example)| example).collect();
        let forest = Forest::grow(&rest, Growth::default()).expect("two classes");
        let mut counts = [[0usize; 2]; 2];
        for (_, example) in own {
            let right = (forest.keep(&example.features) > 127) == example.keep;
            let count = &mut counts[usize::from(!example.keep)];
            *count = [count[0] + usize::from(right), count[1] + 1];
        }
        let recalls = counts.map(|[right, all]| recall(right, all));
        recalls.iter().zip(&mut means).for_each(|(recall, means)| means.extend(recall));
        println!("{name:18} {:6} {:6}   {} {}", counts[0][1], counts[1][1], shown(recalls[0]), shown(recalls[1]));
    }
    let [keep, mask] = means.map(|means| means.iter().sum::<f64>() / means.len() as f64);
    println!("mean keep recall {keep:.3}, mean mask recall {mask:.3}");
    let mut distances = nearest(&rows);
    distances.sort_unstable();
    println!("nine tenths lie nearer than {}", distances[distances.len() * 9 / 10]);
}
