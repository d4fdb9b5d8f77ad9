//! How often the matcher is right, against the number of visible GCPs, of false candidates, and the error of the marks;
//! and how often the formula of the number of false alarms says it can be.
//!
//! The prediction is the formula laid on the true pattern, which nobody knows in practice: a case counts as possible
//! when the true marks, at their measured places, are rarer than 1e-4. Where measured and predicted agree, the search
//! finds what can be believed and the limit is that of the evidence. Excluded: the time of making the cases.
//!
//! `cargo run --release -p autoref-tools --bin success_curve -- FOLDER [TRIALS [FROM]]` writes `matching-success.csv`
//! and `.svg` there. With FROM the fields of fewer false candidates are taken over from the table in FOLDER; beyond all
//! of them it is only drawn.

#[path = "../tests/common/random.rs"]
mod random;

use random::Random;
use std::fmt::Write;
use std::time::Instant;

use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_solve::Similarity;
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::evidence::{LEVELS_PX, pair_evidence};
use autoref_stream::matching::field::Field;
use autoref_stream::matching::{MatchOutcome, Matcher, Priors, RobustMatcher};

const SIZE: (f64, f64) = (15_828.0, 47_619.0);
const GSD: f64 = 0.03;
const VISIBLE: [usize; 9] = [3, 4, 5, 6, 7, 8, 10, 14, 20];
const FALSE: [usize; 6] = [0, 30, 100, 300, 1000, 20_000];
const SIGMA_PX: [f64; 4] = [0.5, 1.0, 2.0, 5.0];
/// From so many false candidates on north is known to ±15°, as it is for orthophotos: without it no search ends in
/// time.
const NORTH_KNOWN_FROM: usize = 20_000;
const NORTH_UP_DEG: f64 = 15.0;
const COLOURS: [&str; 6] = ["#1b6ca8", "#2a9d8f", "#8a9a2b", "#e9a23b", "#d1495b", "#6d3b8e"];

/// 36 GCPs around the image, the first `visible` of those inside marked (candidates 0..visible), then false candidates.
struct Case {
    gcps: Vec<Gcp>,
    marked: Vec<usize>,
    candidates: Vec<Candidate>,
    truth: Similarity,
}

fn case(random: &mut Random, visible: usize, false_candidates: usize, sigma_px: f64) -> Case {
    loop {
        let turn_deg = if false_candidates < NORTH_KNOWN_FROM { 180.0 } else { NORTH_UP_DEG };
        let angle = random.uniform(-turn_deg, turn_deg).to_radians();
        let truth = Similarity {
            a_re: GSD * angle.cos(),
            a_im: GSD * angle.sin(),
            easting_0: 568_000.0,
            northing_0: 7_024_000.0,
            mirrored: Handedness::AsIs,
        };
        // Drawn in the image's frame, so that about three quarters fall inside whatever the rotation.
        let pixels: Vec<PixelPoint> = (0..36)
            .map(|_| PixelPoint {
                x: random.uniform(-0.08 * SIZE.0, 1.08 * SIZE.0),
                y: random.uniform(-0.08 * SIZE.1, 1.08 * SIZE.1),
            })
            .collect();
        let gcps: Vec<Gcp> = pixels
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let m = truth.apply(*p);
                Gcp::control(i.to_string(), m.easting, m.northing)
            })
            .collect();
        let inside = |p: &PixelPoint| p.x >= 0.0 && p.y >= 0.0 && p.x < SIZE.0 && p.y < SIZE.1;
        let marked: Vec<usize> = (0..36).filter(|&i| inside(&pixels[i])).take(visible).collect();
        if marked.len() < visible {
            continue;
        }
        let bare = |x: f64, y: f64| Candidate::at(PixelPoint { x, y });
        let mut candidates: Vec<Candidate> = marked
            .iter()
            .map(|&i| bare(pixels[i].x + sigma_px * random.normal(), pixels[i].y + sigma_px * random.normal()))
            .collect();
        for _ in 0..false_candidates {
            candidates.push(bare(random.uniform(0.0, SIZE.0), random.uniform(0.0, SIZE.1)));
        }
        return Case { gcps, marked, candidates, truth };
    }
}

