//! Rows of a table that are no points but statistics of the rows above: sums, means, extremes.
//!
//! A word alone makes no statistic, since a point may be called `Max`: its numbers must be that statistic, or, in the
//! last rows, lie where no point of the list does. Nor is a word needed, since no list of words has those of all
//! languages: a row below the points whose numbers are one statistic of all columns is one, unless it may be a point,
//! as the middle of a grid is the mean of the others (see [`Tail::shows`]).

use std::collections::HashSet;

use crate::gcp::columns::Columns;
use crate::gcp::text::Row;
use crate::gcp::titles::tidy;
use autoref_raster::ranks::median;

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
            "snittverdi", "middel", "middelvaerdi", "medelv", "medelvardet", "medeltal", "medaltal", "vidurkis",
            "vid", "videjais", "keskmine", "keskm", "ka", "mittlwert", "arithm mittel", "arithmetisches mittel",
            "mean avg", "valeur moyenne", "moyenne arithmetique", "valor medio", "valore medio", "valor promedio",
            "media aritmetica", "medie aritmetica", "stredni hodnota", "aritmeticky prumer", "srednja vrijednost",
            "srednja vrednost", "сред", "средна стоиност", "средна", "середне", "平均數",
            "mittelwert", "mean value", "mittel", "mittelwerte", "durchschnitt", "mw", "mean", "average", "avg",
            "moyenne", "moy",
            "media", "promedio", "prom", "gemiddelde", "gjennomsnitt", "snitt", "middelverdi", "medel", "medelvarde",
            "gennemsnit", "keskiarvo", "srednia", "prumer", "priemer", "prosjek", "povprecje", "atlag", "ortalama",
            "medie", "среднее", "середнє", "μεσοσ οροσ", "平均", "平均値", "平均值", "평균", "ø", "∅",
        ]),
        (Statistic::Median, &["median", "mediane", "mediana", "mediaan", "медиана", "中央値"]),
        (Statistic::Largest, &[
            "grosster", "grosste", "grosstwert", "storst", "storste", "storsta", "størst", "største", "suurin",
            "najwiekszy", "najwieksza", "nejvetsi", "najvacsi", "najveci", "legnagyobb", "en buyuk", "en yuksek",
            "maksimalny", "maximalni", "valeur max", "max value", "maximum value",
            "max", "maximum", "maks", "maksimum", "maximo", "massimo", "maxi", "maximalwert", "макс", "максимум",
            "μεγιστο", "最大", "最大値", "最大值", "최대",
        ]),
        (Statistic::Least, &[
            "kleinster", "kleinste", "kleinstwert", "minst", "minste", "minsta", "mindste", "pienin", "najmniejszy",
            "najmniejsza", "nejmensi", "najmensi", "najmanji", "legkisebb", "en kucuk", "en dusuk", "minimalny",
            "minimalni", "valeur min", "min value", "minimum value",
            "min", "minimum", "minimo", "mini", "minimalwert", "мин", "минимум", "ελαχιστο", "最小", "最小値", "最小值",
            "최소",
        ]),
        (Statistic::Range, &["range", "spannweite", "span", "differenz", "difference", "etendue", "rango", "escursione"]),
        (Statistic::Sum, &[
            "summe", "gesamtsumme", "zwischensumme", "subtotal", "sub total", "total general", "sum", "total",
            "totals", "grand total", "gesamt", "insgesamt", "suma", "somme", "somma", "totale",
            "totaux", "totaal", "som", "soma", "summa", "sum total", "yhteensa", "razem", "celkem", "spolu", "ukupno",
            "skupaj", "osszesen", "osszeg", "toplam", "итого", "всего", "сумма", "усього", "συνολο", "合計", "合计", "合計値",
            "합계", "i alt", "σ",
        ]),
        (Statistic::Spread, &[
            "st dev", "std deviation", "standard dev", "standardfehler", "std fehler", "s", "ec type", "ecart",
            "desv tip", "desv tipica", "desviacion tipica", "desviacion", "desvio", "desv pad", "deviazione std",
            "scarto", "scarto quadratico medio", "sqm", "odch std", "odch stand", "sm odch", "smer odchylka",
            "std sapma", "st sapma", "standaarddeviatie", "std afw", "hajonta", "standarthalve", "standartnovirze",
            "standartinis nuokrypis", "standardna devijacija", "standardni odklon", "abatere standard",
            "стандартно отклонение", "стандартное отклонение", "среднеквадратическое отклонение", "τυπικη αποκλιση",
            "mad", "emq", "mse", "mf",
            "stdabw", "std abw", "standardabw", "standardabweichung", "streuung", "std", "stdev", "std dev",
            "stddev", "sd", "standard deviation",
            "sigma", "rms", "rmse", "ecart type", "ecarttype", "desviacion estandar", "desv est", "desvio padrao",
            "deviazione standard", "dev std", "standaardafwijking", "standardavvik", "standardavvikelse",
            "standardafvigelse", "keskihajonta", "odchylenie standardowe", "smerodatna odchylka", "szoras",
            "standart sapma", "varianz", "variance", "ско", "標準偏差", "標准差", "표준편차",
        ]),
        (Statistic::Count, &[
            "n", "anz", "number of points", "no of points", "points", "nombre", "nombre de points", "nb",
            "numero de puntos", "conteo", "cantidad", "conteggio", "numero punti", "contagem", "quantidade",
            "punkte", "antall punkter", "antal punkter", "aantal punten", "lukumaara", "kpl", "lkm", "ilosc",
            "pocet bodu", "broj", "darab", "db", "adet", "кол во", "число точек", "πληθοσ", "件數", "數", "개수",
            "anzahl", "count", "antall", "antal", "aantal", "liczba", "pocet", "количество", "個数",
        ]),
    ];

    fn of(word: &str) -> Option<Statistic> {
        let plain = tidy(word);
        Statistic::WORDS.iter().find(|(_, words)| words.contains(&plain.as_str())).map(|(statistic, _)| *statistic)
    }

    /// Those that lie among the values, as a point may.
    fn is_among(self) -> bool {
        matches!(self, Statistic::Mean | Statistic::Median | Statistic::Largest | Statistic::Least)
    }
}

