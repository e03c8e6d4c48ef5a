//! What is no request, or too large to be one: refused as everything else is.

use crate::client::{Connection, Request};
use crate::service::Service;

/// Sends the bytes, and returns the status and the kind of the problem that ends the connection.
async fn refusal(service: &Service, bytes: &[u8]) -> (u16, String) {
    let mut connection = Connection::open(service.address).await;
    connection.write(bytes).await;
    let answer = connection.answer().await;
    assert_eq!(answer.header("connection"), Some("close"));
    (answer.status, answer.problem())
}

#[tokio::test]
async fn a_malformed_head_gets_a_problem() {
    let service = Service::start().await;
    for head in [
        &b"hello, is anybody there?\r\n\r\n"[..],
        b"GET /livez HTTP/1.1\r\nno colon\r\n\r\n",
        b"GET /livez HTTP/7.0\r\n\r\n",
        b"PUT / HTTP/1.1\r\ncontent-length: 1\r\ncontent-length: 2\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03 TLS",
    ] {
        let refused = refusal(&service, head).await;
        assert_eq!(refused, (400, "bad-request".to_owned()), "{head:?}");
    }
    service.stop().await;
}

#[tokio::test]
async fn a_malformed_head_after_a_good_one_gets_a_problem_of_its_own() {
    let service = Service::start().await;
    let mut connection = Connection::open(service.address).await;
    connection
        .write(b"GET /livez HTTP/1.1\r\nhost: test\r\n\r\n")
        .await;
    let first = connection.next_answer().await;
    assert_eq!((first.status, first.text().as_str()), (200, "ok\n"));
    connection.write(b"and now?\r\n\r\n").await;
    let second = connection.answer().await;
    assert_eq!(
        (second.status, second.problem().as_str()),
        (400, "bad-request")
    );
    service.stop().await;
}

#[tokio::test]
async fn a_long_address_gets_414() {
    let service = Service::start().await;
    let long = Request::new("GET", format!("/livez?{}", "a".repeat(9 << 10)));
    let refused = refusal(&service, &long.head()).await;
    assert_eq!(refused, (414, "uri-too-long".to_owned()));
    service.stop().await;
}

#[tokio::test]
async fn large_headers_and_many_of_them_get_431() {
    let service = Service::start().await;
    let large = |kibibytes: usize| {
        let text = "a".repeat(kibibytes << 10);
        Request::new("GET", "/livez").header("x-large", &text)
    };
    let many = (0..200).fold(Request::new("GET", "/livez"), |request, k| {
        request.header(&format!("x-{k}"), "a")
    });
    for request in [large(33), large(300), many] {
        let refused = refusal(&service, &request.head()).await;
        assert_eq!(refused, (431, "headers-too-large".to_owned()));
    }
    service.stop().await;
}
