//! A bare OBJ file.
use super::error::{LoadError, Result};
use super::{LoadOptions, Loaded};
use std::path::Path;
pub(crate) fn load(_path: &Path, _options: &LoadOptions) -> Result<Loaded> {
    Err(LoadError::new("not yet"))
}
