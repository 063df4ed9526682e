//! What the fuzzer has found interesting stays harmless.

use rayon::prelude::*;
use std::path::{Path, PathBuf};
use tilecast_fuzz_harness::TARGETS;

/// Every file of every corpus goes through its target. Fails where one panics; says which.
#[test]
fn corpora_are_harmless() {
    let corpora = Path::new(env!("CARGO_MANIFEST_DIR")).join("../corpus");
    for target in TARGETS {
        let folder = corpora.join(target.name);
        let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        let files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        assert!(!files.is_empty(), "{} is empty", folder.display());
        files.par_iter().for_each(|file| {
            let bytes = std::fs::read(file).unwrap();
            let done = std::panic::catch_unwind(|| (target.run)(&bytes));
            assert!(done.is_ok(), "{} {}: it panicked", target.name, file.display());
        });
    }
}
