//! Parse, run, exit code: 0 solved, 1 ran but not solved, 2 error.

use std::process::ExitCode;

use clap::Parser;

mod cli;

fn main() -> ExitCode {
    let cli = cli::Cli::parse_from(cli::joined(std::env::args_os()));
    cli::init_log(cli.verbose);
    match cli::dispatch(cli) {
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
