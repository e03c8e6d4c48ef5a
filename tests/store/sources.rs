//! Sources of the crate, parsed with `syn`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use syn::parse::Parser;
use syn::punctuated::Punctuated;
use syn::{Attribute, Expr, Macro, Token};

/// Files by their path below a directory.
pub type Sources = BTreeMap<String, syn::File>;

/// The files below a directory of the crate, but for those that are compiled for tests alone.
pub fn sources(below: &str) -> Sources {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(below);
    let mut files = Sources::new();
    let mut waiting = vec![root.clone()];
    while let Some(directory) = waiting.pop() {
        for entry in std::fs::read_dir(directory).unwrap() {
            let path: PathBuf = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy();
            if path.is_dir() && name != "tests" {
                waiting.push(path);
            } else if name.ends_with(".rs") && !name.ends_with("tests.rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                let name = path.strip_prefix(&root).unwrap().to_string_lossy();
                let parsed = syn::parse_file(&text);
                files.insert(name.into_owned(), parsed.unwrap());
            }
        }
    }
    files
}

/// The arguments of a macro that is called like a function.
pub fn arguments_of(call: &Macro) -> Option<Punctuated<Expr, Token![,]>> {
    let parser = Punctuated::<Expr, Token![,]>::parse_terminated;
    parser.parse2(call.tokens.clone()).ok()
}

/// Whether one of the attributes is `#[cfg(test)]`.
pub fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute
                .parse_args::<syn::Ident>()
                .is_ok_and(|word| word == "test")
    })
}
