//! `autoref-stream completions` and `man`: what shells and `man` want to know of the command line.

use std::io::Write;

use anyhow::{Context, bail};
use clap::Args;

use crate::cli::everywhere;

/// Print the completion script of a shell: bash, zsh, fish, elvish or powershell.
#[derive(Args, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    pub shell: clap_complete::Shell,
}

pub fn completions(args: &CompletionsArgs) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut everywhere::command(), "autoref-stream", &mut script);
    crate::out::keep(std::io::stdout().write_all(&script));
    Ok(())
}

/// Print the manual page (troff) of the program or of one command.
#[derive(Args, Debug)]
pub struct ManArgs {
    /// A command, with its own command where it has some (`dem align`); without it the page of the main job.
    pub command: Vec<String>,
}

pub fn man(args: &ManArgs) -> anyhow::Result<()> {
    let mut program = everywhere::command();
    program.build();
    let (mut page, mut title) = (&program, "autoref-stream".to_string());
    for name in &args.command {
        let Some(command) = page.find_subcommand(name) else {
            let names: Vec<&str> = page.get_subcommands().map(clap::Command::get_name).collect();
            let there = if names.is_empty() { "none".to_string() } else { names.join(", ") };
            bail!("there is no command `{name}` of {title}; there are {there}");
        };
        title = format!("{title}-{}", command.get_name());
        page = command;
    }
    let mut text = Vec::new();
    clap_mangen::Man::new(page.clone()).title(title).render(&mut text).context("cannot make the page")?;
    crate::out::keep(std::io::stdout().write_all(&text));
    Ok(())
}
