//! What the option parser refuses, said as every other error: one line, and an object with `--json`.

use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

use clap::Command;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use serde_json::json;

use crate::out;

/// Prints help and versions as the parser has them, an error as one line.
pub fn tell(error: &clap::Error, arguments: &[OsString]) -> ExitCode {
    if !error.use_stderr() || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        out::keep(error.print());
        return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
    }
    let help = help(arguments);
    let said = said(error, arguments);
    let line = format!("{said}; see {help}");
    out::error_line(&format!("autoref-stream: {line}"));
    if arguments.iter().take_while(|a| *a != "--").any(|a| a == "--json") {
        let said =
            json!({"kind": "usage", "file": null, "place": null, "message": line, "remedy": format!("see {help}")});
        let first = arguments.iter().skip(1).filter_map(|word| word.to_str()).find(|word| !word.starts_with('-'));
        out::product(&super::errors::text(&json!({"error": said}), first));
    }
    ExitCode::from(2)
}

/// What is wrong and, where it can be told, what to write instead.
fn said(error: &clap::Error, arguments: &[OsString]) -> String {
    about_commands(error, arguments)
        .or_else(|| about_files(error, arguments))
        .unwrap_or_else(|| about_negatives(message(error) + &about_commas(error), arguments))
}

/// The parser's paragraphs but those of usage and help, joined.
fn message(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let mut paragraphs: Vec<String> = Vec::new();
    for paragraph in text.split("\n\n") {
        let paragraph = paragraph.trim();
        if paragraph.starts_with("Usage:") || paragraph.starts_with("For more information") {
            continue;
        }
        let lines: Vec<&str> = paragraph.lines().map(str::trim).filter(|l| !l.is_empty()).collect();
        let joined = match lines.as_slice() {
            [head, rest @ ..] if head.ends_with(':') => format!("{head} {}", rest.join(", ")),
            all => all.join(" "),
        };
        if !joined.is_empty() {
            paragraphs.push(joined);
        }
    }
    crate::printable(paragraphs.join("; ").trim_start_matches("error: "))
}

/// A command with a slip in it is taken for the image, and the image behind it for a command.
fn about_commands(error: &clap::Error, arguments: &[OsString]) -> Option<String> {
    error.get(ContextKind::InvalidSubcommand)?;
    let word = arguments.get(1)?.to_str()?;
    if Path::new(word).exists() || Path::new(word).extension().is_some() {
        return None;
    }
    // The parser of commands alone finds the one that is meant.
    let alone = Command::new("autoref-stream").subcommands(super::everywhere::command().get_subcommands().cloned());
    match alone.try_get_matches_from(arguments.iter().take(2)).err()?.get(ContextKind::SuggestedSubcommand)? {
        ContextValue::Strings(similar) => {
            let shown = crate::printable(word);
            Some(format!("`{shown}` is no command and no image; a similar command exists: {}", similar.first()?))
        }
        _ => None,
    }
}

/// A second file behind the image is taken for a subcommand: what to do with it.
fn about_files(error: &clap::Error, arguments: &[OsString]) -> Option<String> {
    if arguments.get(1).and_then(|first| first.to_str()).is_some_and(is_command) {
        return None;
    }
    const PICTURES: [&str; 10] = ["tif", "tiff", "jpg", "jpeg", "png", "jp2", "vrt", "ecw", "img", "webp"];
    let word = match error.get(ContextKind::InvalidSubcommand)? {
        ContextValue::String(word) => word,
        _ => return None,
    };
    let ending = Path::new(word).extension()?.to_str()?.to_lowercase();
    let shown = crate::printable(word);
    Some(if PICTURES.contains(&ending.as_str()) {
        format!("`{shown}` is a second image: a run takes one; start one for each")
    } else {
        format!("`{shown}` stands without its option; give the list with --gcps {shown}")
    })
}

fn is_command(word: &str) -> bool {
    super::everywhere::command().find_subcommand(word).is_some()
}

