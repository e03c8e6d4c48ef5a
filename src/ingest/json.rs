//! Strict JSON: one document, known fields once each, errors that name the faulty field.

use std::fmt;
use std::marker::PhantomData;

use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeOwned, Deserializer, MapAccess, Visitor};
use serde_json::error::Category;
use serde_path_to_error::{Path, Segment};

/// No accepted document nests deeper.
const DEPTH_MAX: usize = 16;

/// The kind of mistake in a document.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JsonMistake {
    /// It is not JSON, or has unknown or repeated fields.
    Malformed,
    /// A field is missing, or has the wrong type or form.
    Field,
    /// A number beyond the range of a double.
    Range,
}

/// Why a document was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{detail}")]
pub struct JsonError {
    /// The kind of mistake.
    pub mistake: JsonMistake,
    /// JSON pointer (RFC 6901) to the faulty field, or to its parent if it is missing.
    pub pointer: String,
    /// For the sender.
    pub detail: String,
}

/// Reads one JSON document. The type bounds the depth by refusing unknown fields; what it keeps as raw
/// text is read without recursion.
///
/// # Errors
/// [`JsonError`] with the place of the first mistake.
pub fn from_json<T: DeserializeOwned>(body: &[u8]) -> Result<T, JsonError> {
    match serde_json::from_slice(body) {
        Ok(value) => Ok(value),
        // Keeping track of the path costs time, so only faulty documents are read with it.
        Err(_) => Err(explain::<T>(body)),
    }
}

fn explain<T: DeserializeOwned>(body: &[u8]) -> JsonError {
    let malformed = |detail: String| JsonError {
        mistake: JsonMistake::Malformed,
        pointer: String::new(),
        detail,
    };
    if body.iter().all(u8::is_ascii_whitespace) {
        return malformed("the body is empty".into());
    }
    if let Err(error) = std::str::from_utf8(body) {
        return malformed(format!("the body is not UTF-8: {error}"));
    }
    if depth(body) > DEPTH_MAX {
        return malformed(format!("the document nests deeper than {DEPTH_MAX}"));
    }
    let mut deserializer = serde_json::Deserializer::from_slice(body);
    let error = match serde_path_to_error::deserialize::<_, T>(&mut deserializer) {
        Err(error) => error,
        Ok(_) => return malformed("there is more after the end of the document".into()),
    };
    let pointer = json_pointer(error.path());
    let error = error.into_inner();
    let text = error.to_string();
    let mistake = match error.classify() {
        Category::Data if text.starts_with("unknown field") => JsonMistake::Malformed,
        Category::Data if text.starts_with("duplicate field") => JsonMistake::Malformed,
        Category::Data => JsonMistake::Field,
        _ if text.starts_with("number out of range") => JsonMistake::Range,
        _ => JsonMistake::Malformed,
    };
    let detail = match literal_at(body, error.line(), error.column()) {
        Some(literal) if mistake == JsonMistake::Malformed => format!(
            "{literal} is not JSON; send null for a beam without a return (REP-117), and leave other unknown numbers out: {text}"
        ),
        _ => text,
    };
    JsonError {
        mistake,
        pointer,
        detail,
    }
}

/// How deep arrays and objects nest.
pub(super) fn depth(body: &[u8]) -> usize {
    let (mut depth, mut deepest, mut in_string, mut escaped) = (0_usize, 0, false, false);
    for byte in body {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_string => escaped = true,
            b'"' => in_string = !in_string,
            b'[' | b'{' if !in_string => depth += 1,
            b']' | b'}' if !in_string => depth = depth.saturating_sub(1),
            _ => {}
        }
        deepest = deepest.max(depth);
    }
    deepest
}

/// The JavaScript number literal that the parser stumbled over, if it is one.
fn literal_at(body: &[u8], line: usize, column: usize) -> Option<&'static str> {
    let line = body.split(|&b| b == b'\n').nth(line.checked_sub(1)?)?;
    let around = line.get(column.saturating_sub(2)..)?;
    let holds = |word: &[u8]| {
        around
            .windows(word.len())
            .take(3)
            .any(|window| window == word)
    };
    ["NaN", "Infinity", "nan", "inf"]
        .into_iter()
        .find(|word| holds(word.as_bytes()))
}

fn json_pointer(path: &Path) -> String {
    let mut pointer = String::new();
    for segment in path.iter() {
        match segment {
            Segment::Seq { index } => pointer.push_str(&format!("/{index}")),
            Segment::Map { key } | Segment::Enum { variant: key } => {
                pointer.push('/');
                pointer.push_str(&key.replace('~', "~0").replace('/', "~1"));
            }
            Segment::Unknown => {}
        }
    }
    pointer
}

/// A struct that is read from a JSON object only; serde would take an array of its fields too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Object<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ObjectVisitor<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for ObjectVisitor<T> {
            type Value = Object<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Object<T>, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Object)
            }
        }
        deserializer.deserialize_map(ObjectVisitor(PhantomData))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Inner {
        #[serde(rename = "a/b~c")]
        odd: f64,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Outer {
        list: Vec<Object<Inner>>,
    }

    fn refused(text: &str) -> JsonError {
        from_json::<Object<Outer>>(text.as_bytes()).unwrap_err()
    }

    #[test]
    fn the_pointer_is_escaped() {
        let error = refused(r#"{"list":[{"a/b~c":1},{"a/b~c":"x"}]}"#);
        assert_eq!(error.pointer, "/list/1/a~1b~0c");
        assert_eq!(error.mistake, JsonMistake::Field);
    }

    #[test]
    fn each_mistake_has_its_kind() {
        use JsonMistake::{Field, Malformed, Range};
        for (text, mistake) in [
            ("", Malformed),
            ("{", Malformed),
            (r#"{"list":[]} x"#, Malformed),
            (r#"{"list":[],"more":1}"#, Malformed),
            (r#"{"list":[],"list":[]}"#, Malformed),
            (r#"{"list":[{"a/b~c":1e400}]}"#, Range),
            (r#"{}"#, Field),
            (r#"[[]]"#, Field),
            (r#"{"list":[[1.0]]}"#, Field),
        ] {
            assert_eq!(refused(text).mistake, mistake, "{text}");
        }
        for (depth, mistake) in [(16, Field), (17, Malformed), (100_000, Malformed)] {
            assert_eq!(refused(&"[".repeat(depth)).mistake, mistake);
        }
        assert_eq!(refused(&format!("\"{}", "[".repeat(20))).mistake, Malformed);
        let error = from_json::<Object<Outer>>(b"{\"list\":\"\xff\"}").unwrap_err();
        assert!(error.detail.contains("UTF-8"));
    }

    #[test]
    fn literals_of_other_languages_are_explained() {
        for literal in ["NaN", "Infinity", "-Infinity", "nan"] {
            let error = refused(&format!(r#"{{"list":[{{"a/b~c":{literal}}}]}}"#));
            assert_eq!(error.mistake, JsonMistake::Malformed);
            assert!(error.detail.contains("send null"), "{error}");
        }
    }
}
