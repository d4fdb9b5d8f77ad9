//! Rows of a table that are no points but statistics of the rows above: sums, means, extremes.
//!
//! A word alone makes no statistic, since a point may be called `Max`: its numbers must be that statistic, or, in the
//! last rows, lie where no point of the list does.

use crate::gcp::columns::Columns;
use crate::gcp::csv_list::Row;
use crate::gcp::titles::tidy;

/// What a row says of the rows above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Statistic {
    Mean,
    Median,
    Largest,
    Least,
    Range,
    Sum,
    Spread,
    Count,
}

impl Statistic {
    /// As [`tidy`] leaves the words.
    #[rustfmt::skip]
    const WORDS: &[(Statistic, &[&str])] = &[
        (Statistic::Mean, &[
            "mittelwert", "mean value", "mittel", "mittelwerte", "durchschnitt", "mw", "mean", "average", "avg", "moyenne", "moy",
            "media", "promedio", "prom", "gemiddelde", "gjennomsnitt", "snitt", "middelverdi", "medel", "medelvarde",
            "gennemsnit", "keskiarvo", "srednia", "prumer", "priemer", "prosjek", "povprecje", "atlag", "ortalama",
            "medie", "среднее", "середнє", "μεσοσ οροσ", "平均", "平均値", "平均值", "평균", "ø", "∅",
        ]),
        (Statistic::Median, &["median", "mediane", "mediana", "mediaan", "медиана", "中央値"]),
        (Statistic::Largest, &[
            "max", "maximum", "maks", "maksimum", "maximo", "massimo", "maxi", "maximalwert", "макс", "максимум",
            "μεγιστο", "最大", "最大値", "最大值", "최대",
        ]),
        (Statistic::Least, &[
            "min", "minimum", "minimo", "mini", "minimalwert", "мин", "минимум", "ελαχιστο", "最小", "最小値", "最小值",
            "최소",
        ]),
        (Statistic::Range, &["range", "spannweite", "span", "differenz", "difference", "etendue", "rango", "escursione"]),
        (Statistic::Sum, &[
            "summe", "gesamtsumme", "zwischensumme", "subtotal", "sub total", "total general", "sum", "total", "totals", "grand total", "gesamt", "insgesamt", "suma", "somme", "somma", "totale",
            "totaux", "totaal", "som", "soma", "summa", "sum total", "yhteensa", "razem", "celkem", "spolu", "ukupno",
            "skupaj", "osszesen", "osszeg", "toplam", "итого", "всего", "сумма", "усього", "συνολο", "合計", "合计", "合計値",
            "합계", "i alt", "σ",
        ]),
        (Statistic::Spread, &[
            "stdabw", "std abw", "standardabw", "standardabweichung", "streuung", "std", "stdev", "std dev", "stddev", "sd", "standard deviation",
            "sigma", "rms", "rmse", "ecart type", "ecarttype", "desviacion estandar", "desv est", "desvio padrao",
            "deviazione standard", "dev std", "standaardafwijking", "standardavvik", "standardavvikelse",
            "standardafvigelse", "keskihajonta", "odchylenie standardowe", "smerodatna odchylka", "szoras",
            "standart sapma", "varianz", "variance", "ско", "標準偏差", "標准差", "표준편차",
        ]),
        (Statistic::Count, &["anzahl", "count", "antall", "antal", "aantal", "liczba", "pocet", "количество", "個数"]),
    ];

    fn of(word: &str) -> Option<Statistic> {
        let plain = tidy(word);
        Statistic::WORDS.iter().find(|(_, words)| words.contains(&plain.as_str())).map(|(statistic, _)| *statistic)
    }

    /// What the statistic of some values may be.
    fn values(self, above: &[f64]) -> Vec<f64> {
        let n = above.len() as f64;
        let sum: f64 = above.iter().sum();
        let (least, largest) = extremes(above);
        match self {
            Statistic::Mean => vec![sum / n],
            Statistic::Median => {
                let mut sorted = above.to_vec();
                sorted.sort_by(f64::total_cmp);
                let half = sorted.len() / 2;
                vec![if sorted.len() % 2 == 1 { sorted[half] } else { (sorted[half - 1] + sorted[half]) / 2.0 }]
            }
            Statistic::Largest => vec![largest],
            Statistic::Least => vec![least],
            Statistic::Range => vec![largest - least],
            Statistic::Sum => vec![sum],
            Statistic::Spread => {
                let squares: f64 = above.iter().map(|value| (value - sum / n).powi(2)).sum();
                vec![(squares / (n - 1.0)).sqrt(), (squares / n).sqrt()]
            }
            Statistic::Count => vec![n],
        }
    }
}

fn extremes(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), &v| (least.min(v), most.max(v)))
}

