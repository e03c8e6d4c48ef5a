//! The corpora of the fuzz targets: what they begin with, and what they have found.

// The lints spare test functions only, not the helpers beside them.
#![allow(clippy::unwrap_used)]

#[path = "fuzz/laws.rs"]
mod laws;

use std::path::Path;

use proptest::prelude::*;

fn corpus(name: &str) -> Vec<Vec<u8>> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    let files = std::fs::read_dir(directory.join(name)).unwrap();
    files
        .map(|file| std::fs::read(file.unwrap().path()).unwrap())
        .collect()
}

#[test]
fn the_corpora_break_no_law() {
    for (name, law) in laws::DECODERS {
        let corpus = corpus(name);
        assert!(corpus.len() >= 2, "{name}");
        corpus.iter().for_each(|bytes| law(bytes));
    }
}

/// Bytes of the corpora with some of them replaced, a part of another put in, and an end cut off.
fn mutated(name: &str) -> impl Strategy<Value = Vec<u8>> + use<> {
    let file = proptest::sample::select(corpus(name));
    let bytes = proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6);
    let part = (any::<prop::sample::Index>(), file.clone(), 0..40_usize);
    let end = proptest::option::of(any::<prop::sample::Index>());
    (file, bytes, part, end).prop_map(|(mut file, bytes, (at, other, length), end)| {
        if !file.is_empty() {
            for (place, byte) in bytes {
                let place = place.index(file.len());
                file[place] = byte;
            }
            let at = at.index(file.len());
            let part = other.iter().skip(at).take(length).copied();
            file.splice(at..at, part.collect::<Vec<_>>());
            file.truncate(end.map_or(file.len(), |end| end.index(file.len())));
        }
        file
    })
}

fn keep_the_laws(cases: u32) {
    for (name, law) in laws::DECODERS {
        let config = ProptestConfig {
            failure_persistence: None,
            ..ProptestConfig::with_cases(cases)
        };
        proptest!(config, |(bytes in mutated(name))| law(&bytes));
    }
}

#[test]
fn mutated_uploads_break_no_law() {
    keep_the_laws(2_000);
}

/// A million uploads: minutes with `--release`.
#[test]
#[ignore = "slow: cargo test --release --test decoders -- --ignored"]
fn a_million_mutated_uploads_break_no_law() {
    keep_the_laws(200_000);
}
