//! Parse, run, exit code.

mod cli;

use clap::Parser;

#[derive(Parser)]
enum Command {
    Sample(cli::sample::Args),
    Chips(cli::chips::Args),
    Distance(cli::distance::Args),
}

fn main() -> anyhow::Result<()> {
    match Command::parse() {
        Command::Sample(args) => cli::sample::run(&args),
        Command::Chips(args) => cli::chips::run(&args),
        Command::Distance(args) => cli::distance::run(&args),
    }
}
