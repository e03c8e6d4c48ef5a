//! One crate has no Cargo.toml to keep its layers apart: this test reads the paths in `src`.
//!
//! The order is that of the list in `src/lib.rs`. Code under `#[cfg(test)]` may name anything.

// Clippy lets tests unwrap, and not yet what they call.
#![allow(clippy::unwrap_used)]

mod rust_paths;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rust_paths::{RustPath, Source};

/// A module uses only itself and modules before it.
const LAYERS: [&str; 24] = [
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
    "webhooks",
    "api",
    "config",
    "telemetry",
    "app",
    "client",
    "cli",
];

/// The pure modules: the first so many of [`LAYERS`].
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

/// What the HTTP interface must not know: it reads what workers have stored, and hands decisions
/// to the pipeline.
const NOT_IN_API: [&str; 3] = ["crate::mapping", "crate::matching", "crate::solver"];

/// What has one home, or a few.
const AT_HOME: [(&str, &[&str]); 11] = [
    ("axum", &["api", "app"]),
    ("clap", &["config", "cli"]),
    ("crate::sim", &["sim", "experiments", "cli"]),
    ("faer", &["solver"]),
    ("hyper", &["app"]),
    ("reqwest", &["webhooks", "client"]),
    ("sqlx", &["store"]),
    ("std::env", &["config"]),
    ("utoipa", &["api"]),
    ("utoipa_axum", &["api"]),
    ("utoipa_swagger_ui", &["api"]),
];

/// What is wrong with the paths of a file of a module.
fn violations(module: &str, paths: &[RustPath]) -> Vec<String> {
    let Some(layer) = layer_of(module) else {
        return vec![format!("module {module} is not in the list of layers")];
    };
    let complaint = |path: &RustPath| {
        let what = violation(module, layer, path)?;
        let RustPath { line, segments } = path;
        Some(format!("line {line}: `{}`: {what}", segments.join("::")))
    };
    paths.iter().filter_map(complaint).collect()
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
    if module == "api" && names_one_of(&NOT_IN_API) {
        return Some("nothing for the interface".to_owned());
    }
    let away = |(name, homes): &&(&str, &[&str])| path.names(name) && !homes.contains(&module);
    let (_, homes) = AT_HOME.iter().find(away)?;
    Some(format!("only in {}", homes.join(", ")))
}

fn layer_of(module: &str) -> Option<usize> {
    LAYERS.iter().position(|name| *name == module)
}

/// The files below `src` with their texts, by path, `main.rs` and `lib.rs` aside.
fn sources() -> Vec<(PathBuf, Source)> {
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
                files.push((inside.clone(), Source::parse(&inside, &text)));
            }
        }
    }
    files.retain(|(path, _)| path != Path::new("lib.rs") && path != Path::new("main.rs"));
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
    let sources = sources();
    assert!(sources.len() > 50, "the sources were not found");
    let test_modules: BTreeSet<&PathBuf> = sources
        .iter()
        .flat_map(|(_, source)| &source.test_modules)
        .collect();
    let mut found = Vec::new();
    for (path, source) in &sources {
        let stem = path.with_extension("");
        if stem
            .ancestors()
            .any(|a| test_modules.contains(&a.to_owned()))
        {
            continue;
        }
        let complaints = violations(&module_of(path), &source.paths);
        found.extend(
            complaints
                .iter()
                .map(|c| format!("src/{}, {c}", path.display())),
        );
    }
    assert!(found.is_empty(), "\n{}", found.join("\n"));
}

#[test]
fn the_list_in_the_crate_s_documentation_is_this_one() {
    let text = include_str!("../src/lib.rs");
    let (_, after) = text.split_once("//! # Layers").unwrap();
    let (list, _) = after.split_once("//! # ").unwrap();
    let named: Vec<&str> = list
        .split("[`")
        .skip(1)
        .filter_map(|rest| Some(rest.split_once("`]")?.0))
        .collect();
    assert_eq!(named, LAYERS);
    let mut declared: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';'))
        .collect();
    let mut layers = LAYERS.to_vec();
    declared.sort_unstable();
    layers.sort_unstable();
    assert_eq!(declared, layers);
}

fn complaints(file: &str, text: &str) -> Vec<String> {
    let path = Path::new(file);
    violations(&module_of(path), &Source::parse(path, text).paths)
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
        ("sim/random.rs", "let mut rng = ::rand::rng();"),
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
        ("cli/serve.rs", "let home = std::env::var(\"HOME\");"),
        ("api/graph.rs", "use crate::mapping::RouteMap;"),
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
            "use metrics::counter; let a = value.tracing::<u8>();",
        ),
        (
            "change/series.rs",
            "let env = 1; let fs = env.fs; std::mem::swap(a, b);",
        ),
    ] {
        let found = complaints(file, text);
        assert!(found.is_empty(), "{file}: {text}: {found:?}");
    }
}
