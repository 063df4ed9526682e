//! The flags of what tells about flags.

use super::Cli;
use crate::manual::Manual;
use clap::{Args, CommandFactory};
use clap_complete::Shell;
use std::path::PathBuf;

pub const COMPLETIONS_EXAMPLES: &str = "\
Examples:
  tilecast completions bash > ~/.local/share/bash-completion/completions/tilecast
  tilecast completions zsh > ~/.zfunc/_tilecast            with ~/.zfunc in $fpath
  tilecast completions fish > ~/.config/fish/completions/tilecast.fish";

pub const MAN_EXAMPLES: &str = "\
Example:
  tilecast man ~/.local/share/man/man1
  man tilecast-render";

#[derive(Args)]
pub struct CompletionsFlags {
    /// The shell
    shell: Shell,
}

#[derive(Args)]
pub struct ManFlags {
    /// Folder to write them to, made if it is not there
    folder: PathBuf,
}

impl CompletionsFlags {
    pub fn ready(self) -> Manual {
        Manual::Completions { shell: self.shell, command: Box::new(Cli::command()) }
    }
}

impl ManFlags {
    pub fn ready(self) -> Manual {
        Manual::Pages { folder: self.folder, command: Box::new(Cli::command()) }
    }
}
