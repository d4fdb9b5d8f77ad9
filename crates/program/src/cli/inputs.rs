//! Which arguments name files that are read, and which name files that are written: no output is ever an input.
//!
//! Every argument that takes a path is in one of two lists (a test holds the command line to that). Before a command
//! does anything, what its inputs name is protected ([`autoref_raster::protected`]) and what its outputs name is
//! checked: against the inputs, against the files that lie beside an input and belong to it, against those that an
//! input refers to, and against each other. Inputs that only a command can name (companions by a pattern, images of a
//! project) it protects itself.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use autoref_raster::Error;
use autoref_raster::atomic::refuse_read_only;
use autoref_raster::protected::{is_input, protect, refuse_input, same_file};
use autoref_raster::referred::inside_name;
use autoref_raster::sidecars::sidecars;
use clap::ArgMatches;

/// Arguments whose value is a file or folder that the command writes.
const OUTPUTS: &[&str] =
    &["output", "out", "html", "scratch", "write_dem", "write_gcps", "write_index", "balance_page", "profile_json"];

/// No length, angle, number of pixels or limit that means anything is as large.
const LARGEST_NUMBER: f64 = 1e15;

/// Refuses numbers that are none, or larger than anything that is measured: every option that takes a number.
///
/// # Errors
/// [`Error::Usage`] naming the option.
pub fn check_numbers(matches: &ArgMatches) -> Result<(), Error> {
    for id in matches.ids() {
        let Ok(Some(mut values)) = matches.try_get_many::<f64>(id.as_str()) else { continue };
        if let Some(value) = values.find(|value| value.is_nan() || value.abs() > LARGEST_NUMBER) {
            let option = id.as_str().replace('_', "-");
            return Err(Error::usage(format!("--{option}: {value:e} is no number to work with"), "see --help"));
        }
    }
    matches.subcommand().map_or(Ok(()), |(_, inner)| check_numbers(inner))
}

/// Protects what the command reads and refuses outputs that would harm it.
///
/// # Errors
/// [`Error::Usage`] naming the output and what it collides with.
pub fn guard(matches: &ArgMatches) -> Result<(), Error> {
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    gather(matches, &mut inputs, &mut outputs);
    inputs.iter().for_each(|input| protect(input));
    if let Some(input) = inputs.iter().find(|input| input.to_str().is_none() && is_picture(input)) {
        let what = format!("{}: its name is no UTF-8, and GDAL cannot be told it", input.display());
        return Err(Error::usage(what, "rename it"));
    }
    for (number, output) in outputs.iter().enumerate() {
        writable(output)?;
        if output.is_dir() || output.as_os_str() == "-" {
            continue;
        }
        if let Some(input) = inputs.iter().find(|input| input.is_file() && same_file(output, input)) {
            return Err(is_input(output, input));
        }
        if let Some(input) = inputs.iter().find(|input| sidecars(input).iter().any(|c| same_file(output, c))) {
            let what = format!("the output {} belongs to the input {}", output.display(), input.display());
            return Err(Error::usage(what, "name another output"));
        }
        // What inputs refer to: the parts of a virtual raster.
        refuse_input(output)?;
        if outputs[..number].iter().any(|other| same_file(output, other) && other.as_os_str() != "-") {
            return Err(Error::usage(format!("two outputs are {}", output.display()), "name them apart"));
        }
    }
    Ok(())
}

/// Asks whether files can be made where an output is to lie, before anything is computed for it.
fn writable(output: &Path) -> Result<(), Error> {
    let is_special = std::fs::metadata(output).is_ok_and(|found| !found.is_file() && !found.is_dir());
    if output.as_os_str() == "-" || is_special {
        return Ok(());
    }
    let there = output.ancestors().map(|path| if path.as_os_str().is_empty() { Path::new(".") } else { path });
    // Which of the folders above are made is the command's to know.
    match there.skip(usize::from(!output.is_dir())).find(|path| path.exists()) {
        Some(folder) if folder.is_dir() => refuse_read_only(folder),
        _ => Ok(()),
    }
}

/// Values of the command and its subcommands that name something that is there, and values of outputs.
fn gather(matches: &ArgMatches, inputs: &mut Vec<PathBuf>, outputs: &mut Vec<PathBuf>) {
    for id in matches.ids() {
        let Ok(Some(values)) = matches.try_get_raw(id.as_str()) else { continue };
        for value in values {
            let named = named(value);
            if OUTPUTS.contains(&id.as_str()) {
                // A global option stands in the matches of the subcommand too.
                if id.as_str() != "profile_json" || !outputs.contains(&named) {
                    outputs.push(named);
                }
            } else if named.is_file() {
                inputs.push(named);
            } else if named.is_dir() {
                inputs.extend(read_in_folder(id.as_str(), &named));
            } else {
                inputs.extend(inside_name(&named));
            }
        }
    }
    if let Some((_, inner)) = matches.subcommand() {
        gather(inner, inputs, outputs);
    }
}

