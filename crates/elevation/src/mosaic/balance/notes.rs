//! What could not be evened out, in sentences.

use std::collections::BTreeSet;
use std::path::Path;

use super::adjust::Ties;
use autoref_raster::words::{counted, some_of};

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The sentences of one band.
fn of_band(ties: &Ties, names: &[&Path], reference: Option<usize>) -> Vec<String> {
    let members = |group: usize| ties.groups.iter().filter(|g| **g == group).count();
    let sources = ties.groups.len();
    let select = |wanted: &dyn Fn(usize) -> bool| -> Vec<String> {
        (0..sources).filter(|source| wanted(*source)).map(|source| name(names[source])).collect()
    };
    let pairs = |pairs: &[(usize, usize)]| {
        let both = |(i, j): &(usize, usize)| format!("{} with {}", name(names[*i]), name(names[*j]));
        some_of(&pairs.iter().map(both).collect::<Vec<_>>())
    };
    let mut notes = Vec::new();
    let alone = select(&|source| members(ties.groups[source]) == 1 && reference != Some(source));
    if !alone.is_empty() {
        notes.push(format!(
            "{} of {sources} sources are tied to no other by their overlaps and stay as they are: {}",
            alone.len(),
            some_of(&alone)
        ));
    }
    let free: BTreeSet<usize> = ties.groups.iter().copied().filter(|group| members(*group) > 1).collect();
    match reference {
        Some(reference) => {
            let group = ties.groups[reference];
            let others = select(&|source| ties.groups[source] != group && members(ties.groups[source]) > 1);
            if !others.is_empty() {
                notes.push(format!(
                    "{} of {sources} sources are tied to others, and not to {}; they keep a level of their own: {}",
                    others.len(),
                    name(names[reference]),
                    some_of(&others)
                ));
            }
        }
        None if free.len() > 1 => {
            let group = |group: &usize| format!("{} with {} more", name(names[*group]), members(*group) - 1);
            notes.push(format!(
                "the sources fall into {} groups that no overlap ties; each keeps a level of its own: {}",
                free.len(),
                some_of(&free.iter().map(group).collect::<Vec<_>>())
            ));
        }
        None => {}
    }
    if let (Some(reference), Some(surface)) = (reference, ties.kept_surface) {
        notes.push(format!(
            "the sources have a surface in common (a fall of light) that is taken out of all but {}, which stays as it \
             is: there it departs by up to {surface:.1}",
            name(names[reference])
        ));
    }
    if !ties.level_only.is_empty() {
        notes.push(format!(
            "{} of {} overlaps have too few blocks or too little in common to tell a gain; levels alone are evened out \
             there: {}",
            ties.level_only.len(),
            ties.agreeing.len(),
            pairs(&ties.level_only)
        ));
    }
    if !ties.uncounted.is_empty() {
        notes.push(format!(
            "{} of {} overlaps hold no block that counts, since their cells lie at the limits of the sample type: {}",
            ties.uncounted.len(),
            ties.agreeing.len(),
            pairs(&ties.uncounted)
        ));
    }
    notes
}

/// What the ties of all bands leave open; what holds in all of them is said once.
pub fn of_ties(ties: &[Ties], names: &[&Path], reference: Option<usize>) -> Vec<String> {
    let mut said: Vec<(String, Vec<String>)> = Vec::new();
    for band in ties {
        for note in of_band(band, names, reference) {
            let number = (band.band + 1).to_string();
            match said.iter_mut().find(|(earlier, _)| *earlier == note) {
                Some((_, bands)) => bands.push(number),
                None => said.push((note, vec![number])),
            }
        }
    }
    let with_bands = |(note, bands): (String, Vec<String>)| match bands.len() {
        n if n == ties.len() => note,
        1 => format!("band {}: {note}", bands[0]),
        _ => format!("bands {}: {note}", bands.join(", ")),
    };
    said.into_iter().map(with_bands).collect()
}

/// What is said of clipped cells.
pub fn of_clipped(clipped: u64, filled: u64) -> Option<String> {
    let share = 100.0 * clipped as f64 / filled.max(1) as f64;
    let share = if share < 0.1 { "less than 0.1".into() } else { format!("{share:.1}") };
    (clipped > 0).then(|| {
        format!(
            "{} ({share} %) beyond the limits of the sample type: clipped; --balance-to a source of less contrast, or \
             gdal_translate -ot to a wider type first, keeps what is lost",
            counted(clipped, "cell", "cells")
        )
    })
}
