//! What tilecast does with bytes that nobody vouches for: one function for each kind of file and for the wire.
//!
//! Each takes any bytes and returns, having reported errors or not; a panic, a hang or memory without bound is a bug. The fuzzer
//! calls them with bytes that it makes up (`fuzz_targets/`), the test of this crate with those of the corpora that it found.

mod files;
mod state;
mod wire;

/// One kind of bytes.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Of the fuzzer's target and its corpus.
    pub name: &'static str,
    /// What is done with the bytes.
    pub run: fn(&[u8]),
}

/// All kinds.
pub const TARGETS: [Target; 8] = [
    Target { name: "xml", run: files::xml },
    Target { name: "obj", run: files::obj },
    Target { name: "ply", run: files::ply },
    Target { name: "serialized", run: files::serialized },
    Target { name: "texture", run: files::texture },
    Target { name: "wire", run: wire::message },
    Target { name: "film", run: state::film },
    Target { name: "journal", run: state::journal },
];

/// Makes this thread the only one that computes: handing an input to another costs more than most inputs do.
///
/// # Panics
/// If something was computed before.
pub fn compute_alone() {
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().expect("the first to ask");
}

/// Does what the target of this name does.
///
/// # Panics
/// On a name that is none's, or on a bug.
pub fn run(name: &str, bytes: &[u8]) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target of this name");
    (target.run)(bytes);
}
