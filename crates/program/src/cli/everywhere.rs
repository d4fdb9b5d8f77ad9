//! `--json` and `--quiet` for every command: those that have neither of their own get them here.

use autoref_raster::atomic;
use clap::{Arg, ArgAction, ArgMatches, Command, CommandFactory};

use crate::cli::Cli;
use crate::out::{Stream, mute as mute_stream};

/// Names of the added arguments; a command's own are `json` and `quiet`.
const FILES_AS_JSON: &str = "files_as_json";
const NO_WORDS: &str = "no_words";
/// Commands whose product is a text of another kind.
const TEXT_ONLY: [&str; 3] = ["completions", "man", "help"];

/// The whole command line.
pub fn command() -> Command {
    completed(Cli::command())
}

fn completed(command: Command) -> Command {
    command.mut_subcommands(|inner| {
        if TEXT_ONLY.contains(&inner.get_name()) {
            return inner;
        }
        if inner.has_subcommands() {
            return completed(inner);
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
