//! One crate has no Cargo.toml to keep its layers apart: this test reads the paths in `src`.
//!
//! The order is that of the list in `src/lib.rs`. Within a room, as the modules of that list are
//! called here, files do not use each other in circles. Code under `#[cfg(test)]` may name anything.

// Clippy lets tests unwrap and panic, and not yet what they call.
#![allow(clippy::unwrap_used, clippy::panic)]

mod rust_paths;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rust_paths::{Circle, Figures, Rooms, RustPath, Source};

/// A module uses only itself and modules before it.
const LAYERS: [&str; 25] = [
    "ids",
    "model",
    "geometry",
    "scan",
    "matching",
    "calibration",
    "observation",
    "graph",
    "solver",
    "change",
    "mapping",
    "sim",
    "ingest",
    "render",
    "experiments",
    "store",
    "pipeline",
    "http_client",
    "webhooks",
    "api",
    "config",
    "telemetry",
    "app",
    "client",
    "cli",
];

/// Number of pure modules, the first of [`LAYERS`].
const CORE: usize = 12;

/// What a core module must not name: runtimes, the world outside, clocks, chance without a seed.
const NOT_IN_CORE: [&str; 18] = [
    "axum",
    "getrandom",
    "hyper",
    "jiff",
    "metrics",
    "rand::random",
    "rand::rng",
    "reqwest",
    "sqlx",
    "std::env",
    "std::fs",
    "std::net",
    "std::process",
    "std::thread",
    "std::time::Instant",
    "std::time::SystemTime",
    "tokio",
    "tracing",
];

/// What a module must not know although it stands before it in the list: the HTTP interface reads
/// what workers have stored and hands decisions to the pipeline; changes are found in numbers,
/// observations and findings.
const NOT_IN: [(&str, &[&str]); 2] = [
    (
        "api",
        &["crate::mapping", "crate::matching", "crate::solver"],
    ),
    (
        "change",
        &["crate::graph", "crate::matching", "crate::solver"],
    ),
];

/// What has one home, or a few.
const AT_HOME: [(&str, &[&str]); 13] = [
    ("axum", &["api", "app"]),
    ("clap", &["config", "cli"]),
    ("crate::sim", &["sim", "experiments", "cli"]),
    ("faer", &["solver"]),
    ("hyper", &["app"]),
    ("reqwest", &["http_client", "webhooks", "client"]),
    ("rustls", &["http_client"]),
    ("sqlx", &["store"]),
    ("statrs", &["change"]),
    ("std::env", &["config"]),
    ("utoipa", &["api"]),
    ("utoipa_axum", &["api"]),
    ("utoipa_swagger_ui", &["api"]),
];

/// What is wrong with the paths of a file of a module.
fn violations<'a>(module: &str, paths: impl Iterator<Item = &'a RustPath>) -> Vec<String> {
    let Some(layer) = layer_of(module) else {
        return vec![format!("module {module} is not in the list of layers")];
    };
    let complaint = |path: &RustPath| {
        let what = violation(module, layer, path)?;
        let RustPath { line, segments } = path;
        Some(format!("line {line}: `{}`: {what}", segments.join("::")))
    };
    paths.filter_map(complaint).collect()
}

fn violation(module: &str, layer: usize, path: &RustPath) -> Option<String> {
    if let [root, used, ..] = path.segments.as_slice()
        && root == "crate"
    {
        match layer_of(used) {
            None => return Some("not a module in the list of layers".to_owned()),
            Some(used) if used > layer => return Some("a step upwards".to_owned()),
            Some(_) => {}
        }
    }
    let names_one_of = |names: &[&str]| names.iter().any(|name| path.names(name));
    if layer < CORE && names_one_of(&NOT_IN_CORE) {
        return Some("nothing for the core".to_owned());
    }
    let is_closed = |(room, names): &(&str, &[&str])| *room == module && names_one_of(names);
    if NOT_IN.iter().any(is_closed) {
        return Some(format!("nothing for {module}"));
    }
    let away = |(name, homes): &&(&str, &[&str])| path.names(name) && !homes.contains(&module);
    let (_, homes) = AT_HOME.iter().find(away)?;
    Some(format!("only in {}", homes.join(", ")))
}

