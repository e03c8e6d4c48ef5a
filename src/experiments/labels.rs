//! Real changes that were judged by eye: CSV with the columns x, y, kind, what.

use anyhow::{Context, bail};
use serde::Serialize;

use crate::change::ChangeKind;
use crate::geometry::Vector2;
use crate::model::TextEnum as _;

/// A real change of an untouched recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Label {
    /// Map frame, where the first recording's odometry frame is the map's, metres.
    #[serde(skip)]
    pub location: Vector2<f64>,
    /// What it shows.
    pub kind: ChangeKind,
    /// In words.
    pub what: String,
}

/// Reads labels; the first line names the columns.
///
/// # Errors
/// If a line is not `x,y,kind,what`.
pub fn read_labels(text: &str) -> anyhow::Result<Vec<Label>> {
    let mut labels = Vec::new();
    for (k, line) in text.lines().enumerate().skip(1) {
        if !line.trim().is_empty() {
            labels.push(label_of(line).with_context(|| format!("line {}", k + 1))?);
        }
    }
    Ok(labels)
}

fn label_of(line: &str) -> anyhow::Result<Label> {
    let mut fields = line.splitn(4, ',').map(str::trim);
    let mut next = || fields.next().context("x, y, kind and what are needed");
    let (x, y): (f64, f64) = (next()?.parse()?, next()?.parse()?);
    let kind = next()?;
    let kind = match ChangeKind::of_text(kind) {
        Ok(known) if known.is_of_state() => known,
        _ => bail!("{kind} is neither appeared nor disappeared"),
    };
    Ok(Label {
        location: Vector2::new(x, y),
        kind,
        what: next().unwrap_or_default().trim_matches('"').to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_read() {
        let text = "x,y,kind,what\n4.33,-4.15,appeared,\"chair, in front of a box\"\n";
        let labels = read_labels(text).unwrap();
        assert_eq!(labels[0].location, Vector2::new(4.33, -4.15));
        assert_eq!(labels[0].what, "chair, in front of a box");
        assert!(read_labels("x,y,kind,what\n1,2,moved,it").is_err());
    }
}
