//! What holds for every command: `--json` and `--quiet`, blanks in lists, options that no help names.

use autoref_raster::atomic;
use clap::builder::ValueParser;
use clap::{Arg, ArgAction, ArgMatches, Command, CommandFactory, value_parser};

use crate::cli::Cli;
use crate::cli::without_effect::{JOB, below, never_heeded};
use crate::out::{Stream, mute as mute_stream};

/// Names of the added arguments; a command's own are `json` and `quiet`.
const FILES_AS_JSON: &str = "files_as_json";
const NO_WORDS: &str = "no_words";
/// Commands whose product is a text of another kind.
const TEXT_ONLY: [&str; 3] = ["completions", "man", "help"];

/// The whole command line.
pub fn command() -> Command {
    completed(JOB, Cli::command().mut_args(lists_with_blanks))
}

fn completed(path: &str, command: Command) -> Command {
    command.mut_subcommands(|inner| {
        if TEXT_ONLY.contains(&inner.get_name()) {
            return inner;
        }
        let path = below(path, inner.get_name());
        let mut inner = inner.mut_args(lists_with_blanks);
        for option in never_heeded(&path) {
            inner = inner.mut_arg(option, |arg| arg.hide(true));
        }
        if inner.has_subcommands() {
            return completed(&path, inner);
        }
        let has = |name: &str| inner.get_arguments().any(|arg| arg.get_long() == Some(name));
        let mut added = Vec::new();
        if !has("json") {
            let arg = Arg::new(FILES_AS_JSON).long("json").help_heading("Output");
            added.push(arg.help("Print what was written as one JSON document on standard output"));
        }
        if !has("quiet") {
            added.push(Arg::new(NO_WORDS).long("quiet").help_heading("Messages").help("Print nothing but errors"));
        }
        inner.args(added.into_iter().map(|arg| arg.action(ArgAction::SetTrue)))
    })
}

/// `--names "A, B"` is A and B: values between commas are read without the blanks about them. Lists of words and of
/// numbers have no parser of their own; one that checks its values must take the blanks away itself.
fn lists_with_blanks(arg: Arg) -> Arg {
    let reads = arg.get_value_parser().type_id();
    if arg.get_value_delimiter().is_none() || !arg.get_possible_values().is_empty() {
        arg
    } else if reads == ValueParser::string().type_id() {
        arg.value_parser(|text: &str| Ok::<String, String>(text.trim().to_string()))
    } else if reads == ValueParser::from(value_parser!(f64)).type_id() {
        arg.value_parser(|text: &str| text.trim().parse::<f64>())
    } else {
        arg
    }
}

fn is_on(matches: &ArgMatches, id: &str) -> bool {
    matches.try_get_one::<bool>(id).ok().flatten().copied().unwrap_or(false)
}

/// Leaves out what the added arguments ask to leave out; whether the files are to be printed as JSON in the end.
pub fn mute(matches: &ArgMatches) -> bool {
    if let Some((_, inner)) = matches.subcommand() {
        return mute(inner);
    }
    let files = is_on(matches, FILES_AS_JSON);
    let quiet = is_on(matches, NO_WORDS);
    // A document of the command's own is no mere words.
    if files || (quiet && !is_on(matches, "json")) {
        mute_stream(Stream::Output);
    }
    if quiet {
        mute_stream(Stream::Errors);
    }
    files
}

/// The document of the added `--json`.
pub fn files_written() -> String {
    let files: Vec<String> = atomic::completed().iter().map(|path| path.display().to_string()).collect();
    let document = serde_json::json!({
        "program": format!("autoref-stream {}", env!("CARGO_PKG_VERSION")),
        "files_written": files,
    });
    format!("{}\n", serde_json::to_string_pretty(&document).expect("plain data"))
}

#[cfg(test)]
mod tests {
    #[test]
    fn blanks_behind_commas_are_no_part_of_a_value() {
        let matches = super::command().try_get_matches_from(["x", "a.tif", "--gcps", "b.csv", "--names", "G3, G4"]);
        let matches = matches.expect("parses");
        assert_eq!(matches.get_many::<String>("names").expect("given").collect::<Vec<_>>(), ["G3", "G4"]);
        let words = ["x", "dem", "resample", "a.tif", "-o", "b.tif", "--resolution", "10, 20"];
        let matches = super::command().try_get_matches_from(words).expect("parses");
        let (_, resample) = matches.subcommand().and_then(|(_, dem)| dem.subcommand()).expect("dem resample");
        assert_eq!(resample.get_many::<f64>("resolution").expect("given").collect::<Vec<_>>(), [&10.0, &20.0]);
    }

    #[test]
    fn help_names_no_option_that_is_never_heeded() {
        let mut command = super::command();
        let help = |name: &str, command: &mut clap::Command| {
            let inner = command.find_subcommand_mut(name).expect("a command");
            inner.render_long_help().to_string()
        };
        let text = help("compare-solvers", &mut command);
        assert!(text.contains("--tail-cut") && !text.contains("--write-dem") && !text.contains("--nssda"), "{text}");
        assert!(!help("solve", &mut command).contains("--prior"));
    }

    /// Every command but those that print a text takes both, and none twice.
    #[test]
    fn every_command_takes_json_and_quiet() {
        fn look(command: &clap::Command) {
            for inner in command.get_subcommands().filter(|c| !super::TEXT_ONLY.contains(&c.get_name())) {
                if inner.has_subcommands() {
                    look(inner);
                    continue;
                }
                for name in ["json", "quiet"] {
                    let count = inner.get_arguments().filter(|arg| arg.get_long() == Some(name)).count();
                    assert_eq!(count, 1, "{} --{name}", inner.get_name());
                }
            }
        }
        let command = super::command();
        look(&command);
        command.debug_assert();
    }
}
