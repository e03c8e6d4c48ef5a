//! Alerts as comma-separated values, for spreadsheets.

use std::fmt::Write as _;

use crate::client::AlertDetail;

const HEAD: &str = "id,kind,status,tier,confidence,x_m,y_m,sigma_m,length_m,width_m,first_seen,last_seen,raised_at,title,summary";

/// A line for each alert behind a line of names.
pub(super) fn csv(alerts: &[AlertDetail]) -> String {
    let mut text = format!("{HEAD}\r\n");
    for alert in alerts {
        let AlertDetail {
            id,
            kind,
            status,
            tier,
            confidence,
            location,
            first_seen,
            last_seen,
            raised_at,
            ..
        } = alert;
        let size = alert
            .size
            .map(|size| format!("{},{}", size.length, size.width));
        let size = size.unwrap_or_else(|| ",".to_owned());
        let (x, y, sigma) = (location.x, location.y, location.sigma);
        let (title, summary) = (quoted(&alert.title), quoted(&alert.summary));
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "{id},{kind},{status},{tier},{confidence},{x},{y},{sigma},{size},\
             {first_seen},{last_seen},{raised_at},{title},{summary}\r\n"
        );
    }
    text
}

/// A text as RFC 4180 has it.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_quoted_and_every_line_has_as_many_fields() {
        let alert = serde_json::json!({
            "id": "a", "kind": "appeared", "status": "open", "tier": "confirmed",
            "title": "Appeared: \"big\", it seems", "summary": "none", "confidence": 0.5,
            "location": {"x": 1.0, "y": -2.0, "sigma": 0.1}, "region": [], "size": null,
            "first_seen": "2026-11-20T06:00:00Z", "last_seen": "2026-11-20T06:00:01Z",
            "raised_at": "2026-11-20T06:00:02Z",
        });
        let alert = serde_json::from_value(alert).unwrap();
        let text = csv(&[alert]);
        let expected = "a,appeared,open,confirmed,0.5,1,-2,0.1,,,2026-11-20T06:00:00Z,\
                        2026-11-20T06:00:01Z,2026-11-20T06:00:02Z,\
                        \"Appeared: \"\"big\"\", it seems\",\"none\"";
        assert_eq!(text, format!("{HEAD}\r\n{expected}\r\n"));
        assert_eq!(HEAD.matches(',').count(), 14);
    }
}