fn layer_of(module: &str) -> Option<usize> {
    LAYERS.iter().position(|name| *name == module)
}

/// The files below `src` with their texts, by path, `main.rs` and `lib.rs` aside, and without those
/// that are compiled for tests alone.
fn sources() -> Vec<(PathBuf, String, Source)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let (mut files, mut open) = (Vec::new(), vec![root.clone()]);
    while let Some(directory) = open.pop() {
        for entry in std::fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let inside = path.strip_prefix(&root).unwrap().to_owned();
                let text = std::fs::read_to_string(&path).unwrap();
                let source = Source::parse(&inside, &text);
                files.push((inside, text, source));
            }
        }
    }
    assert!(files.len() > 50, "the sources were not found");
    let test_modules = files.iter().flat_map(|(_, _, source)| &source.test_modules);
    let test_modules: BTreeSet<PathBuf> = test_modules.cloned().collect();
    let is_for_tests = |path: &Path| {
        let stem = path.with_extension("");
        stem.ancestors().any(|a| test_modules.contains(a))
    };
    files.retain(|(path, ..)| !["lib.rs", "main.rs"].contains(&path.to_string_lossy().as_ref()));
    files.retain(|(path, ..)| !is_for_tests(path));
    files.sort_by(|a, b| a.0.cmp(&b.0));
    files
}

/// The module of the crate that a file below `src` belongs to.
fn module_of(path: &Path) -> String {
    let first = Path::new(path.components().next().unwrap().as_os_str());
    first.file_stem().unwrap().to_string_lossy().into_owned()
}

#[test]
fn modules_use_only_what_is_above_them_in_the_list() {
    let mut found = Vec::new();
    for (path, _, source) in &sources() {
        let complaints = violations(&module_of(path), source.paths());
        found.extend(
            complaints
                .iter()
                .map(|c| format!("src/{}, {c}", path.display())),
        );
    }
    assert!(found.is_empty(), "\n{}", found.join("\n"));
}

#[test]
fn files_of_a_room_do_not_use_each_other_in_circles() {
    let sources = sources();
    let circles = Rooms::new(sources.iter().map(|(.., source)| source)).circles();
    let found: Vec<String> = circles.iter().map(described).collect();
    assert!(found.is_empty(), "\n{}", found.join("\n"));
}

/// A circle with the paths that make it.
fn described(circle: &Circle) -> String {
    format!("{circle}\n    {}", circle.uses.join("\n    "))
}

#[test]
fn the_list_in_the_crate_s_documentation_is_this_one() {
    let text = include_str!("../src/lib.rs");
    let (_, after) = text.split_once("//! # Layers").unwrap();
    let (_, after) = after.split_once("//! 1. ").unwrap();
    let (list, _) = after.split_once("//! # ").unwrap();
    let is_module = |word: &&str| word.chars().all(|c| c.is_ascii_lowercase() || c == '_');
    let quoted = list.split('`').skip(1).step_by(2);
    let named: Vec<&str> = quoted.filter(is_module).collect();
    assert_eq!(named, LAYERS);
    let declared = text.lines().map(|line| line.trim_start_matches("pub "));
    let declared = declared.filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';'));
    let declared: BTreeSet<&str> = declared.collect();
    assert_eq!(declared, BTreeSet::from(LAYERS));
}

fn complaints(file: &str, text: &str) -> Vec<String> {
    let path = Path::new(file);
    violations(&module_of(path), Source::parse(path, text).paths())
}

