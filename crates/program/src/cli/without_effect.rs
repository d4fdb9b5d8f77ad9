//! Options that would do nothing beside the others: what was asked for and is not done is said before any work.

use autoref_raster::error::Error;
use clap::ArgMatches;
use clap::parser::ValueSource;

/// What another option must be for an option to be heeded.
enum Needs {
    /// Given.
    Given(&'static str),
    /// One of these words.
    Word(&'static str, &'static [&'static str]),
    /// None of these words; without words, not given.
    NoWord(&'static str, &'static [&'static str]),
}

/// An option, by its name as an identifier. Every command that has an option of a `Given` or `NoWord` rule has the
/// other; of a `Word` rule only those where the other has a word.
const RULES: [(&str, Needs); 12] = [
    ("reproject", Needs::Given("to_crs")),
    ("angles", Needs::Given("cameras")),
    ("blend", Needs::NoWord("choose", &["median", "feather"])),
    ("choose", Needs::NoWord("use_index", &[])),
    ("window_mm", Needs::Given("learn")),
    ("border_as", Needs::Given("border")),
    ("extent_m", Needs::NoWord("gcps", &[])),
    ("relief", Needs::NoWord("dem", &[])),
    ("keep_noise", Needs::NoWord("like_pdal", &[])),
    ("reach_px", Needs::NoWord("mask", &[])),
    ("reach_px", Needs::NoWord("polygons", &[])),
    ("reach_px", Needs::NoWord("colours", &[])),
];
/// What the options need whose names begin so.
const TOPOLOGICAL: (&str, Needs) = ("tpp_", Needs::Word("matcher", &["tpp"]));

/// Refuses an option that has no effect.
///
/// # Errors
/// [`Error::Usage`] naming it and what it needs.
pub fn refuse(matches: &ArgMatches) -> Result<(), Error> {
    for option in matches.ids().map(clap::Id::as_str).filter(|option| is_given(matches, option)) {
        let named = RULES.iter().filter(|(name, _)| *name == option).map(|(_, needs)| needs);
        let mut needs = named.chain(option.starts_with(TOPOLOGICAL.0).then_some(&TOPOLOGICAL.1));
        if let Some((what, remedy)) = needs.find_map(|needs| missing(matches, needs)) {
            let option = option.replace('_', "-");
            return Err(Error::usage(
                format!("--{option} has no effect where {what}"),
                format!("{remedy}, or leave out --{option}"),
            ));
        }
    }
    matches.subcommand().map_or(Ok(()), |(_, inner)| refuse(inner))
}

/// What is the matter, and what helps; `None` where nothing is.
fn missing(matches: &ArgMatches, needs: &Needs) -> Option<(String, String)> {
    match needs {
        Needs::Given(other) if !is_given(matches, other) => {
            let other = other.replace('_', "-");
            Some((format!("--{other} is not given"), format!("give --{other}")))
        }
        Needs::Word(other, words) if has(matches, other) && !is_word(matches, other, words) => {
            let words = words.join(" or ");
            Some((format!("--{other} is not {words}"), format!("give --{other} {words}")))
        }
        Needs::NoWord(other, []) if is_given(matches, other) => {
            let other = other.replace('_', "-");
            Some((format!("--{other} is given"), format!("leave out --{other}")))
        }
        Needs::NoWord(other, words) if is_word(matches, other, words) => {
            Some((format!("--{other} is {}", words.join(" or ")), format!("choose another --{other}")))
        }
        _ => None,
    }
}

/// Whether an option has a value, its default perhaps. Clap answers questions about names that a command lacks in debug
/// builds only.
fn has(matches: &ArgMatches, option: &str) -> bool {
    matches.ids().any(|id| id == option)
}

fn is_given(matches: &ArgMatches, option: &str) -> bool {
    has(matches, option) && matches.value_source(option) == Some(ValueSource::CommandLine)
}

fn is_word(matches: &ArgMatches, option: &str, words: &[&str]) -> bool {
    let values = has(matches, option).then(|| matches.get_raw(option)).flatten();
    values.is_some_and(|mut values| values.any(|value| words.iter().any(|word| value == *word)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::everywhere::command;

    #[test]
    fn what_has_no_effect_is_refused() {
        let said = |words: &str| {
            let words = std::iter::once("autoref-stream").chain(words.split('|'));
            let matches = command().try_get_matches_from(words).expect("parses");
            refuse(&matches).map_err(|error| error.to_string())
        };
        for (words, option) in [
            ("a.tif|--gcps|b.csv|--tpp-radius|0.1", "--tpp-radius has no effect where --matcher is not tpp"),
            ("a.tif|--gcps|b.csv|--tpp-distance|3", "--tpp-distance has no effect where --matcher is not tpp"),
            ("a.tif|--gcps|b.csv|--reproject|after", "--reproject has no effect where --to-crs is not given"),
            ("mosaic|a.tif|-o|b.tif|--choose|median|--blend|5", "--blend has no effect where --choose is median"),
            ("fiducials|a.tif|--camera|x|-o|b|--window-mm|5,5", "--window-mm has no effect where --learn is not given"),
            ("synth|a.tif|--gcps|b.csv|--extent-m|90,60", "--extent-m has no effect where --gcps is given"),
            ("synth|a.tif|--random-gcps|9|--border-as|alpha", "--border-as has no effect where --border is not given"),
            ("synth-flight|a|--dem|b.tif|--relief|50", "--relief has no effect where --dem is given"),
            ("cloud|grid|a.laz|-o|b|--keep-noise|--like-pdal", "--keep-noise has no effect where --like-pdal is given"),
            ("sample|a.tif|--polygons|b.geojson|--reach-px|9", "--reach-px has no effect where --polygons is given"),
            (
                "mosaic|a.tif|-o|b.tif|--choose|first|--use-index|c.tif",
                "--choose has no effect where --use-index is given",
            ),
        ] {
            assert!(said(words).is_err_and(|text| text.contains(option)), "{words}: {:?}", said(words));
        }
        for words in [
            "a.tif|--gcps|b.csv",
            "a.tif|--gcps|b.csv|--matcher|tpp|--tpp-radius|0.1",
            "a.tif|--gcps|b.csv|--reproject|after|--to-crs|EPSG:25833",
            "mosaic|a.tif|-o|b.tif|--blend|5",
            "mosaic|a.tif|-o|b.tif|--use-index|c.tif",
            // Another command, without --matcher.
            "patterns|c.csv|--gcps|b.csv|--tpp-radius|0.1",
        ] {
            assert_eq!(said(words), Ok(()), "{words}");
        }
    }

    #[test]
    fn commands_with_an_option_have_what_it_needs() {
        fn look(command: &clap::Command, found: &mut Vec<&'static str>) {
            let has = |option: &str| command.get_arguments().any(|arg| arg.get_id() == option);
            for (option, needs) in RULES.iter().filter(|(option, _)| has(option)) {
                let (Needs::Given(other) | Needs::Word(other, _) | Needs::NoWord(other, _)) = needs;
                assert!(has(other), "{}: {option}, {other}", command.get_name());
                found.push(option);
            }
            command.get_subcommands().for_each(|inner| look(inner, found));
        }
        let mut found = Vec::new();
        look(&command(), &mut found);
        assert!(RULES.iter().all(|(option, _)| found.contains(option)), "{found:?}");
    }
}