/// Numbers are written with a point. Where an option takes several, commas divide them.
fn about_commas(error: &clap::Error) -> String {
    let takes_several = |option: &str| option.split_once('<').is_some_and(|(_, value)| value.contains(','));
    if matches!(error.get(ContextKind::InvalidArg), Some(ContextValue::String(option)) if takes_several(option)) {
        return String::new();
    }
    match error.get(ContextKind::InvalidValue) {
        Some(ContextValue::String(value)) if value.contains(',') => {
            let pointed = value.trim().replace(',', ".");
            let is_number = pointed.parse::<f64>().is_ok();
            if is_number { format!("; tip: write {pointed}, with a decimal point") } else { String::new() }
        }
        _ => String::new(),
    }
}

/// A negative number behind an option is taken for an option; the parser's advice would make it an argument of its own.
fn about_negatives(message: String, arguments: &[OsString]) -> String {
    let words: Vec<&str> = arguments.iter().filter_map(|word| word.to_str()).collect();
    let pair = words.windows(2).find(|pair| {
        pair[0].starts_with("--")
            && pair[1].parse::<f64>().is_ok_and(|number| number < 0.0)
            && message.contains(pair[1])
    });
    match (pair, message.split_once("tip: to pass")) {
        (Some(pair), Some((what, _))) => {
            format!("{what}a negative number is written {}={}, where the option takes one", pair[0], pair[1])
        }
        _ => message,
    }
}

/// The help that explains the command.
fn help(arguments: &[OsString]) -> String {
    let mut words = vec!["autoref-stream".to_string()];
    let mut command = super::everywhere::command();
    for argument in arguments.iter().skip(1) {
        let Some(inner) = argument.to_str().and_then(|name| command.find_subcommand(name)).cloned() else { break };
        words.push(inner.get_name().to_string());
        command = inner;
    }
    words.push("--help".into());
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::{OsString, help, said};

    fn refused(line: &str) -> (String, String) {
        let words: Vec<OsString> = ["autoref-stream"].into_iter().chain(line.split(' ')).map(OsString::from).collect();
        let error = crate::cli::everywhere::command().try_get_matches_from(&words).expect_err("a wrong option");
        (said(&error, &words), help(&words))
    }

    #[test]
    fn every_refusal_is_one_line() {
        for (line, holds, see) in [
            ("--bogus", "unexpected argument '--bogus' found", "autoref-stream --help"),
            ("detect a.tif --tile abc", "invalid value 'abc' for '--tile <N>'", "autoref-stream detect --help"),
            ("cloud clean", "not provided: --out <OUT>, <IN>...", "autoref-stream cloud clean --help"),
            ("dem align a.tif --to b.tif -o c --stabel x", "a similar argument exists: '--stable'", "dem align --help"),
            ("gcps converd", "convert", "--help"),
            ("a.tif w.csv", "give the list with --gcps w.csv", "autoref-stream --help"),
            ("a.tif b.tif --gcps w.csv", "`b.tif` is a second image: a run takes one", "autoref-stream --help"),
            ("detct a.tif", "`detct` is no command and no image; a similar command exists: detect", "--help"),
            ("gcps f.csv", "unrecognized subcommand 'f.csv'", "autoref-stream gcps --help"),
            ("dem hillshade a.tif -o b.tif --z 1,5", "write 1.5, with a decimal point", "dem hillshade --help"),
            ("chips a.tif --at=-5,3", "lies outside the image", "chips --help"),
            ("chips a.tif --at 5,x", "is not X,Y in pixels", "chips --help"),
            ("dem hillshade a.tif -o b.tif --z -1", "is written --z=-1", "dem hillshade --help"),
        ] {
            let (said, help) = refused(line);
            assert!(said.contains(holds), "{line}: {said}");
            assert!(!line.contains("--at") || !said.contains("decimal point"), "{line}: {said}");
            assert!(!said.contains('\n') && !said.contains("Usage") && !said.contains("error:"), "{line}: {said}");
            assert!(help.ends_with(see), "{line}: {help}");
        }
    }
}