/// log₁₀ of the number of false alarms of the true pattern.
fn of_the_truth(case: &Case, possible: f64) -> f64 {
    let points: Vec<PixelPoint> = case.candidates.iter().map(|c| c.centre).collect();
    let positions: Vec<MapPoint> = case.gcps.iter().map(Gcp::position).collect();
    let field = Field::new(points.clone(), Some(SIZE));
    let mut best = 0.0f64;
    for i in 0..case.marked.len() {
        for j in i + 1..case.marked.len() {
            for level in LEVELS_PX {
                let ends = [points[i], points[j]];
                let pair = (case.marked[i], case.marked[j]);
                if let Some(e) = pair_evidence(&field, &positions, pair, ends, level, possible.log10()) {
                    best = best.min(e.log10_false_alarms);
                }
            }
        }
    }
    best
}

#[derive(Clone, Copy, Default)]
struct Cell {
    trials: usize,
    right: usize,
    wrong: usize,
    predicted: usize,
    seconds: f64,
}

fn cell(visible: usize, false_candidates: usize, sigma_px: f64, trials: usize) -> Cell {
    let seed = (visible * 1_000_003 + false_candidates * 97) as u64 + (sigma_px * 10.0) as u64;
    let mut random = Random::new(seed);
    let matcher = RobustMatcher::default();
    let rotation_deg = (false_candidates >= NORTH_KNOWN_FROM).then_some((0.0, NORTH_UP_DEG));
    let priors = Priors { gsd_m_per_px: Some((0.9 * GSD, 1.1 * GSD)), rotation_deg, image_size_px: Some(SIZE) };
    let mut cell = Cell { trials, ..Cell::default() };
    for _ in 0..trials {
        let case = case(&mut random, visible, false_candidates, sigma_px);
        let started = Instant::now();
        let outcome = matcher.find(&case.candidates, &case.gcps, &priors);
        cell.seconds += started.elapsed().as_secs_f64();
        let possible = match &outcome {
            MatchOutcome::Solved(solved) => {
                let off = |&i: &usize| {
                    let m = case.gcps[i].position();
                    let (p, q) = (case.truth.invert(m), solved.pattern.similarity.invert(m));
                    (p.x - q.x).hypot(p.y - q.y)
                };
                let worst = case.marked.iter().map(off).fold(0.0, f64::max);
                if worst <= 5.0 * sigma_px.max(1.0) {
                    cell.right += 1
                } else {
                    cell.wrong += 1
                }
                solved.effort.hypotheses_possible
            }
            MatchOutcome::NoMatch(evidence) => evidence.effort.hypotheses_possible,
        };
        cell.predicted += usize::from(of_the_truth(&case, possible.max(1.0)) <= matcher.max_false_alarms.log10());
    }
    cell
}

/// Four panels, one an error of the marks: success against visible GCPs; measured solid, predicted dashed.
fn svg(cells: &[(usize, usize, f64, Cell)]) -> String {
    let mut out = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 860 620\" font-family=\"sans-serif\" font-size=\"12\">\
         <rect width=\"860\" height=\"620\" fill=\"#fff\"/>\n",
    );
    let place = |visible: f64| 320.0 * (visible - 3.0).ln_1p() / 18f64.ln();
    for (panel, sigma) in SIGMA_PX.into_iter().enumerate() {
        let (x0, y0) = (60.0 + 420.0 * (panel % 2) as f64, 50.0 + 270.0 * (panel / 2) as f64);
        let mut add = |text: String| out.push_str(&text);
        add(format!("<text x=\"{x0}\" y=\"{}\" font-weight=\"bold\">σ = {sigma} px</text>\n", y0 - 12.0));
        for share in [0.0, 0.5, 1.0] {
            let y = y0 + 180.0 * (1.0 - share);
            add(format!(
                "<path d=\"M{x0} {y}h330\" stroke=\"#ccc\"/><text x=\"{}\" y=\"{}\" text-anchor=\"end\">{:.0} %</text>\n",
                x0 - 6.0,
                y + 4.0,
                100.0 * share
            ));
        }
        for visible in VISIBLE {
            add(format!(
                "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{visible}</text>\n",
                x0 + place(visible as f64),
                y0 + 198.0
            ));
        }
        for (false_candidates, colour) in FALSE.into_iter().zip(COLOURS) {
            for (predicted, dash) in [(false, ""), (true, " stroke-dasharray=\"4 4\"")] {
                let points: Vec<String> = cells
                    .iter()
                    .filter(|c| c.1 == false_candidates && c.2 == sigma)
                    .map(|&(visible, _, _, cell)| {
                        let share = if predicted { cell.predicted } else { cell.right } as f64 / cell.trials as f64;
                        format!("{:.1},{:.1}", x0 + place(visible as f64), y0 + 180.0 * (1.0 - share))
                    })
                    .collect();
                add(format!(
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\"{dash}/>\n",
                    points.join(" ")
                ));
            }
        }
    }
    for (i, (false_candidates, colour)) in FALSE.into_iter().zip(COLOURS).enumerate() {
        let x = 60.0 + 105.0 * i as f64;
        writeln!(out, "<path d=\"M{x} 588h18\" stroke=\"{colour}\" stroke-width=\"3\"/><text x=\"{}\" y=\"592\">{false_candidates} false</text>", x + 24.0)
            .expect("a string takes all writes");
    }
    out.push_str("<text x=\"60\" y=\"612\">visible GCPs of 36 →; solid: solved rightly, dashed: what the false-alarm formula allows; 20,000 false: north within 15°</text></svg>\n");
    out
}

