//! Options that would do nothing beside the others: what was asked for and is not done is said before any work.

use autoref_raster::error::Error;
use clap::ArgMatches;
use clap::parser::ValueSource;

/// What another option must be for an option to be heeded.
enum Needs {
    /// Given.
    Given(&'static str),
    /// One of these words.
    Word(&'static str, &'static str),
    /// None of these words.
    NoWord(&'static str, &'static [&'static str]),
}

/// An option, by its name as an identifier; a command that lacks either option has no such rule.
const RULES: [(&str, Needs); 10] = [
    ("tpp_radius", Needs::Word("matcher", "tpp")),
    ("tpp_angle", Needs::Word("matcher", "tpp")),
    ("tpp_minimum", Needs::Word("matcher", "tpp")),
    ("tpp_least", Needs::Word("matcher", "tpp")),
    ("tpp_anchor", Needs::Word("matcher", "tpp")),
    ("tpp_random", Needs::Word("matcher", "tpp")),
    ("reproject", Needs::Given("to_crs")),
    ("angles", Needs::Given("cameras")),
    ("blend", Needs::NoWord("choose", &["median", "feather"])),
    ("choose", Needs::NoWord("use_index", &[])),
];

/// Refuses an option that has no effect.
///
/// # Errors
/// [`Error::Usage`] naming it and what it needs.
pub fn refuse(matches: &ArgMatches) -> Result<(), Error> {
    for (option, needs) in &RULES {
        let (other, missing) = match needs {
            Needs::Given(other) => (other, !is_given(matches, other)),
            Needs::Word(other, word) => (other, !is_word(matches, other, &[word])),
            Needs::NoWord(other, []) => (other, is_given(matches, other)),
            Needs::NoWord(other, words) => (other, is_word(matches, other, words)),
        };
        if missing && is_given(matches, option) && matches.try_contains_id(other).is_ok() {
            let (option, other) = (option.replace('_', "-"), other.replace('_', "-"));
            let (what, remedy) = match needs {
                Needs::Given(_) => ("is not given".into(), format!("give --{other}")),
                Needs::Word(_, word) => (format!("is not {word}"), format!("give --{other} {word}")),
                Needs::NoWord(_, []) => ("is given".into(), format!("leave out --{other}")),
                Needs::NoWord(_, words) => (format!("is {}", words.join(" or ")), format!("choose another --{other}")),
            };
            return Err(Error::usage(
                format!("--{option} has no effect where --{other} {what}"),
                format!("{remedy}, or leave out --{option}"),
            ));
        }
    }
    matches.subcommand().map_or(Ok(()), |(_, inner)| refuse(inner))
}

fn is_given(matches: &ArgMatches, option: &str) -> bool {
    matches.try_contains_id(option).is_ok() && matches.value_source(option) == Some(ValueSource::CommandLine)
}

fn is_word(matches: &ArgMatches, option: &str, words: &[&str]) -> bool {
    let Ok(Some(mut values)) = matches.try_get_raw(option) else { return false };
    values.any(|value| words.iter().any(|word| value == *word))
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
            ("a.tif|--gcps|b.csv|--reproject|after", "--reproject has no effect where --to-crs is not given"),
            ("mosaic|a.tif|-o|b.tif|--choose|median|--blend|5", "--blend has no effect where --choose is median"),
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
        ] {
            assert_eq!(said(words), Ok(()), "{words}");
        }
    }

    #[test]
    fn every_rule_belongs_to_a_command() {
        fn has(command: &clap::Command, option: &str) -> bool {
            command.get_arguments().any(|arg| arg.get_id() == option)
                || command.get_subcommands().any(|inner| has(inner, option))
        }
        for (option, needs) in &RULES {
            let (Needs::Given(other) | Needs::Word(other, _) | Needs::NoWord(other, _)) = needs;
            assert!(has(&command(), option) && has(&command(), other), "{option}, {other}");
        }
    }
}
