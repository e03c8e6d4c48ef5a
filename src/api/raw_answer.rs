//! A problem as the bytes of a whole answer, for connections on which no request was read.

use axum::http::header;
use jiff::Timestamp;
use jiff::fmt::rfc2822::DateTimePrinter;
use uuid::Uuid;

use super::problem::Problem;

/// The answer, which is the connection's last.
pub fn raw_answer(problem: &Problem) -> Vec<u8> {
    let request_id = Uuid::now_v7().to_string();
    let body = serde_json::to_vec(&problem.body(&request_id)).unwrap_or_default();
    let mut answer = format!(
        "HTTP/1.1 {}\r\ncontent-type: application/problem+json\r\ncontent-length: {}\r\nx-request-id: {request_id}\r\nconnection: close\r\n",
        problem.kind().status(),
        body.len()
    );
    if let Ok(date) = DateTimePrinter::new().timestamp_to_rfc9110_string(&Timestamp::now()) {
        answer.push_str(&format!("date: {date}\r\n"));
    }
    let mut answer = answer.into_bytes();
    let others = problem.headers().iter();
    for (name, value) in others.filter(|(name, _)| name != header::CONNECTION) {
        answer.extend_from_slice(name.as_str().as_bytes());
        answer.extend_from_slice(b": ");
        answer.extend_from_slice(value.as_bytes());
        answer.extend_from_slice(b"\r\n");
    }
    answer.extend_from_slice(b"\r\n");
    answer.extend_from_slice(&body);
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::quota::Quota;

    #[test]
    fn an_answer_is_complete_and_closes_the_connection() {
        let problem = Quota::requests("connections", 512).exceeded().closing();
        let answer = String::from_utf8(raw_answer(&problem)).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        assert!(
            head.starts_with("HTTP/1.1 429 Too Many Requests\r\n"),
            "{head}"
        );
        assert_eq!(head.matches("connection: close").count(), 1, "{head}");
        assert!(
            head.contains(&format!("content-length: {}\r\n", body.len())),
            "{head}"
        );
        for field in ["retry-after: 2", "ratelimit-policy: ", "date: "] {
            assert!(head.contains(field), "{head}");
        }
        let body: serde_json::Value = serde_json::from_str(body).unwrap();
        assert_eq!(body["type"], "/problems/too-many-requests");
        assert!(head.contains(body["instance"].as_str().unwrap()), "{head}");
    }
}