/// The statistics of some values.
struct Values {
    each: Vec<(Statistic, f64)>,
    least: f64,
    largest: f64,
}

impl Values {
    /// `None` of less than two.
    fn of(above: &[f64]) -> Option<Values> {
        let n = above.len() as f64;
        if above.len() < 2 {
            return None;
        }
        let sum: f64 = above.iter().sum();
        let (least, largest) = extremes(above);
        let squares: f64 = above.iter().map(|value| (value - sum / n).powi(2)).sum();
        let each = vec![
            (Statistic::Mean, sum / n),
            (Statistic::Median, median(above.to_vec())),
            (Statistic::Largest, largest),
            (Statistic::Least, least),
            (Statistic::Range, largest - least),
            (Statistic::Sum, sum),
            (Statistic::Spread, (squares / (n - 1.0)).sqrt()),
            (Statistic::Spread, (squares / n).sqrt()),
            (Statistic::Count, n),
        ];
        Some(Values { each, least, largest })
    }

    /// Whether a cell says this statistic, to the digits that it is printed with.
    fn says(&self, statistic: Statistic, cell: &Cell<'_>) -> bool {
        let Some(value) = cell.value else { return false };
        // A count is not rounded.
        let step = if statistic == Statistic::Count { 0.0 } else { 1.01 * cell.last_digit() };
        self.each
            .iter()
            .any(|(kind, of_all)| *kind == statistic && (of_all - value).abs() <= step + 1e-12 * value.abs())
    }
}

/// A number as it stands in a row.
struct Cell<'a> {
    text: &'a str,
    value: Option<f64>,
}

