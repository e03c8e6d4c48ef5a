//! A client that sends exactly the bytes it is told to.

use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};

/// What a client gave up waiting for is a failed test, not a hanging one.
const PATIENCE: Duration = Duration::from_secs(30);

/// A request; `Connection: close` and `Content-Length` are added.
#[derive(Debug, Clone)]
pub struct Request {
    pub method: &'static str,
    pub path: String,
    pub headers: Vec<(String, String)>,
    pub body: Option<Vec<u8>>,
}

impl Request {
    pub fn new(method: &'static str, path: impl Into<String>) -> Self {
        Self {
            method,
            path: path.into(),
            headers: Vec::new(),
            body: None,
        }
    }

    pub fn header(mut self, name: &str, value: &str) -> Self {
        self.headers.push((name.into(), value.into()));
        self
    }

    pub fn body(mut self, body: impl Into<Vec<u8>>) -> Self {
        self.body = Some(body.into());
        self
    }

    pub fn json(self, body: &Value) -> Self {
        self.header("content-type", "application/json")
            .body(body.to_string())
    }

    pub fn head(&self) -> Vec<u8> {
        let mut head = format!(
            "{} {} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n",
            self.method, self.path
        );
        for (name, value) in &self.headers {
            head.push_str(&format!("{name}: {value}\r\n"));
        }
        let has_length = self
            .headers
            .iter()
            .any(|(name, _)| name == "content-length");
        if let Some(body) = self.body.as_ref().filter(|_| !has_length) {
            head.push_str(&format!("content-length: {}\r\n", body.len()));
        }
        head.push_str("\r\n");
        head.into_bytes()
    }

    pub async fn send(&self, address: SocketAddr) -> Answer {
        let mut connection = Connection::open(address).await;
        connection.write(&self.head()).await;
        if let Some(body) = &self.body {
            connection.write(body).await;
        }
        connection.answer().await
    }
}

/// A connection under the test's control.
pub struct Connection(TcpStream);

impl Connection {
    pub async fn open(address: SocketAddr) -> Self {
        Self(TcpStream::connect(address).await.unwrap())
    }

    /// Comes from another address of this machine than the other connections.
    pub async fn open_from_elsewhere(address: SocketAddr) -> Self {
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind("127.0.0.2:0".parse().unwrap()).unwrap();
        Self(socket.connect(address).await.unwrap())
    }

    /// Waits until the service has cut the connection, without reading.
    pub async fn wait_until_cut_off(&mut self) {
        let cut = async {
            while self.0.write_all(b"\r\n").await.is_ok() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        let outcome = tokio::time::timeout(PATIENCE, cut).await;
        outcome.expect("the service cuts the connection");
    }

    /// Sends bytes; a service that has stopped listening is no failure here, its answer counts.
    pub async fn write(&mut self, bytes: &[u8]) {
        let _ = self.0.write_all(bytes).await;
    }

    /// Waits for as many bytes as fit.
    pub async fn read_exact(&mut self, bytes: &mut [u8]) {
        let read = self.0.read_exact(bytes);
        let outcome = tokio::time::timeout(PATIENCE, read).await;
        outcome.expect("the service answers").unwrap();
    }

    /// The service asks for an expected body once the upload has its place.
    pub async fn wait_until_asked_for_body(&mut self) {
        let mut asked = [0; 25];
        self.read_exact(&mut asked).await;
        assert_eq!(&asked, b"HTTP/1.1 100 Continue\r\n\r\n");
    }

    /// Reads up to the end of a text, and returns what came; what follows is left for later.
    pub async fn wait_for(&mut self, text: &str) -> String {
        let mut bytes = Vec::new();
        let read = async {
            while !bytes.ends_with(text.as_bytes()) {
                bytes.push(self.0.read_u8().await.unwrap());
            }
        };
        let outcome = tokio::time::timeout(PATIENCE, read).await;
        let came = String::from_utf8_lossy(&bytes).into_owned();
        assert!(outcome.is_ok(), "{text} does not come in {came}");
        came
    }

    /// Everything that comes until the service closes the connection.
    pub async fn rest(&mut self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let read = self.0.read_to_end(&mut bytes);
        let outcome = tokio::time::timeout(PATIENCE, read).await;
        outcome.expect("the service closes the connection").unwrap();
        bytes
    }

    /// The answer to a request on a connection that stays open.
    pub async fn next_answer(&mut self) -> Answer {
        let head = self.wait_for("\r\n\r\n").await;
        let mut answer = Answer::parse(head.as_bytes());
        let length = answer.header("content-length").unwrap();
        answer.body = vec![0; length.parse().unwrap()];
        self.read_exact(&mut answer.body).await;
        answer
    }

    pub async fn answer(&mut self) -> Answer {
        Answer::parse(&self.rest().await)
    }
}

/// A response.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl Answer {
    fn parse(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|w| w == b"\r\n\r\n");
        let end =
            end.unwrap_or_else(|| panic!("no response in {:?}", String::from_utf8_lossy(bytes)));
        let head = std::str::from_utf8(&bytes[..end]).unwrap();
        let mut lines = head.lines();
        let status = lines.next().unwrap().split(' ').nth(1).unwrap();
        let headers = lines.map(|line| {
            let (name, value) = line.split_once(':').unwrap();
            (name.to_ascii_lowercase(), value.trim().to_owned())
        });
        let mut answer = Self {
            status: status.parse().unwrap(),
            headers: headers.collect(),
            body: bytes[end + 4..].to_vec(),
        };
        if answer.header("transfer-encoding") == Some("chunked") {
            answer.body = unchunked(&answer.body);
        }
        answer
    }

    pub fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(other, _)| other == name);
        found.map(|(_, value)| value.as_str())
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error} in {:?}", String::from_utf8_lossy(&self.body)))
    }

    pub fn text(&self) -> String {
        String::from_utf8(self.body.clone()).unwrap()
    }

    /// The last part of a problem's `type`.
    pub fn problem(&self) -> String {
        assert_eq!(
            self.header("content-type"),
            Some("application/problem+json")
        );
        let problem = self.json();
        assert_eq!(problem["status"], self.status);
        assert_eq!(problem["instance"].as_str(), self.header("x-request-id"));
        let kind = problem["type"].as_str().unwrap();
        kind.strip_prefix("/problems/").unwrap().to_owned()
    }
}

/// A body without the framing of its chunks (RFC 9112, section 7.1).
///
/// # Panics
/// If it was cut off before its last chunk.
fn unchunked(mut framed: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    loop {
        let end = framed.windows(2).position(|w| w == b"\r\n").unwrap();
        let length = std::str::from_utf8(&framed[..end]).unwrap();
        let length = usize::from_str_radix(length, 16).unwrap();
        if length == 0 {
            return body;
        }
        body.extend_from_slice(&framed[end + 2..end + 2 + length]);
        framed = &framed[end + 2 + length + 2..];
    }
}
