//! Parse, run, exit code: 0 solved, 1 ran but not solved, 2 error.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{ArgMatches, FromArgMatches};

#[macro_use]
mod out;
mod cli;
mod signals;

fn main() -> ExitCode {
    signals::heed();
    autoref_raster::hear_gdal();
    let arguments = cli::joined(std::env::args_os());
    let (matches, cli) = match parsed(&arguments) {
        Ok(both) => both,
        Err(error) => return ended(cli::option_errors::tell(&error, &arguments)),
    };
    let files_as_json = cli::everywhere::mute(&matches);
    let times = cli::init_log(&cli);
    let profile_json = cli.profile_json.clone();
    let result = cli::inputs::check_numbers(&matches)
        .and_then(|()| cli::without_effect::refuse(&matches))
        .and_then(|()| cli::inputs::guard(&matches))
        .map_err(anyhow::Error::from)
        .and_then(|()| profile_json.iter().try_for_each(|path| cli::stage_times::check(path)))
        .and_then(|()| {
            let code = tracing::info_span!("command").in_scope(|| cli::dispatch(cli))?;
            if let (Some(times), Some(path)) = (&times, &profile_json) {
                times.write(path)?;
            }
            if files_as_json {
                out::product(&cli::everywhere::files_written());
            }
            Ok(code)
        });
    for line in times.iter().flat_map(cli::stage_times::StageTimes::lines) {
        tracing::info!("{line}");
    }
    let code = result.unwrap_or_else(|error| {
        let line = one_line(&error);
        out::error_line(&format!("autoref-stream: {line}"));
        if files_as_json || asks_for_json(&matches) {
            let document = cli::errors::document(&error, &line);
            out::product(&cli::errors::text(&document, matches.subcommand_name()));
        }
        ExitCode::from(2)
    });
    ended(code)
}

/// The exit code, unless standard output could not be written.
fn ended(code: ExitCode) -> ExitCode {
    match out::fault() {
        None => code,
        Some(fault) => {
            out::error_line(&format!("autoref-stream: standard output: cannot write: {fault}"));
            ExitCode::from(2)
        }
    }
}

fn parsed(arguments: &[OsString]) -> clap::error::Result<(ArgMatches, cli::Cli)> {
    let matches = cli::everywhere::command().try_get_matches_from(arguments)?;
    let cli = cli::Cli::from_arg_matches(&matches)?;
    Ok((matches, cli))
}

/// The chain of causes in one line, without the debug noise and without control characters.
fn one_line(error: &anyhow::Error) -> String {
    let mut words: Vec<String> = Vec::new();
    for cause in error.chain().map(ToString::to_string) {
        // Ours name the system's reason already.
        if !words.iter().any(|said| said.contains(&cause)) {
            words.push(cause);
        }
    }
    printable(&words.join(": ").replace(['\n', '\t'], " "))
}

/// A word of more letters, a cell of a broken list perhaps, is cut; a path may have as many as the system takes.
const LONGEST_WORD: usize = 200;

/// Without control characters, and without words that fill a screen.
fn printable(line: &str) -> String {
    let cut = |word: &str| {
        let letters = word.chars().count();
        if letters <= LONGEST_WORD || word.contains('/') {
            return word.to_string();
        }
        let head: String = word.chars().take(LONGEST_WORD - 20).collect();
        let tail: String = word.chars().skip(letters - 10).collect();
        format!("{head}…{tail}")
    };
    let line: Vec<String> = line.split(' ').map(cut).collect();
    line.join(" ").chars().map(|c| if c.is_control() || out::is_obeyed(c) { '\u{fffd}' } else { c }).collect()
}

/// Whether the command that was given has `--json` on.
fn asks_for_json(matches: &ArgMatches) -> bool {
    let here = matches.try_get_one::<bool>("json").ok().flatten().copied().unwrap_or(false);
    here || matches.subcommand().is_some_and(|(_, inner)| asks_for_json(inner))
}