/// Rows of the table in the folder with fewer false candidates than `from`, which are also written to `csv`.
fn taken_over(folder: &std::path::Path, from: usize, csv: &mut String) -> Vec<(usize, usize, f64, Cell)> {
    let table = std::fs::read_to_string(folder.join("matching-success.csv")).expect("a table to go on from");
    let mut cells = Vec::new();
    for line in table.lines().skip(1) {
        let values: Vec<f64> = line.split(',').map(|v| v.parse().expect("a table of numbers")).collect();
        let [visible, false_candidates, trials, right, wrong, predicted] =
            [0, 1, 3, 4, 5, 6].map(|k| values[k] as usize);
        if false_candidates < from {
            let cell = Cell { trials, right, wrong, predicted, seconds: values[7] * values[3] };
            cells.push((visible, false_candidates, values[2], cell));
            csv.push_str(line);
            csv.push('\n');
        }
    }
    cells
}

fn write(folder: &std::path::Path, csv: &str, cells: &[(usize, usize, f64, Cell)]) {
    std::fs::write(folder.join("matching-success.csv"), csv).expect("the folder can be written to");
    std::fs::write(folder.join("matching-success.svg"), svg(cells)).expect("the folder can be written to");
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let folder = std::path::PathBuf::from(arguments.next().expect("usage: success_curve FOLDER [TRIALS]"));
    let trials: usize = arguments.next().map_or(20, |n| n.parse().expect("a number of trials"));
    let from: usize = arguments.next().map_or(0, |n| n.parse().expect("a number of false candidates"));
    let mut csv = String::from("visible,false_candidates,sigma_px,trials,right,wrong,predicted,seconds_per_trial\n");
    let mut cells = if from > 0 { taken_over(&folder, from, &mut csv) } else { Vec::new() };
    // The costly fields last; what is done is on disk.
    for false_candidates in FALSE.into_iter().filter(|&n| n >= from) {
        // A trial among 20,000 costs as much as hundreds among a hundred.
        let trials = match false_candidates {
            0..=500 => trials,
            501..=5000 => trials.div_ceil(4),
            _ => trials.div_ceil(10),
        };
        for sigma in SIGMA_PX {
            for visible in VISIBLE {
                let cell = cell(visible, false_candidates, sigma, trials);
                writeln!(
                    csv,
                    "{visible},{false_candidates},{sigma},{trials},{},{},{},{:.4}",
                    cell.right,
                    cell.wrong,
                    cell.predicted,
                    cell.seconds / trials as f64
                )
                .expect("a string takes all writes");
                cells.push((visible, false_candidates, sigma, cell));
            }
            write(&folder, &csv, &cells);
            eprintln!("{false_candidates} false candidates, σ {sigma} px: done");
        }
    }
    write(&folder, &csv, &cells);
    let count = |f: &dyn Fn(&Cell) -> usize| cells.iter().map(|c| f(&c.3)).sum::<usize>();
    println!(
        "{} trials: {} right, {} wrong, {} predicted",
        count(&|c| c.trials),
        count(&|c| c.right),
        count(&|c| c.wrong),
        count(&|c| c.predicted)
    );
}
