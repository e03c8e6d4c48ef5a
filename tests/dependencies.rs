//! Holds the dependencies to `deny.toml` without cargo-deny, which takes minutes to build: licences,
//! crates that must not come back, and where crates are from.

// Clippy lets tests unwrap, and not yet what they call.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

fn read(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

/// What stands in quotes after the first `key` of each line that has it.
fn quoted<'a>(text: &'a str, key: &str) -> Vec<&'a str> {
    let lines = text.lines().filter_map(|line| line.split_once(key));
    lines
        .filter_map(|(_, rest)| rest.split('"').nth(1))
        .collect()
}

fn allowed(deny: &str) -> Vec<&str> {
    let line = deny.lines().find(|l| l.starts_with("allow = ")).unwrap();
    line.split('"').skip(1).step_by(2).collect()
}

/// Whether an SPDX expression can be met by the allowed licences. `/` is how OR was once written;
/// in `A OR B AND C`, AND binds first.
fn is_met(expression: &str, allowed: &[&str]) -> bool {
    if let Some((group, rest)) = expression
        .strip_prefix('(')
        .and_then(|text| text.split_once(") AND "))
    {
        return is_met(group, allowed) && is_met(rest, allowed);
    }
    let expression = expression.replace('/', " OR ");
    let mut ways = expression.split(" OR ").map(str::trim);
    ways.any(|way| way.split(" AND ").all(|one| allowed.contains(&one.trim())))
}

/// Name and licence of everything that is compiled for this machine, tests included.
fn packages() -> BTreeSet<(String, String)> {
    let tree = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "--prefix", "none"])
        .args(["--edges", "normal,build,dev", "--no-dedupe"])
        .args(["--format", "{p} = {l}"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(tree.status.success(), "{tree:?}");
    let tree = String::from_utf8(tree.stdout).unwrap();
    let packages = tree.lines().map(|line| {
        let (package, licence) = line.split_once(" = ").unwrap();
        let name = package.split(' ').next().unwrap();
        (name.to_owned(), licence.to_owned())
    });
    packages.collect()
}

#[test]
fn licences_are_those_that_deny_toml_allows() {
    let deny = read("deny.toml");
    let allowed = allowed(&deny);
    assert!(allowed.contains(&"MIT"), "{allowed:?}");
    let mut packages = packages();
    assert!(packages.len() > 100, "{packages:?}");
    packages.retain(|(_, licence)| !is_met(licence, &allowed));
    assert!(packages.is_empty(), "{packages:#?}");
}

#[test]
fn denied_crates_are_not_compiled() {
    let deny = read("deny.toml");
    let denied = quoted(&deny, "{ crate = ");
    assert!(!denied.is_empty());
    for (name, _) in packages() {
        assert!(!denied.contains(&name.as_str()), "{name}");
    }
}

#[test]
fn everything_is_from_the_registry() {
    let lock = read("Cargo.lock");
    let sources = quoted(&lock, "source = ");
    assert!(sources.len() > 100, "{sources:?}");
    let places: BTreeSet<&str> = sources.into_iter().collect();
    assert_eq!(places.len(), 1, "{places:?}");
    assert!(places.iter().all(|place| place.starts_with("registry+")));
}

#[test]
fn expressions_are_read() {
    let allowed = ["MIT", "ISC"];
    for good in [
        "MIT",
        "MIT OR Apache-2.0",
        "GPL-3.0/MIT",
        "(A OR MIT) AND ISC",
        "MIT AND ISC",
    ] {
        assert!(is_met(good, &allowed), "{good}");
    }
    for bad in [
        "",
        "Apache-2.0",
        "MIT AND A",
        "(A OR B) AND MIT",
        "(MIT OR A) AND B",
    ] {
        assert!(!is_met(bad, &allowed), "{bad}");
    }
}
