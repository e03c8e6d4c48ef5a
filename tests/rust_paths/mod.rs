//! The paths that a Rust source names, without a compiler.

mod tokens;

use std::path::{Path, PathBuf};

use tokens::{Token, tokens, without_tests};

/// What a source names outside its test code.
pub struct Source {
    /// In the order of the text, groups spread out: `a::{b, c}` is `a::b` and `a::c`.
    pub paths: Vec<RustPath>,
    /// Modules in files of their own that are compiled for tests alone, as paths below `src`
    /// without an extension.
    pub test_modules: Vec<PathBuf>,
}

/// A path of two segments or more, or a crate that is imported whole.
#[derive(Debug)]
pub struct RustPath {
    /// Where it stands, from 1.
    pub line: usize,
    /// `super`s that lead to the crate's root stand as `crate`.
    pub segments: Vec<String>,
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
        let has_own_directory = path.file_name().is_some_and(|name| name == "mod.rs");
        let module = match has_own_directory {
            true => path.parent().unwrap().to_owned(),
            false => path.with_extension(""),
        };
        let (tokens, test_names) = without_tests(tokens(text));
        let mut paths = Vec::new();
        for start in 0..tokens.len() {
            if begins_path(&tokens, start) {
                spread(&tokens, start, &[], &mut paths);
            }
        }
        for path in &mut paths {
            resolve_supers(path, module.components().count());
        }
        let test_modules = test_names.iter().map(|name| module.join(name)).collect();
        Self {
            paths,
            test_modules,
        }
    }
}

fn text_at(tokens: &[Token], at: usize) -> &str {
    tokens.get(at).map_or("", |token| &token.text)
}

/// Whether a path begins here: a word before `::` that nothing leads to, or one after `use`.
fn begins_path(tokens: &[Token], at: usize) -> bool {
    if !tokens[at].is_word() {
        return false;
    }
    let before = |back: usize| at.checked_sub(back).map_or("", |k| text_at(tokens, k));
    let led_to = match before(1) {
        "." => true,
        "::" => at >= 2 && (tokens[at - 2].is_word() && before(2) != "use" || before(2) == ">"),
        _ => false,
    };
    !led_to && (text_at(tokens, at + 1) == "::" || before(1) == "use")
}

/// Adds the paths that begin at a word or a group, and returns where they end.
fn spread(tokens: &[Token], at: usize, prefix: &[String], paths: &mut Vec<RustPath>) -> usize {
    if text_at(tokens, at) == "{" {
        let mut at = at + 1;
        while at < tokens.len() && text_at(tokens, at) != "}" {
            at = spread(tokens, at, prefix, paths).max(at + 1);
            while !["", ",", "}"].contains(&text_at(tokens, at)) {
                at += 1;
            }
            at += usize::from(text_at(tokens, at) == ",");
        }
        return at + 1;
    }
    let Some(token) = tokens.get(at) else {
        return at;
    };
    let mut segments = prefix.to_vec();
    segments.push(token.text.clone());
    let goes_on = |next: &Token| next.is_word() || ["{", "*"].contains(&next.text.as_str());
    if text_at(tokens, at + 1) == "::" && tokens.get(at + 2).is_some_and(goes_on) {
        return spread(tokens, at + 2, &segments, paths);
    }
    let line = token.line;
    paths.push(RustPath { line, segments });
    at + 1
}

/// Replaces `super`s that climb out of a module this deep.
fn resolve_supers(path: &mut RustPath, depth: usize) {
    let supers = path.segments.iter().take_while(|s| *s == "super").count();
    if supers > 0 && supers >= depth {
        path.segments.splice(..supers, ["crate".to_owned()]);
    }
}
