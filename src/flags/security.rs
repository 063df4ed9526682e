//! Certificates and tokens: from files to what proves who one is.

use super::Usage;
use anyhow::Context;
use clap::Args;
use std::path::{Path, PathBuf};
use tilecast_coordinator::access::{Role, Security};
use tilecast_core::scene::Digest;
use tilecast_proto::transport::{Connector, Credentials};

/// A coordinator and how to reach it.
#[derive(Args)]
pub struct ConnectFlags {
    /// Where the coordinator listens: HOST:PORT
    #[arg(long, value_name = "ADDR")]
    connect: String,
    /// Folder of certificates, as `tilecast certs init` makes it; of the keys, one's own is enough
    #[arg(long, value_name = "DIR")]
    certs: Option<PathBuf>,
    /// Shows the token in this file instead of a certificate; of the certificates, ca.pem is enough
    #[arg(long, value_name = "FILE", requires = "certs")]
    token_file: Option<PathBuf>,
}

impl ConnectFlags {
    /// A coordinator, with the certificates in a folder.
    pub fn to(connect: String, certs: Option<PathBuf>) -> Self {
        Self { connect, certs, token_file: None }
    }

    /// The same flags for a worker that sees the same files; of a token, that is an admin's.
    pub fn words(&self) -> anyhow::Result<Vec<String>> {
        let mut words = vec!["--connect".to_owned(), self.connect.clone()];
        for (flag, path) in [("--certs", &self.certs), ("--token-file", &self.token_file)] {
            if let Some(path) = path {
                let absolute = std::path::absolute(path).with_context(|| format!("{} has no place", path.display()))?;
                words.extend([flag.to_owned(), absolute.display().to_string()]);
            }
        }
        Ok(words)
    }

    /// The way to the coordinator, for whoever has one of these roles.
    pub fn ready(self, roles: &[Role]) -> anyhow::Result<Connector> {
        let unreadable = |e| Usage(format!("--connect: {e}"));
        let Some(folder) = self.certs else { return Ok(Connector::tcp(&self.connect).map_err(unreadable)?) };
        let token = self.token_file.map(|path| read(&path)).transpose()?;
        let token = token.map(|bytes| String::from_utf8_lossy(&bytes).trim().to_owned());
        let identity = if token.is_some() { None } else { Some(identity(&folder, roles)?) };
        let credentials = Credentials { authority: certificate(&folder, "ca.pem")?, identity, token };
        Ok(Connector::secure(&self.connect, &credentials).map_err(unreadable)?)
    }
}

/// How a coordinator proves itself, and whom it lets in.
#[derive(Args)]
pub struct GuardFlags {
    /// Folder of certificates, as `tilecast certs init` makes it: TLS, and only peers with a certificate are let in
    #[arg(long, value_name = "DIR")]
    certs: Option<PathBuf>,
    /// Lets peers in that show a token of this file, too; its lines are ROLE TOKEN
    #[arg(long, value_name = "FILE", requires = "certs")]
    token_file: Option<PathBuf>,
}

impl GuardFlags {
    /// What was asked for.
    pub fn ready(self) -> anyhow::Result<Option<Security>> {
        let Some(folder) = self.certs else { return Ok(None) };
        let tokens = self.token_file.map(|path| tokens(&path)).transpose()?.unwrap_or_default();
        Ok(Some(Security {
            certificate: certificate(&folder, "coordinator.pem")?,
            key: certificate(&folder, "coordinator.key")?,
            authority: certificate(&folder, "ca.pem")?,
            tokens,
        }))
    }
}

fn tokens(path: &Path) -> anyhow::Result<Vec<(Role, Digest)>> {
    let text = String::from_utf8_lossy(&read(path)?).into_owned();
    let mut tokens = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let at = format!("--token-file {}, line {}", path.display(), i + 1);
        let (role, token) = line.trim().split_once(' ').ok_or_else(|| Usage(format!("{at}: write ROLE TOKEN")))?;
        let role: Role = role.parse().map_err(|e| Usage(format!("{at}: {e}")))?;
        tokens.push((role, Digest::of(token.trim().as_bytes())));
    }
    Ok(tokens)
}

/// Certificate and key of the first role that the folder has both of.
fn identity(folder: &Path, roles: &[Role]) -> anyhow::Result<(Vec<u8>, Vec<u8>)> {
    let files = |role: &Role| [".pem", ".key"].map(|end| format!("{}{end}", role.name()));
    let there = roles.iter().map(files).find(|files| files.iter().all(|file| folder.join(file).exists()));
    let names: Vec<&str> = roles.iter().map(|role| role.name()).collect();
    let [pem, key] =
        there.ok_or_else(|| missing(folder, &format!("no certificate and key of a {}", names.join(" or an "))))?;
    Ok((certificate(folder, &pem)?, certificate(folder, &key)?))
}

/// A file of the folder of certificates.
fn certificate(folder: &Path, name: &str) -> anyhow::Result<Vec<u8>> {
    let path = folder.join(name);
    if path.exists() { read(&path) } else { Err(missing(folder, &format!("no {name}")).into()) }
}

/// How to come by what the folder of certificates lacks.
fn missing(folder: &Path, what: &str) -> Usage {
    let folder = folder.display();
    Usage(format!(
        "--certs {folder}: {what} there; on the coordinator's machine `tilecast certs init {folder}` makes all of a cluster's, once, \
         and other machines get copies of ca.pem and of their role's .pem and .key"
    ))
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("{} cannot be read", path.display()))
}
