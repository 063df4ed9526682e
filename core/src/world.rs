//! A scene compiled for tracing.

use crate::scene::Scene;
use std::sync::Arc;

/// A scene with all that tracing needs beside it.
pub struct World {
    /// What it was compiled from.
    pub scene: Arc<Scene>,
}

impl World {
    /// Compiles a scene that [`Scene::validate`] has passed, on the current rayon pool.
    pub fn compile(scene: Arc<Scene>) -> Self {
        Self { scene }
    }
}