/// What a command reads of a folder that is named by an argument: rasters and clouds, but no masks, which are written
/// beside frames; of a reconstruction COLMAP's and MicMac's files.
fn read_in_folder(argument: &str, folder: &Path) -> Vec<PathBuf> {
    const CLOUDS: &[&str] = &["las", "laz", "ply", "xyz"];
    const MODELS: &[&str] = &["txt", "bin", "xml"];
    let is_model = ["reconstruction", "cameras", "camera"].contains(&argument);
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let is_read = |path: &PathBuf| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let is_kind = if is_model { ends_in(path, MODELS) } else { is_picture(path) || ends_in(path, CLOUDS) };
        path.is_file() && is_kind && !stem.ends_with("_Masq") && !stem.starts_with('.')
    };
    entries.flatten().map(|entry| entry.path()).filter(is_read).collect()
}

fn is_picture(path: &Path) -> bool {
    ends_in(path, &["tif", "tiff", "jpg", "jpeg", "png", "jp2", "vrt"])
}

fn ends_in(path: &Path, ends: &[&str]) -> bool {
    let end = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    ends.contains(&end.as_str())
}

/// The path in a value; `CLASS=…@FILE` and `FILE=FILE` name theirs at the end.
fn named(value: &OsStr) -> PathBuf {
    let whole = PathBuf::from(value);
    if whole.exists() {
        return whole;
    }
    let text = value.to_string_lossy();
    let end = text.rsplit(['@', '=']).next().unwrap_or_default();
    if Path::new(end).is_file() { PathBuf::from(end) } else { whole }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    /// Arguments whose value is a file that the command reads (or, with `files`, restores).
    const INPUTS: &[&str] = &[
        "a",
        "accuracy",
        "as_is",
        "b",
        "camera",
        "cameras",
        "candidates",
        "closing",
        "clouds",
        "colours",
        "dem",
        "fiducials",
        "files",
        "folder",
        "frame",
        "frames",
        "gcps",
        "global",
        "image",
        "input",
        "inputs",
        "mask",
        "mend",
        "model",
        "models",
        "observations",
        "opening",
        "patch",
        "photos",
        "polygons",
        "project",
        "reconstruction",
        "result",
        "samples",
        "stable",
        "table",
        "to",
        "balance_to",
        "use_index",
        "zones",
    ];

    #[test]
    fn a_number_that_is_none_is_refused_whatever_takes_it() {
        let said = |words: &str| {
            let words = std::iter::once("autoref-stream").chain(words.split('|'));
            let matches = super::super::Cli::command().try_get_matches_from(words).expect("words that are known");
            check_numbers(&matches).map_err(|e| e.to_string())
        };
        for (words, option) in [
            ("dem|profile|a.tif|--line|0,0 5,5|--step|inf|-o|b.csv", "--step"),
            ("cloud|grid|a.las|-o|b|--cell|1e308", "--cell"),
            ("flight|export|a.toml|-o|b|--pixel-mm|NaN", "--pixel-mm"),
            ("flight|resect|a.tif|--gcps|b.csv|--position|1,2,1e300", "--position"),
        ] {
            assert!(said(words).is_err_and(|text| text.contains(option)), "{words}");
        }
        assert_eq!(said("cloud|grid|a.las|-o|b|--cell|0.5"), Ok(()));
    }

    fn paths(command: &clap::Command, found: &mut Vec<String>) {
        let path = std::any::TypeId::of::<PathBuf>();
        let takes = |arg: &&clap::Arg| arg.get_value_parser().type_id() == path;
        found.extend(command.get_arguments().filter(takes).map(|arg| arg.get_id().to_string()));
        command.get_subcommands().for_each(|inner| paths(inner, found));
    }

    #[test]
    fn every_path_is_known_as_input_or_output() {
        let mut found = Vec::new();
        paths(&super::super::Cli::command(), &mut found);
        assert!(found.len() > 20, "{found:?}");
        for id in &found {
            let lists = (INPUTS.contains(&id.as_str()), OUTPUTS.contains(&id.as_str()));
            assert!(
                lists == (true, false) || lists == (false, true),
                "--{id} is in no list of cli/inputs.rs, or in both"
            );
        }
    }
}
