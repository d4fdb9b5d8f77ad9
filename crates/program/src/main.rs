//! Parse, run, exit code: 0 solved, 1 ran but not solved, 2 error.

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches};

mod cli;

fn main() -> ExitCode {
    let matches = cli::Cli::command().get_matches();
    let cli = cli::Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    cli::init_log(cli.verbose);
    match cli::inputs::guard(&matches).map_err(anyhow::Error::from).and_then(|()| cli::dispatch(cli)) {
        Ok(code) => code,
        Err(error) => {
            // One line: the chain of causes, without the debug noise.
            let mut words: Vec<String> = Vec::new();
            for cause in error.chain().map(ToString::to_string) {
                // Ours name the system's reason already.
                if !words.iter().any(|said| said.contains(&cause)) {
                    words.push(cause);
                }
            }
            eprintln!("autoref-stream: {}", words.join(": ").replace('\n', " "));
            ExitCode::from(2)
        }
    }
}
