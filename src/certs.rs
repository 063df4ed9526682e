//! `tilecast certs init`: a private authority, and what coordinator, workers, clients and admins prove themselves with.

use anyhow::{Context, bail};
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tilecast_core::scene::Digest;
use tilecast_proto::transport::{COORDINATOR_NAME, ROLE_DOMAIN};

/// Where to.
pub struct Certs {
    /// The folder, made if it is not there.
    pub folder: PathBuf,
    /// How long they are valid.
    pub lifetime: Duration,
}

/// Clocks of machines differ: what is made now is valid on one that is behind.
const CLOCK_SKEW: Duration = Duration::from_secs(3600);

/// Makes them. What is there already is never replaced.
///
/// # Errors
/// Files that are there, or cannot be written.
pub fn run(Certs { folder, lifetime }: Certs) -> anyhow::Result<()> {
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    if folder.join("ca.pem").exists() {
        bail!("{} has an authority already; take another folder, or delete it first", folder.display());
    }
    let key = KeyPair::generate()?;
    let mut params = named("tilecast authority", Vec::new(), lifetime)?;
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    put(&folder, "ca.pem", &params.self_signed(&key)?.pem(), false)?;
    put(&folder, "ca.key", &key.serialize_pem(), true)?;
    let authority = Issuer::from_params(&params, &key);
    let mut tokens = String::new();
    for role in ["coordinator", "worker", "client", "admin"] {
        let serves = role == "coordinator";
        let name = if serves { COORDINATOR_NAME.to_owned() } else { format!("{role}.{ROLE_DOMAIN}") };
        let mut params = named(&format!("tilecast {role}"), vec![name], lifetime)?;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        let usage = if serves { ExtendedKeyUsagePurpose::ServerAuth } else { ExtendedKeyUsagePurpose::ClientAuth };
        params.extended_key_usages = vec![usage];
        let key = KeyPair::generate()?;
        put(&folder, &format!("{role}.pem"), &params.signed_by(&key, &authority)?.pem(), false)?;
        put(&folder, &format!("{role}.key"), &key.serialize_pem(), true)?;
        if !serves {
            // A private key nobody else sees is as good a secret as any.
            let token = Digest::of(&KeyPair::generate()?.serialize_der());
            put(&folder, &format!("{role}.token"), &format!("{token}\n"), true)?;
            tokens.push_str(&format!("{role} {token}\n"));
        }
    }
    put(&folder, "tokens", &tokens, true)?;
    println!("{}", ADVICE.replace("DIR", &folder.display().to_string()));
    Ok(())
}

const ADVICE: &str = "\
made an authority and certificates in DIR. Next:
  tilecast coordinator --listen 0.0.0.0:7878 --certs DIR
  a worker needs ca.pem, worker.pem and worker.key of it:  tilecast worker --connect HOST:7878 --certs DIR
  a client needs ca.pem, client.pem and client.key:        tilecast submit SCENE --connect HOST:7878 --certs DIR
ca.key makes more certificates: keep it where nobody else can read it.";

fn named(name: &str, subjects: Vec<String>, lifetime: Duration) -> anyhow::Result<CertificateParams> {
    let mut params = CertificateParams::new(subjects)?;
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    let now = rcgen::date_time_ymd(1970, 1, 1) + SystemTime::now().duration_since(UNIX_EPOCH)?;
    params.not_before = now - CLOCK_SKEW;
    params.not_after = now + lifetime;
    Ok(params)
}

/// Writes a new file; a secret one that only its owner can read.
fn put(folder: &Path, name: &str, text: &str, secret: bool) -> anyhow::Result<()> {
    let path = folder.join(name);
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    if secret {
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    }
    #[cfg(not(unix))]
    let _ = secret;
    let mut file = options.open(&path).with_context(|| format!("{}: cannot be made", path.display()))?;
    file.write_all(text.as_bytes()).with_context(|| format!("{}: cannot be written", path.display()))
}
