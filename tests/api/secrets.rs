//! What must not be written down anywhere: keys, ids of sessions, secrets of webhooks.

use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

use mapshift::model::Role;
use mapshift::store::Secret;
use serde_json::json;
use tracing_subscriber::fmt::MakeWriter;

use crate::changed_hall;
use crate::client::Request;
use crate::keys::{key, make, text, with_key};
use crate::log::log_to;
use crate::service::Service;

/// A log that is kept in memory.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

fn contains(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}

/// All bytes of all files below a directory.
fn files(directory: &Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => bytes.extend(files(&path)),
            false => bytes.extend(std::fs::read(path).unwrap()),
        }
    }
    bytes
}

// On one thread, so that everything the service logs comes here.
#[tokio::test]
async fn secrets_are_neither_logged_nor_stored() {
    let log = Log::default();
    let subscriber = tracing_subscriber::fmt()
        .with_max_level(tracing::Level::TRACE)
        .with_writer(log.clone());
    let _guard = log_to(subscriber.finish());

    let admin = key("admin", Role::Admin);
    let directory = changed_hall::directory().await;
    make(&directory, &[&admin]).await;
    let service = Service::start_changed(directory, |_| ()).await;
    let signed_in = Request::new("POST", "/v1/session").json(&json!({"key": text(&admin)}));
    let signed_in = service.send(signed_in).await;
    let cookie = signed_in
        .header("set-cookie")
        .unwrap()
        .split(';')
        .next()
        .unwrap();
    let get = Request::new("GET", "/v1/routes").header("cookie", cookie);
    assert_eq!(service.send(get).await.status, 200);
    let wrong = key("nobody", Role::Admin);
    let get = with_key(Request::new("GET", "/v1/routes"), &wrong);
    assert_eq!(service.send(get).await.status, 401);
    let made = Request::new("POST", "/v1/keys").json(&json!({"name": "b", "role": "viewer"}));
    let made = service.send(with_key(made, &admin)).await.json();
    let hook = json!({"url": "https://example.com/"});
    let hook = Request::new("POST", "/v1/webhooks").json(&hook);
    let hook = service.send(with_key(hook, &admin)).await.json();
    let audit = service
        .send(with_key(Request::new("GET", "/v1/audit"), &admin))
        .await
        .text();
    let directory = service.stop_keeping().await;

    let session = cookie.split_once('=').unwrap().1;
    let log = log.0.lock().unwrap().clone();
    assert!(contains(&log, b"signed in"), "the log is not captured");
    let kept = files(directory.path());
    let made = made["key"].as_str().unwrap();
    for whole in [&text(&admin), &text(&wrong), made, session] {
        let secret = match whole.strip_prefix("ms_") {
            Some(rest) => rest.split_once('_').unwrap().1,
            None => whole,
        };
        assert_eq!(secret.len(), 43);
        for place in [&log, &kept, audit.as_bytes()] {
            assert!(!contains(place, secret.as_bytes()));
        }
    }
    // Webhooks are signed with theirs, which is therefore kept; but nowhere shown.
    let hook = hook["secret"]
        .as_str()
        .unwrap()
        .strip_prefix("whsec_")
        .unwrap();
    assert!(!contains(&log, hook.as_bytes()) && !audit.contains(hook));
    assert!(Secret::of_text(session).is_some());
}