#[test]
fn a_planted_violation_is_found() {
    for (file, text) in [
        ("graph/blocks.rs", "use crate::mapping::RouteMap;"),
        (
            "graph/blocks.rs",
            "use crate::{ids::NodeId, solver::Solver};",
        ),
        (
            "graph/blocks.rs",
            "fn f() { let s = crate::solver::Solver::new(); }",
        ),
        ("graph/mod.rs", "use super::solver::Solver;"),
        ("graph/deep/er.rs", "use super::super::super::cli;"),
        ("graph.rs", "use crate::*;"),
        ("graph.rs", "use crate::nowhere::Thing;"),
        ("nowhere.rs", "use crate::ids::NodeId;"),
        ("scan/codec.rs", "use std::{fmt, fs::File};"),
        (
            "scan/codec.rs",
            "fn now() -> u64 { std::time::SystemTime::now() }",
        ),
        ("sim/drive.rs", "use std::time::{Duration, Instant};"),
        ("sim/random.rs", "fn f() { let mut rng = ::rand::rng(); }"),
        ("solver/mod.rs", "#[tracing::instrument] fn solve() {}"),
        (
            "solver/mod.rs",
            "async fn f() { tokio::task::yield_now().await }",
        ),
        ("pipeline/worker.rs", "use sqlx;"),
        ("pipeline/worker.rs", "use sqlx as database;"),
        ("store/graph.rs", "use axum::Json;"),
        (
            "store/graph.rs",
            "#[derive(Debug, utoipa::ToSchema)] struct A;",
        ),
        ("matching/icp.rs", "type Matrix = faer::Mat<f64>;"),
        (
            "cli/serve.rs",
            "fn f() { let home = std::env::var(\"HOME\"); }",
        ),
        ("api/graph.rs", "use crate::mapping::RouteMap;"),
        ("change/screen.rs", "use crate::matching::View;"),
        (
            "mapping/extend.rs",
            "struct A; #[cfg(test)] mod tests { } use crate::sim::Hall;",
        ),
        (
            "mapping/extend.rs",
            "#[cfg(not(test))] use crate::store::Store;",
        ),
    ] {
        assert_eq!(complaints(file, text).len(), 1, "{file}: {text}");
    }
}

#[test]
fn what_is_allowed_is_left_alone() {
    for (file, text) in [
        (
            "solver/whole.rs",
            "use crate::graph::{Edge, PoseGraph}; use faer::Mat;",
        ),
        (
            "solver/whole.rs",
            "use super::summary::SolveOptions; pub(crate) fn f() {}",
        ),
        (
            "solver/whole.rs",
            "// use crate::cli;\n/* crate::app::start /* nested */ */ fn f() {}",
        ),
        (
            "solver/whole.rs",
            r####"const A: &str = r#"crate::cli " tokio::spawn"#; const B: char = '"';"####,
        ),
        (
            "solver/whole.rs",
            r#"const A: &str = "\" crate::cli"; fn f<'a>(a: &'a str) {}"#,
        ),
        (
            "solver/whole.rs",
            "#[cfg(test)]\nmod tests { use crate::cli; fn f() { {} } }",
        ),
        ("solver/whole.rs", "#[cfg(test)] use std::fs::File;"),
        ("graph/deep/er.rs", "use super::super::solver;"),
        (
            "app/connections.rs",
            "use axum::Router; use crate::api::Limits;",
        ),
        (
            "telemetry.rs",
            "use metrics::counter; fn f() { let a = value.tracing::<u8>(); }",
        ),
        (
            "change/series.rs",
            "fn f() { let env = 1; let fs = env.fs; std::mem::swap(a, b); }",
        ),
    ] {
        let found = complaints(file, text);
        assert!(found.is_empty(), "{file}: {text}: {found:?}");
    }
}

fn circles(files: &[(&str, &str)]) -> Vec<String> {
    let parsed = |(file, text): &(&str, &str)| Source::parse(Path::new(file), text);
    let sources: Vec<Source> = files.iter().map(parsed).collect();
    let circles = Rooms::new(&sources).circles();
    circles.iter().map(Circle::to_string).collect()
}

/// What every planted circle shares: a room that declares its files, and one that defines a type.
const ROOM: (&str, &str) = (
    "room/mod.rs",
    "mod a; mod b; mod c; pub use a::A; pub use b::{B, Other as Renamed}; pub(crate) use c::*;",
);

