//! Marks that lie beside those of the match, all the same way: old ones that were painted again, witness marks.
//!
//! The match cannot know which of the two sets the list means: a shift of all marks alike is a shift of the image.

use super::{MatchRow, RunResult};
use crate::candidate::Candidate;

/// Marks like those of the match, at one offset from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Twins {
    /// GCPs beside whose marks they lie.
    pub gcps: Vec<String>,
    pub apart_px: f64,
}

/// Offsets of one set differ by no more, pixels.
const ALIKE_PX: f64 = 3.0;
/// Fewer are no set.
const FEWEST: usize = 3;
/// So many sets chance may make.
const FALSE_ALARMS: f64 = 1e-3;

/// An offset in pixels, of a candidate from the mark of a row.
struct Offset {
    row: usize,
    candidate: usize,
    at: (f64, f64),
}

impl Twins {
    /// `None` where there are none, or as few as chance makes.
    pub fn of(result: &RunResult) -> Option<Twins> {
        let run = result.solved()?;
        let rows: Vec<&MatchRow> = run.matches.iter().chain(&run.check_points).collect();
        Twins::among(&rows, &result.candidates, area_px2(result, &rows))
    }

    fn among(rows: &[&MatchRow], candidates: &[Candidate], area_px2: f64) -> Option<Twins> {
        /// Among crowds everything lies beside everything.
        const MOST_PAIRS: usize = 20_000_000;
        const MOST_OFFSETS: usize = 4_000;
        if rows.len() * candidates.len() > MOST_PAIRS {
            return None;
        }
        let free: Vec<&Candidate> = free(rows, candidates);
        let offsets = offsets(rows, &free, candidates);
        if offsets.len() > MOST_OFFSETS {
            return None;
        }
        let around = |centre: &Offset| {
            let mut set: Vec<&Offset> = Vec::new();
            for other in &offsets {
                let near = (other.at.0 - centre.at.0).hypot(other.at.1 - centre.at.1) <= ALIKE_PX;
                if near && !set.iter().any(|o| o.row == other.row || o.candidate == other.candidate) {
                    set.push(other);
                }
            }
            set
        };
        let best = offsets.iter().map(around).max_by_key(Vec::len).filter(|set| set.len() >= FEWEST)?;
        let by_chance = -(-(free.len() as f64) / area_px2 * std::f64::consts::PI * ALIKE_PX * ALIKE_PX).exp_m1();
        let false_alarms = offsets.len() as f64 * at_least(rows.len() - 1, best.len() - 1, by_chance);
        if false_alarms > FALSE_ALARMS {
            return None;
        }
        let n = best.len() as f64;
        let mean = |of: fn(&Offset) -> f64| best.iter().map(|o| of(o)).sum::<f64>() / n;
        let apart_px = mean(|o| o.at.0).hypot(mean(|o| o.at.1));
        Some(Twins { gcps: best.iter().map(|offset| rows[offset.row].gcp.clone()).collect(), apart_px })
    }

    /// For the verdict, as a part of a sentence.
    pub fn clause(&self, scale_m_per_px: f64) -> String {
        format!(
            "{} marks like these lie {:.0} px = {:.2} m beside {}, all the same way: old or witness marks, or other parts \
             of these? look which are the points'",
            self.gcps.len(),
            self.apart_px,
            self.apart_px * scale_m_per_px,
            self.gcps.join(", ")
        )
    }
}

/// Candidates of no matched mark.
fn free<'a>(rows: &[&MatchRow], candidates: &'a [Candidate]) -> Vec<&'a Candidate> {
    const SAME_PX: f64 = 2.0;
    let is_matched = |c: &&Candidate| rows.iter().any(|row| (row.x - c.centre.x).hypot(row.y - c.centre.y) <= SAME_PX);
    candidates.iter().filter(|c| !is_matched(c)).collect()
}

/// Of whole marks of about the size, beside their fellows and not within them.
fn offsets(rows: &[&MatchRow], free: &[&Candidate], candidates: &[Candidate]) -> Vec<Offset> {
    /// In sides of the mark; nearer lie its own parts.
    const NEAREST: f64 = 1.3;
    const FARTHEST_PX: f64 = 100.0;
    const MOST_UNLIKE: f64 = 3.0;
    let mut offsets = Vec::new();
    for (row, m) in rows.iter().enumerate() {
        let apart = |c: &Candidate| (c.centre.x - m.x).hypot(c.centre.y - m.y);
        let own = candidates.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
        let Some(area_px) = own.filter(|own| apart(own) <= 2.0).and_then(|own| own.area_px) else { continue };
        for (candidate, c) in free.iter().enumerate() {
            let unlike = c.area_px.map_or(f64::INFINITY, |other| (other / area_px).max(area_px / other));
            if unlike <= MOST_UNLIKE && (NEAREST * area_px.sqrt()..=FARTHEST_PX).contains(&apart(c)) {
                offsets.push(Offset { row, candidate, at: (c.centre.x - m.x, c.centre.y - m.y) });
            }
        }
    }
    offsets
}