impl<'a> Cell<'a> {
    fn of(columns: &Columns, cells: &'a [String], column: Option<usize>) -> Cell<'a> {
        let text = column.and_then(|column| cells.get(column)).map_or("", |cell| cell.trim());
        Cell { text, value: columns.number(text) }
    }

    fn last_digit(&self) -> f64 {
        let decimals = match self.text.rfind(['.', ',']) {
            Some(at) if self.has_fraction() => self.text.len() - at - 1,
            _ => 0,
        };
        10f64.powi(-(decimals.min(12) as i32))
    }

    fn has_fraction(&self) -> bool {
        self.value.is_some_and(|value| value.fract() != 0.0)
    }
}

fn extremes(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), &v| (least.min(v), most.max(v)))
}

/// What was found below or among the points of a table, in plain words.
#[derive(Default)]
pub(super) struct Found {
    /// Rows that were taken out.
    pub aside: Option<String>,
    /// A last row that was left in and may be none.
    pub doubt: Option<String>,
}

/// Takes the rows that are statistics out of a table; says which.
pub(super) fn set_aside(columns: &Columns, rows: &mut Vec<Row<'_>>) -> Found {
    let mut is_aside = among_points(columns, rows);
    let tail = Tail::of(columns, rows, &is_aside);
    is_aside[tail.begin..].fill(true);
    let described =
        |(line, cells): &Row<'_>| format!("`{}` ({})", word(columns, cells).unwrap_or_default(), line.place());
    let said: Vec<String> =
        rows.iter().zip(&is_aside).filter(|(_, aside)| **aside).map(|(row, _)| described(row)).collect();
    let doubt = (tail.begin == rows.len()).then(|| Tail::doubt(columns, rows, &is_aside)).flatten();
    let mut aside = is_aside.iter();
    rows.retain(|_| !aside.next().expect("one for each row"));
    let aside = (!said.is_empty())
        .then(|| format!("set aside, since they are statistics of the rows above: {}", said.join(", ")));
    Found { aside, doubt }
}

/// Which rows are called a statistic, and are that of the rows above, wherever they stand.
fn among_points(columns: &Columns, rows: &[Row<'_>]) -> Vec<bool> {
    /// A list has a handful; each is compared with all rows above.
    const MOST: usize = 64;
    let mut is_aside = vec![false; rows.len()];
    let statistics: Vec<Option<Statistic>> =
        rows.iter().map(|(_, cells)| Statistic::of(word(columns, cells)?)).collect();
    let candidates = statistics.iter().flatten().count();
    if candidates == 0 || candidates > MOST {
        return is_aside;
    }
    let mut above: [Vec<f64>; 2] = Default::default();
    for (at, (_, cells)) in rows.iter().enumerate() {
        let plan = [columns.easting, columns.northing].map(|column| Cell::of(columns, cells, Some(column)));
        is_aside[at] = statistics[at].is_some_and(|statistic| {
            let says = |axis: usize| Values::of(&above[axis]).is_some_and(|all| all.says(statistic, &plan[axis]));
            says(0) && says(1)
        });
        if let ([Some(easting), Some(northing)], false) = (plan.map(|cell| cell.value), is_aside[at]) {
            above[0].push(easting);
            above[1].push(northing);
        }
    }
    is_aside
}

/// The last rows of a table, all of which are statistics of the rows above the first of them.
struct Tail {
    begin: usize,
}

/// How sure it is that a row is a statistic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    Surely,
    /// Where others beside it are.
    InCompany,
    No,
}

/// What the rows above a tail have.
struct Above {
    /// Of easting, northing and height.
    axes: [Option<Values>; 3],
    names: HashSet<String>,
    all_named: bool,
    points: usize,
}