/// Takes the rows that are statistics out of a table; says which.
pub(super) fn set_aside(columns: &Columns, rows: &mut Vec<Row<'_>>) -> Option<String> {
    /// A list has a handful; each is compared with all rows above.
    const MOST: usize = 64;
    let statistics: Vec<Option<Statistic>> =
        rows.iter().map(|(_, cells)| Statistic::of(word(columns, cells)?)).collect();
    let candidates = statistics.iter().flatten().count();
    if candidates == 0 || candidates > MOST {
        return None;
    }
    let last_point = statistics.iter().rposition(Option::is_none)?;
    let mut above: [Vec<f64>; 2] = Default::default();
    let mut is_aside = vec![false; rows.len()];
    for (at, (_, cells)) in rows.iter().enumerate() {
        let texts = [columns.easting, columns.northing].map(|column| cells.get(column).map_or("", |cell| cell.trim()));
        let values = texts.map(|text| columns.number(text));
        is_aside[at] = above[0].len() > 1
            && statistics[at].is_some_and(|statistic| {
                let says = |axis: usize| {
                    values[axis].is_some_and(|value| is_one_of(value, texts[axis], &statistic.values(&above[axis])))
                };
                (says(0) && says(1)) || (at > last_point && lies_off(values, &above))
            });
        if let ([Some(easting), Some(northing)], false) = (values, is_aside[at]) {
            above[0].push(easting);
            above[1].push(northing);
        }
    }
    let said: Vec<String> = rows
        .iter()
        .zip(&is_aside)
        .filter(|(_, aside)| **aside)
        .map(|((line, cells), _)| format!("`{}` ({})", word(columns, cells).unwrap_or_default(), line.place()))
        .collect();
    let mut aside = is_aside.iter();
    rows.retain(|_| !aside.next().expect("one for each row"));
    (!said.is_empty()).then(|| format!("set aside, since they are statistics of the rows above: {}", said.join(", ")))
}

/// What the row is called: its name, else its first cell that is no coordinate.
fn word<'a>(columns: &Columns, cells: &'a [String]) -> Option<&'a str> {
    let filled = |column: usize| cells.get(column).map(|cell| cell.trim()).filter(|cell| !cell.is_empty());
    let coordinates = [Some(columns.easting), Some(columns.northing), columns.height];
    let other = || (0..cells.len()).filter(|column| !coordinates.contains(&Some(*column))).find_map(filled);
    columns.name.and_then(filled).or_else(other)
}

/// Whether a number is one of these, to the digits that it is printed with.
fn is_one_of(value: f64, text: &str, statistics: &[f64]) -> bool {
    let decimals = match text.rfind(['.', ',']) {
        Some(at) if value.fract() != 0.0 => text.len() - at - 1,
        _ => 0,
    };
    let last_digit = 10f64.powi(-(decimals.min(12) as i32));
    statistics.iter().any(|statistic| (statistic - value).abs() <= 1.01 * last_digit + 1e-12 * value.abs())
}

/// Whether a place is none, or lies as far from the points as sums and deviations do.
fn lies_off(values: [Option<f64>; 2], above: &[Vec<f64>; 2]) -> bool {
    const SIZES: f64 = 3.0;
    let [Some(easting), Some(northing)] = values else { return true };
    let boxed = [extremes(&above[0]), extremes(&above[1])];
    let size = (boxed[0].1 - boxed[0].0).hypot(boxed[1].1 - boxed[1].0);
    let off = |(least, most): (f64, f64), value: f64| (least - value).max(value - most).max(0.0);
    off(boxed[0], easting).hypot(off(boxed[1], northing)) > SIZES * size
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_as_names_are_compared() {
        let mut seen = std::collections::HashSet::new();
        for word in Statistic::WORDS.iter().flat_map(|(_, words)| *words) {
            assert_eq!(tidy(word), *word, "written otherwise, it is never found");
            assert!(seen.insert(word), "{word} stands twice");
        }
        assert_eq!(Statistic::of("Écart-type :"), Some(Statistic::Spread));
        assert_eq!(Statistic::of("Mean (n=20)"), Some(Statistic::Mean));
        assert_eq!(Statistic::of("P1"), None);
    }

    #[test]
    fn statistics_to_the_printed_digits() {
        let values = [1.0, 2.0, 4.0];
        for (statistic, text) in [
            (Statistic::Mean, "2.33"),
            (Statistic::Median, "2"),
            (Statistic::Largest, "4.00"),
            (Statistic::Least, "1"),
            (Statistic::Range, "3.0"),
            (Statistic::Sum, "7"),
            (Statistic::Spread, "1.528"),
            (Statistic::Spread, "1.247"),
            (Statistic::Count, "3"),
        ] {
            let value = text.parse().expect("a number");
            assert!(is_one_of(value, text, &statistic.values(&values)), "{statistic:?} {text}");
        }
        assert!(!is_one_of(2.31, "2.31", &Statistic::Mean.values(&values)));
    }

    #[test]
    fn sums_and_deviations_lie_off() {
        let above = [vec![100.0, 200.0], vec![7000.0, 7100.0]];
        assert!(lies_off([Some(300.0), Some(14100.0)], &above) && lies_off([Some(70.7), Some(70.7)], &above));
        assert!(lies_off([Some(2.0), None], &above) && !lies_off([Some(260.0), Some(7150.0)], &above));
    }
}