/// The image's area, or that of the marks where the image is not known.
fn area_px2(result: &RunResult, rows: &[&MatchRow]) -> f64 {
    if let Some(image) = &result.image {
        return image.width as f64 * image.height as f64;
    }
    let span = |of: fn(&MatchRow) -> f64| {
        let ends = rows
            .iter()
            .map(|row| of(row))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        (ends.1 - ends.0).max(1.0)
    };
    span(|row| row.x) * span(|row| row.y)
}

/// The chance that of `n` independent events of probability `p` at least `k` come.
fn at_least(n: usize, k: usize, p: f64) -> f64 {
    let mut term = 1.0;
    let mut below = 0.0;
    for i in 0..k {
        let (n, i) = (n as f64, i as f64);
        below += term * p.powf(i) * (1.0 - p).powf(n - i);
        term *= (n - i) / (i + 1.0);
    }
    if below < 0.99 {
        return 1.0 - below;
    }
    // The first term of the tail, all but: 1 − below has lost its digits.
    term * p.powf(k as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::coords::PixelPoint;

    const PLACES: [(f64, f64); 9] = [
        (100.0, 120.0),
        (900.0, 150.0),
        (1500.0, 300.0),
        (400.0, 700.0),
        (1200.0, 800.0),
        (1700.0, 1000.0),
        (200.0, 1300.0),
        (800.0, 1200.0),
        (1400.0, 1350.0),
    ];

    fn told(beside: &[(usize, f64, f64, f64)]) -> Option<Twins> {
        let mark =
            |x: f64, y: f64, area_px: f64| Candidate { area_px: Some(area_px), ..Candidate::at(PixelPoint { x, y }) };
        let own = PLACES.iter().map(|&(x, y)| mark(x, y, 200.0));
        let others = beside.iter().map(|&(i, dx, dy, area)| mark(PLACES[i].0 + dx, PLACES[i].1 + dy, area));
        let row = |(i, &(x, y)): (usize, &(f64, f64))| -> MatchRow {
            serde_json::from_value(serde_json::json!({
                "gcp": format!("P{i}"), "x": x, "y": y, "easting": 0.0, "northing": 0.0, "height": null,
                "survey_sigma_m": null, "residual_e_m": 0.0, "residual_n_m": 0.0, "residual_px": 0.0,
                "covariance_px2": null, "score": 9.0, "found_by": "scan", "leave_one_out_m": null, "redundancy": null,
                "detectable_blunder_m": null, "outlier": false
            }))
            .expect("a row")
        };
        let rows: Vec<MatchRow> = PLACES.iter().enumerate().map(row).collect();
        Twins::among(&rows.iter().collect::<Vec<_>>(), &own.chain(others).collect::<Vec<_>>(), 2000.0 * 1500.0)
    }

    #[test]
    fn a_second_set_at_one_offset_is_told() {
        let old = [(1, 29.0, 3.0, 180.0), (4, 28.0, 2.5, 220.0), (6, 30.0, 4.0, 150.0), (7, 29.5, 2.0, 190.0)];
        let twins = told(&old).expect("four lie alike");
        assert_eq!(twins.gcps, ["P1", "P4", "P6", "P7"]);
        assert!((twins.apart_px - 29.2).abs() < 0.5, "{}", twins.apart_px);
        assert!(twins.clause(0.05).contains("29 px = 1.46 m beside P1, P4, P6, P7"));
        // Two are no set, digits are smaller, and others lie each its own way.
        assert_eq!(told(&old[..2]), None);
        assert_eq!(told(&old.map(|(i, x, y, _)| (i, x, y, 30.0))), None);
        let scattered =
            [(1, 29.0, 3.0, 180.0), (4, -28.0, 12.5, 220.0), (6, 3.0, 44.0, 150.0), (7, -29.5, -42.0, 190.0)];
        assert_eq!(told(&scattered), None);
    }

    #[test]
    fn the_tail_of_the_binomial() {
        assert!((at_least(4, 2, 0.5) - 11.0 / 16.0).abs() < 1e-12);
        assert!((at_least(8, 3, 1e-5) / (56.0 * 1e-15) - 1.0).abs() < 1e-3);
    }
}