impl Above {
    fn of(columns: &Columns, rows: &[Row<'_>], is_aside: &[bool]) -> Above {
        let mut axes: [Vec<f64>; 3] = Default::default();
        let (mut names, mut all_named) = (HashSet::new(), true);
        for (_, cells) in rows.iter().zip(is_aside).filter(|(_, aside)| !**aside).map(|(row, _)| row) {
            let [Some(easting), Some(northing), height] = cells_of(columns, cells).map(|cell| cell.value) else {
                continue;
            };
            axes[0].push(easting);
            axes[1].push(northing);
            axes[2].extend(height);
            let name = name(columns, cells);
            all_named &= name.is_some();
            names.extend(name.filter(|name| name.contains(|c: char| c.is_ascii_digit())).map(without_digits));
        }
        Above { points: axes[0].len(), axes: axes.map(|values| Values::of(&values)), names, all_named }
    }
}

impl Tail {
    /// As many of the last rows as are statistics of all rows above.
    fn of(columns: &Columns, rows: &[Row<'_>], is_aside: &[bool]) -> Tail {
        const MOST: usize = 16;
        let none = Tail { begin: rows.len() };
        for begin in rows.len().saturating_sub(MOST).max(2)..rows.len() {
            let above = Above::of(columns, &rows[..begin], &is_aside[..begin]);
            let shown = rows[begin..].iter().map(|(_, cells)| Tail::shows(columns, &above, cells));
            let mut shown: Vec<Shown> = shown.collect();
            for (shown, _) in shown.iter_mut().zip(&is_aside[begin..]).filter(|(_, aside)| **aside) {
                *shown = Shown::Surely;
            }
            if !shown.contains(&Shown::No) && shown.contains(&Shown::Surely) {
                return Tail { begin };
            }
        }
        none
    }

    /// Whether a row is a statistic of the rows above: by its word and where it lies; or by numbers that are one
    /// statistic of both coordinates and, since a point may lie in the middle of others or in the corner of a grid, of
    /// the heights too, under no name like those of the points.
    fn shows(columns: &Columns, above: &Above, cells: &[String]) -> Shown {
        let [Some(easting), Some(northing), heights] = &above.axes else { return Shown::No };
        let row = cells_of(columns, cells);
        let called = word(columns, cells).and_then(Statistic::of);
        let says = |statistic: Statistic| easting.says(statistic, &row[0]) && northing.says(statistic, &row[1]);
        let is_off = lies_off([row[0].value, row[1].value], [easting, northing]);
        if called.is_some_and(|called| says(called) || (is_off && may_be(called, &row, above))) {
            return Shown::Surely;
        }
        let name = name(columns, cells);
        if above.points < 3 || name.as_ref().is_some_and(|name| above.names.contains(&without_digits(name.clone()))) {
            return Shown::No;
        }
        let Some((statistic, _)) = easting.each.iter().find(|(statistic, _)| says(*statistic)) else {
            return Shown::No;
        };
        let has_digits = row.iter().take(2).all(Cell::has_fraction);
        let height_too = heights
            .as_ref()
            .is_some_and(|heights| heights.largest > heights.least && heights.says(*statistic, &row[2]));
        let is_nameless = columns.name.is_some() && name.is_none() && above.all_named;
        match statistic.is_among() {
            false if is_off || has_digits => Shown::Surely,
            true if (height_too && row.iter().any(Cell::has_fraction)) || is_nameless => Shown::Surely,
            _ => Shown::InCompany,
        }
    }

    /// A last row that is the mean of the others in the plan alone, as a point in their middle may be.
    fn doubt(columns: &Columns, rows: &[Row<'_>], is_aside: &[bool]) -> Option<String> {
        let ((line, cells), before) = rows.split_last()?;
        let above = Above::of(columns, before, &is_aside[..before.len()]);
        let is_one = Tail::shows(columns, &above, cells) == Shown::InCompany;
        is_one.then(|| {
            format!(
                "{}: `{}` has the numbers of a statistic of the rows above, and was taken for a point; remove the row \
                 if it is none",
                line.place(),
                word(columns, cells).unwrap_or_default()
            )
        })
    }
}

/// Easting, northing and height.
fn cells_of<'a>(columns: &Columns, cells: &'a [String]) -> [Cell<'a>; 3] {
    [Some(columns.easting), Some(columns.northing), columns.height].map(|column| Cell::of(columns, cells, column))
}

fn name(columns: &Columns, cells: &[String]) -> Option<String> {
    columns.name.and_then(|column| cells.get(column)).map(|name| name.trim().to_owned()).filter(|name| !name.is_empty())
}

/// Names that differ in their numbers only are alike: "P12" is "P#".
fn without_digits(name: String) -> String {
    let mut kept = String::with_capacity(name.len());
    for letter in name.chars() {
        match letter {
            '0'..='9' if kept.ends_with('#') => {}
            '0'..='9' => kept.push('#'),
            other => kept.push(other),
        }
    }
    kept
}

/// What the row is called: its name, else its first cell that is no coordinate.
fn word<'a>(columns: &Columns, cells: &'a [String]) -> Option<&'a str> {
    let filled = |column: usize| cells.get(column).map(|cell| cell.trim()).filter(|cell| !cell.is_empty());
    let coordinates = [Some(columns.easting), Some(columns.northing), columns.height];
    let other = || (0..cells.len()).filter(|column| !coordinates.contains(&Some(*column))).find_map(filled);
    columns.name.and_then(filled).or_else(other)
}