#[test]
fn a_planted_circle_is_found() {
    const A: &str = "struct A;";
    for (a, b, c, found) in [
        (
            "use super::B; struct A { b: B }",
            "use super::A; struct B(A);",
            "",
            "a, b",
        ),
        (
            "use super::b::B; struct A(B);",
            "struct B; fn f(a: super::A) {}",
            "",
            "a, b",
        ),
        (
            "use crate::room::{Renamed}; struct A(Renamed);",
            "struct Other; use super::a; fn f(a: a::A) {}",
            "",
            "a, b",
        ),
        (
            A,
            "use super::{A, C}; struct B(A, C);",
            "use super::B; struct C(B);",
            "b, c",
        ),
        (
            "use super::B; struct A(B);",
            "use super::*; struct B; fn f() -> C {}",
            "use super::A; struct C(A);",
            "a, b, c",
        ),
        (
            "struct A; fn f() { g!(vec![super::B::new()]) }",
            "use super::A; struct B(A);",
            "",
            "a, b",
        ),
        (
            "struct A; fn f() { 1.method() }",
            "use super::A; struct B(A);",
            "use super::B; trait C {} fn f(b: B) {}",
            "",
        ),
        (
            "use super::C; struct A; fn f() { 1.method() }",
            A,
            "use super::A; trait C { fn f(a: A); }",
            "a, c",
        ),
        (
            "use super::B as _; struct A;",
            "use super::A; trait B { fn f(a: A); }",
            "",
            "a, b",
        ),
        (
            A,
            "use super::A; struct B(A);",
            "#[cfg(test)] mod tests { use super::super::B; } struct C;",
            "",
        ),
        (
            "struct A; #[cfg(test)] mod tests { use super::super::B; }",
            "use super::A; struct B(A);",
            "",
            "",
        ),
        (
            "/// See [`super::B`].\nstruct A;",
            "use super::A; struct B(A);",
            "",
            "",
        ),
        (
            "use super::gone::B; use serde::c::C; struct A(B, C);",
            "use super::A; struct B(A);",
            "use super::A; struct C(A);",
            "",
        ),
    ] {
        let files = [ROOM, ("room/a.rs", a), ("room/b.rs", b), ("room/c.rs", c)];
        let expected: Vec<String> = match found {
            "" => Vec::new(),
            found => vec![format!("room: {found}")],
        };
        assert_eq!(circles(&files), expected, "{a} | {b} | {c}");
    }
}

#[test]
fn a_parent_that_uses_its_children_is_not_used_by_them() {
    let child = (
        "room/child.rs",
        "use super::Item; pub struct Part(Item); pub fn f() {}",
    );
    for (parent, found) in [
        ("mod child; pub use child::Part; pub struct Item;", vec![]),
        (
            "mod child; pub use child::f; pub struct Item; fn g() { h() }",
            vec![],
        ),
        (
            "mod child; pub struct Item; fn g() { child::f() }",
            vec!["room: mod, child"],
        ),
        (
            "mod child; pub use child::f; pub struct Item; fn g() { f() }",
            vec!["room: mod, child"],
        ),
        (
            "mod child; use child::Part; pub struct Item { part: Box<Part> }",
            vec!["room: mod, child"],
        ),
    ] {
        assert_eq!(
            circles(&[("room/mod.rs", parent), child]),
            found,
            "{parent}"
        );
        let deeper = ("other/room/child.rs", child.1);
        let deeper = [
            ("other/mod.rs", "mod room;"),
            ("other/room.rs", parent),
            deeper,
        ];
        let found: Vec<String> = found
            .iter()
            .map(|_| "other: room, room/child".into())
            .collect();
        assert_eq!(circles(&deeper), found, "{parent}");
    }
}

#[test]
fn two_rooms_make_no_circle_within_one() {
    let files = [
        ("one/mod.rs", "use crate::two::B; pub struct A;"),
        ("two.rs", "use crate::one::A; pub struct B;"),
    ];
    assert_eq!(circles(&files), Vec::<String>::new());
}

#[test]
#[ignore = "prints figures and checks nothing: --ignored --nocapture figures"]
#[allow(clippy::print_stdout)]
fn figures() {
    let sources = sources();
    let rooms = Rooms::new(sources.iter().map(|(.., source)| source));
    let circles = rooms.circles();
    for circle in &circles {
        println!("{}", described(circle));
    }
    let (mut all, mut lines) = (Figures::default(), 0);
    for (path, text, _) in &sources {
        let mut figures = Figures::of(text);
        let place = format!(" in {}", path.display());
        figures.longest_function.1.push_str(&place);
        if figures.sql_statements > 0 {
            println!(
                "{:4} SQL statements in {}",
                figures.sql_statements,
                path.display()
            );
        }
        lines += text.lines().count();
        all += figures;
    }
    let (files, circles) = (sources.len(), circles.len());
    println!("{lines} lines, {files} files, {circles} circles, {all}");
}
