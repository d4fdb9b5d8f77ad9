//! Options that would do nothing beside the others: what was asked for and is not done is said before any work.

use autoref_raster::error::Error;
use clap::ArgMatches;
use clap::parser::ValueSource;

/// What another option must be for an option to be heeded.
enum Needs {
    /// Given.
    Given(&'static str),
    /// One of them given.
    GivenOneOf(&'static [&'static str]),
    /// The first given, or the second one of these words.
    GivenOrWord(&'static str, &'static str, &'static [&'static str]),
    /// One of these words.
    Word(&'static str, &'static [&'static str]),
    /// None of these words; without words, not given.
    NoWord(&'static str, &'static [&'static str]),
    /// What never is, and why.
    Never(&'static str),
}
use Needs::{Given, GivenOneOf, GivenOrWord, Never, NoWord, Word};

/// Every command that has both options; the main job.
const ANY: &str = "";
pub const JOB: &str = "autoref-stream";

/// A command by its names, an option by its identifier, and what it needs. A rule holds for commands that have
/// the other option: clap does not heed `requires` where what is required is excluded by an option that is given.
const RULES: [(&str, &str, Needs); 53] = [
    (ANY, "reproject", Given("to_crs")),
    (ANY, "angles", Given("cameras")),
    (ANY, "blend", NoWord("choose", &["median", "feather"])),
    (ANY, "choose", NoWord("use_index", &[])),
    (ANY, "border_as", Given("border")),
    (ANY, "extent_m", NoWord("gcps", &[])),
    (ANY, "relief", NoWord("dem", &[])),
    (ANY, "keep_noise", NoWord("like_pdal", &[])),
    (ANY, "tpp_seed", Given("tpp_random")),
    (JOB, "datum_accuracy", GivenOrWord("to_crs", "write", &["exif"])),
    ("apply", "datum_accuracy", Given("write")),
    ("apply", "datum_accuracy", Word("write", &["exif"])),
    ("solve", "datum_accuracy", Given("to_crs")),
    ("solve", "prior", Never("no image is read")),
    ("compare-solvers", "datum_accuracy", Given("to_crs")),
    ("compare-solvers", "model", Never("all are compared")),
    ("compare-solvers", "solver", Never("all are compared")),
    ("compare-solvers", "write_dem", Never("nothing is written")),
    ("compare-solvers", "nssda", Never("nothing is stated of check points")),
    ("compare-solvers", "accuracy_class", Never("nothing is stated of accuracies")),
    ("sample", "reach_px", NoWord("mask", &[])),
    ("sample", "reach_px", NoWord("polygons", &[])),
    ("sample", "reach_px", NoWord("colours", &[])),
    ("sample", "mark_size", Given("colours")),
    ("sample", "crs", Given("gcps")),
    ("sample", "names", Given("gcps")),
    ("sample", "gcp_layer", Given("gcps")),
    ("sample", "white", NoWord("colours", &[])),
    ("sample", "page", NoWord("colours", &[])),
    ("apply", "same_extent", Given("to")),
    ("fiducials", "window_mm", Given("learn")),
    ("fiducials", "window_mm", NoWord("page", &[])),
    ("fiducials", "model", NoWord("page", &[])),
    ("fiducials", "agreement_um", NoWord("page", &[])),
    ("fiducials", "box_share", NoWord("page", &[])),
    ("fiducials", "finder", NoWord("page", &[])),
    ("fiducials", "exports", NoWord("learn", &[])),
    ("fiducials", "resample", NoWord("learn", &[])),
    ("fiducials", "patch", NoWord("learn", &[])),
    ("fiducials", "pixels_from", NoWord("learn", &[])),
    ("fiducials", "threads", NoWord("learn", &[])),
    ("fiducials", "overwrite", Given("resample")),
    ("synth", "tiles", NoWord("strips", &[])),
    ("synth", "quality", Word("compress", &["jpeg"])),
    ("synth", "predictor", Word("compress", &["deflate", "lzw", "zstd"])),
    ("synth", "second_paint", Word("shape", &["checker", "cross-plate", "hourglass"])),
    ("synth", "turn", NoWord("shape", &["disc"])),
    ("synth", "epsg", GivenOneOf(&["write_gcps", "georeferenced"])),
    ("synth-flight", "film_um", Given("film")),
    ("synth-flight", "grey", NoWord("film", &[])),
    ("flight adjust", "sigma_image", Given("gcps")),
    ("flight init", "sigma_image", Given("gcps")),
    ("flight init", "sigma_ground", Given("gcps")),
];
/// What the options need whose names begin so.
const TOPOLOGICAL: (&str, Needs) = ("tpp_", Word("matcher", &["tpp"]));

/// A command that in some case heeds few of its options.
struct Case {
    command: &'static str,
    is: fn(&ArgMatches) -> bool,
    what: &'static str,
    heeded: &'static [&'static str],
}

/// What every command heeds.
const GENERAL: [&str; 4] = ["json", "quiet", "verbose", "profile_json"];
const CASES: [Case; 3] = [
    Case {
        command: "compare-solvers",
        is: names_points,
        what: "a result or a table is compared, which has its matched points already",
        heeded: &["image", "tail_cut"],
    },
    Case {
        command: "solve",
        is: |matches| is_given(matches, "patch"),
        what: "--patch is given: a replay matches nothing and has its points already",
        // Of the last five it says itself what to do.
        heeded: &[
            "candidates",
            "patch",
            "output",
            "overwrite",
            "accuracy_class",
            "nssda",
            "force",
            "gcps",
            "model",
            "solver",
            "dem",
            "write_dem",
            "dem_area",
        ],
    },
    Case {
        command: "fiducials",
        is: |matches| is_given(matches, "list_cameras"),
        what: "--list-cameras is given",
        heeded: &["list_cameras"],
    },
];

/// Whether the input is a table of points, or a result.
fn names_points(matches: &ArgMatches) -> bool {
    let image = matches.get_raw("image").and_then(|mut values| values.next());
    let extension = image.and_then(|image| std::path::Path::new(image).extension());
    extension.is_some_and(|end| end.eq_ignore_ascii_case("json") || end.eq_ignore_ascii_case("csv"))
}

/// Options that a command takes with others of their kind and never heeds.
pub fn never_heeded(command: &str) -> impl Iterator<Item = &'static str> {
    let of = RULES.iter().filter(move |(of, _, needs)| *of == command && matches!(needs, Never(_)));
    of.map(|(_, option, _)| *option)
}

/// Refuses an option that has no effect.
///
/// # Errors
/// [`Error::Usage`] naming it and what it needs.
pub fn refuse(matches: &ArgMatches) -> Result<(), Error> {
    refuse_of(JOB, matches)
}

fn refuse_of(command: &str, matches: &ArgMatches) -> Result<(), Error> {
    let given = || matches.ids().map(clap::Id::as_str).filter(|option| is_given(matches, option));
    for option in given() {
        let named = RULES.iter().filter(|(of, name, _)| *name == option && (*of == ANY || *of == command));
        let mut needs =
            named.map(|(_, _, needs)| needs).chain(option.starts_with(TOPOLOGICAL.0).then_some(&TOPOLOGICAL.1));
        if let Some((why, remedy)) = needs.find_map(|needs| missing(matches, needs)) {
            let option = option.replace('_', "-");
            let remedy = remedy.map_or(String::new(), |remedy| format!("{remedy}, or "));
            return Err(Error::usage(
                format!("--{option} has no effect{why}"),
                format!("{remedy}leave out --{option}"),
            ));
        }
    }
    for case in CASES.iter().filter(|case| case.command == command && (case.is)(matches)) {
        let is_heeded = |option: &str| case.heeded.contains(&option) || GENERAL.contains(&option);
        // Groups of options have identifiers too, with capitals.
        let is_option = |option: &str| !option.contains(char::is_uppercase);
        if let Some(option) = given().find(|option| is_option(option) && !is_heeded(option)) {
            let option = option.replace('_', "-");
            return Err(Error::usage(
                format!("--{option} has no effect where {}", case.what),
                format!("leave out --{option}"),
            ));
        }
    }
    matches.subcommand().map_or(Ok(()), |(name, inner)| refuse_of(&below(command, name), inner))
}

/// A command of a command by both names: `flight init`.
pub fn below(command: &str, name: &str) -> String {
    if command == JOB { name.to_string() } else { format!("{command} {name}") }
}

/// What is the matter, and what helps beside leaving the option out; `None` where nothing is.
fn missing(matches: &ArgMatches, needs: &Needs) -> Option<(String, Option<String>)> {
    let flag = |option: &str| format!("--{}", option.replace('_', "-"));
    match needs {
        Given(other) if !is_given(matches, other) => {
            Some((format!(" where {} is not given", flag(other)), Some(format!("give {}", flag(other)))))
        }
        GivenOneOf(others) if !others.iter().any(|other| is_given(matches, other)) => {
            let others: Vec<String> = others.iter().map(|other| flag(other)).collect();
            let what = format!(" where none of {} is given", others.join(", "));
            Some((what, Some(format!("give {}", others.join(" or ")))))
        }
        GivenOrWord(first, other, words) if !is_given(matches, first) && !is_word(matches, other, words) => {
            let (first, other, words) = (flag(first), flag(other), words.join(" or "));
            let what = format!(" where {first} is not given and {other} has no {words}");
            Some((what, Some(format!("give {first}, or {other} {words}"))))
        }
        Word(other, words) if has(matches, other) && !is_word(matches, other, words) => {
            let words = words.join(" or ");
            Some((format!(" where {} is not {words}", flag(other)), Some(format!("give {} {words}", flag(other)))))
        }
        NoWord(other, []) if is_given(matches, other) => {
            Some((format!(" where {} is given", flag(other)), Some(format!("leave out {}", flag(other)))))
        }
        NoWord(other, words) if is_word(matches, other, words) => Some((
            format!(" where {} is {}", flag(other), words.join(" or ")),
            Some(format!("choose another {}", flag(other))),
        )),
        Never(why) => Some((format!(": {why}"), None)),
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
            ("sample|a.tif|--at|9,9|--mark-size|9", "--mark-size has no effect where --colours is not given"),
            ("sample|a.tif|--mask|b.tif|--crs|EPSG:25832", "--crs has no effect where --gcps is not given"),
            ("apply|a.json|a.tif|--same-extent", "--same-extent has no effect where --to is not given"),
            ("a.tif|--gcps|b.csv|--datum-accuracy|9", "--datum-accuracy has no effect where --to-crs is not given"),
            ("apply|a.json|--write|aux|--datum-accuracy|9", "--datum-accuracy has no effect where --write is not exif"),
            ("solve|a.csv|--gcps|b.csv|--prior|none", "--prior has no effect: no image is read"),
            ("solve|a.json|--patch|b.json|--check|A", "--check has no effect where --patch is given: a replay"),
            ("compare-solvers|a.json|--gcps|b.csv", "--gcps has no effect where a result or a table is compared"),
            ("compare-solvers|a.tif|--gcps|b.csv|--model|affine", "--model has no effect: all are compared"),
            ("fiducials|a.tif|--camera|x|--learn|--exports", "--exports has no effect where --learn is given"),
            ("fiducials|a.tif|--camera|x|--overwrite", "--overwrite has no effect where --resample is not given"),
            ("fiducials|--list-cameras|--camera|x", "--camera has no effect where --list-cameras is given"),
            ("synth|a.tif|--random-gcps|9|--tiles|64|--strips|9", "--tiles has no effect where --strips is given"),
            ("synth|a.tif|--random-gcps|9|--quality|80", "--quality has no effect where --compress is not jpeg"),
            (
                "synth|a.tif|--random-gcps|9|--epsg|25832",
                "--epsg has no effect where none of --write-gcps, --georeferenced is given",
            ),
            ("synth-flight|a|--size|90,90|--film-um|20", "--film-um has no effect where --film is not given"),
            ("flight|init|a|-o|b|--sigma-ground|0.1", "--sigma-ground has no effect where --gcps is not given"),
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
            "a.jpg|--gcps|b.csv|--write|aux,exif|--datum-accuracy|9",
            "apply|a.json|--write|exif|--datum-accuracy|9",
            "a.tif|--gcps|b.csv|--reproject|after|--to-crs|EPSG:25833",
            "mosaic|a.tif|-o|b.tif|--blend|5",
            "mosaic|a.tif|-o|b.tif|--use-index|c.tif",
            "compare-solvers|a.json|--json|--tail-cut|0.1",
            "compare-solvers|a.tif|--gcps|b.csv|--refine|never",
            "solve|a.json|--patch|b.json|-o|c.json|--overwrite|--quiet",
            "fiducials|--list-cameras|--quiet",
            "sample|--colours|a.csv|--mark-size|9",
            "synth|a.tif|--random-gcps|9|--epsg|25832|--georeferenced",
            // Another command, without --matcher.
            "patterns|c.csv|--gcps|b.csv|--tpp-radius|0.1",
        ] {
            assert_eq!(said(words), Ok(()), "{words}");
        }
    }

    #[test]
    fn commands_with_an_option_have_what_it_needs() {
        fn look(path: &str, command: &clap::Command, found: &mut Vec<&'static str>, cases: &mut Vec<&'static str>) {
            let has = |option: &str| command.get_arguments().any(|arg| arg.get_id() == option);
            for rule in RULES.iter().filter(|(of, option, _)| (*of == ANY || *of == path) && has(option)) {
                match &rule.2 {
                    Given(other) | Word(other, _) | NoWord(other, _) if has(other) => found.push(rule.1),
                    GivenOrWord(first, other, _) if has(first) && has(other) => found.push(rule.1),
                    GivenOneOf(others) if others.iter().all(|other| has(other)) => found.push(rule.1),
                    Never(_) => found.push(rule.1),
                    // A word that a command lacks is heeded by no rule; what must be given must be there.
                    Given(_) => panic!("{path}: {}", rule.1),
                    _ => assert_eq!(rule.0, ANY, "{path}: {}", rule.1),
                }
            }
            for case in CASES.iter().filter(|case| case.command == path) {
                assert!(case.heeded.iter().all(|option| has(option)), "{}", case.command);
                cases.push(case.what);
            }
            command.get_subcommands().for_each(|inner| look(&below(path, inner.get_name()), inner, found, cases));
        }
        let (mut found, mut cases) = (Vec::new(), Vec::new());
        look(JOB, &command(), &mut found, &mut cases);
        assert!(RULES.iter().all(|(_, option, _)| found.contains(option)), "{found:?}");
        assert_eq!(cases.len(), CASES.len(), "{cases:?}");
    }
}
