//! `autoref-stream undo`: takes back the tags that were written into an image.

use std::path::PathBuf;

use autoref_stream::georef::tags::{self, Undo};
use clap::Args;

/// Take back the tags that `--write tags` put into an image, byte for byte.
#[derive(Args, Debug)]
pub struct UndoArgs {
    /// The image.
    #[arg(required = true)]
    pub files: Vec<PathBuf>,
    /// Take back all that was ever written, not only the last.
    #[arg(long)]
    pub all: bool,
    /// Only say what would be done.
    #[arg(long)]
    pub dry_run: bool,
    /// Print what was done as one JSON document on standard output.
    #[arg(long)]
    pub json: bool,
    /// Print nothing but errors.
    #[arg(long)]
    pub quiet: bool,
}

pub fn run(args: &UndoArgs) -> anyhow::Result<()> {
    let how = if args.dry_run { Undo::DryRun } else { Undo::Now };
    let mut rows = Vec::new();
    for file in &args.files {
        let mut foreseen = match (args.all, how) {
            (true, Undo::DryRun) => tags::would_undo_all(file)?.into_iter(),
            _ => Vec::new().into_iter(),
        };
        loop {
            let undone = foreseen.next().map_or_else(|| tags::undo(file, how), Ok)?;
            let more = args.all && undone.more_below;
            if !args.quiet && !args.json {
                let verb = if args.dry_run { "would be" } else { "is" };
                println!(
                    "{}: {verb} {} bytes long again, as before {}",
                    file.display(),
                    undone.length_bytes,
                    undone.program
                );
            }
            rows.push(serde_json::json!({
                "file": file.display().to_string(),
                "length_bytes": undone.length_bytes,
                "program": undone.program,
                "more_below": undone.more_below,
                "dry_run": args.dry_run,
            }));
            if !more {
                break;
            }
        }
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
    }
    Ok(())
}
