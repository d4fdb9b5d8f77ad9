//! `autoref-stream synth` alone: the sample maker without the rest of the program, for benches and scripts.
//!
//! ```text
//! cargo run --release --example synth -- sample.tif --random-gcps 12 --visible 9 --size 4000,3000
//! ```

use clap::Parser;

#[path = "../src/cli/synth.rs"]
mod synth;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    synth: synth::SynthArgs,
}

fn main() -> anyhow::Result<()> {
    synth::run(Cli::parse().synth)
}
