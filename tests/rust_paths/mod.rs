//! The paths that a Rust source names, read with `syn`.

mod figures;
mod reader;
mod rooms;
mod tokens;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use figures::Figures;
pub use rooms::{Circle, Rooms};

/// What a source names and defines outside its test code.
pub struct Source {
    /// The module that the file is, below the crate's root.
    pub module: Vec<String>,
    /// What `use` brings in, groups spread out: `a::{b, c}` is `a::b` and `a::c`.
    imports: Vec<Import>,
    /// What is named elsewhere, single words too.
    code: Vec<RustPath>,
    /// Functions, types, constants and macros by name; whether each is a trait.
    items: BTreeMap<String, bool>,
    /// Modules in files of their own that are compiled for tests alone, as paths below `src`
    /// without an extension.
    pub test_modules: Vec<PathBuf>,
}

/// A path as it is written but for its beginning.
#[derive(Debug, Clone)]
pub struct RustPath {
    /// Where it stands, from 1.
    pub line: usize,
    /// `self` and `super`s are resolved: such a path begins with `crate`.
    pub segments: Vec<String>,
}

/// One name that a `use` brings in.
struct Import {
    /// `*` for all that a module has.
    name: String,
    path: RustPath,
    /// Whether others may take it from here.
    public: bool,
}

impl RustPath {
    /// Whether it is `name` or something within it.
    pub fn names(&self, name: &str) -> bool {
        let mut segments = self.segments.iter();
        name.split("::")
            .all(|part| segments.next().is_some_and(|segment| segment == part))
    }
}

impl Source {
    /// Reads a file at a path below `src`.
    pub fn parse(path: &Path, text: &str) -> Self {
        let file = syn::parse_file(text)
            .unwrap_or_else(|e| panic!("{}, {:?}: {e}", path.display(), e.span().start()));
        reader::read(module_of_file(path), &file)
    }

    /// All imports, and the paths of two segments or more in code.
    pub fn paths(&self) -> impl Iterator<Item = &RustPath> {
        let imported = self.imports.iter().map(|import| &import.path);
        imported.chain(self.code.iter().filter(|path| path.segments.len() > 1))
    }
}

/// The module that a file below `src` is, from its room on.
fn module_of_file(path: &Path) -> Vec<String> {
    let module = match path.file_name().is_some_and(|name| name == "mod.rs") {
        true => path.parent().unwrap().to_owned(),
        false => path.with_extension(""),
    };
    let names = module.components();
    names
        .map(|name| name.as_os_str().to_string_lossy().into_owned())
        .collect()
}