/// Whether a place is none, or lies as far from the points as sums and deviations do.
fn lies_off(values: [Option<f64>; 2], above: [&Values; 2]) -> bool {
    const SIZES: f64 = 3.0;
    let [Some(easting), Some(northing)] = values else { return true };
    let size = (above[0].largest - above[0].least).hypot(above[1].largest - above[1].least);
    let off = |all: &Values, value: f64| (all.least - value).max(value - all.largest).max(0.0);
    off(above[0], easting).hypot(off(above[1], northing)) > SIZES * size
}

/// Whether numbers that are not this statistic of the rows above may be that of others: sums of any, deviations of up
/// to the size of the list, means and extremes of deviations, which are small. A point called `Max` that lies far away
/// stays one.
fn may_be(statistic: Statistic, row: &[Cell<'_>; 3], above: &Above) -> bool {
    const SHARE: f64 = 0.001;
    if row.iter().take(2).any(|cell| cell.value.is_none()) {
        return true;
    }
    let largest = |all: &Values| match statistic {
        Statistic::Sum => f64::INFINITY,
        Statistic::Spread | Statistic::Range => 1.05 * (all.largest - all.least),
        _ => SHARE * all.least.abs().min(all.largest.abs()),
    };
    let fits = |(all, cell): (&Option<Values>, &Cell<'_>)| {
        cell.value.zip(all.as_ref()).is_some_and(|(value, all)| value.abs() <= largest(all))
    };
    above.axes.iter().zip(row).take(2).all(fits)
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
        let values = Values::of(&[1.0, 2.0, 4.0]).expect("three");
        let says = |statistic, text: &str| values.says(statistic, &Cell { text, value: text.parse().ok() });
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
            assert!(says(statistic, text), "{statistic:?} {text}");
        }
        assert!(!says(Statistic::Mean, "2.31") && !says(Statistic::Count, "4") && !says(Statistic::Mean, ""));
    }

    #[test]
    fn sums_and_deviations_lie_off() {
        let above = [[100.0, 200.0], [7000.0, 7100.0]].map(|values| Values::of(&values).expect("two"));
        let lies_off = |easting, northing| lies_off([Some(easting), northing], [&above[0], &above[1]]);
        assert!(lies_off(300.0, Some(14100.0)) && lies_off(70.7, Some(70.7)));
        assert!(lies_off(2.0, None) && !lies_off(260.0, Some(7150.0)));
    }

    #[test]
    fn names_are_alike_but_for_their_numbers() {
        for (name, plain) in [("P12", "P#"), ("12", "#"), ("A1-20", "A#-#"), ("Mean", "Mean")] {
            assert_eq!(without_digits(name.into()), plain);
        }
    }
}
