//! Starting and stopping.

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};
use std::time::Duration;

use tempfile::TempDir;

use crate::body::batch;
use crate::client::{Connection, Request};
use crate::service::Service;

#[tokio::test]
async fn shutdown_completes_requests_under_way_and_refuses_new_ones() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let address = service.address;
    let request = Request::new("PUT", "/v1/routes/line-4/batches/b-1").json(&batch(0, 2));
    let mut upload = Connection::open(address).await;
    upload
        .write(&request.clone().header("expect", "100-continue").head())
        .await;
    upload.wait_until_asked_for_body().await;

    let stopping = tokio::spawn(service.stop());
    let refused = loop {
        let answer = Request::new("GET", "/v1/routes").send(address).await;
        if answer.status == 503 {
            break answer;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    };
    assert_eq!(refused.problem(), "shutting-down");
    assert!(refused.header("retry-after").is_some());
    assert_eq!(
        Request::new("GET", "/livez").send(address).await.status,
        200
    );
    assert!(!stopping.is_finished());

    upload.write(request.body.as_ref().unwrap()).await;
    assert_eq!(upload.answer().await.status, 202);
    stopping.await.unwrap();
    assert!(tokio::net::TcpStream::connect(address).await.is_err());
}

#[tokio::test]
async fn an_idle_connection_does_not_hold_up_shutdown() {
    let service = Service::start().await;
    let mut idle = Connection::open(service.address).await;
    let mut used = Connection::open(service.address).await;
    used.write(b"GET /livez HTTP/1.1\r\nhost: test\r\n\r\n")
        .await;
    let mut begun = [0; 15];
    used.read_exact(&mut begun).await;
    assert_eq!(&begun, b"HTTP/1.1 200 OK");
    service.stop().await;
    assert!(idle.rest().await.is_empty());
}

fn serve(directory: &TempDir) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mapshift"));
    command
        .args(["serve", "--listen", "127.0.0.1:0", "--data"])
        .arg(directory.path().join("data"));
    command
}

/// As in a bare container: it cannot call webhooks by https, and does everything else.
#[test]
fn the_command_starts_on_a_system_without_certificates() {
    let directory = TempDir::new().unwrap();
    let mut service = serve(&directory)
        .env("SSL_CERT_FILE", directory.path().join("none"))
        .env("SSL_CERT_DIR", directory.path().join("none"))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let output = service.stdout.as_mut().unwrap();
    BufReader::new(output).read_line(&mut line).unwrap();
    service.kill().unwrap();
    service.wait().unwrap();
    assert!(line.starts_with("mapshift listens on"), "{line}");
}

#[test]
fn the_command_prints_its_address_and_stops_on_sigterm() {
    let directory = TempDir::new().unwrap();
    let mut service = serve(&directory)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut output = BufReader::new(service.stdout.take().unwrap());
    let mut line = String::new();
    output.read_line(&mut line).unwrap();
    assert!(
        line.starts_with("mapshift listens on http://127.0.0.1:"),
        "{line}"
    );
    let terminated = Command::new("kill").arg(service.id().to_string()).status();
    assert!(terminated.unwrap().success());
    let mut rest = String::new();
    output.read_to_string(&mut rest).unwrap();
    assert_eq!(rest, "");
    assert_eq!(service.wait().unwrap().code(), Some(0));
}

#[test]
fn the_command_refuses_the_open_network_without_the_setting() {
    let data = tempfile::tempdir().unwrap();
    let refused = Command::new(env!("CARGO_BIN_EXE_mapshift"))
        .args(["serve", "--listen", "0.0.0.0:0", "--data"])
        .arg(data.path())
        .output()
        .unwrap();
    assert_eq!(refused.status.code(), Some(1));
    let text = String::from_utf8(refused.stderr).unwrap();
    assert!(text.contains("--insecure-open-to-network"), "{text}");
}
