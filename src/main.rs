//! Parse, run, exit code.

fn main() -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
