//! Which files of a room use which, and the circles among them.
//!
//! A file is a module, and uses the file that *defines* what it names, however often that is
//! re-exported on the way. A parent that declares and re-exports its children does not use them.
//! What a method call leads to is not seen, nor what a macro defines.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use super::{Import, RustPath, Source};

/// Re-exports that one name may lead through.
const DEEPEST: usize = 16;

/// All files of the crate, by module.
pub struct Rooms<'a> {
    files: BTreeMap<&'a [String], &'a Source>,
}

/// Files of a room each of which uses, directly or not, all others.
pub struct Circle {
    /// The room.
    pub room: String,
    /// Modules below the room, in the order of the alphabet; the room's own file is `mod`.
    pub files: Vec<String>,
    /// One path for each pair: from, to, line, and how it is written.
    pub uses: Vec<String>,
}

impl fmt::Display for Circle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.room, self.files.join(", "))
    }
}

type Module<'a> = &'a [String];

/// Where a path ends.
#[derive(Clone, Copy)]
enum End<'a> {
    Module,
    /// The module that defines it, and whether it is a trait.
    Item(Module<'a>, bool),
}

impl<'a> Rooms<'a> {
    /// The files that are compiled outside tests.
    pub fn new(sources: impl IntoIterator<Item = &'a Source>) -> Self {
        let by_module = |source: &'a Source| (source.module.as_slice(), source);
        Self {
            files: sources.into_iter().map(by_module).collect(),
        }
    }

    /// All circles, by room.
    pub fn circles(&self) -> Vec<Circle> {
        let uses: BTreeMap<Module<'_>, _> =
            self.files.iter().map(|(m, s)| (*m, self.uses(s))).collect();
        let reached: BTreeMap<Module<'_>, BTreeSet<Module<'_>>> =
            uses.keys().map(|m| (*m, reachable(m, &uses))).collect();
        let mut circles: Vec<Circle> = Vec::new();
        let mut seen = BTreeSet::new();
        for (module, beyond) in &reached {
            let back = |other: &&Module<'_>| reached[*other].contains(module);
            let members: Vec<Module<'_>> = beyond.iter().filter(back).copied().collect();
            if members.len() > 1 && members.iter().all(|m| seen.insert(*m)) {
                circles.push(circle(&members, &uses));
            }
        }
        circles
    }

    /// The files of the same room that a file uses, with the first path to each.
    fn uses(&self, source: &'a Source) -> BTreeMap<Module<'a>, RustPath> {
        let words = source.code.iter().map(|path| path.segments[0].as_str());
        let named: BTreeSet<&str> = words.collect();
        let is_own = |import: &Import, is_trait| {
            named.contains(import.name.as_str()) || (is_trait && !import.public)
        };
        let imports = source.imports.iter().map(|i| (&i.path, Some(i)));
        let code = source.code.iter().map(|path| (path, None));
        let mut used = BTreeMap::new();
        for (path, import) in imports.chain(code) {
            let Some(End::Item(module, is_trait)) = self.end(&source.module, &path.segments) else {
                continue;
            };
            let elsewhere = module != source.module && module[0] == source.module[0];
            if elsewhere && import.is_none_or(|import| is_own(import, is_trait)) {
                used.entry(module).or_insert_with(|| path.clone());
            }
        }
        used
    }

    /// Where a path ends that stands in a module, if within the crate.
    fn end(&self, module: &[String], path: &[String]) -> Option<End<'a>> {
        self.followed(module, path, DEEPEST)
    }

    fn followed(&self, module: &[String], path: &[String], depth: usize) -> Option<End<'a>> {
        match path.split_first() {
            Some((root, path)) if root == "crate" => self.below(&[], path, depth),
            _ => self.below(module, path, depth),
        }
    }

    /// Where a path ends that is looked up in a module: among its children, its items, and what
    /// it imports.
    fn below(&self, module: &[String], path: &[String], depth: usize) -> Option<End<'a>> {
        let Some((first, rest)) = path.split_first() else {
            return Some(End::Module);
        };
        let depth = depth.checked_sub(1)?;
        let child = [module, std::slice::from_ref(first)].concat();
        let is_child = self.files.contains_key(child.as_slice());
        if is_child && !rest.is_empty() {
            return self.below(&child, rest, depth);
        }
        if module.is_empty() {
            return is_child.then_some(End::Module);
        }
        let (module, source) = self.files.get_key_value(module)?;
        if let Some(is_trait) = source.items.get(first) {
            return Some(End::Item(module, *is_trait));
        }
        let named = source.imports.iter().filter(|i| i.name == *first);
        let named = named.map(|i| [&i.path.segments, rest].concat());
        let all = source.imports.iter().filter(|i| i.name == "*");
        let all = all.map(|i| [&i.path.segments[..i.path.segments.len() - 1], path].concat());
        // What a crate is imported as may be its own name.
        let mut elsewhere = named.chain(all).filter(|target| target != path);
        let end = elsewhere.find_map(|target| self.followed(module, &target, depth));
        end.or(is_child.then_some(End::Module))
    }
}

/// All that a module uses, and what that uses, itself among them if it is in a circle.
fn reachable<'a>(
    module: Module<'a>,
    uses: &BTreeMap<Module<'a>, BTreeMap<Module<'a>, RustPath>>,
) -> BTreeSet<Module<'a>> {
    let (mut found, mut open) = (BTreeSet::new(), vec![module]);
    while let Some(module) = open.pop() {
        for next in uses[module].keys() {
            if found.insert(*next) {
                open.push(next);
            }
        }
    }
    found
}

fn circle(
    members: &[Module<'_>],
    uses: &BTreeMap<Module<'_>, BTreeMap<Module<'_>, RustPath>>,
) -> Circle {
    let name = |module: Module<'_>| match &module[1..] {
        [] => "mod".to_owned(),
        names => names.join("/"),
    };
    let pairs = members
        .iter()
        .flat_map(|from| uses[from].iter().map(move |to| (from, to)));
    let within = pairs.filter(|(_, (to, _))| members.contains(to));
    Circle {
        room: members[0][0].clone(),
        files: members.iter().map(|module| name(module)).collect(),
        uses: within
            .map(|(from, (to, path))| {
                let RustPath { line, segments } = path;
                format!(
                    "{} -> {}: line {line}: `{}`",
                    name(from),
                    name(to),
                    segments.join("::")
                )
            })
            .collect(),
    }
}
