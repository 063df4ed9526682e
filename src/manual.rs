//! `tilecast completions` and `tilecast man`: the command line, told to shells and to `man`. Knows no command by name.

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What to write, of which command line.
pub enum Manual {
    /// For a shell, to stdout.
    Completions {
        /// Which.
        shell: Shell,
        /// The whole of it.
        command: Box<Command>,
    },
    /// Manual pages.
    Pages {
        /// Where to.
        folder: PathBuf,
        /// The whole of it.
        command: Box<Command>,
    },
}

/// Writes it.
///
/// # Errors
/// A folder or a pipe that cannot be written to.
pub fn run(manual: Manual) -> anyhow::Result<()> {
    match manual {
        Manual::Completions { shell, mut command } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut command, "tilecast", &mut script);
            std::io::stdout().write_all(&script).context("stdout cannot be written to")
        }
        Manual::Pages { folder, mut command } => {
            std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
            command.build();
            let pages = pages(&folder, &command)?;
            println!("wrote {pages} pages to {}", folder.display());
            Ok(())
        }
    }
}

/// Writes the page of a command and those of all below it; says how many.
fn pages(folder: &Path, command: &Command) -> anyhow::Result<u32> {
    let mut pages = 1;
    for below in command.get_subcommands().filter(|below| below.get_name() != "help") {
        pages += self::pages(folder, below)?;
    }
    let man = Man::new(command.clone());
    let path = folder.join(man.get_filename());
    std::fs::write(&path, page(&man, command)?).with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(pages)
}

/// One page. Clap's own would run the lines of the examples together.
fn page(man: &Man, command: &Command) -> std::io::Result<Vec<u8>> {
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    man.render_options_section(&mut page)?;
    if command.has_subcommands() {
        man.render_subcommands_section(&mut page)?;
    }
    if let Some(examples) = command.get_after_long_help() {
        writeln!(page, ".SH EXAMPLES\n.nf")?;
        for line in examples.to_string().lines() {
            writeln!(page, "\\&{}", line.replace('\\', "\\e").replace('-', "\\-"))?;
        }
        writeln!(page, ".fi")?;
    }
    Ok(page)
}
